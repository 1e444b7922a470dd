//! Merges lines shorter than a cell while the sweep continues.
//!
//! A line of a few shots has no neighbours to compare its echoes with; the following line is the
//! next piece of the same sweep, not a neighbouring line. Such lines are passed to the method as
//! one, and the results are split again.

use std::collections::VecDeque;

use super::pulses::CELL_SHOTS;
use super::{Cause, Emission, Line, Resolved};

/// Lines with fewer emissions are merged with the following ones.
const SHORT_SHOTS: usize = CELL_SHOTS as usize;
/// Length of a merged line without known end of sweep, shots.
const SWEEP_SHOTS: usize = 256;
/// Largest length of a merged line, shots.
const MOST_SHOTS: usize = 4096;
/// The same for a revolution, shots.
const MOST_SHOTS_OF_RING: usize = 1 << 17;

/// Lines passed to the method as one.
#[derive(Debug, Default)]
struct Run {
    /// Number of the first of the lines, in the order of `push`.
    first: u64,
    /// For each line, the index of its first emission in the merged line, and its number of echoes.
    lines: Vec<(u32, usize)>,
}

impl Run {
    /// Line and emission at an index of the merged line.
    fn cause(&self, emission: u32) -> Option<Cause> {
        let line = self.lines.partition_point(|&(start, _)| start <= emission).checked_sub(1)?;
        Some(Cause { line: self.first + line as u64, emission: emission - self.lines[line].0 })
    }
}

/// Rotation of the beam over the emissions, degrees; steps with unknown azimuth count as 0.
fn turned_deg(emissions: &[Emission]) -> f32 {
    let steps = emissions.windows(2).map(|pair| pair[1].scan_angle_deg - pair[0].scan_angle_deg);
    steps.filter(|step| step.is_finite()).map(|step| step - 360.0 * (step / 360.0).round()).sum()
}

/// Merges lines and splits the results.
#[derive(Debug, Default)]
pub(super) struct Joined {
    /// Pending short lines, merged, until the end of their sweep.
    waiting: Line,
    run: Run,
    /// Merged lines that a result may still refer to.
    runs: VecDeque<Run>,
    /// Number of the first of these, as the method counts.
    first_run: u64,
    /// Number of lines pushed.
    lines: u64,
    /// Largest number of lines merged so far.
    most_lines: usize,
    /// Lines below this number cause no echo of a later line.
    settled: u64,
    /// Angles are azimuths: lines are merged up to a revolution.
    is_cyclic: bool,
    /// Rotation of the beam over the pending lines, degrees.
    turned_deg: f32,
}

impl Joined {
    pub fn new(is_cyclic: bool) -> Joined {
        Joined { is_cyclic, ..Joined::default() }
    }

    /// Largest number of lines held back if the method holds back `lines`.
    pub(crate) fn held_back(&self, lines: usize) -> usize {
        match self.most_lines.max(self.run.lines.len()) {
            0 | 1 => lines,
            // The pending lines are added.
            most => (lines + 1) * most,
        }
    }

    /// Adds a line; returns those ready for the method. `joins`: short lines are merged.
    pub fn push(&mut self, line: &Line, joins: bool) -> impl Iterator<Item = Line> + use<> {
        // A line without shots is kept only together with others.
        let least = usize::from(self.run.lines.is_empty());
        let is_short =
            joins && (self.is_cyclic || line.emissions.len() < SHORT_SHOTS) && line.emissions.len() >= least;
        let before = (!is_short || !self.goes_on(line)).then(|| self.take()).flatten();
        self.append(line);
        let whole = is_short && self.is_cyclic && self.is_revolution();
        let own = if is_short && !whole { None } else { self.take() };
        before.into_iter().chain(own)
    }

    /// Takes the pending merged line, if any.
    pub fn take(&mut self) -> Option<Line> {
        self.turned_deg = 0.0;
        let run = std::mem::take(&mut self.run);
        if run.lines.is_empty() {
            return None;
        }
        self.most_lines = self.most_lines.max(run.lines.len());
        self.runs.push_back(run);
        Some(std::mem::take(&mut self.waiting))
    }

    /// Whether a line continues the pending ones in time and angle.
    fn goes_on(&self, line: &Line) -> bool {
        let shots = &self.waiting.emissions;
        let (Some(last), Some(next)) = (shots.last(), line.emissions.first()) else { return true };
        let shots_of_both = shots.len() + line.emissions.len();
        if self.is_cyclic {
            return next.clock_ps > last.clock_ps && shots_of_both <= MOST_SHOTS_OF_RING;
        }
        let sweep_deg = last.scan_angle_deg - shots[0].scan_angle_deg;
        let ahead_deg = next.scan_angle_deg - last.scan_angle_deg;
        // NaN, if angles are unknown, is no turn.
        let turns = sweep_deg * ahead_deg < 0.0;
        let most = if ahead_deg.is_nan() { SWEEP_SHOTS } else { MOST_SHOTS };
        next.clock_ps > last.clock_ps && !turns && shots_of_both <= most
    }

    /// Whether the pending lines form a revolution, to half a line.
    fn is_revolution(&self) -> bool {
        let share = 0.5 / self.run.lines.len().max(1) as f32;
        self.turned_deg * (1.0 + share) >= 360.0
    }

    fn append(&mut self, line: &Line) {
        let start = self.waiting.emissions.len() as u32;
        if self.run.lines.is_empty() {
            self.run.first = self.lines;
        }
        self.lines += 1;
        self.run.lines.push((start, line.echoes.len()));
        self.waiting.bytes += line.bytes;
        self.waiting.emissions.extend_from_slice(&line.emissions);
        let joint = self.waiting.emissions.len().saturating_sub(line.emissions.len() + 1);
        self.turned_deg += turned_deg(&self.waiting.emissions[joint..]);
        let moved = |echo: &super::Echo| super::Echo { emission: echo.emission + start, ..*echo };
        self.waiting.echoes.extend(line.echoes.iter().map(moved));
    }

    /// Splits the result of a merged line into its lines.
    pub fn apart(&mut self, found: Resolved, into: &mut VecDeque<Resolved>) {
        let at = |number: u64| number.checked_sub(self.first_run).map(|at| at as usize);
        let run_at = |number: u64| self.runs.get(at(number)?);
        let Some(run) = run_at(found.line) else { return };
        let begins = |number: u64| run_at(number).map(|run| run.first);
        let behind = run.first + run.lines.len() as u64;
        let before = self.settled;
        self.settled = begins(found.settled_lines).unwrap_or(behind);
        let mut echoes = found.echoes.into_iter().map(|mut echo| {
            echo.cause = echo.cause.and_then(|cause| run_at(cause.line)?.cause(cause.emission));
            echo
        });
        for (line, &(_, count)) in (run.first..).zip(&run.lines) {
            // Lines settled by the merged line are settled after the last of its lines.
            let settled_lines = if line + 1 == behind { self.settled } else { before };
            into.push_back(Resolved { line, echoes: echoes.by_ref().take(count).collect(), settled_lines });
        }
        drop(echoes);
        while self.first_run < found.settled_lines.min(found.line + 1) && !self.runs.is_empty() {
            self.runs.pop_front();
            self.first_run += 1;
        }
    }
}
