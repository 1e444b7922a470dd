//! Multiple time around: which emission caused an echo, when several pulses are in the air.
//!
//! An echo received at time `T` may belong to any emission before it: emission `e` gives the range `c/2 (T − t_e)`. Lasers
//! whose pulse intervals vary make this decidable, because only the true assignment gives a smooth surface; all others carry
//! the known variation of the intervals. A constant pulse rate needs a [`Prior`]. docs/explanation/mta.md describes the methods and what
//! they reach.
//!
//! A [`Resolver`] takes scan lines and gives them back in order, each echo with its cause. It holds back at most
//! [`Resolver::look_ahead_lines`] lines. What comes out depends on the lines and the settings alone.

mod blocks;
mod cells;
mod grid;
mod held;
mod joined;
mod pulses;
mod summary;
#[cfg(test)]
mod tests;
mod variance;

use std::collections::VecDeque;

pub use blocks::LOOK_AHEAD_BYTES;
pub use cells::BAND_LINES;
pub use summary::{Summary, Warning};

use blocks::Blocks;
use held::{Held, Places};
use joined::Joined;
use variance::Variance;

/// One emission of a line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Emission {
    /// Time on the instrument's clock, ps. Ascending within a line.
    pub clock_ps: i64,
    /// Running number. Zones are differences of it: where numbers run on over lost records, zones count those, too.
    pub shot: u64,
    /// Place across the line (scan angle, or mirror angle), comparable between lines; NaN where unknown: then the emissions of
    /// all lines are taken to stand at the same places.
    pub scan_angle_deg: f32,
    /// Cosine of the angle between beam and vertical, for [`Prior::Agl`]; NaN where unknown.
    pub cos_nadir: f32,
    /// The range at which a shot emitted now meets the terrain, m, for [`Prior::PerEmission`]; NaN where unknown.
    pub prior_range_m: f32,
}

impl Default for Emission {
    /// An emission of which only the time will be known.
    fn default() -> Emission {
        Emission {
            clock_ps: 0,
            shot: 0,
            scan_angle_deg: f32::NAN,
            cos_nadir: f32::NAN,
            prior_range_m: f32::NAN,
        }
    }
}

/// One received echo.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Echo {
    /// Index, in the line, of the emission in whose record the echo lies.
    pub emission: u32,
    /// Time after that emission's clock, ns. May exceed the interval to the next emission.
    pub time_ns: f64,
}

/// A scan line: its emissions in order of time, and its echoes in any order.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Line {
    /// In ascending order of `clock_ps`.
    pub emissions: Vec<Emission>,
    /// What was received in this line's records.
    pub echoes: Vec<Echo>,
    /// What the caller keeps with the line until it is resolved, bytes: beyond [`LOOK_AHEAD_BYTES`] fewer lines are held
    /// back. It must follow from the data alone, because results depend on it.
    pub bytes: usize,
}

/// An emission that caused an echo.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cause {
    /// Number of the line, in the order they were pushed, from 0.
    pub line: u64,
    /// Index of the emission in that line.
    pub emission: u32,
}

/// An echo with its cause.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Assigned {
    /// The emission that caused it; `None` where no emission is at a feasible distance.
    pub cause: Option<Cause>,
    /// Emissions between cause and reception, from 0: the running number of the last emission before the echo less that of
    /// the cause. 0 without a cause.
    pub zone: u16,
    /// Time since the causing emission's clock, ns; NaN without a cause.
    pub flight_ns: f64,
    /// Evidence against the second best zone, nats (`Blocks`), or half the buffer's length times the logarithm of the ratio of
    /// variances (`Variance`). Infinite with a fixed zone.
    pub margin_nats: f32,
    /// The zone was decided against little evidence, or the echo lies far from the surface.
    pub uncertain: bool,
    /// Received within the blind gap around an emission: what scatters in the instrument may lie there, too.
    pub in_blind_gap: bool,
}

