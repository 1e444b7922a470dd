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
            side_roughness: 0.8,
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
    use proptest::prelude::*;

    /// Points 1 m apart, shifted within their cells by a fixed pattern, whose heights `height` gives.
    fn scene(edge: u32, height: impl Fn(f64, f64) -> (f64, bool)) -> (Vec<CloudPoint>, Vec<bool>) {
        (0..edge * edge)
            .map(|index| {
                let shift = |factor: u32| f64::from(index.wrapping_mul(factor) >> 16 & 255) / 256.0;
                let (x, y) =
                    (f64::from(index % edge) + shift(40503), f64::from(index / edge) + shift(2654435761));
                let (z, is_ground) = height(x, y);
                (CloudPoint::at([x, y, z]), is_ground)
            })
            .unzip()
    }

    fn is_ground(points: &[CloudPoint]) -> Vec<bool> {
        classify_ground(points, &GroundSettings::default())
            .into_iter()
            .map(|class| class == Class::Ground)
            .collect()
    }

    /// Share of points that are classified wrongly.
    fn error(points: &[CloudPoint], truth: &[bool]) -> f64 {
        let wrong = is_ground(points).iter().zip(truth).filter(|(found, truth)| found != truth).count();
        wrong as f64 / truth.len() as f64
    }

    #[test]
    fn buildings_on_a_slope_are_no_ground() {
        let (points, truth) = scene(160, |x, y| {
            let is_roof = (50.0..70.0).contains(&x) && (50.0..70.0).contains(&y);
            (0.3 * x + if is_roof { 12.0 } else { 0.0 }, !is_roof)
        });
        assert!(error(&points, &truth) < 0.005, "{}", error(&points, &truth));
    }

    #[test]
    fn buildings_of_75_m_are_no_ground() {
        let (points, truth) = scene(220, |x, y| {
            let is_roof = (70.0..145.0).contains(&x) && (70.0..145.0).contains(&y);
            (if is_roof { 15.0 } else { 0.0 }, !is_roof)
        });
        assert!(error(&points, &truth) < 0.005, "{}", error(&points, &truth));
    }

    #[test]
    fn slopes_of_45_degrees_and_terraces_are_ground() {
        let (points, truth) = scene(120, |x, _| (if x < 60.0 { x } else { 68.0 }, true));
        assert!(error(&points, &truth) < 0.02, "{}", error(&points, &truth));
    }

    #[test]
    fn points_far_below_do_not_pull_the_ground_down() {
        let (mut points, mut truth) = scene(100, |x, y| (0.1 * x + 0.05 * y, true));
        for index in 0..10 {
            let x = 8.0 + 9.0 * f64::from(index);
            points.push(CloudPoint::at([x, 50.0, -500.0]));
            points.push(CloudPoint::at([x, 51.0, -12.0]));
            truth.extend([false; 2]);
        }
        assert_eq!(error(&points, &truth), 0.0);
    }

    #[test]
    fn returns_before_the_last_are_no_ground() {
        let mut first = CloudPoint::at([10.5, 10.5, 0.0]);
        (first.return_number, first.n_returns) = (1, 2);
        let (mut points, _) = scene(20, |_, _| (0.0, true));
        points.push(first);
        assert_eq!(is_ground(&points).pop(), Some(false));
    }

    #[test]
    fn islands_are_classified_without_a_raster_over_the_gap() {
        let (mut points, truth) = scene(60, |x, _| (0.1 * x, true));
        let far: Vec<CloudPoint> = points
            .iter()
            .map(|point| CloudPoint {
                position_m: [point.position_m[0] + 1e6, point.position_m[1], 9.0],
                ..*point
            })
            .collect();
        points.extend(far);
        assert_eq!(error(&points, &[truth.clone(), truth].concat()), 0.0);
    }

    #[test]
    fn sparse_points_get_coarse_cells() {
        let positions = [[0.0, 0.0, 0.0], [700.0, 700.0, 0.0]];
        assert!(super::grid(&positions, &GroundSettings::default()).len() < 20_000);
    }

    #[test]
    fn unusable_coordinates_are_unclassified() {
        let bad = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e300, -1e10];
        for value in bad {
            for axis in 0..3 {
                let mut position = [1.0, 2.0, 3.0];
                position[axis] = value;
                assert_eq!(is_ground(&[CloudPoint::at([0.0; 3]), CloudPoint::at(position)]), [true, false]);
            }
        }
        assert!(is_ground(&[]).is_empty());
    }

    #[test]
    fn collinear_and_equal_points_are_classified() {
        let line: Vec<CloudPoint> =
            (0..50).map(|index| CloudPoint::at([f64::from(index), 0.0, 1.0])).collect();
        assert!(is_ground(&line).iter().all(|&is_ground| is_ground));
        assert_eq!(is_ground(&[CloudPoint::at([5.0; 3]); 40]), [true; 40]);
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 24, ..ProptestConfig::default() })]
        #[test]
        fn results_do_not_depend_on_the_order_of_points(
            mut keyed in prop::collection::vec((0u32..1200, 0u32..40, 0u32..30, any::<u32>()), 1..200),
        ) {
            let classified = |keyed: &[(u32, u32, u32, u32)]| {
                let points: Vec<CloudPoint> = keyed
                    .iter()
                    .map(|&(x, y, z, _)| CloudPoint::at([f64::from(x) / 2.0, f64::from(y) / 2.0, f64::from(z) / 10.0]))
                    .collect();
                let mut result: Vec<_> =
                    keyed.iter().zip(is_ground(&points)).map(|(&(x, y, z, _), ground)| (x, y, z, ground)).collect();
                result.sort_unstable();
                result
            };
            let first = classified(&keyed);
            keyed.sort_unstable_by_key(|point| point.3);
            prop_assert_eq!(first, classified(&keyed));
        }
    }
}
