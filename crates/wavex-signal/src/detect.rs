//! Pulse candidates: local maxima of the matched filter of the calibrated pulse on whitened
//! samples.
//!
//! The statistic at lag `t` is `m(t) = g_tᵀ S⁻¹ y / √E(t)` with `E(t) = g_tᵀ S⁻¹ g_t`, `g_t` the
//! pulse of unit height at sample `t` and `S` the noise covariance of the used samples. In pure
//! noise it has mean 0 and variance 1 at every lag, so thresholds are in standard deviations of the
//! noise. An unknown background of precision `q` is part of the noise, `S = Σ + 11ᵀ/q`, by the
//! Sherman–Morrison formula.

use std::ops::Range;

use wavex_simd::dot::{AT_A_TIME, dot};

use crate::shape::Shape;
use crate::shape::{FOUR_LN_2, Pulse};
use crate::whitening::Whitener;

/// Half length of the filter pulse, in its widths: the main lobe.
const HALF_LENGTH_WIDTHS: f64 = 1.5;
/// Smallest fraction of the pulse energy in used samples at a lag.
pub(crate) const LEAST_ENERGY_PART: f64 = 0.3;

/// Smallest dip between two candidates, relative to the threshold; without it, noise on the flank
/// of one wide pulse would give two.
pub(crate) const DIP_PART: f64 = 0.5;
/// Length of the tabulated filter response after a pulse, samples.
pub(crate) const ECHO_SAMPLES: usize = 256;

/// A candidate pulse.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Candidate {
    /// Position of the maximum, samples from the block's first.
    pub position_samples: f64,
    /// Statistic at the sample of the maximum, in standard deviations of the noise; infinite for a
    /// saturated plateau.
    pub statistic: f64,
    /// Initial estimate of the height, DN.
    pub height_dn: f64,
    /// Initial estimate of the log width ratio.
    pub ln_width_ratio: f64,
}

/// Workspace of the matched filter for one pulse width.
#[derive(Debug, Clone)]
pub struct Detector {
    shape: Shape,
    offset_precision: Option<f64>,
    /// Filter pulse at an even and at an odd lag.
    templates: [Vec<f64>; 2],
    full_energy: f64,
    /// Filter statistic by whole sample after a pulse of height 1 and calibrated width.
    echo: Vec<f64>,
    /// By lag: `g_tᵀ Σ⁻¹ g_t`, reduced for an unknown background.
    energy: Vec<f64>,
    /// By lag: `g_tᵀ Σ⁻¹ 1`.
    template_offset: Vec<f64>,
    /// `Σ⁻¹ 1`.
    offset_solved: Vec<f64>,
    /// `1ᵀ Σ⁻¹ 1 + q`.
    offset_information: f64,
    solved: Vec<f64>,
    statistic: Vec<f64>,
}

