//! Points far below their surroundings.

use super::GroundSettings;
use super::opening::close;
use super::raster::{EMPTY, Grid, is_lower, lowest};

/// Passes: points under the first that are found become the lowest of their cells.
const PASSES: usize = 3;

/// Points of a floor are neighbours within this distance, in spacings of lowest points.
const NEIGHBOURS: f64 = 2.0;
/// Height difference of neighbours on one floor, m, besides a slope.
const STEP_M: f64 = 0.3;
/// Slope of a floor.
const SLOPE: f64 = 0.5;

/// Marks points in pits that no ground has: narrower than a window and deeper than `low_slope` times its radius.
///
/// A closing of the lowest heights fills pits that are narrower than its window. Pingel, Clarke and McBride (2013) detect
/// low outliers in this way with a window of one cell. Courtyards and lanes are such pits as well, but their floors continue
/// to points outside.
///
/// `spacing` is the distance of lowest points in cells.
pub(super) fn below_ground(
    grid: &Grid,
    positions_m: &[[f64; 3]],
    spacing: f64,
    settings: &GroundSettings,
) -> Vec<bool> {
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
            if !*is_low && position[2] < lowest_allowed[grid.cell(*position)] {
                *is_low = true;
                is_changed = true;
            }
        }
        if !is_changed {
            break;
        }
    }
    restore_floors(grid, positions_m, spacing, &mut is_low);
    is_low
}

/// Removes the mark from points that other points without it continue, step by step from the edge of a floor.
fn restore_floors(grid: &Grid, positions_m: &[[f64; 3]], spacing: f64, is_low: &mut [bool]) {
    let mut low: Vec<usize> = (0..is_low.len()).filter(|&point| is_low[point]).collect();
    if low.is_empty() {
        return;
    }
    let mut cells = lowest(grid, positions_m, |point| !is_low[point]);
    let rings = (NEIGHBOURS * spacing).ceil() as usize;
    loop {
        let continues = |&point: &usize| {
            let position = positions_m[point];
            let mut is_found = false;
            for ring in 0..=rings {
                grid.for_each_in_ring(grid.cell(position), ring, |cell| {
                    if cells[cell] != EMPTY {
                        let [x, y, z] = [0, 1, 2].map(|axis| positions_m[cells[cell]][axis] - position[axis]);
                        is_found |= z.abs() <= STEP_M + SLOPE * (x * x + y * y).sqrt();
                    }
                });
            }
            is_found
        };
        let (floor, others): (Vec<usize>, Vec<usize>) = low.iter().partition(|point| continues(point));
        if floor.is_empty() {
            return;
        }
        for point in floor {
            is_low[point] = false;
            let cell = &mut cells[grid.cell(positions_m[point])];
            if *cell == EMPTY || is_lower(positions_m[point], positions_m[*cell]) {
                *cell = point;
            }
        }
        low = others;
    }
}
