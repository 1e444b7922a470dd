//! Moments of the noise from stretches of signal-free samples.

/// Number of lags, 0 included.
const LAGS: usize = 6;
/// Samples that determine the level of a phase to a twentieth of the noise.
const MIN_PHASE_SAMPLES: u64 = 400;

/// Sums over sample pairs at one lag and phase of the earlier.
#[derive(Debug, Clone, Copy, Default)]
struct Pairs {
    count: u64,
    product: f64,
    earlier: f64,
    later: f64,
    squares: f64,
}

impl Pairs {
    /// Sum of products about the means `a` (earlier sample) and `b` (later).
    fn product_about(&self, a: f64, b: f64) -> f64 {
        self.product - b * self.earlier - a * self.later + a * b * self.count as f64
    }

    /// Sum of half the squared differences about the same means.
    fn half_difference_about(&self, a: f64, b: f64) -> f64 {
        let squares =
            self.squares - 2.0 * (a * self.earlier + b * self.later) + (a * a + b * b) * self.count as f64;
        0.5 * squares - self.product_about(a, b)
    }
}

/// Running sums over stretches of free samples.
///
/// They give the level by phase modulo 4, the autocovariance at lags 0 to 5, and the part of it due
/// to a drift of the level between stretches.
#[derive(Debug, Clone, Default)]
pub struct NoiseStatistics {
    /// Sums by lag and phase.
    pairs: [[Pairs; 4]; LAGS],
    /// Level subtracted before summation, DN; by default the first sample.
    origin_dn: Option<f64>,
    /// Half the squared differences of all pairs at larger lags.
    distant: f64,
    distant_pairs: f64,
}

impl NoiseStatistics {
    /// Creates statistics about an approximate level, which keeps the squares small.
    pub fn about(level_dn: f64) -> NoiseStatistics {
        NoiseStatistics { origin_dn: Some(level_dn), ..NoiseStatistics::default() }
    }

    /// Adds the sums of another object about the same level.
    pub fn merge(&mut self, other: &NoiseStatistics) {
        debug_assert_eq!(self.origin_dn, other.origin_dn);
        for (cell, more) in self.pairs.as_flattened_mut().iter_mut().zip(other.pairs.as_flattened()) {
            cell.count += more.count;
            cell.product += more.product;
            cell.earlier += more.earlier;
            cell.later += more.later;
            cell.squares += more.squares;
        }
        self.distant += other.distant;
        self.distant_pairs += other.distant_pairs;
    }

    /// Adds a stretch of consecutive samples of a block.
    ///
    /// `phase` is the index in the block of the first of them, modulo 4.
    pub fn add<T: Copy + Into<f64>>(&mut self, samples: &[T], phase: u8) {
        let Some(&first) = samples.first() else { return };
        let origin_dn = *self.origin_dn.get_or_insert(first.into());
        let value = |k: usize| samples[k].into() - origin_dn;
        let (mut sum, mut square, mut near) = (0.0, 0.0, 0.0);
        for k in 0..samples.len() {
            let later = value(k);
            sum += later;
            square += later * later;
            for lag in 0..LAGS.min(k + 1) {
                let earlier = value(k - lag);
                let cell = &mut self.pairs[lag][(usize::from(phase) + k - lag) % 4];
                cell.count += 1;
                cell.product += earlier * later;
                cell.earlier += earlier;
                cell.later += later;
                cell.squares += earlier * earlier + later * later;
                near += 0.5 * (later - earlier) * (later - earlier);
            }
        }
        if samples.len() > LAGS {
            // Over all pairs, the squared differences add up to n Σx² - (Σx)².
            self.distant += 0.5 * (samples.len() as f64 * square - sum * sum) - near;
            let beyond = (samples.len() - LAGS) as f64;
            self.distant_pairs += 0.5 * beyond * (beyond + 1.0);
        }
    }

    fn origin_dn(&self) -> f64 {
        self.origin_dn.unwrap_or(0.0)
    }

    /// Number of samples.
    pub fn samples(&self) -> u64 {
        self.pairs[0].iter().map(|cell| cell.count).sum()
    }

    /// Mean level by phase, DN.
    ///
    /// A phase with too few samples gets the level of its parity, because two interleaved
    /// converters make even and odd samples differ, or else of all samples; 0 without samples.
    pub fn background_dn(&self) -> [f64; 4] {
        let cells = &self.pairs[0];
        let level = |of: &[usize]| {
            let sum: f64 = of.iter().map(|&phase| cells[phase].earlier).sum();
            let count: u64 = of.iter().map(|&phase| cells[phase].count).sum();
            (count, self.origin_dn() + sum / count.max(1) as f64)
        };
        let (_, overall) = level(&[0, 1, 2, 3]);
        std::array::from_fn(|phase| {
            let known = [level(&[phase]), level(&[phase, (phase + 2) % 4])];
            known
                .into_iter()
                .find(|(count, _)| *count >= MIN_PHASE_SAMPLES)
                .map_or(overall, |(_, level)| level)
        })
    }

