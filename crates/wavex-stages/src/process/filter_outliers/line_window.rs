//! Line window: a line is classified once enough later lines are held.

use std::collections::VecDeque;
use std::ops::Range;

use super::FilterOutliers;
use super::geometry::{AssumedMotion, ReturnPositions, dot, has_vertical};
use wavex_line::scan_line::{Content, ScanLine};
use wavex_line::stage::{Output, Reason, Result};
use wavex_returns::outliers::{PointLine, Side, SupportSearch, jump};

/// Number of lines on each side used to classify a line.
const LINES_APART: usize = 16;
/// Number of other returns that a supported return must reach.
const OTHERS: usize = 3;
/// Minimum step length, as a multiple of the shot or line spacing.
const SPACINGS: f64 = 2.5;
/// LAS 1.4 classes of low and of high noise.
const LOW_NOISE: u8 = 7;
const HIGH_NOISE: u8 = 18;

/// Pending lines, and emitted lines still needed for others.
pub(super) struct OutlierWindow {
    config: FilterOutliers,
    motion: AssumedMotion,
    lines: VecDeque<OutlierLine>,
    /// Index of the first line in `lines` not yet classified.
    next: usize,
    bytes: usize,
    search: SupportSearch,
}

/// A line; its line is taken when it is emitted.
struct OutlierLine {
    scan_line: Option<ScanLine>,
    places: ReturnPositions,
    bytes: usize,
}

/// Classification of a line's returns.
#[derive(Default)]
struct Verdicts {
    /// Unsupported returns.
    outliers: Vec<bool>,
    /// Returns whose waveform is rejected.
    rejected: Vec<bool>,
    /// Side on which the outliers lie.
    sides: Vec<Option<Side>>,
}

impl OutlierWindow {
    pub(super) fn new(config: FilterOutliers) -> OutlierWindow {
        OutlierWindow {
            config,
            motion: AssumedMotion::default(),
            lines: VecDeque::new(),
            next: 0,
            bytes: 0,
            search: SupportSearch::default(),
        }
    }

    /// Adds the next line and emits those that can be classified.
    pub(super) fn push(&mut self, scan_line: ScanLine, out: &mut Output) -> Result<()> {
        if !has_vertical(scan_line.input.frame) {
            out.cx.info("without a trajectory, outliers are detected as if the sensor moved straight on by half a shot spacing per line");
        }
        let places = ReturnPositions::of(&scan_line, &mut self.motion);
        let bytes = scan_line.bytes() + places.bytes();
        self.bytes += bytes;
        self.lines.push_back(OutlierLine { scan_line: Some(scan_line), places, bytes });
        while self.lines.len() - self.next > LINES_APART {
            self.judge_next(out)?;
        }
        while self.bytes > out.may_hold_bytes() && !self.lines.is_empty() {
            out.cx.warn(
                "outliers are detected with fewer neighbouring lines than wanted: more do not fit into memory_mb",
            );
            // Keep as many lines before as after.
            match self.next > self.lines.len() - self.next {
                true => self.forget_first(),
                false => self.judge_next(out)?,
            }
        }
        Ok(())
    }

    /// Classifies the remaining lines.
    pub(super) fn finish(&mut self, out: &mut Output) -> Result<()> {
        while self.next < self.lines.len() {
            self.judge_next(out)?;
        }
        Ok(())
    }

    /// Classifies a line and emits it.
    fn judge_next(&mut self, out: &mut Output) -> Result<()> {
        let at = self.next;
        self.next += 1;
        let verdicts = self.verdicts(at);
        let Some(held) = self.lines.get_mut(at) else { return Ok(()) };
        let Some(mut scan_line) = held.scan_line.take() else { return Ok(()) };
        let left = held.places.bytes();
        self.bytes = self.bytes - held.bytes + left;
        held.bytes = left;
        if self.next > LINES_APART {
            self.forget_first();
        }
        apply(&mut scan_line, &verdicts, &self.config, out);
        out.emit(scan_line)
    }

    /// Drops the first line, which has been classified.
    fn forget_first(&mut self) {
        let gone = self.lines.pop_front().map_or(0, |gone| gone.bytes);
        self.bytes -= gone;
        self.next -= 1;
    }

