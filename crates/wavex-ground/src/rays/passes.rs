//! Beams that pass through the places of objects.

use rayon::prelude::*;

use super::objects::{Cells, Objects};
use crate::point::CloudPoint;

/// Thickness of a layer of places, m.
const LAYER_M: f64 = 8.0;
/// Most points that stand for an object.
const MOST_PLACES: usize = 256;
/// Width of the cells in which places are looked up, m.
const CELL_M: f64 = 8.0;
/// Beams that are more inclined are not followed: tangent of the angle from the vertical.
const MOST_INCLINED: f64 = 3.0;

/// Beams that ended in an object, and beams that passed through its places.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Evidence {
    pub(super) hits: u32,
    pub(super) passes: u32,
    /// Hits of beams that went on.
    pub(super) partial_hits: u32,
}

/// A representative point of an object.
struct Place {
    position_m: [f64; 3],
    object: usize,
}

/// End of a beam.
struct End {
    position_m: [f64; 3],
    /// Horizontal way of the beam per height.
    inclination: [f64; 2],
    /// Object that it hit; `None` if it ends in an accepted object.
    own: Option<u32>,
    may_go_on: bool,
}

impl End {
    fn new(point: &CloudPoint, own: Option<u32>) -> End {
        let (position_m, inclination) = (point.position_m, inclination(point));
        End { position_m, inclination, own, may_go_on: !point.may_be_last() }
    }

    /// Where the beam is at a height, m.
    fn at(&self, z: f64) -> [f64; 2] {
        [0, 1].map(|axis| self.position_m[axis] + self.inclination[axis] * (z - self.position_m[2]))
    }
}

/// Where a beam is when it is at the height `z`, m; straight up from the point if its beam is not known.
pub(super) fn beam_at(point: &CloudPoint, z: f64) -> [f64; 2] {
    let [x, y, below] = point.position_m;
    let [dx, dy] = inclination(point);
    [x + dx * (z - below), y + dy * (z - below)]
}

/// Horizontal way of a beam per height.
fn inclination(point: &CloudPoint) -> [f64; 2] {
    let [bx, by, bz] = point.beam.map(f64::from);
    let inclination = [bx / bz, by / bz];
    let is_usable = bz < 0.0 && inclination.iter().all(|part| part.abs() <= MOST_INCLINED);
    if is_usable { inclination } else { [0.0; 2] }
}

/// Beams that hit the objects `wanted`, and beams that end in accepted objects below and passed them.
pub(super) fn passes(
    points: &[CloudPoint],
    objects: &Objects,
    wanted: &[usize],
    is_accepted: &[bool],
) -> Vec<Evidence> {
    let mut evidence = vec![Evidence::default(); wanted.len()];
    if wanted.is_empty() {
        return evidence;
    }
    let radius_m = 1.5 * objects.scale_m;
    let mut places: Vec<Place> = Vec::new();
    let mut ends: Vec<End> = Vec::new();
    for (object, &at) in wanted.iter().enumerate() {
        let object_points: Vec<usize> = objects.points_of(&objects.list[at]).collect();
        let step = object_points.len().div_ceil(MOST_PLACES).max(1);
        // By position: the order of points has no effect.
        let mut positions: Vec<[f64; 3]> = object_points.iter().map(|&at| points[at].position_m).collect();
        positions
            .sort_by(|a, b| a[2].total_cmp(&b[2]).then(a[0].total_cmp(&b[0])).then(a[1].total_cmp(&b[1])));
        places.extend(positions.into_iter().step_by(step).map(|position_m| Place { position_m, object }));
        ends.extend(object_points.into_iter().map(|at| End::new(&points[at], Some(object as u32))));
    }
    for (_, object) in objects.list.iter().enumerate().filter(|(at, _)| is_accepted[*at]) {
        let last = objects.points_of(object).map(|at| &points[at]).filter(|point| point.may_be_last());
        ends.extend(last.map(|point| End::new(point, None)));
    }
    places.sort_by(|a, b| a.position_m[2].total_cmp(&b.position_m[2]).then(a.object.cmp(&b.object)));
    let layer = |place: &Place| (place.position_m[2] / LAYER_M).floor();
    let layers: Vec<&[Place]> = places.chunk_by(|a, b| layer(a) == layer(b)).collect();
    let counted: Vec<Vec<(usize, Evidence)>> =
        layers.par_iter().map(|places| in_layer(places, &ends, radius_m)).collect();
    for (object, seen) in counted.into_iter().flatten() {
        evidence[object].hits += seen.hits;
        evidence[object].partial_hits += seen.partial_hits;
        evidence[object].passes += seen.passes.saturating_sub(seen.partial_hits);
    }
    evidence
}

/// Evidence of the beams through the places of a layer.
fn in_layer(places: &[Place], ends: &[End], radius_m: f64) -> Vec<(usize, Evidence)> {
    let middle_m = ((places[0].position_m[2] / LAYER_M).floor() + 0.5) * LAYER_M;
    let mut cells: Cells<Vec<usize>> = Cells::default();
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    for (at, place) in places.iter().enumerate() {
        let [x, y, _] = place.position_m;
        // A beam that is near a place is in its cell or a neighbouring one when it is in the layer's middle,
        // except for strongly inclined beams.
        let reach_m = radius_m + 0.5 * LAYER_M;
        for (axis, at) in [x, y].into_iter().enumerate() {
            low[axis] = low[axis].min(at - reach_m - CELL_M);
            high[axis] = high[axis].max(at + reach_m + CELL_M);
        }
        let index = |x: f64| (x / CELL_M).floor() as i64;
        for i in index(x - reach_m)..=index(x + reach_m) {
            for j in index(y - reach_m)..=index(y + reach_m) {
                cells.entry(cell_key(i, j)).or_default().push(at);
            }
        }
    }
    let mut evidence: Vec<(usize, Evidence)> = Vec::new();
    let mut of_object: Cells<usize> = Cells::default();
    let mut seen: Vec<usize> = Vec::new();
    for end in ends {
        let [x, y] = end.at(middle_m);
        if !((low[0]..high[0]).contains(&x) && (low[1]..high[1]).contains(&y)) {
            continue;
        }
        let Some(near) = cells.get(&cell_key((x / CELL_M).floor() as i64, (y / CELL_M).floor() as i64))
        else {
            continue;
        };
        seen.clear();
        for &at in near {
            let Place { position_m: [px, py, pz], object } = places[at];
            let is_end_below =
                end.own.map_or(end.position_m[2] < pz - radius_m.max(1.0), |own| own as usize == object);
            let [bx, by] = end.at(pz);
            let is_near = (bx - px) * (bx - px) + (by - py) * (by - py) <= radius_m * radius_m;
            if is_end_below && is_near && !seen.contains(&object) {
                seen.push(object);
                let at = *of_object.entry(object as u64).or_insert_with(|| {
                    evidence.push((object, Evidence::default()));
                    evidence.len() - 1
                });
                let counts = &mut evidence[at].1;
                // The last return of a shot that hit the object is among the passes.
                match end.own {
                    Some(_) => {
                        counts.hits += 1;
                        counts.partial_hits += u32::from(end.may_go_on);
                    }
                    None => counts.passes += 1,
                }
            }
        }
    }
    evidence
}

fn cell_key(i: i64, j: i64) -> u64 {
    (i as u64) << 32 | (j as u64 & 0xffff_ffff)
}
