//! SIMD form of [`crate::decompose`]: sixteen waveforms in lock-step, in `f32`.
//!
//! Samples lie along the vectors, and each waveform's dot products are sums over its own row. Only
//! the small linear systems are solved with one waveform per lane. Templates are therefore read in
//! whole cache lines at any pulse position. The results of a waveform are identical to the bit
//! alone, in any batch and on every [`SimdLevel`].
//!
//! A batch passes through detection ([`FilterPeak`]), the fit of all clusters of up to eight pulses,
//! a search of their residuals, and the score test of widened pulses. If each waveform has its own
//! background, it is estimated before detection and brought to the joint optimum with the pulses
//! after their fits (`level`). The scalar kernels take the waveforms that the SIMD kernels cannot
//! decompose, one at a time: saturation, a background without enough free samples, pulses wider
//! than a row, large clusters, fits without an optimum, and pulses that fail as returns. The scalar
//! kernels are also the reference in the tests.
//!
//! The first samples of a block, as many as the order of the noise, have no weight in a fit. They
//! count in chi-square if no pulse reaches them. After construction a [`BatchDecomposer`] allocates only
//! for more returns or longer blocks, two lists per batch of which a part is refined, and a little
//! for pulses at the ends of blocks of varying length.

#![allow(
    clippy::needless_range_loop,
    reason = "an index of a lane, row or column runs over several arrays in step"
)]
#![allow(
    clippy::too_many_arguments,
    reason = "kernels are plain functions over tables, rows and scratch space"
)]

/// Unrolls a short loop, so that its arrays stay in registers.
macro_rules! unrolled {
    ($i:ident in [$($n:literal)*] if $limit:expr => $body:block) => {
        $(if $n < $limit {
            let $i: usize = $n;
            $body
        })*
    };
}

mod batch;
mod candidates;
mod columns;
mod detection;
mod filter;
mod fit;
mod fit_many;
mod fit_queue;
mod fitted;
mod fourier_response;
mod initial_guess;
mod layout;
mod level;
mod level_tables;
mod outcome;
mod pulse_model;
mod residual_search;
mod rows;
mod score_test;
mod single_pulse;
mod solve;
mod table_cache;
mod tables;
mod template;
mod thresholds;
mod trial;
mod workspace;

#[cfg(test)]
mod tests;

use std::sync::Arc;

use wavex_simd::SimdLevel;

use super::{DecomposeSettings, Decomposer, Waveform};
use crate::decompose::DEVIANT;
use crate::decompose::acceptance::CLEAR_OF_ZERO_SD;
use crate::sensor_model::{ChannelModel, ModelError};
use crate::shape::Shape;

pub use candidates::FilterPeak;
pub use outcome::Decompositions;
pub use table_cache::TableCache;
pub use tables::Tables;

use detection::Detect;
use outcome::{Finish, Give};
use pulse_model::PulseModel;
use rows::{BATCH, FAST_BATCH};
use thresholds::Thresholds;
use workspace::{Decompose, DetectionBuffers, Workspace};

/// Thoroughness of the decomposition.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mode {
    /// One step from the width bank for each detected pulse.
    Fastest,
    /// As `Fastest` for separate pulses; a joint fit for overlapping ones.
    FastSeparated,
    /// Fits all pulses to the optimum.
    ///
    /// Searches the residuals, and tests widened pulses for two.
    Refined,
}

/// Decomposes the waveforms of one channel in batches; reuses its memory between them.
///
/// ```
/// use std::sync::Arc;
/// use wavex_signal::decompose::{
///     BatchDecomposer, DecomposeSettings, Decompositions, Mode, Tables, Waveform,
/// };
/// use wavex_simd::SimdLevel;
/// # use wavex_signal::{noise::ArNoise, simulated::channel};
/// # let model = channel(&ArNoise::new(&[], 0.7).unwrap(), 4.0, 5.0);
///
/// // `model`: pulses 4 ns wide, on a background of 5 DN.
/// let samples = [5, 5, 5, 5, 5, 6, 12, 27, 49, 61, 49, 27, 12, 6, 5, 5, 5, 5, 5, 5];
/// let batch = [Waveform { samples: &samples }; 100];
/// let (tables, settings) = (Tables::new(&model).map(Arc::new), DecomposeSettings::default());
/// let mut decomposer =
///     BatchDecomposer::new(&model, tables, &settings, Mode::Refined, SimdLevel::best())?;
/// let mut outcomes = Decompositions::default();
/// decomposer.decompose(&batch, &mut outcomes);
/// assert!(outcomes.iter().all(|outcome| outcome.returns.len() == 1));
/// # Ok::<(), wavex_signal::sensor_model::ModelError>(())
/// ```
pub struct BatchDecomposer {
    model: ChannelModel,
    settings: DecomposeSettings,
    mode: Mode,
    refine_when_needed: bool,
    drops_weak: bool,
    path: SimdLevel,
    tables: Option<Arc<Tables>>,
    thresholds: Thresholds,
    plain: Decomposer,
    work: Workspace,
    /// Pulse models of the fast pass while some waveforms are refined.
    first_pass: Vec<PulseModel>,
    left_to_plain: u64,
}