/// A finished line.
#[derive(Clone, Debug, PartialEq)]
pub struct Resolved {
    /// Number of the line, in the order they were pushed, from 0.
    pub line: u64,
    /// One for each echo, in the order of [`Line::echoes`].
    pub echoes: Vec<Assigned>,
    /// No line that is still to come has an echo caused by lines below this number: their pulses are complete.
    pub settled_lines: u64,
}

/// What is known of ranges beforehand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Prior {
    /// Nothing but [`Settings::range_m`].
    None,
    /// The height above flat ground: a shot's range is `agl_m / cos_nadir`.
    Agl {
        /// Height above ground, m.
        agl_m: f64,
        /// How far terrain departs from it, m.
        sd_m: f64,
    },
    /// [`Emission::prior_range_m`], from a terrain model or a trajectory.
    PerEmission {
        /// Standard deviation of terrain about it, m.
        sd_m: f64,
    },
}

/// How zones are found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// Evidence of blocks of neighbouring echoes, joined over the strip.
    Blocks,
    /// The least variance of consecutive ranges in a buffer of so many.
    Variance {
        /// Length of the buffer; 50 is usual.
        buffer: usize,
    },
    /// Always so many emissions back.
    Fixed(u16),
}

/// What a resolver is told.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// How zones are found.
    pub method: Method,
    /// What is known of ranges.
    pub prior: Prior,
    /// Least and greatest feasible range, m. At most 126 intervals between emissions are considered.
    pub range_m: [f64; 2],
    /// Speed of the pulse, m/s.
    pub group_velocity_mps: f64,
    /// Echoes so near to an emission are marked, ns.
    pub blind_gap_ns: f64,
    /// Scan angles are azimuths of a beam that turns on a cone: they grow with time and go on at 0 after 360 degrees. Lines
    /// are joined to revolutions.
    pub is_cyclic: bool,
}

impl Default for Settings {
    fn default() -> Settings {
        Settings {
            method: Method::Blocks,
            prior: Prior::None,
            range_m: [30.0, 5000.0],
            group_velocity_mps: 299_710_540.0,
            blind_gap_ns: 15.0,
            is_cyclic: false,
        }
    }
}

/// Why zones cannot be found.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MtaError {
    /// Settings that contradict themselves.
    #[error("{0}")]
    Settings(&'static str),
    /// An echo points beyond the line's emissions.
    #[error(
        "line {line}: echo {echo} lies in the record of emission {emission}, but the line has {emissions}"
    )]
    NoSuchEmission {
        /// The line's number.
        line: u64,
        /// The echo's index.
        echo: usize,
        /// The emission it points to.
        emission: u32,
        /// How many the line has.
        emissions: usize,
    },
    /// An echo's time is not a number or more than a second away from its emission.
    #[error("line {line}: echo {echo} has no usable time: {time_ns} ns after its emission")]
    EchoTime {
        /// The line's number.
        line: u64,
        /// The echo's index.
        echo: usize,
        /// The time.
        time_ns: f64,
    },
    /// The clock does not ascend within a line.
    #[error(
        "line {line}: the clock does not ascend at shot {shot}: {clock_ps} ps after {before_ps} ps; end the line there"
    )]
    ClockOrder {
        /// The line's number.
        line: u64,
        /// Running number of the shot.
        shot: u64,
        /// Its clock.
        clock_ps: i64,
        /// The clock of the emission before it.
        before_ps: i64,
    },
    /// All zones give equally smooth surfaces.
    #[error(
        "the pulse rate is constant: intervals of {interval_ns:.3} ns vary by {rms_ns:.3} ns rms, at least {least_ns} ns are needed \
         to tell one zone from another; give a prior (height above ground, terrain model, trajectory) or a fixed zone"
    )]
    ConstantRate {
        /// The usual interval.
        interval_ns: f64,
        /// How much intervals vary.
        rms_ns: f64,
        /// From when on zones can be told apart.
        least_ns: f64,
    },
    /// The clock is read early and late, but pulses leave at even intervals, or zones are wrong throughout.
    #[error(
        "intervals between pulses vary by {rms_ns:.3} ns rms on the clock, but ranges contain {:.0} % of that: zones cannot be decided; give a prior (height above ground, terrain model, trajectory) or a fixed zone",
        100.0 * following.max(0.0)
    )]
    JitteringClock {
        /// How much intervals vary on the clock.
        rms_ns: f64,
        /// The part of it that echoes follow.
        following: f64,
    },
}

