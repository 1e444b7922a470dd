//! Residual search, split test and pruning.

use super::scene::Found;
use super::{Counts, DEVIANT, Decomposer, Filter};
use crate::decompose::acceptance::{
    CLEAR_PART, DIVIDED_PARTS, GAIN_PART, HIDING_WIDTH_RATIO, OVERDRIVEN_HIDING_WIDTH_RATIO, TRIAL_PART,
    is_misshapen, is_outside, width_filter,
};
use crate::detect::Candidate;
use crate::flags;
use crate::shape::SD_OF_FWHM;

/// Maximum number of trials on one residual.
const TRIALS: usize = 3;

/// Start values of a cluster with an added pulse.
#[derive(Clone, Copy)]
enum Start {
    /// Current values.
    AsFitted,
    /// Calibrated width, fixed for some iterations.
    CalibratedWidth,
    /// The nearest pulse in two of calibrated width, with the same first moments.
    ///
    /// The first has this fraction of the energy.
    Apart(f64),
}

impl Decomposer {
    /// Adds pulses while they justify their parameters.
    ///
    /// At maxima of the residual, or by dividing widened pulses.
    pub(super) fn add_from_residual(&mut self, split_score: f64) {
        let room = |d: &Decomposer| {
            d.scene.found.len() < d.settings.max_returns && d.counts.n_added < d.settings.max_added
        };
        while room(self) && (self.add_one() || self.split_one(split_score)) {
            self.counts.n_added += 1;
            self.refined_twice = true;
        }
        if self.counts.n_added > 0 {
            self.scene.fit_all();
        }
    }

    /// Adds a pulse at one of the largest maxima of the residual.
    fn add_one(&mut self) -> bool {
        self.detector.filter(self.scene.whitener(), self.scene.residual_dn());
        self.candidates.clear();
        self.detector.maxima(TRIAL_PART * self.sigma.least, &mut self.candidates);
        self.candidates.sort_unstable_by(|a, b| b.statistic.total_cmp(&a.statistic));
        let starts = [Start::AsFitted, Start::CalibratedWidth, Start::Apart(0.5)];
        (0..self.candidates.len().min(TRIALS)).any(|i| {
            let candidate = self.candidates[i];
            let nearest = self.nearest(candidate.position_samples);
            let gain = GAIN_PART * self.threshold_at(candidate.position_samples, f64::INFINITY).powi(2);
            nearest.is_some_and(|nearest| self.try_starts(&starts, &candidate, nearest, gain))
        })
    }

    /// Divides the first widened pulse that two pulses fit better.
    fn split_one(&mut self, split_score: f64) -> bool {
        let Some(gain) = self.settings.split_evidence else { return false };
        let starts = DIVIDED_PARTS.map(Start::Apart);
        (0..self.scene.found.len()).any(|i| {
            let p = self.scene.found[i].pulse;
            let overdrives = self.allowance.overdrives(p.height_dn);
            if overdrives && p.ln_width_ratio.exp() < OVERDRIVEN_HIDING_WIDTH_RATIO
                || !self.may_hide_two(i, split_score)
            {
                return false;
            }
            // A division uses only the position of its candidate.
            let half = Candidate {
                position_samples: p.position_samples,
                statistic: 0.0,
                height_dn: p.height_dn,
                ln_width_ratio: 0.0,
            };
            // A decrease within the response error is no evidence. Two pulses that overdrive the
            // receiver only together have the response error of weaker ones.
            let allowed = match overdrives {
                true => self.allowance_if_divided(i),
                false => self.allowance_at(p.position_samples, f64::INFINITY),
            };
            self.try_starts(&starts, &half, i, gain * allowed * allowed)
        })
    }

    /// Whether a pulse is wide enough for two, and its score indicates two.
    fn may_hide_two(&mut self, index: usize, split_score: f64) -> bool {
        self.scene.found[index].pulse.ln_width_ratio.exp() > HIDING_WIDTH_RATIO
            && (split_score <= 0.0 || self.scene.score(index) > split_score)
    }

    fn overdrives(&self, index: usize) -> bool {
        self.allowance.overdrives(self.scene.found[index].pulse.height_dn)
    }

    fn count_overdriven(&self) -> usize {
        (0..self.scene.found.len()).filter(|&i| self.overdrives(i)).count()
    }

    fn nearest(&self, position_samples: f64) -> Option<usize> {
        let distance = |i: usize| (self.scene.found[i].pulse.position_samples - position_samples).abs();
        (0..self.scene.found.len()).min_by(|&i, &j| distance(i).total_cmp(&distance(j)))
    }