    /// Autocovariance about the phase means at lags 0 to 5, DN², drift included.
    ///
    /// Has as many lags as there are pairs for.
    pub fn autocovariance(&self) -> Vec<f64> {
        let lags = self.means(Pairs::product_about);
        if lags.is_empty() { vec![0.0] } else { lags }
    }

    /// Autocovariance without the contribution of a level drift, DN².
    ///
    /// The drift adds the same value at every lag. Differences within a stretch cancel the level;
    /// samples at larger lags than those kept are assumed uncorrelated. `None` if no stretch is
    /// long enough.
    pub(crate) fn autocovariance_without_drift(&self) -> Option<Vec<f64>> {
        if self.distant_pairs < 1.0 {
            return None;
        }
        let levels = self.background_dn();
        let mean = levels.iter().sum::<f64>() / 4.0;
        let of_phases = levels.iter().map(|l| (l - mean) * (l - mean)).sum::<f64>() / 4.0;
        let variance = self.distant / self.distant_pairs - of_phases;
        Some(self.means(Pairs::half_difference_about).iter().map(|half| variance - half).collect())
    }

    /// Mean over pairs, by lag, of a sum about the phase means.
    fn means(&self, sum_about: fn(&Pairs, f64, f64) -> f64) -> Vec<f64> {
        let means = self.background_dn().map(|level| level - self.origin_dn());
        self.pairs
            .iter()
            .enumerate()
            .map(|(lag, cells)| {
                let count: u64 = cells.iter().map(|cell| cell.count).sum();
                let sum = |(phase, cell)| sum_about(cell, means[phase], means[(phase + lag) % 4]);
                (count, cells.iter().enumerate().map(sum).sum::<f64>())
            })
            .take_while(|(count, _)| *count > 0)
            .map(|(count, sum)| sum / count as f64)
            .collect()
    }

    /// Variance of one sample, DN², drift included.
    pub fn variance(&self) -> f64 {
        self.autocovariance()[0]
    }

    /// Variance of the level between stretches, DN²; 0 if no stretch is long enough.
    pub(crate) fn drift_variance(&self) -> f64 {
        match self.autocovariance_without_drift() {
            Some(noise) => (self.variance() - noise[0]).max(0.0),
            None => 0.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::noise::ArNoise;
    use crate::simulated::{Random, digitised, noise};

    #[test]
    fn moments_of_stretches_by_hand() {
        let mut statistics = NoiseStatistics::default();
        statistics.add(&[5u16, 7, 6, 10], 2);
        assert_eq!(statistics.background_dn(), [7.0; 4]);
        assert_eq!(statistics.autocovariance(), [3.5, -1.0, 1.0, -6.0]);
        // Phases 2 3 0 1, each with its own mean; then deviations -2 0 -2 0 and 2 0 2 0.
        (1..400).for_each(|_| statistics.add(&[5u16, 7, 6, 10], 2));
        assert_eq!(statistics.background_dn(), [6.0, 10.0, 5.0, 7.0]);
        assert_eq!(statistics.autocovariance(), [0.0; 4]);
        (0..400).for_each(|_| statistics.add(&[9u16, 7, 10, 10], 2));
        assert_eq!(statistics.background_dn(), [8.0, 10.0, 7.0, 7.0]);
        assert_eq!(statistics.autocovariance(), [2.0, 0.0, 2.0, 0.0]);
        assert_eq!((statistics.samples(), statistics.drift_variance()), (3200, 0.0));
        assert_eq!(statistics.autocovariance_without_drift(), None);
    }

    /// Only the first two samples of each block are free: the third phase equals the first, the
    /// fourth the second.
    #[test]
    fn phases_that_are_not_seen_have_the_level_of_their_parity() {
        let mut statistics = NoiseStatistics::default();
        (0..400).for_each(|_| statistics.add(&[4u16, 9], 0));
        assert_eq!(statistics.background_dn(), [4.0, 9.0, 4.0, 9.0]);
    }

    #[test]
    fn noise_statistics_of_no_samples_are_none() {
        let mut statistics = NoiseStatistics::default();
        statistics.add::<u16>(&[], 0);
        assert_eq!(statistics.background_dn(), [0.0; 4]);
        assert_eq!((statistics.variance(), statistics.drift_variance()), (0.0, 0.0));
    }

    /// Rounding adds 1/12 DN² at lag 0 only (Widrow, Kollár 2008); a drift adds its variance at
    /// every lag.
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
        for (got, level) in stable.background_dn().iter().zip(levels) {
            assert!((got - 20.5 - level).abs() < 0.01, "{got} {level}");
        }
        let freed = drifting.autocovariance_without_drift().unwrap();
        for (lag, (got, exact)) in freed.iter().zip(exact).enumerate() {
            assert!((got - exact).abs() < 0.02 * noise_variance, "lag {lag}: {got} {exact}");
        }
        assert!(stable.drift_variance() < 0.005, "{}", stable.drift_variance());
        assert!((drifting.drift_variance() - 0.25).abs() < 0.01, "{}", drifting.drift_variance());
    }
}
