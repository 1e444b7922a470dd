//! Filters in single precision: smoothing with a Gaussian, its complement, and what smoothing leaves of correlated noise.

/// Half length of a kernel, SDs of its Gaussian.
const HALF_LENGTH_SDS: f64 = 4.0;

/// A symmetric kernel.
#[derive(Clone, Debug)]
pub(super) struct Kernel {
    /// Weight of the centre, then of the neighbours at distance 1, 2, …
    weights: Vec<f32>,
}

impl Kernel {
    /// A Gaussian of sum 1 and this standard deviation, samples; positive.
    pub(super) fn of_sd(sd_samples: f64) -> Kernel {
        let half = (HALF_LENGTH_SDS * sd_samples).ceil().max(1.0) as i32;
        let weight = |k: i32| libm::exp(-0.5 * (f64::from(k) / sd_samples).powi(2));
        let sum: f64 = (-half..=half).map(weight).sum();
        Kernel { weights: (0..=half).map(|k| (weight(k) / sum) as f32).collect() }
    }

    /// What is left when a Gaussian of this standard deviation, samples, is removed `order` times: `(1 - G)^order`.
    pub(super) fn high_pass(sd_samples: f64, order: u32) -> Kernel {
        let half = (HALF_LENGTH_SDS * sd_samples * f64::from(order).sqrt()).ceil() as i32;
        // Binomial terms; the Gaussian of k passes is wider by the root of k.
        let (mut weights, mut binomial) = (vec![0.0; half as usize + 1], 1.0);
        for passes in 1..=order {
            binomial *= -f64::from(order + 1 - passes) / f64::from(passes);
            let weight =
                |k: i32| libm::exp(-0.5 * f64::from(k).powi(2) / (sd_samples.powi(2) * f64::from(passes)));
            let sum: f64 = (-half..=half).map(weight).sum();
            (0..=half).zip(&mut weights).for_each(|(k, total)| *total += binomial * weight(k) / sum);
        }
        weights.iter_mut().take(1).for_each(|centre| *centre += 1.0);
        Kernel { weights: weights.into_iter().map(|weight| weight as f32).collect() }
    }

    /// Filters values that continue as 0 beyond their ends.
    ///
    /// One pass per distance, because such loops become vector instructions of any processor with the
    /// same result.
    pub(super) fn smooth_into(&self, values: &[f32], smoothed: &mut Vec<f32>) {
        smoothed.clear();
        let Some((centre, sides)) = self.weights.split_first() else { return };
        smoothed.extend(values.iter().map(|value| centre * value));
        for (distance, weight) in (1..).zip(sides) {
            let Some(later) = values.get(distance..) else { break };
            smoothed.iter_mut().zip(later).for_each(|(sum, value)| *sum += weight * value);
            let shifted = smoothed.get_mut(distance..).unwrap_or_default();
            shifted.iter_mut().zip(values).for_each(|(sum, value)| *sum += weight * value);
        }
    }

    /// Weight at a distance from the centre.
    fn at(&self, distance: usize) -> f64 {
        self.weights.get(distance).copied().map_or(0.0, f64::from)
    }

    /// Autocorrelation of the noise of this autocorrelation (lag 0 first) after smoothing, at lags 0, 1, …;
    /// relative to the variance before.
    pub(super) fn autocorrelation_after(&self, before: &[f64], lags: usize) -> Vec<f64> {
        let half = self.weights.len() as i64 - 1;
        let weight = |k: i64| self.at(k.unsigned_abs() as usize);
        let own = |lag: i64| (-half..=half).map(|k| weight(k) * weight(k + lag)).sum::<f64>();
        let own: Vec<f64> = (0..2 * half + 1 + before.len() as i64 + lags as i64).map(own).collect();
        let of_kernel = |lag: i64| own.get(lag.unsigned_abs() as usize).copied().unwrap_or(0.0);
        let of_noise = |lag: i64| before.get(lag.unsigned_abs() as usize).copied().unwrap_or(0.0);
        let reach = before.len() as i64;
        let at = |lag: i64| (-reach..=reach).map(|k| of_noise(k) * of_kernel(lag + k)).sum();
        (0..lags as i64).map(at).collect()
    }
}

