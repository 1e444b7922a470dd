//! The even/odd test: how far the places differ that every other sample of a recorded pulse tells.

use crate::kernels::gauss_fit::{GaussFit, Limits, Pulse};
use crate::kernels::sensor_model::{ChannelModel, ModelError};
use crate::kernels::shape::Shape;
use crate::kernels::whitening::Whitener;

/// Fits of one pulse to the even and to the odd samples of its block.
///
/// Both tell the same place, so their difference is made of the noise alone, recorded noise and not simulated: no truth
/// is needed, and no other program (docs/explanation/method.md, Calibration). To first order the places are weighted sums of
/// the samples, `w_e·y` and `w_o·y`; with `Σ` the covariance of the noise the difference has the variance
/// `(w_e - w_o)ᵀ Σ (w_e - w_o)`, in which the correlation of even with odd samples is not left out.
#[derive(Debug, Clone)]
pub struct EvenOdd {
    fitter: GaussFit,
    /// For even and for odd samples.
    whiteners: [Whitener; 2],
    /// As far as it differs from zero.
    autocovariance: Vec<f64>,
}

/// Places to within a hundredth of their standard deviations.
const NEAR: Limits = Limits { iterations: 30, decrease: 1e-4, enough: f64::INFINITY };
/// Noise that is correlated by less is not.
const LEAST_CORRELATION: f64 = 1e-9;

impl EvenOdd {
    /// For blocks of the channel of up to `longest` samples; in longer ones noise farther apart than that is taken to be
    /// uncorrelated.
    pub fn new(model: &ChannelModel, longest: usize) -> Result<EvenOdd, ModelError> {
        EvenOdd::of_shape(Shape::of(model)?, model, longest)
    }

    /// The same where the shape that the model describes is at hand.
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
            fitter: GaussFit::new(shape, model.offset_precision(), longest, 1),
            whiteners: [Whitener::new(noise.clone(), longest), Whitener::new(noise, longest)],
            autocovariance,
        })
    }

    /// The difference of the two places over its standard deviation by the noise model, the error factor left out.
    ///
    /// `target_dn` are the samples less the background, `start` is the only pulse in them. `None` where a half cannot
    /// be fitted.
    pub fn score(&mut self, target_dn: &[f64], start: Pulse) -> Option<f64> {
        let (even, weights_even) = self.place(target_dn, start, 0)?;
        let (odd, weights_odd) = self.place(target_dn, start, 1)?;
        let weights: Vec<f64> = weights_even.iter().zip(weights_odd).map(|(a, b)| a - b).collect();
        let variance = self.variance(&weights);
        (variance > 0.0).then(|| (even - odd) / variance.sqrt())
    }

    /// The place that every other sample tells, and how it follows each sample.
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

    /// Variance that the noise gives to a weighted sum of samples.
    fn variance(&self, weights: &[f64]) -> f64 {
        let at_lag = |(lag, covariance): (usize, &f64)| {
            let later = weights.get(lag..).unwrap_or_default();
            let products: f64 = weights.iter().zip(later).map(|(a, b)| a * b).sum();
            covariance * products * if lag == 0 { 1.0 } else { 2.0 }
        };
        self.autocovariance.iter().enumerate().map(at_lag).sum()
    }
}
