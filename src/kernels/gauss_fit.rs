//! Pulses fitted jointly to a block of samples by least squares in the whitened domain.
//!
//! The model of sample `k` is `b + Σ a_i s(k - t_i, u_i)` with the shape `s` of height 1, a Gaussian
//! `exp(-4 ln 2 (k - t)² / (W e^u)²)` or the calibrated response: heights `a`, positions `t`,
//! logarithms `u` of the width over the calibrated width `W`, and an offset `b` where the background is not known.
//! What is made smallest is `‖L⁻¹(y - model)‖² + Σ (u_i/s_i)² + (b/s_b)²`, with `L` the factor of the noise's
//! covariance on the used samples: the posterior's logarithm for Gaussian priors on `u` and `b`. The method is that of
//! Levenberg (1944) and Marquardt (1963) with the derivatives in closed form; the covariance of the parameters is the
//! inverse of the normal matrix at the optimum, priors included.

use super::cholesky;
use super::shape::{Lane, Shape};
use super::whitening::Whitener;
use super::wide::dot;

#[cfg(test)]
mod tests;

/// `4 ln 2`: a Gaussian of full width `W` at half maximum is `exp(-4 ln 2 (x/W)²)`.
pub const FOUR_LN_2: f64 = 2.772_588_722_239_781;
/// Beyond so many of its widths a pulse is zero in double precision (`exp(-4 ln 2 · 3.65²) = 1e-16`).
const SUPPORT_WIDTHS: f64 = 3.65;
/// The shortest and the longest pulse, over the calibrated width; beyond, a fit has left what can be measured.
pub(super) const LN_WIDTH_BOUNDS: [f64; 2] = [-1.5, 3.2];
/// The farthest a step may move a pulse, in its own widths (1.5 samples for a pulse of 4.25).
const MAX_MOVE_WIDTHS: f64 = 0.35;
/// The largest change of a width's logarithm in a step.
const MAX_LN_WIDTH_STEP: f64 = 0.4;
/// The smallest part of its height that a step leaves to a pulse.
const MIN_HEIGHT_PART: f64 = 0.2;
/// The smallest height over the noise's standard deviation: keeps the normal matrix regular.
const MIN_HEIGHT_SD: f64 = 1e-3;
/// Damping below which the promised decrease tells that the optimum is near.
const NEAR_NEWTON: f64 = 1e-2;
/// What the next step promises is taken this many times for what a fit may still gain.
const REACH: f64 = 8.0;

/// One pulse.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pulse {
    /// Height of the peak above the background, digitiser steps.
    pub height_dn: f64,
    /// Place of the peak, in samples from the block's first.
    pub position_samples: f64,
    /// Logarithm of the width over the calibrated width.
    pub ln_width_ratio: f64,
    /// `1/s²` of the prior that draws `ln_width_ratio` to 0; 0 for no prior.
    pub ln_width_precision: f64,
}

impl Pulse {
    /// Adds `sign` times the pulse as a Gaussian to `values`, the samples of a block; `fwhm_samples` is the calibrated
    /// width.
    pub fn add_to(&self, fwhm_samples: f64, sign: f64, values: &mut [f64]) {
        self.add_lane_to(fwhm_samples, sign, Lane::All, values);
    }

    /// The same for some of the samples.
    pub(super) fn add_lane_to(&self, fwhm_samples: f64, sign: f64, lane: Lane, values: &mut [f64]) {
        let width = fwhm_samples * self.ln_width_ratio.exp();
        let (first, end) = support(self.position_samples, width, values.len());
        for (k, value) in values.iter_mut().enumerate().take(end).skip(lane.from(first)).step_by(lane.step())
        {
            let x = (k as f64 - self.position_samples) / width;
            *value += sign * self.height_dn * (-FOUR_LN_2 * x * x).exp();
        }
    }

