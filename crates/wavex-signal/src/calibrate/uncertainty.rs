//! Uncertainty of a model from the amount of data.

use super::pass_stats::PassStats;
use crate::sensor_model::{ChannelModel, ModelUncertainty};

/// SD of the median of normal values, times the root of the count, in their SD: `√(π/2)`.
const SPREAD_OF_MEDIAN: f64 = 1.253_314_137_315_500_3;

/// Uncertainty of background and noise estimated from residuals: medians over the blocks.
pub(super) fn of_residuals(model: &ChannelModel, survey: &PassStats) -> ModelUncertainty {
    ModelUncertainty {
        background_dn: of_median(model.background_sd_dn, survey.blocks),
        noise_sd_dn: of_median(survey.residual_spread() * model.noise_sd_dn, survey.blocks),
        ..ModelUncertainty::default()
    }
}

/// SD of the median of values with this spread.
pub(super) fn of_median(spread: f64, values: u64) -> f64 {
    SPREAD_OF_MEDIAN * spread / (values.max(1) as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use crate::calibrate::{CalibrationSettings, calibrate};
    use crate::decompose::Waveform;
    use crate::noise::ArNoise;
    use crate::simulated::{Random, analogue, digitised, moments, pulse};

    /// For a mean it is the standard error of the mean.
    #[test]
    fn the_jackknife_of_a_mean_is_its_standard_error() {
        let values = [3.0, 5.0, 4.0, 9.0];
        let without: Vec<f64> = values.iter().map(|value| (21.0 - value) / 3.0).collect();
        assert!((super::super::jackknife_sd(&without) - moments(&values).1 / 2.0).abs() < 1e-12);
        assert_eq!(super::super::jackknife_sd(&[]), 0.0);
    }

    /// Sixty recordings of one sensor: the spread of the estimates equals the reported uncertainty.
    #[test]
    fn models_of_repeated_recordings_spread_as_they_say() {
        let mut random = Random::new(77);
        let process = ArNoise::new(&[0.6], 0.7).unwrap();
        let mut values: [Vec<f64>; 5] = Default::default();
        let mut reported: [Vec<f64>; 5] = Default::default();
        for _ in 0..60 {
            let blocks: Vec<Vec<u16>> = (0..250)
                .map(|_| {
                    let echo = pulse(40.0 + 100.0 * random.uniform(), 24.0 + 4.0 * random.uniform(), 1.0);
                    digitised(&analogue(&mut random, &process, 44, 20.3, 4.4, &[echo]), 255)
                })
                .collect();
            let blocks = blocks.iter().map(|samples| Waveform { samples });
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
                reported[k].push(sd);
            }
        }
        for (k, (values, reported)) in values.iter().zip(&reported).enumerate() {
            let (spread, reported) = (moments(values).1, moments(reported).0);
            println!("{k}: spread {spread:.5}, reported {reported:.5}");
            // The relative uncertainty of an SD of sixty values is 9 %.
            assert!((0.7..1.35).contains(&(spread / reported)), "{k}: {spread} {reported}");
        }
    }
}
