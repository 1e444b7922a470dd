//! Pairs of an adjustment as results: place, differences, use.

use rayon::prelude::*;
use wavex_geodesy::frames::Vector;

use crate::matching::Pair;
use crate::normal::{Problem, Weighting};
use crate::residual::{centre, normal, residual};
use crate::survey::State;
use crate::vector::{length, scaled, sum};

/// Pairs per parallel step.
const PART: usize = 128;

/// Difference of two strips at one place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observation {
    /// Indices of the strips, the lower one first.
    pub strips: [u32; 2],
    /// Middle between the centres of both patches, earth-centred frame, m.
    pub place_in_ecef_m: Vector,
    /// Mean of the normals of both patches, unit vector in the earth-centred frame, upwards.
    pub normal_in_ecef: Vector,
    /// Mean times of the beams of each patch on the axis of its trajectory, without the time offset, s.
    pub times_s: [f64; 2],
    /// First strip minus second along the normal, with the start values, m; `None` without a pose.
    pub before_m: Option<f64>,
    /// The same with the results, m.
    pub after_m: f64,
    /// Stated SD of the difference, m.
    pub sd_m: f64,
    /// Whether it was used; otherwise it was rejected.
    pub is_used: bool,
}

/// Observations of pairs at a solution, in the order of the pairs; pairs without a pose are left out.
pub(crate) fn observations(
    problem: &Problem<'_>,
    state: &State,
    pairs: &[Pair],
    weighting: &Weighting,
) -> Vec<Observation> {
    let survey = problem.survey;
    let of_part = |part: &[Pair]| {
        let mut poses = survey.poses();
        let of = |pair: &Pair| {
            let patches = pair.patches.map(|patch| &survey.patches[patch as usize]);
            let [a, b] = patches;
            let mut ends = |state: &State| {
                Some((survey.ends(a, state, &mut poses)?, survey.ends(b, state, &mut poses)?))
            };
            let (ends_a, ends_b) = ends(state)?;
            let before = ends(&problem.start);
            let after_m = residual(&ends_a, &ends_b)?.0;
            let along = sum(normal(&ends_a)?, normal(&ends_b)?);
            Some(Observation {
                strips: patches.map(|patch| patch.strip),
                place_in_ecef_m: scaled(sum(centre(&ends_a), centre(&ends_b)), 0.5),
                normal_in_ecef: scaled(along, 1.0 / length(along)),
                times_s: patches.map(|patch| patch.beams.iter().map(|beam| beam.time_s).sum::<f64>() / 3.0),
                before_m: before.and_then(|(a, b)| Some(residual(&a, &b)?.0)),
                after_m,
                sd_m: pair.sd_m,
                is_used: weighting.weight(pair, after_m) > 0.0,
            })
        };
        part.iter().filter_map(of).collect::<Vec<_>>()
    };
    pairs.par_chunks(PART).flat_map_iter(of_part).collect()
}
