//! Calibration from waveforms of different gains, converted to gain 1.
//!
//! `(sample - background) / gain` is stored in 16-bit samples of finer steps, so all waveforms have
//! the model of one receiver. Quantisation noise, which is larger at small gains after this
//! conversion, is subtracted from the estimated noise and added again at gain 1.

use super::QUANTISATION_VARIANCE;
use crate::calibrate::response::{Calibrated, calibrate_response};
use crate::calibrate::{CalibrationError, CalibrationSettings, calibrate, separate_noise};
use crate::decompose::Waveform;
use crate::sensor_model::{ChannelModel, ModelError};

/// Samples at the start of a block for the initial background estimate.
const START_SAMPLES: usize = 8;
/// Largest sample in finer steps, the limit of the fast kernels.
const LARGEST: f64 = 32_766.0;

/// Samples of a block and its gain.
#[derive(Clone, Copy, Debug)]
pub struct Recorded<'a> {
    /// Digitiser steps.
    pub samples: &'a [u16],
    /// Relative to the reference gain; positive.
    pub gain: f64,
}

/// Calibrates a channel at gain 1 from blocks of any gain.
///
/// `with_response` also estimates the system response.
///
/// # Errors
/// As [`calibrate`] and [`calibrate_response`].
pub fn calibrate_at_unit_gain<'a>(
    blocks: impl Iterator<Item = Recorded<'a>> + Clone,
    settings: &CalibrationSettings,
    with_response: bool,
) -> Result<Calibrated, CalibrationError> {
    // The first round estimates the background by phase; the second subtracts it.
    let start_dn = start_level_dn(blocks.clone());
    let first = Normalised::of(blocks.clone(), [start_dn; 4], settings.full_scale_dn);
    let model = calibrate(first.blocks(), &first.settings(settings))?;
    let second = Normalised::of(blocks, first.background_dn(&model), settings.full_scale_dn);
    let settings = second.settings(settings);
    let model = calibrate(second.blocks(), &settings)?;
    let found = match with_response {
        true => calibrate_response(second.blocks(), &model, &settings)?,
        false => {
            let model = separate_noise(second.blocks(), &model, &settings)?;
            Calibrated { model, usable_echoes: 0 }
        }
    };
    Ok(Calibrated { model: second.at_unit_gain(&found.model)?, ..found })
}

/// Median of the blocks' first samples, DN.
fn start_level_dn<'a>(blocks: impl Iterator<Item = Recorded<'a>>) -> f64 {
    let mut starts: Vec<u16> =
        blocks.flat_map(|block| block.samples.iter().take(START_SAMPLES).copied()).collect();
    let middle = starts.len() / 2;
    if starts.is_empty() { 0.0 } else { f64::from(*starts.select_nth_unstable(middle).1) }
}

/// Blocks at gain 1, in finer steps.
struct Normalised {
    samples: Vec<u16>,
    lengths: Vec<usize>,
    /// Finer steps per digitiser step at gain 1.
    scale: f64,
    /// Subtracted background by sample number modulo 4, DN.
    ///
    /// It is stored as `level`, in finer steps.
    pivot_dn: [f64; 4],
    level: f64,
    full_scale_dn: f64,
    /// Largest value that is not clipped at any gain, finer steps.
    full_scale: f64,
    /// Mean of `1 / gain` and of `1 / gain²` over the blocks.
    mean_inverse: f64,
    mean_inverse_square: f64,
}

