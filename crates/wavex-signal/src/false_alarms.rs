//! Expected rate of false returns from noise alone.
//!
//! Detection searches maxima of the matched-filter output, a stationary Gaussian process of unit
//! variance. The rate at which such a process crosses a threshold upwards follows from its
//! correlation alone. Maxima are interpolated between samples, so the rate is that of the continuous
//! output (Rice 1944, "Mathematical analysis of random noise", section 3.3).

use crate::noise::ArNoise;
use crate::shape::SD_OF_FWHM;

/// Matched-filter output for pure noise.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FilteredNoise {
    /// Root of minus the second derivative of its autocorrelation at lag 0, rad per sample.
    pub bandwidth_rad_per_sample: f64,
}

/// Half extent of the pulse, in standard deviations.
const REACH_SD: f64 = 7.0;

impl FilteredNoise {
    /// Output of the filter matched to a Gaussian pulse of this FWHM, samples, in this noise.
    pub fn of(fwhm_samples: f64, noise: &ArNoise) -> FilteredNoise {
        let sd = SD_OF_FWHM * fwhm_samples;
        let reach = (REACH_SD * sd).ceil() as i32;
        let pulse = |k: i32| (-0.5 * (f64::from(k) / sd).powi(2)).exp();
        let slope = |k: i32| -f64::from(k) / (sd * sd) * pulse(k);
        // The whitened pulse g and its derivative; white noise is unchanged.
        let whitened = |f: &dyn Fn(i32) -> f64, k: i32| {
            let past = noise.coefficients().iter().zip(1..).map(|(phi, lag)| phi * f(k - lag)).sum::<f64>();
            f(k) - past
        };
        let order = noise.order() as i32;
        let range = -reach..=reach + order;
        let sum = |term: &dyn Fn(i32) -> f64| range.clone().map(term).sum::<f64>();
        let energy = sum(&|k| whitened(&pulse, k).powi(2));
        let slope_energy = sum(&|k| whitened(&slope, k).powi(2));
        FilteredNoise { bandwidth_rad_per_sample: (slope_energy / energy).sqrt() }
    }

    /// Expected false maxima above `sigma` standard deviations in a waveform.
    ///
    /// It is the sum of the maxima of waveforms that start above the threshold and of Rice's rate of
    /// upward crossings.
    pub fn per_waveform(&self, sigma: f64, samples: f64) -> f64 {
        let rate = self.bandwidth_rad_per_sample / std::f64::consts::TAU * (-0.5 * sigma * sigma).exp();
        samples * rate + upper_tail(sigma)
    }
}

/// Probability that a standard normal variable exceeds `x`.
fn upper_tail(x: f64) -> f64 {
    0.5 * libm::erfc(x / std::f64::consts::SQRT_2)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise(coefficients: &[f64]) -> ArNoise {
        ArNoise::new(coefficients, 1.0).unwrap()
    }

    #[test]
    fn a_gaussian_in_white_noise_has_a_closed_form() {
        // The filter output has the autocorrelation of the pulse: exp(-t²/4s²).
        let filtered = FilteredNoise::of(4.253, &noise(&[]));
        let sd = SD_OF_FWHM * 4.253;
        assert!((filtered.bandwidth_rad_per_sample - 1.0 / (sd * 2f64.sqrt())).abs() < 1e-6);
    }

    #[test]
    fn probabilities_agree_with_tables() {
        assert!((upper_tail(4.5) / 3.397_673e-6 - 1.0).abs() < 1e-6);
    }

    #[test]
    fn correlation_makes_false_alarms_more_frequent() {
        let rate = |phi: f64| FilteredNoise::of(4.5, &noise(&[phi])).per_waveform(4.5, 60.0);
        assert!(rate(0.0) < rate(0.3) && rate(0.3) < rate(0.6));
        assert!((1.4e-4..1.8e-4).contains(&rate(0.0)), "{}", rate(0.0));
    }

    /// Filters simulated noise; returns the interpolated maxima per threshold.
    fn simulate(phi: &[f64], fwhm: f64, sigmas: &[f64], samples: usize) -> Vec<u64> {
        let sd = SD_OF_FWHM * fwhm;
        let pulse = |k: i32| (-0.5 * (f64::from(k) / sd).powi(2)).exp();
        // Noise is whitened before filtering, so white deviates are filtered with the whitened
        // pulse.
        let past = |k: i32| phi.iter().zip(1..).map(|(phi, lag)| phi * pulse(k - lag)).sum::<f64>();
        let taps: Vec<f64> = (-10..=10 + phi.len() as i32).map(|k| pulse(k) - past(k)).collect();
        let norm = taps.iter().map(|tap| tap * tap).sum::<f64>().sqrt();
        let mut random = crate::simulated::Random::new(5);
        let mut white: Vec<f64> = (0..taps.len()).map(|_| random.normal()).collect();
        let mut counts = vec![0; sigmas.len()];
        let (mut before, mut at) = (0.0, 0.0);
        for _ in 0..samples {
            white.rotate_left(1);
            white[taps.len() - 1] = random.normal();
            let after = white.iter().zip(&taps).map(|(x, tap)| x * tap).sum::<f64>() / norm;
            let is_peak = at > before && at >= after;
            let peak = at + (after - before).powi(2) / (8.0 * (2.0 * at - before - after)).max(1e-12);
            for (count, sigma) in counts.iter_mut().zip(sigmas) {
                *count += u64::from(is_peak && peak >= *sigma);
            }
            (before, at) = (at, after);
        }
        counts
    }

    #[test]
    fn simulated_noise_agrees_with_theory() {
        let samples = 20_000_000;
        let sigmas = [3.0, 3.5, 4.0, 4.5];
        for phi in [&[][..], &[0.6], &[0.65, -0.02, -0.06, 0.03]] {
            let filtered = FilteredNoise::of(4.5, &noise(phi));
            for (sigma, peaks) in sigmas.into_iter().zip(simulate(phi, 4.5, &sigmas, samples)) {
                let rice = filtered.per_waveform(sigma, samples as f64);
                let part = peaks as f64 / rice;
                println!("{phi:?} {sigma}: {peaks} maxima, {part:.3} of Rice's rate");
                // Two maxima may share one upward crossing: there are a few per cent fewer maxima
                // than crossings.
                let chance = 3.0 / rice.sqrt();
                assert!((part - 0.97).abs() <= 0.05 + chance, "{phi:?} {sigma}: {part}");
            }
        }
    }
}
