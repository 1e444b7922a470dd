//! How well a model is known, from how much it was found from.

use super::survey::Survey;
use crate::kernels::sensor_model::{ChannelModel, ModelUncertainty};

/// Lags at which the correlation of the noise is summed up.
const LAGS: usize = 64;
/// The mode of a normal distribution, found as the mean of the window of 1.5 standard deviations about itself, spreads by so
/// many standard deviations over the root of the count: `√(0.552/0.866)/(1 - 0.448)`, with 0.866 of the values in the window,
/// 0.552 their variance, and 0.448 the part of a shift that the window takes back into the mean.
const SPREAD_OF_MODE: f64 = 1.446;
/// The same for a median: `√(π/2)`.
const SPREAD_OF_MEDIAN: f64 = 1.253_314_137_315_500_3;

/// Of a model made from samples that are free of signal: `L` is the mean length of their stretches, `n` their number, `ρ_k`
/// the correlation of the fitted noise.
///
/// - Level of a phase: `σ² (4/n) (1 + 2 Σ_j (1 - 4j/L) ρ_4j)`, and the variance of the drift over the blocks.
/// - Noise: `σ² (1 + 2 Σ_k (1 - k/L) ρ_k²) / 2n`, the variance of a standard deviation of correlated normal values.
/// - Correlation: Bartlett's formula (1946) with `n (1 - k/L)` pairs.
pub(super) fn of_free_samples(model: &ChannelModel, survey: &Survey) -> ModelUncertainty {
    let Ok(noise) = model.noise() else { return ModelUncertainty::default() };
    let (samples, blocks) = (survey.noise.samples().max(1) as f64, survey.blocks.max(1) as f64);
    let length = (samples / blocks).max(1.0);
    let mut rho = vec![0.0; LAGS];
    noise.autocovariance_into(&mut rho);
    let variance = rho[0];
    rho.iter_mut().for_each(|r| *r /= variance);
    let part = |lag: usize| (1.0 - lag as f64 / length).max(0.0);
    let of_phase: f64 = (4..LAGS).step_by(4).map(|lag| 2.0 * part(lag) * rho[lag]).sum();
    let of_square: f64 = (1..LAGS).map(|lag| 2.0 * part(lag) * rho[lag].powi(2)).sum();
    let drift = model.background_sd_dn.powi(2) / blocks;
    let of_lag = |lag: usize| (bartlett(&rho, lag) / (samples * part(lag)).max(1.0)).sqrt();
    ModelUncertainty {
        background_dn: (variance * 4.0 / samples * (1.0 + of_phase) + drift).sqrt(),
        noise_sd_dn: (variance * (1.0 + of_square) / (2.0 * samples)).sqrt(),
        autocorrelation: (1..=model.autocorrelation.len()).map(of_lag).collect(),
        ..of_width(model)
    }
}

/// Of a model made from what fits leave: medians over the blocks.
pub(super) fn of_residuals(model: &ChannelModel, survey: &Survey) -> ModelUncertainty {
    let of_median = |spread: f64| SPREAD_OF_MEDIAN * spread / (survey.blocks.max(1) as f64).sqrt();
    ModelUncertainty {
        background_dn: of_median(model.background_sd_dn),
        noise_sd_dn: of_median(survey.residual_spread() * model.noise_sd_dn),
        ..of_width(model)
    }
}

/// The width is the mode of as many.
fn of_width(model: &ChannelModel) -> ModelUncertainty {
    let pulses = (model.pulses.max(1) as f64).sqrt();
    ModelUncertainty {
        pulse_fwhm_ns: SPREAD_OF_MODE * model.pulse_fwhm_sd_ns / pulses,
        ..ModelUncertainty::default()
    }
}

/// `n` times the variance of the correlation measured at a lag of a process with the correlation `rho`.
fn bartlett(rho: &[f64], lag: usize) -> f64 {
    let at = |m: i64| rho.get(m.unsigned_abs() as usize).copied().unwrap_or(0.0);
    let (k, reach) = (lag as i64, rho.len() as i64);
    let of_k = at(k);
    let term = |m: i64| {
        at(m).powi(2) + at(m - k) * at(m + k) - 4.0 * of_k * at(m) * at(m - k) + 2.0 * (at(m) * of_k).powi(2)
    };
    (-reach..=reach).map(term).sum::<f64>().max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels::calibrate::{Block, CalibrationSettings, calibrate};
    use crate::kernels::noise::ArNoise;
    use crate::kernels::simulated::{Random, analogue, digitised, moments, pulse};

    /// Of white noise every correlation is known to `1/√n`; of a process of order 1 the first to `√((1 - φ²)/n)`.
    #[test]
    fn bartletts_formula_has_its_closed_forms() {
        let mut white = [0.0; LAGS];
        white[0] = 1.0;
        assert_eq!([1, 2, 5].map(|lag| bartlett(&white, lag)), [1.0; 3]);
        let ar: Vec<f64> = (0..LAGS as i32).map(|lag| 0.6f64.powi(lag)).collect();
        assert!((bartlett(&ar, 1) - 0.64).abs() < 1e-9, "{}", bartlett(&ar, 1));
    }

    /// Sixty recordings of the same sensor: what is told of them spreads as each of them says.
    #[test]
    fn models_of_repeated_recordings_spread_as_they_say() {
        let mut random = Random::new(77);
        let process = ArNoise::new(&[0.6], 0.7).unwrap();
        let mut values: [Vec<f64>; 5] = Default::default();
        let mut told: [Vec<f64>; 5] = Default::default();
        for _ in 0..60 {
            let blocks: Vec<Vec<u16>> = (0..250)
                .map(|_| {
                    let echo = pulse(40.0 + 100.0 * random.uniform(), 24.0 + 4.0 * random.uniform(), 1.0);
                    digitised(&analogue(&mut random, &process, 44, 20.3, 4.4, &[echo]), 255)
                })
                .collect();
            let blocks = blocks.iter().map(|samples| Block { samples, start_phase: 0 });
            let model = calibrate(blocks, &CalibrationSettings::echoes(1.0, 255.0)).unwrap();
            let known = &model.uncertainty;
            let pairs = [
                (model.background_dn[1], known.background_dn),
                (model.noise_sd_dn, known.noise_sd_dn),
                (model.autocorrelation[0], known.autocorrelation[0]),
                (model.autocorrelation[2], known.autocorrelation[2]),
                (model.pulse_fwhm_ns, known.pulse_fwhm_ns),
            ];
            for (k, (value, sd)) in pairs.into_iter().enumerate() {
                values[k].push(value);
                told[k].push(sd);
            }
        }
        for (k, (values, told)) in values.iter().zip(&told).enumerate() {
            let (spread, told) = (moments(values).1, moments(told).0);
            println!("{k}: spread {spread:.5}, told {told:.5}");
            // A spread of sixty is known to 9 %.
            assert!((0.7..1.35).contains(&(spread / told)), "{k}: {spread} {told}");
        }
    }
}
