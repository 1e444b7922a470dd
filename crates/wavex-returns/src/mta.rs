//! Multiple time around (MTA): assigns echoes to pulses when several are in the air.
//!
//! An echo received at time `T` may belong to any earlier emission: emission `e` gives the range
//! `c/2 (T − t_e)`. If the pulse intervals vary, only the true assignment gives a smooth surface;
//! every other one carries the known variation of the intervals. A constant pulse rate requires a
//! [`Prior`]. docs/explanation/mta.md describes the methods and their accuracy.
//!
//! A [`Resolver`] accepts scan lines and returns them in order, each echo with its cause. It holds
//! back at most [`Resolver::look_ahead_lines`] lines. The output depends only on the lines and the
//! settings.

mod blocks;
mod cells;
mod error;
mod grid;
mod held;
mod joined;
mod pending;
mod pulses;
mod settings;
mod summary;
#[cfg(test)]
mod tests;
mod variance;

use std::collections::VecDeque;

pub use blocks::LOOK_AHEAD_BYTES;
pub use cells::BAND_LINES;
pub use summary::{Summary, Warning};

use blocks::Blocks;
pub use error::MtaError;
pub use settings::{Method, Prior, Settings};

use held::Held;
use joined::Joined;
use pending::Places;
use variance::Variance;

/// One emission of a scan line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Emission {
    /// Time on the instrument's clock, ps. Ascends within a line.
    pub clock_ps: i64,
    /// Shot number. Zones are differences of shot numbers: if numbering continues over lost records,
    /// zones count those too.
    pub shot: u64,
    /// Position across the line (scan angle or mirror angle), comparable between lines. If NaN, all
    /// lines are assumed to have their emissions at the same positions.
    pub scan_angle_deg: f32,
    /// Cosine of the angle between beam and vertical, for [`Prior::Agl`]; NaN if unknown.
    pub cos_nadir: f32,
    /// Expected range of this shot to the terrain, m, for [`Prior::PerEmission`]; NaN if unknown.
    pub prior_range_m: f32,
}

impl Default for Emission {
    /// An emission with all values unknown.
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
    /// Index in the line of the emission whose record contains the echo.
    pub emission: u32,
    /// Time after that emission's clock, ns. May exceed the interval to the next emission.
    pub time_ns: f64,
}

/// A scan line: emissions in time order, and echoes in any order.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Line {
    /// In ascending order of `clock_ps`.
    pub emissions: Vec<Emission>,
    /// Echoes received in the records of this line.
    pub echoes: Vec<Echo>,
    /// Memory that the caller holds for this line until it is resolved, bytes.
    ///
    /// Above [`LOOK_AHEAD_BYTES`] fewer lines are held back. The value must depend on the data
    /// alone, because results depend on it.
    pub bytes: usize,
}

/// The emission that caused an echo.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cause {
    /// Number of the line in the order of `push`, from 0.
    pub line: u64,
    /// Index of the emission in that line.
    pub emission: u32,
}

/// An echo with its cause.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Assigned {
    /// The emission that caused it; `None` if no emission gives a feasible range.
    pub cause: Option<Cause>,
    /// MTA zone: number of emissions between cause and reception, from 0. It is the number of the
    /// last shot before the echo minus that of the cause. 0 without a cause.
    pub zone: u16,
    /// Time since the causing emission's clock, ns; NaN without a cause.
    pub flight_ns: f64,
    /// Evidence against the second-best zone, nats.
    ///
    /// For `Variance` it is half the buffer length times the logarithm of the variance ratio.
    /// Infinite for a fixed zone.
    pub margin_nats: f32,
    /// The evidence for the zone is weak, or the echo is far from the surface.
    pub uncertain: bool,
    /// Received within the blind gap around an emission, where internal scatter may appear too.
    pub in_blind_gap: bool,
}

/// A finished line.
#[derive(Clone, Debug, PartialEq)]
pub struct Resolved {
    /// Number of the line in the order of `push`, from 0.
    pub line: u64,
    /// One entry per echo, in the order of [`Line::echoes`].
    pub echoes: Vec<Assigned>,
    /// Lines below this number cause no echo of a later line: their pulses are complete.
    pub settled_lines: u64,
}

