//! The ground: the lowest mode, or a surface below it that has no mode.
//!
//! Slopes and low vegetation merge with the ground into one mode and shift it by more than the noise does; a layer can hide
//! the ground. The distance of the ground below the mode has a distribution of three parts: a normal one about the
//! mode, a normal one about a second candidate below it, and an exponential one of grounds that the waveform does not show.
//! Weights, SDs and distances are functions of the shape of the mode.
//! `tests/python/fit_ground.py` fits their constants to simulated shots by maximum likelihood.

use wavex_simd::statistics::WithSd;

use super::constants::{CALIBRATION, OUTPUTS, SD_FACTOR};
use super::echo::Echo;
use super::maximum::fall;
use super::measured::{FootprintMode, GROUND_FEATURES};

/// Bounds of the logarithms, m: SD of the first candidate, distance and SD of the second, mean distance of a hidden ground.
const LOG_BOUNDS: [[f64; 2]; 4] = [[-5.0, 1.0], [-2.0, 3.0], [-2.0, 1.1], [0.0, 3.4]];
/// A candidate is right if the ground is within this distance, m, or this number of SDs.
const NEAR_M: f64 = 1.0;
const NEAR_SDS: f64 = 3.0;
/// Mean distance of grounds above the mode, m: modes below the ground are rare.
const ABOVE_M: f64 = 1.0;
/// Smallest probability of a second candidate.
const LEAST_SECOND: f64 = 0.05;
/// Levels at which the mode's width below is measured, over its height.
const LEVELS: [f64; 3] = [0.75, 0.5, 0.25];
/// Smallest of these levels, SDs of the smoothed noise.
const LEAST_LEVEL_SDS: f64 = 6.0;
/// Distance per nanosecond, m.
pub(super) const M_PER_NS: f64 = 0.149_896_229;

/// The lowest mode and its surroundings.
pub(super) struct Lowest<'a> {
    /// Smoothed samples, DN.
    pub(super) values_dn: &'a [f32],
    /// The modes; the last one is the lowest.
    pub(super) modes: &'a [FootprintMode],
    pub(super) echo: &'a Echo,
    /// First and last sample of the signal.
    pub(super) signal: [usize; 2],
    /// Threshold at which the signal ends, DN.
    pub(super) least_dn: f64,
    /// Energy of the mode over that of the waveform.
    pub(super) energy_ratio: f64,
    pub(super) m_per_sample: f64,
    pub(super) pulse_sd_samples: f64,
}

impl Lowest<'_> {
    /// What the constants multiply; bounded, because nothing is known beyond the simulated shots.
    pub(super) fn features(&self) -> Option<[f64; GROUND_FEATURES]> {
        let (mode, above) = self.modes.split_last()?;
        let above = above.last();
        let log = |value: f64, least: f64, most: f64| libm::log(value.clamp(least, most));
        let WithSd { value: height_dn, sd: sd_dn } = mode.amplitude_dn;
        let position = mode.position_samples.value;
        let top = position.round() as usize;
        let [widest_below, wide_below, wider_below] = LEVELS.map(|level| {
            let level_dn = (level * height_dn).max(LEAST_LEVEL_SDS * sd_dn);
            let own = fall(self.values_dn.get(top..).unwrap_or_default(), level_dn) - (position - top as f64);
            log(own / self.echo.fall_behind(level_dn / height_dn).max(0.5), 0.5, 8.0)
        });
        let [first, last] = self.signal.map(|sample| sample as f64);
        let edge_m = (last - position - self.echo.fall_behind(self.least_dn / height_dn)) * self.m_per_sample;
        let canopy_m = (position - first - 2.0 * self.pulse_sd_samples) * self.m_per_sample;
        let valley_dn = above.map_or(height_dn, |above| {
            let between = self.values_dn.get(above.position_samples.value.round() as usize..top);
            between.unwrap_or_default().iter().fold(f64::INFINITY, |least, dn| least.min(f64::from(*dn)))
        });
        let above_dn = above.map_or(height_dn, |above| above.amplitude_dn.value);
        let [_, half_above] = mode.half_width_ratios;
        Some([
            1.0,
            widest_below,
            wide_below,
            wider_below,
            log(half_above, 0.5, 8.0),
            -log(self.energy_ratio, 0.02, 1.0),
            log(height_dn / sd_dn, 3.0, 2000.0),
            (self.modes.len() as f64 - 1.0).clamp(0.0, 3.0),
            log(edge_m, 0.3, 20.0),
            log(canopy_m, 0.3, 60.0),
            (valley_dn / height_dn).clamp(0.0, 1.0),
            log(above_dn / height_dn, 0.05, 20.0),
        ])
    }
}

/// Distribution of the distance of the ground below the lowest mode, m.
#[derive(Clone, Copy, Debug)]
pub(super) struct GroundDistribution {
    /// Weights of ground at the mode, at the second candidate, and not shown.
    weights: [f64; 3],
    sd_m: f64,
    second_m: WithSd,
    /// Mean distance of a ground that is not shown, m.
    missed_m: f64,
}

