//! Pulse width of flat targets as a function of amplitude (docs/explanation/corrections.md, Width).
//!
//! It is the lowest mode of the widths in amplitude bins, smoothed. Slopes, roughness and leaves
//! only widen a pulse, so flat targets form the lowest mode.

use crate::penalised_spline::{DataPoint, smooth};

/// Width of a bin in log amplitude.
const BIN_LN: f64 = 0.1;
/// Fewest pulses of a bin.
const LEAST_PULSES: usize = 100;
/// Fewest bins of a curve.
const LEAST_BINS: usize = 3;
/// Largest relative SD of the width of pulses used for a mode.
const MOST_LN_WIDTH_SD: f64 = 0.1;
/// Smallest bandwidth of the density of widths.
const LEAST_BANDWIDTH: f64 = 0.004;
/// Smallest height of a mode, relative to the highest.
const MODE_PART: f64 = 0.5;
/// Steps of the density per bandwidth, and half extent of the kernel in bandwidths.
const STEPS_PER_BANDWIDTH: f64 = 4.0;
const REACH_BANDWIDTHS: f64 = 3.0;
/// SD of a mode over that of the widths divided by the root of their number.
const SD_OF_MODE: f64 = 1.35;
/// Standard deviations of `χ²` by which the modes must differ from a constant.
const SIGNIFICANT_SD: f64 = 3.0;
/// Number of stretches of the recording; even ones are one half, odd ones the other.
const STRETCHES: usize = 20;
/// Smallest fall of squared differences, in standard deviations of its jackknife over stretches.
const LEAST_FALL_SD: f64 = 3.0;
/// Largest log width, relative to the response, of flat targets.
const MOST_LN_WIDTH: f64 = 0.7;

/// An isolated pulse.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IsolatedPulse {
    /// Log amplitude, ln DN.
    pub ln_amplitude: f64,
    /// Logarithm of the width over the calibrated width.
    pub ln_width: f64,
    /// Standard deviation of `ln_width`.
    pub ln_width_sd: f64,
}

/// Node of the curve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WidthNode {
    /// Log amplitude, ln DN.
    pub ln_amplitude: f64,
    /// Logarithm of a flat target's width over the calibrated width.
    pub ln_width: f64,
}

/// Reason why widths have no curve.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum NoCurve {
    /// Fewer than three bins, of width 0.1 in log amplitude, with at least 100 pulses.
    #[error("the width of flat targets cannot be estimated from its single returns")]
    TooFewPulses,
    /// Chance explains the differences between the bins.
    #[error("the widths of its single returns do not depend on the amplitude")]
    Constant,
    /// The curve of one half of the pulses does not help the other half.
    #[error(
        "the dependence on the amplitude is not proven: what one half of its single returns shows lets the squared \
         differences in the other half fall by {:.1} and {:.1} standard deviations, at least {LEAST_FALL_SD} are needed",
        .0[0], .0[1]
    )]
    Unproven([f64; 2]),
}

/// Width of flat targets by ascending amplitude.
///
/// # Errors
/// [`NoCurve`]: too few pulses, or no significant dependence.
pub fn width_by_amplitude(pulses: &[IsolatedPulse]) -> Result<Vec<WidthNode>, NoCurve> {
    let modes = modes(pulses);
    if modes.len() < LEAST_BINS {
        return Err(NoCurve::TooFewPulses);
    }
    if !depends_on_amplitude(&modes) {
        return Err(NoCurve::Constant);
    }
    let curve = smooth(&modes);
    let node = |(mode, ln_width): (&DataPoint, f64)| WidthNode { ln_amplitude: mode.x, ln_width };
    Ok(modes.iter().zip(curve).map(node).collect())
}

/// Width of flat targets that proves itself, of pulses in the order of the recording.
///
/// The curve of either half must make the modes of the other half depend less on the amplitude.
///
/// # Errors
/// [`NoCurve`]: as [`width_by_amplitude`], or the curve does not prove itself.
pub fn proven_width_by_amplitude(pulses: &[IsolatedPulse]) -> Result<Vec<WidthNode>, NoCurve> {
    let nodes = width_by_amplitude(pulses)?;
    let stretch = |i: usize| i * STRETCHES / pulses.len();
    let falls = [0, 1].map(|half| {
        let other: Vec<IsolatedPulse> =
            (0..pulses.len()).filter(|i| stretch(*i) % 2 != half).map(|i| pulses[i]).collect();
        let Ok(curve) = width_by_amplitude(&other) else { return 0.0 };
        let without = |left_out: usize| {
            let is_used = |i: &usize| stretch(*i) % 2 == half && stretch(*i) != left_out;
            fall(&(0..pulses.len()).filter(is_used).map(|i| pulses[i]).collect::<Vec<_>>(), &curve)
        };
        let all = without(STRETCHES);
        let of_half: Vec<f64> = (0..STRETCHES).filter(|k| k % 2 == half).map(without).collect();
        let count = of_half.len() as f64;
        let squares: f64 = of_half.iter().map(|one| (one - all).powi(2)).sum();
        let ratio = all / (squares * (count - 1.0) / count).sqrt();
        if ratio.is_nan() { 0.0 } else { ratio }
    });
    match falls.iter().all(|fall| *fall >= LEAST_FALL_SD) {
        true => Ok(nodes),
        false => Err(NoCurve::Unproven(falls)),
    }
}