/// Assigns each echo to an emission, line by line.
///
/// ```
/// use wavex_returns::mta::{Echo, Emission, Line, Method, Resolver, Settings};
///
/// // A shot every microsecond, each echo after 2.4 µs: 2 shots later.
/// let emissions = (0..50).map(|i| Emission { clock_ps: 1_000_000 * i, shot: i as u64, ..Emission::default() });
/// let echoes = (2..50).map(|emission| Echo { emission, time_ns: 400.0 });
/// let line = Line { emissions: emissions.collect(), echoes: echoes.collect(), bytes: 0 };
///
/// let mut resolver = Resolver::new(&Settings { method: Method::Fixed(2), ..Settings::default() })?;
/// resolver.push(&line)?;
/// resolver.finish()?;
/// let resolved = resolver.pop().expect("a line was pushed");
/// assert!(resolved.echoes.iter().all(|echo| echo.zone == 2 && (echo.flight_ns - 2400.0).abs() < 1e-6));
/// # Ok::<(), wavex_returns::mta::MtaError>(())
/// ```
#[derive(Debug)]
pub struct Resolver {
    settings: Settings,
    places: Places,
    method: State,
    lines: u64,
    joined: Joined,
    /// Number of (merged) lines passed to the method.
    runs: u64,
    summary: Summary,
    /// Results of the method for merged lines, then split into the original lines.
    found: VecDeque<Resolved>,
    ready: VecDeque<Resolved>,
    /// Last emissions of the lines pushed so far, needed by later lines.
    tail: pulses::Tail,
}

#[derive(Debug)]
enum State {
    Blocks(Blocks),
    Variance(Variance),
    Fixed(u16, Option<Held>),
}

impl Resolver {
    /// Creates a resolver; fails on contradictory settings.
    pub fn new(settings: &Settings) -> Result<Resolver, MtaError> {
        let [least, most] = settings.range_m;
        if !(least >= 0.0 && most > least && most.is_finite()) {
            return Err(MtaError::Settings("range_m: must be two ascending distances of at least 0 m"));
        }
        if !(settings.group_velocity_mps > 1e8 && settings.group_velocity_mps < 3e8) {
            return Err(MtaError::Settings("group_velocity_mps: must be between 1e8 and 3e8 m/s"));
        }
        if settings.blind_gap_ns.is_nan() || settings.blind_gap_ns < 0.0 {
            return Err(MtaError::Settings("blind_gap_ns: must be at least 0 ns"));
        }
        let positive = |value: f64| value > 0.0 && value.is_finite();
        match settings.prior {
            Prior::Agl { agl_m, sd_m } if !(positive(agl_m) && positive(sd_m)) => {
                return Err(MtaError::Settings("prior: height and standard deviation must be above 0 m"));
            }
            Prior::PerEmission { sd_m } if !positive(sd_m) => {
                return Err(MtaError::Settings("prior: standard deviation must be above 0 m"));
            }
            _ => {}
        }
        let method = match settings.method {
            Method::Blocks => State::Blocks(Blocks::new(settings)),
            Method::Variance { buffer } if (4..=10_000).contains(&buffer) => {
                State::Variance(Variance::new(settings, buffer))
            }
            Method::Variance { .. } => {
                return Err(MtaError::Settings("buffer: must be 4 to 10000 ranges"));
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

    /// Largest number of lines held back after a push, the pushed line included.
    ///
    /// Memory is this times [`BYTES_PER_SHOT`] and [`BYTES_PER_ECHO`] per line. `Variance` reaches
    /// the bound only if lines have fewer echoes than half the buffer. Lines shorter than a cell
    /// are merged within a sweep; the bound then grows with the largest number of lines merged so
    /// far.
    pub fn look_ahead_lines(&self) -> usize {
        let lines = match &self.method {
            State::Blocks(_) => blocks::LOOK_AHEAD_LINES,
            State::Variance(variance) => variance.look_ahead_lines(),
            State::Fixed(..) => 1,
        };
        self.joined.held_back(lines)
    }

    /// Adds the next line; finished lines are returned by [`Resolver::pop`].
    ///
    /// After an error the resolver must not be used further.
    pub fn push(&mut self, line: &Line) -> Result<(), MtaError> {
        check(line, self.lines)?;
        self.lines += 1;
        // A fixed zone does not depend on neighbours.
        let joins = !matches!(self.settings.method, Method::Fixed(_));
        for line in self.joined.push(line, joins) {
            self.give(&line)?;
        }
        self.tell();
        Ok(())
    }

    /// Passes a sufficiently long line to the method.
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

    /// Splits the results of the method into the original lines.
    fn tell(&mut self) {
        for found in self.found.drain(..) {
            self.joined.apart(found, &mut self.ready);
        }
    }

    /// Returns the next finished line, in the order of `push`.
    pub fn pop(&mut self) -> Option<Resolved> {
        self.ready.pop_front()
    }

    /// Signals the end of the input and finishes all lines.
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

    /// Statistics of all finished lines.
    pub fn summary(&self) -> &Summary {
        &self.summary
    }

    /// Reasons in the data to distrust the zones.
    pub fn warnings(&self) -> Vec<Warning> {
        self.summary.warnings(&self.settings)
    }
}

/// Memory per emission of a pending line, bytes, including spare capacity of vectors.
pub const BYTES_PER_SHOT: usize = 64;
/// Memory per echo of a pending line, bytes, including its result.
pub const BYTES_PER_ECHO: usize = 112;

/// Assigns all echoes of a line to the same zone.
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
    pending::finish(line, assigned, next, settings, summary)
}

/// Checks the preconditions of a line.
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
