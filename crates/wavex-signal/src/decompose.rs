//! Decomposes one waveform: detection, joint fit, residual search, pruning.
//!
//! The plain kernels, in `f64` and one waveform at a time, as docs/explanation/method.md describes
//! from Detection to Uncertainties. They are the reference of [`super::lockstep`] and take the
//! waveforms it cannot decompose.

use super::allowance::Allowance;
use super::detect::{Candidate, Detector, next_plateau, plateau_candidate};
use super::flags;
use super::sensor_model::{ChannelModel, ModelError};
use scene::{Found, Scene};

mod allowance;
mod refine;
mod scene;
mod score;
#[cfg(test)]
mod tests;
mod view;

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
    /// Fraction of full scale above which pulses overdrive the receiver.
    ///
    /// No sample needs to be saturated. Such pulses are flagged and not divided, and the response
    /// error is 6 % of their height up to the after-pulse. Only for models with a response.
    pub overdriven_part: f64,
    /// Samples unusable after saturation, while the receiver recovers.
    pub recovery_samples: usize,
    /// Maximum number of returns per waveform; the strongest candidates are kept.
    pub max_returns: usize,
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
        }
    }
}

impl DecomposeSettings {
    /// Returns the lower of the two thresholds.
    pub(super) fn least_sigma(&self) -> f64 {
        self.detection_sigma_last.map_or(self.detection_sigma, |last| last.min(self.detection_sigma))
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
    /// Bits of [`super::flags`].
    pub flags: u16,
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
    /// Dropped: too weak, too narrow or wide, outside the block, not determined, or in excess.
    pub np_filtered: u32,
    /// Merged with a neighbour that could not be resolved.
    pub np_merged: u32,
    /// Dropped as cross-talk of an emission.
    ///
    /// Always 0 here, because emissions are unknown.
    pub np_xtalk_dropped: u32,
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

    /// Sum of `ν` and [`Decomposition::expected_excess`].
    #[inline(always)]
    pub(super) fn expected_chi_square(&self) -> f64 {
        self.degrees_of_freedom() as f64 + self.expected_excess
    }
}

/// Decomposes the waveforms of one channel; reuses its buffers.
#[derive(Debug, Clone)]
pub struct Decomposer {
    model: ChannelModel,
    settings: DecomposeSettings,
    allowance: Allowance,
    scene: Scene,
    detector: Detector,
    candidates: Vec<Candidate>,
    returns: Vec<Return>,
    counts: Counts,
    refined_twice: bool,
}

impl Decomposer {
    /// Creates a decomposer for blocks of up to `max_samples` samples.
    ///
    /// Longer blocks make it allocate more memory.
    pub fn new(
        model: &ChannelModel,
        settings: &DecomposeSettings,
        max_samples: usize,
    ) -> Result<Decomposer, ModelError> {
        let scene = Scene::new(model, settings, max_samples)?;
        let detector =
            Detector::new(scene.shape().clone(), model.offset_precision(), scene.whitener(), max_samples);
        Ok(Decomposer {
            model: model.clone(),
            settings: settings.clone(),
            allowance: Allowance::new(
                model,
                settings.template_error,
                settings.overdriven_part * model.full_scale_dn,
            ),
            scene,
            detector,
            candidates: Vec::with_capacity(max_samples),
            returns: Vec::with_capacity(settings.max_returns),
            counts: Counts::default(),
            refined_twice: false,
        })
    }

    /// Returns the model of its channel.
    pub fn model(&self) -> &ChannelModel {
        &self.model
    }

    /// Decomposes one block; `start_phase` is the index of its first sample modulo 4.
    pub fn decompose(&mut self, samples: &[u16], start_phase: u8) -> Decomposition<'_> {
        self.counts = Counts::default();
        self.refined_twice = false;
        self.returns.clear();
        if self.scene.load(&self.model, samples, start_phase, self.settings.recovery_samples) {
            self.detector.prepare(self.scene.whitener());
        }
        self.find_candidates(samples);
        if !self.scene.found.is_empty() {
            self.scene.fit_all();
            self.add_from_residual();
            self.prune();
        }
        self.report(samples)
    }

    /// Chi-square after fitting pulses from these start values.
    ///
    /// Start values are height, position and logarithm of the width ratio. No pulse is added or
    /// removed.
    pub(super) fn chi_square_of(
        &mut self,
        samples: &[u16],
        start_phase: u8,
        pulses: impl Iterator<Item = [f64; 3]>,
    ) -> f64 {
        if self.scene.load(&self.model, samples, start_phase, self.settings.recovery_samples) {
            self.detector.prepare(self.scene.whitener());
        }
        self.scene.found.extend(pulses.map(|[height, position, width]| Found::new(height, position, width)));
        self.scene.fit_all_roughly();
        self.scene.chi_square()
    }

