//! Cells of one strip, in bounded memory.

use std::collections::HashMap;

use super::cell::{CellSums, HEIGHT_STEP_M, STEPS_PER_CELL};
use wavex_line::scan_line::Return;

/// Binary logarithm of the edge of a tile, cells.
const TILE_BITS: u32 = 4;
const TILE_CELLS: usize = 1 << (2 * TILE_BITS);
/// Maximum number of tiles of a strip: about a million cells, 100 MB.
const MAX_TILES: usize = 4096;
/// Coarsest level; cells are then larger than the earth.
const COARSEST: u8 = 24;
/// Largest valid coordinate, in units of the CRS, and height, m.
const FARTHEST: f64 = 1e8;
const HIGHEST_M: f64 = 1e5;

/// Cell of a strip with its column and row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PlacedCell {
    /// Cells east of the origin of the CRS.
    pub(super) column: i32,
    /// Cells north of the origin of the CRS.
    pub(super) row: i32,
    pub(super) sums: CellSums,
}

type CellTile = Box<[CellSums; TILE_CELLS]>;

/// Sparse grid of cells that double in size when they become too many.
///
/// Cells are multiples of their size, and sums move exactly to the larger cells: the result does not
/// depend on the order of points.
#[derive(Debug)]
pub(super) struct StripGrid {
    /// Size of a cell of level 0, units of the CRS.
    cell: f64,
    /// Binary logarithm of the cell size relative to `cell`.
    level: u8,
    tiles: HashMap<[i32; 2], CellTile>,
    /// Tile of the last point, which is not in `tiles`.
    current: Option<([i32; 2], CellTile)>,
    max_tiles: usize,
}

impl StripGrid {
    /// An empty grid with cells of this size, units of the CRS.
    pub(super) fn new(cell: f64) -> StripGrid {
        StripGrid { cell, level: 0, tiles: HashMap::new(), current: None, max_tiles: MAX_TILES }
    }

    pub(super) fn level(&self) -> u8 {
        self.level
    }

    /// Adds a point; returns whether its coordinates are valid.
    ///
    /// `height_unit_m` is the unit of the height.
    pub(super) fn add(&mut self, found: &Return, [x, y, z]: [f64; 3], height_unit_m: f64) -> bool {
        let height_m = z * height_unit_m;
        if !(x.abs() < FARTHEST && y.abs() < FARTHEST && height_m.abs() < HIGHEST_M) {
            return false;
        }
        let steps = [x, y].map(|at| (at / self.cell * STEPS_PER_CELL as f64).floor() as i64);
        let shift = STEPS_PER_CELL.trailing_zeros() + u32::from(self.level);
        let cell = steps.map(|step| step >> shift);
        let centre = |cell: i64| (cell << shift) + (1 << (shift - 1));
        let from_centre = [0, 1].map(|axis| steps[axis] - centre(cell[axis]));
        let height = (height_m / HEIGHT_STEP_M).round() as i32;
        let place = cell.map(|cell| (cell & ((1 << TILE_BITS) - 1)) as usize);
        let tile = self.tile(cell.map(|cell| (cell >> TILE_BITS) as i32));
        tile[(place[1] << TILE_BITS) | place[0]].add(found, from_centre, height);
        while self.has_too_many_tiles() {
            self.coarsen();
        }
        true
    }

    fn has_too_many_tiles(&self) -> bool {
        self.tiles.len() + usize::from(self.current.is_some()) > self.max_tiles && self.level < COARSEST
    }

    fn tile(&mut self, at: [i32; 2]) -> &mut CellTile {
        let is_other = |(place, _): &mut ([i32; 2], CellTile)| *place != at;
        if let Some((place, tile)) = self.current.take_if(is_other) {
            self.tiles.insert(place, tile);
        }
        let tiles = &mut self.tiles;
        let current = self.current.get_or_insert_with(|| {
            (at, tiles.remove(&at).unwrap_or_else(|| Box::new([CellSums::default(); TILE_CELLS])))
        });
        &mut current.1
    }