/// Fall of the mean squared difference of the modes from their mean, by a curve; NaN without modes.
fn fall(pulses: &[IsolatedPulse], curve: &[WidthNode]) -> f64 {
    let modes = modes(pulses);
    let weights: f64 = modes.iter().map(|mode| mode.weight).sum();
    let variance = |of: &dyn Fn(&DataPoint) -> f64| {
        let mean = modes.iter().map(|mode| mode.weight * of(mode)).sum::<f64>() / weights;
        modes.iter().map(|mode| mode.weight * (of(mode) - mean).powi(2)).sum::<f64>() / weights
    };
    variance(&|mode| mode.y) - variance(&|mode| mode.y - ln_width_at(curve, mode.x))
}

/// Logarithm of a flat target's width: linear between nodes, constant beyond them; 0 without nodes.
pub fn ln_width_at(nodes: &[WidthNode], ln_amplitude: f64) -> f64 {
    let behind = nodes.partition_point(|node| node.ln_amplitude <= ln_amplitude);
    let before = behind.checked_sub(1).and_then(|before| nodes.get(before));
    match (before, nodes.get(behind)) {
        (Some(a), Some(b)) => {
            let part = (ln_amplitude - a.ln_amplitude) / (b.ln_amplitude - a.ln_amplitude);
            a.ln_width + part * (b.ln_width - a.ln_width)
        }
        (Some(node), None) | (None, Some(node)) => node.ln_width,
        (None, None) => 0.0,
    }
}

/// Lowest mode of the widths in every bin with enough pulses, by ascending amplitude.
fn modes(pulses: &[IsolatedPulse]) -> Vec<DataPoint> {
    let usable = |pulse: &&IsolatedPulse| {
        pulse.ln_amplitude.is_finite()
            && pulse.ln_width.abs() <= MOST_LN_WIDTH
            && pulse.ln_width_sd > 0.0
            && pulse.ln_width_sd <= MOST_LN_WIDTH_SD
    };
    let bin = |pulse: &IsolatedPulse| (pulse.ln_amplitude / BIN_LN).floor();
    let mut sorted: Vec<IsolatedPulse> = pulses.iter().filter(usable).copied().collect();
    sorted.sort_by(|a, b| {
        bin(a)
            .total_cmp(&bin(b))
            .then(a.ln_width.total_cmp(&b.ln_width))
            .then(a.ln_width_sd.total_cmp(&b.ln_width_sd))
    });
    let bins = sorted.chunk_by(|a, b| bin(a) == bin(b)).filter(|bin| bin.len() >= LEAST_PULSES);
    bins.map(lower_mode).collect()
}

/// Whether the modes differ from their mean by more than chance.
fn depends_on_amplitude(modes: &[DataPoint]) -> bool {
    let weights = modes.iter().map(|mode| mode.weight).sum::<f64>();
    let mean = modes.iter().map(|mode| mode.weight * mode.y).sum::<f64>() / weights;
    let squares = modes.iter().map(|mode| mode.weight * (mode.y - mean).powi(2)).sum::<f64>();
    let freedom = modes.len() as f64 - 1.0;
    squares / SD_OF_MODE.powi(2) > freedom + SIGNIFICANT_SD * (2.0 * freedom).sqrt()
}

/// Lowest mode of the widths of a bin, sorted by ascending width.
fn lower_mode(bin: &[IsolatedPulse]) -> DataPoint {
    let n = bin.len() as f64;
    let mut sds: Vec<f64> = bin.iter().map(|pulse| pulse.ln_width_sd).collect();
    sds.sort_by(f64::total_cmp);
    let bandwidth = sds[sds.len() / 2].max(LEAST_BANDWIDTH);
    let x = bin.iter().map(|pulse| pulse.ln_amplitude).sum::<f64>() / n;
    let (density, from, step) = density(bin, bandwidth);
    let highest = density.iter().copied().fold(0.0, f64::max);
    let is_mode = |k: &usize| {
        let at = |k: usize| density.get(k).copied().unwrap_or(0.0);
        at(*k) >= MODE_PART * highest && at(*k) >= at(k.wrapping_sub(1)) && at(*k) > at(k + 1)
    };
    let mode = (0..density.len()).find(is_mode).unwrap_or(0);
    // Vertex of the parabola through the mode and its neighbours.
    let side = |k: usize| density.get(k).copied().unwrap_or(0.0);
    let (before, top, behind) = (side(mode.wrapping_sub(1)), side(mode), side(mode + 1));
    let bend = before - 2.0 * top + behind;
    let part = if bend < 0.0 { (0.5 * (before - behind) / bend).clamp(-0.5, 0.5) } else { 0.0 };
    DataPoint { x, y: from + (mode as f64 + part) * step, weight: n / (bandwidth * bandwidth) }
}