    /// Initialises pulses from matched filter maxima and saturated plateaus.
    fn find_candidates(&mut self, samples: &[u16]) {
        self.detector.filter(self.scene.whitener(), self.scene.target_dn());
        self.candidates.clear();
        let least_sigma = self.settings.least_sigma();
        self.detector.maxima(least_sigma, &mut self.candidates);
        self.drop_weak_candidates();
        let width = self.model.fwhm_samples();
        let mut from = 0;
        while let Some(plateau) = next_plateau(samples, self.model.full_scale_dn, from) {
            let near = plateau.start as f64 - width..plateau.end as f64 + width;
            // Maxima on the flanks of a plateau belong to the plateau's pulse.
            self.candidates.retain(|c| c.statistic.is_infinite() || !near.contains(&c.position_samples));
            from = plateau.end;
            self.candidates.push(plateau_candidate(self.scene.target_dn(), plateau, width));
        }
        self.counts.n_candidates = self.candidates.len() as u32;
        self.candidates.sort_unstable_by(|a, b| b.statistic.total_cmp(&a.statistic));
        self.screen_candidates();
        let scene = &mut self.scene;
        let kept = self.candidates.len().min(self.settings.max_returns);
        self.counts.np_filtered = self.counts.n_candidates - kept as u32;
        scene.found.extend(self.candidates.iter().take(kept).map(Found::from_candidate));
    }

    /// Converts the remaining pulses to returns.
    fn report(&mut self, samples: &[u16]) -> Decomposition<'_> {
        let found = &self.scene.found;
        self.counts.np = found.len() as u32;
        let outcome = Decomposition {
            returns: &[],
            counts: self.counts,
            chi_square: self.scene.chi_square(),
            expected_excess: self.expected_excess(),
            samples: self.scene.whitener().used_count(),
            parameters: 3 * found.len() + usize::from(self.model.offset_precision().is_some()),
            background_offset_dn: self.scene.offset_dn(),
            saturated: samples.iter().any(|&s| f64::from(s) >= self.model.full_scale_dn),
            refined_once: self.counts.n_candidates > 0,
            refined_twice: self.refined_twice || found.iter().any(|f| f.flags & flags::DIVERGED != 0),
        };
        let deviation_ratio = outcome.deviation_ratio();
        for f in found {
            let width_ratio = f.pulse.ln_width_ratio.exp();
            let factor = self.model.pulse_error_factor;
            self.returns.push(Return {
                position_samples: f.pulse.position_samples,
                position_sd_samples: factor * f.sd[1],
                amplitude_dn: f.pulse.height_dn,
                amplitude_sd_dn: factor * f.sd[0],
                width_ratio,
                width_ratio_sd: factor * width_ratio * f.sd[2],
                fwhm_ns: width_ratio
                    * self.scene.shape().fwhm_samples_at(f.pulse.height_dn)
                    * self.model.sampling_interval_ns,
                deviation_ratio,
                flags: f.flags
                    | flags::REFINED
                    | block_flags(samples, &self.model, f.pulse.position_samples, f.pulse.ln_width_ratio)
                    | if self.allowance.overdrives(f.pulse.height_dn) { flags::OVERDRIVEN } else { 0 },
            });
        }
        self.set_overlaps();
        Decomposition { returns: &self.returns, ..outcome }
    }

    fn set_overlaps(&mut self) {
        for i in 1..self.returns.len() {
            if self.scene.overlap(i - 1, i) {
                self.returns[i - 1].flags |= flags::OVERLAP;
                self.returns[i].flags |= flags::OVERLAP;
            }
        }
    }
}

/// Whether a block begins or ends on a pulse.
///
/// Position and width in samples.
#[inline(always)]
pub(super) fn truncation_flag(position: f64, width: f64, samples: usize) -> u16 {
    let is_whole = position >= 0.7 * width && position <= samples as f64 - 1.0 - 0.25 * width;
    if is_whole { 0 } else { flags::TRUNCATED }
}

/// Flags of saturation and truncation.
fn block_flags(samples: &[u16], model: &ChannelModel, position_samples: f64, ln_width_ratio: f64) -> u16 {
    let width = model.fwhm_samples() * ln_width_ratio.exp();
    let position = position_samples;
    let mut flags = truncation_flag(position, width, samples.len());
    let saturated = |k: usize| f64::from(samples[k]) >= model.full_scale_dn;
    let within = |before: f64, after: f64| {
        let first = (position - before * width).ceil().max(0.0) as usize;
        let end = ((position + after * width).floor() + 1.0).max(0.0) as usize;
        first.min(samples.len())..end.min(samples.len())
    };
    if within(1.0, 1.0).any(saturated) {
        flags |= flags::SATURATED;
        let core = within(0.5, 0.5);
        let lost = core.clone().filter(|&k| saturated(k)).count();
        let no_flank = within(1.5, 0.0).all(saturated) || within(0.0, 1.5).all(saturated);
        if lost as f64 > 0.6 * core.len() as f64 || no_flank {
            flags |= flags::EXTREMELY_SATURATED;
        }
    }
    flags
}
