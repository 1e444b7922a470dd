//! Decomposes one waveform at a time, in `f64`: detection, joint fit, residual search, pruning.
//!
//! The reference of the SIMD form [`super::simd`], which leaves it the waveforms it does not
//! support. docs/explanation/method.md describes the steps from Detection to Uncertainties.

use super::acceptance::response_error::Allowance;
use super::acceptance::{DetectionSigma, HIDING_WIDTH_RATIO};
use super::{Counts, DEVIANT, DecomposeSettings, Decomposition, Filter, Return, truncation_flag};
use crate::detect::{Candidate, Detector, next_plateau, plateau_candidate};
use crate::flags;
use crate::sensor_model::{ChannelModel, ModelError};
use crate::shape::Shape;
use scene::{FitScene, Found};

mod refine;
mod scene;
mod score;
#[cfg(test)]
mod tests;
mod thresholds;
mod view;

/// Decomposes the waveforms of one channel; reuses its buffers.
///
/// ```
/// use wavex_signal::decompose::{DecomposeSettings, Decomposer};
/// # use wavex_signal::{noise::ArNoise, simulated::channel};
/// # let model = channel(&ArNoise::new(&[], 0.7).unwrap(), 4.0, 5.0);
///
/// // `model`: pulses 4 ns wide, on a background of 5 DN.
/// let samples = [5, 5, 5, 5, 5, 6, 12, 27, 49, 61, 49, 27, 12, 6, 5, 5, 5, 5, 5, 5];
/// let mut decomposer = Decomposer::new(&model, &DecomposeSettings::default(), samples.len())?;
/// let outcome = decomposer.decompose(&samples);
/// assert_eq!(outcome.returns.len(), 1);
/// assert!((outcome.returns[0].position_samples - 9.0).abs() < 0.05);
/// # Ok::<(), wavex_signal::sensor_model::ModelError>(())
/// ```
#[derive(Debug, Clone)]
pub struct Decomposer {
    model: ChannelModel,
    settings: DecomposeSettings,
    sigma: DetectionSigma,
    allowance: Allowance,
    scene: FitScene,
    detector: Detector,
    candidates: Vec<Candidate>,
    returns: Vec<Return>,
    /// Pulses of the first of two attempts.
    first: Vec<Found>,
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
        Decomposer::of_shape(model, settings, Shape::of(model)?, max_samples)
    }

    /// As [`Decomposer::new`], with [`Shape::of`] the model.
    pub(super) fn of_shape(
        model: &ChannelModel,
        settings: &DecomposeSettings,
        shape: Shape,
        max_samples: usize,
    ) -> Result<Decomposer, ModelError> {
        let scene = FitScene::new(model, settings, shape, max_samples)?;
        let detector =
            Detector::new(scene.shape().clone(), model.offset_precision(), scene.whitener(), max_samples);
        Ok(Decomposer {
            model: model.clone(),
            settings: settings.clone(),
            sigma: DetectionSigma::of(settings),
            allowance: Allowance::new(
                model,
                settings.template_error,
                model.overdriven_dn(settings.overdriven_part),
            ),
            scene,
            detector,
            candidates: Vec::with_capacity(max_samples),
            returns: Vec::with_capacity(settings.max_returns),
            first: Vec::with_capacity(settings.max_returns),
            counts: Counts::default(),
            refined_twice: false,
        })
    }

    /// Returns the model of its channel.
    pub fn model(&self) -> &ChannelModel {
        &self.model
    }

    /// The pulse shape; clones share its tables.
    pub(super) fn shape(&self) -> &Shape {
        self.scene.shape()
    }

    /// Samples unusable after saturation.
    fn recovery_samples(&self) -> usize {
        self.model.limits.recovery_samples.unwrap_or(self.settings.recovery_samples)
    }

    /// Decomposes one block.
    pub fn decompose(&mut self, samples: &[u16]) -> Decomposition<'_> {
        self.decompose_window(samples, 0)
    }

    /// Decomposes a window of a block as if it were the whole block.
    ///
    /// `first` is the index in the block of the window's first sample; it determines the background
    /// of each sample, and must be even if odd samples are late. Returned positions count from the
    /// start of the window.
    pub fn decompose_window(&mut self, samples: &[u16], first: usize) -> Decomposition<'_> {
        self.load(samples, first);
        self.find_returns(samples, self.settings.split_score);
        let outcome = self.outcome(samples);
        if self.settings.explains_all && outcome.deviation_ratio() > DEVIANT {
            let widened = |found: &Found| found.pulse.ln_width_ratio.exp() > HIDING_WIDTH_RATIO;
            // With a score of 0, every widened pulse has been tried.
            if self.settings.split_score > 0.0 && self.scene.found.iter().any(widened) {
                self.find_more_returns(samples, &outcome);
            }
            self.keep_clear_peaks(samples);
        }
        self.report(samples)
    }

    /// As [`Decomposer::decompose`] for a waveform that others left unexplained.
    ///
    /// Every widened pulse is tried as two.
    pub(crate) fn decompose_thoroughly(&mut self, samples: &[u16]) -> Decomposition<'_> {
        self.load(samples, 0);
        self.find_returns(samples, 0.0);
        self.keep_clear_peaks(samples);
        self.report(samples)
    }

    /// Loads a waveform without pulses; `first` is the index in the block of its first sample.
    fn load(&mut self, samples: &[u16], first: usize) {
        self.returns.clear();
        if self.scene.load(&self.model, samples, first, self.recovery_samples()) {
            self.detector.prepare(self.scene.whitener());
        }
    }

    /// Finds and fits the pulses of the loaded waveform.
    ///
    /// Widened pulses with a score below `split_score` are not tried as two.
    fn find_returns(&mut self, samples: &[u16], split_score: f64) {
        self.counts = Counts::default();
        self.refined_twice = false;
        self.find_candidates(samples);
        if !self.scene.found.is_empty() {
            self.scene.fit_all();
            self.add_from_residual(split_score);
            self.prune();
        }
    }

    /// Tries every widened pulse of an unexplained waveform as two; keeps the better result.
    fn find_more_returns(&mut self, samples: &[u16], first: &Decomposition<'static>) {
        self.first.clear();
        self.first.extend_from_slice(&self.scene.found);
        let refined_twice = self.refined_twice;
        self.scene.clear();
        self.find_returns(samples, 0.0);
        if !self.outcome(samples).is_better_than(first) {
            self.scene.show(self.first.drain(..), first.background_offset_dn);
            (self.counts, self.refined_twice) = (first.counts, refined_twice);
        }
    }

    /// Chi-square after fitting pulses from these start values.
    ///
    /// Start values are height, position and logarithm of the width ratio. No pulse is added or
    /// removed.
    pub(crate) fn chi_square_of(&mut self, samples: &[u16], pulses: impl Iterator<Item = [f64; 3]>) -> f64 {
        self.load(samples, 0);
        self.scene.found.extend(pulses.map(|[height, position, width]| Found::new(height, position, width)));
        self.scene.fit_all_roughly();
        self.scene.chi_square()
    }

    /// Initialises pulses from matched filter maxima and saturated plateaus.
    fn find_candidates(&mut self, samples: &[u16]) {
        self.detector.filter(self.scene.whitener(), self.scene.target_dn());
        self.candidates.clear();
        self.detector.maxima(self.sigma.least, &mut self.candidates);
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
        // Strongest first: screening compares with stronger ones, and the strongest are kept.
        self.candidates.sort_unstable_by(|a, b| b.statistic.total_cmp(&a.statistic));
        self.screen_candidates();
        let scene = &mut self.scene;
        let unexplained = self.candidates.len();
        let kept = unexplained.min(self.settings.max_returns);
        self.counts.filtered.add(Filter::Screened, self.counts.n_candidates - unexplained as u32);
        self.counts.filtered.add(Filter::Excess, (unexplained - kept) as u32);
        scene.found.extend(self.candidates.iter().take(kept).map(Found::from_candidate));
    }

    /// Returns the decomposition without its returns.
    fn outcome(&self, samples: &[u16]) -> Decomposition<'static> {
        let found = &self.scene.found;
        Decomposition {
            returns: &[],
            counts: Counts { np: found.len() as u32, ..self.counts },
            chi_square: self.scene.chi_square(),
            expected_excess: self.expected_excess(),
            samples: self.scene.whitener().used_count(),
            parameters: 3 * found.len() + usize::from(self.model.offset_precision().is_some()),
            background_offset_dn: self.scene.offset_dn(),
            saturated: samples.iter().any(|&s| f64::from(s) >= self.model.full_scale_dn),
            refined_once: self.counts.n_candidates > 0,
            refined_twice: self.refined_twice || found.iter().any(|f| f.flags & flags::DIVERGED != 0),
            left_to_plain: true,
        }
    }

    /// Converts the remaining pulses to returns.
    fn report(&mut self, samples: &[u16]) -> Decomposition<'_> {
        let outcome = self.outcome(samples);
        let deviation_ratio = outcome.deviation_ratio();
        let misfit_factor = outcome.misfit_factor(deviation_ratio, &self.settings);
        for f in &self.scene.found {
            let width_ratio = f.pulse.ln_width_ratio.exp();
            let factor = misfit_factor * self.model.pulse_error_factor;
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
                    | if self.allowance.overdrives(f.pulse.height_dn) { flags::OVERDRIVEN } else { 0 }
                    | if misfit_factor > 1.0 { flags::MISFIT } else { 0 }
                    | if self.is_misshapen(f) { flags::UNUSUAL } else { 0 },
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
        // The flanks determine a clipped pulse. Too little is left without one of them, or without most of
        // the core.
        let lost = core.clone().filter(|&k| saturated(k)).count();
        let no_flank = within(1.5, 0.0).all(saturated) || within(0.0, 1.5).all(saturated);
        if lost as f64 > 0.6 * core.len() as f64 || no_flank {
            flags |= flags::EXTREMELY_SATURATED;
        }
    }
    flags
}
