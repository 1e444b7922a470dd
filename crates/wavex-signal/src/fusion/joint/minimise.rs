//! Linearisation and steps of the joint fit.

use wavex_simd::dot::dot;

use super::{JointFit, PARTS};
use crate::cholesky;
use crate::levenberg_marquardt::{LeastSquares, Rules};

/// Rules of the loop.
pub(super) const RULES: Rules = Rules {
    damping: [1e-4, 1e-12],
    most_damping: 1e8f64.next_up(),
    linearisations: usize::MAX,
    steps: 40,
    decrease: 1e-8,
    near_newton: f64::INFINITY,
    takes_last_step: true,
    ends_if_singular: true,
};
/// Largest steps of log height, position in widths, and log width.
const LONGEST: [f64; PARTS] = [0.7, 0.35, 0.3];

impl LeastSquares for JointFit {
    fn objective(&mut self) -> f64 {
        self.trial_chi_square = self.residual();
        self.weight * self.trial_chi_square + self.prior()
    }

    fn accept(&mut self) {
        self.best.clone_from(&self.values);
        self.chi_square = self.trial_chi_square;
    }

    /// Computes the normal matrix and descent direction at the last residual.
    ///
    /// The direction is half the negative gradient of the objective.
    fn linearise(&mut self) {
        let weight = self.weight;
        let (n, m) = (self.values.len(), self.target_dn.len());
        self.columns.clear();
        self.columns.resize(n * m, 0.0);
        for i in 0..self.pulses.len() {
            let pulse = self.pulse(i);
            let columns = &mut self.columns[PARTS * i * m..PARTS * (i + 1) * m];
            let (by_height, rest) = columns.split_at_mut(m);
            let (by_position, by_width) = rest.split_at_mut(m);
            self.shape.add_derivatives(&pulse, [&mut *by_height, by_position, by_width]);
            // The parameter is the logarithm of the height.
            by_height.iter_mut().for_each(|value| *value *= pulse.height_dn);
        }
        self.columns[PARTS * self.pulses.len() * m..].fill(1.0);
        if m > 0 {
            self.columns.chunks_exact_mut(m).for_each(|column| self.whitener.whiten(column));
        }
        self.normal.clear();
        self.normal.resize(n * n, 0.0);
        self.gradient.clear();
        self.gradient.resize(n, 0.0);
        let column = |i: usize| &self.columns[i * m..(i + 1) * m];
        for i in 0..n {
            self.gradient[i] = weight * dot(column(i), &self.residual);
            for j in 0..=i {
                let value = weight * dot(column(i), column(j));
                (self.normal[i * n + j], self.normal[j * n + i]) = (value, value);
            }
        }
        self.add_priors();
    }

    fn solve(&mut self, damping: f64) -> bool {
        let n = self.values.len();
        self.damped.clone_from(&self.normal);
        (0..n).for_each(|i| self.damped[i * n + i] *= 1.0 + damping);
        if !cholesky::factor(&mut self.damped, n) {
            return false;
        }
        self.step.clone_from(&self.gradient);
        cholesky::solve(&self.damped, n, &mut self.step);
        self.promised = self.step.iter().zip(&self.gradient).map(|(s, g)| s * g).sum();
        true
    }

    /// Keeps steps within the validity of the linear model, and widths within the templates.
    fn take_step(&mut self) {
        let longest = [LONGEST[0], LONGEST[1] * self.shape.fwhm_samples(), LONGEST[2]];
        let [least, most] = self.shape.ln_width_bounds();
        for (i, step) in self.step.iter_mut().enumerate().take(PARTS * self.pulses.len()) {
            let part = i % PARTS;
            *step = step.clamp(-longest[part], longest[part]);
            if part == 2 {
                *step = (self.best[i] + *step).clamp(least, most) - self.best[i];
            }
        }
        self.values.clone_from(&self.best);
        self.values.iter_mut().zip(&self.step).for_each(|(value, step)| *value += step);
    }

    fn promised(&self) -> f64 {
        self.promised
    }
}
