//! Weak returns in samples that no detected pulse has touched: told by what noise has as often upside down.
//!
//! Noise is as likely as its mirror image about the background, and a return only raises samples. So stretches that a
//! smooth peak stands out of are left out, and for them stretches with a dip as deep are taken twice, as they are and
//! mirrored: in mere noise both are equally frequent and have the same squares and products, whatever its size and
//! correlation, so that nothing is cut away from its statistics, wherever the threshold lies.

use super::QUANTISATION_VARIANCE;
use crate::kernels::noise::ArNoise;
use crate::kernels::sensor_model::{Background, ChannelModel, ModelError};

/// Peaks and dips of the matched filter count from so many of its standard deviations on: the lower, the less of weak
/// returns is left, and the fewer samples tell the noise.
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

/// What a stretch shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Lean {
    Peak,
    Dip,
    Neither,
}

/// A channel's background as a mirror.
#[derive(Debug, Clone)]
pub(super) struct Mirror {
    /// The matched filter of a pulse in the noise, of unit variance, about its middle.
    filter: Vec<f64>,
    stretch_samples: f64,
    beside: usize,
    background_dn: [f64; 4],
    free_dn: Vec<f64>,
    mirrored_dn: Vec<f64>,
    filtered: Vec<f64>,
}

impl Mirror {
    /// Of a channel as it is known so far. `None` where noise has no mirror image: the background is each waveform's own
    /// and so not known, or too near to 0.
    pub(super) fn new(model: &ChannelModel) -> Result<Option<Mirror>, ModelError> {
        let noise = model.noise()?;
        let lowest_dn = model.background_dn.iter().copied().fold(f64::INFINITY, f64::min);
        if model.background == Background::PerWaveform || lowest_dn < LEAST_LEVEL_SD * noise.sd() {
            return Ok(None);
        }
        let fwhm_samples = model.fwhm_samples();
        Ok(Some(Mirror {
            filter: matched_filter(&noise, fwhm_samples),
            stretch_samples: (STRETCH_WIDTHS * fwhm_samples).max(LEAST_STRETCH),
            beside: (BESIDE_WIDTHS * fwhm_samples).round() as usize,
            background_dn: model.background_dn,
            free_dn: Vec::new(),
            mirrored_dn: Vec::new(),
            filtered: Vec::new(),
        }))
    }

    /// Hands on the free samples of a block by stretches: how each leans, its samples, the same mirrored, and the phase of
    /// the first. The digitiser cuts noise at 0; samples are cut as far above the background, so that peaks are like dips.
    pub(super) fn stretches(
        &mut self,
        samples: &[u16],
        start_phase: u8,
        mut take: impl FnMut(Lean, &[f64], &[f64], u8),
    ) {
        let background_dn = self.background_dn;
        let level = |k: usize| background_dn[(usize::from(start_phase) + k) % 4];
        self.free_dn.clear();
        let cut = samples.iter().enumerate().map(|(k, &sample)| f64::from(sample).min(2.0 * level(k)));
        self.free_dn.extend(cut);
        self.mirrored_dn.clear();
        self.mirrored_dn.extend(self.free_dn.iter().enumerate().map(|(k, value)| 2.0 * level(k) - value));
        self.filter_samples();
        let stretches = (samples.len() as f64 / self.stretch_samples).floor().max(1.0) as usize;
        // In fewer samples than a stretch nothing can be told apart.
        let is_short = samples.len() < self.stretch_samples as usize;
        for i in 0..stretches {
            let (from, to) = (i * samples.len() / stretches, (i + 1) * samples.len() / stretches);
            let phase = ((usize::from(start_phase) + from) % 4) as u8;
            let lean = if is_short { Lean::Neither } else { self.lean(from, to) };
            take(lean, &self.free_dn[from..to], &self.mirrored_dn[from..to], phase);
        }
    }

    /// Runs the filter over the free samples less the background; beyond them is nothing.
    fn filter_samples(&mut self) {
        let above_dn: Vec<f64> =
            self.free_dn.iter().zip(&self.mirrored_dn).map(|(up, down)| 0.5 * (up - down)).collect();
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
}

/// The part of normal, rounded noise's variance that is left between cuts at 0 and at twice the level, from the
/// variance left.
pub(super) fn part_left(left: f64, level_dn: f64) -> f64 {
    let mut part = 1.0;
    // The part depends little on the variance: each round is nearer by a factor of three or more.
    for _ in 0..8 {
        let variance = left / part;
        let rounded_sd = (variance - QUANTISATION_VARIANCE).sqrt();
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
    use crate::kernels::simulated::{Random, channel, moments, noise};

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
        assert!((variance / (sd * sd + QUANTISATION_VARIANCE) - 1.0).abs() < 0.01, "{variance}");
    }

    #[test]
    fn peaks_and_dips_are_told_apart() {
        let model = channel(&ArNoise::new(&[], 1.0).unwrap(), 4.4, 20.0);
        let mut mirror = Mirror::new(&model).unwrap().unwrap();
        let mut samples = [20; 40];
        samples[2..5].copy_from_slice(&[24, 26, 24]);
        samples[36..39].copy_from_slice(&[16, 14, 16]);
        let mut seen = Vec::new();
        mirror.stretches(&samples, 1, |lean, stretch, mirrored, phase| {
            seen.push((lean, stretch[3], mirrored[3], phase));
        });
        assert_eq!(seen.len(), 6);
        assert_eq!(seen[0], (Lean::Peak, 26.0, 14.0, 1));
        assert_eq!(seen[2], (Lean::Neither, 20.0, 20.0, 2));
        assert_eq!((seen[5].0, seen[5].3), (Lean::Dip, 2));
    }

    #[test]
    fn noise_without_a_mirror_image_is_left_alone() {
        let mut model = channel(&ArNoise::new(&[], 1.0).unwrap(), 4.4, 1.2);
        assert!(Mirror::new(&model).unwrap().is_none());
        model.background_dn = [9.0; 4];
        assert!(Mirror::new(&model).unwrap().is_some());
        model.background = Background::PerWaveform;
        assert!(Mirror::new(&model).unwrap().is_none());
    }
}
