//! Raster of a tile: cells with values, and the lowest point of each cell.

/// No point in a cell.
pub(super) const EMPTY: usize = usize::MAX;

/// Cells of a tile in the plane, m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Grid {
    /// Lower left corner.
    pub(super) origin_m: [f64; 2],
    pub(super) cell_m: f64,
    pub(super) columns: usize,
    pub(super) rows: usize,
}

impl Grid {
    /// The grid whose cells cover `min_m` to `max_m`; its corner is a multiple of the cell.
    pub(super) fn covering(min_m: [f64; 2], max_m: [f64; 2], cell_m: f64) -> Grid {
        let origin_m = min_m.map(|value| (value / cell_m).floor() * cell_m);
        let count = |axis: usize| ((max_m[axis] - origin_m[axis]) / cell_m).floor() as usize + 1;
        Grid { origin_m, cell_m, columns: count(0), rows: count(1) }
    }

    pub(super) fn len(&self) -> usize {
        self.columns * self.rows
    }

    /// The cell that contains a position inside the grid.
    pub(super) fn cell(&self, position_m: [f64; 3]) -> usize {
        let index = |axis: usize, count: usize| {
            (((position_m[axis] - self.origin_m[axis]) / self.cell_m) as usize).min(count - 1)
        };
        index(1, self.rows) * self.columns + index(0, self.columns)
    }

    /// Calls `visit` with the cells of the square ring at a distance of `ring` cells.
    pub(super) fn for_each_in_ring(&self, cell: usize, ring: usize, mut visit: impl FnMut(usize)) {
        let (row, column) = (cell / self.columns, cell % self.columns);
        let columns = column.saturating_sub(ring)..(column + ring + 1).min(self.columns);
        for other_row in row.saturating_sub(ring)..(row + ring + 1).min(self.rows) {
            if other_row.abs_diff(row) == ring {
                columns.clone().for_each(|other| visit(other_row * self.columns + other));
                continue;
            }
            if column >= ring {
                visit(other_row * self.columns + column - ring);
            }
            if column + ring < self.columns {
                visit(other_row * self.columns + column + ring);
            }
        }
    }

    /// Value between the centres of cells (bilinear; constant beyond the outer centres).
    pub(super) fn interpolate(&self, values: &[f64], x_m: f64, y_m: f64) -> f64 {
        let place = |value: f64, origin: f64, count: usize| {
            let at = ((value - origin) / self.cell_m - 0.5).clamp(0.0, (count - 1) as f64);
            let low = (at as usize).min(count.saturating_sub(2));
            (low, (low + 1).min(count - 1), at - low as f64)
        };
        let (left, right, u) = place(x_m, self.origin_m[0], self.columns);
        let (low, high, v) = place(y_m, self.origin_m[1], self.rows);
        let value = |row: usize, column: usize| values[row * self.columns + column];
        let below = value(low, left) * (1.0 - u) + value(low, right) * u;
        let above = value(high, left) * (1.0 - u) + value(high, right) * u;
        below * (1.0 - v) + above * v
    }
}

/// The lowest accepted point of each cell, by index; [`EMPTY`] for none. Ties are resolved by position.
pub(super) fn lowest(grid: &Grid, positions_m: &[[f64; 3]], accept: impl Fn(usize) -> bool) -> Vec<usize> {
    let mut cells = vec![EMPTY; grid.len()];
    for (index, &position) in positions_m.iter().enumerate() {
        if !accept(index) {
            continue;
        }
        let cell = &mut cells[grid.cell(position)];
        if *cell == EMPTY || is_lower(position, positions_m[*cell]) {
            *cell = index;
        }
    }
    cells
}

/// Order by height, then by position, for results that do not depend on the order of points.
pub(super) fn is_lower(a: [f64; 3], b: [f64; 3]) -> bool {
    (a[2], a[0], a[1]) < (b[2], b[0], b[1])
}