/// Density of the widths: values, position of the first, and step.
fn density(bin: &[IsolatedPulse], bandwidth: f64) -> (Vec<f64>, f64, f64) {
    let step = bandwidth / STEPS_PER_BANDWIDTH;
    let reach = REACH_BANDWIDTHS * bandwidth;
    let (first, last) = (bin.first().map_or(0.0, |p| p.ln_width), bin.last().map_or(0.0, |p| p.ln_width));
    let from = first - reach;
    let mut density = vec![0.0; ((last - first + 2.0 * reach) / step) as usize + 1];
    for pulse in bin {
        let near = ((pulse.ln_width - reach - from) / step).max(0.0) as usize;
        let until = (((pulse.ln_width + reach - from) / step) as usize + 1).min(density.len());
        for (k, value) in density.iter_mut().enumerate().take(until).skip(near) {
            let distance = (from + k as f64 * step - pulse.ln_width) / bandwidth;
            *value += (-0.5 * distance * distance).exp();
        }
    }
    (density, from, step)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Amplitudes of 20 to 200; flat targets according to `flat`, and as many widened ones.
    fn pulses(flat: impl Fn(f64) -> f64) -> Vec<IsolatedPulse> {
        let pulse = |k: usize| {
            let ln_amplitude = 20f64.ln() + 10f64.ln() * (k % 997) as f64 / 997.0;
            let spread = 0.02 * ((k % 31) as f64 / 15.0 - 1.0) * ((k % 7) as f64 / 6.0);
            let widened = if k.is_multiple_of(2) { 0.1 + 0.25 * (k % 53) as f64 / 53.0 } else { 0.0 };
            IsolatedPulse { ln_amplitude, ln_width: flat(ln_amplitude) + spread + widened, ln_width_sd: 0.01 }
        };
        (0..20_000).map(pulse).collect()
    }

    #[test]
    fn the_curve_of_flat_targets_is_found_among_widened_ones() {
        let flat = |ln_amplitude: f64| 0.05 * (ln_amplitude - 4.0) - 0.02 * (ln_amplitude - 4.0).powi(2);
        let nodes = width_by_amplitude(&pulses(flat)).unwrap();
        assert!(nodes.len() > 20);
        for node in &nodes {
            assert!((node.ln_width - flat(node.ln_amplitude)).abs() < 0.004, "{node:?}");
        }
    }

    #[test]
    fn a_curve_proves_itself_only_if_both_halves_have_it() {
        let flat = |ln_amplitude: f64| 0.05 * (ln_amplitude - 4.0);
        assert_eq!(proven_width_by_amplitude(&pulses(flat)), width_by_amplitude(&pulses(flat)));
        // Only the stretches of one half depend on the amplitude.
        let mut half = pulses(flat);
        for (i, pulse) in half.iter_mut().enumerate() {
            let is_odd = (i * STRETCHES / 20_000) % 2 == 1;
            pulse.ln_width -= if is_odd { 1.6 * flat(pulse.ln_amplitude) } else { 0.0 };
        }
        assert!(width_by_amplitude(&half).is_ok());
        let refused = proven_width_by_amplitude(&half).unwrap_err();
        assert!(
            matches!(refused, NoCurve::Unproven(falls) if falls.iter().all(|fall| *fall < 3.0)),
            "{refused}"
        );
    }

    #[test]
    fn the_order_of_the_pulses_does_not_matter() {
        let some = pulses(|ln_amplitude| 0.01 * ln_amplitude);
        let backwards: Vec<IsolatedPulse> = some.iter().rev().copied().collect();
        let (a, b) = (width_by_amplitude(&some).unwrap(), width_by_amplitude(&backwards).unwrap());
        for (a, b) in a.iter().zip(&b) {
            assert!((a.ln_width - b.ln_width).abs() < 1e-9 && (a.ln_amplitude - b.ln_amplitude).abs() < 1e-9);
        }
    }

    #[test]
    fn widths_without_dependence_have_no_curve() {
        assert_eq!(width_by_amplitude(&pulses(|_| 0.01)), Err(NoCurve::Constant));
    }

    #[test]
    fn few_pulses_give_no_width_table() {
        let few: Vec<IsolatedPulse> = pulses(|_| 0.0).into_iter().take(500).collect();
        assert_eq!(width_by_amplitude(&few), Err(NoCurve::TooFewPulses));
        let unsure: Vec<IsolatedPulse> =
            pulses(|_| 0.0).into_iter().map(|p| IsolatedPulse { ln_width_sd: 0.2, ..p }).collect();
        assert_eq!(width_by_amplitude(&unsure), Err(NoCurve::TooFewPulses));
    }
}
