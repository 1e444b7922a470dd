//! Range walk: delay of a receiver that depends on the amplitude of the echo.
//!
//! It is learnt from geometry alone. Three neighbouring single echoes on a smooth surface have a
//! small second difference of their times of flight; if their amplitudes differ, the walk enters it
//! with known factors. A cubic in the logarithm of the amplitude is fitted to the second differences
//! of a recording (docs/explanation/corrections.md, Range walk).

use nalgebra::{Matrix3, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Fewest triples to learn from.
pub const LEAST_TRIPLES: usize = 1000;
/// Distance in shots within which other triples show the roughness of the surface; triples closer
/// than the first share echoes with the triple itself.
const NEIGHBOURS: std::ops::RangeInclusive<u64> = 3..=12;
/// Fewest neighbours that show the roughness.
const LEAST_NEIGHBOURS: usize = 5;
/// Tukey's biweight is zero beyond this many standard deviations.
const REACH_SD: f64 = 4.0;
/// Number of passes of the robust fit, and every how many of them the roughness is measured again.
const PASSES: usize = 15;
const ROUGHNESS_EVERY: usize = 5;
/// Number of consecutive parts of the recording, of which the jackknife leaves out one at a time.
const PARTS: usize = 40;
/// Part of the amplitudes beyond which the walk stays constant, at either end.
const BEYOND_PART: f64 = 0.001;
/// Largest `T²` of the difference of both halves: exceeded by chance in 1 of 100 recordings.
///
/// Hotelling's distribution of 3 coefficients with a covariance of 39 degrees of freedom.
const MOST_DIFFERENCE: f64 = 13.8;
/// Smallest `T²` of a walk: exceeded by chance in 1 of 1000 recordings.
const LEAST_WALK: f64 = 21.2;
/// Largest plausible delay, ns (150 m).
const MOST_DELAY_NS: f64 = 1000.0;
/// Standard deviation of a normal distribution over its median absolute deviation.
const SD_OF_MEDIAN: f64 = 1.4826;

/// Delay of a receiver by amplitude: a cubic in `t = ln(amplitude / reference_dn)`.
///
/// The delay is zero at the reference amplitude, and constant beyond the amplitudes from which it
/// was learnt.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RangeWalk {
    /// Amplitude without delay, DN; positive.
    pub reference_dn: f64,
    /// Smallest and largest amplitude of the cubic, DN; positive.
    pub amplitudes_dn: [f64; 2],
    /// Coefficients of `t`, `t²` and `t³`, ns.
    pub coefficients_ns: [f64; 3],
    /// Covariance of the coefficients, ns².
    pub covariance_ns2: [[f64; 3]; 3],
    /// Number of triples of echoes from which it was learnt.
    pub triples: u64,
}

/// A single echo.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SingleEcho {
    /// Time of flight, ns, and its standard deviation.
    pub flight_ns: f64,
    /// Standard deviation of `flight_ns`.
    pub flight_sd_ns: f64,
    /// Amplitude in the receiver, DN; positive.
    pub amplitude_dn: f64,
}

/// Single echoes of three consecutive shots.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Triple {
    /// The echoes in the order of the shots.
    pub echoes: [SingleEcho; 3],
    /// Number of the middle shot; consecutive along a scan line, and at least 100 apart between lines.
    pub shot: u64,
}

/// Reason why there is no walk.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum NoWalk {
    /// The recording has too few triples of single echoes.
    #[error("{0} triples of neighbouring single echoes, {LEAST_TRIPLES} needed")]
    TooFew(usize),
    /// The echoes have one amplitude, so that nothing determines the walk.
    #[error("the amplitudes of neighbouring single echoes do not differ enough")]
    OneAmplitude,
    /// Both halves of the recording differ by more than chance.
    #[error("both halves of the recording differ: T² {0:.1}, at most {MOST_DIFFERENCE} by chance")]
    HalvesDiffer(f64),
    /// No walk is visible.
    #[error("no walk is visible: T² {0:.1}, at least {LEAST_WALK} needed")]
    Insignificant(f64),
}

impl RangeWalk {
    /// Delay of an echo of this amplitude, ns, and its standard deviation; 0 if it is not positive.
    pub fn late_ns(&self, amplitude_dn: f64) -> (f64, f64) {
        let Some(powers) = self.powers(amplitude_dn) else { return (0.0, 0.0) };
        let late = powers.dot(&Vector3::from(self.coefficients_ns));
        (late, self.variance_ns2(powers).max(0.0).sqrt())
    }

