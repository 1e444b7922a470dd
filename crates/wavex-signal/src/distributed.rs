//! Distributed targets: the waveform as a continuous profile of the target along the beam.
//!
//! Dense vegetation under a large footprint is not a sum of a few echoes. Its waveform is the system
//! response convolved with a profile that is nowhere negative. The profile is estimated on a fine
//! grid by non-negative least squares with a penalty on its bending; the penalty is the largest that
//! explains the waveform to its noise (V. A. Morozov, On the solution of functional equations by the
//! method of regularization, Soviet Mathematics Doklady 7, 1966). Peaks and relative heights follow
//! from the profile, their standard deviations from its covariance.

mod band;
mod columns;
mod profile;
mod solve;
#[cfg(test)]
mod tests;

use crate::sensor_model::{ChannelModel, ModelError};
use crate::shape::Shape;
use crate::whitening::Whitener;

use columns::{Columns, Grid};
pub use profile::{RELATIVE_HEIGHTS, TargetProfile, WithSd};
use solve::Solver;

/// Fewest usable samples of a waveform.
const LEAST_SAMPLES: usize = 8;

/// Estimates profiles of the waveforms of one channel.
pub struct DistributedTargets {
    model: ChannelModel,
    shape: Shape,
    whitener: Whitener,
    /// Error of the response relative to its height.
    shape_error: f64,
    columns: Columns,
    solver: Solver,
    used: Vec<bool>,
    signal_dn: Vec<f64>,
    weights: Vec<f64>,
}

impl DistributedTargets {
    /// Creates the estimator of a channel; `template_error` is the smallest relative error of its
    /// response.
    ///
    /// # Errors
    /// The model is invalid.
    pub fn new(model: &ChannelModel, template_error: f64) -> Result<DistributedTargets, ModelError> {
        Ok(DistributedTargets {
            shape: Shape::of(model)?,
            whitener: Whitener::new(model.noise()?, 0),
            shape_error: template_error.hypot(model.pulse_shape_error),
            model: model.clone(),
            columns: Columns::default(),
            solver: Solver::default(),
            used: Vec::new(),
            signal_dn: Vec::new(),
            weights: Vec::new(),
        })
    }

    /// Profile of a waveform; `None` if it has no usable samples or no signal.
    ///
    /// `start_phase` is the index of its first sample modulo 4, `offset_dn` its background above that
    /// of the channel, DN.
    pub fn profile(&mut self, samples: &[u16], start_phase: u8, offset_dn: f64) -> Option<TargetProfile> {
        self.used.clear();
        self.used.extend(samples.iter().map(|&sample| f64::from(sample) < self.model.full_scale_dn));
        let used = self.used.iter().filter(|used| **used).count();
        if used < LEAST_SAMPLES {
            return None;
        }
        self.whitener.set_used(&self.used);
        self.signal_dn.clear();
        self.model.signal_into(samples, start_phase, &mut self.signal_dn);
        self.signal_dn.iter_mut().for_each(|dn| *dn -= offset_dn);
        let highest_dn = self.signal_dn.iter().copied().fold(0.0, f64::max);
        if highest_dn <= self.model.noise_sd_dn {
            return None;
        }
        self.weigh();
        let grid = Grid::of(samples.len(), self.shape.fwhm_samples());
        self.columns.set(grid, &self.shape, highest_dn, &self.whitener, &self.weights);
        self.whitener.whiten(&mut self.signal_dn);
        self.signal_dn.iter_mut().zip(&self.weights).for_each(|(value, weight)| *value *= weight);
        let solution = self.solver.solve(&self.columns, &self.signal_dn, used)?;
        profile::of(&solution, grid)
    }

    /// Weights of the whitened samples: the error of the response adds to the noise.
    fn weigh(&mut self) {
        let relative_error = self.shape_error / self.model.noise_sd_dn;
        let weight = |dn: &f64| (1.0 + (relative_error * dn.max(0.0)).powi(2)).sqrt().recip();
        self.weights.clear();
        self.weights.extend(self.signal_dn.iter().map(weight));
    }
}