    /// Doubles the cell size.
    fn coarsen(&mut self) {
        let cells = self.take_cells();
        self.level += 1;
        for cell in cells {
            let wide = coarser(cell, self.level);
            let place = [wide.column, wide.row].map(|at| (at & ((1 << TILE_BITS) - 1)) as usize);
            let tile = self.tile([wide.column >> TILE_BITS, wide.row >> TILE_BITS]);
            tile[(place[1] << TILE_BITS) | place[0]].merge(&wide.sums);
        }
    }

    /// Takes all cells with points, in no particular order.
    fn take_cells(&mut self) -> Vec<PlacedCell> {
        let tiles = std::mem::take(&mut self.tiles).into_iter().chain(self.current.take());
        let cells = tiles.flat_map(|([x, y], tile)| {
            let with_points = move |(i, sums): (usize, CellSums)| {
                let [dx, dy] = [i & ((1 << TILE_BITS) - 1), i >> TILE_BITS].map(|at| at as i32);
                let [column, row] = [(x << TILE_BITS) + dx, (y << TILE_BITS) + dy];
                (sums.points > 0).then_some(PlacedCell { column, row, sums })
            };
            (*tile).into_iter().enumerate().filter_map(with_points).collect::<Vec<_>>()
        });
        cells.collect()
    }

    /// Returns the cells with points from north to south, then from west to east.
    pub(super) fn finish(mut self) -> Vec<PlacedCell> {
        let mut cells = self.take_cells();
        cells.sort_unstable_by_key(|cell| (std::cmp::Reverse(cell.row), cell.column));
        cells
    }
}

/// A cell's part of the cell of twice its size, which has this level.
pub(super) fn coarser(cell: PlacedCell, level: u8) -> PlacedCell {
    let half = (STEPS_PER_CELL << level) / 4;
    let from_centre = [cell.column, cell.row].map(|at| if at & 1 == 1 { half } else { -half });
    PlacedCell { column: cell.column >> 1, row: cell.row >> 1, sums: cell.sums.moved(from_centre) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid(max_tiles: usize, points: impl Iterator<Item = [f64; 3]>) -> StripGrid {
        let mut grid = StripGrid { max_tiles, ..StripGrid::new(1.0) };
        points.for_each(|point| assert!(grid.add(&Return::default(), point, 1.0)));
        grid
    }

    fn points() -> Vec<[f64; 3]> {
        let of = |i: u32| {
            let i = f64::from(i);
            [320_000.0 + (i * 37.31) % 400.0, -200.0 + (i * 11.77) % 333.0, 400.0 + (i * 0.37) % 3.0]
        };
        (0..5000).map(of).collect()
    }

    #[test]
    fn larger_cells_do_not_depend_on_the_order_of_points() {
        let forwards = grid(49, points().into_iter());
        let backwards = grid(49, points().into_iter().rev());
        assert_eq!((forwards.level(), backwards.level()), (2, 2));
        let cells = forwards.finish();
        assert_eq!(cells, backwards.finish());
        assert_eq!(cells.iter().map(|cell| cell.sums.points).sum::<u32>(), 5000);
        // The same as cells of that size from the start.
        let mut direct = StripGrid { level: 2, ..StripGrid::new(1.0) };
        points().into_iter().for_each(|point| assert!(direct.add(&Return::default(), point, 1.0)));
        assert_eq!(cells, direct.finish());
    }

    #[test]
    fn cells_are_where_their_points_are() {
        let cells = grid(MAX_TILES, [[3.2, -0.5, 7.0], [3.9, -0.1, 8.0], [-1.0, 5.0, 0.0]].into_iter());
        let cells = cells.finish();
        let places: Vec<[i32; 2]> = cells.iter().map(|cell| [cell.column, cell.row]).collect();
        assert_eq!(places, [[-1, 5], [3, -1]]);
        assert_eq!((cells[1].sums.n, cells[1].sums.lowest, cells[1].sums.highest), (2, 70_000, 80_000));
    }

    #[test]
    fn invalid_coordinates_are_no_points() {
        let mut grid = StripGrid::new(1.0);
        for point in [[f64::NAN, 0.0, 0.0], [0.0, 1e9, 0.0], [0.0, 0.0, f64::INFINITY]] {
            assert!(!grid.add(&Return::default(), point, 1.0));
        }
        assert!(grid.finish().is_empty());
    }
}