    /// Change of the delay with the amplitude, ns/DN; 0 beyond the amplitudes of the cubic.
    pub fn slope_ns_per_dn(&self, amplitude_dn: f64) -> f64 {
        let [least, most] = self.amplitudes_dn;
        if !(least..=most).contains(&amplitude_dn) {
            return 0.0;
        }
        let t = (amplitude_dn / self.reference_dn).ln();
        let [a, b, c] = self.coefficients_ns;
        (a + t * (2.0 * b + t * 3.0 * c)) / amplitude_dn
    }

    /// Whether all numbers are usable.
    pub fn is_valid(&self) -> bool {
        let [least, most] = self.amplitudes_dn;
        let numbers = self.coefficients_ns.iter().chain(self.covariance_ns2.iter().flatten());
        let positive = [self.reference_dn, least, most].iter().all(|dn| *dn > 0.0 && dn.is_finite());
        let is_delay = |dn: &f64| self.late_ns(*dn).0.abs() <= MOST_DELAY_NS;
        let is_known = positive && least <= most && numbers.copied().all(f64::is_finite);
        is_known && self.amplitudes_dn.iter().all(is_delay)
    }

    /// Learns the walk of a receiver from triples in the order of the recording.
    ///
    /// # Errors
    /// [`NoWalk`] says what the recording lacks.
    pub fn learn(triples: &[Triple]) -> Result<RangeWalk, NoWalk> {
        let is_usable = |echo: &SingleEcho| {
            echo.flight_ns.is_finite() && echo.flight_sd_ns.is_finite() && echo.amplitude_dn > 0.0
        };
        let triples: Vec<Triple> =
            triples.iter().filter(|triple| triple.echoes.iter().all(is_usable)).copied().collect();
        if triples.len() < LEAST_TRIPLES {
            return Err(NoWalk::TooFew(triples.len()));
        }
        let mut amplitudes_dn: Vec<f64> =
            triples.iter().map(|triple| triple.echoes[1].amplitude_dn).collect();
        amplitudes_dn.sort_by(f64::total_cmp);
        let at = |part: f64| amplitudes_dn[(part * (amplitudes_dn.len() - 1) as f64) as usize];
        let mut walk = RangeWalk {
            reference_dn: at(0.5),
            amplitudes_dn: [at(BEYOND_PART), at(1.0 - BEYOND_PART)],
            coefficients_ns: [0.0; 3],
            covariance_ns2: [[0.0; 3]; 3],
            triples: triples.len() as u64,
        };
        let rows: Vec<Row> = triples.iter().filter_map(|triple| Row::of(triple, &walk)).collect();
        let RobustFit { parts, variance_factor } = robust_fit(&rows).ok_or(NoWalk::OneAmplitude)?;
        let all = parts.iter().fold(NormalEquations::default(), |sum, part| sum.plus(part, 1.0));
        let solve = |equations: NormalEquations| equations.solve().ok_or(NoWalk::OneAmplitude);
        let coefficients = solve(all)?;
        let mut covariance = Matrix3::zeros();
        for part in &parts {
            let difference = solve(all.plus(part, -1.0))? - coefficients;
            covariance += difference * difference.transpose();
        }
        covariance *= variance_factor * (PARTS - 1) as f64 / PARTS as f64;
        let [first, second] = [&parts[..PARTS / 2], &parts[PARTS / 2..]]
            .map(|half| half.iter().fold(NormalEquations::default(), |sum, part| sum.plus(part, 1.0)));
        // Either half has twice the variance of the whole.
        let inverse = covariance.try_inverse().ok_or(NoWalk::OneAmplitude)?;
        let difference = solve(first)? - solve(second)?;
        let of_halves = (difference.transpose() * inverse * difference)[0] / 4.0;
        if of_halves.is_nan() || of_halves > MOST_DIFFERENCE {
            return Err(NoWalk::HalvesDiffer(of_halves));
        }
        let of_walk = (coefficients.transpose() * inverse * coefficients)[0];
        if of_walk < LEAST_WALK {
            return Err(NoWalk::Insignificant(of_walk));
        }
        walk.coefficients_ns = coefficients.into();
        walk.covariance_ns2 = covariance.into();
        Ok(walk)
    }

    /// `t`, `t²`, `t³` of an amplitude.
    fn powers(&self, amplitude_dn: f64) -> Option<Vector3<f64>> {
        let [least, most] = self.amplitudes_dn;
        let is_positive = amplitude_dn > 0.0;
        let t = (amplitude_dn.max(least).min(most) / self.reference_dn).ln();
        is_positive.then(|| Vector3::new(t, t * t, t * t * t))
    }

    fn variance_ns2(&self, powers: Vector3<f64>) -> f64 {
        (powers.transpose() * Matrix3::from(self.covariance_ns2) * powers)[0]
    }
}

