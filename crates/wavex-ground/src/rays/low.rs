//! The lowest surface, as planes through the lowest points of the cells around, and points below it.

use super::objects::{Cells, Objects};
use super::passes::beam_at;
use crate::point::CloudPoint;

/// Smallest width of cells, m; larger where points are sparse.
const CELL_M: f64 = 5.0;
/// Cells around one that give its plane, on each side.
const REACH: i64 = 2;
/// Fewest cells with points of a plane.
const FEWEST_CELLS: usize = 8;
/// A point is below the surface at this many spreads of the lowest points.
const SPREADS: f64 = 4.0;
/// Smallest spread, m.
const LEAST_SPREAD_M: f64 = 0.1;

/// Plane of the lowest points around a cell.
#[derive(Clone, Copy, Debug)]
struct Plane {
    /// Middle of the cell, m.
    middle_m: [f64; 2],
    /// Height in the middle, m.
    height_m: f64,
    slope: [f64; 2],
    /// Spread of the lowest points below the plane, m.
    spread_m: f64,
}

impl Plane {
    fn height_at(&self, x: f64, y: f64) -> f64 {
        self.height_m + self.slope[0] * (x - self.middle_m[0]) + self.slope[1] * (y - self.middle_m[1])
    }
}

/// Planes of all cells with points.
#[derive(Debug)]
pub(super) struct LowSurface {
    cell_m: f64,
    depth_m: f64,
    scale_m: f64,
    planes: Cells<Plane>,
}

/// Height of a point above the lowest surface, m.
#[derive(Clone, Copy, Debug)]
pub(super) struct Offset {
    pub(super) above_m: f64,
    spread_m: f64,
    /// Depth from which a point is below the surface, m.
    depth_m: f64,
}

impl Offset {
    /// Whether the point is clearly below the surface.
    pub(super) fn is_below(self) -> bool {
        self.above_m < -self.depth_m
    }

    /// Whether the point is lower than most of the surface.
    pub(super) fn is_lower(self) -> bool {
        self.above_m < -self.spread_m.max(1.0)
    }

    /// Whether the point is a point of the surface.
    pub(super) fn is_on(self) -> bool {
        (-self.depth_m.min(3.0)..=1.0).contains(&self.above_m)
    }
}

impl LowSurface {
    /// Fits the planes to the lowest accepted points.
    pub(super) fn new(
        points: &[CloudPoint],
        objects: &Objects,
        is_accepted: &[bool],
        depth_m: f64,
    ) -> LowSurface {
        let cell_m = CELL_M.max(3.0 * objects.scale_m);
        let mut lowest: Cells<[f64; 3]> = Cells::default();
        let mut cells: Vec<[i64; 2]> = Vec::new();
        for (at, object) in objects.list.iter().enumerate() {
            for point in objects.points_of(object) {
                let p = points[point].position_m;
                let cell = cell_of(p, cell_m);
                if !is_accepted[at] {
                    cells.push(cell);
                    continue;
                }
                let kept = lowest.entry(key(cell)).or_insert_with(|| {
                    cells.push(cell);
                    p
                });
                // Of equal heights, the first by coordinates: the order of points has no effect.
                if [p[2], p[0], p[1]] < [kept[2], kept[0], kept[1]] {
                    *kept = p;
                }
            }
        }
        cells.sort_unstable();
        cells.dedup();
        let planes = cells.iter().filter_map(|&cell| Some((key(cell), plane(cell, cell_m, &lowest)?)));
        LowSurface { cell_m, depth_m, scale_m: objects.scale_m, planes: planes.collect() }
    }

    /// Height of a point above the lowest surface; `None` without one.
    pub(super) fn offset(&self, position_m: [f64; 3]) -> Option<Offset> {
        let plane = self.plane_at(position_m)?;
        let above_m = position_m[2] - plane.height_at(position_m[0], position_m[1]);
        let spread_m = plane.spread_m;
        Some(Offset { above_m, spread_m, depth_m: self.depth_m.max(SPREADS * plane.spread_m) })
    }

