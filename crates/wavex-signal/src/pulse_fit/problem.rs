//! The fit as a least-squares problem.

use super::{FIRST_DAMPING, NEAR_NEWTON, PulseFit, REACH};
use crate::levenberg_marquardt::{LeastSquares, Rules};
use crate::whitening::Whitener;

/// Rules of the loop; [`StopCriteria`](super::StopCriteria) set the iterations and the decrease.
pub(super) const RULES: Rules = Rules {
    damping: [FIRST_DAMPING, 1e-9],
    most_damping: 1e10,
    linearisations: 0,
    steps: usize::MAX,
    decrease: 0.0,
    near_newton: NEAR_NEWTON,
    takes_last_step: false,
    ends_if_singular: false,
};

/// A fit to one block.
pub(super) struct FitProblem<'a> {
    pub(super) fit: &'a mut PulseFit,
    pub(super) whitener: &'a Whitener,
    pub(super) target_dn: &'a [f64],
    pub(super) min_height_dn: f64,
    /// See [`StopCriteria::enough`](super::StopCriteria::enough).
    pub(super) enough: f64,
}

impl LeastSquares for FitProblem<'_> {
    fn objective(&mut self) -> f64 {
        self.fit.try_point(self.whitener, self.target_dn)
    }

    fn accept(&mut self) {
        self.fit.accept();
    }

    fn linearise(&mut self) {
        self.fit.form_normal_equations(self.whitener);
    }

    fn solve(&mut self, damping: f64) -> bool {
        self.fit.solve_damped(damping)
    }

    /// Uses the full step, before it is limited.
    fn is_out_of_reach(&self, objective: f64) -> bool {
        objective - REACH * self.fit.promised_decrease() > self.enough
    }

    fn take_step(&mut self) {
        self.fit.step_within_limits(self.target_dn.len(), self.min_height_dn);
    }

    fn promised(&self) -> f64 {
        self.fit.promised_decrease()
    }
}
