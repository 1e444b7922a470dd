//! Noise from fourth differences of quiet samples, without a pulse model.
//!
//! A smooth pulse cancels in fourth differences, where the noise is amplified by `√70`. Only
//! stretches near the lowest sample of a block are used, because the pulse of a narrow response
//! does not cancel near its peak. Correlated noise partly cancels as well: the estimate is a lower
//! limit of the noise and a check of other estimates ([`ArNoise::difference_sd`]).
//!
//! [`ArNoise::difference_sd`]: crate::noise::ArNoise::difference_sd

use super::QUANTISATION_VARIANCE;
use super::histogram::Histogram;
use crate::decompose::Waveform;

/// `√70`: SD of fourth differences of white noise, over that of the noise.
const GAIN: f64 = 8.366_600_265_340_756;
/// Height of quiet samples above the lowest of the block, relative to its highest …
const QUIET_PART: f64 = 0.1;
/// … and at least, in standard deviations of the noise by all samples, plus two steps.
const QUIET_SD: f64 = 8.0;
/// Fewest quiet differences; with fewer, all are used.
const MIN_QUIET: u64 = 100;
/// Representation of difference 0 in a histogram of unsigned numbers.
const ZERO: i32 = 1 << 15;

/// SD of white noise by fourth differences, DN; at least that of rounding.
pub(crate) fn noise_sd_dn<'a>(blocks: impl Iterator<Item = Waveform<'a>> + Clone) -> f64 {
    let mut all = Differences::default();
    blocks.clone().for_each(|block| all.add(block, f64::INFINITY));
    // Quartiles resist the pulses, so all samples give a first estimate.
    let rough_dn = all.sd_dn();
    let mut quiet = Differences::default();
    blocks.for_each(|block| {
        let (Some(&lowest), Some(&highest)) = (block.samples.iter().min(), block.samples.iter().max()) else {
            return;
        };
        let height_dn = (QUIET_PART * f64::from(highest - lowest)).max(QUIET_SD * rough_dn + 2.0);
        quiet.add(block, f64::from(lowest) + height_dn);
    });
    if quiet.count() < MIN_QUIET { rough_dn } else { quiet.sd_dn() }
}

/// Fourth differences by phase: a level that depends on the phase shifts them by a constant.
#[derive(Default)]
struct Differences {
    by_phase: [Histogram; 4],
}

impl Differences {
    /// Adds the differences of samples of which none exceeds `limit_dn`.
    fn add(&mut self, block: Waveform<'_>, limit_dn: f64) {
        // Number of samples up to this one, without a gap, that do not exceed the limit.
        let mut low = 0;
        for (k, &sample) in block.samples.iter().enumerate() {
            low = if f64::from(sample) > limit_dn { 0 } else { low + 1 };
            if low < 5 {
                continue;
            }
            let s = [4, 3, 2, 1, 0].map(|lag| i32::from(block.samples[k - lag]));
            let difference = s[0] - 4 * s[1] + 6 * s[2] - 4 * s[3] + s[4];
            self.by_phase[k % 4].add((difference + ZERO).clamp(0, i32::from(u16::MAX)) as u16);
        }
    }

    fn count(&self) -> u64 {
        self.by_phase.iter().map(Histogram::count).sum()
    }

    /// SD of the noise from the central half of the differences, DN.
    fn sd_dn(&self) -> f64 {
        let variance = |histogram: &Histogram| {
            // The quartiles of a normal distribution are 1.349 standard deviations apart.
            let sd = (histogram.quantile(0.75) - histogram.quantile(0.25)) / 1.348_979_500_392_163_4 / GAIN;
            histogram.count() as f64 * sd * sd
        };
        let mean = self.by_phase.iter().map(variance).sum::<f64>() / self.count().max(1) as f64;
        mean.max(QUANTISATION_VARIANCE).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::noise::ArNoise;
    use crate::simulated::{Random, analogue, digitised, pulse};

    fn measured(process: &ArNoise, fwhm: f64, levels: [f64; 4]) -> f64 {
        let mut random = Random::new(61);
        let blocks: Vec<Vec<u16>> = (0..500)
            .map(|_| {
                let echo = pulse(40.0 + 160.0 * random.uniform(), 20.0 + 20.0 * random.uniform(), 1.0);
                let mut values = analogue(&mut random, process, 60, 12.0, fwhm, &[echo]);
                values.iter_mut().enumerate().for_each(|(k, value)| *value += levels[k % 4]);
                digitised(&values, 255)
            })
            .collect();
        noise_sd_dn(blocks.iter().map(|samples| Waveform { samples }))
    }

    #[test]
    fn pulses_and_levels_of_phases_do_not_count_as_noise() {
        let exact = (1.0 + QUANTISATION_VARIANCE).sqrt();
        let white = ArNoise::new(&[], 1.0).unwrap();
        for (fwhm, levels) in [(4.4, [0.0; 4]), (14.0, [0.0; 4]), (4.4, [0.5, -0.5, 0.5, -0.5])] {
            let found = measured(&white, fwhm, levels);
            assert!((found / exact - 1.0).abs() < 0.06, "{fwhm}, {levels:?}: {found} {exact}");
        }
    }

    #[test]
    fn correlated_noise_has_the_differences_of_its_process() {
        let process = ArNoise::new(&[0.6], 0.8).unwrap();
        let exact = (process.difference_sd().powi(2) + QUANTISATION_VARIANCE).sqrt();
        let found = measured(&process, 4.4, [0.0; 4]);
        assert!((found / exact - 1.0).abs() < 0.06, "{found} {exact}");
    }

    #[test]
    fn differences_of_a_cubic_vanish_and_rounding_remains() {
        let cubic: Vec<u16> = (0..10u16).map(|k| k * k * k).collect();
        let blocks = [&cubic[..], &[1, 2], &[]].map(|samples| Waveform { samples });
        assert_eq!(noise_sd_dn(blocks.into_iter()), QUANTISATION_VARIANCE.sqrt());
    }
}
