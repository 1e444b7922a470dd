//! Decomposes waveforms into returns: detection, joint fit, residual search, pruning.
//!
//! [`Decomposer`] takes one waveform at a time, in `f64`; it is the reference. [`BatchDecomposer`] takes
//! batches, sixteen waveforms at a time, in `f32`, and is many times faster. Both use the settings,
//! the acceptance rules and the outcome types of this module.

use crate::flags;

pub(crate) mod acceptance;
mod scalar;
pub mod simd;

pub use scalar::Decomposer;
pub use simd::{BatchDecomposer, Decompositions, FilterPeak, Mode, TableCache, Tables};

/// Deviation ratio above which a waveform is not explained: it is decomposed more thoroughly, and its
/// standard deviations are raised.
pub const DEVIANT: f64 = 3.0;

/// Least decrease of the deviation ratio by further returns of an unexplained waveform.
///
/// For 60 samples a decrease of chi-square by 22.
const LEAST_IMPROVEMENT: f64 = 2.0;

/// One waveform: the samples of a block.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Waveform<'a> {
    /// Samples of the digitiser, DN.
    pub samples: &'a [u16],
}

/// Pulses above this fraction of full scale overdrive a RIEGL receiver (210 of 255 DN).
pub const OVERDRIVEN_PART: f64 = 210.0 / 255.0;

/// Settings of the decomposition.
#[derive(Debug, Clone, PartialEq)]
pub struct DecomposeSettings {
    /// Threshold of detection and pruning, standard deviations of the filtered noise.
    pub detection_sigma: f64,
    /// Threshold of the last of two or more returns, which is most often false.
    pub detection_sigma_last: Option<f64>,
    /// Smallest and largest width relative to the calibrated width.
    ///
    /// A return is dropped only if its width is outside the range by more than two standard
    /// deviations.
    pub width_ratio: [f64; 2],
    /// Maximum number of iterations of one fit.
    pub iterations: usize,
    /// Prior SD of the logarithm of the width of overlapping pulses.
    ///
    /// The spread of the widths of isolated pulses (empirical Bayes). Isolated pulses have no
    /// prior.
    pub overlap_ln_width_sd: f64,
    /// Decrease of chi-square required to replace a widened pulse by two.
    ///
    /// `None`: widened pulses are not tried, except at maxima of the residual.
    pub split_evidence: Option<f64>,
    /// Rao's score below which a widened pulse is not tried as two.
    ///
    /// Chi-square with two degrees of freedom for one pulse; 0 tries all pulses.
    pub split_score: f64,
    /// Maximum number of pulses added after detection; 0: none.
    pub max_added: u32,
    /// Minimum relative error of the system response.
    ///
    /// Thresholds near a strong pulse are raised by this fraction of its height. Without effect for
    /// Gaussians.
    pub template_error: f64,
    /// Fraction of full scale above which pulses overdrive the receiver, if the model has no
    /// measured limit.
    ///
    /// No sample needs to be saturated. Such pulses are flagged and divided only if they are wide, and
    /// the response error is 6 % of their height up to the after-pulse. Only for models with a response.
    pub overdriven_part: f64,
    /// Samples unusable after saturation, while the receiver recovers, if the model has no measured
    /// number.
    pub recovery_samples: usize,
    /// Maximum number of returns per waveform; the strongest candidates are kept.
    pub max_returns: usize,
    /// What happens to waveforms with a deviation ratio above [`DEVIANT`].
    ///
    /// They are decomposed more thoroughly, their clear peaks are kept, and their standard
    /// deviations are raised; `false`: nothing.
    pub explains_all: bool,
}

impl Default for DecomposeSettings {
    fn default() -> DecomposeSettings {
        DecomposeSettings {
            detection_sigma: 4.5,
            detection_sigma_last: None,
            width_ratio: [0.8, 10.0],
            iterations: 50,
            overlap_ln_width_sd: 0.15,
            split_evidence: Some(16.0),
            split_score: 6.0,
            max_added: 16,
            template_error: 0.005,
            overdriven_part: OVERDRIVEN_PART,
            recovery_samples: 1,
            max_returns: 24,
            explains_all: true,
        }
    }
}