impl Normalised {
    fn of<'a>(
        blocks: impl Iterator<Item = Recorded<'a>> + Clone,
        pivot_dn: [f64; 4],
        full_scale_dn: f64,
    ) -> Normalised {
        let least_gain = blocks.clone().map(|block| block.gain).fold(f64::INFINITY, f64::min).min(1e300);
        let highest = blocks.clone().flat_map(|block| block.samples).max().map_or(0.0, |&dn| f64::from(dn));
        let largest_dn = (highest + 1.0).min(full_scale_dn.max(1.0));
        let scale = LARGEST * least_gain / largest_dn;
        let pivot = pivot_dn.iter().fold(0.0, |most: f64, &dn| most.max(dn));
        let level = scale * pivot / least_gain;
        let mut normalised = Normalised {
            samples: Vec::new(),
            lengths: Vec::new(),
            scale,
            pivot_dn,
            level,
            full_scale_dn,
            full_scale: level + scale * (full_scale_dn - pivot) / least_gain,
            mean_inverse: 0.0,
            mean_inverse_square: 0.0,
        };
        for block in blocks {
            normalised.add(block);
        }
        let count = normalised.lengths.len().max(1) as f64;
        normalised.mean_inverse /= count;
        normalised.mean_inverse_square /= count;
        normalised
    }

    fn add(&mut self, block: Recorded) {
        let factor = self.scale / block.gain;
        let finer = |(k, &sample): (usize, &u16)| {
            let dn = f64::from(sample);
            if dn >= self.full_scale_dn {
                return u16::MAX;
            }
            // The conversion saturates at the bounds of the integer type.
            (self.level + factor * (dn - self.pivot_dn[k % 4])).round().min(LARGEST) as u16
        };
        self.samples.extend(block.samples.iter().enumerate().map(finer));
        self.lengths.push(block.samples.len());
        self.mean_inverse += 1.0 / block.gain;
        self.mean_inverse_square += 1.0 / (block.gain * block.gain);
    }

    fn blocks(&self) -> impl Iterator<Item = Waveform<'_>> + Clone {
        let mut rest = &self.samples[..];
        self.lengths.iter().map(move |&length| {
            let (samples, behind) = rest.split_at(length);
            rest = behind;
            Waveform { samples }
        })
    }

    fn settings(&self, settings: &CalibrationSettings) -> CalibrationSettings {
        CalibrationSettings { full_scale_dn: self.full_scale, ..settings.clone() }
    }

    /// Converts the estimated background from finer steps to recorded DN.
    fn background_dn(&self, model: &ChannelModel) -> [f64; 4] {
        let per_dn = self.scale * self.mean_inverse;
        std::array::from_fn(|k| self.pivot_dn[k] + (model.background_dn[k] - self.level) / per_dn)
    }

    /// Converts the model to digitiser steps at gain 1.
    fn at_unit_gain(&self, model: &ChannelModel) -> Result<ChannelModel, ModelError> {
        let rounding = QUANTISATION_VARIANCE * (self.mean_inverse_square + self.scale.powi(-2));
        let in_steps = model.in_steps(1.0 / self.scale);
        let mut at_unit = in_steps.with_white_noise(-rounding, 1.0, QUANTISATION_VARIANCE)?;
        at_unit.background_dn = self.background_dn(model);
        at_unit.full_scale_dn = self.full_scale_dn;
        Ok(at_unit)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::noise::ArNoise;
    use crate::simulated::{Random, analogue, digitised, pulse};

    #[test]
    fn blocks_of_many_gains_calibrate_one_receiver() {
        let process = ArNoise::new(&[0.6], 0.8).unwrap();
        let mut random = Random::new(5);
        let recorded: Vec<(Vec<u16>, f64)> = (0..4000)
            .map(|i| {
                let gain = [0.5, 1.0, 2.0, 4.0][i % 4];
                let echo = pulse(20.0 + 20.0 * random.uniform(), 24.0 + random.uniform(), 1.0);
                let signal = analogue(&mut random, &process, 60, 0.0, 4.5, &[echo]);
                let level = |k: usize| if k.is_multiple_of(2) { 20.0 } else { 21.5 };
                let values: Vec<f64> = signal.iter().enumerate().map(|(k, v)| level(k) + gain * v).collect();
                (digitised(&values, 255), gain)
            })
            .collect();
        let blocks = || recorded.iter().map(|(samples, gain)| Recorded { samples, gain: *gain });
        let model =
            calibrate_at_unit_gain(blocks(), &CalibrationSettings::echoes(1.0, 255.0), false).unwrap().model;
        let noise_sd_dn = (process.sd().powi(2) + QUANTISATION_VARIANCE).sqrt();
        assert!((model.noise_sd_dn / noise_sd_dn - 1.0).abs() < 0.02, "{} {noise_sd_dn}", model.noise_sd_dn);
        let first = 0.6 * process.sd().powi(2) / noise_sd_dn.powi(2);
        assert!((model.autocorrelation[0] - first).abs() < 0.02, "{:?} {first}", model.autocorrelation);
        for (level, exact) in model.background_dn.iter().zip([20.0, 21.5, 20.0, 21.5]) {
            assert!((level - exact).abs() < 0.05, "{:?}", model.background_dn);
        }
        assert!((model.pulse_fwhm_ns - 4.5).abs() < 0.03, "{}", model.pulse_fwhm_ns);
        assert_eq!(model.full_scale_dn, 255.0);
    }
}
