//! Pulse acceptance rules of the scalar and the SIMD form.
//!
//! Rules are generic over `f64` (scalar) and `f32` (SIMD) positions.

use std::ops::{Add, Sub};

use super::{DecomposeSettings, Filter};

pub(crate) mod response_error;

/// Distance after a stronger pulse, in widths, beyond which its filter response is subtracted from a
/// candidate's statistic.
pub(crate) const TAIL_START_WIDTHS: f64 = 1.5;
/// Start of a pulse before its peak, in its widths (8 ns for 4.25).
pub(crate) const BEGINS_WIDTHS: f64 = 1.9;
/// Distance in widths below which pulses are fitted jointly.
pub(crate) const CLUSTER_WIDTHS: f64 = 3.0;
/// Minimum separation of two pulses, in calibrated widths; at least one sample.
const LEAST_SEPARATION_WIDTHS: f64 = 0.25;
/// Smallest decrease of chi-square by an added pulse, relative to the squared threshold.
pub(crate) const GAIN_PART: f64 = 0.8;
/// Smallest maximum of the filtered residual for which a pulse is tried, relative to the threshold.
pub(crate) const TRIAL_PART: f64 = 0.75;
/// Width ratio above which a pulse may hide two.
pub(crate) const HIDING_WIDTH_RATIO: f64 = 1.04;
/// Width ratio above which a pulse that overdrives the receiver may hide two.
///
/// Overdrive widens single echoes of a RIEGL LMS-Q680i by up to 1.09.
pub(crate) const OVERDRIVEN_HIDING_WIDTH_RATIO: f64 = 1.2;
/// Significance relative to the threshold above which no rule drops a pulse.
pub(crate) const CLEAR_PART: f64 = 4.0;
/// Initial energy fractions of the first half of a split pulse.
pub(crate) const DIVIDED_PARTS: [f64; 3] = [0.5, 0.8, 0.2];
/// Background above which samples of 0 are excluded, in standard deviations of the noise: they are
/// caused by the undershoot of a strong pulse.
pub(crate) const CLEAR_OF_ZERO_SD: f64 = 5.0;

/// Detection thresholds, standard deviations of the filtered noise.
#[derive(Debug, Clone, Copy)]
pub(crate) struct DetectionSigma {
    pub(crate) usual: f64,
    /// Threshold of the last of several pulses.
    of_last: Option<f64>,
    /// The lower of the two.
    pub(crate) least: f64,
}

impl DetectionSigma {
    pub(crate) fn of(settings: &DecomposeSettings) -> DetectionSigma {
        let (usual, of_last) = (settings.detection_sigma, settings.detection_sigma_last);
        DetectionSigma { usual, of_last, least: of_last.map_or(usual, |last| last.min(usual)) }
    }

    /// Threshold at a position among pulses at `others`, without response errors.
    #[inline(always)]
    pub(crate) fn at<T: Copy + PartialOrd>(
        &self,
        position: T,
        mut others: impl Iterator<Item = T> + Clone,
    ) -> f64 {
        let Some(of_last) = self.of_last else { return self.usual };
        let is_last = others.clone().any(|p| p < position) && others.all(|p| p <= position);
        if is_last { of_last } else { self.usual }
    }
}

/// Minimum separation of two pulses, samples.
pub(crate) fn least_separation_samples(fwhm_samples: f64) -> f64 {
    (LEAST_SEPARATION_WIDTHS * fwhm_samples).max(1.0)
}

/// Number of neighbours closer than `least`; positions ascend.
pub(crate) fn too_near<T>(positions: impl Iterator<Item = T> + Clone, least: T) -> usize
where
    T: Copy + PartialOrd + Sub<Output = T>,
{
    let gaps = positions.clone().skip(1).zip(positions);
    gaps.filter(|&(right, left)| right - left < least).count()
}

/// Whether the peak of a pulse is outside the block.
#[inline(always)]
pub(crate) fn is_outside<T: Copy + PartialOrd>(position: T, [first, last]: [T; 2]) -> bool {
    position < first || position > last
}

/// Whether a width is outside `ln_width_bounds` by more than two standard deviations.
#[inline(always)]
pub(crate) fn is_misshapen<T>([ln_width, ln_width_sd]: [T; 2], [narrowest, widest]: [T; 2]) -> bool
where
    T: Copy + PartialOrd + Add<Output = T> + Sub<Output = T>,
{
    let reach = ln_width_sd + ln_width_sd;
    ln_width + reach < narrowest || ln_width - reach > widest
}

/// Reason to drop a pulse whose width is outside of `ln_width_bounds`; see [`is_misshapen`].
pub(crate) fn width_filter<T: Copy + PartialOrd>(ln_width: T, [narrowest, _]: [T; 2]) -> Filter {
    if ln_width < narrowest { Filter::Narrow } else { Filter::Wide }
}
