//! Joint least-squares fit of pulses in the whitened domain.
//!
//! The model of sample `k` is `b + Σ a_i s(k - t_i, u_i)`. The shape `s` has height 1; it is a
//! Gaussian `exp(-4 ln 2 (k - t)² / (W e^u)²)` or the calibrated response. Parameters are heights
//! `a`, positions `t`, logarithms `u` of the width over the calibrated width `W`, and an offset `b`
//! if the background is unknown. The objective is `‖L⁻¹(y - model)‖² + Σ (u_i/s_i)² + (b/s_b)²`,
//! with `L` the Cholesky factor of the noise covariance of the used samples; up to constants it is
//! -2 times the log posterior for Gaussian priors on `u` and `b`. The method is that of Levenberg
//! (1944) and Marquardt (1963) with analytic derivatives. The covariance of the parameters is the
//! inverse of the normal matrix at the optimum, priors included.

mod problem;

use std::ops::Range;

use wavex_simd::dot::{AT_A_TIME, dot};

use crate::cholesky;
use crate::levenberg_marquardt::{self, Rules, Termination};
use crate::shape::{Pulse, Shape};
use crate::whitening::Whitener;

#[cfg(test)]
mod tests;

use problem::{FitProblem, RULES};

/// Largest move of a pulse in one step, in its own widths (1.5 samples for a pulse of 4.25).
const MAX_MOVE_WIDTHS: f64 = 0.35;
/// Largest change of a log width in one step.
pub(crate) const MAX_LN_WIDTH_STEP: f64 = 0.4;
/// Smallest relative height that a step may leave.
pub(crate) const MIN_HEIGHT_PART: f64 = 0.2;
/// Smallest height over the noise SD; keeps the normal matrix regular.
const MIN_HEIGHT_SD: f64 = 1e-3;
/// Damping below which a small promised decrease indicates convergence.
pub(crate) const NEAR_NEWTON: f64 = 1e-2;
/// Initial damping.
pub(crate) const FIRST_DAMPING: f64 = 1e-3;
/// Promised decrease that makes chi-square accurate enough for acceptance tests.
pub(crate) const ROUGH_DECREASE: f64 = 1e-2;
/// Assumed ratio of the achievable to the predicted decrease.
pub(crate) const REACH: f64 = 8.0;
/// Precision of a prior that fixes a width.
pub(crate) const FIXED_WIDTH_PRECISION: f64 = 1e8;

/// Termination criteria of a fit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct StopCriteria {
    /// Largest number of iterations.
    pub iterations: usize,
    /// Converged if the next step is predicted to lower chi-square by less.
    ///
    /// It is the square of the remaining distance, in standard deviations of the parameters.
    pub decrease: f64,
    /// Abandons a fit that cannot come below this objective.
    ///
    /// The criterion: even eight times the predicted decrease leaves chi-square plus the prior part
    /// above it.
    pub enough: f64,
}

impl StopCriteria {
    /// Criteria for parameters to 1e-5 of their standard deviations.
    pub fn exact(iterations: usize) -> StopCriteria {
        StopCriteria { iterations, decrease: 1e-10, enough: f64::INFINITY }
    }

    /// Criteria for a chi-square accurate enough for acceptance tests.
    pub(crate) fn rough(iterations: usize) -> StopCriteria {
        StopCriteria { iterations, decrease: ROUGH_DECREASE, enough: f64::INFINITY }
    }
}

/// Result of a fit; pulses, offset and covariance remain in the workspace.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct FitResult {
    /// `‖L⁻¹(y - model)‖²` over the used samples, without the prior part.
    pub chi_square: f64,
    /// Number of used samples.
    pub samples: usize,
    /// Number of free parameters: three per pulse, one for an unknown background.
    pub parameters: usize,
    /// Number of iterations, each with one normal matrix.
    pub iterations: usize,
    /// Reason for the end.
    pub termination: Termination,
}

/// Workspace of the fit; within its capacities fits do not allocate.
#[derive(Debug, Clone)]
pub(crate) struct PulseFit {
    shape: Shape,
    offset_precision: Option<f64>,
    max_pulses: usize,
    pulses: Vec<Pulse>,
    offset_dn: f64,
    trial: Vec<Pulse>,
    trial_offset_dn: f64,
    /// Whether the last step was limited by a bound.
    at_bound: bool,
    residual: Vec<f64>,
    trial_residual: Vec<f64>,
    /// Whitened derivatives, in consecutive columns of block length.
    columns: Vec<f64>,
    /// Sample range of each column outside which it is zero.
    supports: Vec<Range<usize>>,
    /// Length of a column.
    column_length: usize,
    normal: Vec<f64>,
    damped: Vec<f64>,
    gradient: Vec<f64>,
    step: Vec<f64>,
    covariance: Vec<f64>,
}

