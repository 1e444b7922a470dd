//! The emissions that may have caused the echoes of one line: its own, and those before it whose pulses may be in the air.

use super::{Cause, Emission, Prior, Settings};

/// So many emissions before a line are looked at, at most.
const MOST_BEFORE: usize = 126;
/// Beams flatter than this never meet flat ground.
const LEAST_COSINE: f32 = 0.05;
/// The interval where a recording has one emission, ps.
const UNKNOWN_INTERVAL_PS: f64 = 2.5e6;
/// Intervals further from the median than this part of it hold a lost record.
pub(super) const REGULAR_PART: f64 = 0.05;

/// Emissions in order of time: first those before the line, then its own.
#[derive(Debug, Default)]
pub(super) struct Pulses {
    pub clock_ps: Vec<i64>,
    pub shot: Vec<u64>,
    /// Place across the line, in shots.
    pub column: Vec<i32>,
    /// Expected range, m, NaN where unknown; empty without a prior.
    pub expected_m: Vec<f32>,
    /// Where the line's own emissions begin.
    pub lead: usize,
    /// Line and index of those before.
    lead_causes: Vec<Cause>,
    /// The usual interval, ps and m.
    pub interval_ps: f64,
    pub interval_m: f32,
    /// How many intervals before each emission, without a break, hold no lost record.
    pub regular: Vec<u32>,
    /// How much farther an emission is from the line's first than it were at even intervals, m.
    pub offset_m: Vec<f32>,
}

/// The last emissions so far.
#[derive(Debug, Default)]
pub(super) struct Tail {
    clock_ps: Vec<i64>,
    shot: Vec<u64>,
    column: Vec<i32>,
    expected_m: Vec<f32>,
    causes: Vec<Cause>,
    interval_ps: Option<f64>,
}

impl Pulses {
    /// The emissions of line `number` at the places `columns`, behind those of `tail`, which becomes this line's.
    pub fn new(
        emissions: &[Emission],
        columns: Vec<i32>,
        number: u64,
        settings: &Settings,
        tail: &mut Tail,
    ) -> Pulses {
        let reach_ps = 2e12 * settings.range_m[1] / settings.group_velocity_mps;
        let mut pulses = Pulses::default();
        let first = emissions.first().map_or(0, |emission| emission.clock_ps);
        // Where the clock was set anew, no emission before is comparable.
        let follows = tail.clock_ps.last().is_some_and(|&last| last < first) && !emissions.is_empty();
        let from = match follows {
            true => tail.clock_ps.partition_point(|&clock| (first.saturating_sub(clock)) as f64 > reach_ps),
            false => tail.clock_ps.len(),
        };
        pulses.lead = tail.clock_ps.len() - from;
        pulses.clock_ps.extend_from_slice(&tail.clock_ps[from..]);
        pulses.shot.extend_from_slice(&tail.shot[from..]);
        pulses.column.extend_from_slice(&tail.column[from..]);
        pulses.expected_m.extend_from_slice(tail.expected_m.get(from..).unwrap_or_default());
        pulses.lead_causes.extend_from_slice(&tail.causes[from..]);
        pulses.clock_ps.extend(emissions.iter().map(|emission| emission.clock_ps));
        pulses.shot.extend(emissions.iter().map(|emission| emission.shot));
        pulses.column.extend(columns);
        pulses.expect(emissions, settings);
        pulses.measure(settings, tail.interval_ps);
        if !emissions.is_empty() {
            tail.follow(&pulses, number);
        }
        pulses
    }

    /// Adds the expected ranges of the line's own emissions.
    fn expect(&mut self, emissions: &[Emission], settings: &Settings) {
        match settings.prior {
            Prior::None => {}
            Prior::Agl { agl_m, .. } => {
                let range = |cos: f32| if cos > LEAST_COSINE { agl_m as f32 / cos } else { f32::NAN };
                self.expected_m.extend(emissions.iter().map(|emission| range(emission.cos_nadir)));
            }
            Prior::PerEmission { .. } => {
                self.expected_m.extend(emissions.iter().map(|emission| emission.prior_range_m));
            }
        }
    }

    /// Finds the interval and what departs from it.
    fn measure(&mut self, settings: &Settings, usual_ps: Option<f64>) {
        let mut intervals: Vec<i64> =
            self.clock_ps.windows(2).map(|pair| pair[1].saturating_sub(pair[0])).collect();
        let middle = intervals.len() / 2;
        self.interval_ps = match intervals.is_empty() {
            true => usual_ps.unwrap_or(UNKNOWN_INTERVAL_PS),
            false => *intervals.select_nth_unstable(middle).1 as f64,
        };
        let m_per_ps = 0.5e-12 * settings.group_velocity_mps;
        self.interval_m = (self.interval_ps * m_per_ps) as f32;
        let is_regular = |from: i64, to: i64| {
            (to.saturating_sub(from) as f64 - self.interval_ps).abs() <= REGULAR_PART * self.interval_ps
        };
        let mut run = 0;
        self.regular = (0..self.clock_ps.len())
            .map(|place| {
                let before = place.checked_sub(1).map(|before| self.clock_ps[before]);
                run = if before.is_some_and(|before| is_regular(before, self.clock_ps[place])) {
                    run + 1
                } else {
                    0
                };
                run
            })
            .collect();
        let first = self.clock_ps.get(self.lead).copied().unwrap_or(0);
        let (lead, interval_ps) = (self.lead as f64, self.interval_ps);
        let places = (0u32..).zip(&self.clock_ps);
        let offset =
            |p: u32, clock: i64| clock.saturating_sub(first) as f64 - (f64::from(p) - lead) * interval_ps;
        self.offset_m = places.map(|(p, &clock)| (offset(p, clock) * m_per_ps) as f32).collect();
    }

    /// How many emissions the line itself has.
    pub fn own(&self) -> usize {
        self.clock_ps.len() - self.lead
    }

    /// The line's own clocks, ps.
    pub fn own_clocks(&self) -> &[i64] {
        &self.clock_ps[self.lead..]
    }

    /// The emission at `place`, counted from the first that is held.
    pub fn cause(&self, place: usize, line: u64) -> Cause {
        match place.checked_sub(self.lead) {
            Some(own) => Cause { line, emission: own as u32 },
            None => self.lead_causes[place],
        }
    }

    /// The first line of which emissions are held, this being line `line`.
    pub fn first_line(&self, line: u64) -> u64 {
        self.lead_causes.first().map_or(line, |cause| cause.line)
    }

    /// The place of the emission with a running number, looked for from `near` backwards.
    pub fn of_shot(&self, shot: Option<u64>, near: u32) -> Option<usize> {
        let shot = shot?;
        let near = (near as usize + 1).min(self.shot.len());
        let place = self.shot[..near].iter().rposition(|&number| number <= shot)?;
        (self.shot[place] == shot).then_some(place)
    }
}

impl Tail {
    fn follow(&mut self, pulses: &Pulses, line: u64) {
        let from = pulses.clock_ps.len().saturating_sub(MOST_BEFORE);
        self.clock_ps = pulses.clock_ps[from..].to_vec();
        self.shot = pulses.shot[from..].to_vec();
        self.column = pulses.column[from..].to_vec();
        self.expected_m = pulses.expected_m.get(from..).unwrap_or_default().to_vec();
        self.causes = (from..pulses.clock_ps.len()).map(|place| pulses.cause(place, line)).collect();
        self.interval_ps = Some(pulses.interval_ps);
    }
}
