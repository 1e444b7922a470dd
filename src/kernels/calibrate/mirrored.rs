//! Noise of free samples that returns too weak to be detected may have raised.
//!
//! Noise is as likely as its mirror image about the background, and a return only raises samples. So stretches that a
//! smooth peak stands out of are left out, and for them stretches with a dip as deep are taken twice, as they are and
//! mirrored: in mere noise both are equally frequent and have the same squares and products, whatever its size and
//! correlation, so that nothing is cut away from its statistics, wherever the threshold lies.

use super::noise_statistics::NoiseStatistics;
use crate::kernels::noise::ArNoise;
use crate::kernels::sensor_model::{Background, ChannelModel, ModelError};

/// Peaks and dips of the matched filter count from so many of its standard deviations on. From 2 on, less of weak returns
/// would be left, but so many stretches would count twice that the noise is known half as well.
const THRESHOLD_SD: f64 = 3.0;
/// Length of a stretch in widths of a pulse; in longer ones more often stand a peak and a dip.
const STRETCH_WIDTHS: f64 = 1.5;
/// With fewer samples hardly a pair is left at the largest lag.
const LEAST_STRETCH: f64 = 6.0;
/// Peaks so many widths beside a stretch still reach into it.
const BESIDE_WIDTHS: f64 = 0.5;
/// The filter reaches so many widths to either side.
const REACH_WIDTHS: f64 = 1.5;
/// Where the background stands fewer standard deviations above 0, too little is left of dips.
const LEAST_LEVEL_SD: f64 = 1.5;
/// From so many standard deviations on, 0 cuts nothing away.
const UNCUT_LEVEL_SD: f64 = 6.0;
/// Rounding to whole steps adds this to the noise's variance, DN².
const ROUNDING: f64 = super::QUANTISATION_VARIANCE;

/// What of the blocks' free samples tells the noise.
#[derive(Debug, Clone)]
pub(super) struct Mirrored {
    /// The matched filter of a pulse in the noise, of unit variance, about its middle.
    filter: Vec<f64>,
    stretch_samples: f64,
    beside: usize,
    background_dn: [f64; 4],
    /// Of all stretches, those with a peak replaced by mirrored ones with a dip.
    noise: NoiseStatistics,
    /// Of stretches with neither: the level, which mirrored pairs do not tell.
    level: NoiseStatistics,
    free_dn: Vec<f64>,
    filtered: Vec<f64>,
}

/// What a stretch shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Lean {
    Peak,
    Dip,
    Neither,
}

impl Mirrored {
    /// Of a channel as it is known so far. `None` where noise has no mirror image: the background is each waveform's own
    /// and so not known, or too near to 0.
    pub(super) fn new(model: &ChannelModel) -> Result<Option<Mirrored>, ModelError> {
        let noise = model.noise()?;
        let lowest_dn = model.background_dn.iter().copied().fold(f64::INFINITY, f64::min);
        if model.background == Background::PerWaveform || lowest_dn < LEAST_LEVEL_SD * noise.sd() {
            return Ok(None);
        }
        let fwhm_samples = model.fwhm_samples();
        Ok(Some(Mirrored {
            filter: matched_filter(&noise, fwhm_samples),
            stretch_samples: (STRETCH_WIDTHS * fwhm_samples).max(LEAST_STRETCH),
            beside: (BESIDE_WIDTHS * fwhm_samples).round() as usize,
            background_dn: model.background_dn,
            noise: NoiseStatistics::default(),
            level: NoiseStatistics::default(),
            free_dn: Vec::new(),
            filtered: Vec::new(),
        }))
    }

    /// Takes in the free samples of a block. In fewer than a stretch nothing can be told apart.
    pub(super) fn add(&mut self, samples: &[u16], start_phase: u8) {
        let background_dn = self.background_dn;
        let level = |k: usize| background_dn[(usize::from(start_phase) + k) % 4];
        // The digitiser cuts noise at 0; cut as far above the background, peaks are like dips again.
        self.free_dn.clear();
        let cut = samples.iter().enumerate().map(|(k, &sample)| f64::from(sample).min(2.0 * level(k)));
        self.free_dn.extend(cut);
        self.filter_samples(start_phase);
        let stretches = (samples.len() as f64 / self.stretch_samples).round() as usize;
        if samples.len() < self.stretch_samples as usize || stretches == 0 {
            self.noise.add(&self.free_dn, start_phase);
            self.level.add(&self.free_dn, start_phase);
            return;
        }
        for i in 0..stretches {
            let (from, to) = (i * samples.len() / stretches, (i + 1) * samples.len() / stretches);
            let phase = ((usize::from(start_phase) + from) % 4) as u8;
            let lean = self.lean(from, to);
            if lean == Lean::Peak {
                continue;
            }
            let stretch = &self.free_dn[from..to];
            self.noise.add(stretch, phase);
            if lean == Lean::Neither {
                self.level.add(stretch, phase);
            } else {
                let mirrored: Vec<f64> = (from..to).map(|k| 2.0 * level(k) - self.free_dn[k]).collect();
                self.noise.add(&mirrored, phase);
            }
        }
    }

