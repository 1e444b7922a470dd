//! Channel models at other gains, for automatic gain control.
//!
//! A sample is `background + gain x (signal + receiver noise) + quantisation noise`. Receiver noise
//! scales with the gain. Quantisation noise is white with a variance of 1/12 DN². The background is
//! the digitiser's offset and does not change; a waveform's deviation from it scales with the gain.
//! See docs/explanation/method.md, Automatic gain control.

use crate::noise::fit_by_bic;
use crate::sensor_model::{ChannelModel, ModelError};

mod normalised;

pub use normalised::{Recorded, calibrate_at_unit_gain};

/// Quantisation variance, DN².
const QUANTISATION_VARIANCE: f64 = 1.0 / 12.0;
/// Models per octave of gain.
///
/// The noise SD is within 2.2 % of that at the block's gain.
const LEVELS_PER_OCTAVE: f64 = 16.0;
/// Minimum of the maximum AR order at another gain.
const ORDER: usize = 4;
/// Sample count that makes the order depend on the autocovariance alone.
const EXACT: u64 = 1 << 40;

/// Index on the logarithmic grid of gains; 0 is gain 1.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct GainLevel(i16);

impl GainLevel {
    /// Level of the reference gain.
    pub const UNIT: GainLevel = GainLevel(0);

    /// Returns the level nearest to a positive gain.
    pub fn of(gain: f64) -> GainLevel {
        // The conversion saturates at the bounds of the integer type.
        if gain == 1.0 {
            GainLevel::UNIT
        } else {
            GainLevel((LEVELS_PER_OCTAVE * libm::log2(gain)).round() as i16)
        }
    }

    /// Returns the gain of the level, dimensionless.
    pub fn gain(self) -> f64 {
        libm::exp2(f64::from(self.0) / LEVELS_PER_OCTAVE)
    }
}

impl ChannelModel {
    /// Returns the model of this channel at another gain.
    ///
    /// `self` is the model at gain 1. Noise other than quantisation scales with the gain, and so do
    /// the peak heights of the responses. Background and full scale belong to the digitiser and do
    /// not change.
    ///
    /// # Errors
    /// The model is invalid.
    pub fn at_gain(&self, gain: f64) -> Result<ChannelModel, ModelError> {
        if gain == 1.0 {
            return Ok(self.clone());
        }
        let rounding = QUANTISATION_VARIANCE.min(self.noise()?.sd().powi(2));
        let mut model = self.with_white_noise(-rounding, gain * gain, rounding)?;
        model.background_sd_dn *= gain;
        if let Some(response) = &mut model.response {
            response.nodes.iter_mut().for_each(|node| node.peak_dn *= gain);
        }
        Ok(model)
    }

    /// Returns the channel in other units: 1 DN becomes `factor`.
    ///
    /// The full scale does not change.
    pub(crate) fn in_steps(&self, factor: f64) -> ChannelModel {
        let mut model = self.clone();
        model.background_dn.iter_mut().for_each(|level| *level *= factor);
        for value in [&mut model.background_sd_dn, &mut model.noise_sd_dn, &mut model.innovation_sd_dn] {
            *value *= factor;
        }
        model.provenance.noise_by_differences_dn *= factor;
        model.uncertainty.background_dn *= factor;
        model.uncertainty.noise_sd_dn *= factor;
        if let Some(response) = &mut model.response {
            response.nodes.iter_mut().for_each(|node| node.peak_dn *= factor);
        }
        model
    }

