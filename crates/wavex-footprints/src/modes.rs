//! Modes: maxima of the smoothed waveform.

use std::f64::consts::SQRT_2;
use std::ops::Range;

use wavex_simd::statistics::WithSd;

use super::echo::Echo;
use super::maximum::{half_widths, parabola};
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
