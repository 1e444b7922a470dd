//! Smoothing, and the variance of linear functions of correlated noise.

use crate::noise::ArNoise;

/// Half length of a kernel, SDs of its Gaussian.
const HALF_LENGTH_SDS: f64 = 4.0;

/// A symmetric Gaussian of sum 1.
pub(super) struct LinearKernel {
    weights: Vec<f64>,
}

impl LinearKernel {
    /// Of this full width at half maximum, samples.
    pub(super) fn of_fwhm(fwhm_samples: f64) -> LinearKernel {
        let sd_samples = fwhm_samples / (8.0 * 2f64.ln()).sqrt();
        let half = (HALF_LENGTH_SDS * sd_samples).ceil().max(1.0) as i32;
        let weight = |k: i32| (-0.5 * (f64::from(k) / sd_samples).powi(2)).exp();
        let sum: f64 = (-half..=half).map(weight).sum();
        LinearKernel { weights: (-half..=half).map(|k| weight(k) / sum).collect() }
    }

    pub(super) fn weights(&self) -> &[f64] {
        &self.weights
    }

    /// Smooths values that are 0 outside of the block.
    pub(super) fn smooth_into(&self, values: &[f64], smoothed: &mut Vec<f64>) {
        let half = self.weights.len() / 2;
        smoothed.clear();
        smoothed.extend((0..values.len()).map(|k| {
            let first = k.saturating_sub(half);
            let end = (k + half + 1).min(values.len());
            let weights = &self.weights[first + half - k..];
            values[first..end].iter().zip(weights).map(|(value, weight)| value * weight).sum::<f64>()
        }));
    }
}

/// Variance of the sum of the noise of consecutive samples with these weights, which are overwritten.
///
/// The noise of each sample is replaced by its innovation and the noise of the samples before it.
/// At least as many samples as the order of the noise.
pub(super) fn variance(noise: &ArNoise, weights: &mut [f64]) -> f64 {
    let order = noise.order().min(weights.len());
    let mut sum = 0.0;
    for k in (order..weights.len()).rev() {
        let weight = weights[k];
        sum += weight * weight;
        let before = weights[..k].iter_mut().rev();
        before.zip(noise.coefficients()).for_each(|(before, coefficient)| *before += coefficient * weight);
    }
    let mut autocovariance = [0.0; crate::noise::MAX_ORDER];
    noise.autocovariance_into(&mut autocovariance[..order]);
    let first = &weights[..order];
    let of_first: f64 = (0..order)
        .flat_map(|i| (0..order).map(move |j| (i, j)))
        .map(|(i, j)| first[i] * first[j] * autocovariance[i.abs_diff(j)])
        .sum();
    sum * noise.innovation_variance() + of_first
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn variance_is_that_of_the_covariance_matrix() {
        let noise = ArNoise::new(&[0.6, -0.3], 1.3).unwrap();
        let weights: Vec<f64> = (0..20).map(|k| (0.7 * f64::from(k)).sin() + 0.2).collect();
        let mut autocovariance = [0.0; 20];
        noise.autocovariance_into(&mut autocovariance);
        let product = |i: usize, j: usize| weights[i] * weights[j] * autocovariance[i.abs_diff(j)];
        let expected: f64 =
            (0..20).flat_map(|i| (0..20).map(move |j| (i, j))).map(|(i, j)| product(i, j)).sum();
        assert!((variance(&noise, &mut weights.clone()) / expected - 1.0).abs() < 1e-9);
    }

    #[test]
    fn smoothing_keeps_sums_and_centres() {
        let mut smoothed = Vec::new();
        let mut values = vec![0.0; 60];
        values[30] = 2.0;
        LinearKernel::of_fwhm(6.0).smooth_into(&values, &mut smoothed);
        let centre: f64 = smoothed.iter().enumerate().map(|(k, dn)| k as f64 * dn).sum();
        assert!((smoothed.iter().sum::<f64>() - 2.0).abs() < 1e-12 && (centre - 60.0).abs() < 1e-9);
        assert!((smoothed[33] / smoothed[30] - 0.5).abs() < 1e-3);
    }
}
