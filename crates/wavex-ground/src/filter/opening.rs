//! Morphological opening of a raster with squares.

use super::GroundSettings;
use super::raster::Grid;
use super::surface::fill;

/// Opening with a square of `2 radius + 1` cells: highest of the squares' lowest values. Empty cells (infinite) have no
/// effect and get a value if a square around them has one.
pub(super) fn open(grid: &Grid, values: &[f64], radius: usize) -> Vec<f64> {
    let mut eroded = sweep(grid, values, radius, f64::INFINITY, lower);
    replace(&mut eroded, f64::INFINITY, f64::NEG_INFINITY);
    sweep(grid, &eroded, radius, f64::NEG_INFINITY, higher)
}

/// Closing with a square: lowest of the squares' highest values. Empty cells are negative infinite.
pub(super) fn close(grid: &Grid, values: &[f64], radius: usize) -> Vec<f64> {
    let mut dilated = sweep(grid, values, radius, f64::NEG_INFINITY, higher);
    replace(&mut dilated, f64::NEG_INFINITY, f64::INFINITY);
    sweep(grid, &dilated, radius, f64::INFINITY, lower)
}

fn replace(values: &mut [f64], old: f64, new: f64) {
    for value in values {
        if *value == old {
            *value = new;
        }
    }
}

// Unlike `f64::min` and `f64::max` without a rule for NaN, which heights are not.
fn lower(a: f64, b: f64) -> f64 {
    if a < b { a } else { b }
}

fn higher(a: f64, b: f64) -> f64 {
    if a > b { a } else { b }
}

/// `pick` over a square around each cell: along rows, then along columns.
fn sweep(
    grid: &Grid,
    values: &[f64],
    radius: usize,
    none: f64,
    pick: impl Fn(f64, f64) -> f64 + Copy,
) -> Vec<f64> {
    let along_rows = sweep_rows(values, grid.columns, radius, none, pick);
    let turned = transpose(&along_rows, grid.columns);
    transpose(&sweep_rows(&turned, grid.rows, radius, none, pick), grid.rows)
}

/// Columns as rows.
fn transpose(values: &[f64], columns: usize) -> Vec<f64> {
    let rows = values.len() / columns;
    let mut turned = vec![0.0; values.len()];
    for (row, cells) in values.chunks_exact(columns).enumerate() {
        for (column, &value) in cells.iter().enumerate() {
            turned[column * rows + row] = value;
        }
    }
    turned
}

/// `pick` over windows along rows, by the algorithm of van Herk (1992) and Gil and Werman (1993), whose cost does not
/// depend on the radius.
fn sweep_rows(
    values: &[f64],
    columns: usize,
    radius: usize,
    none: f64,
    pick: impl Fn(f64, f64) -> f64 + Copy,
) -> Vec<f64> {
    let window = 2 * radius + 1;
    let padded = (columns + 2 * radius).next_multiple_of(window);
    let mut forward = vec![none; padded];
    let mut backward = vec![none; padded];
    let mut result = Vec::with_capacity(values.len());
    for row in values.chunks_exact(columns) {
        forward.fill(none);
        forward[radius..radius + columns].copy_from_slice(row);
        backward.copy_from_slice(&forward);
        for (forward, backward) in forward.chunks_exact_mut(window).zip(backward.chunks_exact_mut(window)) {
            for index in 1..window {
                forward[index] = pick(forward[index - 1], forward[index]);
                let mirrored = window - 1 - index;
                backward[mirrored] = pick(backward[mirrored + 1], backward[mirrored]);
            }
        }
        let ends = &forward[window - 1..];
        result.extend(backward.iter().zip(ends).take(columns).map(|(&start, &end)| pick(start, end)));
    }
    result
}

/// Whether the lowest point of each cell may be ground: no opening lowers it by more than the slope allows. Heights of empty
/// cells are NaN; these are not ground.
///
/// Simple morphological filter (Pingel, Clarke and McBride 2013, doi:10.1016/j.isprsjprs.2012.12.002): each opening starts
/// from the one with the next smaller window. An object of height h disappears at once, with the first window that is
/// wider; a hill is lowered little by little.
pub(super) fn bare_cells(grid: &Grid, heights_m: &[f64], settings: &GroundSettings) -> Vec<bool> {
    // Filled, because a slope between sparse points would look like a step of an opening that reaches the next one.
    let mut heights = fill(grid.columns, grid.rows, heights_m);
    let mut is_bare: Vec<bool> = heights_m.iter().map(|height| height.is_finite()).collect();
    let largest = (settings.largest_radius_m / grid.cell_m).round() as usize;
    let mut radius = 0;
    while radius < largest {
        radius = (radius + (radius / 8).max(1)).min(largest);
        let opened = open(grid, &heights, radius);
        let step = settings.step_m + settings.step_slope * radius as f64 * grid.cell_m;
        for cell in 0..grid.len() {
            is_bare[cell] &= heights[cell] - opened[cell] <= step;
        }
        heights = opened;
    }
    is_bare
}
