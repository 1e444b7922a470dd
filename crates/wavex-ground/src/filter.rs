//! Ground classification of points.

mod growth;
mod local_plane;
mod low;
mod nodes;
mod opening;
mod raster;
mod roof;
mod surface;

use std::collections::{BTreeMap, BTreeSet};

use rayon::prelude::*;

use crate::point::{Class, CloudPoint};
use growth::Growth;
use nodes::Nodes;
use raster::{EMPTY, Grid, lowest};

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
    /// Edges of the squares whose mean heights are the trend, for each repetition of the openings, m.
    pub trends_m: [f64; 2],
    /// Passes of the growth of the ground before climbed roofs are dropped, and after it.
    pub growth_passes: [usize; 2],
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
            trends_m: [64.0, 16.0],
            growth_passes: [5, 2],
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

/// The distance of lowest points is measured with squares of this edge, in cells.
const SQUARE_CELLS: usize = 16;

/// Largest distance of lowest points, in cells, to which neighbourhoods are adapted.
const FARTHEST_SPACING: f64 = 4.0;

/// Widest extent of points that are classified with one raster, m.
const WIDEST_M: f64 = 2.0 * (TILE_M + 2.0 * OVERLAP_M);

/// Classifies points as [`Class::Ground`] or [`Class::Unclassified`].
///
/// Each tile of [`TILE_M`] is classified with the points within [`OVERLAP_M`] of it, so memory does not depend on the
/// extent. The result does not depend on the order of points or on threads. Points whose coordinates are not finite, or
/// farther than 1e9 m from the origin, are unclassified.
pub fn classify_ground(points: &[CloudPoint], settings: &GroundSettings) -> Vec<Class> {
    let mut tiles: BTreeMap<[i64; 2], Vec<usize>> = BTreeMap::new();
    for (index, point) in points.iter().enumerate() {
        let position = point.position_m;
        if is_usable(position) {
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

/// Classifies the points of one tile with those around it, like [`classify_ground`], but with one raster.
///
/// The points around it get classes as well, which are less certain near the edge. Points that extend over more than 1424 m
/// are classified by tiles.
pub fn classify_tile(points: &[CloudPoint], settings: &GroundSettings) -> Vec<Class> {
    let usable: Vec<usize> = (0..points.len()).filter(|&index| is_usable(points[index].position_m)).collect();
    let is_wide = (0..2).any(|axis| {
        let along = || usable.iter().map(|&index| points[index].position_m[axis]);
        along().fold(f64::NEG_INFINITY, f64::max) - along().fold(f64::INFINITY, f64::min) > WIDEST_M
    });
    if is_wide {
        return classify_ground(points, settings);
    }
    let members: Vec<CloudPoint> = usable.iter().map(|&index| points[index]).collect();
    let mut classes = vec![Class::Unclassified; points.len()];
    for (index, is_ground) in usable.into_iter().zip(ground(&members, settings)) {
        if is_ground {
            classes[index] = Class::Ground;
        }
    }
    classes
}

/// Whether cells have exact coordinates at a position.
fn is_usable(position_m: [f64; 3]) -> bool {
    position_m.iter().all(|value| value.abs() <= FARTHEST_M)
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

/// Mean distance of lowest points, in cells, on squares that have some.
fn spacing(grid: &Grid, cells: &[usize]) -> f64 {
    let columns = grid.columns.div_ceil(SQUARE_CELLS);
    let mut is_occupied = vec![false; columns * grid.rows.div_ceil(SQUARE_CELLS)];
    let mut n_nodes = 0;
    for (cell, _) in cells.iter().enumerate().filter(|&(_, &point)| point != EMPTY) {
        let (row, column) = (cell / grid.columns, cell % grid.columns);
        is_occupied[row / SQUARE_CELLS * columns + column / SQUARE_CELLS] = true;
        n_nodes += 1;
    }
    let n_squares = is_occupied.into_iter().filter(|&is_occupied| is_occupied).count();
    let n_cells = (n_squares * SQUARE_CELLS * SQUARE_CELLS) as f64;
    (n_cells / f64::from(n_nodes.max(1))).sqrt().clamp(1.0, FARTHEST_SPACING)
}

/// Whether the openings leave each node. Their raster has coarser cells if most cells of `grid` are empty.
///
/// The openings are repeated with heights above the trend of the ground found so far. On a slope, windows that grow by one
/// cell lower a large roof in steps that are small enough for ground.
fn bare_nodes(nodes: &Nodes, grid: &Grid, spacing: f64, settings: &GroundSettings) -> Vec<bool> {
    let coarser = if spacing >= 4.0 {
        4.0
    } else if spacing >= 2.0 {
        2.0
    } else {
        1.0
    };
    let [width_m, height_m] = [grid.columns, grid.rows].map(|n| (n - 1) as f64 * grid.cell_m);
    let end_m = [grid.origin_m[0] + width_m, grid.origin_m[1] + height_m];
    let coarse = Grid::covering(grid.origin_m, end_m, coarser * grid.cell_m);
    let lowest = lowest(&coarse, &nodes.positions_m, |_| true);
    let heights_m: Vec<f64> = lowest
        .iter()
        .map(|&node| if node == EMPTY { f64::NAN } else { nodes.positions_m[node][2] })
        .collect();
    let mut is_bare_cell = opening::bare_cells(&coarse, &heights_m, settings);
    for edge_m in settings.trends_m {
        let known = |(&height, &is_bare)| if is_bare { height } else { f64::NAN };
        let ground_m: Vec<f64> = heights_m.iter().zip(&is_bare_cell).map(known).collect();
        let (squares, trend_m) = surface::trend(&coarse, &ground_m, edge_m);
        let mut residuals_m = heights_m.clone();
        for (residual, &node) in residuals_m.iter_mut().zip(&lowest).filter(|(_, node)| **node != EMPTY) {
            let [x, y, _] = nodes.positions_m[node];
            *residual -= squares.interpolate(&trend_m, x, y);
        }
        is_bare_cell = opening::bare_cells(&coarse, &residuals_m, settings);
    }
    let mut is_bare = vec![false; nodes.len()];
    for (node, is_bare_cell) in lowest.into_iter().zip(is_bare_cell).filter(|(node, _)| *node != EMPTY) {
        is_bare[node] = is_bare_cell;
    }
    is_bare
}

/// Whether each point of a tile is ground.
fn ground(points: &[CloudPoint], settings: &GroundSettings) -> Vec<bool> {
    let positions_m: Vec<[f64; 3]> = points.iter().map(|point| point.position_m).collect();
    if points.is_empty() {
        return Vec::new();
    }
    let grid = grid(&positions_m, settings);
    let is_low = low::below_ground(&grid, &positions_m, settings);
    let cells = lowest(&grid, &positions_m, |point| !is_low[point] && points[point].may_be_last());
    let nodes = Nodes::new(&grid, &positions_m, &cells);
    let spacing = spacing(&grid, &cells);
    let is_bare = bare_nodes(&nodes, &grid, spacing, settings);
    let mut is_ground = is_bare.clone();
    let mut growth = Growth::new(&nodes, spacing);
    for passes in settings.growth_passes {
        growth.grow(&mut is_ground, passes, settings);
        roof::drop_roofs(&nodes, &is_bare, spacing, &mut is_ground);
    }
    let mut known = vec![f64::NAN; grid.len()];
    for (node, _) in is_ground.iter().enumerate().filter(|(_, is_ground)| **is_ground) {
        known[nodes.cells[node]] = nodes.positions_m[node][2];
    }
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
    fn wide_roofs_parallel_to_a_slope_are_no_ground() {
        let (points, truth) = scene(140, |x, y| {
            let is_roof = (60.0..85.0).contains(&x) && (60.0..85.0).contains(&y);
            (if is_roof { 4.0 } else { 0.0 } - 0.25 * y, !is_roof)
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
        for index in 0..16 {
            let [x, y] = [70.5 + f64::from(index % 4), 20.5 + f64::from(index / 4)];
            points.push(CloudPoint::at([x, y, -30.0]));
            truth.push(false);
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
    fn floors_of_lanes_between_high_buildings_are_ground() {
        let (points, truth) = scene(60, |x, y| {
            let is_roof = (20.0..50.0).contains(&x) && !(32.0..36.0).contains(&y);
            (if is_roof { 40.0 } else { 0.0 }, !is_roof)
        });
        assert!(error(&points, &truth) < 0.01, "{}", error(&points, &truth));
    }

    /// 20 m wide, up to 6 m high, 0.16 points per m²: a ramp leads up, all other sides are walls.
    #[test]
    fn embankments_of_sparse_points_are_ground() {
        let (mut points, truth) = scene(80, |_, _| (0.0, true));
        for point in &mut points {
            let [x, y, z] = &mut point.position_m;
            (*x, *y) = (2.5 * *x, 2.5 * *y);
            let is_top = (*x + 0.3 * *y - 130.0).abs() < 10.0 && *y < 130.0;
            *z = if is_top { (0.1 * (*y - 30.0)).clamp(0.0, 6.0) } else { 0.0 };
        }
        assert!(error(&points, &truth) < 0.02, "{}", error(&points, &truth));
    }

    #[test]
    fn a_tile_is_classified_like_a_tile_of_a_cloud() {
        // The right part alone would be ground.
        let (mut points, _) = scene(100, |x, _| (0.2 * x + if x > 60.0 { 8.0 } else { 0.0 }, true));
        points.push(CloudPoint::at([f64::NAN, 0.0, 0.0]));
        let settings = GroundSettings::default();
        assert_eq!(classify_tile(&points, &settings), classify_ground(&points, &settings));
        // The edge of a tile crosses the points.
        points.iter_mut().for_each(|point| point.position_m[0] += TILE_M - 70.0);
        assert_eq!(classify_tile(&points, &settings), classify_ground(&points, &settings));
        assert!(classify_tile(&[], &settings).is_empty());
    }

    #[test]
    fn wide_clouds_are_not_one_tile() {
        let far = |x: f64| CloudPoint::at([x, 0.0, 0.0]);
        let points = [far(-1e9), far(1e9), CloudPoint::at([0.0, 1e8, 5.0])];
        assert_eq!(classify_tile(&points, &GroundSettings::default()), [Class::Ground; 3]);
    }

    #[test]
    fn spacing_is_that_of_occupied_squares() {
        let grid = Grid::covering([0.0; 2], [319.0, 159.0], 1.0);
        let cells: Vec<usize> = (0..grid.len())
            .map(|cell| {
                let (row, column) = (cell / grid.columns, cell % grid.columns);
                if row.is_multiple_of(3) && column.is_multiple_of(3) && column < 160 { cell } else { EMPTY }
            })
            .collect();
        let spacing = super::spacing(&grid, &cells);
        assert!((spacing - 3.0).abs() < 0.1, "{spacing}");
        assert_eq!(super::spacing(&grid, &[EMPTY; 320 * 160]), 1.0);
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