/// One return of a waveform; its position is that of the peak.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Return {
    /// Position from the block's first sample, samples.
    pub position_samples: f64,
    /// Standard deviation of the position, samples.
    pub position_sd_samples: f64,
    /// Peak height above the background, DN.
    pub amplitude_dn: f64,
    /// Standard deviation of the amplitude, DN.
    pub amplitude_sd_dn: f64,
    /// Width relative to the calibrated width.
    pub width_ratio: f64,
    /// Standard deviation of the width ratio.
    pub width_ratio_sd: f64,
    /// Full width at half maximum, ns.
    pub fwhm_ns: f64,
    /// `(χ² - ν)/√(2ν)` of the waveform; 0 without a degree of freedom.
    pub deviation_ratio: f64,
    /// Bits of [`crate::flags`].
    pub flags: u16,
}

/// Reason why a candidate is dropped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Filter {
    /// Explained by the responses of stronger candidates.
    Screened,
    /// Weaker than [`DecomposeSettings::max_returns`] others.
    Excess,
    /// Not determined by the samples: its fit has no optimum.
    Undetermined,
    /// Below the threshold.
    Weak,
    /// Narrower than the range of widths, and not far above the threshold.
    Narrow,
    /// Wider than the range of widths, and not far above the threshold.
    Wide,
    /// Its peak is outside the block.
    Outside,
}

impl Filter {
    /// All reasons.
    pub const ALL: [Filter; 7] = [
        Filter::Screened,
        Filter::Excess,
        Filter::Undetermined,
        Filter::Weak,
        Filter::Narrow,
        Filter::Wide,
        Filter::Outside,
    ];
}

/// Number of dropped candidates by reason.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Filtered(pub(crate) [u32; Filter::ALL.len()]);

impl Filtered {
    /// Adds candidates dropped for a reason.
    #[inline(always)]
    pub(crate) fn add(&mut self, reason: Filter, n: u32) {
        self.0[reason as usize] += n;
    }

    /// Number for one reason.
    pub fn of(&self, reason: Filter) -> u32 {
        self.0[reason as usize]
    }

    /// Number for all reasons.
    pub fn total(&self) -> u32 {
        self.0.iter().sum()
    }
}

/// Counts of candidates.
///
/// `n_candidates + n_added = np + np_filtered + np_merged + np_xtalk_dropped`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counts {
    /// Maxima of the matched filter above the threshold, and saturated plateaus.
    pub n_candidates: u32,
    /// Pulses added by the residual search.
    pub n_added: u32,
    /// Returns.
    pub np: u32,
    /// Dropped, by reason; [`Counts::np_filtered`] is their sum.
    pub filtered: Filtered,
    /// Merged with a neighbour that could not be resolved.
    pub np_merged: u32,
    /// Dropped as cross-talk of an emission.
    ///
    /// Always 0 here, because emissions are unknown.
    pub np_xtalk_dropped: u32,
}

impl Counts {
    /// Number of dropped candidates, for all reasons.
    pub fn np_filtered(&self) -> u32 {
        self.filtered.total()
    }
}

/// A decomposed waveform.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Decomposition<'a> {
    /// The returns, by position.
    pub returns: &'a [Return],
    /// Counts of candidates.
    pub counts: Counts,
    /// `χ²` of the residual.
    pub chi_square: f64,
    /// Expected contribution of the template error to `χ²`; 0 if unknown.
    pub expected_excess: f64,
    /// Samples used.
    pub samples: usize,
    /// Parameters fitted.
    pub parameters: usize,
    /// Fitted offset from the channel's background, DN; 0 if the background is fixed.
    pub background_offset_dn: f64,
    /// Whether samples are saturated.
    pub saturated: bool,
    /// Whether a fit was made.
    pub refined_once: bool,
    /// Whether a further fit was needed because pulses were added or a fit failed.
    pub refined_twice: bool,
    /// Whether the scalar kernels decomposed the waveform, even if their result was not used.
    pub left_to_plain: bool,
}

