//! Thresholds near strong pulses, raised by the response error.

use super::Decomposer;
use crate::decompose::acceptance::TAIL_START_WIDTHS;
use crate::decompose::acceptance::response_error::ErrorSource;
use crate::shape::Pulse;

impl Decomposer {
    /// Expected contribution of the response error to chi-square.
    pub(super) fn expected_excess(&self) -> f64 {
        let samples = self.scene.target_dn().len();
        let of =
            |pulse: &Pulse| self.allowance.expected_excess(pulse.position_samples, pulse.height_dn, samples);
        self.scene.found.iter().map(|f| of(&f.pulse)).sum()
    }

    /// Detection threshold at a position.
    ///
    /// Raised by the response error of pulses higher than `height_dn`; infinity means all pulses.
    pub(super) fn threshold_at(&self, position_samples: f64, height_dn: f64) -> f64 {
        let positions = self.scene.found.iter().map(|f| f.pulse.position_samples);
        self.sigma.at(position_samples, positions) * self.allowance_at(position_samples, height_dn)
    }

    /// Drops candidates below the threshold, except the last of several with a lower threshold.
    ///
    /// Candidates are sorted by position.
    pub(super) fn drop_weak_candidates(&mut self) {
        let sigma = self.sigma.usual;
        let others = self.candidates.iter().rev().skip(1).any(|c| c.statistic >= sigma);
        let mut left = self.candidates.len();
        self.candidates.retain(|c| {
            left -= 1;
            c.statistic >= sigma || (left == 0 && others)
        });
    }

    /// Factor by which response errors raise the threshold at a position.
    ///
    /// Of pulses higher than `height_dn`; infinity means all pulses.
    pub(super) fn allowance_at(&self, position_samples: f64, height_dn: f64) -> f64 {
        let per_dn = self.detector.full_significance_per_dn();
        let pulses = self.scene.found.iter().map(|f| ErrorSource::of(&f.pulse));
        self.allowance.raise(position_samples, height_dn, per_dn, pulses)
    }

    /// As [`Decomposer::allowance_at`] a pulse, if that pulse were two of half its height.
    pub(super) fn allowance_if_divided(&self, index: usize) -> f64 {
        let per_dn = self.detector.full_significance_per_dn();
        let found = &self.scene.found;
        let of = |i: usize| {
            let part = if i == index { 0.5 } else { 1.0 };
            ErrorSource::of(&Pulse { height_dn: part * found[i].pulse.height_dn, ..found[i].pulse })
        };
        let pulses = (0..found.len()).chain([index]).map(of);
        self.allowance.raise(found[index].pulse.position_samples, f64::INFINITY, per_dn, pulses)
    }

    /// Drops candidates within the response error of stronger ones.
    ///
    /// Candidates are sorted by their statistic. A candidate dropped wrongly appears in the
    /// residual of the first fit.
    pub(super) fn screen_candidates(&mut self) {
        if self.model.response.is_none() {
            return;
        }
        let tail_start = TAIL_START_WIDTHS * self.model.fwhm_samples();
        let mut kept = 0;
        for i in 0..self.candidates.len() {
            let candidate = self.candidates[i];
            let left = self.candidates[..kept].iter().fold(0.0, |sum, stronger| {
                let lag = candidate.position_samples - stronger.position_samples;
                sum + if lag > tail_start { stronger.height_dn * self.detector.echo(lag) } else { 0.0 }
            });
            if candidate.statistic - left >= self.sigma.least {
                self.candidates[kept] = candidate;
                kept += 1;
            }
        }
        self.candidates.truncate(kept);
    }
}
