//! Decomposes many blocks with the SIMD kernels, in batches.

use std::sync::Arc;

use crate::decompose::Waveform;
use crate::decompose::{BatchDecomposer, Decompositions, Mode, Tables};
use crate::decompose::{DecomposeSettings, Decomposition};
use crate::sensor_model::{ChannelModel, ModelError};
use crate::simd::SimdLevel;

/// Number of blocks per batch: these and their samples fit into the cache.
const CHUNK: usize = 256;

/// Decomposes blocks in order and passes each result to `take`.
///
/// The scalar kernels decompose blocks unsuitable for the SIMD kernels, and all blocks if each
/// waveform has its own background: the models of the first rounds describe noise and level too
/// poorly for a robust estimate of it.
pub(crate) fn decompose_each<'a>(
    mut blocks: impl Iterator<Item = Waveform<'a>>,
    model: &ChannelModel,
    settings: &DecomposeSettings,
    simd: SimdLevel,
    mut take: impl FnMut(Waveform<'a>, &Decomposition<'_>),
) -> Result<(), ModelError> {
    let is_fixed = model.offset_precision().is_none();
    let tables = if is_fixed { Tables::new(model).map(Arc::new) } else { None };
    let mut decomposer = BatchDecomposer::new(model, tables, settings, Mode::Refined, simd)?;
    let (mut chunk, mut outcomes) = (Vec::with_capacity(CHUNK), Decompositions::default());
    loop {
        chunk.clear();
        chunk.extend(blocks.by_ref().take(CHUNK));
        if chunk.is_empty() {
            return Ok(());
        }
        decomposer.decompose(&chunk, &mut outcomes);
        for (block, outcome) in chunk.iter().zip(outcomes.iter()) {
            take(*block, &outcome);
        }
    }
}
