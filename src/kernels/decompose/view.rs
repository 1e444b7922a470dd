//! What a decomposer holds of the waveform that it decomposed or was shown last, for those who want to see it.

use super::scene::Found;
use super::{Decomposer, Decomposition, Return};

impl Decomposer {
    /// Takes up a block with returns that others found in it, the fast kernels for one.
    pub fn show(&mut self, samples: &[u16], start_phase: u8, outcome: &Decomposition<'_>) {
        self.scene.load(&self.model, samples, start_phase, self.settings.recovery_samples);
        self.returns.clear();
        self.returns.extend_from_slice(outcome.returns);
        let found = |r: &Return| Found::new(r.amplitude_dn, r.position_samples, r.width_ratio.ln());
        self.scene.show(outcome.returns.iter().map(found), outcome.background_offset_dn);
    }

    /// The returns of the last waveform, by position.
    pub fn returns(&self) -> &[Return] {
        &self.returns
    }

    /// Which of its samples took part: saturated ones and those the receiver needs to recover did not.
    pub fn used(&self) -> &[bool] {
        self.scene.whitener().used()
    }

    /// What its samples stand above the channel's background, DN, as it was fitted.
    pub fn signal_dn(&self) -> &[f64] {
        self.scene.target_dn()
    }

    /// What the fit leaves, whitened: in standard deviations, independent from sample to sample where the model is
    /// right; 0 for samples that took no part.
    pub fn standardised_residual(&self) -> &[f64] {
        self.scene.whitened()
    }

    /// The pulse of return `index` above the background, DN, at every `1/per_sample` of a sample from the block's first to its
    /// last; empty where there is no such return.
    pub fn pulse_curve(&self, index: usize, per_sample: usize) -> Vec<f64> {
        let (Some(found), samples) = (self.scene.found.get(index), self.scene.target_dn().len()) else {
            return Vec::new();
        };
        let points = samples.saturating_sub(1) * per_sample + usize::from(samples > 0);
        let mut curve = vec![0.0; points];
        let shape = self.scene.shape().on_time();
        for phase in 0..per_sample {
            // The shape knows whole samples: what lies between is seen by moving the pulse the other way.
            let mut pulse = found.pulse;
            pulse.position_samples -= phase as f64 / per_sample as f64;
            let mut values = vec![0.0; samples];
            shape.add(&pulse, 1.0, &mut values);
            for (point, value) in curve.iter_mut().skip(phase).step_by(per_sample).zip(values) {
                *point = value;
            }
        }
        curve
    }
}