    /// Writes the Gaussian's derivatives by height, position and width's logarithm to columns of a block's length.
    /// Returns the first sample that can differ from zero.
    pub(super) fn add_derivatives_to(
        &self,
        fwhm_samples: f64,
        lane: Lane,
        columns: [&mut [f64]; 3],
    ) -> usize {
        let [by_height, by_position, by_width] = columns;
        let width = fwhm_samples * self.ln_width_ratio.exp();
        let (first, end) = support(self.position_samples, width, by_height.len());
        for k in (lane.from(first)..end).step_by(lane.step()) {
            let x = (k as f64 - self.position_samples) / width;
            let shape = (-FOUR_LN_2 * x * x).exp();
            let slope = 2.0 * FOUR_LN_2 * x * self.height_dn * shape;
            by_height[k] = shape;
            by_position[k] = slope / width;
            by_width[k] = slope * x;
        }
        first
    }
}

/// The samples `first..end` of a block of `samples` where a pulse is not zero.
fn support(position: f64, width: f64, samples: usize) -> (usize, usize) {
    let reach = SUPPORT_WIDTHS * width;
    let first = (position - reach).ceil().max(0.0) as usize;
    let end = ((position + reach).floor() + 1.0).max(0.0) as usize;
    (first.min(samples), end.min(samples))
}

/// Why a fit ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Termination {
    /// The next step promises no decrease worth taking: the optimum.
    Converged,
    /// The same, with a width or a position at the end of its admissible range.
    AtBound,
    /// No step, however short, gives a smaller value: the optimum to within rounding.
    NoDecrease,
    /// The permitted number of iterations was used up.
    IterationLimit,
    /// It would not have come down to [`Limits::enough`].
    OutOfReach,
    /// Fewer used samples than parameters: nothing was fitted.
    TooFewSamples,
    /// More pulses than the workspace was made for: nothing was fitted.
    TooManyPulses,
    /// Start values, samples or normal matrix are not fit for the computation (not finite, or singular).
    Singular,
}

impl Termination {
    /// Whether the parameters are an optimum and their covariance is known.
    pub fn is_optimum(self) -> bool {
        matches!(self, Termination::Converged | Termination::AtBound | Termination::NoDecrease)
    }
}

/// When a fit ends.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Iterations at most.
    pub iterations: usize,
    /// Converged is what the next step promises to lower chi-square by less than this; the square of what is left to
    /// go, in standard deviations of the parameters.
    pub decrease: f64,
    /// A fit is given up where even eight times what the next step promises would leave chi-square, with the priors'
    /// part, above this.
    pub enough: f64,
}

impl Limits {
    /// Parameters to within 1e-5 of their standard deviations.
    pub fn exact(iterations: usize) -> Limits {
        Limits { iterations, decrease: 1e-10, enough: f64::INFINITY }
    }

    /// Chi-square to within what an acceptance turns on.
    pub fn rough(iterations: usize) -> Limits {
        Limits { iterations, decrease: 1e-2, enough: f64::INFINITY }
    }
}

/// What a fit reports beside the pulses, the offset and the covariance, which the workspace keeps.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fit {
    /// `‖L⁻¹(y - model)‖²` over the used samples, without the priors' part.
    pub chi_square: f64,
    /// Used samples.
    pub samples: usize,
    /// Free parameters: three for each pulse, one for an unknown background.
    pub parameters: usize,
    /// Iterations made: normal matrices formed.
    pub iterations: usize,
    /// Why it ended.
    pub termination: Termination,
}

/// Workspace of the fit; no memory is taken while fitting blocks and pulses within its capacities.
#[derive(Debug, Clone)]
pub struct GaussFit {
    shape: Shape,
    offset_precision: Option<f64>,
    max_pulses: usize,
    pulses: Vec<Pulse>,
    offset_dn: f64,
    trial: Vec<Pulse>,
    residual: Vec<f64>,
    trial_residual: Vec<f64>,
    /// Whitened derivatives, one column of the block's length after the other.
    columns: Vec<f64>,
    normal: Vec<f64>,
    damped: Vec<f64>,
    gradient: Vec<f64>,
    step: Vec<f64>,
    covariance: Vec<f64>,
}

