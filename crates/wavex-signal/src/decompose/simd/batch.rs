//! Processes a batch of waveforms from samples to fitted pulses.

use super::Mode;
use super::detection::{Begin, DetectAll};
use super::filter::HIGHEST;
use super::fit::{Aim, FitJob};
use super::fit_queue::{add, take_off};
use super::fitted::FittedPulse;
use super::initial_guess::{ClearForStep, FromBank, OneStep};
use super::level::{SetLevels, widen};
use super::pulse_model::{MAX_CLUSTER, MAX_PULSES, PulseComponent, PulseModel};
use super::rows::FAST_BATCH;
use super::single_pulse::FitSingles;
use super::workspace::{ChiSquares, Decompose, DetectionBuffers, FitBuffers, Workspace};
use crate::flags;

/// Maximum number of joint steps of level and pulses.
///
/// Pulses that moved far are fitted between the steps.
const LEVEL_ROUNDS: usize = 3;

impl Decompose<'_> {
    /// Processes the batch.
    pub(super) fn run(mut self) {
        self.work.pulse_models.resize_with(self.blocks.len(), PulseModel::default);
        self.work.detection.by_count.clear();
        for first in (0..self.blocks.len()).step_by(FAST_BATCH) {
            // Only the single pulses of this part: their rows are still in the cache.
            let singles = self.work.detection.by_count.count(1);
            self.detect(first);
            if self.mode == Mode::Refined {
                self.fit_singles(singles);
            }
        }
        match self.mode {
            Mode::Fastest => self.step_each(false),
            Mode::FastSeparated => {
                self.step_each(true);
                // Separate pulses keep their step: only clusters of two or more are fitted.
                self.set_all_due();
                self.fit_clusters(2);
            }
            Mode::Refined => {
                self.set_all_due();
                self.fit_clusters(1);
                // Fitted again if positions or widths changed the clusters, or a fit has no optimum.
                // Unchanged clusters need no second fit: a pulse affects only later clusters, which were
                // fitted after it. A level affects all clusters, so they are fitted twice.
                for enough in [self.tables.level.as_ref().map(|_| 2), None] {
                    self.keep_due(enough);
                    self.fit_clusters(1);
                }
            }
        }
        if self.tables.level.is_some() {
            self.set_levels();
            if self.mode == Mode::Refined {
                self.search_residuals();
                // A fit sets standard deviations for a known level. The part of the level is added after
                // the last fit.
                widen(&mut self.work.pulse_models);
            }
            return;
        }
        self.select(PulseModel::needs_chi_square);
        self.sum_squares();
        self.search_residuals();
    }

    /// Brings level and pulses of all waveforms to their joint optimum.
    fn set_levels(&mut self) {
        self.select(PulseModel::needs_level);
        self.set_levels_of_which();
    }

    /// Lists the waveforms with a property in `which`, without a branch that depends on the waveform.
    #[inline(always)]
    fn select(&mut self, is_selected: impl Fn(&PulseModel) -> bool) {
        let Workspace { pulse_models, which, .. } = &mut *self.work;
        which.resize(pulse_models.len(), 0);
        let mut count = 0;
        for (row, pulse_model) in pulse_models.iter().enumerate() {
            which[count] = row;
            count += usize::from(is_selected(pulse_model));
        }
        which.truncate(count);
    }

    /// Brings level and pulses of the waveforms in `which` to their joint optimum.
    ///
    /// Waveforms already there are skipped. In the refined mode, pulses that moved far are fitted
    /// again.
    pub(super) fn set_levels_of_which(&mut self) {
        let Some(level) = &self.tables.level else { return };
        let follows = self.mode == Mode::Refined;
        for round in 0..LEVEL_ROUNDS {
            let Workspace { rows, pulse_models, which, fits, .. } = &mut *self.work;
            let moved = &mut fits.due;
            which.retain(|&row| pulse_models[row].needs_level());
            moved.clear();
            self.on.run(SetLevels { tables: self.tables, level, rows, pulse_models, which, follows, moved });
            if moved.is_empty() || round + 1 == LEVEL_ROUNDS {
                return;
            }
            self.keep_due(Some(1));
            let Workspace { pulse_models, which, fits, .. } = &mut *self.work;
            which.clone_from(&fits.due);
            which.iter().for_each(|&row| pulse_models[row].reopen());
            self.fit_clusters(1);
        }
    }

    pub(super) fn fwhm(&self) -> f32 {
        self.tables.fwhm_samples as f32
    }

    /// Loads, filters and whitens blocks and creates their pulse models.
    ///
    /// Processes [`FAST_BATCH`] blocks from `first` on, so that their data stay in the cache. The
    /// pulse models start with the candidates.
    fn detect(&mut self, first: usize) {
        let some = first..(first + FAST_BATCH).min(self.blocks.len());
        let Workspace { rows, pulse_models, detection, .. } = &mut *self.work;
        let DetectionBuffers { columns, by_count, .. } = detection;
        let begin = Begin {
            thresholds: self.thresholds,
            settings: self.settings,
            saturated: self.full_scale_dn.ceil().clamp(0.0, f64::from(HIGHEST)) as u16,
            clear_of_zero: self.clear_of_zero,
        };
        let (tables, blocks, pulse_models) =
            (self.tables, &self.blocks[some.clone()], &mut pulse_models[some]);
        self.on.run(DetectAll { tables, rows, columns, blocks, first, begin, pulse_models, by_count });
    }

    /// Fits the waveforms of one pulse, except the first `done` of them.
    fn fit_singles(&mut self, done: usize) {
        let Workspace { rows, pulse_models, which, detection, fits, .. } = &mut *self.work;
        let moved = &mut fits.due;
        which.clear();
        which.extend(detection.by_count.rows(1).skip(done));
        moved.clear();
        self.on.run(FitSingles { tables: self.tables, rows, pulse_models, which, moved });
        for &row in moved.iter() {
            pulse_models[row].reopen();
        }
    }

    /// Marks the clusters of all unfitted waveforms as due.
    fn set_all_due(&mut self) {
        let Workspace { pulse_models, fits: FitBuffers { due, .. }, .. } = &mut *self.work;
        due.clear();
        due.extend((0..pulse_models.len()).filter(|&row| pulse_models[row].needs_fit()));
        self.keep_due(Some(1));
    }

    /// Keeps the due waveforms with changed clusters, a pulse that is not fitted, or `enough` clusters.
    fn keep_due(&mut self, enough: Option<usize>) {
        let fwhm = self.fwhm();
        let Workspace { pulse_models, fits, .. } = &mut *self.work;
        fits.due.retain(|&row| {
            let pulse_model = &mut pulse_models[row];
            pulse_model.sort();
            let others = pulse_model.set_clusters(fwhm);
            let is_open = !pulse_model.pulses().iter().all(PulseComponent::is_fitted);
            let has_enough = enough.is_some_and(|clusters| pulse_model.cluster(clusters - 1).is_some());
            pulse_model.is_fast() && (others || is_open || has_enough)
        });
    }

    /// Subtracts all pulses from their waveform's row, unless already done.
    fn take_off_all(&mut self, row: usize) {
        let pulse_model = &mut self.work.pulse_models[row];
        if !pulse_model.subtract() {
            for pulse in pulse_model.pulses() {
                add(self.on, self.tables, &mut self.work.rows, row, pulse.values(), -1.0);
            }
        }
    }

    /// Makes one step on each pulse, or on each pulse without overlap.
    ///
    /// Processes the first pulse of each waveform, then the second, and so on. Pulses that one step
    /// cannot handle are few; they are fitted together at the end.
    fn step_each(&mut self, separated: bool) {
        let (on, tables, fwhm) = (self.on, self.tables, self.fwhm());
        let Workspace { rows, pulse_models, which, detection, fits, .. } = &mut *self.work;
        let (by_count, to_fit) = (&detection.by_count, &mut fits.to_fit);
        to_fit.clear();
        for number in 0..MAX_PULSES {
            on.run(ClearForStep { tables, rows, pulse_models, by_count, number, separated, fwhm, which });
            if !which.is_empty() {
                on.run(OneStep { tables, rows, pulse_models, which, number, to_fit });
            }
        }
        let to_fit = std::mem::take(&mut self.work.fits.to_fit);
        // One pulse per waveform at a time: `to_fit` is ordered by index.
        for to_fit in to_fit.chunk_by(|a, b| a.1 == b.1) {
            for &(row, number) in to_fit {
                let Workspace { rows, pulse_models, fits, .. } = &mut *self.work;
                let values = pulse_models[row].pulses()[number].values();
                // A fit needs its pulses on the row.
                if pulse_models[row].is_subtracted() {
                    add(on, tables, rows, row, values, 1.0);
                }
                fits.queues.push(tables, row, &[values], Aim::OPTIMUM, number);
            }
            self.run_clusters();
        }
        self.work.fits.to_fit = to_fit;
    }

    /// Fits the clusters of at least `least` pulses in the due waveforms.
    ///
    /// Processes the first cluster of each waveform, then the second, and so on.
    pub(super) fn fit_clusters(&mut self, least: usize) {
        let mut singles = std::mem::take(&mut self.work.fits.singles);
        let mut tags = std::mem::take(&mut self.work.fits.single_tags);
        let mut round = std::mem::take(&mut self.work.fits.round);
        round.clone_from(&self.work.fits.due);
        for number in 0..MAX_PULSES {
            singles.clear();
            tags.clear();
            round.retain(|&row| {
                let pulse_model = &self.work.pulse_models[row];
                pulse_model.is_fast() && pulse_model.cluster(number).is_some()
            });
            if round.is_empty() {
                break;
            }
            for &row in &round {
                let Some(cluster) = self.work.pulse_models[row].cluster(number) else { continue };
                // `beyond` is the sum over the clusters of one fit of the waveform.
                if number == 0 {
                    self.work.pulse_models[row].beyond = 0.0;
                }
                if cluster.len() > MAX_CLUSTER {
                    self.work.pulse_models[row].leave_to_scalar();
                } else if cluster.len() >= least
                    && let Some(single) = self.queue_cluster(row, cluster.clone())
                {
                    singles.push(single);
                    tags.push(cluster.start);
                }
            }
            let jobs = &mut singles;
            self.on.run(FromBank { tables: self.tables, rows: &self.work.rows, jobs });
            for (job, &tag) in singles.iter().zip(&tags) {
                self.work.fits.queues.push(self.tables, job.row, &job.pulses, Aim::OPTIMUM, tag);
            }
            self.run_clusters();
        }
        let fits = &mut self.work.fits;
        (fits.singles, fits.single_tags, fits.round) = (singles, tags, round);
    }

    /// Adds a cluster back to its row and queues its fit.
    ///
    /// Returns the job instead of queuing it for a single pulse that was never fitted: the width
    /// bank must find its start values.
    fn queue_cluster(&mut self, row: usize, cluster: std::ops::Range<usize>) -> Option<FitJob<1>> {
        let pulse_model = &self.work.pulse_models[row];
        // The only cluster of a waveform is on the row as long as its pulses were never subtracted.
        if pulse_model.is_subtracted() || cluster.len() < pulse_model.pulses().len() {
            self.take_off_all(row);
            for i in cluster.clone() {
                let values = self.work.pulse_models[row].pulses()[i].values();
                add(self.on, self.tables, &mut self.work.rows, row, values, 1.0);
            }
        }
        let mut values = [[0.0; 3]; MAX_CLUSTER];
        let pulses = &self.work.pulse_models[row].pulses()[cluster.clone()];
        for (values, pulse) in values.iter_mut().zip(pulses) {
            *values = pulse.values();
        }
        if let [pulse] = pulses
            && !pulse.is_fitted()
        {
            return Some(FitJob { row, pulses: [pulse.values()], aim: Aim::OPTIMUM });
        }
        self.work.fits.queues.push(self.tables, row, &values[..cluster.len()], Aim::OPTIMUM, cluster.start);
        None
    }

    /// Runs the queued fits and subtracts their pulses from the rows.
    fn run_clusters(&mut self) {
        let precision = self.settings.overlap_ln_width_sd.powi(-2) as f32;
        let Workspace { rows, pulse_models, fits: FitBuffers { queues, done: results, .. }, .. } =
            &mut *self.work;
        queues.run(self.on, self.tables, rows, precision, results);
        for done in &results.list {
            let fitted = results.pulses(done);
            let pulse_model = &mut pulse_models[done.row];
            if fitted.len() == pulse_model.pulses().len() {
                pulse_model.subtract();
            }
            // Without an optimum the pulse counts as not fitted: another may join it, or the scalar
            // kernels take the waveform.
            let settled = done.is_optimum && fitted.iter().all(FittedPulse::is_held);
            // The decrease promised beyond the tables counts only if they limit a width.
            if !fitted.iter().all(FittedPulse::is_held) {
                pulse_model.beyond += done.beyond;
            }
            let pulses = &mut pulse_model.pulses_mut()[done.tag..done.tag + fitted.len()];
            for (pulse, fitted) in pulses.iter_mut().zip(fitted) {
                pulse.take(fitted);
                pulse.flags |= flags::REFINED;
                if !settled {
                    pulse.flags |= flags::DIVERGED;
                }
                // The fast modes accept the pulse as it is.
                let stays = settled || (fitted.is_known() && self.mode != Mode::Refined);
                pulse.sds = if stays { fitted.sds } else { [0.0; 3] };
            }
        }
        take_off(self.on, self.tables, rows, results);
    }

    /// Computes chi-square of the waveforms in `which`, whose pulses are subtracted.
    pub(super) fn sum_squares(&mut self) {
        let Workspace { rows, pulse_models, squares, which, .. } = &mut *self.work;
        self.on.run(ChiSquares { rows, which, out: squares });
        for (&row, square) in which.iter().zip(squares) {
            pulse_models[row].chi_square = *square;
            pulse_models[row].samples = rows.counted(row);
        }
    }
}
