//! Morphological opening of a raster with squares.

use super::GroundSettings;
use super::raster::{EMPTY, Grid};

/// Opening with a square of `2 radius + 1` cells: highest of the squares' lowest values. Empty cells (infinite) have no
/// effect and get a value if a square around them has one.
pub(super) fn open(grid: &Grid, values: &[f64], radius: usize) -> Vec<f64> {
    let mut eroded = sweep(grid, values, radius, f64::INFINITY, f64::min);
    replace(&mut eroded, f64::INFINITY, f64::NEG_INFINITY);
    sweep(grid, &eroded, radius, f64::NEG_INFINITY, f64::max)
}

/// Closing with a square: lowest of the squares' highest values. Empty cells are negative infinite.
pub(super) fn close(grid: &Grid, values: &[f64], radius: usize) -> Vec<f64> {
    let mut dilated = sweep(grid, values, radius, f64::NEG_INFINITY, f64::max);
    replace(&mut dilated, f64::NEG_INFINITY, f64::INFINITY);
    sweep(grid, &dilated, radius, f64::INFINITY, f64::min)
}

fn replace(values: &mut [f64], old: f64, new: f64) {
    for value in values {
        if *value == old {
            *value = new;
        }
    }
}

/// `pick` over a square around each cell: rows, then columns, each by the algorithm of van Herk (1992) and Gil and
/// Werman (1993), whose cost does not depend on the radius.
fn sweep(grid: &Grid, values: &[f64], radius: usize, none: f64, pick: fn(f64, f64) -> f64) -> Vec<f64> {
    let mut result = values.to_vec();
    let longest = grid.columns.max(grid.rows);
    let (mut line, mut forward, mut backward) = (Vec::new(), Vec::new(), Vec::new());
    for buffer in [&mut line, &mut forward, &mut backward] {
        buffer.reserve(longest + 4 * radius + 2);
    }
    let mut run = |result: &mut [f64], start: usize, step: usize, count: usize| {
        let window = 2 * radius + 1;
        let padded = (count + 2 * radius).next_multiple_of(window);
        line.clear();
        line.resize(padded, none);
        for index in 0..count {
            line[radius + index] = result[start + index * step];
        }
        forward.clear();
        forward.extend_from_slice(&line);
        backward.clear();
        backward.extend_from_slice(&line);
        for index in 1..padded {
            if !index.is_multiple_of(window) {
                forward[index] = pick(forward[index], forward[index - 1]);
            }
            let mirrored = padded - 1 - index;
            if !(mirrored + 1).is_multiple_of(window) {
                backward[mirrored] = pick(backward[mirrored], backward[mirrored + 1]);
            }
        }
        for index in 0..count {
            result[start + index * step] = pick(backward[index], forward[index + window - 1]);
        }
    };
    for row in 0..grid.rows {
        run(&mut result, row * grid.columns, 1, grid.columns);
    }
    for column in 0..grid.columns {
        run(&mut result, column, grid.columns, grid.rows);
    }
    result
}

/// Whether the lowest point of each cell may be ground: no opening lowers it by more than the slope allows.
///
/// Simple morphological filter (Pingel, Clarke and McBride 2013, doi:10.1016/j.isprsjprs.2012.12.002): each opening starts
/// from the one with the next smaller window. An object of height h disappears at once, with the first window that is
/// wider; a hill is lowered little by little.
pub(super) fn bare_cells(
    grid: &Grid,
    positions_m: &[[f64; 3]],
    cells: &[u32],
    settings: &GroundSettings,
) -> Vec<bool> {
    let mut heights: Vec<f64> = cells
        .iter()
        .map(|&point| if point == EMPTY { f64::INFINITY } else { positions_m[point as usize][2] })
        .collect();
    let mut is_bare: Vec<bool> = cells.iter().map(|&point| point != EMPTY).collect();
    let largest = (settings.largest_radius_m / grid.cell_m).round() as usize;
    for radius in 1..=largest {
        let opened = open(grid, &heights, radius);
        let step = settings.slope * radius as f64 * grid.cell_m;
        for cell in 0..grid.len() {
            if heights[cell] - opened[cell] > step {
                is_bare[cell] = false;
            }
        }
        heights = opened;
    }
    is_bare
}
