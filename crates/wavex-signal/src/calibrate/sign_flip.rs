//! Corrects noise statistics for undetected weak returns by sign-flipped samples.
//!
//! Noise is symmetric about the background, and a return only raises samples. Stretches with a
//! smooth peak are therefore omitted, and stretches with an equally deep dip count twice: as they
//! are and mirrored. In pure noise both are equally frequent and have the same squares and
//! products, whatever its size and correlation. The statistics of the noise are thus not truncated,
//! wherever the threshold lies.

use super::QUANTISATION_VARIANCE;
use crate::noise::ArNoise;
use crate::sensor_model::{Background, ChannelModel, ModelError};

/// Threshold of peaks and dips of the matched filter, in its standard deviations. A lower one
/// leaves less of weak returns but fewer samples for the noise estimate.
const THRESHOLD_SD: f64 = 3.0;
/// Length of a stretch in pulse widths; longer ones more often contain both a peak and a dip.
const STRETCH_WIDTHS: f64 = 1.5;
/// Shortest stretch, samples; shorter ones have hardly a pair at the largest lag.
const LEAST_STRETCH: f64 = 6.0;
/// Largest distance from which a peak reaches into a stretch, in pulse widths.
const BESIDE_WIDTHS: f64 = 0.5;
/// Half length of the filter, in pulse widths.
const REACH_WIDTHS: f64 = 1.5;
/// Smallest background, in standard deviations above 0; below it too little of the dips is left.
const LEAST_LEVEL_SD: f64 = 1.5;
/// Background above which 0 truncates nothing, in standard deviations.
const UNCUT_LEVEL_SD: f64 = 6.0;

/// Sign of the strongest extremum of a stretch.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Lean {
    Peak,
    Dip,
    Neither,
}

/// Mirrors samples about a channel's background.
#[derive(Debug, Clone)]
pub(super) struct Mirror {
    /// Matched filter of a pulse in the noise, unit variance, centred.
    filter: Vec<f64>,
    stretch_samples: f64,
    beside: usize,
    background_dn: [f64; 4],
    free_dn: Vec<f64>,
    mirrored_dn: Vec<f64>,
    filtered: Vec<f64>,
}

impl Mirror {
    /// Creates a mirror for the current model of a channel.
    ///
    /// `None` if the noise cannot be mirrored: the background is each waveform's own and thus
    /// unknown, or too close to 0.
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

    /// Passes the free samples of a block to `take` in stretches.
    ///
    /// Arguments: the sign of the extremum, the samples, the mirrored samples, and the index of the
    /// first in the block, modulo 4. The digitiser truncates noise at 0; samples are truncated at the
    /// same distance above the background, so that peaks and dips are alike.
    pub(super) fn stretches(&mut self, samples: &[u16], mut take: impl FnMut(Lean, &[f64], &[f64], u8)) {
        let background_dn = self.background_dn;
        let level = |k: usize| background_dn[k % 4];
        self.free_dn.clear();
        let cut = samples.iter().enumerate().map(|(k, &sample)| f64::from(sample).min(2.0 * level(k)));
        self.free_dn.extend(cut);
        self.mirrored_dn.clear();
        self.mirrored_dn.extend(self.free_dn.iter().enumerate().map(|(k, value)| 2.0 * level(k) - value));
        self.filter_samples();
        let stretches = (samples.len() as f64 / self.stretch_samples).floor().max(1.0) as usize;
        // Fewer samples than a stretch allow no decision.
        let is_short = samples.len() < self.stretch_samples as usize;
        for i in 0..stretches {
            let (from, to) = (i * samples.len() / stretches, (i + 1) * samples.len() / stretches);
            let phase = (from % 4) as u8;
            let lean = if is_short { Lean::Neither } else { self.lean(from, to) };
            take(lean, &self.free_dn[from..to], &self.mirrored_dn[from..to], phase);
        }
    }

    /// Filters the free samples less the background; zero outside them.
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
        // A peak just outside raises the samples inside as well.
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

/// Fraction of the variance of normal, rounded noise left by truncation at 0 and twice the level.
///
/// `left` is the remaining variance.
pub(super) fn part_left(left: f64, level_dn: f64) -> f64 {
    let mut part = 1.0;
    // The fraction depends weakly on the variance: each iteration reduces the error by a factor of
    // three or more.
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

/// Matched filter `Σ⁻¹ g / √(gᵀ Σ⁻¹ g)` of a Gaussian pulse far from the block edges.
///
/// The pulse is passed through the prediction filter of the noise forwards and backwards.
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
    use crate::simulated::{Random, channel, moments, noise};

    #[test]
    fn the_filter_of_noise_has_unit_variance() {
        let process = ArNoise::new(&[0.7, -0.2], 0.9).unwrap();
        let filter = matched_filter(&process, 4.4);
        let mut random = Random::new(5);
        let outputs: Vec<f64> = (0..20_000)
            .map(|_| noise(&mut random, &process, filter.len()).iter().zip(&filter).map(|(y, f)| y * f).sum())
            .collect();
        // The relative uncertainty of the SD of 20 000 values is 0.5 %.
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
    fn peaks_and_dips_are_distinguished() {
        let model = channel(&ArNoise::new(&[], 1.0).unwrap(), 4.4, 20.0);
        let mut mirror = Mirror::new(&model).unwrap().unwrap();
        let mut samples = [20; 40];
        samples[2..5].copy_from_slice(&[24, 26, 24]);
        samples[36..39].copy_from_slice(&[16, 14, 16]);
        let mut seen = Vec::new();
        mirror.stretches(&samples, |lean, stretch, mirrored, phase| {
            seen.push((lean, stretch[3], mirrored[3], phase));
        });
        assert_eq!(seen.len(), 6);
        assert_eq!(seen[0], (Lean::Peak, 26.0, 14.0, 0));
        assert_eq!(seen[2], (Lean::Neither, 20.0, 20.0, 1));
        assert_eq!((seen[5].0, seen[5].3), (Lean::Dip, 1));
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