/// Equation of one triple.
struct Row {
    shot: u64,
    /// Second difference of the times of flight, ns, and its SD by noise.
    difference_ns: f64,
    noise_ns: f64,
    /// Second difference of the powers of `t`.
    powers: Vector3<f64>,
}

impl Row {
    fn of(triple: &Triple, walk: &RangeWalk) -> Option<Row> {
        let [a, b, c] = triple.echoes;
        let [x, y, z] =
            [walk.powers(a.amplitude_dn)?, walk.powers(b.amplitude_dn)?, walk.powers(c.amplitude_dn)?];
        let noise_ns2 = a.flight_sd_ns.powi(2) + 4.0 * b.flight_sd_ns.powi(2) + c.flight_sd_ns.powi(2);
        Some(Row {
            shot: triple.shot,
            difference_ns: a.flight_ns - 2.0 * b.flight_ns + c.flight_ns,
            noise_ns: noise_ns2.sqrt(),
            powers: x - 2.0 * y + z,
        })
    }
}

/// Sums of weighted equations.
#[derive(Clone, Copy, Default)]
struct NormalEquations {
    matrix: Matrix3<f64>,
    right: Vector3<f64>,
}

impl NormalEquations {
    fn add(&mut self, row: &Row, weight: f64) {
        self.matrix += weight * row.powers * row.powers.transpose();
        self.right += weight * row.difference_ns * row.powers;
    }

    fn plus(self, other: &NormalEquations, sign: f64) -> NormalEquations {
        NormalEquations { matrix: self.matrix + sign * other.matrix, right: self.right + sign * other.right }
    }

    fn solve(&self) -> Option<Vector3<f64>> {
        let solution = self.matrix.cholesky()?.solve(&self.right);
        solution.iter().all(|value| value.is_finite()).then_some(solution)
    }
}

/// Result of the robust fit.
struct RobustFit {
    /// Sums of the equations of each part of the recording, with their final weights.
    parts: Vec<NormalEquations>,
    /// Variance over that with fixed weights, because the weights follow the residuals (P. J. Huber,
    /// Robust Statistics, 1981, section 7.6).
    variance_factor: f64,
}

fn robust_fit(rows: &[Row]) -> Option<RobustFit> {
    let mut coefficients = Vector3::zeros();
    let mut sds_ns = Vec::new();
    let mut parts = vec![NormalEquations::default(); PARTS];
    let (mut weights, mut slopes) = (0.0, 0.0);
    for pass in 0..PASSES {
        let residuals_ns: Vec<f64> =
            rows.iter().map(|row| row.difference_ns - row.powers.dot(&coefficients)).collect();
        if pass.is_multiple_of(ROUGHNESS_EVERY) {
            sds_ns = roughness_ns(rows, &residuals_ns);
        }
        parts.fill(NormalEquations::default());
        (weights, slopes) = (0.0, 0.0);
        for (i, ((row, residual_ns), sd_ns)) in rows.iter().zip(&residuals_ns).zip(&sds_ns).enumerate() {
            let u = residual_ns / (REACH_SD * sd_ns);
            if sd_ns.is_finite() && u.abs() < 1.0 {
                weights += (1.0 - u * u).powi(2);
                slopes += (1.0 - u * u) * (1.0 - 5.0 * u * u);
                parts[i * PARTS / rows.len()].add(row, ((1.0 - u * u) / sd_ns).powi(2));
            }
        }
        let all = parts.iter().fold(NormalEquations::default(), |sum, part| sum.plus(part, 1.0));
        coefficients = all.solve()?;
    }
    Some(RobustFit { parts, variance_factor: (weights / slopes.max(0.1 * weights)).powi(2) })
}