impl GroundDistribution {
    pub(super) fn of(features: &[f64; GROUND_FEATURES]) -> GroundDistribution {
        let outputs = OUTPUTS.map(|factors| {
            features.iter().zip(factors).map(|(feature, factor)| feature * factor).sum::<f64>()
        });
        let [first, second, missed, log_sd, log_second, log_second_sd, log_missed] = outputs;
        let highest = first.max(second).max(missed);
        let odds = [first, second, missed].map(|score| libm::exp(score - highest));
        let [sd_bounds, second_bounds, second_sd_bounds, missed_bounds] = LOG_BOUNDS;
        let exp = |log: f64, [least, most]: [f64; 2]| libm::exp(log.clamp(least, most));
        GroundDistribution {
            weights: odds.map(|of| of / odds.iter().sum::<f64>()),
            sd_m: exp(log_sd, sd_bounds),
            second_m: WithSd {
                value: exp(log_second, second_bounds),
                sd: exp(log_second_sd, second_sd_bounds),
            },
            missed_m: exp(log_missed, missed_bounds),
        }
    }

    /// SD of the ground if it is at the mode, m.
    pub(super) fn sd_m(&self) -> f64 {
        SD_FACTOR * self.sd_m
    }

    /// Root mean square distance of the ground from the mode, m: the SD that includes the choice.
    pub(super) fn total_sd_m(&self) -> f64 {
        let [first, second, missed] = self.weights;
        let WithSd { value, sd } = self.second_m;
        let missed_square = 2.0 * (self.missed_m.powi(3) + ABOVE_M.powi(3)) / (self.missed_m + ABOVE_M);
        (first * self.sd_m().powi(2) + second * (value * value + sd * sd) + missed * missed_square).sqrt()
    }

    /// Probability of a distance below this one.
    fn below(&self, distance_m: f64) -> f64 {
        let normal = |scores: f64| 0.5 * libm::erfc(-scores * std::f64::consts::FRAC_1_SQRT_2);
        let share = self.missed_m / (self.missed_m + ABOVE_M);
        let missed = if distance_m > 0.0 {
            1.0 - share * libm::exp(-distance_m / self.missed_m)
        } else {
            (1.0 - share) * libm::exp(distance_m / ABOVE_M)
        };
        let second = normal((distance_m - self.second_m.value) / self.second_m.sd);
        let parts = [normal(distance_m / self.sd_m), second, missed];
        self.weights.iter().zip(parts).map(|(weight, part)| weight * part).sum()
    }

    /// Half width of the first candidate's range, m.
    fn near_m(&self) -> f64 {
        NEAR_M.max(NEAR_SDS * self.sd_m())
    }

    /// Part of the distribution at the mode, before calibration.
    fn at_mode(&self) -> f64 {
        let near_m = self.near_m();
        (self.below(near_m) - self.below(-near_m)).clamp(0.0, 1.0)
    }

    /// Probability that the mode is the ground.
    pub(super) fn probability(&self) -> f64 {
        let part = self.at_mode().clamp(1e-3, 0.9995);
        let odds = libm::log(part / (1.0 - part));
        let [constant, linear, square] = CALIBRATION;
        1.0 / (1.0 + libm::exp(-(constant + odds * (linear + odds * square))))
    }

    /// Distance of the second candidate below the mode, m, and its probability, outside of the range of the first.
    pub(super) fn second(&self) -> Option<(WithSd, f64)> {
        let half_m = NEAR_M.max(NEAR_SDS * self.second_m.sd);
        let from_m = (self.second_m.value - half_m).max(self.near_m());
        let until_m = (self.second_m.value + half_m).max(from_m);
        let share = (self.below(until_m) - self.below(from_m)) / (1.0 - self.at_mode()).max(1e-6);
        let probability = (1.0 - self.probability()) * share.clamp(0.0, 1.0);
        (probability >= LEAST_SECOND).then_some((self.second_m, probability))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A distribution of these weights, with its second candidate 4 m below the mode.
    fn distribution(weights: [f64; 3]) -> GroundDistribution {
        GroundDistribution { weights, sd_m: 0.1, second_m: WithSd { value: 4.0, sd: 0.5 }, missed_m: 14.0 }
    }

    #[test]
    fn probabilities_are_those_of_the_distribution() {
        let [sure, split, hidden] =
            [[0.98, 0.01, 0.01], [0.5, 0.45, 0.05], [0.02, 0.03, 0.95]].map(distribution);
        assert!(sure.probability() > 0.9 && sure.second().is_none(), "{sure:?} {}", sure.probability());
        let (_, second) = split.second().unwrap();
        assert!((split.probability() - 0.5).abs() < 0.15 && (0.3..0.6).contains(&second));
        assert!(split.probability() + second < 1.0);
        assert!(hidden.probability() < 0.2, "{}", hidden.probability());
    }

    #[test]
    fn the_total_sd_includes_the_choice() {
        let total_m = |weights| distribution(weights).total_sd_m();
        assert!(total_m([1.0, 0.0, 0.0]) < 0.2);
        assert!((total_m([0.5, 0.5, 0.0]) - (0.5f64 * 16.25).sqrt()).abs() < 0.05);
        assert!(total_m([0.5, 0.0, 0.5]) > total_m([0.9, 0.0, 0.1]));
    }

    #[test]
    fn every_distance_has_a_probability() {
        let of = distribution([0.4, 0.4, 0.2]);
        let parts: Vec<f64> = (-400..400).map(|k| of.below(f64::from(k))).collect();
        assert!(parts.is_sorted() && parts[0] < 1e-6 && parts[799] > 1.0 - 1e-6);
    }

    #[test]
    fn nothing_is_extrapolated() {
        let of = GroundDistribution::of(&[1e9; GROUND_FEATURES]);
        assert!((0.0..=1.0).contains(&of.probability()) && of.total_sd_m().is_finite());
    }
}
