//! Points far below their surroundings.

use super::GroundSettings;
use super::opening::close;
use super::raster::{EMPTY, Grid, lowest};

/// Passes: points under the first that are found become the lowest of their cells.
const PASSES: usize = 3;

/// Distances at which other low points show that a pit is ground below a wood, m: low clusters are narrower.
const COMPANIONS_M: [f64; 2] = [5.0, 20.0];
/// Height difference of such points, m, and its part of their distance.
const LEVEL_M: f64 = 0.5;
const LEVEL_SLOPE: f64 = 0.1;
/// Fewest quadrants with such points: on a slope, only two have points of the same height.
const QUADRANTS: u32 = 2;

/// Marks points in pits that no ground has: narrower than a window and deeper than `low_slope` times its radius.
///
/// A closing of the lowest heights fills pits that are narrower than its window. Pingel, Clarke and McBride (2013) detect
/// low outliers in this way with a window of one cell. Ground seen through gaps of a wood is in such pits as well, but
/// has points of the same height around.
pub(super) fn below_ground(grid: &Grid, positions_m: &[[f64; 3]], settings: &GroundSettings) -> Vec<bool> {
    let mut is_low = vec![false; positions_m.len()];
    for _ in 0..PASSES {
        let cells = lowest(grid, positions_m, |point| !is_low[point]);
        let heights: Vec<f64> = cells
            .iter()
            .map(|&point| if point == EMPTY { f64::NEG_INFINITY } else { positions_m[point][2] })
            .collect();
        let mut lowest_allowed = vec![f64::NEG_INFINITY; grid.len()];
        for radius_m in settings.low_radii_m {
            let radius = ((radius_m / grid.cell_m).round() as usize).max(1);
            let depth = settings.low_slope * radius as f64 * grid.cell_m;
            for (limit, closed) in lowest_allowed.iter_mut().zip(close(grid, &heights, radius)) {
                *limit = limit.max(closed - depth);
            }
        }
        let mut is_changed = false;
        for (position, is_low) in positions_m.iter().zip(&mut is_low) {
            let is_pit = !*is_low && position[2] < lowest_allowed[grid.cell(*position)];
            if is_pit && !has_companions(grid, &heights, *position) {
                *is_low = true;
                is_changed = true;
            }
        }
        if !is_changed {
            break;
        }
    }
    is_low
}

/// Whether lowest points around a place, in several directions, have its height.
fn has_companions(grid: &Grid, heights: &[f64], position_m: [f64; 3]) -> bool {
    let cell = grid.cell(position_m);
    let (row, column) = (cell / grid.columns, cell % grid.columns);
    let [nearest, farthest] = COMPANIONS_M.map(|reach_m| (reach_m / grid.cell_m).ceil().max(1.0) as usize);
    let mut quadrants = 0u32;
    for ring in nearest..=farthest {
        let level_m = LEVEL_M + LEVEL_SLOPE * ring as f64 * grid.cell_m;
        grid.for_each_in_ring(cell, ring, |other| {
            if (heights[other] - position_m[2]).abs() <= level_m {
                let (is_north, is_east) = (other / grid.columns > row, other % grid.columns > column);
                quadrants |= 1 << (2 * u32::from(is_north) + u32::from(is_east));
            }
        });
        if quadrants.count_ones() >= QUADRANTS {
            return true;
        }
    }
    false
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ground_below_a_wood_is_no_pit_and_low_clusters_are() {
        // A wood 12 m high, through which every ninth point reaches the ground, and a cluster of 3 m by 3 m below it.
        let positions: Vec<[f64; 3]> = (0..3600)
            .map(|index| {
                let (x, y) = (f64::from(index % 60) + 0.5, f64::from(index / 60) + 0.5);
                let is_cluster = (30.0..33.0).contains(&x) && (30.0..33.0).contains(&y);
                let is_edge = [x, y].iter().any(|at| !(3.0..57.0).contains(at));
                let is_ground = is_edge || index % 3 == 0 && index / 60 % 3 == 0;
                [
                    x,
                    y,
                    if is_cluster {
                        -22.0
                    } else if is_ground {
                        0.05 * x
                    } else {
                        12.0 + 0.05 * x
                    },
                ]
            })
            .collect();
        let grid = Grid::covering([0.0; 2], [59.9; 2], 1.0);
        let is_low = below_ground(&grid, &positions, &GroundSettings::default());
        let found = positions.iter().zip(is_low).filter(|(_, is_low)| *is_low).map(|(p, _)| p[2]);
        assert_eq!(found.collect::<Vec<_>>(), [-22.0; 9]);
    }
}