impl BatchDecomposer {
    /// Creates a decomposer for a channel and its tables.
    ///
    /// `tables` is `None` or the result of [`Tables::new`] for the same model. Without tables the
    /// scalar kernels decompose all waveforms.
    pub fn new(
        model: &ChannelModel,
        tables: Option<Arc<Tables>>,
        settings: &DecomposeSettings,
        mode: Mode,
        path: SimdLevel,
    ) -> Result<BatchDecomposer, ModelError> {
        let shape = tables.as_ref().map_or_else(|| Shape::of(model), |tables| Ok(tables.shape.clone()))?;
        let plain = Decomposer::of_shape(model, settings, shape, 0)?;
        let mut thresholds = Thresholds::new(model, settings, plain.shape().clone())?;
        let level = tables.as_ref().and_then(|tables| tables.level.as_ref());
        thresholds.level_response = level.map_or(0.0, |level| level.response());
        Ok(BatchDecomposer {
            model: model.clone(),
            settings: settings.clone(),
            mode,
            refine_when_needed: false,
            drops_weak: false,
            path,
            tables,
            thresholds,
            plain,
            work: Workspace::new(0),
            first_pass: Vec::new(),
            left_to_plain: 0,
        })
    }

    /// Creates the same decomposer for another thread; both share their tables.
    pub fn another(&self) -> BatchDecomposer {
        BatchDecomposer {
            model: self.model.clone(),
            settings: self.settings.clone(),
            tables: self.tables.clone(),
            thresholds: self.thresholds.clone(),
            plain: self.plain.clone(),
            work: Workspace::new(0),
            first_pass: Vec::new(),
            left_to_plain: 0,
            ..*self
        }
    }

    /// Enables refinement in the fast modes.
    ///
    /// Waveforms with overlapping pulses or a deviation ratio above 3 are refined.
    pub fn refine_when_needed(mut self, refine: bool) -> BatchDecomposer {
        self.refine_when_needed = refine && self.mode != Mode::Refined;
        self
    }

    /// Drops pulses that are no returns without fitting their neighbours again, as the fast modes do.
    pub(crate) fn dropping_weak(mut self, drops: bool) -> BatchDecomposer {
        self.drops_weak = drops;
        self
    }

    /// Returns the model of its channel.
    pub fn model(&self) -> &ChannelModel {
        &self.model
    }

    /// Returns the pulse shape; clones share its tables.
    pub(crate) fn shape(&self) -> &Shape {
        self.plain.shape()
    }

    /// Number of waveforms decomposed by the scalar kernels since construction.
    pub fn left_to_plain(&self) -> u64 {
        self.left_to_plain
    }