    /// Classifies the returns of a line.
    fn verdicts(&mut self, at: usize) -> Verdicts {
        let Some(held) = self.lines.get(at) else { return Verdicts::default() };
        let from = at.saturating_sub(LINES_APART);
        let until = (at + LINES_APART + 1).min(self.lines.len());
        let lines: Vec<&PointLine> = self.lines.range(from..until).map(|held| &held.places.line).collect();
        let line_spacing_m = self.line_spacing_m(at);
        let places = &held.places;
        let n = places.line.points().len();
        let mut outliers = Vec::with_capacity(n);
        for (point, &spacing_m) in places.spacing_m.iter().enumerate() {
            let step_m = self.config.max_range_m.max(SPACINGS * line_spacing_m.max(f64::from(spacing_m)));
            outliers.push(!self.search.is_supported(&lines, at - from, point, step_m, OTHERS));
        }
        let mut verdicts = Verdicts { outliers, rejected: vec![false; n], sides: vec![None; n] };
        find_sides(places, &mut verdicts);
        if self.config.waves {
            reject_jumps(places, &mut verdicts, &self.config);
        }
        verdicts
    }

    /// Distance to the nearer neighbouring line, m; 0 without one.
    fn line_spacing_m(&self, at: usize) -> f64 {
        let middle_m = |at: usize| self.lines.get(at)?.places.middle_m;
        let apart = |a: Option<usize>| {
            let (a, b) = (middle_m(a?)?, middle_m(at)?);
            let step: [f64; 3] = std::array::from_fn(|axis| b[axis] - a[axis]);
            Some(dot(step, step).sqrt())
        };
        let (before, behind) = (apart(at.checked_sub(1)), apart(Some(at + 1)));
        before.into_iter().chain(behind).min_by(f64::total_cmp).unwrap_or(0.0)
    }
}

/// Determines whether each outlier lies above or below the line.
///
/// The level is the mean height of the nearest supported returns before and after it.
fn find_sides(places: &ReturnPositions, verdicts: &mut Verdicts) {
    let heights = &places.height_m;
    let mut before = vec![f64::NAN; heights.len()];
    let mut last = f64::NAN;
    for (i, height) in heights.iter().enumerate() {
        if !verdicts.outliers[i] {
            last = *height;
        }
        before[i] = last;
    }
    let mut behind = f64::NAN;
    for (i, &height) in heights.iter().enumerate().rev() {
        if !verdicts.outliers[i] {
            behind = height;
            continue;
        }
        let level = match (before[i].is_nan(), behind.is_nan()) {
            (false, false) => 0.5 * (before[i] + behind),
            (true, _) => behind,
            (_, true) => before[i],
        };
        verdicts.sides[i] = Some(if height < level { Side::Low } else { Side::Air });
    }
}

/// Rejects waveforms that consist of outliers and jump from their neighbours.
fn reject_jumps(places: &ReturnPositions, verdicts: &mut Verdicts, config: &FilterOutliers) {
    let mut waves: Vec<Range<usize>> = Vec::new();
    for of_wave in places.line.points().chunk_by(|a, b| a.waveform == b.waveform) {
        let from = waves.last().map_or(0, |last| last.end);
        waves.push(from..from + of_wave.len());
    }
    let min_angle_rad = config.min_angle_deg.to_radians();
    for three in waves.windows(3) {
        let [before, wave, behind] = three else { continue };
        if !verdicts.outliers[wave.clone()].iter().all(|outlier| *outlier) {
            continue;
        }
        let extent = |wave: &Range<usize>| places.extent(wave.clone());
        let (Some(before), Some(it), Some(behind)) = (extent(before), extent(wave), extent(behind)) else {
            continue;
        };
        if let Some(side) = jump(&before, &it, &behind, config.max_height_m, min_angle_rad) {
            verdicts.rejected[wave.clone()].fill(true);
            verdicts.sides[wave.clone()].fill(Some(side));
        }
    }
}

/// Rejects and marks the returns of a line, and counts them.
fn apply(scan_line: &mut ScanLine, verdicts: &Verdicts, config: &FilterOutliers, out: &mut Output) {
    let stats = &mut scan_line.stats;
    let Content::Returns(returns) = &mut scan_line.content else { return };
    let is_out = |index: usize| verdicts.rejected[index] || (config.points && verdicts.outliers[index]);
    for (index, r) in returns.iter_mut().enumerate().filter(|(index, _)| is_out(*index)) {
        let (count, class) = match verdicts.sides[index] {
            Some(Side::Low) => (&mut stats.np_low, LOW_NOISE),
            _ => (&mut stats.np_air, HIGH_NOISE),
        };
        *count += 1;
        (r.withheld, r.class) = (true, class);
    }
    let reason = Reason::DeviatingWaveform;
    let n = scan_line.remove_returns(&verdicts.rejected, reason);
    out.cx.reject(reason, n);
}