    /// Adds white noise, scales the noise, and adds white noise again.
    ///
    /// The variance `before` is added first, or subtracted if negative, DN². The variance is then
    /// multiplied by `factor`, and `after` is added.
    ///
    /// # Errors
    /// The model is invalid, or no noise is left.
    pub(crate) fn with_white_noise(
        &self,
        before: f64,
        factor: f64,
        after: f64,
    ) -> Result<ChannelModel, ModelError> {
        let noise = self.noise()?;
        let order = if self.ar.is_empty() { 0 } else { self.ar.len().max(ORDER) };
        let mut autocovariance = vec![0.0; order + 1];
        noise.autocovariance_into(&mut autocovariance);
        let measured = autocovariance[0];
        autocovariance.iter_mut().for_each(|value| *value *= factor);
        autocovariance[0] = (factor * (measured + before)).max(0.0) + after;
        let changed = fit_by_bic(&autocovariance, EXACT, order).ok_or_else(|| ModelError {
            field: "noise_sd_dn",
            problem: format!("{} leaves no noise at another gain", self.noise_sd_dn),
        })?;
        let kept = factor * measured / autocovariance[0];
        let mut model = self.clone();
        model.noise_sd_dn = changed.sd();
        model.innovation_sd_dn = changed.innovation_variance().sqrt();
        model.ar = changed.coefficients().to_vec();
        model.autocorrelation.iter_mut().for_each(|rho| *rho = (*rho * kept).clamp(-1.0, 1.0));
        model.uncertainty.noise_sd_dn *= factor.sqrt();
        Ok(model)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::noise::ArNoise;
    use crate::simulated::{Random, analogue, channel, digitised};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_level_is_near_its_gain(gain in 1.0 / 1024.0..1024.0_f64) {
            let ratio = GainLevel::of(gain).gain() / gain;
            prop_assert!((ratio.log2() * LEVELS_PER_OCTAVE).abs() <= 0.5 + 1e-9, "{}", ratio);
        }
    }

    #[test]
    fn the_reference_gain_changes_nothing() {
        let model = channel(&ArNoise::new(&[0.6], 0.8).unwrap(), 4.5, 2.0);
        assert_eq!(model.at_gain(1.0).unwrap(), model);
        assert_eq!((GainLevel::of(1.0), GainLevel::UNIT.gain()), (GainLevel::UNIT, 1.0));
        assert_eq!([0.5, 2.0, 4.0].map(|gain| GainLevel::of(gain).gain()), [0.5, 2.0, 4.0]);
    }

    /// Compares amplified and rounded receiver noise with the model at its gain.
    #[test]
    fn noise_is_that_of_amplified_and_rounded_samples() {
        let (background_dn, count) = (40.0, 200_000);
        let analog = ArNoise::new(&[0.6], 1.2).unwrap();
        let model = channel(&analog, 4.5, background_dn);
        for gain in [0.5, 1.0, 4.0] {
            let mut random = Random::new(3);
            let values = analogue(&mut random, &analog, count, 0.0, 4.5, &[]);
            let samples: Vec<f64> = values.iter().map(|v| background_dn + gain * v).collect();
            let samples: Vec<f64> =
                digitised(&samples, 255).iter().map(|&s| f64::from(s) - background_dn).collect();
            let lag =
                |k: usize| samples.windows(k + 1).map(|w| w[0] * w[k]).sum::<f64>() / (count - k) as f64;
            let at_gain = model.at_gain(gain).unwrap();
            let mut expected = [0.0; 4];
            at_gain.noise().unwrap().autocovariance_into(&mut expected);
            for (k, expected) in expected.iter().enumerate() {
                let error = (lag(k) - expected) / lag(0);
                assert!(error.abs() < 0.02, "gain {gain}, lag {k}: {} {expected}", lag(k));
            }
            assert_eq!(
                (at_gain.background_dn, at_gain.full_scale_dn),
                (model.background_dn, model.full_scale_dn)
            );
        }
    }

    #[test]
    fn other_steps_are_other_units() {
        let model = channel(&ArNoise::new(&[0.6], 0.8).unwrap(), 4.5, 2.0);
        let fine = model.in_steps(64.0);
        assert_eq!((fine.noise_sd_dn, fine.background_dn), (64.0 * model.noise_sd_dn, [128.0; 4]));
        assert_eq!(fine.in_steps(1.0 / 64.0), model);
    }
}
