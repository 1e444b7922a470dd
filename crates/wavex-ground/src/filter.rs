//! Ground classification of points.

mod growth;
mod local_plane;
mod low;
mod opening;
mod raster;
mod surface;

use std::collections::{BTreeMap, BTreeSet};

use rayon::prelude::*;

use crate::point::{Class, CloudPoint};
use raster::{Grid, lowest};

/// Edge of the tiles that are classified one by one, m. Tiles begin at multiples of it.
pub const TILE_M: f64 = 512.0;

/// Settings of the ground classification. The default is one set for city, mountain and forest.
#[derive(Clone, Debug, PartialEq)]
pub struct GroundSettings {
    /// Cell of the raster of lowest points, m; coarser for sparse points. At least [`SMALLEST_CELL_M`].
    pub cell_m: f64,
    /// Half of the width of pits that are outliers, m.
    pub low_radii_m: [f64; 2],
    /// Depth of such a pit divided by half of its width.
    pub low_slope: f64,
    /// Half of the width of the widest object, m; at most a third of [`OVERLAP_M`].
    pub largest_radius_m: f64,
    /// An opening with windows of half width `r` removes what it lowers by more than `step_m + step_slope r`.
    pub step_m: f64,
    /// See `step_m`.
    pub step_slope: f64,
    /// Passes of the growth of the ground.
    pub growth_passes: usize,
    /// Largest height of ground above the plane around it, m, besides the plane's RMS.
    pub plane_m: f64,
    /// Addition to `plane_m` on a slope of 1 (45 degrees), m.
    pub plane_slope_m: f64,
    /// Largest height of ground above or below the plane on one side of it, m.
    pub side_m: f64,
    /// Addition to `side_m`, as a multiple of that plane's RMS.
    pub side_roughness: f64,
    /// Largest height of ground points above the final surface, m.
    pub threshold_m: f64,
    /// Addition to `threshold_m` on a slope of 1, m.
    pub slope_threshold_m: f64,
}

impl Default for GroundSettings {
    fn default() -> GroundSettings {
        GroundSettings {
            cell_m: 1.0,
            low_radii_m: [1.0, 4.0],
            low_slope: 5.0,
            largest_radius_m: 40.0,
            step_m: 0.2,
            step_slope: 0.1,
            growth_passes: 5,
            plane_m: 0.3,
            plane_slope_m: 0.3,
            side_m: 0.2,
            side_roughness: 0.4,
            threshold_m: 0.3,
            slope_threshold_m: 0.9,
        }
    }
}

/// Smallest cell that is used, m.
pub const SMALLEST_CELL_M: f64 = 0.1;

/// Distance beyond the edge of a tile up to which points take part in its classification, m.
pub const OVERLAP_M: f64 = 100.0;

/// Farthest position that is classified, m: cells beyond it have no exact coordinates.
const FARTHEST_M: f64 = 1e9;

/// Occupied area is measured with squares of this edge, m.
const AREA_SQUARE_M: f64 = 32.0;

/// Largest number of cells for each point on occupied area.
const CELLS_PER_POINT: f64 = 16.0;

/// Classifies points as [`Class::Ground`] or [`Class::Unclassified`].
///
/// Each tile of [`TILE_M`] is classified with the points within [`OVERLAP_M`] of it, so memory does not depend on the
/// extent. The result does not depend on the order of points or on threads. Points whose coordinates are not finite, or
/// farther than 1e9 m from the origin, are unclassified.
pub fn classify_ground(points: &[CloudPoint], settings: &GroundSettings) -> Vec<Class> {
    let mut tiles: BTreeMap<[i64; 2], Vec<usize>> = BTreeMap::new();
    for (index, point) in points.iter().enumerate() {
        let position = point.position_m;
        if position.iter().all(|value| value.abs() <= FARTHEST_M) {
            let tile = [0, 1].map(|axis| (position[axis] / TILE_M).floor() as i64);
            tiles.entry(tile).or_default().push(index);
        }
    }
    let tiles = &tiles;
    let grounds: Vec<Vec<usize>> =
        tiles.par_iter().map(|(&tile, inner)| ground_of_tile(points, tiles, tile, inner, settings)).collect();
    let mut classes = vec![Class::Unclassified; points.len()];
    for index in grounds.into_iter().flatten() {
        classes[index] = Class::Ground;
    }
    classes
}