    /// Finds the matched-filter maxima that reach the threshold.
    ///
    /// Each maximum is stored in `found` with the index of its block; `found` is cleared first.
    /// Without tables nothing is found. Samples above 32 767 count as 32 767.
    pub fn detect(&mut self, blocks: &[Waveform<'_>], found: &mut Vec<(u32, FilterPeak)>) {
        found.clear();
        let Some(tables) = self.tables.clone() else { return };
        let threshold = self.settings.detection_sigma as f32;
        for (batch, blocks) in blocks.chunks(BATCH).enumerate() {
            self.work.make_room(blocks);
            let DetectionBuffers { columns, candidates: out, .. } = &mut self.work.detection;
            self.path.processor().run(Detect { tables: &tables, columns, blocks, threshold, out });
            for (i, candidates) in out.iter().enumerate() {
                let index = (batch * BATCH + i) as u32;
                found.extend(candidates.as_slice().iter().map(|candidate| (index, *candidate)));
            }
        }
    }

    /// Decomposes blocks into one outcome each, in order.
    ///
    /// `outcomes` is cleared first.
    pub fn decompose(&mut self, blocks: &[Waveform<'_>], outcomes: &mut Decompositions) {
        outcomes.clear();
        self.work.make_room(blocks);
        let refines = self.mode == Mode::Refined || self.refine_when_needed;
        let batch = self.work.rows.batch().min(if refines { BATCH } else { FAST_BATCH });
        for blocks in blocks.chunks(batch) {
            self.batch(blocks, outcomes);
        }
    }

    fn batch(&mut self, blocks: &[Waveform<'_>], outcomes: &mut Decompositions) {
        let Some(tables) = self.tables.clone() else {
            self.left_to_plain += blocks.len() as u64;
            for block in blocks {
                outcomes.push(&self.plain.decompose(block.samples));
            }
            return;
        };
        self.run(&tables, blocks, self.mode);
        if !self.refine_when_needed {
            let mut pulse_models = std::mem::take(&mut self.work.pulse_models);
            let on = self.path.processor();
            on.run(Give {
                finish: self.finish(self.mode),
                blocks,
                pulse_models: &mut pulse_models,
                outcomes,
            });
            self.work.pulse_models = pulse_models;
            return;
        }
        self.refine_some(&tables, blocks, outcomes);
    }

    fn run(&mut self, tables: &Tables, blocks: &[Waveform<'_>], mode: Mode) {
        let BatchDecomposer { path, thresholds, plain, settings, model, work, .. } = self;
        let full_scale_dn = model.full_scale_dn;
        let lowest = model.background_dn.iter().fold(f64::INFINITY, |a, &b| a.min(b));
        let clear_of_zero = lowest >= CLEAR_OF_ZERO_SD * model.noise_sd_dn;
        let on = path.processor();
        Decompose {
            on,
            tables,
            thresholds,
            plain,
            settings,
            mode,
            full_scale_dn,
            clear_of_zero,
            work,
            blocks,
        }
        .run();
    }

    fn finish(&mut self, mode: Mode) -> Finish<'_> {
        Finish {
            model: &self.model,
            settings: &self.settings,
            thresholds: &mut self.thresholds,
            plain: &mut self.plain,
            left_to_plain: &mut self.left_to_plain,
            is_refined: mode == Mode::Refined && !self.drops_weak,
        }
    }

    /// Refines the waveforms of a fast pass that need it; outputs all in order.
    fn refine_some(&mut self, tables: &Tables, blocks: &[Waveform<'_>], outcomes: &mut Decompositions) {
        std::mem::swap(&mut self.first_pass, &mut self.work.pulse_models);
        let (mut to_refine, mut which) = (Vec::with_capacity(blocks.len()), Vec::with_capacity(blocks.len()));
        for (block, pulse_model) in blocks.iter().zip(&self.first_pass) {
            let is_unclear = self.needs_refinement(pulse_model, block.samples.len());
            // `usize::MAX` is past the end of the refined models: such a waveform keeps its first pass.
            which.push(if is_unclear { to_refine.len() } else { usize::MAX });
            to_refine.extend(is_unclear.then_some(*block));
        }
        self.run(tables, &to_refine, Mode::Refined);
        let mut refined = std::mem::take(&mut self.work.pulse_models);
        let mut first_pass = std::mem::take(&mut self.first_pass);
        for (i, block) in blocks.iter().enumerate() {
            let (mode, pulse_model) = match refined.get_mut(which[i]) {
                Some(pulse_model) => (Mode::Refined, pulse_model),
                None => (self.mode, &mut first_pass[i]),
            };
            self.finish(mode).push_returns(block.samples, pulse_model, outcomes);
        }
        (self.work.pulse_models, self.first_pass) = (refined, first_pass);
    }

    fn needs_refinement(&self, pulse_model: &PulseModel, samples: usize) -> bool {
        if pulse_model.pulses().is_empty() {
            return false;
        }
        if !pulse_model.is_fast() {
            // One step on overlapping pulses leaves much of their signal to the level. A waveform
            // rejected for this reason may succeed once it is refined.
            return self.thresholds.level_response > 0.0;
        }
        let fwhm = self.model.fwhm_samples() as f32;
        let overlaps = (1..pulse_model.pulses().len()).any(|i| pulse_model.overlap(i - 1, i, fwhm));
        overlaps || self.thresholds.outcome(pulse_model, samples).deviation_ratio() > DEVIANT
    }
}
