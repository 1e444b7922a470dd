//! The decomposition of a run, one waveform at a time.

use std::sync::Arc;

use wavex_signal::decompose::{BatchDecomposer, Decompositions, Flanks, Mode, Tables};
use wavex_signal::decompose::{DecomposeSettings, Return, Waveform};
use wavex_signal::sensor_model::ChannelModel;
use wavex_signal::simd::SimdLevel;

/// Decomposes one waveform at a time.
pub struct WaveformDecomposer {
    kernels: BatchDecomposer,
    outcomes: Decompositions,
    flanks: Flanks,
    sampling_interval_ns: f64,
}

impl WaveformDecomposer {
    /// Creates the engine for a channel.
    pub fn new(model: &ChannelModel, settings: &DecomposeSettings, mode: Mode) -> WaveformDecomposer {
        let tables = Tables::new(model).map(Arc::new);
        let kernels =
            BatchDecomposer::new(model, tables, settings, mode, SimdLevel::best()).expect("a model");
        let flanks = Flanks::new(model, settings.template_error, settings.recovery_samples).expect("a model");
        let sampling_interval_ns = model.sampling_interval_ns;
        WaveformDecomposer { kernels, outcomes: Decompositions::default(), flanks, sampling_interval_ns }
    }

    /// Returns of a waveform, and its deviation ratio.
    pub fn decompose(&mut self, samples: &[u16]) -> (&[Return], f64) {
        self.kernels.decompose(&[Waveform { samples, start_phase: 0 }], &mut self.outcomes);
        let outcome = self.outcomes.get(0).expect("one outcome for one waveform");
        (outcome.returns, outcome.deviation_ratio())
    }

    /// Returns of a waveform with the standard deviations that a run states for overdriven and
    /// clipped pulses.
    pub fn decompose_as_stated(&mut self, samples: &[u16]) -> Vec<Return> {
        let waveform = Waveform { samples, start_phase: 0 };
        self.kernels.decompose(&[waveform], &mut self.outcomes);
        let outcome = self.outcomes.get(0).expect("one outcome for one waveform");
        let errors = self.flanks.overdrive_errors(waveform, &outcome);
        let mut returns = outcome.returns.to_vec();
        for pulse in &mut returns {
            let (time_ns, relative_height) = errors.of(pulse.flags);
            let time_samples = time_ns / self.sampling_interval_ns;
            pulse.position_sd_samples = pulse.position_sd_samples.hypot(time_samples);
            pulse.amplitude_sd_dn = pulse.amplitude_sd_dn.hypot(relative_height * pulse.amplitude_dn);
        }
        returns
    }
}