/// A kernel with the noise that it leaves, relative to that of a sample.
pub(super) struct Smoother {
    pub(super) kernel: Kernel,
    /// Standard deviation of a smoothed sample.
    pub(super) sd: f64,
    /// Standard deviation of half the difference of its neighbours.
    pub(super) slope_sd: f64,
    pub(super) values_dn: Vec<f32>,
}

impl Smoother {
    pub(super) fn new(sd_samples: f64, autocorrelation: &[f64]) -> Smoother {
        let kernel = Kernel::of_sd(sd_samples);
        let left = kernel.autocorrelation_after(autocorrelation, 3);
        let [own, _, second] = [0, 1, 2].map(|lag| left.get(lag).copied().unwrap_or(0.0));
        Smoother {
            kernel,
            sd: own.max(0.0).sqrt(),
            slope_sd: (0.5 * (own - second)).max(0.0).sqrt(),
            values_dn: Vec::new(),
        }
    }

    pub(super) fn smooth(&mut self, samples: &[f32]) {
        self.kernel.smooth_into(samples, &mut self.values_dn);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn smoothing_keeps_sums_and_centres() {
        let mut values = vec![0.0; 61];
        values[30] = 2.0;
        let mut smoothed = Vec::new();
        Kernel::of_sd(3.0).smooth_into(&values, &mut smoothed);
        let sum: f32 = smoothed.iter().sum();
        let centre: f32 = smoothed.iter().zip(0u8..).map(|(dn, k)| dn * f32::from(k)).sum();
        assert!((sum - 2.0).abs() < 1e-5 && (centre / sum - 30.0).abs() < 1e-4);
        assert!((smoothed[33] / smoothed[30] - 0.60653).abs() < 1e-4, "one SD from the centre");
    }

    #[test]
    fn short_waveforms_are_smoothed_too() {
        let mut smoothed = Vec::new();
        let kernel = Kernel::of_sd(6.5);
        kernel.smooth_into(&[1.0, 1.0], &mut smoothed);
        assert!(smoothed.len() == 2 && smoothed[0] < 0.2);
        kernel.smooth_into(&[], &mut smoothed);
        assert!(smoothed.is_empty());
    }

    /// A wide Gaussian passes none of it, an impulse nearly all.
    #[test]
    fn a_high_pass_removes_what_is_smooth() {
        let bell: Vec<f32> =
            (0..200).map(|k| 500.0 * (-0.5 * ((k as f32 - 100.3) / 6.6).powi(2)).exp()).collect();
        let mut left = Vec::new();
        let kernel = Kernel::high_pass(2.0, 6);
        kernel.smooth_into(&bell, &mut left);
        let largest = left.iter().fold(0.0f32, |largest, dn| largest.max(dn.abs()));
        assert!(largest < 0.2, "{largest}");
        let mut impulse = vec![0.0; 101];
        impulse[50] = 1.0;
        kernel.smooth_into(&impulse, &mut left);
        let sum: f32 = left.iter().sum();
        assert!(sum.abs() < 1e-4 && left[50] > 0.4, "{sum} {}", left[50]);
    }

    /// White noise keeps the sum of the squared weights; smooth noise keeps more.
    #[test]
    fn the_noise_left_follows_from_its_correlation() {
        let kernel = Kernel::of_sd(6.5);
        let squares: f64 = (-26..=26i64).map(|k| kernel.at(k.unsigned_abs() as usize).powi(2)).sum();
        let white = kernel.autocorrelation_after(&[1.0], 3);
        assert!((white[0] / squares - 1.0).abs() < 1e-9 && white[1] < white[0]);
        let smooth = kernel.autocorrelation_after(&[1.0, 0.9, 0.7, 0.4], 1);
        assert!((smooth[0] / (5.0 * white[0]) - 1.0).abs() < 0.03);
    }
}
