//! Residual search after the first fit: overlooked pulses, and widened pulses that are two.

use std::ops::Range;

use super::Mode;
use super::candidates::{Candidates, FilterPeak};
use super::detection::FilterResiduals;
use super::fit::Aim;
use super::fit_queue::{add, take_off};
use super::layout::U_MAX;
use super::level::JointSquares;
use super::pulse_model::{MAX_TRIAL, PulseComponent, PulseModel};
use super::rows::BATCH;
use super::score_test::Scores;
use super::trial::{Change, Trial, divided};
use super::workspace::{ChiSquares, Decompose, FitBuffers, SearchBuffers, Workspace};
use crate::decompose::acceptance::{DIVIDED_PARTS, GAIN_PART, HIDING_WIDTH_RATIO, TRIAL_PART, too_near};
use crate::flags;

/// Maximum number of rounds; a waveform that still changes goes to the scalar kernels.
const ROUNDS: usize = 8;
/// Fraction of the required gain that a trial must reach with a fixed level.
///
/// With several pulses, chi-square may decrease by only this fraction of the decrease with a free
/// level.
const HELD_PART: f32 = 0.5;
/// Margin below the required gain within which an unfinished trial stays undecided.
const OPEN_GAIN: f32 = 4.0;

impl Decompose<'_> {
    /// Adds and splits pulses as long as chi-square decreases enough; refined mode only.
    pub(super) fn search_residuals(&mut self) {
        if self.mode != Mode::Refined || self.settings.max_added == 0 {
            return;
        }
        let Workspace { pulse_models, search: SearchBuffers { active, rivals, wide, .. }, .. } =
            &mut *self.work;
        active.clear();
        rivals.clear();
        rivals.resize(pulse_models.len(), f32::INFINITY);
        wide.clear();
        for (row, (pulse_model, rival)) in pulse_models.iter().zip(rivals).enumerate() {
            if pulse_model.is_fast() && is_cut_short(pulse_model) {
                match least_beyond(pulse_model) {
                    Some(least) => *rival = least,
                    None => wide.push((row, *pulse_model)),
                }
            }
        }
        let room = 1..self.settings.max_returns;
        let begun = pulse_models
            .iter()
            .enumerate()
            .filter(|(_, pulse_model)| pulse_model.is_fast() && room.contains(&pulse_model.pulses().len()));
        active.extend(begun.map(|(row, _)| row));
        for _ in 0..ROUNDS {
            if self.work.search.active.is_empty() {
                break;
            }
            self.start_round();
            self.search();
            for is_first in [true, false] {
                self.plan_additions(is_first);
                self.run_trials();
            }
            if let Some(evidence) = self.settings.split_evidence {
                self.plan_divisions(evidence);
                self.run_trials();
            }
            self.end_round();
        }
        self.compare_with_wide();
        let Workspace { pulse_models, search, .. } = &mut *self.work;
        for &row in &search.active {
            pulse_models[row].leave_to_scalar();
        }
        for (pulse_model, &rival) in pulse_models.iter_mut().zip(&search.rivals) {
            if pulse_model.is_fast() && (is_cut_short(pulse_model) || may_be_wider(pulse_model, rival)) {
                pulse_model.leave_to_scalar();
            }
        }
    }

    /// Passes a waveform to the scalar kernels if pulses wider than the tables fit it about as well as those that
    /// replaced them: each added pulse must lower chi-square by `split_evidence`.
    ///
    /// Only the scalar form can evaluate pulses of any width.
    fn compare_with_wide(&mut self) {
        let Workspace { pulse_models, search, .. } = &mut *self.work;
        for (row, before) in &search.wide {
            let pulse_model = &mut pulse_models[*row];
            if !pulse_model.is_fast() || is_cut_short(pulse_model) {
                continue;
            }
            let pulses = before.pulses().iter().map(|p| p.values().map(f64::from));
            let of_wide = self.plain.chi_square_of(self.blocks[*row].samples, pulses);
            let added = pulse_model.pulses().len().saturating_sub(before.pulses().len());
            let gain = self.settings.split_evidence.unwrap_or(0.0) * added as f64;
            if f64::from(pulse_model.chi_square) > of_wide - gain {
                pulse_model.leave_to_scalar();
            }
        }
    }

    fn start_round(&mut self) {
        let Workspace { pulse_models, fits, search, .. } = &mut *self.work;
        fits.due.clear();
        for &row in &search.active {
            pulse_models[row].start_search_round();
        }
    }

    /// Keeps the changed waveforms with room for more pulses; fits their clusters again.
    fn end_round(&mut self) {
        let fwhm = self.fwhm();
        let Workspace {
            pulse_models,
            fits: FitBuffers { due, .. },
            search: SearchBuffers { active, .. },
            ..
        } = &mut *self.work;
        active.retain(|&row| pulse_models[row].has_changed() && pulse_models[row].is_fast());
        for &row in active.iter() {
            pulse_models[row].set_clusters(fwhm);
            let pulses = pulse_models[row].pulses();
            let is_fitted = pulses.len() <= MAX_TRIAL && pulses.iter().all(PulseComponent::is_fitted);
            // A single cluster of a trial's size has just been fitted.
            if !is_fitted || pulse_models[row].cluster(1).is_some() {
                due.push(row);
            }
        }
        self.fit_clusters(1);
        let Workspace { which, fits, search, .. } = &mut *self.work;
        which.clear();
        if self.tables.level.is_some() {
            which.extend_from_slice(&search.active);
            self.set_levels_of_which();
        } else {
            which.extend_from_slice(&fits.due);
            self.sum_squares();
        }
        let Workspace { pulse_models, search, .. } = &mut *self.work;
        let settings = self.settings;
        search.active.retain(|&row| {
            let pulse_model = &pulse_models[row];
            let room = pulse_model.pulses().len() < settings.max_returns
                && pulse_model.counts.n_added < settings.max_added;
            room && pulse_model.is_fast()
        });
    }

    /// Finds the candidates in the residual of each active waveform.
    fn search(&mut self) {
        let least = TRIAL_PART as f32 * self.thresholds.sigma.least as f32;
        let Workspace { rows, detection, search, .. } = &mut *self.work;
        let (columns, which) = (&mut detection.columns, &search.active);
        let out = &mut detection.candidates;
        self.on.run(FilterResiduals { tables: self.tables, rows, columns, which, threshold: least, out });
    }

    /// Plans trials with one more pulse.
    ///
    /// First at the largest maximum of each residual, from the most likely start values. Waveforms
    /// not improved by it get other start values, and a trial at the second maximum.
    fn plan_additions(&mut self, is_first: bool) {
        for i in 0..self.work.search.active.len() {
            let row = self.work.search.active[i];
            let pulse_model = &self.work.pulse_models[row];
            if pulse_model.has_changed() || !pulse_model.is_fast() {
                continue;
            }
            let [first, second] = self.greatest(pulse_model, &self.work.detection.candidates[i]);
            if is_first {
                first.into_iter().for_each(|candidate| self.plan_addition(row, &candidate, true));
            } else {
                first.into_iter().for_each(|candidate| self.plan_addition(row, &candidate, false));
                second.into_iter().for_each(|candidate| self.plan_addition(row, &candidate, true));
            }
        }
    }

    /// Returns the two candidates highest above their thresholds, if worth a trial.
    fn greatest(&self, pulse_model: &PulseModel, found: &Candidates) -> [Option<FilterPeak>; 2] {
        let least = TRIAL_PART * self.thresholds.sigma.least;
        let mut best: [(f64, Option<FilterPeak>); 2] = [(least, None); 2];
        for candidate in found.as_slice() {
            let raise = self.thresholds.raise(pulse_model, candidate.position_samples, f32::INFINITY);
            let strength = f64::from(candidate.statistic) / raise;
            if strength >= best[0].0 {
                best = [(strength, Some(*candidate)), best[0]];
            } else if strength >= best[1].0 {
                best[1] = (strength, Some(*candidate));
            }
        }
        best.map(|(_, candidate)| candidate)
    }

    fn plan_addition(&mut self, row: usize, candidate: &FilterPeak, is_likely: bool) {
        let pulse_model = self.work.pulse_models[row];
        let position = candidate.position_samples;
        let threshold = self.thresholds.threshold(&pulse_model, position, f32::INFINITY);
        let gain = (GAIN_PART * threshold * threshold) as f32;
        let trial = Trial::near(row, &pulse_model, position, self.fwhm(), gain);
        let added = PulseComponent::new([candidate.statistic / self.thresholds.per_dn, position, 0.0]);
        if is_likely {
            self.plan(trial, &pulse_model, Change::Add(added));
        }
        let distance = |i: &usize| (pulse_model.pulses()[*i].position() - position).abs();
        let nearest = trial.old().min_by(|i, j| distance(i).total_cmp(&distance(j)));
        let Some(nearest) = nearest else { return };
        let ratio = pulse_model.pulses()[nearest].width_ratio();
        if distance(&nearest) < 1.5 * self.fwhm() * ratio.max(1.0) && ratio > HIDING_WIDTH_RATIO as f32 {
            let change = if is_likely {
                Change::Divide(nearest, DIVIDED_PARTS[0] as f32)
            } else {
                Change::AddToNarrow(added, nearest)
            };
            self.plan(trial, &pulse_model, change);
        }
    }

    /// Plans trials that split widened pulses with a high score.
    fn plan_divisions(&mut self, evidence: f64) {
        self.work.search.suspects.clear();
        self.work.search.suspect_numbers.clear();
        for i in 0..self.work.search.active.len() {
            let row = self.work.search.active[i];
            let pulse_model = &self.work.pulse_models[row];
            if pulse_model.has_changed() || !pulse_model.is_fast() {
                continue;
            }
            for (number, pulse) in pulse_model.pulses().iter().enumerate() {
                let height = f64::from(pulse.height());
                // Overdrive widens single echoes too. If such a waveform remains unexplained, the scalar
                // kernels try it with a stricter rule.
                if pulse.width_ratio() > HIDING_WIDTH_RATIO as f32
                    && !self.thresholds.allowance.overdrives(height)
                {
                    self.work.search.suspects.push((row, *pulse));
                    self.work.search.suspect_numbers.push(number);
                }
            }
        }
        let Workspace { rows, search: SearchBuffers { suspects, scores, .. }, .. } = &mut *self.work;
        self.on.run(Scores { tables: self.tables, rows, pulses: suspects, out: scores });
        let [equal, stronger, weaker] = DIVIDED_PARTS.map(|part| part as f32);
        for i in 0..self.work.search.suspects.len() {
            let (row, _) = self.work.search.suspects[i];
            let (score, is_earlier) = self.work.search.scores[i];
            if f64::from(score) > self.settings.split_score {
                // The sign of the score shows which of two pulses is stronger, so one unequal start suffices.
                let part = if is_earlier { stronger } else { weaker };
                self.plan_division(row, self.work.search.suspect_numbers[i], [equal, part], evidence);
            }
        }
    }

    fn plan_division(&mut self, row: usize, number: usize, parts: [f32; 2], evidence: f64) {
        let pulse_model = self.work.pulse_models[row];
        let position = pulse_model.pulses()[number].position();
        // An apparent split due to an error of the response is not evidence.
        let raise = self.thresholds.raise(&pulse_model, position, f32::INFINITY);
        let gain = (evidence * raise * raise) as f32;
        let trial = Trial::around(row, &pulse_model, number, self.fwhm(), gain);
        for part in parts {
            self.plan(trial, &pulse_model, Change::Divide(number, part));
        }
    }

    /// Plans a trial that changes its old pulses.
    fn plan(&mut self, mut trial: Trial, pulse_model: &PulseModel, change: Change) {
        let old = trial.old();
        let (count, pulses) = (old.len() + 1, &mut trial.pulses);
        pulses[..old.len()].copy_from_slice(&pulse_model.pulses()[old.clone()]);
        match change {
            Change::Add(added) => pulses[count - 1] = added,
            Change::AddToNarrow(added, nearest) => {
                pulses[..old.len()].iter_mut().for_each(|p| p.set_values([p.height(), p.position(), 0.0]));
                pulses[nearest - old.start].flags |= flags::DIVERGED;
                pulses[count - 1] = added.flagged(flags::DIVERGED);
            }
            Change::Divide(number, part) => {
                let [first, second] = divided(&pulse_model.pulses()[number], part, self.fwhm());
                pulses[number - old.start] = first;
                pulses[count - 1] = second;
            }
        }
        pulses[..count].sort_unstable_by(|a, b| a.position().total_cmp(&b.position()));
        trial.count = count;
        self.work.search.trials.push(trial);
    }

    /// Fits all trials and accepts the best of each waveform if justified.
    ///
    /// Each trial has its own row.
    fn run_trials(&mut self) {
        let batch = self.work.rows.batch();
        let count = self.work.search.trials.len();
        let mut first = 0;
        while first < count {
            let trials = &self.work.search.trials;
            let mut end = (first + batch).min(count);
            // All trials of a waveform are in one group: the next group overwrites their rows.
            while end < count && end > first + 1 && trials[end].row == trials[end - 1].row {
                end -= 1;
            }
            self.fit_trials(first..end);
            let mut start = first;
            while start < end {
                let trials = &self.work.search.trials[start..end];
                let of_waveform = trials.iter().take_while(|trial| trial.row == trials[0].row).count();
                self.judge(start..start + of_waveform, first);
                start += of_waveform;
            }
            first = end;
        }
        self.work.search.trials.clear();
    }

    /// Accepts the best of a waveform's trials.
    ///
    /// If none is acceptable, but one without an optimum might be, the scalar kernels decompose the
    /// waveform unless it is explained. Trial `i` has row `BATCH + i - first`.
    fn judge(&mut self, trials: Range<usize>, first: usize) {
        let all = &self.work.search.trials;
        let row = all[trials.start].row;
        let pulse_model = &self.work.pulse_models[row];
        if !pulse_model.is_fast() {
            return;
        }
        let gained = |i: usize| pulse_model.chi_square - all[i].chi_square - all[i].gain;
        let ended = trials.clone().filter(|&i| all[i].objective.is_finite());
        let best = ended.min_by(|&i, &j| all[i].objective.total_cmp(&all[j].objective));
        let open = trials.filter(|&i| !all[i].has_ended && !all[i].is_dropped);
        let open = open.min_by(|&i, &j| all[i].chi_square.total_cmp(&all[j].chi_square));
        // A further pulse may give an optimum to a trial without one.
        let accepted = best.filter(|&i| gained(i) >= 0.0).or(open.filter(|&i| gained(i) >= 0.0));
        if let Some(accepted) = accepted {
            let trial = all[accepted];
            self.take_up(&trial, BATCH + accepted - first);
        } else if open.is_some_and(|open| gained(open) > -OPEN_GAIN) {
            self.work.pulse_models[row].set_undecided();
        }
    }

    fn fit_trials(&mut self, trials: Range<usize>) {
        let (on, tables) = (self.on, self.tables);
        let Workspace { rows, pulse_models, which, squares: out, fits, search, .. } = &mut *self.work;
        let (FitBuffers { queues, done: results, .. }, SearchBuffers { trials: all, levels, .. }) =
            (fits, search);
        let all = &mut all[trials];
        for ((row, at), trial) in (BATCH..).zip(0..).zip(&*all) {
            let pulse_model = &pulse_models[trial.row];
            rows.copy(trial.row, row);
            for pulse in &pulse_model.pulses()[trial.old()] {
                add(on, tables, rows, row, pulse.values(), 1.0);
            }
            let mut values = [[0.0; 3]; MAX_TRIAL];
            for (values, pulse) in values.iter_mut().zip(trial.pulses()) {
                *values = pulse.values();
            }
            // The fit holds the level, so another pulse lowers chi-square by less than with a free
            // level.
            let least_gain = match tables.level {
                Some(_) => HELD_PART * trial.gain * self.thresholds.left_by_level(pulse_model) as f32,
                None => trial.gain,
            };
            let aim = Aim::trial(pulse_model.chi_square - least_gain, trial.row);
            queues.push(tables, row, &values[..trial.count], aim, at);
        }
        let precision = self.settings.overlap_ln_width_sd.powi(-2) as f32;
        queues.run(on, tables, rows, precision, results);
        for done in &results.list {
            let fitted = results.pulses(done);
            let trial = &mut all[done.tag];
            trial.is_dropped = done.is_dropped;
            trial.has_ended = done.is_optimum;
            for (pulse, fitted) in trial.pulses.iter_mut().zip(fitted) {
                pulse.take(fitted);
                pulse.sds = fitted.sds;
                pulse.flags |= flags::REFINED;
            }
        }
        take_off(on, tables, rows, results);
        let least = self.thresholds.least_separation;
        which.clear();
        which.extend(BATCH..BATCH + all.len());
        if let Some(level) = &tables.level {
            levels.clear();
            levels.extend(all.iter().map(|trial| {
                let pulse_model = &pulse_models[trial.row];
                [pulse_model.level_dn, trial.level_information(pulse_model)]
            }));
            on.run(JointSquares { tables, level, rows, which, levels, out });
        } else {
            on.run(ChiSquares { rows, which, out });
        }
        for (trial, square) in all.iter_mut().zip(&*out) {
            trial.chi_square = *square;
            if trial.has_ended {
                let old = &pulse_models[trial.row].pulses()[trial.old()];
                // A trial that brings two pulses closer than the minimum separation is no
                // improvement.
                let near =
                    |pulses: &[PulseComponent]| too_near(pulses.iter().map(PulseComponent::position), least);
                if near(trial.pulses()) <= near(old) {
                    let widths: f32 = trial.pulses().iter().map(|p| p.values()[2].powi(2)).sum();
                    trial.objective = square + if trial.count > 1 { precision * widths } else { 0.0 };
                }
            }
        }
    }

    /// Replaces the pulses of a waveform by those of a trial.
    ///
    /// `residual` is the row of the trial.
    fn take_up(&mut self, trial: &Trial, residual: usize) {
        let work = &mut *self.work;
        let pulse_model = &mut work.pulse_models[trial.row];
        let before = *pulse_model;
        if !pulse_model.replace(trial.old(), trial.pulses()) {
            pulse_model.leave_to_scalar();
            return;
        }
        let samples = work.rows.length(trial.row);
        if !trial.pulses().iter().all(|pulse| self.thresholds.is_return(pulse_model, pulse, samples)) {
            // One of its pulses would be dropped as a return. If that leaves the waveform unexplained,
            // the scalar kernels decompose it.
            *pulse_model = before;
            return;
        }
        if !trial.has_ended {
            // It counts as not fitted until its cluster is.
            let fitted = trial.old.0..trial.old.0 + trial.count;
            pulse_model.pulses_mut()[fitted].iter_mut().for_each(|pulse| pulse.sds = [0.0; 3]);
        }
        work.rows.copy(residual, trial.row);
        // What pulses wider than the tables could reach, with as many other pulses.
        let replaces_wide = before.pulses()[trial.old()].iter().any(is_widest);
        let decrease = pulse_model.chi_square - trial.chi_square;
        work.search.rivals[trial.row] -= if replaces_wide { trial.gain } else { decrease };
        pulse_model.chi_square = trial.chi_square;
        pulse_model.sort();
        pulse_model.accept_trial();
    }
}

