//! Initial estimate of levels, spreads and pulse width by order statistics, without a model.

use crate::decompose::Waveform;

/// Number of samples at the start of a block taken as background.
const START_SAMPLES: usize = 8;
/// Smallest peak above the background, in standard deviations, of pulses whose width is measured.
const STRONG_SD: f64 = 10.0;
/// Quantile of the measured widths that represents a flat target.
const NARROW_PART: f64 = 0.3;
/// `√70`: standard deviation of fourth differences of white noise, over that of the noise.
const FOURTH_DIFFERENCE_GAIN: f64 = 8.366_600_265_340_756;
/// SD of a normal distribution over its median absolute value.
const SD_OF_MEDIAN: f64 = 1.482_602_218_505_602;

/// Initial levels, spreads and width.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct InitialEstimate {
    /// Median of the first samples of the blocks, DN.
    pub(super) start_level_dn: f64,
    /// Their standard deviation from the part below the median, which contains no signal, DN.
    pub(super) start_sd_dn: f64,
    /// Median of the smallest samples of the blocks, DN.
    pub(super) floor_level_dn: f64,
    /// Robust SD of these, DN.
    pub(super) floor_sd_dn: f64,
    /// White part of the noise, DN, from fourth differences, in which a smooth pulse cancels.
    pub(super) white_sd_dn: f64,
    /// Width of narrow pulses at half maximum, samples.
    pub(super) fwhm_samples: f64,
    /// Number of pulses measured.
    pub(super) pulses: usize,
}

impl InitialEstimate {
    pub(super) fn of<'a>(
        blocks: impl Iterator<Item = Waveform<'a>> + Clone,
        full_scale_dn: f64,
    ) -> InitialEstimate {
        let mut starts = Histogram::default();
        let mut floors = Histogram::default();
        let mut differences = Histogram::default();
        for block in blocks.clone() {
            block.samples.iter().take(START_SAMPLES).for_each(|&s| starts.add(s));
            block.samples.iter().min().into_iter().for_each(|&s| floors.add(s));
            fourth_differences(block.samples).for_each(|d| differences.add(d));
        }
        let start_level_dn = starts.quantile(0.5);
        let start_sd_dn = (start_level_dn - starts.quantile(0.158_655)).max(0.1);
        let threshold = start_level_dn + STRONG_SD * start_sd_dn;
        let mut widths: Vec<f64> = blocks
            .filter_map(|block| width_of_highest(block.samples, start_level_dn, threshold, full_scale_dn))
            .collect();
        widths.sort_by(f64::total_cmp);
        InitialEstimate {
            start_level_dn,
            start_sd_dn,
            floor_level_dn: floors.quantile(0.5),
            floor_sd_dn: 0.5 * (floors.quantile(0.841_345) - floors.quantile(0.158_655)),
            // A magnitude in whole steps represents values up to half a step around it, so the
            // histogram of magnitudes with its lowest bin half as wide gives the median: sufficient
            // for an initial estimate.
            white_sd_dn: SD_OF_MEDIAN * differences.quantile(0.5).max(0.0) / FOURTH_DIFFERENCE_GAIN,
            fwhm_samples: widths.get((widths.len() as f64 * NARROW_PART) as usize).copied().unwrap_or(0.0),
            pulses: widths.len(),
        }
    }
}

/// Magnitudes of the fourth differences.
fn fourth_differences(samples: &[u16]) -> impl Iterator<Item = u16> {
    samples.windows(5).map(|w| {
        let s = [0, 1, 2, 3, 4].map(|k| i64::from(w[k]));
        let difference = s[0] - 4 * s[1] + 6 * s[2] - 4 * s[3] + s[4];
        difference.unsigned_abs().min(u64::from(u16::MAX)) as u16
    })
}

/// Width at half maximum of the highest pulse of a block, samples.
///
/// `None` unless it exceeds the threshold, is unsaturated, and both flanks are in the block.
fn width_of_highest(samples: &[u16], level_dn: f64, threshold_dn: f64, full_scale_dn: f64) -> Option<f64> {
    let (peak, &highest) = samples.iter().enumerate().rev().max_by_key(|(_, s)| **s)?;
    let highest = f64::from(highest);
    if highest <= threshold_dn || highest >= full_scale_dn {
        return None;
    }
    let half = level_dn + 0.5 * (highest - level_dn);
    let at = |k: usize| f64::from(samples[k]);
    let before = (0..peak).rev().find(|&k| at(k) < half)?;
    let after = (peak + 1..samples.len()).find(|&k| at(k) < half)?;
    let rise = before as f64 + (half - at(before)) / (at(before + 1) - at(before));
    let fall = after as f64 - (half - at(after)) / (at(after - 1) - at(after));
    Some(fall - rise)
}

/// Histogram of whole numbers.
#[derive(Default)]
struct Histogram {
    counts: Vec<u64>,
}

impl Histogram {
    fn add(&mut self, value: u16) {
        let index = usize::from(value);
        if index >= self.counts.len() {
            self.counts.resize(index + 1, 0);
        }
        self.counts[index] += 1;
    }

    /// Quantile of the values before rounding; each count is spread over half a step to either
    /// side. 0 without values.
    fn quantile(&self, part: f64) -> f64 {
        let total: u64 = self.counts.iter().sum();
        let mut left = part * total as f64;
        for (value, &count) in self.counts.iter().enumerate() {
            let count = count as f64;
            if count > 0.0 && left <= count {
                return value as f64 - 0.5 + left / count;
            }
            left -= count;
        }
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_lie_between_whole_numbers() {
        let mut histogram = Histogram::default();
        assert_eq!(histogram.quantile(0.5), 0.0);
        [3, 3, 4, 4].iter().for_each(|&v| histogram.add(v));
        assert_eq!(histogram.quantile(0.5), 3.5);
        assert_eq!(histogram.quantile(0.25), 3.0);
        assert_eq!(histogram.quantile(1.0), 4.5);
    }

    #[test]
    fn the_width_is_measured_between_half_heights() {
        let samples = [10, 10, 14, 18, 22, 30, 22, 18, 14, 10, 10];
        // Half maximum is 20: between 18 and 22 on either side.
        assert_eq!(width_of_highest(&samples, 10.0, 12.0, 255.0), Some(3.0));
        assert_eq!(width_of_highest(&samples, 10.0, 30.0, 255.0), None);
        assert_eq!(width_of_highest(&samples, 10.0, 12.0, 30.0), None);
        assert_eq!(width_of_highest(&samples[5..], 10.0, 12.0, 255.0), None);
        assert_eq!(width_of_highest(&[], 10.0, 12.0, 255.0), None);
    }

    #[test]
    fn fourth_differences_of_a_cubic_vanish() {
        let cubic: Vec<u16> = (0..10u16).map(|k| k * k * k).collect();
        assert!(fourth_differences(&cubic).all(|d| d == 0));
        assert_eq!(fourth_differences(&[0, 0, 5, 0, 0]).collect::<Vec<_>>(), [30]);
        assert_eq!(fourth_differences(&[1, 2]).count(), 0);
    }
}
