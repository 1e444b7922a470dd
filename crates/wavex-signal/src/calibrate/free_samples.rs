//! Background and noise from samples free of pulses, and their uncertainty.

use super::noise_statistics::NoiseStatistics;
use super::sign_flip::{Lean, Mirror, part_left};
use super::{GROUPS, QUANTISATION_VARIANCE, jackknife_sd};
use crate::sensor_model::{Background, ChannelModel, ModelError, ModelUncertainty};

/// Additive statistics.
#[derive(Debug, Clone)]
struct Sums {
    /// All free samples.
    all: NoiseStatistics,
    /// If noise can be mirrored: the same with stretches with a peak replaced by mirrored stretches
    /// with a dip.
    noise: NoiseStatistics,
    /// The same for stretches with neither, which give the level; mirrored pairs do not.
    level: NoiseStatistics,
}

/// Background and noise.
#[derive(Debug, Clone)]
pub(super) struct NoiseEstimate {
    /// By phase, DN.
    pub(super) background_dn: [f64; 4],
    /// Autocovariance at lags from 0, DN², without the variance taken up by a free background.
    pub(super) autocovariance: Vec<f64>,
}

/// Free samples of a pass.
#[derive(Debug, Clone)]
pub(super) struct FreeSamples {
    mirror: Option<Mirror>,
    background: Background,
    blocks_per_group: u64,
    blocks: u64,
    groups: Vec<Sums>,
    /// Value subtracted from every sample before summation, DN.
    origin_dn: f64,
}

impl Sums {
    fn about(origin_dn: f64) -> Sums {
        let statistics = NoiseStatistics::about(origin_dn);
        Sums { all: statistics.clone(), noise: statistics.clone(), level: statistics }
    }

    fn merge(mut self, other: &Sums) -> Sums {
        self.all.merge(&other.all);
        self.noise.merge(&other.noise);
        self.level.merge(&other.level);
        self
    }

    fn estimate(&self, background: Background) -> NoiseEstimate {
        let all = |autocovariance| NoiseEstimate { background_dn: self.all.background_dn(), autocovariance };
        if background == Background::PerWaveform {
            // The free background removes the drift, so it does not count as noise.
            let without = self.all.autocovariance_without_drift();
            return all(without.unwrap_or_else(|| self.all.autocovariance()));
        }
        if self.level.samples() == 0 {
            return all(self.all.autocovariance());
        }
        let background_dn = self.level.background_dn();
        let mut autocovariance = self.noise.autocovariance();
        // Both truncations reduce all lags by nearly the same fraction.
        let part = part_left(autocovariance[0], background_dn.iter().sum::<f64>() / 4.0);
        autocovariance.iter_mut().for_each(|value| *value /= part);
        NoiseEstimate { background_dn, autocovariance }
    }
}

impl FreeSamples {
    /// Starts statistics for `blocks` blocks, with the current model of the channel.
    pub(super) fn of(model: &ChannelModel, blocks: u64) -> Result<FreeSamples, ModelError> {
        Ok(FreeSamples {
            mirror: Mirror::new(model)?,
            background: model.background,
            blocks_per_group: blocks.div_ceil(GROUPS as u64).max(1),
            blocks: 0,
            groups: Vec::new(),
            origin_dn: model.background_dn[0],
        })
    }

    /// Adds the free samples of the next block, possibly none.
    pub(super) fn add(&mut self, samples: &[u16]) {
        let group = (self.blocks / self.blocks_per_group) as usize;
        self.blocks += 1;
        if self.groups.len() <= group {
            self.groups.push(Sums::about(self.origin_dn));
        }
        let Some(sums) = self.groups.last_mut() else { return };
        sums.all.add(samples, 0);
        let Some(mirror) = &mut self.mirror else { return };
        // A stretch with a dip counts as recorded and mirrored, in place of one with a peak.
        mirror.stretches(samples, |lean, stretch, mirrored, phase| {
            if lean != Lean::Peak {
                sums.noise.add(stretch, phase);
            }
            match lean {
                Lean::Neither => sums.level.add(stretch, phase),
                Lean::Dip => sums.noise.add(mirrored, phase),
                Lean::Peak => {}
            }
        });
    }

    fn sums_but(&self, left_out: Option<usize>) -> Sums {
        let kept = self.groups.iter().enumerate().filter(|(i, _)| Some(*i) != left_out);
        kept.fold(Sums::about(self.origin_dn), |sums, (_, group)| sums.merge(group))
    }

    /// Number of samples.
    pub(super) fn samples(&self) -> u64 {
        self.groups.iter().map(|group| group.all.samples()).sum()
    }

