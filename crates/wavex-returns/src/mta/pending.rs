//! A pending scan line.

use super::held::{Held, HeldEcho};
use super::pulses::{CELL_SHOTS, LinePulses, Tail};
use super::summary::Summary;
use super::{Assigned, Line, Resolved, Settings};

/// Largest column number; larger ones are clamped.
const MOST_COLUMNS: f32 = 65_535.0;

/// Maps scan angles to columns; determined from the first line with four angles.
#[derive(Debug, Default)]
pub(super) struct Places {
    /// Angle of column 0 and angle per column, degrees.
    raster_deg: Option<(f32, f32)>,
    /// Angles are azimuths, which wrap at 360 degrees.
    is_cyclic: bool,
    /// Columns of a revolution; 0 for a sweep.
    ring: i32,
}

impl Places {
    pub fn new(is_cyclic: bool) -> Places {
        Places { is_cyclic, ..Places::default() }
    }

    fn columns(&mut self, line: &Line) -> Vec<i32> {
        let angles = || line.emissions.iter().map(|emission| emission.scan_angle_deg);
        if self.raster_deg.is_none() {
            let known: Vec<f32> = angles().filter(|angle| angle.is_finite()).collect();
            let mut steps: Vec<f32> = known.windows(2).map(|pair| (pair[1] - pair[0]).abs()).collect();
            let middle = steps.len() / 2;
            // A turn from the end of a sweep to the start of the next is not a step.
            if steps.len() >= 3 {
                let step = *steps.select_nth_unstable_by(middle, f32::total_cmp).1;
                let least = known.iter().copied().fold(f32::INFINITY, f32::min);
                self.raster_deg = (step > 0.0).then_some((least, step));
                if self.is_cyclic && step > 0.0 {
                    // A revolution has a whole number of cells.
                    let cells = (360.0 / step / CELL_SHOTS as f32)
                        .round()
                        .clamp(1.0, MOST_COLUMNS / CELL_SHOTS as f32);
                    self.ring = cells as i32 * CELL_SHOTS;
                    self.raster_deg = Some((0.0, 360.0 / self.ring as f32));
                }
            }
        }
        let column = |(index, angle): (i32, f32)| match self.raster_deg {
            Some((_, step)) if angle.is_finite() && self.ring > 0 => {
                ((angle / step) as i32).rem_euclid(self.ring)
            }
            Some((least, step)) if angle.is_finite() => {
                ((angle - least) / step).round().clamp(-MOST_COLUMNS, MOST_COLUMNS) as i32
            }
            _ => index.min(MOST_COLUMNS as i32),
        };
        (0..).zip(angles()).map(column).collect()
    }
}

/// The last emission before an echo.
#[derive(Debug, Clone, Copy)]
pub(super) struct LastEmission {
    pub shot: u64,
    /// Time since it, and until the next emission, ns.
    since_ns: f64,
    until_ns: f64,
}

impl Held {
    pub fn new(line: &Line, number: u64, settings: &Settings, places: &mut Places, tail: &mut Tail) -> Held {
        let pulses = LinePulses::new(&line.emissions, places.columns(line), number, settings, tail);
        let mut echoes: Vec<HeldEcho> = (0u32..)
            .zip(&line.echoes)
            .map(|(input, echo)| place(input, echo.emission as usize, echo.time_ns, &pulses, settings))
            .collect();
        let column = |echo: &HeldEcho| pulses.column[echo.last as usize];
        if !echoes.is_sorted_by(|a, b| (column(a), a.last, a.since_ns) <= (column(b), b.last, b.since_ns)) {
            echoes.sort_by(|a, b| {
                let places = (column(a), a.last).cmp(&(column(b), b.last));
                places.then(a.since_ns.total_cmp(&b.since_ns))
            });
        }
        Held { number, pulses, echoes, ring: places.ring, bytes: line.bytes }
    }

    /// Column in which an echo was received.
    pub fn column(&self, echo: &HeldEcho) -> i32 {
        self.pulses.column[echo.last as usize]
    }

    /// Range if the emission at `place` is the cause, m.
    pub fn range_m(&self, echo: &HeldEcho, place: usize, settings: &Settings) -> f32 {
        (self.flight_ns(echo, place) * 0.5e-9 * settings.group_velocity_mps) as f32
    }

