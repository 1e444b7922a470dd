//! Detection of sixteen waveforms at a time, from samples to initial pulse models.

use wavex_simd::{Kernel, LANES, Simd};

use super::candidates::Candidates;
use super::columns::Columns;
use super::pulse_model::{MAX_PULSES, PulseComponent, PulseCounts, PulseModel};
use super::rows::{BATCH, Rows};
use super::tables::Tables;
use super::thresholds::Thresholds;
use crate::decompose::DecomposeSettings;
use crate::decompose::Waveform;

/// Loads and filters blocks and finds the candidates of each.
pub(super) struct Detect<'a> {
    pub(super) tables: &'a Tables,
    pub(super) columns: &'a mut Columns,
    pub(super) blocks: &'a [Waveform<'a>],
    pub(super) threshold: f32,
    pub(super) out: &'a mut Vec<Candidates>,
}

impl Kernel for Detect<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let Detect { tables, columns, threshold, out, .. } = self;
        // In place: reading a value as a whole right after writing it by parts is slow.
        out.resize_with(self.blocks.len(), Candidates::default);
        let groups = self.blocks.chunks(LANES).zip(out.chunks_mut(LANES));
        for (group, (blocks, out)) in groups.enumerate() {
            fetch(s, self.blocks, group + 1);
            let extremes = load(s, tables, columns, blocks);
            detect(s, tables, columns, extremes, threshold, out);
        }
    }
}

/// Prefetches the samples of the next group, which are read once, in sequence.
#[inline(always)]
fn fetch<S: Simd>(s: S, blocks: &[Waveform<'_>], group: usize) {
    for block in blocks.iter().skip(group * LANES).take(LANES) {
        s.fetch(block.samples);
    }
}

/// Loads up to sixteen blocks; returns the lowest and highest sample of each.
///
/// Also estimates the level of each block if waveforms have their own background.
#[inline(always)]
fn load<S: Simd>(s: S, tables: &Tables, columns: &mut Columns, blocks: &[Waveform<'_>]) -> [[u16; 2]; LANES] {
    let mut samples: [&[u16]; LANES] = [&[]; LANES];
    for (samples, block) in samples.iter_mut().zip(blocks) {
        *samples = block.samples;
    }
    let extremes = columns.load(s, &samples[..blocks.len()]);
    if let Some(level) = &tables.level {
        columns.estimate_levels(s, tables, level);
    }
    extremes
}

/// Finds the candidates of loaded blocks.
#[inline(always)]
fn detect<S: Simd>(
    s: S,
    tables: &Tables,
    columns: &mut Columns,
    extremes: [[u16; 2]; LANES],
    threshold: f32,
    out: &mut [Candidates],
) {
    columns.filter_samples(s, tables);
    columns.mark_maxima(s, threshold);
    for (lane, (extremes, found)) in extremes.into_iter().zip(out).enumerate() {
        found.find(s, columns, lane, threshold);
        found.extremes = extremes;
    }
}

/// Detects pulses in the blocks of a batch and creates their pulse models.
pub(super) struct DetectAll<'a> {
    pub(super) tables: &'a Tables,
    pub(super) rows: &'a mut Rows,
    pub(super) columns: &'a mut Columns,
    /// Blocks of the rows from `first` on.
    pub(super) blocks: &'a [Waveform<'a>],
    pub(super) first: usize,
    pub(super) begin: Begin<'a>,
    pub(super) pulse_models: &'a mut [PulseModel],
    /// Waveforms by number of pulses.
    ///
    /// Later loops over waveforms with the same number of pulses have a constant trip count, which
    /// the processor predicts.
    pub(super) by_count: &'a mut ByCount,
}

/// Waveforms of a batch by number of pulses.
pub(super) struct ByCount {
    rows: Vec<[u32; BATCH]>,
    lengths: [usize; MAX_PULSES + 1],
}

impl ByCount {
    pub(super) fn new() -> ByCount {
        ByCount { rows: vec![[0; BATCH]; MAX_PULSES + 1], lengths: [0; MAX_PULSES + 1] }
    }

    pub(super) fn clear(&mut self) {
        self.lengths = [0; MAX_PULSES + 1];
    }

    /// Adds a waveform with `count` pulses.
    #[inline(always)]
    fn push(&mut self, count: usize, row: usize) {
        let (Some(rows), Some(length)) = (self.rows.get_mut(count), self.lengths.get_mut(count)) else {
            return;
        };
        if let Some(place) = rows.get_mut(*length) {
            *place = row as u32;
            *length += 1;
        }
    }

