//! The current waveform and its pulses.

mod trial;

use std::ops::Range;

use crate::detect::Candidate;
use crate::flags;
use crate::pulse_fit::{FIXED_WIDTH_PRECISION, PulseFit, StopCriteria};
use crate::sensor_model::{ChannelModel, ModelError};
use crate::shape::Pulse;
use crate::shape::Shape;
use crate::whitening::Whitener;

use super::DecomposeSettings;
use super::score::TestScore;
use crate::decompose::acceptance::{CLEAR_OF_ZERO_SD, CLUSTER_WIDTHS, least_separation_samples};
use trial::Saved;

/// Iterations with fixed width for pulses that start from the calibrated width.
const FROZEN_ITERATIONS: usize = 8;

/// A pulse with its uncertainties.
#[derive(Debug, Clone, Copy)]
pub(super) struct Found {
    pub(super) pulse: Pulse,
    /// Standard deviations of height (DN), position (samples) and ln width.
    pub(super) sd: [f64; 3],
    pub(super) flags: u16,
    /// Whether the last fit failed to determine it.
    pub(super) failed: bool,
}

impl Found {
    pub(super) fn new(height_dn: f64, position_samples: f64, ln_width_ratio: f64) -> Found {
        let pulse = Pulse { height_dn, position_samples, ln_width_ratio, ln_width_precision: 0.0 };
        Found { pulse, sd: [f64::NAN; 3], flags: 0, failed: false }
    }

    pub(super) fn from_candidate(candidate: &Candidate) -> Found {
        Found::new(candidate.height_dn, candidate.position_samples, candidate.ln_width_ratio)
    }
}

/// Samples, pulses and workspace of the fit.
#[derive(Debug, Clone)]
pub(super) struct FitScene {
    pub(super) found: Vec<Found>,
    shape: Shape,
    fwhm_samples: f64,
    offset_is_free: bool,
    overlap_precision: f64,
    limits: StopCriteria,
    whitener: Whitener,
    fitter: PulseFit,
    target_dn: Vec<f64>,
    used: Vec<bool>,
    /// `target_dn` minus pulses and offset.
    residual_dn: Vec<f64>,
    whitened: Vec<f64>,
    offset_dn: f64,
    chi_square: f64,
    starts: Vec<Pulse>,
    cluster_ends: Vec<usize>,
    before: Saved,
    best: Saved,
    score: TestScore,
}

impl FitScene {
    pub(super) fn new(
        model: &ChannelModel,
        settings: &DecomposeSettings,
        shape: Shape,
        max_samples: usize,
    ) -> Result<FitScene, ModelError> {
        let fwhm_samples = shape.fwhm_samples();
        let pulses = settings.max_returns;
        let saved = || Saved { found: Vec::with_capacity(pulses), ..Saved::default() };
        Ok(FitScene {
            found: Vec::with_capacity(pulses),
            shape: shape.clone(),
            fwhm_samples,
            offset_is_free: model.offset_precision().is_some(),
            overlap_precision: settings.overlap_ln_width_sd.powi(-2),
            limits: StopCriteria::exact(settings.iterations),
            whitener: Whitener::new(model.noise()?, max_samples),
            fitter: PulseFit::new(shape.clone(), model.offset_precision(), max_samples, pulses),
            target_dn: Vec::with_capacity(max_samples),
            used: Vec::with_capacity(max_samples),
            residual_dn: Vec::with_capacity(max_samples),
            whitened: Vec::with_capacity(max_samples),
            offset_dn: 0.0,
            chi_square: 0.0,
            starts: Vec::with_capacity(pulses),
            cluster_ends: Vec::with_capacity(pulses),
            before: saved(),
            best: saved(),
            score: TestScore::new(shape, model.offset_precision().is_some(), max_samples, pulses),
        })
    }

    pub(super) fn shape(&self) -> &Shape {
        &self.shape
    }

    pub(super) fn whitener(&self) -> &Whitener {
        &self.whitener
    }

    /// Samples minus the channel's background.
    pub(super) fn target_dn(&self) -> &[f64] {
        &self.target_dn
    }

    /// Samples minus background and pulses, after the last [`Scene::update_residual`].
    pub(super) fn residual_dn(&self) -> &[f64] {
        &self.residual_dn
    }

    /// Whitened residual, after the last [`Scene::update_residual`].
    pub(super) fn whitened(&self) -> &[f64] {
        &self.whitened
    }

    pub(super) fn offset_dn(&self) -> f64 {
        self.offset_dn
    }

