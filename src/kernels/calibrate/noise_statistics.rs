//! Moments of the noise from stretches of samples that are free of signal.

/// Lags at which products are kept, 0 included.
const LAGS: usize = 6;

/// Sums of one lag and one phase of the earlier sample.
#[derive(Debug, Clone, Copy, Default)]
struct Products {
    count: u64,
    product: f64,
    earlier: f64,
    later: f64,
}

/// Running sums over stretches of free samples: level by phase modulo 4, autocovariance at lags 0 to 5, and the
/// drift from stretch to stretch.
#[derive(Debug, Clone, Default)]
pub struct NoiseStatistics {
    /// By lag and phase.
    products: [[Products; 4]; LAGS],
    /// Level that sums are taken about, so that squares stay small.
    origin_dn: f64,
    /// Products of all pairs of a stretch farther apart than the lags kept.
    distant: f64,
    distant_pairs: f64,
}

impl NoiseStatistics {
    /// Adds a stretch of consecutive samples; `start_phase` is the index of the first modulo 4.
    pub fn add(&mut self, samples: &[u16], start_phase: u8) {
        if self.samples() == 0 {
            self.origin_dn = samples.first().map_or(0.0, |&s| f64::from(s));
        }
        let value = |k: usize| f64::from(samples[k]) - self.origin_dn;
        let (mut sum, mut near, mut square) = (0.0, 0.0, 0.0);
        for (k, _) in samples.iter().enumerate() {
            let later = value(k);
            sum += later;
            square += later * later;
            for lag in 0..LAGS.min(k + 1) {
                let earlier = value(k - lag);
                let phase = (usize::from(start_phase) + k - lag) % 4;
                let cell = &mut self.products[lag][phase];
                cell.count += 1;
                cell.product += earlier * later;
                cell.earlier += earlier;
                cell.later += later;
                near += if lag > 0 { earlier * later } else { 0.0 };
            }
        }
        if samples.len() > LAGS {
            let beyond = (samples.len() - LAGS) as f64;
            self.distant += 0.5 * (sum * sum - square) - near;
            self.distant_pairs += 0.5 * beyond * (beyond + 1.0);
        }
    }

    /// Samples seen.
    pub fn samples(&self) -> u64 {
        self.products[0].iter().map(|cell| cell.count).sum()
    }

    /// Mean level by phase, DN; `otherwise` for phases without a sample.
    pub fn background_dn(&self, otherwise: [f64; 4]) -> [f64; 4] {
        let mut levels = otherwise;
        for (level, cell) in levels.iter_mut().zip(&self.products[0]) {
            if cell.count > 0 {
                *level = self.origin_dn + cell.earlier / cell.count as f64;
            }
        }
        levels
    }

    /// Autocovariance about the phases' means at lags 0 to 5, DN²; as many lags as there are pairs for.
    pub fn autocovariance(&self) -> Vec<f64> {
        let means = self.background_dn([self.origin_dn; 4]).map(|level| level - self.origin_dn);
        let mut out = Vec::with_capacity(LAGS);
        for (lag, cells) in self.products.iter().enumerate() {
            let count: u64 = cells.iter().map(|cell| cell.count).sum();
            if count == 0 {
                break;
            }
            let mut sum = 0.0;
            for (phase, cell) in cells.iter().enumerate() {
                let (a, b) = (means[phase], means[(phase + lag) % 4]);
                sum += cell.product - b * cell.earlier - a * cell.later + a * b * cell.count as f64;
            }
            out.push(sum / count as f64);
        }
        if out.is_empty() { vec![0.0] } else { out }
    }

    /// Variance of one sample, DN².
    pub fn variance(&self) -> f64 {
        self.autocovariance()[0]
    }

    /// Variance of the level from stretch to stretch, DN²: what samples farther apart than the noise's correlation
    /// still have in common. 0 where no stretch is that long.
    pub fn drift_variance(&self) -> f64 {
        if self.distant_pairs < 1.0 {
            return 0.0;
        }
        let cells = &self.products[0];
        let mean = cells.iter().map(|c| c.earlier).sum::<f64>() / self.samples() as f64;
        (self.distant / self.distant_pairs - mean * mean).max(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels::noise::ArNoise;
    use crate::kernels::simulated::{Random, digitised, noise};

    #[test]
    fn moments_of_a_stretch_by_hand() {
        let mut statistics = NoiseStatistics::default();
        statistics.add(&[5, 7, 6, 10], 2); // phases 2 3 0 1: each its own mean
        assert_eq!(statistics.background_dn([0.0; 4]), [6.0, 10.0, 5.0, 7.0]);
        assert_eq!(statistics.autocovariance(), [0.0; 4]);
        statistics.add(&[9, 7, 10, 10], 2); // deviations -2 0 -2 0, then 2 0 2 0
        assert_eq!(statistics.background_dn([0.0; 4]), [8.0, 10.0, 7.0, 7.0]);
        assert_eq!(statistics.autocovariance(), [2.0, 0.0, 2.0, 0.0]);
        assert_eq!(statistics.samples(), 8);
        assert_eq!(statistics.drift_variance(), 0.0);
    }

    #[test]
    fn without_samples_nothing_is_told() {
        let mut statistics = NoiseStatistics::default();
        statistics.add(&[], 0);
        assert_eq!(statistics.background_dn([1.0, 2.0, 3.0, 4.0]), [1.0, 2.0, 3.0, 4.0]);
        assert_eq!((statistics.variance(), statistics.drift_variance()), (0.0, 0.0));
    }

    /// Rounding adds 1/12 DN² at lag 0 and nothing elsewhere (Widrow, Kollár 2008), a drift its variance at every lag.
    #[test]
    fn digitised_noise_has_the_closed_forms_of_its_process() {
        let process = ArNoise::new(&[0.7, -0.2], 0.9).unwrap();
        let mut exact = [0.0; 6];
        process.autocovariance_into(&mut exact);
        let mut random = Random::new(3);
        let levels = [0.3, -0.1, 0.2, 0.0];
        let mut stable = NoiseStatistics::default();
        let mut drifting = NoiseStatistics::default();
        for block in 0..20_000u32 {
            let phase = (block % 4) as u8;
            let mut values = noise(&mut random, &process, 16);
            for (k, value) in values.iter_mut().enumerate() {
                *value += 20.5 + levels[(usize::from(phase) + k) % 4];
            }
            stable.add(&digitised(&values, 255), phase);
            let drift = 0.5 * random.normal();
            values.iter_mut().for_each(|v| *v += drift);
            drifting.add(&digitised(&values, 255), phase);
        }
        let noise_variance = exact[0];
        exact[0] += 1.0 / 12.0;
        for (lag, (got, exact)) in stable.autocovariance().iter().zip(exact).enumerate() {
            assert!((got - exact).abs() < 0.012 * noise_variance, "lag {lag}: {got} {exact}");
        }
        for (lag, (got, exact)) in drifting.autocovariance().iter().zip(exact).enumerate() {
            assert!((got - exact - 0.25).abs() < 0.02 * noise_variance, "lag {lag}: {got} {exact}");
        }
        for (got, level) in stable.background_dn([0.0; 4]).iter().zip(levels) {
            assert!((got - 20.5 - level).abs() < 0.01, "{got} {level}");
        }
        assert!(stable.drift_variance() < 0.005, "{}", stable.drift_variance());
        assert!((drifting.drift_variance() - 0.25).abs() < 0.01, "{}", drifting.drift_variance());
    }
}