impl Detector {
    /// Creates a filter for pulses of the calibrated width, in the whitener's noise.
    ///
    /// Blocks longer than `max_samples` allocate. `offset_precision` is `None`
    /// for a known background, otherwise the precision of its prior, 1/DN² (0: no prior).
    pub fn new(
        shape: impl Into<Shape>,
        offset_precision: Option<f64>,
        whitener: &Whitener,
        max_samples: usize,
    ) -> Detector {
        // The length is capped: parts of a pulse outside any block are never used.
        let shape = shape.into();
        let half = (HALF_LENGTH_WIDTHS * shape.fwhm_samples()).ceil().clamp(1.0, 1e4) as usize;
        // Late odd samples make the pulse differ between even and odd lags.
        let templates = [0, 1].map(|parity| {
            let centre = 2 * half + parity;
            let mut pulse = vec![0.0; centre + half + 1];
            shape.add(&unit_pulse(centre as f64), 1.0, &mut pulse);
            pulse.split_off(centre - half)
        });
        let mut long = Whitener::new(whitener.noise().clone(), 4 * half);
        long.set_used(&vec![true; 4 * half + 1]);
        let filters = templates.each_ref().map(|template| {
            let mut column = vec![0.0; 4 * half + 1];
            column[half..=3 * half].copy_from_slice(template);
            long.whiten(&mut column);
            let energy: f64 = column.iter().map(|v| v * v).sum();
            long.whiten_transposed(&mut column);
            (column, energy)
        });
        let full_energy = filters[0].1;
        let mut pulse = vec![0.0; 4 * half + 1 + ECHO_SAMPLES];
        // The filter stays at its centre; the pulse is shifted relative to it.
        shape.add(&unit_pulse((2 * half) as f64), 1.0, &mut pulse);
        let echo = (0..ECHO_SAMPLES).map(|lag| {
            let (solved, energy) = &filters[lag % 2];
            dot(solved, &pulse[lag..]) / energy.sqrt()
        });
        let echo = echo.collect();
        Detector {
            echo,
            shape,
            offset_precision,
            templates,
            full_energy,
            energy: Vec::with_capacity(max_samples),
            template_offset: Vec::with_capacity(max_samples),
            offset_solved: Vec::with_capacity(max_samples),
            offset_information: f64::INFINITY,
            solved: Vec::with_capacity(max_samples),
            statistic: Vec::with_capacity(max_samples),
        }
    }

    /// Prepares for the whitener's block and used samples; must be called again when they change.
    pub fn prepare(&mut self, whitener: &Whitener) {
        let samples = whitener.used().len();
        self.prepare_offset(whitener);
        self.energy.clear();
        self.template_offset.clear();
        self.solved.clear();
        self.solved.resize(samples, 0.0);
        let mut filled = 0..0;
        for lag in 0..samples {
            let (first, part) = within_block(&self.templates[lag % 2], lag, samples);
            let pulse = first..first + part.len();
            self.solved[filled].fill(0.0);
            self.solved[pulse.clone()].copy_from_slice(part);
            // Whole groups of summands: the sum is that of the whole block, bit by bit.
            let groups = first / AT_A_TIME * AT_A_TIME..pulse.end.next_multiple_of(AT_A_TIME).min(samples);
            let cross = dot(&self.solved[groups.clone()], &self.offset_solved[groups]);
            let end = whitener.whiten_part(pulse.clone(), &mut self.solved).max(pulse.end);
            filled = first..end;
            let known: f64 = self.solved[filled.clone()].iter().map(|v| v * v).sum();
            // A known background has infinite information: nothing is subtracted.
            self.energy.push(known - cross * cross / self.offset_information);
            self.template_offset.push(cross);
        }
    }

    fn prepare_offset(&mut self, whitener: &Whitener) {
        self.offset_solved.clear();
        self.offset_solved.resize(whitener.used().len(), 0.0);
        self.offset_information = f64::INFINITY;
        if let Some(precision) = self.offset_precision {
            self.offset_solved.fill(1.0);
            whitener.whiten(&mut self.offset_solved);
            let information: f64 = self.offset_solved.iter().map(|v| v * v).sum();
            if information + precision > 0.0 {
                self.offset_information = information + precision;
            }
            whitener.whiten_transposed(&mut self.offset_solved);
        }
    }

    /// Filters `values_dn`, the samples less the background, or less the pulses already found.
    ///
    /// Returns the statistic by lag; minus infinity if too little of the pulse is in used samples.
    pub fn filter(&mut self, whitener: &Whitener, values_dn: &[f64]) -> &[f64] {
        self.solved.clear();
        self.solved.extend_from_slice(values_dn);
        whitener.whiten(&mut self.solved);
        whitener.whiten_transposed(&mut self.solved);
        let offset: f64 = match self.offset_precision {
            Some(_) => self.solved.iter().sum::<f64>() / self.offset_information,
            None => 0.0,
        };
        self.statistic.clear();
        for (lag, (&energy, cross)) in self.energy.iter().zip(&self.template_offset).enumerate() {
            let (first, part) = within_block(&self.templates[lag % 2], lag, self.energy.len());
            let product = dot(part, self.solved.get(first..).unwrap_or_default()) - cross * offset;
            let enough = energy >= LEAST_ENERGY_PART * self.full_energy;
            self.statistic.push(if enough { product / energy.sqrt() } else { f64::NEG_INFINITY });
        }
        &self.statistic
    }

