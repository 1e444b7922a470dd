//! Echoes of earlier pulses on outgoing pulses: detection and corrected emission time.
//!
//! Outgoing pulses of one scan line are alike. A pulse with unusual height, width, position or
//! residual has two hypotheses: one typical pulse, or a typical pulse and an echo of unknown
//! position and height. Their evidence (Laplace approximation at each echo position, integrated
//! over positions) gives the probability of an echo, and the mean and standard deviation of the
//! emission time over both hypotheses (Bayesian model averaging).

mod moments;

use std::ops::Range;

use super::usual::{ReferenceBlock, UNUSUAL_DEVIATION, Usual, percentiles};
use super::{Outgoing, window};
use crate::cholesky;
use crate::flags;
use crate::sensor_model::{ChannelModel, ModelError};
use crate::shape::Pulse;
use crate::shape::Shape;
use crate::whitening::Whitener;
use moments::Moments;

/// Fewest outgoing pulses of a line that define typical parameters.
const LEAST_PULSES: usize = 30;
/// Number of pulses fitted to measure the typical residual.
const SAMPLED: usize = 12;
/// Prior odds of an echo on an unusual outgoing pulse.
const PRIOR_ODDS: f64 = 0.2;
/// Prior odds if a recorded echo was received while the pulse left.
const EXPECTED_ODDS: f64 = 2.0;
/// Upper limit of the uniform prior on the echo height, in typical pulse heights.
const GREATEST_HEIGHT: f64 = 1.5;
/// Largest distance of the echo from the pulse, in pulse widths.
const REACH_WIDTHS: f64 = 1.6;
/// Number of echo positions tried first.
const PLACES: usize = 37;
/// Number of positions that replace each relevant one, if neighbours differ too much.
const PLACES_PER_STEP: usize = 3;
/// Levels of refinement of the echo position.
const LEVELS: usize = 5;
/// Number of maxima of the evidence refined at each level.
const MODES: usize = 4;
/// Largest difference of log evidence between neighbouring positions.
const COARSE: f64 = 3.0;
/// Factor on the SD of the pulse position with an echo: the width of the echo is unknown.
const UNKNOWN_WIDTH: f64 = 1.15;
/// Log evidence below the best at which a position is negligible.
const NEGLIGIBLE: f64 = 10.0;
/// Largest number of iterations of a fit.
const ITERATIONS: usize = 12;
/// Number of parameters: height, position and log width of the pulse, and height of the echo.
const PARAMETERS: usize = 4;

/// Parameters at an optimum.
#[derive(Debug, Clone, Copy)]
struct Optimum {
    values: [f64; PARAMETERS],
    place_sd: f64,
    /// Chi-square of the samples alone, over the noise factor.
    chi_square: f64,
    /// Log evidence, without constants common to all hypotheses.
    ln_evidence: f64,
}

/// Hypothesis of an outgoing pulse with an echo, integrated over echo positions.
struct WithEcho {
    ln_evidence: f64,
    /// Position of the pulse.
    place: Moments,
    /// Smallest chi-square of all echo positions.
    chi_square: f64,
}

/// Separates echoes from the outgoing pulses of one channel.
#[derive(Debug, Clone)]
pub(super) struct Mixture {
    model: ChannelModel,
    shape: Shape,
    whitener: Whitener,
    target_dn: Vec<f64>,
    residual: Vec<f64>,
    columns: [Vec<f64>; PARAMETERS],
}

impl Mixture {
    /// Returns `None` without a calibrated response: the residual of a Gaussian resembles an echo.
    pub(super) fn new(model: &ChannelModel) -> Result<Option<Mixture>, ModelError> {
        if model.response.is_none() {
            return Ok(None);
        }
        Ok(Some(Mixture {
            model: model.clone(),
            shape: Shape::of(model)?,
            whitener: Whitener::new(model.noise()?, 64),
            target_dn: Vec::new(),
            residual: Vec::new(),
            columns: Default::default(),
        }))
    }

