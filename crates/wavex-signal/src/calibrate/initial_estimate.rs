//! Initial estimate of levels, spreads and pulse width by order statistics, without a model.

use super::differences;
use super::histogram::Histogram;
use crate::decompose::Waveform;

/// Number of samples at the start of a block taken as background.
const START_SAMPLES: usize = 8;
/// Smallest peak above the background, in standard deviations, of pulses whose width is measured.
const STRONG_SD: f64 = 10.0;
/// Quantile of the measured widths that represents a flat target.
const NARROW_PART: f64 = 0.3;
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
    /// Noise by fourth differences of quiet samples, DN: a lower limit if it is correlated.
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
        for block in blocks.clone() {
            block.samples.iter().take(START_SAMPLES).for_each(|&s| starts.add(s));
            block.samples.iter().min().into_iter().for_each(|&s| floors.add(s));
        }
        let start_level_dn = starts.quantile(0.5);
        // Only below the median: signal raises samples.
        let start_sd_dn = (start_level_dn - starts.quantile(0.158_655)).max(0.1);
        let threshold = start_level_dn + STRONG_SD * start_sd_dn;
        let white_sd_dn = differences::noise_sd_dn(blocks.clone());
        let mut widths: Vec<f64> = blocks
            .filter_map(|block| width_of_highest(block.samples, start_level_dn, threshold, full_scale_dn))
            .collect();
        widths.sort_by(f64::total_cmp);
        InitialEstimate {
            start_level_dn,
            start_sd_dn,
            floor_level_dn: floors.quantile(0.5),
            floor_sd_dn: 0.5 * (floors.quantile(0.841_345) - floors.quantile(0.158_655)),
            white_sd_dn,
            fwhm_samples: widths.get((widths.len() as f64 * NARROW_PART) as usize).copied().unwrap_or(0.0),
            pulses: widths.len(),
        }
    }
}

/// Width at half maximum of the highest pulse of a block, samples.
///
/// `None` unless it exceeds the threshold, is unsaturated, and both flanks are in the block.
fn width_of_highest(samples: &[u16], level_dn: f64, threshold_dn: f64, full_scale_dn: f64) -> Option<f64> {
    // Reversed, so that `max_by_key` finds the first of equal samples.
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

#[cfg(test)]
mod tests {
    use super::*;

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
}