    /// Appends local maxima of the filter output of at least `threshold`, from left to right.
    ///
    /// Consecutive maxima are separated by a dip of at least half the threshold.
    pub fn maxima(&self, threshold: f64, candidates: &mut Vec<Candidate>) {
        let already = candidates.len();
        let mut lowest_since = f64::NEG_INFINITY;
        for lag in 0..self.statistic.len() {
            let value = self.statistic[lag];
            lowest_since = lowest_since.min(value);
            // Strict on the left only: a plateau counts once.
            let rises = lag == 0 || self.statistic[lag - 1] < value;
            let falls = self.statistic.get(lag + 1).is_none_or(|&next| next <= value);
            if !(value >= threshold && rises && falls) {
                continue;
            }
            let candidate = self.candidate(lag);
            match candidates[already..].last_mut() {
                Some(last) if last.statistic.min(value) - lowest_since < DIP_PART * threshold => {
                    if value > last.statistic {
                        *last = candidate;
                        lowest_since = value;
                    }
                }
                _ => {
                    candidates.push(candidate);
                    lowest_since = value;
                }
            }
        }
    }

    /// Interpolates a maximum by a parabola through its neighbours; the height follows from the
    /// filter gain.
    fn candidate(&self, lag: usize) -> Candidate {
        let at =
            |lag: Option<usize>| lag.and_then(|k| self.statistic.get(k)).copied().filter(|v| v.is_finite());
        let value = self.statistic[lag];
        let shift = match (at(lag.checked_sub(1)), at(Some(lag + 1))) {
            (Some(before), Some(after)) if before + after - 2.0 * value < 0.0 => {
                0.5 * (before - after) / (before + after - 2.0 * value)
            }
            _ => 0.0,
        };
        Candidate {
            position_samples: lag as f64 + shift.clamp(-0.5, 0.5),
            statistic: value,
            height_dn: value / self.energy[lag].sqrt(),
            ln_width_ratio: 0.0,
        }
    }

    /// `√E` of a pulse of calibrated width entirely in used samples.
    pub(crate) fn full_significance_per_dn(&self) -> f64 {
        self.full_energy.sqrt()
    }

    /// Filter statistic `lag_samples` after a pulse of height 1 and calibrated width.
    ///
    /// It contains the main lobe, then the filter output of the receiver's after-pulse and tail.
    pub fn echo(&self, lag_samples: f64) -> f64 {
        if lag_samples < 0.0 {
            return 0.0;
        }
        let at = |k: usize| self.echo.get(k).copied().unwrap_or(0.0);
        let (k, part) = (lag_samples as usize, lag_samples.fract());
        (1.0 - part) * at(k) + part * at(k.saturating_add(1))
    }

    /// `√E` of a pulse of calibrated width at a fractional position; its significance is its height
    /// times this.
    pub(crate) fn significance_per_dn(&mut self, whitener: &Whitener, position_samples: f64) -> f64 {
        self.solved.fill(0.0);
        self.shape.add(&unit_pulse(position_samples), 1.0, &mut self.solved);
        let cross = dot(&self.solved, &self.offset_solved);
        whitener.whiten(&mut self.solved);
        let known: f64 = self.solved.iter().map(|v| v * v).sum();
        (known - cross * cross / self.offset_information).max(0.0).sqrt()
    }
}

/// A pulse of height 1 and calibrated width.
fn unit_pulse(position_samples: f64) -> Pulse {
    Pulse { height_dn: 1.0, position_samples, ln_width_ratio: 0.0, ln_width_precision: 0.0 }
}