/// Whether a pulse is at the width limit of the tables.
fn is_cut_short(pulse_model: &PulseModel) -> bool {
    pulse_model.pulses().iter().any(is_widest)
}

/// Whether pulses wider than the tables might explain the waveform better than those that replaced
/// them: `rival` is the least chi-square they could reach.
fn may_be_wider(pulse_model: &PulseModel, rival: f32) -> bool {
    let is_resolved = pulse_model.chi_square < pulse_model.samples as f32 + NO_GOOD_FIT
        && pulse_model.pulses().iter().all(|pulse| pulse.width_ratio() < RESOLVED_WIDTH_RATIO);
    pulse_model.chi_square > rival && !is_resolved
}

fn is_widest(pulse: &PulseComponent) -> bool {
    pulse.values()[2] >= U_MAX as f32
}

/// Bound on the decrease of chi-square by widths beyond the tables.
///
/// The sum of this many promised decreases of the next step and this fraction of chi-square.
/// Measured for pulses composed of two: at most 3 decreases and this fraction.
const BEYOND_REACH: f32 = 4.0;
const BEYOND_PART: f32 = 0.1;
/// Chi-square in excess of the number of samples that excludes a good fit.
///
/// It is six standard deviations for 60 samples.
const NO_GOOD_FIT: f32 = 64.0;

/// Width ratio below which the pulses of a good fit cannot be parts of one beyond the tables.
///
/// Two pulses that imitate one of 2.3 calibrated widths have 1.7 each.
const RESOLVED_WIDTH_RATIO: f32 = 1.5;

/// Lower bound of chi-square with widths beyond the limit of the tables.
///
/// `None` if it could be a good fit. A waveform below the bound in the end is explained better than
/// by the wide pulses.
fn least_beyond(pulse_model: &PulseModel) -> Option<f32> {
    let least = (1.0 - BEYOND_PART) * pulse_model.chi_square - BEYOND_REACH * pulse_model.beyond;
    (least > pulse_model.samples as f32 + NO_GOOD_FIT).then_some(least)
}