impl PulseFit {
    /// Creates a workspace for pulses of a shape; a number means Gaussians of that FWHM, samples.
    ///
    /// `offset_precision` is `None` if the background is known (and subtracted), otherwise the
    /// precision `1/s_b²` of the offset's prior about zero, in 1/DN² (0: no prior). Blocks longer
    /// than `max_samples` allocate; more than `max_pulses` pulses are rejected.
    pub fn new(
        shape: impl Into<Shape>,
        offset_precision: Option<f64>,
        max_samples: usize,
        max_pulses: usize,
    ) -> PulseFit {
        let parameters = 3 * max_pulses + 1;
        PulseFit {
            shape: shape.into(),
            offset_precision,
            max_pulses,
            pulses: Vec::with_capacity(max_pulses),
            offset_dn: 0.0,
            trial: Vec::with_capacity(max_pulses),
            trial_offset_dn: 0.0,
            at_bound: false,
            residual: Vec::with_capacity(max_samples),
            trial_residual: Vec::with_capacity(max_samples),
            columns: Vec::with_capacity(max_samples * parameters),
            supports: Vec::with_capacity(parameters),
            column_length: 0,
            normal: vec![0.0; parameters * parameters],
            damped: vec![0.0; parameters * parameters],
            gradient: vec![0.0; parameters],
            step: vec![0.0; parameters],
            covariance: vec![0.0; parameters * parameters],
        }
    }

    /// Pulses of the last fit, in input order.
    pub fn pulses(&self) -> &[Pulse] {
        &self.pulses
    }

    /// Background offset of the last fit, DN; 0 if the background is known.
    pub(crate) fn offset_dn(&self) -> f64 {
        self.offset_dn
    }

    /// Covariance of two parameters at the optimum.
    ///
    /// Of pulse `i`, `3i` is the height (DN), `3i + 1` the position (samples) and `3i + 2` the log
    /// width; the offset (DN) follows the last pulse. Valid only if the fit ended at an optimum or
    /// the iteration limit; NaN for parameters that do not exist.
    pub fn covariance(&self, i: usize, j: usize) -> f64 {
        let n = self.parameters();
        if i.max(j) < n { self.covariance[i * n + j] } else { f64::NAN }
    }

    /// Standard deviations of pulse `i`: height (DN), position (samples), log width.
    pub(crate) fn pulse_sd(&self, i: usize) -> [f64; 3] {
        [0, 1, 2].map(|part| self.covariance(3 * i + part, 3 * i + part).sqrt())
    }

    /// Sensitivity of parameter `i` of the last fit to the whitened samples, to first order.
    ///
    /// It is the row of the covariance times the derivatives. [`Whitener::whiten_transposed`]
    /// converts it to weights of the samples.
    pub(crate) fn weights(&self, i: usize) -> Vec<f64> {
        let samples = self.residual.len();
        let mut weights = vec![0.0; samples];
        for (j, column) in self.columns.chunks_exact(samples.max(1)).enumerate().take(self.parameters()) {
            let factor = self.covariance(i, j);
            weights.iter_mut().zip(column).for_each(|(w, c)| *w += factor * c);
        }
        weights
    }

    /// Fits pulses to `target_dn`, the samples less the known background, from start values.
    ///
    /// The whitener defines the used samples; it must be prepared for a block of this length.
    pub fn fit(
        &mut self,
        whitener: &Whitener,
        target_dn: &[f64],
        start: &[Pulse],
        limits: StopCriteria,
    ) -> FitResult {
        self.pulses.clear();
        self.offset_dn = 0.0;
        let mut fit = FitResult {
            chi_square: f64::NAN,
            samples: whitener.used_count(),
            parameters: 3 * start.len() + usize::from(self.offset_precision.is_some()),
            iterations: 0,
            termination: Termination::IterationLimit,
        };
        if start.len() > self.max_pulses {
            fit.termination = Termination::TooManyPulses;
            return fit;
        }
        self.pulses.extend_from_slice(start);
        if fit.samples < fit.parameters {
            fit.termination = Termination::TooFewSamples;
            return fit;
        }
        self.prepare(target_dn.len(), fit.parameters);
        self.minimise(whitener, target_dn, limits, &mut fit);
        fit
    }

