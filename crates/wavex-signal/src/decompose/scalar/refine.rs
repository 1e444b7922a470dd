//! Residual search, split test and pruning.

use super::scene::Found;
use super::{Counts, Decomposer};
use crate::decompose::acceptance::{DIVIDED_PARTS, GAIN_PART, HIDING_WIDTH_RATIO, TRIAL_PART, is_misshapen};
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
    pub(super) fn add_from_residual(&mut self) {
        let room = |d: &Decomposer| {
            d.scene.found.len() < d.settings.max_returns && d.counts.n_added < d.settings.max_added
        };
        while room(self) && (self.add_one() || self.split_one()) {
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
    fn split_one(&mut self) -> bool {
        let Some(gain) = self.settings.split_evidence else { return false };
        let starts = DIVIDED_PARTS.map(Start::Apart);
        (0..self.scene.found.len()).any(|i| {
            let p = self.scene.found[i].pulse;
            if self.allowance.overdrives(p.height_dn) || !self.may_hide_two(i) {
                return false;
            }
            let half = Candidate {
                position_samples: p.position_samples,
                statistic: 0.0,
                height_dn: p.height_dn,
                ln_width_ratio: 0.0,
            };
            // A decrease within the response error is no evidence.
            let allowed = self.allowance_at(p.position_samples, f64::INFINITY);
            self.try_starts(&starts, &half, i, gain * allowed * allowed)
        })
    }

    /// Whether a pulse is wide enough for two, and its score indicates two.
    fn may_hide_two(&mut self, index: usize) -> bool {
        self.scene.found[index].pulse.ln_width_ratio.exp() > HIDING_WIDTH_RATIO
            && (self.settings.split_score <= 0.0 || self.scene.score(index) > self.settings.split_score)
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
        for &start in starts {
            self.scene.restore();
            if let Some(added) = self.start_with(candidate, nearest, start) {
                self.scene.fit_around(added, matches!(start, Start::CalibratedWidth), gain);
                self.scene.keep_if_best();
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

    fn filter_out(counts: &mut Counts, found: &mut Vec<Found>, index: Option<usize>) -> bool {
        if let Some(index) = index {
            found.remove(index);
            counts.np_filtered += 1;
        }
        index.is_some()
    }

    /// Returns the weakest undetermined pulse.
    fn remove_failed(&mut self) -> bool {
        let found = &mut self.scene.found;
        let failed = (0..found.len())
            .filter(|&i| found[i].failed)
            .min_by(|&i, &j| found[i].pulse.height_dn.total_cmp(&found[j].pulse.height_dn));
        Self::filter_out(&mut self.counts, found, failed)
    }

    /// Returns the nearest two pulses if they are below the minimum separation.
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
        left.flags = (left.flags | right.flags) & !flags::SPLIT;
        self.counts.np_merged += 1;
        true
    }

    /// Returns the weakest pulse below the threshold.
    ///
    /// Its significance is that of a pulse of calibrated width with the same energy.
    fn remove_weakest(&mut self) -> bool {
        let mut weakest = (1.0, None);
        for i in 0..self.scene.found.len() {
            let p = self.scene.found[i].pulse;
            let per_dn = self.detector.significance_per_dn(self.scene.whitener(), p.position_samples);
            let energy = p.height_dn * p.ln_width_ratio.exp();
            let threshold = self.threshold_at(p.position_samples, p.height_dn);
            let part = per_dn * energy / threshold;
            if part < weakest.0 {
                weakest = (part, Some(i));
            }
        }
        Self::filter_out(&mut self.counts, &mut self.scene.found, weakest.1)
    }

    /// Returns the first pulse with an invalid width or a peak outside the block.
    ///
    /// The width must be out of range by more than two standard deviations.
    fn remove_misshapen(&mut self) -> bool {
        let bounds = self.settings.width_ratio.map(f64::ln);
        let block = [-1.0, self.scene.target_dn().len() as f64];
        let misshapen = self.scene.found.iter().position(|f| {
            is_misshapen([f.pulse.position_samples, f.pulse.ln_width_ratio, f.sd[2]], bounds, block)
        });
        Self::filter_out(&mut self.counts, &mut self.scene.found, misshapen)
    }
}
