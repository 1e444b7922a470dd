//! Read access to a decomposer's last waveform.

use super::scene::Found;
use super::{Decomposer, Decomposition, Return};

impl Decomposer {
    /// Loads a window of a block with returns from elsewhere, such as the fast kernels.
    ///
    /// `first` is the index in the block of the window's first sample.
    pub fn show(&mut self, samples: &[u16], first: usize, outcome: &Decomposition<'_>) {
        self.scene.load(&self.model, samples, first, self.recovery_samples());
        self.returns.clear();
        self.returns.extend_from_slice(outcome.returns);
        let found = |r: &Return| Found::new(r.amplitude_dn, r.position_samples, r.width_ratio.ln());
        self.scene.show(outcome.returns.iter().map(found), outcome.background_offset_dn);
    }

    /// Returns of the last waveform, by position.
    pub fn returns(&self) -> &[Return] {
        &self.returns
    }

    /// Whether each sample was used.
    ///
    /// Saturated samples and those during recovery are not used.
    pub fn used(&self) -> &[bool] {
        self.scene.whitener().used()
    }

    /// Fitted signal above the channel's background, DN.
    pub fn signal_dn(&self) -> &[f64] {
        self.scene.target_dn()
    }

    /// Whitened residual, standard deviations.
    ///
    /// Independent between samples if the model is right; 0 for unused samples.
    pub fn standardised_residual(&self) -> &[f64] {
        self.scene.whitened()
    }

    /// Pulse of return `index` above the background, DN.
    ///
    /// `per_sample` values per sample, from the block's first to its last; empty if there is no
    /// such return.
    pub fn pulse_curve(&self, index: usize, per_sample: usize) -> Vec<f64> {
        let (Some(found), samples) = (self.scene.found.get(index), self.scene.target_dn().len()) else {
            return Vec::new();
        };
        let points = samples.saturating_sub(1) * per_sample + usize::from(samples > 0);
        let mut curve = vec![0.0; points];
        let shape = self.scene.shape().on_time();
        for phase in 0..per_sample {
            // The shape is tabulated for whole samples; shifting the pulse gives values in between.
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