    /// Runs the filter over the free samples less the background; beyond them is nothing.
    fn filter_samples(&mut self, start_phase: u8) {
        let level = |k: usize| self.background_dn[(usize::from(start_phase) + k) % 4];
        let above_dn: Vec<f64> = self.free_dn.iter().enumerate().map(|(k, value)| value - level(k)).collect();
        let reach = self.filter.len() / 2;
        self.filtered.clear();
        self.filtered.extend((0..above_dn.len()).map(|k| {
            let (from, skipped) = (k.saturating_sub(reach), reach.saturating_sub(k));
            let products = self.filter[skipped..].iter().zip(&above_dn[from..]).map(|(f, y)| f * y);
            products.sum::<f64>()
        }));
    }

    fn lean(&self, from: usize, to: usize) -> Lean {
        let to = (to + self.beside).min(self.filtered.len());
        let near = &self.filtered[from.saturating_sub(self.beside)..to];
        let peak = near.iter().copied().fold(0.0, f64::max);
        let dip = -near.iter().copied().fold(0.0, f64::min);
        match peak.max(dip) < THRESHOLD_SD {
            true => Lean::Neither,
            false if peak > dip => Lean::Peak,
            false => Lean::Dip,
        }
    }

    /// Level by phase, DN. `None` where no stretch is level.
    pub(super) fn background_dn(&self) -> Option<[f64; 4]> {
        (self.level.samples() > 0).then(|| self.level.background_dn())
    }

    /// Autocovariance, DN², as if 0 cut nothing away: what both cuts take is the same part at every lag, nearly. `None`
    /// where no stretch is level.
    pub(super) fn autocovariance(&self) -> Option<Vec<f64>> {
        let level_dn = self.background_dn()?.iter().sum::<f64>() / 4.0;
        let mut autocovariance = self.noise.autocovariance();
        let part = part_left(autocovariance[0], level_dn);
        autocovariance.iter_mut().for_each(|value| *value /= part);
        Some(autocovariance)
    }

    /// Samples of level stretches.
    pub(super) fn level_samples(&self) -> u64 {
        self.level.samples()
    }

    /// How much larger the variance of the estimates is than that of all samples taken once: a part `p` taken twice for
    /// as many left out has the mean square weight `1 + 2p`.
    pub(super) fn variance_gain(&self, samples: f64) -> f64 {
        1.0 + (self.noise.samples() - self.level.samples()) as f64 / samples.max(1.0)
    }
}

/// The part of normal, rounded noise's variance that is left between cuts at 0 and at twice the level, from the
/// variance left.
fn part_left(left: f64, level_dn: f64) -> f64 {
    let mut part = 1.0;
    // The part depends little on the variance: each round is nearer by a factor of ten.
    for _ in 0..8 {
        let variance = left / part;
        let rounded_sd = (variance - ROUNDING).sqrt();
        if !(rounded_sd > 0.0 && level_dn > 0.0) || level_dn > UNCUT_LEVEL_SD * variance.sqrt() {
            return 1.0;
        }
        let below =
            |edge: f64| 0.5 * libm::erfc((level_dn - edge) / rounded_sd * std::f64::consts::FRAC_1_SQRT_2);
        let highest = (2.0 * level_dn).ceil();
        let mut between = below(0.5) * level_dn.powi(2);
        for value in 1..highest as u32 {
            let value = f64::from(value);
            between += (below(value + 0.5) - below(value - 0.5)) * (value - level_dn).powi(2);
        }
        between += (1.0 - below(highest - 0.5)) * level_dn.powi(2);
        part = (between / variance).clamp(0.5, 1.0);
    }
    part
}

