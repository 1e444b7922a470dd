//! Many blocks decomposed by the fast kernels, a batch at a time.

use std::sync::Arc;

use super::Block;
use crate::kernels::decompose::{DecomposeSettings, Decomposition};
use crate::kernels::lockstep::{Lockstep, Mode, Outcomes, Path, Tables};
use crate::kernels::sensor_model::{ChannelModel, ModelError};

/// Blocks whose outcomes are held at once: they and their samples stay in the cache.
const CHUNK: usize = 256;

/// Decomposes blocks with a model and hands on each with what became of it, in order.
///
/// The plain kernels decompose what the fast ones are not made for, and every waveform where the background is each
/// waveform's own: the models of the first rounds know too little of noise and level for a robust estimate of it.
pub(in crate::kernels) fn decompose_each<'a>(
    mut blocks: impl Iterator<Item = Block<'a>>,
    model: &ChannelModel,
    settings: &DecomposeSettings,
    mut take: impl FnMut(Block<'a>, &Decomposition<'_>),
) -> Result<(), ModelError> {
    let is_fixed = model.offset_precision().is_none();
    let tables = if is_fixed { Tables::new(model).map(Arc::new) } else { None };
    let mut lockstep = Lockstep::new(model, tables, settings, Mode::Refined, Path::best())?;
    let (mut chunk, mut outcomes) = (Vec::with_capacity(CHUNK), Outcomes::default());
    loop {
        chunk.clear();
        chunk.extend(blocks.by_ref().take(CHUNK));
        if chunk.is_empty() {
            return Ok(());
        }
        lockstep.decompose(&chunk, &mut outcomes);
        for (block, outcome) in chunk.iter().zip(outcomes.iter()) {
            take(*block, &outcome);
        }
    }
}
