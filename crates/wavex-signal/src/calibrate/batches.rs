//! Decomposes many blocks with the SIMD kernels, in batches.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use rayon::iter::ParallelIterator;
use rayon::slice::ParallelSlice;

use super::{CalibrationError, CalibrationSettings};
use crate::decompose::Waveform;
use crate::decompose::{BatchDecomposer, Decompositions, Mode, Tables};
use crate::decompose::{DecomposeSettings, Decomposition};
use crate::sensor_model::ChannelModel;

/// Number of blocks per batch: these and their samples fit into the cache.
const CHUNK: usize = 256;
/// Number of blocks per task.
const BLOCKS_PER_TASK: usize = 4 * CHUNK;

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
    mut take: impl FnMut(Waveform<'a>, &Decomposition<'_>),
) -> Result<(), CalibrationError> {
    let is_fixed = model.offset_precision().is_none();
    let tables = if is_fixed { Tables::new(model).map(Arc::new) } else { None };
    let blocks: Vec<Waveform<'a>> = blocks.collect();
    let results = map_parts(&blocks, BLOCKS_PER_TASK, |part| -> Result<Vec<_>, CalibrationError> {
        let mut decomposer =
            BatchDecomposer::new(model, tables.clone(), decompose, Mode::Refined, settings.simd)?;
        let decompose_batch = |batch| {
            if settings.cancelled.load(Ordering::Relaxed) {
                return Err(CalibrationError::Cancelled);
            }
            let mut outcomes = Decompositions::default();
            decomposer.decompose(batch, &mut outcomes);
            Ok(outcomes)
        };
        part.chunks(CHUNK).map(decompose_batch).collect()
    });
    let mut of_batches = blocks.chunks(CHUNK);
    for part in results {
        for (outcomes, batch) in part?.iter().zip(&mut of_batches) {
            batch.iter().zip(outcomes.iter()).for_each(|(block, outcome)| take(*block, &outcome));
        }
    }
    Ok(())
}

/// Maps consecutive parts of a list; in parallel if called from a thread of a `rayon` pool.
///
/// Parts have `length` items, the last one possibly fewer. Neither they nor the order of the results
/// depend on the number of threads.
pub(crate) fn map_parts<T: Sync, R: Send>(
    items: &[T],
    length: usize,
    map: impl Fn(&[T]) -> R + Sync + Send,
) -> Vec<R> {
    let length = length.max(1);
    match rayon::current_thread_index() {
        Some(_) => items.par_chunks(length).map(map).collect(),
        None => items.chunks(length).map(map).collect(),
    }
}