/// The matched filter `Σ⁻¹ g / √(gᵀ Σ⁻¹ g)` of a Gaussian pulse far from a block's edges: the pulse run through the
/// noise's predictor forwards and backwards.
fn matched_filter(noise: &ArNoise, fwhm_samples: f64) -> Vec<f64> {
    let reach = (REACH_WIDTHS * fwhm_samples).ceil();
    let pulse: Vec<f64> = (0..=2 * reach as usize)
        .map(|k| (-4.0 * std::f64::consts::LN_2 * ((k as f64 - reach) / fwhm_samples).powi(2)).exp())
        .collect();
    let predictor: Vec<f64> = std::iter::once(1.0).chain(noise.coefficients().iter().map(|c| -c)).collect();
    let backwards: Vec<f64> = predictor.iter().rev().copied().collect();
    let whitened = convolved(&pulse, &predictor);
    let energy: f64 = whitened.iter().map(|value| value * value).sum();
    let scale = (noise.innovation_variance() * energy).sqrt();
    convolved(&whitened, &backwards).iter().map(|value| value / scale).collect()
}

fn convolved(a: &[f64], b: &[f64]) -> Vec<f64> {
    let mut out = vec![0.0; a.len() + b.len() - 1];
    for (i, a) in a.iter().enumerate() {
        for (j, b) in b.iter().enumerate() {
            out[i + j] += a * b;
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels::simulated::{Random, channel, digitised, moments, noise};

    #[test]
    fn the_filter_of_noise_has_unit_variance() {
        let process = ArNoise::new(&[0.7, -0.2], 0.9).unwrap();
        let filter = matched_filter(&process, 4.4);
        let mut random = Random::new(5);
        let outputs: Vec<f64> = (0..20_000)
            .map(|_| noise(&mut random, &process, filter.len()).iter().zip(&filter).map(|(y, f)| y * f).sum())
            .collect();
        // A standard deviation of twenty thousand is known to 0.5 %.
        assert!((moments(&outputs).1 - 1.0).abs() < 0.015, "{}", moments(&outputs).1);
    }

    #[test]
    fn cuts_far_away_take_nothing_and_near_ones_what_can_be_counted() {
        assert_eq!(part_left(4.0, 20.0), 1.0);
        assert_eq!(part_left(0.05, 2.0), 1.0);
        let (sd, level) = (0.9, 2.0);
        let mut random = Random::new(6);
        let squares: Vec<f64> = (0..200_000)
            .map(|_| ((level + sd * random.normal()).round().clamp(0.0, 2.0 * level) - level).powi(2))
            .collect();
        let left = moments(&squares).0;
        let variance = left / part_left(left, level);
        assert!((variance / (sd * sd + ROUNDING) - 1.0).abs() < 0.01, "{variance}");
    }

    /// Mere noise on levels far from 0 and two standard deviations above it, with 26 free samples a block.
    #[test]
    fn mere_noise_is_not_biased() {
        for (level, seed) in [(20.3, 7), (2.2, 8)] {
            let process = ArNoise::new(&[0.6, 0.05], 0.7).unwrap();
            let model = channel(&process, 4.4, level);
            let mut mirrored = Mirrored::new(&model).unwrap().unwrap();
            let mut random = Random::new(seed);
            for block in 0..20_000u32 {
                let mut values = noise(&mut random, &process, 26);
                values.iter_mut().for_each(|value| *value += level);
                mirrored.add(&digitised(&values, 255), (block % 4) as u8);
            }
            let mut exact = [0.0; 6];
            process.autocovariance_into(&mut exact);
            exact[0] += ROUNDING;
            let got = mirrored.autocovariance().unwrap();
            println!("{level}: {got:?} {exact:?}");
            assert!(((got[0] / exact[0]).sqrt() - 1.0).abs() < 0.015, "{level}: {got:?} {exact:?}");
            for lag in 1..6 {
                let (got, exact) = (got[lag] / got[0], exact[lag] / exact[0]);
                assert!((got - exact).abs() < 0.02, "{level}, lag {lag}: {got} {exact}");
            }
            assert!(mirrored.background_dn().unwrap().iter().all(|got| (got - level).abs() < 0.1));
        }
    }

    #[test]
    fn noise_without_a_mirror_image_is_left_alone() {
        let mut model = channel(&ArNoise::new(&[], 1.0).unwrap(), 4.4, 1.2);
        assert!(Mirrored::new(&model).unwrap().is_none());
        model.background_dn = [9.0; 4];
        assert!(Mirrored::new(&model).unwrap().is_some());
        model.background = Background::PerWaveform;
        assert!(Mirrored::new(&model).unwrap().is_none());
    }
}