    fn parameters(&self) -> usize {
        3 * self.pulses.len() + usize::from(self.offset_precision.is_some())
    }

    fn prepare(&mut self, samples: usize, parameters: usize) {
        self.residual.clear();
        self.residual.resize(samples, 0.0);
        self.trial_residual.clear();
        self.trial_residual.resize(samples, 0.0);
        if samples != self.column_length {
            self.columns.clear();
            self.supports.clear();
            self.column_length = samples;
        }
        if parameters > self.supports.len() {
            self.columns.resize(samples * parameters, 0.0);
            self.supports.resize(parameters, 0..0);
        }
        self.covariance.fill(f64::NAN);
        self.trial.clear();
        self.trial.extend_from_slice(&self.pulses);
        self.trial_offset_dn = self.offset_dn;
    }

    fn minimise(
        &mut self,
        whitener: &Whitener,
        target_dn: &[f64],
        limits: StopCriteria,
        fit: &mut FitResult,
    ) {
        let min_height_dn = MIN_HEIGHT_SD * whitener.noise().sd();
        let rules = Rules { linearisations: limits.iterations, decrease: limits.decrease, ..RULES };
        let mut problem = FitProblem { fit: self, whitener, target_dn, min_height_dn, enough: limits.enough };
        (fit.termination, fit.iterations) = levenberg_marquardt::minimise(&mut problem, &rules);
        if fit.termination == Termination::Singular {
            return;
        }
        if fit.termination == Termination::Converged && self.at_bound {
            fit.termination = Termination::AtBound;
        }
        // The last accepted step came after the last linearisation.
        if fit.termination == Termination::IterationLimit {
            self.form_normal_equations(whitener);
        }
        fit.chi_square = dot(&self.residual, &self.residual);
        // An abandoned fit is not used, so it needs no covariance.
        if fit.termination != Termination::OutOfReach && !self.invert_normal_matrix() {
            fit.termination = Termination::Singular;
        }
    }

    /// Computes the objective at the trial point, and its whitened residual.
    fn try_point(&mut self, whitener: &Whitener, target_dn: &[f64]) -> f64 {
        let offset = self.trial_offset_dn;
        for (residual, target) in self.trial_residual.iter_mut().zip(target_dn) {
            *residual = target - offset;
        }
        let mut prior = self.offset_precision.unwrap_or(0.0) * offset * offset;
        for pulse in &self.trial {
            self.shape.add(pulse, -1.0, &mut self.trial_residual);
            prior += pulse.ln_width_precision * pulse.ln_width_ratio * pulse.ln_width_ratio;
        }
        whitener.whiten(&mut self.trial_residual);
        dot(&self.trial_residual, &self.trial_residual) + prior
    }

    fn accept(&mut self) {
        self.pulses.copy_from_slice(&self.trial);
        self.offset_dn = self.trial_offset_dn;
        std::mem::swap(&mut self.residual, &mut self.trial_residual);
    }

    /// Computes the whitened derivatives at the current point in `self.columns`.
    fn form_columns(&mut self, whitener: &Whitener) {
        let samples = self.residual.len();
        let mut columns = self.columns.chunks_exact_mut(samples.max(1)).zip(&mut self.supports);
        let mut next_cleared = || {
            columns.next().map(|(column, support)| {
                column[support.clone()].fill(0.0);
                (column, support)
            })
        };
        for pulse in &self.pulses {
            let [Some(by_height), Some(by_position), Some(by_width)] = [(); 3].map(|()| next_cleared())
            else {
                return;
            };
            let parts = [&mut *by_height.0, &mut *by_position.0, &mut *by_width.0];
            let changed = self.shape.add_derivatives(pulse, parts);
            for (column, support) in [by_height, by_position, by_width] {
                *support = changed.start..whitener.whiten_part(changed.clone(), column);
            }
        }
        if let (Some(_), Some((by_offset, support))) = (self.offset_precision, next_cleared()) {
            by_offset.fill(1.0);
            whitener.whiten(by_offset);
            *support = 0..samples;
        }
    }