    /// Whether the beam to a point crosses the surface where other beams have met it on all sides.
    pub(super) fn is_crossed_surface(
        &self,
        points: &[CloudPoint],
        objects: &Objects,
        point: &CloudPoint,
    ) -> bool {
        let mut crossing_m = point.position_m;
        for _ in 0..3 {
            let Some(plane) = self.plane_at(crossing_m) else { return false };
            let height_m = plane.height_at(crossing_m[0], crossing_m[1]);
            let [x, y] = beam_at(point, height_m);
            crossing_m = [x, y, height_m];
        }
        let Some(plane) = self.plane_at(crossing_m) else { return false };
        let [x, y, z] = crossing_m;
        let band_m = (1.0 + 1.5 * plane.spread_m).min(10.0);
        // Points of a low cluster are no surface.
        let least_m = -band_m.min(0.5 * self.offset(point.position_m).map_or(0.0, |offset| -offset.above_m));
        let reach_m = (2.5 * self.scale_m).max(1.5);
        let tall_m = band_m + reach_m * (plane.slope[0].abs() + plane.slope[1].abs()).min(3.0);
        let found =
            objects.points_in([x - reach_m, y - reach_m, z - tall_m], [x + reach_m, y + reach_m, z + tall_m]);
        let mut quadrants = 0u32;
        for other in found {
            let [ox, oy, oz] = points[other].position_m;
            let (dx, dy) = (ox - x, oy - y);
            let above_m = oz - plane.height_at(ox, oy);
            if dx * dx + dy * dy <= reach_m * reach_m && (least_m..=band_m).contains(&above_m) {
                quadrants |= 1 << (u32::from(dx > 0.0) * 2 + u32::from(dy > 0.0));
            }
        }
        quadrants == 0b1111
    }

    /// Whether a point is alone below the surface: all points around are above it, on all sides.
    ///
    /// Finds multipath on terraces and in valleys, where planes are less certain than the points near by.
    pub(super) fn is_alone_below(
        &self,
        points: &[CloudPoint],
        objects: &Objects,
        position_m: [f64; 3],
    ) -> bool {
        if !self.offset(position_m).is_some_and(|offset| offset.above_m < -self.depth_m) {
            return false;
        }
        let [x, y, z] = position_m;
        let reach_m = (2.0 * self.scale_m).max(1.5);
        let low_m = [x - reach_m, y - reach_m, z - objects.step_m];
        let high_m = [x + reach_m, y + reach_m, z + 3.0 * objects.step_m];
        let mut quadrants = 0u32;
        let mut n_below = 0;
        for other in objects.points_in(low_m, high_m) {
            let [ox, oy, oz] = points[other].position_m;
            let (dx, dy) = (ox - x, oy - y);
            if dx * dx + dy * dy <= reach_m * reach_m {
                n_below += u32::from(oz < z + 0.8 * self.depth_m);
                quadrants |= 1 << (u32::from(dx > 0.0) * 2 + u32::from(dy > 0.0));
            }
        }
        // The point is one of those that are not above it.
        n_below == 1 && quadrants == 0b1111
    }

    fn plane_at(&self, position_m: [f64; 3]) -> Option<&Plane> {
        self.planes.get(&key(cell_of(position_m, self.cell_m)))
    }
}

/// Plane of the lowest points around a cell, without its own.
///
/// Slopes are medians of the slopes between pairs of cells. The height is the 30 % quantile of the points about
/// these slopes, and the spread is the distance to their 15 % quantile: low clusters cover up to four cells.
fn plane(cell: [i64; 2], cell_m: f64, lowest: &Cells<[f64; 3]>) -> Option<Plane> {
    let around = |(i, j): (i64, i64)| lowest.get(&key([cell[0] + i, cell[1] + j])).copied();
    let offsets = (-REACH..=REACH).flat_map(|i| (-REACH..=REACH).map(move |j| (i, j)));
    let found: Vec<[f64; 3]> = offsets.filter(|&offset| offset != (0, 0)).filter_map(around).collect();
    if found.len() < FEWEST_CELLS {
        return None;
    }
    let middle_m = cell.map(|index| (index as f64 + 0.5) * cell_m);
    let slope = [0, 1].map(|axis| {
        let mut slopes = Vec::new();
        for (at, a) in found.iter().enumerate() {
            for b in &found[at + 1..] {
                let (along_m, across_m) = (b[axis] - a[axis], b[1 - axis] - a[1 - axis]);
                if along_m.abs() > 1.5 * cell_m && across_m.abs() < cell_m {
                    slopes.push((b[2] - a[2]) / along_m);
                }
            }
        }
        quantile(&mut slopes, 0.5).unwrap_or(0.0)
    });
    let mut heights_m: Vec<f64> = found
        .iter()
        .map(|p| p[2] - slope[0] * (p[0] - middle_m[0]) - slope[1] * (p[1] - middle_m[1]))
        .collect();
    let height_m = quantile(&mut heights_m, 0.3)?;
    let spread_m = (height_m - quantile(&mut heights_m, 0.15)?).max(LEAST_SPREAD_M);
    Some(Plane { middle_m, height_m, slope, spread_m })
}

fn quantile(values: &mut [f64], part: f64) -> Option<f64> {
    let at = (part * values.len().checked_sub(1)? as f64).round() as usize;
    Some(*values.select_nth_unstable_by(at, f64::total_cmp).1)
}

fn cell_of(position_m: [f64; 3], cell_m: f64) -> [i64; 2] {
    [0, 1].map(|axis| (position_m[axis] / cell_m).floor() as i64)
}

fn key([i, j]: [i64; 2]) -> u64 {
    (i as u64) << 32 | (j as u64 & 0xffff_ffff)
}