    /// Fits with one more pulse from several starts.
    ///
    /// Keeps the best if it lowers chi-square enough.
    fn try_starts(&mut self, starts: &[Start], candidate: &Candidate, nearest: usize, gain: f64) -> bool {
        self.scene.save();
        // Of an overdriven pulse, a division must leave none.
        let divides = starts.iter().all(|start| matches!(start, Start::Apart(_)));
        let overdriven = match divides && self.overdrives(nearest) {
            true => self.count_overdriven() - 1,
            false => usize::MAX,
        };
        for &start in starts {
            self.scene.restore();
            if let Some(added) = self.start_with(candidate, nearest, start) {
                self.scene.fit_around(added, matches!(start, Start::CalibratedWidth), gain);
                if self.count_overdriven() <= overdriven {
                    self.scene.keep_if_best();
                }
            }
        }
        self.scene.settle(gain)
    }

    /// Sets the start values of a trial and returns the new pulse's index.
    ///
    /// `None` if the start divides the nearest pulse and that pulse cannot be divided.
    fn start_with(&mut self, candidate: &Candidate, nearest: usize, start: Start) -> Option<usize> {
        let width = self.scene.fwhm_samples();
        let neighbour = &mut self.scene.found[nearest];
        let ratio = neighbour.pulse.ln_width_ratio.exp();
        let distance = (neighbour.pulse.position_samples - candidate.position_samples).abs();
        let widened = distance < 1.5 * width * ratio.max(1.0) && ratio > HIDING_WIDTH_RATIO;
        match start {
            Start::AsFitted => Some(self.scene.insert(Found::from_candidate(candidate))),
            // The other starts change a widened neighbour.
            _ if !widened => None,
            Start::CalibratedWidth => {
                neighbour.flags |= flags::DIVERGED;
                let mut added = Found::from_candidate(candidate);
                added.flags |= flags::DIVERGED;
                Some(self.scene.insert(added))
            }
            Start::Apart(part) => {
                let separation = SD_OF_FWHM * width * ((ratio * ratio - 1.0) / (part * (1.0 - part))).sqrt();
                let (centre, energy) = (neighbour.pulse.position_samples, ratio * neighbour.pulse.height_dn);
                let flags = neighbour.flags | flags::SPLIT;
                *neighbour = Found::new(part * energy, centre - (1.0 - part) * separation, 0.0);
                neighbour.flags = flags;
                let mut second = Found::new((1.0 - part) * energy, centre + part * separation, 0.0);
                second.flags = flags;
                Some(self.scene.insert(second))
            }
        }
    }

    /// Removes insignificant pulses one by one, refitting the others each time.
    pub(super) fn prune(&mut self) {
        while self.remove_failed() || self.merge_nearest() || self.remove_weakest() || self.remove_misshapen()
        {
            self.scene.fit_all();
        }
    }

    /// Removes and counts a pulse; returns whether there is one.
    fn filter_out(counts: &mut Counts, found: &mut Vec<Found>, pulse: Option<(usize, Filter)>) -> bool {
        if let Some((index, reason)) = pulse {
            found.remove(index);
            counts.filtered.add(reason, 1);
        }
        pulse.is_some()
    }

    /// Removes the weakest undetermined pulse.
    fn remove_failed(&mut self) -> bool {
        let found = &mut self.scene.found;
        let failed = (0..found.len())
            .filter(|&i| found[i].failed)
            .min_by(|&i, &j| found[i].pulse.height_dn.total_cmp(&found[j].pulse.height_dn));
        Self::filter_out(&mut self.counts, found, failed.map(|index| (index, Filter::Undetermined)))
    }

    /// Merges the nearest two pulses if they are below the minimum separation.
    fn merge_nearest(&mut self) -> bool {
        let least = self.scene.least_separation();
        let found = &mut self.scene.found;
        let gap = |i: usize| found[i].pulse.position_samples - found[i - 1].pulse.position_samples;
        let Some(i) = (1..found.len()).filter(|&i| gap(i) < least).min_by(|&i, &j| gap(i).total_cmp(&gap(j)))
        else {
            return false;
        };
        let right = found.remove(i);
        let left = &mut found[i - 1];
        let (a, b) = (left.pulse.height_dn, right.pulse.height_dn);
        left.pulse.position_samples =
            (a * left.pulse.position_samples + b * right.pulse.position_samples) / (a + b);
        left.pulse.height_dn = a + b;
        // A merged pulse is one echo, not a part of a split one.
        left.flags = (left.flags | right.flags) & !flags::SPLIT;
        self.counts.np_merged += 1;
        true
    }

