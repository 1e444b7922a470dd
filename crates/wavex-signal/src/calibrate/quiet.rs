//! Noise of a channel without free samples: residuals where the fitted pulses are low.
//!
//! The error of the pulse shape is proportional to the fitted signal. Where that is below a few
//! standard deviations of the noise, the residual is the noise, with its correlation. The
//! remaining residual, near the peaks, is shape error. The levels of these samples are the
//! background, which the skirts of misfitted pulses and the smallest samples displace.

use super::noise_statistics::NoiseStatistics;
use super::pass_stats::median_and_spread;
use super::{
    CalibrationError, CalibrationSettings, LEAST_DRIFT_SD, MISSHAPEN, QUANTISATION_VARIANCE, WeakPulses,
    decompose_each, set_noise, uncertainty,
};
use crate::decompose::{DecomposeSettings, Decomposition, Waveform};
use crate::noise::{ArNoise, fit_by_bic};
use crate::sensor_model::{Background, ChannelModel, NoiseSource};
use crate::shape::{Pulse, Shape};

/// Largest fitted signal of quiet samples, in standard deviations of the noise by differences.
const QUIET_SD: f64 = 3.0;
/// Shortest stretch of quiet samples.
const MIN_STRETCH: usize = 6;
/// Fewest quiet samples; fewer give no estimate.
const MIN_SAMPLES: u64 = 1000;
/// Largest variance of a block over the median of all; others contain a pulse without a fit.
const LARGEST_VARIANCE: f64 = 4.0;
/// Largest noise over that by differences. More is signal without a fit: correlated noise of six
/// instruments exceeds it by at most 1.8.
const STRUCTURED: f64 = 4.0;
/// Largest number of blocks, evenly spaced.
const MAX_BLOCKS: usize = 5_000;
/// The first estimate finds the weak pulses that the second one leaves out.
const ROUNDS: usize = 2;

/// Replaces noise and background estimates that contain the shape error of the pulses.
///
/// The background only if each waveform has its own. Only for noise from the residuals of fits at all samples; other models are returned unchanged.
/// Without enough quiet samples, noise is that of the differences if the residual exceeds it
/// clearly.
pub fn separate_noise<'a>(
    blocks: impl Iterator<Item = Waveform<'a>> + Clone,
    model: &ChannelModel,
    settings: &CalibrationSettings,
) -> Result<ChannelModel, CalibrationError> {
    let mut model = model.clone();
    if !matches!(model.provenance.noise, NoiseSource::Residuals | NoiseSource::QuietResiduals) {
        return Ok(model);
    }
    let white_dn = model.provenance.noise_by_differences_dn;
    let step = blocks.clone().count().div_ceil(MAX_BLOCKS).max(1) | 1;
    for _ in 0..ROUNDS {
        let quiet = QuietBlocks::of(blocks.clone().step_by(step), &model, settings)?;
        let Some((autocovariance, samples)) = quiet.autocovariance(model.background) else { break };
        model.autocorrelation = autocovariance[1..].iter().map(|r| r / autocovariance[0]).collect();
        set_noise(&mut model, fit_by_bic(&autocovariance, samples, settings.max_ar_order));
        model.provenance.noise = NoiseSource::QuietResiduals;
        if model.background == Background::PerWaveform {
            quiet.set_background(&mut model);
        }
    }
    // Residuals at all samples contain the shape error, so they are trusted less than quiet ones.
    let limit = match model.provenance.noise {
        NoiseSource::Residuals => MISSHAPEN,
        _ => STRUCTURED,
    };
    if model.noise_sd_dn > limit * white_dn {
        model.autocorrelation.clear();
        set_noise(&mut model, ArNoise::new(&[], white_dn));
        model.provenance.noise = NoiseSource::Differences;
    }
    Ok(model)
}

/// Residuals at quiet samples, in stretches by block.
#[derive(Default)]
struct QuietBlocks(Vec<QuietBlock>);

