//! Decomposes many blocks with the SIMD kernels, in batches.

use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, PoisonError};

use super::{CalibrationError, CalibrationSettings};
use crate::decompose::Waveform;
use crate::decompose::{BatchDecomposer, Decompositions, Mode, Tables};
use crate::decompose::{DecomposeSettings, Decomposition};
use crate::parallel::map_parts;
use crate::sensor_model::ChannelModel;

/// Number of blocks per batch: these and their samples fit into the cache.
const CHUNK: usize = 256;
/// Number of blocks per task.
const BLOCKS_PER_TASK: usize = 4 * CHUNK;

/// Pulses that are no returns.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum WeakPulses {
    /// They are dropped; chi-square and their neighbours are those with them.
    Drop,
    /// Their neighbours are fitted again.
    FitAgain,
}

/// Decomposes blocks and passes each result to `take`, in the order of the blocks.
///
/// The scalar kernels decompose blocks unsuitable for the SIMD kernels, and all blocks if each
/// waveform has its own background: the models of the first rounds describe noise and level too
/// poorly for a robust estimate of it.
pub(crate) fn decompose_each<'a>(
    blocks: impl Iterator<Item = Waveform<'a>>,
    model: &ChannelModel,
    decompose: &DecomposeSettings,
    settings: &CalibrationSettings,
    weak: WeakPulses,
    mut take: impl FnMut(Waveform<'a>, &Decomposition<'_>),
) -> Result<(), CalibrationError> {
    let is_fixed = model.offset_precision().is_none();
    let tables = if is_fixed { Tables::new(model).map(Arc::new) } else { None };
    let blocks: Vec<Waveform<'a>> = blocks.collect();
    let first = BatchDecomposer::new(model, tables, decompose, Mode::Refined, settings.simd)?
        .dropping_weak(weak == WeakPulses::Drop);
    // One for each thread at work.
    let idle = Mutex::new(Vec::new());
    let idle = || idle.lock().unwrap_or_else(PoisonError::into_inner);
    let results = map_parts(&blocks, BLOCKS_PER_TASK, |part| -> Result<Vec<_>, CalibrationError> {
        let waiting = idle().pop();
        let mut decomposer = waiting.unwrap_or_else(|| first.another());
        let decompose_batch = |batch| {
            if settings.cancelled.load(Ordering::Relaxed) {
                return Err(CalibrationError::Cancelled);
            }
            let mut outcomes = Decompositions::default();
            decomposer.decompose(batch, &mut outcomes);
            settings.progress.add(batch.len());
            Ok(outcomes)
        };
        let outcomes = part.chunks(CHUNK).map(decompose_batch).collect();
        idle().push(decomposer);
        outcomes
    });
    let mut of_batches = blocks.chunks(CHUNK);
    for part in results {
        for (outcomes, batch) in part?.iter().zip(&mut of_batches) {
            batch.iter().zip(outcomes.iter()).for_each(|(block, outcome)| take(*block, &outcome));
        }
    }
    Ok(())
}