    pub(super) fn chi_square(&self) -> f64 {
        self.chi_square
    }

    pub(super) fn fwhm_samples(&self) -> f64 {
        self.fwhm_samples
    }

    /// Minimum separation of two pulses.
    pub(super) fn least_separation(&self) -> f64 {
        least_separation_samples(self.fwhm_samples)
    }

    /// Loads a new waveform; `first` is the index in the block of its first sample.
    ///
    /// Returns whether its length or its usable samples differ from the last one's.
    pub(super) fn load(
        &mut self,
        model: &ChannelModel,
        samples: &[u16],
        first: usize,
        recovery_samples: usize,
    ) -> bool {
        self.found.clear();
        self.target_dn.clear();
        self.used.clear();
        let clear_dn = CLEAR_OF_ZERO_SD * model.noise_sd_dn;
        let mut recovering = 0;
        model.window_signal_into(samples, first, &mut self.target_dn);
        for (k, &sample) in samples.iter().enumerate() {
            let value = f64::from(sample);
            let background = model.background_at(first + k);
            if value >= model.full_scale_dn {
                // One more than recovers: the saturated sample itself.
                recovering = recovery_samples + 1;
            }
            // With a background far above 0, a sample of 0 is the clipped undershoot of a strong pulse.
            self.used.push(recovering == 0 && (sample > 0 || background < clear_dn));
            recovering = recovering.saturating_sub(1);
        }
        let changed = self.whitener.set_used(&self.used);
        self.fit_offset_alone();
        changed
    }

    /// Removes all pulses.
    pub(super) fn clear(&mut self) {
        self.found.clear();
        self.fit_offset_alone();
    }

    /// Fits the offset to the samples without pulses.
    fn fit_offset_alone(&mut self) {
        self.offset_dn = 0.0;
        if self.offset_is_free {
            self.fitter.fit(&self.whitener, &self.target_dn, &[], self.limits);
            self.offset_dn = self.fitter.offset_dn();
        }
        self.update_residual();
    }

    /// Sets pulses and offset.
    pub(super) fn show(&mut self, found: impl Iterator<Item = Found>, offset_dn: f64) {
        self.found.clear();
        self.found.extend(found);
        self.offset_dn = offset_dn;
        self.update_residual();
    }

    /// Updates residual and chi-square for the current pulse parameters.
    pub(super) fn update_residual(&mut self) {
        self.residual_dn.clear();
        self.residual_dn.extend(self.target_dn.iter().map(|y| y - self.offset_dn));
        for f in &self.found {
            self.shape.add(&f.pulse, -1.0, &mut self.residual_dn);
        }
        self.whitened.clear();
        self.whitened.extend_from_slice(&self.residual_dn);
        self.whitener.whiten(&mut self.whitened);
        self.chi_square = self.whitened.iter().map(|r| r * r).sum();
    }

    /// Whether two pulses overlap.
    pub(super) fn overlap(&self, i: usize, j: usize) -> bool {
        let (a, b) = (&self.found[i].pulse, &self.found[j].pulse);
        let width_ratio = a.ln_width_ratio.max(b.ln_width_ratio).max(0.0).exp();
        let reach = CLUSTER_WIDTHS * self.fwhm_samples * width_ratio;
        (a.position_samples - b.position_samples).abs() < reach
    }

    /// Returns the end of the cluster that starts at pulse `i`.
    ///
    /// Pulses are sorted. All pulses are one cluster if they share an offset.
    fn cluster_end(&self, start: usize) -> usize {
        let mut end = start + 1;
        while end < self.found.len() && (self.offset_is_free || self.overlap(end - 1, end)) {
            end += 1;
        }
        end
    }

    /// Returns the cluster of pulse `index`.
    fn cluster_around(&self, index: usize) -> Range<usize> {
        let mut start = 0;
        loop {
            let end = self.cluster_end(start);
            if index < end || end >= self.found.len() {
                return start..end;
            }
            start = end;
        }
    }

    fn sort(&mut self) {
        self.found.sort_unstable_by(|a, b| a.pulse.position_samples.total_cmp(&b.pulse.position_samples));
    }

    /// Fits all pulses, cluster by cluster.
    ///
    /// Repeats if the fitted widths and positions change the clusters.
    pub(super) fn fit_all(&mut self) {
        self.fit_clusters(self.limits);
    }

    /// As [`Scene::fit`], to the accuracy needed for chi-square.
    pub(super) fn fit_all_roughly(&mut self) {
        self.fit_clusters(StopCriteria::rough(self.limits.iterations));
    }

