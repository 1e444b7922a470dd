//! The ground: how far the lowest mode may be from it, and the probability that it is it.
//!
//! Slopes and low vegetation merge with the ground into one mode, and shift it by more than the noise does. How much
//! follows from the mode's shape: the constants are maximum-likelihood estimates from 12 000 shots of
//! `tests/python/make_footprints.py` (seeds 11 to 16), for a mixture of a Gaussian error about the
//! ground and an exponential one of modes above a ground that is not seen (`tests/python/fit_ground.py`).

use wavex_simd::statistics::WithSd;

use super::measured::FootprintMode;

/// Constants, and factors of [`Evidence::features`]: of the log-odds that the mode is the ground.
const LOG_ODDS: [f64; 6] = [-0.6299, -11.6645, 8.9003, 0.4434, 0.3793, 0.9416];
/// The same of the logarithm of the SD of its distance from the ground, m.
const LOG_SD: [f64; 6] = [-3.3577, -3.5224, 5.2481, 0.2175, -0.0310, -0.0694];
/// Smallest and largest logarithm of that SD.
const LOG_SD_BOUNDS: [f64; 2] = [-5.0, 2.0];
/// Distance per nanosecond, m.
const M_PER_NS: f64 = 0.149_896_229;

/// What the distance of a mode from the ground depends on.
#[derive(Clone, Copy, Debug)]
pub(super) struct Evidence {
    /// Half widths behind and before the mode, over those of a flat target.
    half_width_ratios: [f64; 2],
    /// Energy of the mode over that of the waveform.
    energy_ratio: f64,
    /// Height of the mode over the SD of its noise.
    height_sds: f64,
    /// Number of modes.
    modes: usize,
}

impl Evidence {
    /// Of the lowest of several modes.
    pub(super) fn of(lowest: &FootprintMode, energy_ratio: f64, modes: usize) -> Evidence {
        Evidence {
            half_width_ratios: lowest.half_width_ratios,
            energy_ratio,
            height_sds: lowest.amplitude_dn.value / lowest.amplitude_dn.sd,
            modes,
        }
    }

    /// What the constants multiply; bounded, because nothing is known beyond the simulated shots.
    fn features(self) -> [f64; 6] {
        let [behind, before] = self.half_width_ratios.map(|width| libm::log(width.clamp(0.5, 8.0)));
        let canopy = -libm::log(self.energy_ratio.clamp(0.02, 1.0));
        let strength = libm::log(self.height_sds.clamp(3.0, 2000.0));
        [1.0, behind, before, canopy, strength, (self.modes as f64 - 1.0).clamp(0.0, 3.0)]
    }

    fn sum(self, factors: [f64; 6]) -> f64 {
        self.features().iter().zip(factors).map(|(feature, factor)| feature * factor).sum()
    }

    /// Probability that the mode is the ground, and not a layer above a ground that is not seen.
    pub(super) fn probability(self) -> f64 {
        1.0 / (1.0 + libm::exp(-self.sum(LOG_ODDS)))
    }

    /// SD of the mode's distance from the ground by slope and vegetation, ns.
    fn shift_sd_ns(self) -> f64 {
        let [least, largest] = LOG_SD_BOUNDS;
        libm::exp(self.sum(LOG_SD).clamp(least, largest)) / M_PER_NS
    }

    /// Position of the ground: that of the mode, with the SD of noise and shift.
    pub(super) fn position(self, mode: &FootprintMode, interval_ns: f64) -> WithSd {
        let WithSd { value, sd } = mode.position_samples;
        WithSd { value, sd: sd.hypot(self.shift_sd_ns() / interval_ns) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BARE: Evidence =
        Evidence { half_width_ratios: [1.0, 1.0], energy_ratio: 1.0, height_sds: 200.0, modes: 1 };

    #[test]
    fn a_narrow_mode_is_the_ground_within_centimetres() {
        assert!(BARE.probability() > 0.7, "{}", BARE.probability());
        assert!((0.02..0.06).contains(&(BARE.shift_sd_ns() * M_PER_NS)));
    }

    /// Vegetation that merges with the ground widens the mode on its upper side.
    #[test]
    fn a_mode_widened_above_is_uncertain() {
        let widened = Evidence { half_width_ratios: [1.1, 2.0], energy_ratio: 0.6, ..BARE };
        assert!(widened.shift_sd_ns() > 10.0 * BARE.shift_sd_ns());
        let layers = Evidence { half_width_ratios: [1.6, 1.0], modes: 3, ..BARE };
        assert!(layers.probability() < BARE.probability(), "wide below: a layer above a hidden ground");
    }

    #[test]
    fn nothing_is_extrapolated() {
        let far = Evidence {
            half_width_ratios: [1e9, f64::INFINITY],
            energy_ratio: 0.0,
            height_sds: 0.0,
            modes: 90,
        };
        assert!((0.0..=1.0).contains(&far.probability()) && far.shift_sd_ns() * M_PER_NS < 7.5);
    }
}
