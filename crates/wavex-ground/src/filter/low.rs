//! Points far below their surroundings.

use super::GroundSettings;
use super::opening::close;
use super::raster::{EMPTY, Grid, lowest};

/// Passes: points under the first that are found become the lowest of their cells.
const PASSES: usize = 3;

/// Marks points in pits that no ground has: narrower than a window and deeper than `low_slope` times its radius.
///
/// A closing of the lowest heights fills pits that are narrower than its window. Pingel, Clarke and McBride (2013) detect
/// low outliers in this way with a window of one cell.
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
            if !*is_low && position[2] < lowest_allowed[grid.cell(*position)] {
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
