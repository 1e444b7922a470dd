//! Candidate emissions for the echoes of one line.
//!
//! These are its own emissions and earlier ones whose pulses may still be in the air.

use super::{Cause, Emission, Prior, Settings};

/// Width of a cell, shots.
pub(super) const CELL_SHOTS: i32 = 16;
/// Largest number of emissions considered before a line.
const MOST_BEFORE: usize = 126;
/// Smallest nadir cosine at which a beam reaches flat ground.
const LEAST_COSINE: f32 = 0.05;
/// Interval assumed for a recording with one emission, ps.
const UNKNOWN_INTERVAL_PS: f64 = 2.5e6;
/// Relative deviation from the median interval above which a record was lost.
pub(super) const REGULAR_PART: f64 = 0.05;

/// Emissions in time order: those before the line, then its own.
#[derive(Debug, Default)]
pub(super) struct LinePulses {
    pub clock_ps: Vec<i64>,
    pub shot: Vec<u64>,
    /// Column of each emission.
    pub column: Vec<i32>,
    /// Expected range, m, NaN if unknown; empty without a prior.
    pub expected_m: Vec<f32>,
    /// Index of the line's first own emission.
    pub lead: usize,
    /// Line and index of the earlier emissions.
    lead_causes: Vec<Cause>,
    /// Median interval, ps and m.
    pub interval_ps: f64,
    pub interval_m: f32,
    /// Number of consecutive intervals before each emission without a lost record.
    pub regular: Vec<u32>,
    /// Deviation of the emission time from even intervals after the line's first, m of range.
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

impl LinePulses {
    /// Combines the emissions of line `number` with those of `tail`, and updates `tail`.
    pub fn new(
        emissions: &[Emission],
        columns: Vec<i32>,
        number: u64,
        settings: &Settings,
        tail: &mut Tail,
    ) -> LinePulses {
        let reach_ps = 2e12 * settings.range_m[1] / settings.group_velocity_mps;
        let mut pulses = LinePulses::default();
        let first = emissions.first().map_or(0, |emission| emission.clock_ps);
        // After a clock reset, no earlier emission is comparable.
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

    /// Measures the interval and the deviations from it.
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

    /// Number of the line's own emissions.
    pub fn own(&self) -> usize {
        self.clock_ps.len() - self.lead
    }

    /// The line's own clocks, ps.
    pub(crate) fn own_clocks(&self) -> &[i64] {
        &self.clock_ps[self.lead..]
    }

    /// The emission at index `place`, counted from the first held.
    pub fn cause(&self, place: usize, line: u64) -> Cause {
        match place.checked_sub(self.lead) {
            Some(own) => Cause { line, emission: own as u32 },
            None => self.lead_causes[place],
        }
    }

    /// First line with emissions held, for line `line`.
    pub fn first_line(&self, line: u64) -> u64 {
        self.lead_causes.first().map_or(line, |cause| cause.line)
    }

    /// Index of the emission with a shot number, searched backwards from `near`.
    pub fn of_shot(&self, shot: Option<u64>, near: u32) -> Option<usize> {
        let shot = shot?;
        let near = (near as usize + 1).min(self.shot.len());
        let place = self.shot[..near].iter().rposition(|&number| number <= shot)?;
        (self.shot[place] == shot).then_some(place)
    }
}

impl Tail {
    fn follow(&mut self, pulses: &LinePulses, line: u64) {
        let from = pulses.clock_ps.len().saturating_sub(MOST_BEFORE);
        self.clock_ps = pulses.clock_ps[from..].to_vec();
        self.shot = pulses.shot[from..].to_vec();
        self.column = pulses.column[from..].to_vec();
        self.expected_m = pulses.expected_m.get(from..).unwrap_or_default().to_vec();
        self.causes = (from..pulses.clock_ps.len()).map(|place| pulses.cause(place, line)).collect();
        self.interval_ps = Some(pulses.interval_ps);
    }
}