    /// Normal matrix `JᵀJ + Λ` and right-hand side `Jᵀr - Λ(θ - θ₀)` at the current point.
    fn form_normal_equations(&mut self, whitener: &Whitener) {
        self.form_columns(whitener);
        let samples = self.residual.len();
        let n = self.parameters();
        for i in 0..n {
            // Columns are zero outside their support. Whole groups of samples keep the order of summation.
            let support = &self.supports[i];
            let start = support.start - support.start % AT_A_TIME;
            let end = support.end.next_multiple_of(AT_A_TIME).min(samples);
            let column = |j: usize| &self.columns[j * samples..][start..end];
            self.gradient[i] = dot(column(i), &self.residual[start..end]);
            for j in 0..=i {
                self.normal[i * n + j] = dot(column(i), column(j));
            }
        }
        for (i, pulse) in self.pulses.iter().enumerate() {
            let at = 3 * i + 2;
            self.normal[at * n + at] += pulse.ln_width_precision;
            self.gradient[at] -= pulse.ln_width_precision * pulse.ln_width_ratio;
        }
        if let Some(precision) = self.offset_precision {
            self.normal[n * n - 1] += precision;
            self.gradient[n - 1] -= precision * self.offset_dn;
        }
    }

    /// Solves `(N + damping · diag N) δ = g` into `self.step`.
    fn solve_damped(&mut self, damping: f64) -> bool {
        let n = self.parameters();
        self.damped[..n * n].copy_from_slice(&self.normal[..n * n]);
        for i in 0..n {
            // Relative to the diagonal, because height, position and width have different units.
            self.damped[i * n + i] *= 1.0 + damping;
        }
        if !cholesky::factor(&mut self.damped[..n * n], n) {
            return false;
        }
        self.step[..n].copy_from_slice(&self.gradient[..n]);
        cholesky::solve(&self.damped[..n * n], n, &mut self.step[..n]);
        true
    }

    /// Applies the limited step to the trial point; `self.step` becomes the actual move.
    fn step_within_limits(&mut self, samples: usize, min_height_dn: f64) {
        self.at_bound = false;
        let fwhm_samples = self.shape.fwhm_samples();
        let [narrowest, widest] = self.shape.ln_width_bounds();
        for (i, (trial, pulse)) in self.trial.iter_mut().zip(&self.pulses).enumerate() {
            let step = &mut self.step[3 * i..3 * i + 3];
            let width = fwhm_samples * pulse.ln_width_ratio.exp();
            let lowest_height = min_height_dn.max(MIN_HEIGHT_PART * pulse.height_dn);
            trial.height_dn = (pulse.height_dn + step[0]).max(lowest_height);
            let moved =
                pulse.position_samples + step[1].clamp(-MAX_MOVE_WIDTHS * width, MAX_MOVE_WIDTHS * width);
            trial.position_samples =
                moved.clamp(-2.0 * fwhm_samples, samples as f64 - 1.0 + 2.0 * fwhm_samples);
            let widened = pulse.ln_width_ratio + step[2].clamp(-MAX_LN_WIDTH_STEP, MAX_LN_WIDTH_STEP);
            trial.ln_width_ratio = widened.clamp(narrowest, widest);
            self.at_bound |= trial.position_samples != moved || trial.ln_width_ratio != widened;
            step[0] = trial.height_dn - pulse.height_dn;
            step[1] = trial.position_samples - pulse.position_samples;
            step[2] = trial.ln_width_ratio - pulse.ln_width_ratio;
        }
        let offset_step =
            if self.offset_precision.is_some() { self.step[3 * self.pulses.len()] } else { 0.0 };
        self.trial_offset_dn = self.offset_dn + offset_step;
    }

    /// Decrease of the objective predicted by the quadratic model.
    fn promised_decrease(&self) -> f64 {
        let n = self.parameters();
        let mut decrease = 0.0;
        for i in 0..n {
            let row = &self.normal[i * n..i * n + i];
            let below: f64 = row.iter().zip(&self.step).map(|(a, s)| a * s).sum();
            let curvature = self.normal[i * n + i] * self.step[i];
            decrease += self.step[i] * (2.0 * self.gradient[i] - curvature - 2.0 * below);
        }
        decrease
    }

    fn invert_normal_matrix(&mut self) -> bool {
        let n = self.parameters();
        if n == 0 {
            return true;
        }
        self.damped[..n * n].copy_from_slice(&self.normal[..n * n]);
        if !cholesky::factor(&mut self.damped[..n * n], n) {
            return false;
        }
        cholesky::invert(&self.damped[..n * n], n, &mut self.covariance[..n * n]);
        true
    }
}
