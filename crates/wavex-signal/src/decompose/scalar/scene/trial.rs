//! Saved states of a waveform's pulses, and acceptance of a trial.

use super::{FitScene, Found};
use crate::decompose::acceptance::too_near;

/// State that a trial changes and a rejected trial restores.
#[derive(Debug, Clone, Default)]
pub(super) struct Saved {
    pub(super) found: Vec<Found>,
    pub(super) offset_dn: f64,
    pub(super) chi_square: f64,
    /// `chi_square` plus the priors' part.
    pub(super) objective: f64,
}

impl FitScene {
    /// Saves the current state for [`Scene::restore`].
    pub(in super::super) fn save(&mut self) {
        store(&mut self.before, &self.found, self.offset_dn, self.chi_square);
        self.best.chi_square = f64::INFINITY;
        self.best.objective = f64::INFINITY;
    }

    /// Restores the saved state.
    pub(in super::super) fn restore(&mut self) {
        load(&self.before, &mut self.found, &mut self.offset_dn, &mut self.chi_square);
    }

    /// Saves the current state if it is the best since the last [`Scene::save`].
    ///
    /// By chi-square with priors, and only if no two pulses are closer than the minimum separation.
    /// Without the priors, a narrow pulse with a wide one often fits as well as the true pair.
    pub(in super::super) fn keep_if_best(&mut self) {
        let least = self.least_separation();
        let near = |found: &[Found]| too_near(found.iter().map(|f| f.pulse.position_samples), least);
        if objective(&self.found, self.chi_square) < self.best.objective
            && near(&self.found) <= near(&self.before.found)
        {
            store(&mut self.best, &self.found, self.offset_dn, self.chi_square);
        }
    }

    /// Restores the best state if it lowers chi-square by at least `gain`, else the saved one.
    pub(in super::super) fn settle(&mut self, gain: f64) -> bool {
        let accepted = self.before.chi_square - self.best.chi_square >= gain;
        let state = if accepted { &self.best } else { &self.before };
        load(state, &mut self.found, &mut self.offset_dn, &mut self.chi_square);
        self.update_residual();
        accepted
    }
}

fn store(saved: &mut Saved, found: &[Found], offset_dn: f64, chi_square: f64) {
    saved.found.clear();
    saved.found.extend_from_slice(found);
    saved.offset_dn = offset_dn;
    saved.chi_square = chi_square;
    saved.objective = objective(found, chi_square);
}

/// Chi-square plus the priors' part.
fn objective(found: &[Found], chi_square: f64) -> f64 {
    let prior = |f: &Found| f.pulse.ln_width_precision * f.pulse.ln_width_ratio.powi(2);
    chi_square + found.iter().map(prior).sum::<f64>()
}

fn load(saved: &Saved, found: &mut Vec<Found>, offset_dn: &mut f64, chi_square: &mut f64) {
    found.clear();
    found.extend_from_slice(&saved.found);
    *offset_dn = saved.offset_dn;
    *chi_square = saved.chi_square;
}