    /// Background and noise from all groups.
    pub(super) fn estimate(&self) -> NoiseEstimate {
        self.sums_but(None).estimate(self.background)
    }

    /// Variance of one sample, and of the level between blocks, DN².
    pub(super) fn variance_and_drift(&self) -> (f64, f64) {
        let all = self.sums_but(None).all;
        (all.variance(), all.drift_variance())
    }

    /// Standard deviations of level, noise and correlations by the jackknife over groups (Tukey
    /// 1958).
    ///
    /// Changes along the recording count as well as chance.
    pub(super) fn uncertainty(&self) -> ModelUncertainty {
        let seen = (0..self.groups.len()).filter(|&i| self.groups[i].all.samples() > 0);
        let without: Vec<NoiseEstimate> =
            seen.map(|i| self.sums_but(Some(i)).estimate(self.background)).collect();
        let spread = |value: &dyn Fn(&NoiseEstimate) -> f64| {
            jackknife_sd(&without.iter().map(value).collect::<Vec<_>>())
        };
        let of_phases: f64 =
            (0..4).map(|phase| spread(&|estimate| estimate.background_dn[phase]).powi(2)).sum();
        let lags = without.iter().map(|estimate| estimate.autocovariance.len()).min().unwrap_or(1);
        let variance = |estimate: &NoiseEstimate| estimate.autocovariance[0].max(QUANTISATION_VARIANCE);
        let correlation =
            |estimate: &NoiseEstimate, lag: usize| estimate.autocovariance[lag] / variance(estimate);
        ModelUncertainty {
            background_dn: (of_phases / 4.0).sqrt(),
            noise_sd_dn: spread(&|estimate| variance(estimate).sqrt()),
            autocorrelation: (1..lags).map(|lag| spread(&|estimate| correlation(estimate, lag))).collect(),
            ..ModelUncertainty::default()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::noise::ArNoise;
    use crate::simulated::{Random, channel, digitised, noise};

    /// Pure noise on levels far from 0 and two standard deviations above it, with 26 and with 8
    /// free samples per block.
    #[test]
    fn mere_noise_is_not_biased() {
        for (level, length, seed) in [(20.3, 26, 7), (2.2, 26, 8), (20.3, 8, 9)] {
            let process = ArNoise::new(&[0.6, 0.05], 0.7).unwrap();
            let model = channel(&process, 4.4, level);
            let mut free = FreeSamples::of(&model, 20_000).unwrap();
            let mut random = Random::new(seed);
            for _ in 0..20_000 {
                let mut values = noise(&mut random, &process, length);
                values.iter_mut().for_each(|value| *value += level);
                free.add(&digitised(&values, 255));
            }
            let mut exact = [0.0; 6];
            process.autocovariance_into(&mut exact);
            exact[0] += QUANTISATION_VARIANCE;
            let (estimate, known) = (free.estimate(), free.uncertainty());
            let got = &estimate.autocovariance;
            println!("{level}: {got:?} {exact:?} {known:?}");
            assert!(((got[0] / exact[0]).sqrt() - 1.0).abs() < 0.015, "{level}: {got:?} {exact:?}");
            for lag in 1..6 {
                let (got, exact) = (got[lag] / got[0], exact[lag] / exact[0]);
                assert!((got - exact).abs() < 0.02, "{level}, lag {lag}: {got} {exact}");
            }
            assert!(estimate.background_dn.iter().all(|got| (got - level).abs() < 0.1), "{estimate:?}");
            assert_eq!((free.samples(), free.groups.len()), (20_000 * length as u64, 25));
        }
    }

    /// The level differs between tenths of a recording: the mean is less certain than by chance
    /// alone.
    #[test]
    fn what_changes_along_the_recording_counts() {
        let process = ArNoise::new(&[], 1.0).unwrap();
        let mut random = Random::new(9);
        let mut free = FreeSamples::of(&channel(&process, 4.4, 20.0), 5000).unwrap();
        let levels: [f64; 10] = std::array::from_fn(|i| if i % 2 == 0 { 19.7 } else { 20.3 });
        for block in 0..5000 {
            let mut values = noise(&mut random, &process, 20);
            values.iter_mut().for_each(|value| *value += levels[block / 500]);
            free.add(&digitised(&values, 255));
        }
        let known_dn = free.uncertainty().background_dn;
        // 0.3/√25 except for groups with a change of level; 1/√25000 without changes.
        assert!((0.04..0.07).contains(&known_dn), "{known_dn}");
    }
}
