//! The even/odd test: position difference between the even and odd samples of a pulse.

use crate::pulse_fit::{PulseFit, StopCriteria};
use crate::sensor_model::{ChannelModel, ModelError};
use crate::shape::Pulse;
use crate::shape::Shape;
use crate::whitening::Whitener;

/// Fits one pulse separately to even and odd samples.
///
/// Both estimate the same position, so their difference contains only the recorded noise: neither a
/// truth nor another program is needed (docs/explanation/method.md, Calibration). To first order the positions
/// are weighted sums of the samples, `w_e·y` and `w_o·y`. With `Σ` the covariance of the noise, the
/// difference has the variance `(w_e - w_o)ᵀ Σ (w_e - w_o)`, which includes the correlation between
/// even and odd samples.
#[derive(Debug, Clone)]
pub struct EvenOdd {
    fitter: PulseFit,
    /// For even and for odd samples.
    whiteners: [Whitener; 2],
    /// Up to the last lag that differs from zero.
    autocovariance: Vec<f64>,
}

/// Tolerance for positions: a hundredth of their standard deviations.
const NEAR: StopCriteria = StopCriteria { iterations: 30, decrease: 1e-4, enough: f64::INFINITY };
/// Correlation below which noise is treated as uncorrelated.
const LEAST_CORRELATION: f64 = 1e-9;

impl EvenOdd {
    /// Creates the test for blocks of up to `longest` samples.
    ///
    /// In longer blocks, larger lags count as uncorrelated.
    pub fn new(model: &ChannelModel, longest: usize) -> Result<EvenOdd, ModelError> {
        EvenOdd::of_shape(Shape::of(model)?, model, longest)
    }

    /// The same for a given shape of the model.
    pub(super) fn of_shape(
        shape: Shape,
        model: &ChannelModel,
        longest: usize,
    ) -> Result<EvenOdd, ModelError> {
        let noise = model.noise()?;
        let mut autocovariance = vec![0.0; longest];
        noise.autocovariance_into(&mut autocovariance);
        let least = LEAST_CORRELATION * autocovariance.first().copied().unwrap_or(0.0);
        let reach = autocovariance.iter().rposition(|value| value.abs() > least).map_or(0, |last| last + 1);
        autocovariance.truncate(reach);
        Ok(EvenOdd {
            fitter: PulseFit::new(shape, model.offset_precision(), longest, 1),
            whiteners: [Whitener::new(noise.clone(), longest), Whitener::new(noise, longest)],
            autocovariance,
        })
    }

    /// Position difference over its standard deviation by the noise model, without the error
    /// factor.
    ///
    /// `target_dn` are the samples less the background; `start` is the only pulse in them. `None`
    /// if the fit to either half fails.
    pub fn score(&mut self, target_dn: &[f64], start: Pulse) -> Option<f64> {
        let (even, weights_even) = self.place(target_dn, start, 0)?;
        let (odd, weights_odd) = self.place(target_dn, start, 1)?;
        let weights: Vec<f64> = weights_even.iter().zip(weights_odd).map(|(a, b)| a - b).collect();
        let variance = self.variance(&weights);
        (variance > 0.0).then(|| (even - odd) / variance.sqrt())
    }

    /// Position from every other sample, and its sensitivity to each sample.
    fn place(&mut self, target_dn: &[f64], start: Pulse, parity: usize) -> Option<(f64, Vec<f64>)> {
        let whitener = &mut self.whiteners[parity];
        if whitener.used().len() != target_dn.len() {
            let used: Vec<bool> = (0..target_dn.len()).map(|k| k % 2 == parity).collect();
            whitener.set_used(&used);
        }
        let fit = self.fitter.fit(whitener, target_dn, &[start], NEAR);
        if !fit.termination.is_optimum() {
            return None;
        }
        let mut weights = self.fitter.weights(1);
        whitener.whiten_transposed(&mut weights);
        Some((self.fitter.pulses().first()?.position_samples, weights))
    }

    /// Noise variance of a weighted sum of samples.
    fn variance(&self, weights: &[f64]) -> f64 {
        let at_lag = |(lag, covariance): (usize, &f64)| {
            let later = weights.get(lag..).unwrap_or_default();
            let products: f64 = weights.iter().zip(later).map(|(a, b)| a * b).sum();
            covariance * products * if lag == 0 { 1.0 } else { 2.0 }
        };
        self.autocovariance.iter().enumerate().map(at_lag).sum()
    }
}