impl GaussFit {
    /// A workspace for pulses of the shape (of a number: Gaussians of that full width at half maximum, samples).
    ///
    /// `offset_precision` is `None` where the background is known (and was subtracted), else `1/s_b²` of the offset's
    /// prior about zero, in 1/DN² (0: no prior). Blocks longer than `max_samples` make the workspace grow; more than
    /// `max_pulses` pulses are refused.
    pub fn new(
        shape: impl Into<Shape>,
        offset_precision: Option<f64>,
        max_samples: usize,
        max_pulses: usize,
    ) -> GaussFit {
        let parameters = 3 * max_pulses + 1;
        GaussFit {
            shape: shape.into(),
            offset_precision,
            max_pulses,
            pulses: Vec::with_capacity(max_pulses),
            offset_dn: 0.0,
            trial: Vec::with_capacity(max_pulses),
            residual: Vec::with_capacity(max_samples),
            trial_residual: Vec::with_capacity(max_samples),
            columns: Vec::with_capacity(max_samples * parameters),
            normal: vec![0.0; parameters * parameters],
            damped: vec![0.0; parameters * parameters],
            gradient: vec![0.0; parameters],
            step: vec![0.0; parameters],
            covariance: vec![0.0; parameters * parameters],
        }
    }

    /// The pulses of the last fit, in the order they were given.
    pub fn pulses(&self) -> &[Pulse] {
        &self.pulses
    }

    /// The background's offset in the last fit, digitiser steps; 0 where the background is known.
    pub fn offset_dn(&self) -> f64 {
        self.offset_dn
    }

    /// Covariance of two parameters at the optimum: of pulse `i`, `3i` is the height (DN), `3i + 1` the position
    /// (samples) and `3i + 2` the width's logarithm; behind the last pulse stands the offset (DN).
    ///
    /// Only after a fit whose termination is an optimum or the iteration limit; NaN for parameters there are not.
    pub fn covariance(&self, i: usize, j: usize) -> f64 {
        let n = self.parameters();
        if i.max(j) < n { self.covariance[i * n + j] } else { f64::NAN }
    }

    /// Standard deviations of pulse `i`: height (DN), position (samples), width's logarithm.
    pub fn pulse_sd(&self, i: usize) -> [f64; 3] {
        [0, 1, 2].map(|part| self.covariance(3 * i + part, 3 * i + part).sqrt())
    }

    /// How parameter `i` of the last fit follows the whitened samples, to first order: its row of the covariance times the
    /// derivatives. [`Whitener::whiten_transposed`] turns it into weights of the samples themselves.
    pub(super) fn weights(&self, i: usize) -> Vec<f64> {
        let samples = self.residual.len();
        let mut weights = vec![0.0; samples];
        for (j, column) in self.columns.chunks_exact(samples.max(1)).enumerate().take(self.parameters()) {
            let factor = self.covariance(i, j);
            weights.iter_mut().zip(column).for_each(|(w, c)| *w += factor * c);
        }
        weights
    }

