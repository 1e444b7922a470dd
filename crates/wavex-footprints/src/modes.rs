//! Modes: maxima of the smoothed waveform.

use std::f64::consts::SQRT_2;
use std::ops::Range;

use wavex_simd::statistics::WithSd;

use super::echo::Echo;
use super::measured::FootprintMode;

/// What a maximum must exceed to be a mode.
pub(super) struct ModeRules {
    /// Height, DN.
    pub(super) least_dn: f64,
    /// Whether it need not stand out of the valleys beside it and of the tails of modes before it.
    pub(super) takes_every_maximum: bool,
}

/// SDs of a smoothed sample and of half the difference of its neighbours, DN.
pub(super) struct SmoothedNoise {
    pub(super) height_sd_dn: f64,
    pub(super) slope_sd_dn: f64,
}

/// Modes of a smoothed waveform within a range of samples.
pub(super) fn modes(
    values: &[f32],
    within: Range<usize>,
    rules: &ModeRules,
    noise: &SmoothedNoise,
    echo: &Echo,
) -> Vec<FootprintMode> {
    // A valley is real if it is deeper than the noise of a difference.
    let depth_dn = if rules.takes_every_maximum { 0.0 } else { SQRT_2 * rules.least_dn };
    let mut modes: Vec<FootprintMode> = Vec::new();
    let mut valley_dn = f64::INFINITY;
    for top in within {
        let Some(here) = values.get(top).copied().map(f64::from) else { break };
        valley_dn = valley_dn.min(here);
        let Some((offset, bend_dn)) = parabola(values, top).filter(|_| here > rules.least_dn) else {
            continue;
        };
        // The highest point of the parabola.
        let height_dn = here - 0.5 * bend_dn * offset * offset;
        let position = top as f64 + offset;
        let own = half_widths(values, top, position, height_dn);
        let mode = FootprintMode {
            position_samples: WithSd { value: position, sd: noise.slope_sd_dn / -bend_dn },
            amplitude_dn: WithSd { value: height_dn, sd: noise.height_sd_dn },
            half_width_ratios: [0, 1].map(|side| own[side] / echo.half_widths_samples[side]),
        };
        let before = modes.last().map(|last| last.amplitude_dn.value);
        if let Some(before_dn) = before.filter(|before_dn| before_dn.min(height_dn) - valley_dn < depth_dn) {
            // One mode with a ripple: the higher maximum.
            if height_dn > before_dn {
                modes.pop();
                modes.push(mode);
                valley_dn = here;
            }
        } else if rules.takes_every_maximum || height_dn >= rules.least_dn + tails_dn(&modes, position, echo)
        {
            modes.push(mode);
            valley_dn = here;
        }
    }
    modes
}

/// Largest signal that the tails of modes leave at a position behind them, DN.
fn tails_dn(modes: &[FootprintMode], position: f64, echo: &Echo) -> f64 {
    let tail = |mode: &FootprintMode| {
        let distance = (position - mode.position_samples.value).max(0.0) as usize;
        mode.amplitude_dn.value * echo.tail.get(distance).copied().unwrap_or(0.0)
    };
    modes.iter().map(tail).sum()
}

/// Distances from a mode to half its height behind it and before it, samples; to the next valley if that is higher.
pub(super) fn half_widths(values: &[f32], top: usize, position: f64, height: f64) -> [f64; 2] {
    let half = 0.5 * height;
    let behind = values.get(top..).unwrap_or_default().iter().map(|dn| f64::from(*dn));
    let before = values.get(..=top).unwrap_or_default().iter().rev().map(|dn| f64::from(*dn));
    let offset = position - top as f64;
    [steps_to(behind, half) - offset, steps_to(before, half) + offset]
}

/// Number of steps, with its fraction, until values fall below a level or rise again.
fn steps_to(values: impl Iterator<Item = f64>, level: f64) -> f64 {
    let mut last = f64::INFINITY;
    for (step, value) in (0u32..).zip(values) {
        if value <= level {
            return f64::from(step) - (level - value) / (last - value);
        }
        if value > last {
            return f64::from(step.saturating_sub(1));
        }
        last = value;
    }
    f64::INFINITY
}

/// The parabola through a local maximum and its neighbours: distance of its vertex from the maximum, and its second
/// difference; `None` at the ends and elsewhere.
pub(super) fn parabola(values: &[f32], top: usize) -> Option<(f64, f64)> {
    let at = |k: usize| values.get(k).copied().map(f64::from);
    let (before, here, behind) = (at(top.checked_sub(1)?)?, at(top)?, at(top + 1)?);
    let bend = before - 2.0 * here + behind;
    (here > before && here >= behind).then(|| (0.5 * (before - behind) / bend, bend))
}