    /// Returns the number of waveforms with `count` pulses.
    pub(super) fn count(&self, count: usize) -> usize {
        self.lengths[count]
    }

    /// Returns the waveforms with `count` pulses, in order.
    pub(super) fn rows(&self, count: usize) -> impl Iterator<Item = usize> {
        self.rows[count][..self.lengths[count]].iter().map(|&row| row as usize)
    }
}

impl Kernel for DetectAll<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let DetectAll { tables, rows, columns, first, begin, pulse_models, by_count, .. } = self;
        let threshold = begin.thresholds.sigma.least as f32;
        let mut found = [Candidates::default(); LANES];
        let groups = self.blocks.chunks(LANES).zip(pulse_models.chunks_mut(LANES));
        for (group, (blocks, pulse_models)) in groups.enumerate() {
            fetch(s, self.blocks, group + 1);
            let first = first + group * LANES;
            let found = &mut found[..blocks.len()];
            let extremes = load(s, tables, columns, blocks);
            columns.whiten(s, tables, rows, first, blocks.len());
            detect(s, tables, columns, extremes, threshold, found);
            let lanes = blocks.iter().zip(found).zip(pulse_models).enumerate();
            for (lane, ((block, found), pulse_model)) in lanes {
                begin.begin(block, rows.capacity(), found, pulse_model);
                if let Some(level) = &tables.level {
                    match columns.level(lane).filter(|[level_dn, v]| level.is_likely(*level_dn, *v)) {
                        Some([level_dn, _]) => pulse_model.level_dn = level_dn,
                        None => pulse_model.leave_to_scalar(),
                    }
                }
                // The later kernels take their waveforms from these lists, and none left to the scalar kernels.
                if pulse_model.is_fast() {
                    by_count.push(pulse_model.pulses().len(), first + lane);
                }
            }
        }
    }
}

/// Selects the candidates that become pulses.
pub(super) struct Begin<'a> {
    pub(super) thresholds: &'a Thresholds,
    pub(super) settings: &'a DecomposeSettings,
    /// Samples from this value on are clipped.
    pub(super) saturated: u16,
    /// Whether the background is so high that a sample of 0 is clipped.
    pub(super) clear_of_zero: bool,
}

impl Begin<'_> {
    /// Initialises the pulses of a waveform from its candidates.
    #[inline(always)]
    fn begin(
        &self,
        block: &Waveform<'_>,
        capacity: usize,
        found: &mut Candidates,
        pulse_model: &mut PulseModel,
    ) {
        let Begin { thresholds, settings, .. } = self;
        pulse_model.reset();
        let [lowest, highest] = found.extremes;
        let is_cut_off = highest >= self.saturated || (lowest == 0 && self.clear_of_zero);
        let is_long = block.samples.len() > capacity;
        if is_cut_off || is_long || found.too_many {
            pulse_model.leave_to_scalar();
            return;
        }
        // Detection used the lower threshold, which holds only for the last of several returns.
        if thresholds.sigma.usual > thresholds.sigma.least {
            found.drop_weak(thresholds.sigma.usual as f32);
        }
        found.screen(thresholds.sigma.least as f32, &thresholds.left_behind, thresholds.per_dn);
        let unexplained = found.as_slice().len();
        found.keep_strongest(settings.max_returns);
        let kept = found.as_slice();
        pulse_model.counts = PulseCounts::of_candidates(found.found, unexplained, kept.len());
        for candidate in kept {
            let height = candidate.statistic / thresholds.per_dn;
            pulse_model.push(PulseComponent::of_calibrated_width(height, candidate.position_samples));
        }
    }
}

/// Finds the candidates in the residuals of some waveforms.
pub(super) struct FilterResiduals<'a> {
    pub(super) tables: &'a Tables,
    pub(super) rows: &'a Rows,
    pub(super) columns: &'a mut Columns,
    pub(super) which: &'a [usize],
    pub(super) threshold: f32,
    pub(super) out: &'a mut Vec<Candidates>,
}

impl Kernel for FilterResiduals<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let FilterResiduals { tables, rows, columns, threshold, out, .. } = self;
        out.resize_with(self.which.len(), Candidates::default);
        for (which, out) in self.which.chunks(LANES).zip(out.chunks_mut(LANES)) {
            let mut lanes = [which[0]; LANES];
            lanes[..which.len()].copy_from_slice(which);
            columns.load_residuals(s, rows, &lanes);
            columns.filter_residuals(s, tables);
            columns.mark_maxima(s, threshold);
            for (lane, found) in out.iter_mut().enumerate() {
                found.find(s, columns, lane, threshold);
            }
        }
    }
}