    /// Fits pulses to `target_dn`, the samples less the known background, from the given start values.
    ///
    /// The whitener tells which samples are used; it is prepared for a block of `target_dn`'s length.
    pub fn fit(&mut self, whitener: &Whitener, target_dn: &[f64], start: &[Pulse], limits: Limits) -> Fit {
        self.pulses.clear();
        self.offset_dn = 0.0;
        let mut fit = Fit {
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
        self.columns.clear();
        self.columns.resize(samples * parameters, 0.0);
        self.covariance.fill(f64::NAN);
        self.trial.clear();
        self.trial.extend_from_slice(&self.pulses);
    }

    fn minimise(&mut self, whitener: &Whitener, target_dn: &[f64], limits: Limits, fit: &mut Fit) {
        let mut objective = self.try_point(whitener, target_dn, self.offset_dn);
        self.accept(self.offset_dn);
        let mut damping = 1e-3;
        fit.termination = Termination::IterationLimit;
        if !objective.is_finite() {
            fit.termination = Termination::Singular;
            return;
        }
        while fit.iterations < limits.iterations {
            self.form_normal_equations(whitener);
            fit.iterations += 1;
            let descent = self.descend(whitener, target_dn, limits, &mut objective, &mut damping);
            if let Some(termination) = descent {
                fit.termination = termination;
                break;
            }
        }
        if fit.termination == Termination::IterationLimit {
            self.form_normal_equations(whitener);
        }
        fit.chi_square = dot(&self.residual, &self.residual);
        if fit.termination != Termination::OutOfReach && !self.invert_normal_matrix() {
            fit.termination = Termination::Singular;
        }
    }

    /// Looks for a step that lowers the objective, with more and more damping; says why, when it is the last.
    fn descend(
        &mut self,
        whitener: &Whitener,
        target_dn: &[f64],
        limits: Limits,
        objective: &mut f64,
        damping: &mut f64,
    ) -> Option<Termination> {
        let min_height_dn = MIN_HEIGHT_SD * whitener.noise().sd();
        while *damping < 1e10 {
            if !self.solve_damped(*damping) {
                *damping *= 10.0;
                continue;
            }
            let is_newton = *damping <= NEAR_NEWTON;
            // Of the whole step, before it is cut down.
            if is_newton && *objective - REACH * self.promised_decrease() > limits.enough {
                return Some(Termination::OutOfReach);
            }
            let (offset, at_bound) = self.step_within_limits(target_dn.len(), min_height_dn);
            if is_newton && self.promised_decrease() < limits.decrease {
                return Some(if at_bound { Termination::AtBound } else { Termination::Converged });
            }
            let value = self.try_point(whitener, target_dn, offset);
            if value <= *objective {
                *objective = value;
                self.accept(offset);
                *damping = (*damping * 0.1).max(1e-9);
                return None;
            }
            *damping *= 10.0;
        }
        Some(Termination::NoDecrease)
    }

    /// The objective at `self.trial` and `offset`; the whitened residual goes to `self.trial_residual`.
    fn try_point(&mut self, whitener: &Whitener, target_dn: &[f64], offset: f64) -> f64 {
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

    fn accept(&mut self, offset: f64) {
        self.pulses.copy_from_slice(&self.trial);
        self.offset_dn = offset;
        std::mem::swap(&mut self.residual, &mut self.trial_residual);
    }

    /// Whitened derivatives of the model at the present point, into `self.columns`.
    fn form_columns(&mut self, whitener: &Whitener) {
        let samples = self.residual.len();
        self.columns.fill(0.0);
        let mut columns = self.columns.chunks_exact_mut(samples.max(1));
        for pulse in &self.pulses {
            let parts = [columns.next(), columns.next(), columns.next()];
            let [Some(by_height), Some(by_position), Some(by_width)] = parts else { return };
            let first =
                self.shape.add_derivatives(pulse, [&mut *by_height, &mut *by_position, &mut *by_width]);
            for column in [by_height, by_position, by_width] {
                whitener.whiten_from(first, column);
            }
        }
        if let (Some(_), Some(by_offset)) = (self.offset_precision, columns.next()) {
            by_offset.fill(1.0);
            whitener.whiten(by_offset);
        }
    }

    /// Normal matrix `JᵀJ + Λ` and right-hand side `Jᵀr - Λ(θ - θ₀)` at the present point.
    fn form_normal_equations(&mut self, whitener: &Whitener) {
        self.form_columns(whitener);
        let samples = self.residual.len();
        let n = self.parameters();
        let column = |i: usize| &self.columns[i * samples..(i + 1) * samples];
        for i in 0..n {
            self.gradient[i] = dot(column(i), &self.residual);
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
            self.damped[i * n + i] *= 1.0 + damping;
        }
        if !cholesky::factor(&mut self.damped[..n * n], n) {
            return false;
        }
        self.step[..n].copy_from_slice(&self.gradient[..n]);
        cholesky::solve(&self.damped[..n * n], n, &mut self.step[..n]);
        true
    }

    /// Moves `self.trial` by the step, cut down to what one step may do; the step becomes what was moved. Returns the
    /// trial's offset, and whether a bound of the parameters held something back.
    fn step_within_limits(&mut self, samples: usize, min_height_dn: f64) -> (f64, bool) {
        let mut at_bound = false;
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
            at_bound |= trial.position_samples != moved || trial.ln_width_ratio != widened;
            step[0] = trial.height_dn - pulse.height_dn;
            step[1] = trial.position_samples - pulse.position_samples;
            step[2] = trial.ln_width_ratio - pulse.ln_width_ratio;
        }
        let offset_step =
            if self.offset_precision.is_some() { self.step[3 * self.pulses.len()] } else { 0.0 };
        (self.offset_dn + offset_step, at_bound)
    }

    /// By how much the quadratic model says that the step lowers the objective.
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