    /// Removes the weakest pulse below the threshold.
    fn remove_weakest(&mut self) -> bool {
        let mut weakest = (1.0, None);
        for i in 0..self.scene.found.len() {
            let part = self.relative_significance(i);
            if part < weakest.0 {
                weakest = (part, Some((i, Filter::Weak)));
            }
        }
        Self::filter_out(&mut self.counts, &mut self.scene.found, weakest.1)
    }

    /// Removes the first pulse with a peak outside the block, or of unusual width and not far above
    /// the threshold.
    fn remove_misshapen(&mut self) -> bool {
        let block = [-1.0, self.scene.target_dn().len() as f64];
        let misshapen = (0..self.scene.found.len()).find_map(|i| {
            let found = &self.scene.found[i];
            if is_outside(found.pulse.position_samples, block) {
                return Some((i, Filter::Outside));
            }
            let reason = width_filter(found.pulse.ln_width_ratio, self.ln_width_bounds());
            let is_dropped = self.is_misshapen(found) && self.relative_significance(i) < CLEAR_PART;
            is_dropped.then_some((i, reason))
        });
        Self::filter_out(&mut self.counts, &mut self.scene.found, misshapen)
    }

    /// Whether a pulse has an unusual width.
    pub(super) fn is_misshapen(&self, found: &Found) -> bool {
        is_misshapen([found.pulse.ln_width_ratio, found.sd[2]], self.ln_width_bounds())
    }

    fn ln_width_bounds(&self) -> [f64; 2] {
        self.settings.width_ratio.map(f64::ln)
    }

    /// Significance over the threshold.
    ///
    /// That of a pulse of calibrated width with the same energy.
    fn relative_significance(&mut self, index: usize) -> f64 {
        let p = self.scene.found[index].pulse;
        let per_dn = self.detector.significance_per_dn(self.scene.whitener(), p.position_samples);
        // Only higher pulses count: neither the pulse itself nor weaker ones raise its threshold.
        per_dn * p.height_dn * p.ln_width_ratio.exp() / self.threshold_at(p.position_samples, p.height_dn)
    }

    /// Adds the clear peaks of an unexplained waveform that no pulse explains, with the uncertainty of
    /// a width.
    ///
    /// They are far above the threshold and at least half of their height above the dips on both
    /// sides.
    pub(super) fn keep_clear_peaks(&mut self, samples: &[u16]) {
        if self.outcome(samples).deviation_ratio() <= DEVIANT {
            return;
        }
        let width = self.scene.fwhm_samples();
        self.detector.filter(self.scene.whitener(), self.scene.residual_dn());
        self.candidates.clear();
        self.detector.maxima(CLEAR_PART * self.sigma.least, &mut self.candidates);
        self.candidates.sort_unstable_by(|a, b| b.statistic.total_cmp(&a.statistic));
        for i in 0..self.candidates.len() {
            let candidate = self.candidates[i];
            let position = candidate.position_samples;
            let threshold = self.threshold_at(position, f64::INFINITY);
            let is_explained = self.nearest(position).is_some_and(|nearest| {
                (self.scene.found[nearest].pulse.position_samples - position).abs() < width
            });
            if is_explained
                || candidate.statistic < CLEAR_PART * threshold
                || self.scene.found.len() >= self.settings.max_returns
                || self.counts.n_added >= self.settings.max_added
                || !is_peak(self.scene.target_dn(), position, self.scene.offset_dn())
            {
                continue;
            }
            let mut clear = Found::from_candidate(&candidate);
            clear.sd = [SD_OF_FWHM * candidate.height_dn, SD_OF_FWHM * width, 1.0];
            clear.flags = flags::UNUSUAL | flags::DIVERGED;
            self.scene.insert(clear);
            self.counts.n_added += 1;
        }
        self.scene.update_residual();
    }
}

/// Whether the samples near a position have a maximum of at least twice the dips on both sides.
fn is_peak(target_dn: &[f64], position_samples: f64, offset_dn: f64) -> bool {
    let near = (position_samples.round().max(0.0) as usize).min(target_dn.len().saturating_sub(1));
    let around = near.saturating_sub(2)..(near + 3).min(target_dn.len());
    let Some(peak) = around.max_by(|&i, &j| target_dn[i].total_cmp(&target_dn[j])) else { return false };
    let height_dn = target_dn[peak] - offset_dn;
    // The lowest sample before one that is higher than the peak.
    let dip = |samples: &mut dyn Iterator<Item = f64>| {
        samples.take_while(|&y| y <= target_dn[peak]).fold(f64::INFINITY, f64::min) - offset_dn
    };
    let left = dip(&mut target_dn[..peak].iter().rev().copied());
    let right = dip(&mut target_dn[peak + 1..].iter().copied());
    height_dn > 0.0 && left.max(right) <= 0.5 * height_dn
}
