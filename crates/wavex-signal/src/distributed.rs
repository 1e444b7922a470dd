//! Distributed targets: the waveform as a continuous profile of the target along the beam.
//!
//! Dense vegetation under a large footprint is not a sum of a few echoes. Its waveform is the system
//! response convolved with a profile that is nowhere negative. The profile is estimated on a fine
//! grid by non-negative least squares with a penalty on its bending; the penalty is the largest that
//! explains the waveform to its noise (V. A. Morozov, On the solution of functional equations by the
//! method of regularization, Soviet Mathematics Doklady 7, 1966). Peaks and relative heights follow
//! from the profile, their standard deviations from its covariance.

mod profile;
mod solve;
#[cfg(test)]
mod tests;

use crate::sensor_model::{ChannelModel, ModelError};
use crate::shape::{Pulse, Shape};
use crate::whitening::Whitener;

pub use profile::{RELATIVE_HEIGHTS, TargetProfile, WithSd};
use solve::Solver;

/// Grid points per pulse width.
const POINTS_PER_WIDTH: f64 = 6.0;
/// Largest number of grid points; wider steps are used for longer blocks.
const MOST_POINTS: usize = 400;
/// Fewest usable samples of a waveform.
const LEAST_SAMPLES: usize = 8;
/// Samples of a column below this part of its peak count as zero.
const NEGLIGIBLE: f64 = 1e-5;

/// Estimates profiles of the waveforms of one channel.
pub struct DistributedTargets {
    model: ChannelModel,
    shape: Shape,
    whitener: Whitener,
    /// Error of the response relative to its height.
    shape_error: f64,
    solver: Solver,
    used: Vec<bool>,
    signal_dn: Vec<f64>,
    weights: Vec<f64>,
}

/// Grid of the profile, samples from the first of the block.
#[derive(Clone, Copy, Debug)]
struct Grid {
    step_samples: f64,
    points: usize,
}

impl Grid {
    fn of(samples: usize, fwhm_samples: f64) -> Grid {
        let length = samples as f64 - 1.0;
        let step_samples = (fwhm_samples / POINTS_PER_WIDTH).max(length / (MOST_POINTS - 1) as f64);
        Grid { step_samples, points: (length / step_samples) as usize + 1 }
    }

    fn position(&self, point: usize) -> f64 {
        point as f64 * self.step_samples
    }
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
        let n = samples.len();
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
        let grid = Grid::of(n, self.shape.fwhm_samples());
        self.solver.begin(n);
        for point in 0..grid.points {
            let pulse = Pulse {
                height_dn: highest_dn,
                position_samples: grid.position(point),
                ln_width_ratio: 0.0,
                ln_width_precision: 0.0,
            };
            let column = self.solver.add_column();
            self.shape.add(&pulse, 1.0, column);
            column.iter_mut().for_each(|value| *value /= highest_dn);
            let first = column.iter().position(|value| value.abs() > NEGLIGIBLE).unwrap_or(n);
            column[..first].fill(0.0);
            self.whitener.whiten_from(first, column);
            column.iter_mut().zip(&self.weights).for_each(|(value, weight)| *value *= weight);
        }
        self.whitener.whiten(&mut self.signal_dn);
        self.signal_dn.iter_mut().zip(&self.weights).for_each(|(value, weight)| *value *= weight);
        let solution = self.solver.solve(&self.signal_dn, used)?;
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