/// SD of the second difference of every row, from its neighbours and its noise, ns.
///
/// Infinite if there are too few neighbours.
fn roughness_ns(rows: &[Row], residuals_ns: &[f64]) -> Vec<f64> {
    let mut first = 0;
    let mut near_ns = Vec::new();
    let sd_ns = |(i, row): (usize, &Row)| {
        while row.shot.abs_diff(rows[first].shot) > *NEIGHBOURS.end() && first < i {
            first += 1;
        }
        near_ns.clear();
        for (other, residual_ns) in rows[first..].iter().zip(&residuals_ns[first..]) {
            let distance = other.shot.abs_diff(row.shot);
            if NEIGHBOURS.contains(&distance) {
                near_ns.push(residual_ns.abs());
            } else if other.shot > row.shot && distance > *NEIGHBOURS.end() {
                break;
            }
        }
        if near_ns.len() < LEAST_NEIGHBOURS {
            return f64::INFINITY;
        }
        let middle = near_ns.len() / 2;
        let (_, median_ns, _) = near_ns.select_nth_unstable_by(middle, f64::total_cmp);
        (SD_OF_MEDIAN * *median_ns).hypot(row.noise_ns)
    };
    rows.iter().enumerate().map(sd_ns).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulated::Random;

    /// Delay of the simulated receiver, ns.
    fn truth_ns(amplitude_dn: f64) -> f64 {
        let t = (amplitude_dn / 160.0).ln();
        -0.08 * t - 0.05 * t * t
    }

    /// Lines of 200 shots over a rough surface with patches of different reflectance.
    fn recording(seed: u64, lines: usize, late_ns: impl Fn(f64) -> f64) -> Vec<Triple> {
        let mut random = Random::new(seed);
        let mut triples = Vec::new();
        for line in 0..lines {
            let (mut height_ns, mut slope_ns, mut patch_dn) = (0.0, 0.0, 120.0);
            let mut echoes = Vec::new();
            for shot in 0..200 {
                slope_ns += 0.03 * random.normal();
                height_ns += slope_ns + if shot == 90 { 20.0 } else { 0.0 };
                if shot % 7 == 0 {
                    patch_dn = (120.0 + 40.0 * random.normal()).clamp(30.0, 200.0);
                }
                let amplitude_dn = patch_dn + 8.0 * random.normal();
                let noise_ns = 0.015 * random.normal() + 0.05 * random.normal();
                let flight_ns = 5000.0 + height_ns + noise_ns + late_ns(amplitude_dn);
                echoes.push(SingleEcho { flight_ns, flight_sd_ns: 0.015, amplitude_dn });
            }
            let of_line = echoes.windows(3).enumerate();
            triples.extend(of_line.map(|(i, echoes)| Triple {
                echoes: [echoes[0], echoes[1], echoes[2]],
                shot: (1000 * line + i) as u64,
            }));
        }
        triples
    }

    #[test]
    fn a_walk_is_found_within_its_uncertainty() {
        let mut squares = Vec::new();
        for seed in 0..20 {
            let walk = RangeWalk::learn(&recording(seed, 60, truth_ns)).unwrap();
            for amplitude_dn in [60.0, 90.0, 160.0, 190.0] {
                let (late_ns, sd_ns) = walk.late_ns(amplitude_dn);
                let true_ns = truth_ns(amplitude_dn) - truth_ns(walk.reference_dn);
                assert!((late_ns - true_ns).abs() < 0.03, "{amplitude_dn} DN: {late_ns} {true_ns} {sd_ns}");
                squares.push(((late_ns - true_ns) / sd_ns).powi(2));
            }
        }
        let rms = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
        assert!((0.7..1.4).contains(&rms), "{rms}");
    }

    #[test]
    fn no_walk_is_learnt_where_there_is_none() {
        let found = (0..40).filter(|seed| RangeWalk::learn(&recording(*seed, 20, |_| 0.0)).is_ok()).count();
        assert!(found <= 1, "{found} of 40");
        let few = recording(1, 4, truth_ns);
        assert_eq!(RangeWalk::learn(&few), Err(NoWalk::TooFew(few.len())));
        let mut equal = recording(1, 20, truth_ns);
        equal.iter_mut().flat_map(|triple| &mut triple.echoes).for_each(|echo| echo.amplitude_dn = 100.0);
        assert_eq!(RangeWalk::learn(&equal), Err(NoWalk::OneAmplitude));
    }

    #[test]
    fn a_receiver_that_changes_is_not_believed() {
        let mut changing = recording(3, 40, truth_ns);
        changing.extend(recording(4, 40, |dn| -truth_ns(dn)));
        assert!(matches!(RangeWalk::learn(&changing), Err(NoWalk::HalvesDiffer(_))));
    }

    #[test]
    fn the_slope_is_the_derivative_and_the_ends_are_constant() {
        let walk = RangeWalk::learn(&recording(7, 60, truth_ns)).unwrap();
        let numeric = (walk.late_ns(100.01).0 - walk.late_ns(99.99).0) / 0.02;
        assert!((walk.slope_ns_per_dn(100.0) - numeric).abs() < 1e-7);
        assert_eq!(walk.late_ns(walk.amplitudes_dn[1]), walk.late_ns(5000.0));
        assert_eq!((walk.slope_ns_per_dn(5000.0), walk.late_ns(f64::NAN)), (0.0, (0.0, 0.0)));
        assert_eq!(walk.late_ns(walk.reference_dn), (0.0, 0.0));
        assert!(walk.is_valid());
        assert!(!RangeWalk { reference_dn: 0.0, ..walk }.is_valid());
        assert!(!RangeWalk { coefficients_ns: [1e9; 3], ..walk }.is_valid());
    }
}