/// Finds the cause of each echo, line by line.
#[derive(Debug)]
pub struct Resolver {
    settings: Settings,
    places: Places,
    method: State,
    lines: u64,
    joined: Joined,
    /// How many lines, those that are joined taken as one, the method was given.
    runs: u64,
    summary: Summary,
    /// What the method has finished, and that line by line.
    found: VecDeque<Resolved>,
    ready: VecDeque<Resolved>,
    /// The last line of all that were pushed, as far as later lines need it.
    tail: pulses::Tail,
}

#[derive(Debug)]
enum State {
    Blocks(Blocks),
    Variance(Variance),
    Fixed(u16, Option<Held>),
}

impl Resolver {
    /// A resolver, or why its settings contradict themselves.
    pub fn new(settings: &Settings) -> Result<Resolver, MtaError> {
        let [least, most] = settings.range_m;
        if !(least >= 0.0 && most > least && most.is_finite()) {
            return Err(MtaError::Settings("range_m: two ascending distances of at least 0 m are needed"));
        }
        if !(settings.group_velocity_mps > 1e8 && settings.group_velocity_mps < 3e8) {
            return Err(MtaError::Settings("group_velocity_mps: a speed of light is needed, m/s"));
        }
        if settings.blind_gap_ns.is_nan() || settings.blind_gap_ns < 0.0 {
            return Err(MtaError::Settings("blind_gap_ns: a time of at least 0 ns is needed"));
        }
        let positive = |value: f64| value > 0.0 && value.is_finite();
        match settings.prior {
            Prior::Agl { agl_m, sd_m } if !(positive(agl_m) && positive(sd_m)) => {
                return Err(MtaError::Settings("prior: height and standard deviation above 0 m are needed"));
            }
            Prior::PerEmission { sd_m } if !positive(sd_m) => {
                return Err(MtaError::Settings("prior: a standard deviation above 0 m is needed"));
            }
            _ => {}
        }
        let method = match settings.method {
            Method::Blocks => State::Blocks(Blocks::new(settings)),
            Method::Variance { buffer } if (4..=10_000).contains(&buffer) => {
                State::Variance(Variance::new(settings, buffer))
            }
            Method::Variance { .. } => {
                return Err(MtaError::Settings("buffer: from 4 to 10000 ranges are possible"));
            }
            Method::Fixed(zone) => State::Fixed(zone, None),
        };
        Ok(Resolver {
            settings: *settings,
            places: Places::new(settings.is_cyclic),
            method,
            lines: 0,
            joined: Joined::new(settings.is_cyclic),
            runs: 0,
            summary: Summary::default(),
            found: VecDeque::new(),
            ready: VecDeque::new(),
            tail: pulses::Tail::default(),
        })
    }

    /// So many lines at most are held back after a push, this one included: what a look-ahead costs is this times
    /// [`BYTES_PER_SHOT`] and [`BYTES_PER_ECHO`]. With the method `Variance` it is so many unless lines have fewer echoes than
    /// half a buffer. Lines shorter than a cell count as one while the beam sweeps on: then it grows with the most of them that
    /// have made one so far.
    pub fn look_ahead_lines(&self) -> usize {
        let lines = match &self.method {
            State::Blocks(_) => blocks::LOOK_AHEAD_LINES,
            State::Variance(variance) => variance.look_ahead_lines(),
            State::Fixed(..) => 1,
        };
        self.joined.held_back(lines)
    }

    /// Takes the next line; [`Resolver::pop`] has what is finished then. After an error the resolver is of no further use.
    pub fn push(&mut self, line: &Line) -> Result<(), MtaError> {
        check(line, self.lines)?;
        self.lines += 1;
        // Of a fixed zone neighbours have no say.
        let joins = !matches!(self.settings.method, Method::Fixed(_));
        for line in self.joined.push(line, joins) {
            self.give(&line)?;
        }
        self.tell();
        Ok(())
    }

