//! Detection: local maxima of the matched filter, and selection of pulse candidates.

use std::ops::Range;

use wavex_simd::Simd;

use super::columns::Columns;
use super::pulse_model::MAX_PULSES;
use crate::decompose::acceptance::TAIL_START_WIDTHS;
use crate::detect::DIP_PART;

/// Maximum number of candidates per waveform; waveforms with more go to the scalar kernels.
const MAX_CANDIDATES: usize = MAX_PULSES;

/// A local maximum of the matched filter.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct FilterPeak {
    /// Vertex of the parabola through the maximum and its neighbours, samples from the block's
    /// first.
    pub position_samples: f32,
    /// Statistic at the sample of the maximum, in standard deviations of its noise.
    pub statistic: f32,
}

/// The candidates of one waveform.
#[derive(Clone, Copy)]
pub(super) struct Candidates {
    all: [FilterPeak; MAX_CANDIDATES],
    count: usize,
    /// Number of candidates found, including those screened out later.
    pub(super) found: usize,
    /// Whether more were found than fit.
    pub(super) too_many: bool,
    /// Lowest and highest sample of the block.
    pub(super) extremes: [u16; 2],
}

impl FilterPeak {
    /// Interpolates the maximum of a lane at a position.
    #[inline(always)]
    fn at(columns: &Columns, lane: usize, position: usize) -> FilterPeak {
        let [left, centre, right] = columns.around(lane, position);
        let bend = left - 2.0 * centre + right;
        let shift = if bend < 0.0 { (0.5 * (left - right) / bend).clamp(-0.5, 0.5) } else { 0.0 };
        FilterPeak { position_samples: position as f32 + shift, statistic: centre }
    }
}

impl Default for Candidates {
    fn default() -> Candidates {
        Candidates::none()
    }
}

impl Candidates {
    const fn none() -> Candidates {
        let all = [FilterPeak { position_samples: 0.0, statistic: 0.0 }; MAX_CANDIDATES];
        Candidates { all, count: 0, found: 0, too_many: false, extremes: [u16::MAX, 0] }
    }

    pub(super) fn as_slice(&self) -> &[FilterPeak] {
        &self.all[..self.count]
    }

    /// Finds the maxima of a lane from left to right.
    ///
    /// Maxima without a dip between them are merged.
    #[inline(always)]
    pub(super) fn find<S: Simd>(&mut self, s: S, columns: &Columns, lane: usize, threshold: f32) {
        (self.count, self.found, self.too_many) = (0, 0, false);
        let depth = DIP_PART as f32 * threshold;
        let mut last = 0;
        for (from, mut bits) in columns.maxima(s, lane) {
            while bits != 0 {
                let at = from + bits.trailing_zeros() as usize;
                bits &= bits - 1;
                let candidate = FilterPeak::at(columns, lane, at);
                match self.all[..self.count].last_mut() {
                    Some(before) if !dips(columns, lane, last..at, depth) => {
                        if candidate.statistic > before.statistic {
                            *before = candidate;
                            last = at;
                        }
                        continue;
                    }
                    _ => last = at,
                }
                match self.all.get_mut(self.count) {
                    Some(place) => *place = candidate,
                    None => {
                        self.too_many = true;
                        return;
                    }
                }
                self.count += 1;
            }
        }
        self.found = self.count;
    }

    /// Drops candidates below a threshold.
    ///
    /// Keeps the last one if others reach the threshold, because the last return may have its own
    /// threshold. Candidates must be in order of position.
    pub(super) fn drop_weak(&mut self, threshold: f32) {
        let last = self.count.saturating_sub(1);
        let others = self.all[..last].iter().any(|c| c.statistic >= threshold);
        let mut kept = 0;
        for i in 0..self.count {
            if self.all[i].statistic >= threshold || (i == last && others) {
                self.all[kept] = self.all[i];
                kept += 1;
            }
        }
        (self.count, self.found) = (kept, kept);
    }

    /// Drops candidates explained by the filter response of stronger ones.
    ///
    /// `per_dn` is the statistic of a pulse of height 1 DN. Candidates must be in order of
    /// position.
    #[inline(always)]
    pub(super) fn screen(&mut self, threshold: f32, left: &LeftBehind, per_dn: f32) {
        if self.count < 2 {
            return;
        }
        let statistics = self.as_slice().iter().map(|c| c.statistic);
        let weakest = statistics.clone().fold(f32::INFINITY, f32::min);
        let others = statistics.sum::<f32>() - weakest;
        // Cheap bound: usually even the weakest exceeds the threshold by more than all others can leave.
        if weakest - others / per_dn * left.most < threshold {
            self.screen_each(threshold, left, per_dn);
        }
    }

    fn screen_each(&mut self, threshold: f32, left: &LeftBehind, per_dn: f32) {
        self.sort_by_strength();
        let mut kept = 0;
        for i in 0..self.count {
            let candidate = self.all[i];
            let stronger = self.all[..kept].iter();
            let left: f32 = stronger
                .map(|s| s.statistic / per_dn * left.at(candidate.position_samples - s.position_samples))
                .sum();
            if candidate.statistic - left >= threshold {
                self.all[kept] = candidate;
                kept += 1;
            }
        }
        self.count = kept;
        self.sort_by_position();
    }

    /// Keeps the strongest `most` candidates, in order of position.
    #[inline(always)]
    pub(super) fn keep_strongest(&mut self, most: usize) {
        if self.count > most {
            self.sort_by_strength();
            self.count = most;
            self.sort_by_position();
        }
    }

    fn sort_by_strength(&mut self) {
        self.all[..self.count].sort_unstable_by(|a, b| b.statistic.total_cmp(&a.statistic));
    }

    fn sort_by_position(&mut self) {
        self.all[..self.count].sort_unstable_by(|a, b| a.position_samples.total_cmp(&b.position_samples));
    }
}

/// Filter response after a pulse of height 1 DN: the statistic by lag.
#[derive(Clone)]
pub(super) struct LeftBehind {
    /// By whole samples after the peak.
    echo: Vec<f32>,
    /// Lag from which it counts, samples; closer candidates are distinguished by their own maximum.
    from_samples: f32,
    /// Maximum from that lag on.
    most: f32,
}

impl LeftBehind {
    /// Creates it from the statistic by whole samples after the peak.
    pub(super) fn new(echo: Vec<f32>, fwhm_samples: f64) -> LeftBehind {
        let from_samples = TAIL_START_WIDTHS as f32 * fwhm_samples as f32;
        let behind = echo.get(from_samples as usize..).unwrap_or_default();
        let most = behind.iter().copied().fold(0.0, f32::max);
        LeftBehind { echo, from_samples, most }
    }

    fn at(&self, lag_samples: f32) -> f32 {
        if lag_samples <= self.from_samples {
            return 0.0;
        }
        let at = |k: usize| self.echo.get(k).copied().unwrap_or(0.0);
        let (k, part) = (lag_samples as usize, lag_samples.fract());
        (1.0 - part) * at(k) + part * at(k + 1)
    }
}

/// Whether the statistic between two maxima falls `depth` below the lower one.
#[inline(always)]
fn dips(columns: &Columns, lane: usize, maxima: Range<usize>, depth: f32) -> bool {
    let at = |position| columns.statistic(lane, position);
    let least = at(maxima.start).min(at(maxima.end)) - depth;
    // Checks the middle first, because it usually decides.
    let middle = maxima.start.midpoint(maxima.end);
    at(middle) <= least || maxima.rev().any(|position| at(position) <= least)
}