    /// Time since the emission at `place`, ns.
    pub fn flight_ns(&self, echo: &HeldEcho, place: usize) -> f64 {
        let clocks = &self.pulses.clock_ps;
        echo.since_ns + clocks[echo.last as usize].saturating_sub(clocks[place]) as f64 * 1e-3
    }

    /// The last emission before an echo, possibly in the next line.
    pub(crate) fn last_emission(&self, echo: &HeldEcho, next: Option<&Held>) -> LastEmission {
        let (clocks, last) = (&self.pulses.clock_ps, echo.last as usize);
        let gap_ns = |from: i64, to: i64| to.saturating_sub(from) as f64 * 1e-3;
        let mut found =
            LastEmission { shot: self.pulses.shot[last], since_ns: echo.since_ns, until_ns: f64::INFINITY };
        if let Some(&after) = clocks.get(last + 1) {
            found.until_ns = gap_ns(clocks[last], after) - echo.since_ns;
            return found;
        }
        let Some(next) = next else { return found };
        let follows = next.pulses.own_clocks().first().is_some_and(|&first| first > clocks[last]);
        if follows {
            for (&clock, &shot) in next.pulses.own_clocks().iter().zip(&next.pulses.shot[next.pulses.lead..])
            {
                let since_ns = echo.since_ns - gap_ns(clocks[last], clock);
                if since_ns < 0.0 {
                    found.until_ns = -since_ns;
                    break;
                }
                (found.shot, found.since_ns) = (shot, since_ns);
            }
        }
        found
    }

    /// Assigns an echo to the emission at `cause`.
    pub fn assigned(
        &self,
        echo: &HeldEcho,
        cause: Option<usize>,
        margin_nats: f32,
        uncertain: bool,
        last: &LastEmission,
        settings: &Settings,
    ) -> Assigned {
        let zone = cause.map_or(0, |place| last.shot.saturating_sub(self.pulses.shot[place]));
        Assigned {
            cause: cause.map(|place| self.pulses.cause(place, self.number)),
            zone: zone.min(u64::from(u16::MAX)) as u16,
            flight_ns: cause.map_or(f64::NAN, |place| self.flight_ns(echo, place)),
            margin_nats,
            uncertain,
            in_blind_gap: last.since_ns.abs().min(last.until_ns) <= settings.blind_gap_ns,
        }
    }
}

/// Locates an echo `time_ns` after the line's emission `emission` among all emissions.
fn place(input: u32, emission: usize, time_ns: f64, pulses: &LinePulses, settings: &Settings) -> HeldEcho {
    let clocks = &pulses.clock_ps;
    let record = pulses.lead + emission;
    let since = |place: usize| time_ns - clocks[place].saturating_sub(clocks[record]) as f64 * 1e-3;
    let mut last = record;
    while last + 1 < clocks.len() && since(last + 1) >= 0.0 {
        last += 1;
    }
    while last > 0 && since(last) < 0.0 {
        last -= 1;
    }
    let since_ns = since(last);
    let range_m = (since_ns * 0.5e-9 * settings.group_velocity_mps) as f32;
    let even_m = range_m + pulses.offset_m[last];
    let mut echo = HeldEcho { since_ns, input, last: last as u32, base: last as i32, even_m, range_m };
    // After a line's last emission, zones are counted at even intervals.
    echo.count_from((range_m / pulses.interval_m).floor().clamp(0.0, 1e6) as i32, pulses.interval_m);
    echo
}

/// Builds a finished line; `assigned` holds echo indices, in any order.
pub(super) fn finish(
    line: &Held,
    assigned: impl Iterator<Item = (u32, Assigned)>,
    next: Option<&Held>,
    settings: &Settings,
    summary: &mut Summary,
) -> Resolved {
    let nothing = Assigned {
        cause: None,
        zone: 0,
        flight_ns: f64::NAN,
        margin_nats: 0.0,
        uncertain: true,
        in_blind_gap: false,
    };
    let mut echoes = vec![nothing; line.echoes.len()];
    for (input, one) in assigned {
        summary.add(&one, settings);
        if let Some(place) = echoes.get_mut(input as usize) {
            *place = one;
        }
    }
    let settled_lines = next.map_or(line.number + 1, |next| next.pulses.first_line(next.number));
    Resolved { line: line.number, echoes, settled_lines }
}