/// Indices of the ground points of a tile.
fn ground_of_tile(
    points: &[CloudPoint],
    tiles: &BTreeMap<[i64; 2], Vec<usize>>,
    tile: [i64; 2],
    inner: &[usize],
    settings: &GroundSettings,
) -> Vec<usize> {
    let mut members = inner.to_vec();
    let lower = tile.map(|index| index as f64 * TILE_M - OVERLAP_M);
    let upper = tile.map(|index| (index + 1) as f64 * TILE_M + OVERLAP_M);
    for (east, north) in [-1, 0, 1].into_iter().flat_map(|east| [-1, 0, 1].map(|north| (east, north))) {
        if (east, north) == (0, 0) {
            continue;
        }
        let Some(neighbour) = tiles.get(&[tile[0] + east, tile[1] + north]) else { continue };
        members.extend(neighbour.iter().filter(|&&index| {
            let position = points[index].position_m;
            (0..2).all(|axis| position[axis] >= lower[axis] && position[axis] <= upper[axis])
        }));
    }
    let members: Vec<CloudPoint> = members.iter().map(|&index| points[index]).collect();
    let mut is_ground = ground(&members, settings);
    is_ground.truncate(inner.len());
    inner.iter().zip(is_ground).filter(|&(_, is_ground)| is_ground).map(|(&index, _)| index).collect()
}

/// Grid of a tile, whose cells are coarser for sparse points.
fn grid(positions_m: &[[f64; 3]], settings: &GroundSettings) -> Grid {
    let (mut min_m, mut max_m) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    let mut squares = BTreeSet::new();
    for position in positions_m {
        for axis in 0..2 {
            min_m[axis] = min_m[axis].min(position[axis]);
            max_m[axis] = max_m[axis].max(position[axis]);
        }
        squares.insert([0, 1].map(|axis| (position[axis] / AREA_SQUARE_M).floor() as i64));
    }
    let area_m2 = squares.len() as f64 * AREA_SQUARE_M * AREA_SQUARE_M;
    let mut cell_m = settings.cell_m.max(SMALLEST_CELL_M);
    while area_m2 / (cell_m * cell_m) > CELLS_PER_POINT * positions_m.len() as f64 {
        cell_m *= 2.0;
    }
    Grid::covering(min_m, max_m, cell_m)
}

/// Whether each point of a tile is ground.
fn ground(points: &[CloudPoint], settings: &GroundSettings) -> Vec<bool> {
    let positions_m: Vec<[f64; 3]> = points.iter().map(|point| point.position_m).collect();
    let grid = grid(&positions_m, settings);
    let is_low = low::below_ground(&grid, &positions_m, settings);
    let cells = lowest(&grid, &positions_m, |point| !is_low[point] && points[point].may_be_last());
    let mut is_ground = opening::bare_cells(&grid, &positions_m, &cells, settings);
    growth::grow(&grid, &positions_m, &cells, &mut is_ground, settings);
    let known: Vec<f64> = cells
        .iter()
        .zip(&is_ground)
        .map(|(&point, &is_ground)| if is_ground { positions_m[point][2] } else { f64::NAN })
        .collect();
    let surface = surface::fill(grid.columns, grid.rows, &known);
    let slopes = surface::slopes(&grid, &surface);
    points
        .iter()
        .zip(is_low)
        .map(|(point, is_low)| {
            let [x, y, z] = point.position_m;
            let height_m = z - grid.interpolate(&surface, x, y);
            let limit_m = settings.threshold_m + settings.slope_threshold_m * grid.interpolate(&slopes, x, y);
            !is_low && point.may_be_last() && height_m.abs() <= limit_m
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn box_on_a_plane_is_no_ground() {
        let mut points = Vec::new();
        for index in 0..10_000u32 {
            let (x, y) = (f64::from(index % 100), f64::from(index / 100));
            let is_roof = (40.0..60.0).contains(&x) && (40.0..60.0).contains(&y);
            points.push((CloudPoint::at([x, y, if is_roof { 8.0 } else { 0.02 * x }]), is_roof));
        }
        let cloud: Vec<CloudPoint> = points.iter().map(|&(point, _)| point).collect();
        let classes = classify_ground(&cloud, &GroundSettings::default());
        for ((_, is_roof), class) in points.iter().zip(classes) {
            assert_eq!(class == Class::Ground, !is_roof);
        }
    }
}