    /// Typical parameters of the outgoing pulses of a line; `None` for fewer than 30.
    pub(super) fn usual(
        &mut self,
        blocks: &[ReferenceBlock<'_>],
        pulses: &[Option<Outgoing>],
    ) -> Option<Usual> {
        let is_whole =
            |outgoing: &&Outgoing| outgoing.pulse.flags & (flags::SATURATED | flags::TRUNCATED) == 0;
        let fitted: Vec<(&ReferenceBlock<'_>, &Outgoing)> = (blocks.iter().zip(pulses))
            .filter_map(|(block, outgoing)| Some((block, outgoing.as_ref().filter(is_whole)?)))
            .collect();
        if fitted.len() < LEAST_PULSES {
            return None;
        }
        let mut usual = Usual::of(&fitted);
        // Second pass without unusual pulses.
        let clean: Vec<(&ReferenceBlock<'_>, &Outgoing)> = (fitted.iter().copied())
            .filter(|(block, o)| !usual.is_unusual(&o.pulse, block.start_samples + o.pulse.position_samples))
            .collect();
        let fitted = if clean.len() < LEAST_PULSES { fitted } else { clean };
        usual = Usual::of(&fitted);
        let step = fitted.len().div_ceil(SAMPLED);
        let mut left: Vec<f64> = Vec::with_capacity(SAMPLED);
        for (block, outgoing) in fitted.iter().step_by(step) {
            if let Some(LoadedPulse { window, start }) = self.load(block, outgoing, &usual)
                && let Some(one) = self.optimum(None, start, &usual)
            {
                left.push(one.chi_square / window.len().saturating_sub(3).max(1) as f64);
            }
        }
        // `max` ignores a NaN median.
        let factor = self.model.pulse_error_factor.powi(2).max(1.0);
        usual.noise_factor = factor.max(percentiles(left.into_iter())[1]);
        Some(usual)
    }

    /// Examines an outgoing pulse of the line for an echo.
    ///
    /// Sets [`flags::ECHO_ON_OUTGOING`] if an echo is more probable than not. Position and standard
    /// deviation become the mean over both hypotheses.
    pub(super) fn judge(
        &mut self,
        block: &ReferenceBlock<'_>,
        outgoing: &mut Outgoing,
        usual: &Usual,
        is_expected: bool,
    ) {
        if outgoing.pulse.flags & flags::SATURATED != 0 {
            return;
        }
        let place = block.start_samples + outgoing.pulse.position_samples;
        let unseen_sd = usual.unseen_move_sd(&outgoing.pulse, self.model.fwhm_samples());
        let pulse = &mut outgoing.pulse;
        pulse.position_sd_samples = pulse.position_sd_samples.hypot(unseen_sd);
        if !(is_expected || usual.is_unusual(pulse, place)) {
            return;
        }
        let Some(LoadedPulse { window, start }) = self.load(block, outgoing, usual) else { return };
        let Some(one) = self.optimum(None, start, usual) else { return };
        let with_echo = self.with_echo(start, usual);
        let odds = if is_expected { EXPECTED_ODDS } else { PRIOR_ODDS };
        let ln_odds = odds.ln() + with_echo.ln_evidence - one.ln_evidence;
        let probability = 1.0 / (1.0 + (-ln_odds).exp());
        let mut all = Moments::default();
        all.add(1.0 - probability, one.values[1], one.place_sd.hypot(unseen_sd));
        if with_echo.place.weight > 0.0 {
            all.add(probability, with_echo.place.mean(), UNKNOWN_WIDTH * with_echo.place.variance().sqrt());
        }
        let pulse = &mut outgoing.pulse;
        pulse.position_samples = window.start as f64 + all.mean();
        pulse.position_sd_samples = all.variance().sqrt();
        let chi_square = if probability > 0.5 { with_echo.chi_square } else { one.chi_square };
        let freedom = window.len().saturating_sub(PARAMETERS).max(1) as f64;
        outgoing.is_explained = chi_square <= freedom + UNUSUAL_DEVIATION * (2.0 * freedom).sqrt();
        if probability > 0.5 || usual.is_displaced(place) {
            pulse.flags |= flags::ECHO_ON_OUTGOING;
        }
        outgoing.window = window;
    }

    /// Loads the samples around the typical position, or around the pulse if that is not known.
    fn load(
        &mut self,
        block: &ReferenceBlock<'_>,
        outgoing: &Outgoing,
        usual: &Usual,
    ) -> Option<LoadedPulse> {
        let expected = usual.place.median - block.start_samples;
        let at = if usual.knows_place() { expected } else { outgoing.pulse.position_samples };
        let mut range = window(at, self.model.fwhm_samples(), block.samples.len());
        // Background phase and sample parity depend on the index in the block.
        range.start = range.start / 4 * 4;
        let samples = block.samples.get(range.clone())?;
        let is_saturated = samples.iter().any(|&sample| f64::from(sample) >= self.model.full_scale_dn);
        if samples.len() <= PARAMETERS || is_saturated {
            return None;
        }
        self.target_dn.clear();
        self.model.signal_into(samples, &mut self.target_dn);
        self.residual.clear();
        self.residual.resize(samples.len(), 0.0);
        self.whitener.set_used(&vec![true; samples.len()]);
        for column in &mut self.columns {
            column.clear();
            column.resize(samples.len(), 0.0);
        }
        let first = range.start as f64;
        let values = [usual.ln_height.median.exp(), at - first, usual.ln_width.median, 0.0];
        Some(LoadedPulse { window: range, start: StartValues { values, place: expected - first } })
    }

    /// Fits the pulse with an echo, over all echo positions.
    fn with_echo(&mut self, start: StartValues, usual: &Usual) -> WithEcho {
        let reach = REACH_WIDTHS * self.model.fwhm_samples();
        let at = start.values[1];
        let mut tried = Vec::new();
        let whole = PulseGrid { low: at - reach, high: at + reach, places: PLACES };
        self.explore(whole, LEVELS, start, usual, &mut tried);
        let best = tried.iter().map(|(ln_weight, _)| *ln_weight).fold(f64::NEG_INFINITY, f64::max);
        let mut all = WithEcho { ln_evidence: best, place: Moments::default(), chi_square: f64::INFINITY };
        for (ln_weight, optimum) in tried {
            all.place.add((ln_weight - best).exp(), optimum.values[1], optimum.place_sd);
            all.chi_square = all.chi_square.min(optimum.chi_square);
        }
        all.ln_evidence += (all.place.weight / (2.0 * reach)).ln();
        all
    }

    /// Tries echo positions in an interval; refines relevant ones until neighbours differ little.
    ///
    /// Appends optima with their log evidence times the step.
    fn explore(
        &mut self,
        PulseGrid { low, high, places }: PulseGrid,
        levels: usize,
        start: StartValues,
        usual: &Usual,
        tried: &mut Vec<(f64, Optimum)>,
    ) {
        let step = (high - low) / places as f64;
        let place = |i: usize| low + (i as f64 + 0.5) * step;
        let optima: Vec<Option<Optimum>> =
            (0..places).map(|i| self.optimum(Some(place(i)), start, usual)).collect();
        let ln_evidence =
            |i: usize| optima.get(i).copied().flatten().map_or(f64::NEG_INFINITY, |o| o.ln_evidence);
        let best = (0..places).map(ln_evidence).fold(f64::NEG_INFINITY, f64::max);
        let is_coarse = (1..places).any(|i| {
            let (a, b) = (ln_evidence(i - 1), ln_evidence(i));
            a.max(b) > best - NEGLIGIBLE && (a - b).abs() > COARSE
        });
        if !is_coarse || levels == 0 {
            let optima = optima.into_iter().flatten().filter(|optimum| optimum.ln_evidence.is_finite());
            tried.extend(optima.map(|optimum| (optimum.ln_evidence + step.ln(), optimum)));
            return;
        }
        let before = |i: usize| if i == 0 { f64::NEG_INFINITY } else { ln_evidence(i - 1) };
        let mut maxima: Vec<usize> = (0..places)
            .filter(|&i| ln_evidence(i) > before(i) && ln_evidence(i) >= ln_evidence(i + 1))
            .collect();
        maxima.sort_by(|&a, &b| ln_evidence(b).total_cmp(&ln_evidence(a)));
        maxima.truncate(MODES);
        let matters = |i: &usize| {
            ln_evidence(*i) > best - 3.0 * NEGLIGIBLE
                || maxima.iter().any(|maximum| maximum.abs_diff(*i) <= 1)
        };
        let mut i = 0;
        while i < places {
            let run = (i..places).take_while(matters).count();
            if run > 0 {
                let finer = PulseGrid {
                    low: low + i as f64 * step,
                    high: low + (i + run) as f64 * step,
                    places: PLACES_PER_STEP * run,
                };
                self.explore(finer, levels - 1, start, usual, tried);
            }
            i += run + 1;
        }
    }

    /// Finds the optimum with an echo at a given position, or without one. `None` if the fit fails.
    fn optimum(&mut self, echo: Option<f64>, start: StartValues, usual: &Usual) -> Option<Optimum> {
        let n = if echo.is_some() { PARAMETERS } else { PARAMETERS - 1 };
        let mut values = start.values;
        let (mut objective, mut chi_square) = (f64::INFINITY, f64::INFINITY);
        let mut normal = [0.0; PARAMETERS * PARAMETERS];
        for _ in 0..ITERATIONS {
            let mut gradient = [0.0; PARAMETERS];
            let chi = self.normal_equations(&values, echo, usual, &mut normal, &mut gradient);
            let priors = add_priors(&values, n, start.place, usual, &mut normal, &mut gradient);
            (chi_square, objective) = (chi, chi + priors);
            let mut step = gradient;
            if !objective.is_finite() || !cholesky::factor(&mut normal[..n * n], n) {
                return None;
            }
            cholesky::solve(&normal[..n * n], n, &mut step[..n]);
            let promised: f64 = step.iter().zip(&gradient).take(n).map(|(s, g)| s * g).sum();
            if promised < 1e-2 {
                break;
            }
            let limits = [0.5 * values[0], 1.0, 0.2, f64::INFINITY];
            for ((value, step), limit) in values.iter_mut().zip(step).zip(limits).take(n) {
                *value += step.clamp(-limit, limit);
            }
        }
        let mut covariance = [0.0; PARAMETERS * PARAMETERS];
        cholesky::invert(&normal[..n * n], n, &mut covariance[..n * n]);
        // Half the logarithm of the determinant of the covariance (Laplace).
        let ln_det: f64 = (0..n).map(|i| -normal[i * n + i].ln()).sum();
        let (place_sd, mut ln_evidence) = (covariance[n + 1].sqrt(), ln_det - 0.5 * objective);
        if echo.is_some() {
            let echo_sd_dn = covariance[n * n - 1].sqrt();
            let greatest_dn = GREATEST_HEIGHT * usual.ln_height.median.exp();
            // Uniform prior from 0 to the greatest height; `√(2π)` for the additional parameter.
            let positive = libm::erfc(-values[3] / (echo_sd_dn * std::f64::consts::SQRT_2)) / 2.0;
            ln_evidence += (positive * std::f64::consts::TAU.sqrt() / greatest_dn).ln();
        }
        Some(Optimum { values, place_sd, chi_square, ln_evidence })
            .filter(|optimum| optimum.place_sd.is_finite())
    }

    /// Writes the normal matrix and gradient of the samples; returns chi-square over the noise
    /// factor.
    fn normal_equations(
        &mut self,
        values: &[f64; PARAMETERS],
        echo: Option<f64>,
        usual: &Usual,
        normal: &mut [f64],
        gradient: &mut [f64],
    ) -> f64 {
        let n = if echo.is_some() { PARAMETERS } else { PARAMETERS - 1 };
        let [height_dn, position_samples, ln_width_ratio, echo_dn] = *values;
        let pulse = Pulse { height_dn, position_samples, ln_width_ratio, ln_width_precision: 0.0 };
        for column in &mut self.columns {
            column.fill(0.0);
        }
        self.residual.copy_from_slice(&self.target_dn);
        self.shape.add(&pulse, -1.0, &mut self.residual);
        let [by_height, by_place, by_width, by_echo] = &mut self.columns;
        self.shape.add_derivatives(&pulse, [by_height, by_place, by_width]);
        if let Some(position_samples) = echo {
            let ln_width_ratio = usual.ln_width.median;
            let unit = Pulse { height_dn: 1.0, position_samples, ln_width_ratio, ln_width_precision: 0.0 };
            self.shape.add(&unit, 1.0, by_echo);
            self.residual.iter_mut().zip(&*by_echo).for_each(|(r, e)| *r -= echo_dn * e);
        }
        self.whitener.whiten(&mut self.residual);
        for column in self.columns.iter_mut().take(n) {
            self.whitener.whiten(column);
        }
        let dot = |a: &[f64], b: &[f64]| -> f64 {
            a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>() / usual.noise_factor
        };
        for (i, a) in self.columns.iter().take(n).enumerate() {
            gradient[i] = dot(a, &self.residual);
            for (j, b) in self.columns.iter().take(i + 1).enumerate() {
                normal[i * n + j] = dot(a, b);
            }
        }
        dot(&self.residual, &self.residual)
    }
}

/// Echo positions in the middle of equal parts of an interval, samples.
struct PulseGrid {
    low: f64,
    high: f64,
    places: usize,
}

/// Fitted samples and start values.
struct LoadedPulse {
    window: Range<usize>,
    start: StartValues,
}

/// StartValues values of a fit and the position expected from the line.
#[derive(Debug, Clone, Copy)]
struct StartValues {
    values: [f64; PARAMETERS],
    place: f64,
}

/// Adds the line's priors on height, position and width; returns their part of the objective.
fn add_priors(
    values: &[f64; PARAMETERS],
    n: usize,
    place: f64,
    usual: &Usual,
    normal: &mut [f64],
    gradient: &mut [f64],
) -> f64 {
    let height = usual.ln_height.median.exp();
    let priors = [
        (height, height * usual.ln_height.true_sd),
        (place, usual.place.true_sd),
        (usual.ln_width.median, usual.ln_width.true_sd),
    ];
    let mut sum = 0.0;
    for (i, (mean, sd)) in priors.into_iter().enumerate() {
        let score = (values[i] - mean) / sd;
        normal[i * n + i] += 1.0 / (sd * sd);
        gradient[i] -= score / sd;
        sum += score * score;
    }
    sum
}

#[cfg(test)]
mod tests;