struct QuietBlock {
    /// Residuals of a stretch, DN, and the phase of its first sample.
    stretches: Vec<(Vec<f64>, u8)>,
    /// Fitted background less that of the model, DN.
    background_offset_dn: f64,
}

impl QuietBlock {
    fn variance(&self) -> f64 {
        self.mean_of(|value| value * value)
    }

    /// Background of the quiet samples less that of the model, DN.
    fn offset_dn(&self) -> f64 {
        self.background_offset_dn + self.mean_of(|value| value)
    }

    fn mean_of(&self, quantity: impl Fn(f64) -> f64) -> f64 {
        let values = || self.stretches.iter().flat_map(|(values, _)| values);
        values().map(|value| quantity(*value)).sum::<f64>() / values().count().max(1) as f64
    }
}

impl QuietBlocks {
    fn of<'a>(
        blocks: impl Iterator<Item = Waveform<'a>>,
        model: &ChannelModel,
        settings: &CalibrationSettings,
    ) -> Result<QuietBlocks, CalibrationError> {
        let shape = Shape::of(model)?;
        let quiet_dn = QUIET_SD * model.provenance.noise_by_differences_dn;
        let decompose = DecomposeSettings { split_evidence: None, ..settings.decompose.clone() };
        let mut quiet = QuietBlocks::default();
        decompose_each(blocks, model, &decompose, settings, WeakPulses::FitAgain, |block, outcome| {
            if !outcome.saturated && !outcome.returns.is_empty() {
                quiet.add(model, &shape, quiet_dn, block, outcome);
            }
        })?;
        Ok(quiet)
    }

    fn add(
        &mut self,
        model: &ChannelModel,
        shape: &Shape,
        quiet_dn: f64,
        block: Waveform<'_>,
        outcome: &Decomposition<'_>,
    ) {
        let mut residual_dn = Vec::with_capacity(block.samples.len());
        model.signal_into(block.samples, &mut residual_dn);
        let mut fitted_dn = vec![0.0; residual_dn.len()];
        for found in outcome.returns {
            let pulse = Pulse {
                height_dn: found.amplitude_dn,
                position_samples: found.position_samples,
                ln_width_ratio: found.width_ratio.ln(),
                ln_width_precision: 0.0,
            };
            shape.add(&pulse, 1.0, &mut fitted_dn);
        }
        for (residual, fitted) in residual_dn.iter_mut().zip(&fitted_dn) {
            *residual -= fitted + outcome.background_offset_dn;
        }
        let background_offset_dn = outcome.background_offset_dn;
        let mut quiet = QuietBlock { stretches: Vec::new(), background_offset_dn };
        let mut from = 0;
        for k in 0..=residual_dn.len() {
            let is_quiet = fitted_dn.get(k).is_some_and(|fitted| fitted.abs() <= quiet_dn);
            if !is_quiet {
                if k - from >= MIN_STRETCH {
                    quiet.stretches.push((residual_dn[from..k].to_vec(), (from % 4) as u8));
                }
                from = k + 1;
            }
        }
        if !quiet.stretches.is_empty() {
            self.0.push(quiet);
        }
    }

    /// Replaces the background by the median of the blocks, and its spread.
    fn set_background(&self, model: &mut ChannelModel) {
        let offsets_dn: Vec<f64> = self.0.iter().map(QuietBlock::offset_dn).collect();
        let blocks = offsets_dn.len() as u64;
        let (offset_dn, spread_dn) = median_and_spread(offsets_dn);
        model.background_dn = model.background_dn.map(|level| level + offset_dn);
        model.background_sd_dn = spread_dn.max(LEAST_DRIFT_SD * model.noise_sd_dn);
        model.uncertainty.background_dn = uncertainty::of_median(spread_dn, blocks);
    }

    /// Autocovariance at lags from 0, DN², and the number of samples; `None` with too few.
    fn autocovariance(&self, background: Background) -> Option<(Vec<f64>, u64)> {
        let mut variances: Vec<f64> = self.0.iter().map(QuietBlock::variance).collect();
        variances.sort_by(f64::total_cmp);
        let median = variances.get(variances.len() / 2)?.max(QUANTISATION_VARIANCE);
        let largest = LARGEST_VARIANCE * median;
        let mut statistics = NoiseStatistics::about(0.0);
        for block in self.0.iter().filter(|block| block.variance() <= largest) {
            block.stretches.iter().for_each(|(values, phase)| statistics.add(values, *phase));
        }
        if statistics.samples() < MIN_SAMPLES {
            return None;
        }
        let without_drift = match background {
            Background::PerWaveform => statistics.autocovariance_without_drift(),
            Background::Fixed => None,
        };
        let mut autocovariance = without_drift.unwrap_or_else(|| statistics.autocovariance());
        autocovariance[0] = autocovariance[0].max(QUANTISATION_VARIANCE);
        Some((autocovariance, statistics.samples()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibrate::calibrate;
    use crate::simulated::{Random, digitised, noise};

    /// Skewed pulses that begin 1.2 widths after the start of the block: no sample is free, and a
    /// Gaussian misses them by several standard deviations of the noise. The undershoot behind them
    /// is below the background.
    #[test]
    fn shape_error_is_neither_noise_nor_background() {
        const BACKGROUND_DN: f64 = 20.0;
        let process = ArNoise::new(&[0.6], 0.8).unwrap();
        let mut random = Random::new(71);
        let blocks: Vec<Vec<u16>> = (0..600)
            .map(|_| {
                let (height, peak) = (60.0 + 150.0 * random.uniform(), 18.0 + 4.0 * random.uniform());
                let drift_dn = 0.5 * random.normal();
                let mut values = noise(&mut random, &process, 110);
                for (k, value) in values.iter_mut().enumerate() {
                    let x = k as f64 - peak;
                    let width = if x < 0.0 { 6.0 } else { 9.0 };
                    let undershoot = 0.02 * (-0.5 * ((x - 40.0) / 5.0).powi(2)).exp();
                    *value +=
                        BACKGROUND_DN + drift_dn + height * ((-0.5 * (x / width).powi(2)).exp() - undershoot);
                }
                digitised(&values, 255)
            })
            .collect();
        let views = || blocks.iter().map(|samples| Waveform { samples });
        let settings = CalibrationSettings::echoes(1.0, 255.0);
        let with_misfit = calibrate(views(), &settings).unwrap();
        assert_eq!(with_misfit.provenance.noise, NoiseSource::Residuals);
        let model = separate_noise(views(), &with_misfit, &settings).unwrap();
        let exact = (process.sd().powi(2) + QUANTISATION_VARIANCE).sqrt();
        println!("{} with misfit, {} without, true {exact}", with_misfit.noise_sd_dn, model.noise_sd_dn);
        assert_eq!(model.provenance.noise, NoiseSource::QuietResiduals);
        assert!(with_misfit.noise_sd_dn > 2.0 * exact, "{}", with_misfit.noise_sd_dn);
        assert!((0.8..1.5).contains(&(model.noise_sd_dn / exact)), "{}", model.noise_sd_dn);
        assert!(with_misfit.pulse_shape_error > 0.01);
        let levels_dn = [&with_misfit, &model].map(|model| model.background_dn[0]);
        println!("background {levels_dn:?}, SD {}", model.background_sd_dn);
        assert!(levels_dn[0] < BACKGROUND_DN - 1.0, "{levels_dn:?}");
        assert!((levels_dn[1] - BACKGROUND_DN).abs() < 0.5, "{levels_dn:?}");
        assert!((0.3..1.5).contains(&model.background_sd_dn), "{}", model.background_sd_dn);
    }
}
