//! The decomposition of a run, one waveform at a time.

use std::sync::Arc;

use wavex_signal::decompose::Waveform;
use wavex_signal::decompose::{BatchDecomposer, Decompositions, Mode, Tables};
use wavex_signal::decompose::{DecomposeSettings, Return};
use wavex_signal::sensor_model::ChannelModel;
use wavex_simd::SimdLevel;

/// Decomposes one waveform at a time.
pub struct WaveformDecomposer {
    kernels: BatchDecomposer,
    outcomes: Decompositions,
}

impl WaveformDecomposer {
    /// Creates the engine for a channel.
    pub fn new(model: &ChannelModel, settings: &DecomposeSettings, mode: Mode) -> WaveformDecomposer {
        let tables = Tables::new(model).map(Arc::new);
        let kernels =
            BatchDecomposer::new(model, tables, settings, mode, SimdLevel::best()).expect("a model");
        WaveformDecomposer { kernels, outcomes: Decompositions::default() }
    }

    /// Returns of a waveform, and its deviation ratio.
    pub fn decompose(&mut self, samples: &[u16]) -> (&[Return], f64) {
        self.kernels.decompose(&[Waveform { samples }], &mut self.outcomes);
        let outcome = self.outcomes.get(0).expect("one outcome for one waveform");
        (outcome.returns, outcome.deviation_ratio())
    }
}