    fn fit_clusters(&mut self, limits: StopCriteria) {
        self.sort();
        for _ in 0..3 {
            let mut start = 0;
            self.cluster_ends.clear();
            while start < self.found.len() {
                start = self.cluster_end(start);
                self.cluster_ends.push(start);
            }
            start = 0;
            for i in 0..self.cluster_ends.len() {
                let end = self.cluster_ends[i];
                self.fit_cluster(start..end, limits);
                start = end;
            }
            self.sort();
            let same = (0..self.cluster_ends.len())
                .scan(0, |start, _| {
                    *start = if *start < self.found.len() { self.cluster_end(*start) } else { usize::MAX };
                    Some(*start)
                })
                .eq(self.cluster_ends.iter().copied());
            if same {
                break;
            }
        }
        if self.found.is_empty() {
            self.fit_offset_alone();
        }
        self.update_residual();
    }

    /// Fits the cluster of pulse `index` as far as a trial requires.
    ///
    /// The trial must lower chi-square by `gain`. `from_calibrated_width` first keeps the widths at
    /// that value.
    pub(super) fn fit_around(&mut self, index: usize, from_calibrated_width: bool, gain: f64) {
        let cluster = self.cluster_around(index);
        // With free widths, unequal pairs often end in a local minimum: one narrow and one wide pulse.
        if from_calibrated_width {
            for f in &mut self.found[cluster.clone()] {
                f.pulse.ln_width_ratio = 0.0;
                f.pulse.ln_width_precision = FIXED_WIDTH_PRECISION;
            }
            self.fit_as_is(cluster.clone(), StopCriteria::rough(FROZEN_ITERATIONS));
        }
        // A trial must beat the best one so far and gain enough.
        let enough = self.best.objective.min(self.before.chi_square - gain);
        self.fit_cluster(cluster, StopCriteria { enough, ..StopCriteria::rough(self.limits.iterations) });
        self.sort();
        self.update_residual();
    }

    /// Sets the width priors of overlapping pulses, then fits.
    fn fit_cluster(&mut self, cluster: Range<usize>, limits: StopCriteria) {
        for i in cluster.clone() {
            let overlaps =
                (i > 0 && self.overlap(i - 1, i)) || (i + 1 < self.found.len() && self.overlap(i, i + 1));
            self.found[i].pulse.ln_width_precision = if overlaps { self.overlap_precision } else { 0.0 };
        }
        self.fit_as_is(cluster, limits);
    }

    /// Fits the pulses of a cluster to the samples minus the other pulses.
    fn fit_as_is(&mut self, cluster: Range<usize>, limits: StopCriteria) {
        self.residual_dn.clear();
        self.residual_dn.extend_from_slice(&self.target_dn);
        self.starts.clear();
        for (i, f) in self.found.iter().enumerate() {
            if cluster.contains(&i) {
                self.starts.push(f.pulse);
            } else {
                self.shape.add(&f.pulse, -1.0, &mut self.residual_dn);
            }
        }
        let fit = self.fitter.fit(&self.whitener, &self.residual_dn, &self.starts, limits);
        let fitted = fit.chi_square.is_finite();
        if fitted {
            self.offset_dn = self.fitter.offset_dn();
        }
        for (i, f) in self.found[cluster].iter_mut().enumerate() {
            f.sd = self.fitter.pulse_sd(i);
            f.failed = !fitted || f.sd.iter().any(|sd| !sd.is_finite());
            if fitted {
                let moved = self.fitter.pulses()[i];
                if (moved.position_samples - f.pulse.position_samples).abs() > self.fwhm_samples {
                    f.flags |= flags::DIVERGED;
                }
                f.pulse = moved;
            }
            // Fits of trials are rough, and end early on purpose.
            if !fit.termination.is_optimum() && limits == self.limits {
                f.flags |= flags::DIVERGED;
            }
        }
    }

    /// Evidence that pulse `index` is two, by [`Score::statistic`].
    ///
    /// The residual must be up to date.
    pub(super) fn score(&mut self, index: usize) -> f64 {
        let cluster = self.cluster_around(index);
        let pulses = self.found[cluster].iter().map(|f| f.pulse);
        let pulse = self.found[index].pulse;
        self.score.statistic(&self.whitener, pulses, pulse, &self.whitened)
    }

    /// Inserts a pulse in order and returns its index.
    pub(super) fn insert(&mut self, found: Found) -> usize {
        let position = found.pulse.position_samples;
        let index = self.found.partition_point(|f| f.pulse.position_samples < position);
        self.found.insert(index, found);
        index
    }
}