    /// Gives the method a line that is long enough.
    fn give(&mut self, line: &Line) -> Result<(), MtaError> {
        let held = Held::new(line, self.runs, &self.settings, &mut self.places, &mut self.tail);
        self.runs += 1;
        self.summary.add_line(&held);
        match &mut self.method {
            State::Blocks(blocks) => blocks.push(held, &mut self.summary, &mut self.found),
            State::Variance(variance) => variance.push(held, &mut self.summary, &mut self.found),
            State::Fixed(zone, last) => {
                if let Some(done) = last.take() {
                    self.found.push_back(fixed(&done, *zone, Some(&held), &self.settings, &mut self.summary));
                }
                *last = Some(held);
                Ok(())
            }
        }
    }

    /// Makes lines of what the method has finished.
    fn tell(&mut self) {
        for found in self.found.drain(..) {
            self.joined.apart(found, &mut self.ready);
        }
    }

    /// The next finished line, in the order they were pushed.
    pub fn pop(&mut self) -> Option<Resolved> {
        self.ready.pop_front()
    }

    /// Says that no line follows: all lines are finished then.
    pub fn finish(&mut self) -> Result<(), MtaError> {
        if let Some(line) = self.joined.take() {
            self.give(&line)?;
        }
        match &mut self.method {
            State::Blocks(blocks) => blocks.finish(&mut self.summary, &mut self.found)?,
            State::Variance(variance) => variance.finish(&mut self.summary, &mut self.found)?,
            State::Fixed(zone, last) => {
                if let Some(done) = last.take() {
                    self.found.push_back(fixed(&done, *zone, None, &self.settings, &mut self.summary));
                }
            }
        }
        self.tell();
        Ok(())
    }

    /// What was found so far, over all finished lines.
    pub fn summary(&self) -> &Summary {
        &self.summary
    }

    /// What in the data speaks against trusting the zones.
    pub fn warnings(&self) -> Vec<Warning> {
        self.summary.warnings(&self.settings)
    }
}

/// What an emission takes while its line is held back, bytes, with what its vectors may have in reserve.
pub const BYTES_PER_SHOT: usize = 64;
/// What an echo takes while its line is held back, bytes, with what is found of it.
pub const BYTES_PER_ECHO: usize = 112;

/// A line whose echoes all come from so many emissions back.
fn fixed(
    line: &Held,
    zone: u16,
    next: Option<&Held>,
    settings: &Settings,
    summary: &mut Summary,
) -> Resolved {
    let assigned = line.echoes.iter().map(|echo| {
        let last = line.last_emission(echo, next);
        let cause = line.pulses.of_shot(last.shot.checked_sub(u64::from(zone)), echo.last);
        (echo.input, line.assigned(echo, cause, f32::INFINITY, cause.is_none(), &last, settings))
    });
    held::finish(line, assigned, next, settings, summary)
}

/// What a line must fulfil.
fn check(line: &Line, number: u64) -> Result<(), MtaError> {
    for pair in line.emissions.windows(2) {
        let (before, now) = (pair[0], pair[1]);
        if now.clock_ps <= before.clock_ps {
            return Err(MtaError::ClockOrder {
                line: number,
                shot: now.shot,
                clock_ps: now.clock_ps,
                before_ps: before.clock_ps,
            });
        }
    }
    for (i, echo) in line.echoes.iter().enumerate() {
        if echo.emission as usize >= line.emissions.len() {
            return Err(MtaError::NoSuchEmission {
                line: number,
                echo: i,
                emission: echo.emission,
                emissions: line.emissions.len(),
            });
        }
        if echo.time_ns.is_nan() || echo.time_ns.abs() > 1e9 {
            return Err(MtaError::EchoTime { line: number, echo: i, time_ns: echo.time_ns });
        }
    }
    Ok(())
}
