//! Occupied cells of a raster, with quick access to the neighbours of each.

use super::raster::{EMPTY, Grid};

/// Occupied cells in the order of the raster.
pub(super) struct Nodes {
    /// Cell of each node.
    pub(super) cells: Vec<usize>,
    /// Lowest point of each node, m.
    pub(super) positions_m: Vec<[f64; 3]>,
    pub(super) cell_m: f64,
    columns: usize,
    rows: usize,
    /// Number of nodes before each cell; the last element is the number of all nodes.
    starts: Vec<u32>,
}

impl Nodes {
    /// Nodes of the cells that have a lowest point.
    pub(super) fn new(grid: &Grid, positions_m: &[[f64; 3]], lowest: &[usize]) -> Nodes {
        let mut starts = Vec::with_capacity(lowest.len() + 1);
        let (mut cells, mut nodes_m) = (Vec::new(), Vec::new());
        for (cell, &point) in lowest.iter().enumerate() {
            starts.push(cells.len() as u32);
            if point != EMPTY {
                cells.push(cell);
                nodes_m.push(positions_m[point]);
            }
        }
        starts.push(cells.len() as u32);
        Nodes {
            cells,
            positions_m: nodes_m,
            cell_m: grid.cell_m,
            columns: grid.columns,
            rows: grid.rows,
            starts,
        }
    }

    pub(super) fn len(&self) -> usize {
        self.cells.len()
    }

    /// Calls `visit` with each other node within `rings` cells along both axes, and with its ring.
    pub(super) fn for_each_within(&self, node: usize, rings: usize, mut visit: impl FnMut(usize, usize)) {
        let (row, column) = (self.cells[node] / self.columns, self.cells[node] % self.columns);
        let (first, last) = (column.saturating_sub(rings), (column + rings).min(self.columns - 1));
        for other_row in row.saturating_sub(rings)..=(row + rings).min(self.rows - 1) {
            let start = other_row * self.columns;
            for other in self.starts[start + first] as usize..self.starts[start + last + 1] as usize {
                if other != node {
                    let other_column = self.cells[other] - start;
                    visit(other, other_row.abs_diff(row).max(other_column.abs_diff(column)));
                }
            }
        }
    }

    /// Whether the slope between two nodes is at most `slope`, besides a step of `step_m`.
    pub(super) fn is_smooth(&self, a: usize, b: usize, step_m: f64, slope: f64) -> bool {
        let [x, y, z] = [0, 1, 2].map(|axis| self.positions_m[a][axis] - self.positions_m[b][axis]);
        z.abs() <= step_m + slope * (x * x + y * y).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::filter::raster::lowest;

    #[test]
    fn nodes_within_rings_are_found_in_all_directions() {
        let grid = Grid::covering([0.0; 2], [29.0, 19.0], 1.0);
        let positions_m: Vec<[f64; 3]> = (0..150)
            .map(|index| [f64::from(index * 37 % 30) + 0.5, f64::from(index * 53 % 20) + 0.5, 0.0])
            .collect();
        let nodes = Nodes::new(&grid, &positions_m, &lowest(&grid, &positions_m, |point| point % 4 != 0));
        assert!((30..100).contains(&nodes.len()));
        for node in 0..nodes.len() {
            let ring_to = |other: usize| {
                let along = |axis: usize| {
                    nodes.positions_m[node][axis].floor() - nodes.positions_m[other][axis].floor()
                };
                along(0).abs().max(along(1).abs()) as usize
            };
            for rings in [1, 3, 40] {
                let mut found = Vec::new();
                nodes.for_each_within(node, rings, |other, ring| found.push((other, ring)));
                let expected: Vec<_> = (0..nodes.len())
                    .filter(|&other| other != node)
                    .map(|other| (other, ring_to(other)))
                    .filter(|&(_, ring)| ring <= rings)
                    .collect();
                assert_eq!(found, expected);
            }
        }
    }
}
