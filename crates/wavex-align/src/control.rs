//! Control points: known positions on the surface that strips show.

use rayon::prelude::*;
use wavex_geodesy::ellipsoid::WGS84;
use wavex_geodesy::frames::Vector;
use wavex_simd::statistics::median;

use crate::matching::{GroundIndex, Surroundings};
use crate::patch::Horizon;
use crate::survey::{Located, State, Survey};
use crate::vector::{difference, dot};

/// A control point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ControlPoint {
    /// Position in the earth-centred frame of the trajectories, m.
    pub position_in_ecef_m: Vector,
    /// SDs to the east, to the north and of the height, m; above 0.
    pub sd_m: [f64; 3],
    /// Unit normal of the surface: east, north, up at the point. Without it, the normals of the patches are used.
    pub normal: Option<Vector>,
}

/// Difference of a strip from a control point along the normal of the surface: strip minus point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ControlDifference {
    /// Index of the strip.
    pub strip: u32,
    /// Before alignment, m; `None` if the strip had no patch there.
    pub before_m: Option<f64>,
    /// After alignment, m.
    pub after_m: f64,
    /// SD of the difference from point and patch, m.
    pub sd_m: f64,
    /// Whether it was used; otherwise it was rejected as a blunder.
    pub is_used: bool,
}

/// Control points after an alignment.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ControlResult {
    /// Differences of each point; none if no strip has a smooth surface there.
    pub differences: Vec<Vec<ControlDifference>>,
    /// Factor by which the SDs of the differences were enlarged, because half of the points differ by more than they allow.
    pub scale: f64,
    /// Largest horizontal distance between a point and the centre of a patch, m.
    pub search_m: f64,
}

impl ControlResult {
    /// Whether most points differ by more than their SDs and those of the trajectories allow.
    pub fn contradicts(&self) -> bool {
        self.scale > CONTRADICTION
    }
}

/// Scale of the control points above which they contradict the trajectories.
const CONTRADICTION: f64 = 2.0;
/// Part of a cell within which a patch has a control point: half its diagonal, and a little.
const REACH_CELLS: f64 = 0.75;
/// Largest angle between a given normal and that of a patch, rad.
const MOST_TURN_RAD: f64 = 0.15;

/// A control point and the patch of a strip at its place.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ControlPair {
    pub(crate) point: u32,
    pub(crate) patch: u32,
    /// SD of the difference, m.
    pub(crate) sd_m: f64,
    /// SD by which it is weighted, m: the error of the point is common to all strips that show it.
    pub(crate) weighting_sd_m: f64,
    /// Direction of the derivatives, in the earth-centred frame: the normal without its noise.
    pub(crate) direction: Vector,
}

/// Largest horizontal distance between a point and the centre of a patch, m.
pub(crate) fn reach_m(cell_m: f64) -> f64 {
    REACH_CELLS * cell_m
}

/// Control points with the nearest patch of each strip, in the order of points and strips.
pub(crate) fn match_control(
    survey: &Survey<'_>,
    points: &[ControlPoint],
    state: &State,
    cell_m: f64,
) -> Vec<ControlPair> {
    if points.is_empty() {
        return Vec::new();
    }
    let located = survey.locate_all(state);
    let index = GroundIndex::new(&located, reach_m(cell_m));
    let surroundings = Surroundings::new(&located);
    let of_point = |(k, point): (usize, &ControlPoint)| {
        let nearest = nearest(survey, &located, &index, point, reach_m(cell_m));
        let strips = nearest.len() as f64;
        let horizon = Horizon::at(WGS84.geodetic_of(point.position_in_ecef_m));
        let pair = |patch: u32| {
            let about = &survey.patches[patch as usize];
            let at = located[patch as usize].as_ref()?;
            let slope_sd = f64::from(about.slope_sd);
            let direction = match point.normal {
                Some(normal) => horizon.ecef_direction(normal),
                None => {
                    let local = surroundings.denoised(at, at, slope_sd * slope_sd);
                    survey.horizon.ecef_direction(local.map(f64::from))
                }
            };
            let along = horizon.local_direction(direction);
            let of_point: f64 = along.iter().zip(point.sd_m).map(|(part, sd_m)| (part * sd_m).powi(2)).sum();
            let between = difference(at.centre_m(), survey.horizon.local_m(point.position_in_ecef_m));
            let normal = at.normal();
            let across_squared = (dot(between, between) - dot(normal, between).powi(2)).max(0.0);
            // A given normal has no noise, but the patch may differ from it by as much.
            let of_patch = f64::from(about.sd_m).powi(2)
                + f64::from(about.roughness_m).powi(2)
                + across_squared * slope_sd * slope_sd;
            Some(ControlPair {
                point: k as u32,
                patch,
                sd_m: (of_point + of_patch).sqrt(),
                weighting_sd_m: (strips * of_point + of_patch).sqrt(),
                direction,
            })
        };
        nearest.iter().filter_map(|patch| pair(*patch)).collect::<Vec<_>>()
    };
    points.par_iter().enumerate().flat_map_iter(of_point).collect()
}

/// Nearest patch of each strip within reach, in the order of the strips.
fn nearest(
    survey: &Survey<'_>,
    located: &[Option<Located>],
    index: &GroundIndex,
    point: &ControlPoint,
    reach_m: f64,
) -> Vec<u32> {
    let place_m = survey.horizon.local_m(point.position_in_ecef_m);
    let horizon = Horizon::at(WGS84.geodetic_of(point.position_in_ecef_m));
    let given = point.normal.map(|normal| survey.horizon.local_direction(horizon.ecef_direction(normal)));
    // Strip, squared distance, patch.
    let mut best: Vec<(u32, f64, u32)> = Vec::new();
    let at = Located::new(place_m.map(|along_m| along_m as f32), [0.0, 0.0, 1.0]);
    for patch in index.around(&at) {
        let Some(there) = &located[patch as usize] else { continue };
        let [east, north, _] = difference(there.centre_m(), place_m);
        let squared = east * east + north * north;
        let is_other = given.is_some_and(|normal| dot(normal, there.normal()) < MOST_TURN_RAD.cos());
        if squared > reach_m * reach_m || is_other {
            continue;
        }
        let strip = survey.patches[patch as usize].strip;
        match best.iter_mut().find(|(known, ..)| *known == strip) {
            Some(known) if (known.1, known.2) > (squared, patch) => *known = (strip, squared, patch),
            Some(_) => {}
            None => best.push((strip, squared, patch)),
        }
    }
    best.sort_unstable_by_key(|(strip, ..)| *strip);
    best.into_iter().map(|(.., patch)| patch).collect()
}

/// Factor of the SDs of all control points: a robust scale with an allowance for few points, at least 1.
///
/// While the strips are far from all points, it keeps most of them; at the solution it is 1, unless the points contradict
/// the trajectories.
pub(crate) fn scale(pairs: &[ControlPair], residuals: &[Option<f64>]) -> f64 {
    let both: Vec<(u32, f64)> = pairs
        .iter()
        .zip(residuals)
        .filter_map(|(pair, residual)| Some((pair.point, (*residual)?.abs() / pair.sd_m)))
        .collect();
    let of_points =
        both.chunk_by(|a, b| a.0 == b.0).filter_map(|own| median(own.iter().map(|(_, size)| *size)));
    // Of an even number, the lower median: one of two points may be wrong.
    let mut sizes: Vec<f64> = of_points.collect();
    sizes.sort_by(f64::total_cmp);
    let middle = sizes.len().checked_sub(1).map_or(0.0, |last| sizes[last / 2]);
    (0.5 * 1.4826 * middle).max(1.0)
}
