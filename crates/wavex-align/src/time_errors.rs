//! Errors that the corrections of trajectories cannot follow: residuals of the same time that share a sign.

use std::collections::BTreeMap;

use rayon::prelude::*;

use crate::matching::Pair;
use crate::normal::{Problem, Weighting};
use crate::parameters::{OFFSETS, TrajectoryModel};
use crate::residual::{gradient, residual};
use crate::survey::State;
use crate::vector::dot;

/// Pairs per parallel step.
const PART: usize = 128;
/// Intervals of a strip whose corrections are constant, or linear.
const INTERVALS: [f64; 2] = [4.0, 6.0];
/// Intervals between two knots.
const INTERVALS_PER_KNOT: f64 = 2.0;
/// Fewest intervals that show errors.
const LEAST_INTERVALS: usize = 6;
/// A ratio is more than chance beyond this many SDs.
const SIGNIFICANT_SDS: f64 = 3.0;

/// Errors that pairs of the same time share, by offset of the trajectory.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimeErrors {
    /// Variance of the sums of residuals over intervals of time, over that of independent residuals: north, east, down,
    /// roll, pitch, heading. 0 for offsets that are kept.
    pub ratios: [f64; OFFSETS],
    /// Number of intervals.
    pub intervals: usize,
    /// Mean length of the intervals, s.
    pub interval_s: f64,
    /// Factor of the variances of all pairs: 1 if the ratios are chance.
    pub factor: f64,
}

/// Sums over an interval.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    gradient: [f64; OFFSETS],
    information: [f64; OFFSETS],
}

impl Problem<'_> {
    /// Length of the intervals of each strip, s; `None` without patches.
    fn intervals_s(&self, model: TrajectoryModel) -> Vec<Option<f64>> {
        let of_span = |[first_s, last_s]: &[f64; 2]| {
            let length_s = last_s - first_s;
            (length_s > 0.0).then(|| match model {
                TrajectoryModel::None | TrajectoryModel::Constant => length_s / INTERVALS[0],
                TrajectoryModel::Linear => length_s / INTERVALS[1],
                TrajectoryModel::Spline(step_s) => length_s.min(step_s) / INTERVALS_PER_KNOT,
            })
        };
        self.spans_s.iter().map(of_span).collect()
    }

    /// Compares sums of the residuals over intervals of time with those of independent residuals.
    ///
    /// The sums are the derivatives of the cost by offsets of the trajectory in the interval: a score test of denser
    /// corrections. With independent residuals their variance is the information on the offset.
    pub(crate) fn time_errors(
        &self,
        state: &State,
        pairs: &[Pair],
        weighting: &Weighting,
        model: TrajectoryModel,
    ) -> TimeErrors {
        let lengths_s = self.intervals_s(model);
        // Strip, interval, and derivatives by its offsets, of both patches.
        type Part = ((u32, u32), [f64; OFFSETS]);
        let of_pair = |pair: &Pair, poses: &mut [_]| -> Option<(f64, f64, [Part; 2])> {
            let [a, b] = pair.patches.map(|patch| &self.survey.patches[patch as usize]);
            let (ends_a, of_a) = self.derivatives(a, state, poses)?;
            let (ends_b, of_b) = self.derivatives(b, state, poses)?;
            let residual_m = residual(&ends_a, &ends_b)?.0;
            let direction = self.survey.horizon.ecef_direction(pair.direction.map(f64::from));
            let by_ends = gradient(&ends_a, &ends_b, direction)?;
            let mut parts = [((0, 0), [0.0; OFFSETS]); 2];
            for (k, (patch, of_beams)) in [(a, of_a), (b, of_b)].into_iter().enumerate() {
                let strip = patch.strip as usize;
                let since_s = patch.beams[0].time_s - self.spans_s[strip][0];
                parts[k].0 = (patch.strip, (since_s / lengths_s[strip]?).max(0.0) as u32);
                for (of_beam, by_end) in of_beams.iter().zip(&by_ends[k]) {
                    for (sum, by) in parts[k].1.iter_mut().zip(&of_beam.offsets) {
                        *sum += dot(*by, *by_end);
                    }
                }
            }
            Some((weighting.weight(pair, residual_m), residual_m, parts))
        };
        let found: Vec<_> = pairs
            .par_chunks(PART)
            .flat_map_iter(|part| {
                let mut poses = self.survey.poses();
                part.iter().filter_map(|pair| of_pair(pair, &mut poses)).collect::<Vec<_>>()
            })
            .collect();
        let mut sums: BTreeMap<(u32, u32), Sums> = BTreeMap::new();
        for (weight, residual_m, parts) in found.into_iter().filter(|(weight, ..)| *weight > 0.0) {
            for (place, derivatives) in parts {
                let own = sums.entry(place).or_default();
                for (offset, by) in derivatives.into_iter().enumerate() {
                    own.gradient[offset] += weight * residual_m * by;
                    own.information[offset] += weight * by * by;
                }
            }
        }
        let is_open = |offset: usize| self.priors.offsets.iter().any(|sds| sds[offset] > 0.0);
        let ratios = core::array::from_fn(|offset| {
            let squares: f64 = sums.values().map(|own| own.gradient[offset].powi(2)).sum();
            let expected: f64 = sums.values().map(|own| own.information[offset]).sum();
            if is_open(offset) && expected > 0.0 { squares / expected } else { 0.0 }
        });
        let lengths_s: Vec<f64> = lengths_s.into_iter().flatten().collect();
        let most = ratios.into_iter().fold(0.0, f64::max);
        let chance = 1.0 + SIGNIFICANT_SDS * (2.0 / sums.len().max(1) as f64).sqrt();
        TimeErrors {
            ratios,
            intervals: sums.len(),
            interval_s: lengths_s.iter().sum::<f64>() / lengths_s.len().max(1) as f64,
            factor: if sums.len() >= LEAST_INTERVALS && most > chance { most } else { 1.0 },
        }
    }
}