impl Decomposition<'_> {
    /// Samples minus parameters.
    pub fn degrees_of_freedom(&self) -> usize {
        self.samples.saturating_sub(self.parameters)
    }

    /// `(χ² - ν)/√(2ν)` with [`Decomposition::expected_excess`] in `ν`.
    ///
    /// 0 without a degree of freedom.
    #[inline(always)]
    pub fn deviation_ratio(&self) -> f64 {
        match self.degrees_of_freedom() {
            0 => 0.0,
            _ => {
                let expected = self.expected_chi_square();
                (self.chi_square - expected) / (2.0 * expected).sqrt()
            }
        }
    }

    /// Whether it explains the waveform better than another decomposition.
    ///
    /// More returns must lower the deviation ratio by at least [`LEAST_IMPROVEMENT`].
    pub(crate) fn is_better_than(&self, other: &Decomposition) -> bool {
        self.is_better([other.deviation_ratio(), f64::from(other.counts.np)])
    }

    /// As [`Decomposition::is_better_than`]; `other` holds its deviation ratio and number of returns.
    pub(crate) fn is_better(&self, other: [f64; 2]) -> bool {
        let [deviation_ratio, returns] = other;
        let improvement = deviation_ratio - self.deviation_ratio();
        improvement > 0.0 && (f64::from(self.counts.np) <= returns || improvement >= LEAST_IMPROVEMENT)
    }

    /// Factor by which the misfit raises standard deviations: `√(χ²/ν)` of a waveform whose
    /// deviation ratio exceeds [`DEVIANT`], else 1.
    ///
    /// If `χ²` exceeds four times the degrees of freedom, the error of the response dominates the noise
    /// and moves the pulses: `ν` is then without [`Decomposition::expected_excess`], whatever the ratio.
    #[inline(always)]
    pub(crate) fn misfit_factor(&self, deviation_ratio: f64, settings: &DecomposeSettings) -> f64 {
        /// Chi-square per degree of freedom from which the error of the response dominates the noise.
        const DOMINATED: f64 = 4.0;
        let nu = self.degrees_of_freedom().max(1) as f64;
        match (settings.explains_all, self.chi_square > DOMINATED * nu, deviation_ratio > DEVIANT) {
            (true, true, _) => (self.chi_square / nu).sqrt(),
            (true, false, true) => (self.chi_square / self.expected_chi_square()).sqrt(),
            _ => 1.0,
        }
    }

    /// Sum of `ν` and [`Decomposition::expected_excess`].
    #[inline(always)]
    pub(crate) fn expected_chi_square(&self) -> f64 {
        self.degrees_of_freedom() as f64 + self.expected_excess
    }
}

/// Whether a block begins or ends on a pulse.
///
/// Position and width in samples.
#[inline(always)]
pub(crate) fn truncation_flag(position: f64, width: f64, samples: usize) -> u16 {
    let is_whole = position >= 0.7 * width && position <= samples as f64 - 1.0 - 0.25 * width;
    if is_whole { 0 } else { flags::TRUNCATED }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_misfit_raises_standard_deviations_by_its_root() {
        let factor = |chi_square: f64, expected_excess: f64| {
            let found = Decomposition {
                chi_square,
                expected_excess,
                samples: 53,
                parameters: 3,
                ..Default::default()
            };
            found.misfit_factor(found.deviation_ratio(), &DecomposeSettings::default())
        };
        assert_eq!(factor(79.0, 0.0), 1.0, "deviation ratio 2.9");
        assert_eq!(factor(81.0, 0.0), (81.0_f64 / 50.0).sqrt(), "deviation ratio 3.1");
        // The response explains these, but up to four times the noise.
        assert_eq!(factor(199.0, 150.0), 1.0);
        assert_eq!(factor(201.0, 150.0), (201.0_f64 / 50.0).sqrt());
    }
}
