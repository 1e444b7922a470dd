//! The outgoing pulses of many blocks at a time, by the fast kernels.

use std::ops::Range;
use std::sync::Arc;

use super::{OutgoingFitter, one_pulse, window};
use crate::kernels::calibrate::Block;
use crate::kernels::decompose::Return;
use crate::kernels::lockstep::{Candidate, Lockstep, Mode, Outcomes, Path, Tables};
use crate::kernels::sensor_model::{ChannelModel, ModelError};

/// An outgoing pulse, and the samples of its block that it was fitted to.
#[derive(Debug, Clone, PartialEq)]
pub struct Outgoing {
    /// The pulse; its place counts from the block's first sample.
    pub pulse: Return,
    /// The samples that it was fitted to.
    pub window: Range<usize>,
}

/// Fits outgoing pulses of one channel; keeps its memory from one batch to the next.
///
/// What [`OutgoingFitter`] does, but for this: the matched filter alone says where the window lies, and the window begins
/// some samples earlier, at a multiple of four and with the samples that the noise's prediction needs before it. Blocks
/// that are not for the fast kernels are left to it.
pub struct OutgoingBatch {
    plain: OutgoingFitter,
    fast: Lockstep,
    /// Samples at the beginning of a block that only predict.
    order: usize,
    candidates: Vec<(u32, Candidate)>,
    strongest: Vec<Candidate>,
    /// Length and place of each window, with its block's index.
    windows: Vec<(usize, u32, Range<usize>)>,
    outcomes: Outcomes,
}

impl OutgoingBatch {
    /// For the reference channel and its tables: `None`, or what [`Tables::new`] gives for the same model.
    pub fn new(
        model: &ChannelModel,
        tables: Option<Arc<Tables>>,
        path: Path,
    ) -> Result<OutgoingBatch, ModelError> {
        Ok(OutgoingBatch {
            plain: OutgoingFitter::new(model, 0)?,
            fast: Lockstep::new(model, tables, &one_pulse(), Mode::Refined, path)?,
            order: model.ar.len(),
            candidates: Vec::new(),
            strongest: Vec::new(),
            windows: Vec::new(),
            outcomes: Outcomes::default(),
        })
    }

    /// The reference channel.
    pub fn model(&self) -> &ChannelModel {
        self.fast.model()
    }

    /// The strongest pulse of each block, in order; see [`OutgoingFitter::fit`]. `pulses` is emptied first.
    pub fn fit(&mut self, blocks: &[Block<'_>], pulses: &mut Vec<Option<Outgoing>>) {
        pulses.clear();
        self.choose_windows(blocks);
        let windowed: Vec<Block<'_>> = (self.windows.iter())
            .map(|(_, i, window)| Block { samples: part(blocks, *i, window), start_phase: 0 })
            .collect();
        self.fast.decompose(&windowed, &mut self.outcomes);
        pulses.resize(blocks.len(), None);
        for ((outcome, block), (_, i, window)) in self.outcomes.iter().zip(&windowed).zip(&self.windows) {
            let fitted = outcome.returns.first().map(|&pulse| Outgoing {
                pulse: self.plain.finished(pulse, window.start, block.samples, 0),
                window: window.clone(),
            });
            if let Some(place) = pulses.get_mut(*i as usize) {
                *place = fitted;
            }
        }
        for ((block, strongest), pulse) in blocks.iter().zip(&self.strongest).zip(pulses) {
            if strongest.statistic == 0.0 {
                let fitted = self.plain.fit(block.samples, block.start_phase);
                *pulse = fitted.map(|pulse| Outgoing { pulse, window: self.plain.window.clone() });
            }
        }
    }

    /// Finds the strongest pulse of each block, a statistic of 0 where the block is not for the fast kernels, and its
    /// window. Windows are in order of their length: thresholds at the ends of blocks are computed once for each length.
    fn choose_windows(&mut self, blocks: &[Block<'_>]) {
        let model = self.fast.model();
        let (fwhm, full_scale_dn) = (model.fwhm_samples(), model.full_scale_dn);
        self.fast.detect(blocks, &mut self.candidates);
        self.strongest.clear();
        self.strongest.resize(blocks.len(), Candidate::default());
        for (i, candidate) in &self.candidates {
            match self.strongest.get_mut(*i as usize) {
                Some(strongest) if candidate.statistic > strongest.statistic => *strongest = *candidate,
                _ => {}
            }
        }
        self.windows.clear();
        for ((i, block), strongest) in (0..).zip(blocks).zip(&mut self.strongest) {
            let is_saturated = block.samples.iter().any(|&sample| f64::from(sample) >= full_scale_dn);
            if is_saturated || !block.start_phase.is_multiple_of(4) {
                *strongest = Candidate::default();
            }
            if strongest.statistic > 0.0 {
                let mut window = window(strongest.position_samples.into(), fwhm, block.samples.len());
                window.start = window.start.saturating_sub(self.order) / 4 * 4;
                self.windows.push((window.len(), i, window));
            }
        }
        self.windows.sort_unstable_by_key(|&(length, i, _)| (length, i));
    }
}

/// The samples of a window of a block.
fn part<'a>(blocks: &[Block<'a>], index: u32, window: &Range<usize>) -> &'a [u16] {
    blocks.get(index as usize).and_then(|block| block.samples.get(window.clone())).unwrap_or_default()
}