/// Part of the pulse at `lag` inside the block, and its first sample.
fn within_block(template: &[f64], lag: usize, samples: usize) -> (usize, &[f64]) {
    let half = template.len() / 2;
    let first = lag.saturating_sub(half);
    let end = (lag + half + 1).min(samples);
    let skipped = first + half - lag;
    (first, &template[skipped..skipped + (end - first)])
}

/// Next run of saturated samples from `from`; runs separated by a single unsaturated sample are
/// merged.
pub(crate) fn next_plateau(samples: &[u16], full_scale_dn: f64, from: usize) -> Option<Range<usize>> {
    let saturated = |k: usize| samples.get(k).is_some_and(|&s| f64::from(s) >= full_scale_dn);
    let start = (from..samples.len()).find(|&k| saturated(k))?;
    let mut end = start + 1;
    while saturated(end) || saturated(end + 1) {
        end += 1;
    }
    Some(start..end)
}

/// Candidate of a saturated plateau, from the crossings of its flanks at 0.3 and 0.8 of its level.
///
/// Two free flanks give position, width and height of a Gaussian; one gives position and height for
/// the calibrated width; without any, the centre of the plateau is used. `values_dn` are the
/// samples less the background.
pub(crate) fn plateau_candidate(values_dn: &[f64], plateau: Range<usize>, fwhm_samples: f64) -> Candidate {
    const LOW: f64 = 0.3;
    const HIGH: f64 = 0.8;
    let level = plateau.clone().filter_map(|k| values_dn.get(k)).fold(1e-6, |a: f64, &b| a.max(b));
    let rise = |part: f64| crossing(values_dn, (0..plateau.start).rev(), -1.0, level, part);
    let fall = |part: f64| crossing(values_dn, plateau.end..values_dn.len(), 1.0, level, part);
    // Of a Gaussian `exp(-c x²)`: `c (x² at LOW - x² at HIGH)`.
    let drop = (HIGH / LOW).ln();
    let calibrated = FOUR_LN_2 / (fwhm_samples * fwhm_samples);
    let (position, ln_width, outside) = match ((rise(LOW), rise(HIGH)), (fall(LOW), fall(HIGH))) {
        ((Some(a), Some(b)), (Some(d), Some(c))) => {
            let (wide, narrow) = (0.5 * (d - a), 0.5 * (c - b));
            let curvature = drop / (wide * wide - narrow * narrow).max(1e-6);
            ((a + b + c + d) / 4.0, (-0.5 * (curvature / calibrated).ln()).clamp(-0.4, 1.2), narrow)
        }
        ((Some(low), Some(high)), _) | (_, (Some(low), Some(high))) => {
            let position = 0.5 * (drop / calibrated / nonzero(high - low) + low + high);
            (position, 0.0, position - high)
        }
        _ => (0.5 * (plateau.start as f64 + plateau.end as f64 - 1.0), 0.0, 0.0),
    };
    let growth = FOUR_LN_2 * (outside / (fwhm_samples * ln_width.exp())).powi(2);
    Candidate {
        position_samples: position
            .clamp(plateau.start as f64 - fwhm_samples, plateau.end as f64 + fwhm_samples),
        statistic: f64::INFINITY,
        // The extrapolation grows exponentially, so it is bounded; the pulse is at least as high as its plateau.
        height_dn: level * (HIGH * growth.min(7.0).exp()).max(1.0),
        ln_width_ratio: ln_width,
    }
}

/// Position where the values, followed outwards from a plateau, first fall below `part` of `level`.
///
/// `direction` is the direction of the walk.
fn crossing(
    values: &[f64],
    walk: impl Iterator<Item = usize>,
    direction: f64,
    level: f64,
    part: f64,
) -> Option<f64> {
    let mut inner = level;
    for k in walk {
        let value = *values.get(k)?;
        if value < part * level {
            return Some(k as f64 - direction * (part * level - value) / nonzero(inner - value));
        }
        inner = value;
    }
    None
}

fn nonzero(x: f64) -> f64 {
    if x.abs() < 1e-9 { 1e-9f64.copysign(x) } else { x }
}

#[cfg(test)]
mod tests;
