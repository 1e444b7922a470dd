//! Smooth surface through known cells.

use super::raster::Grid;

/// Sweeps of relaxation at each level.
const SWEEPS: usize = 12;

/// Fills unknown cells (NaN) with the membrane through the known ones: each unknown cell is the mean of its neighbours.
///
/// Starts from the solution of a raster with half the resolution (cascadic multigrid). All cells are NaN if none is known.
pub(super) fn fill(columns: usize, rows: usize, known: &[f64]) -> Vec<f64> {
    let mut values = known.to_vec();
    if known.iter().all(|value| value.is_finite()) || known.iter().all(|value| value.is_nan()) {
        return values;
    }
    let (half_columns, half_rows) = (columns.div_ceil(2), rows.div_ceil(2));
    let mut sums = vec![(0f64, 0u32); half_columns * half_rows];
    for row in 0..rows {
        for column in 0..columns {
            let value = known[row * columns + column];
            if value.is_finite() {
                let (sum, count) = &mut sums[row / 2 * half_columns + column / 2];
                *sum += value;
                *count += 1;
            }
        }
    }
    let coarse: Vec<f64> =
        sums.iter().map(|&(sum, count)| if count == 0 { f64::NAN } else { sum / f64::from(count) }).collect();
    let coarse = fill(half_columns, half_rows, &coarse);
    let half = Grid { origin_m: [0.0; 2], cell_m: 2.0, columns: half_columns, rows: half_rows };
    let mut unknown = Vec::new();
    for row in 0..rows {
        for column in 0..columns {
            let cell = row * columns + column;
            if !known[cell].is_finite() {
                values[cell] = half.interpolate(&coarse, column as f64 + 0.5, row as f64 + 0.5);
                unknown.push(cell);
            }
        }
    }
    for _ in 0..SWEEPS {
        for &cell in &unknown {
            let (row, column) = (cell / columns, cell % columns);
            let (mut sum, mut count) = (0f64, 0f64);
            let mut add = |is_inside: bool, at: usize| {
                if is_inside {
                    sum += values[at];
                    count += 1.0;
                }
            };
            add(column > 0, cell.wrapping_sub(1));
            add(column + 1 < columns, cell + 1);
            add(row > 0, cell.wrapping_sub(columns));
            add(row + 1 < rows, cell + columns);
            values[cell] = sum / count;
        }
    }
    values
}

/// Trend of known cells (NaN: unknown): means of the filled surface over squares, to be interpolated between their centres.
pub(super) fn trend(grid: &Grid, known: &[f64], edge_m: f64) -> (Grid, Vec<f64>) {
    let centre_m = |cell: usize| {
        let at = |index: usize, axis: usize| grid.origin_m[axis] + (index as f64 + 0.5) * grid.cell_m;
        [at(cell % grid.columns, 0), at(cell / grid.columns, 1), 0.0]
    };
    let [first_m, last_m] = [0, grid.len() - 1].map(|cell| [0, 1].map(|axis| centre_m(cell)[axis]));
    let squares = Grid::covering(first_m, last_m, edge_m.max(grid.cell_m));
    let mut sums = vec![(0.0, 0u32); squares.len()];
    for (cell, height_m) in fill(grid.columns, grid.rows, known).into_iter().enumerate() {
        let (sum, count) = &mut sums[squares.cell(centre_m(cell))];
        *sum += height_m;
        *count += 1;
    }
    let means: Vec<f64> = sums.iter().map(|&(sum, count)| sum / f64::from(count)).collect();
    let means = fill(squares.columns, squares.rows, &means);
    (squares, means)
}

/// Slope (tangent) of a surface at each cell, from central differences.
pub(super) fn slopes(grid: &Grid, surface: &[f64]) -> Vec<f64> {
    let mut slopes = Vec::with_capacity(surface.len());
    for row in 0..grid.rows {
        for column in 0..grid.columns {
            let along = |low: usize, high: usize, steps: usize| {
                if steps == 0 { 0.0 } else { (surface[high] - surface[low]) / (steps as f64 * grid.cell_m) }
            };
            let (left, right) = (column.saturating_sub(1), (column + 1).min(grid.columns - 1));
            let (low, high) = (row.saturating_sub(1), (row + 1).min(grid.rows - 1));
            let east = along(row * grid.columns + left, row * grid.columns + right, right - left);
            let north = along(low * grid.columns + column, high * grid.columns + column, high - low);
            slopes.push((east * east + north * north).sqrt());
        }
    }
    slopes
}
