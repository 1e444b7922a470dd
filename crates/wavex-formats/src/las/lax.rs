//! LASzip's spatial index (LAX): the points of each quadtree cell.
//!
//! LAStools write it to a `.lax` file next to the points, or append it to them. All numbers are
//! little-endian. The file has `LASX`, a version, and three parts, each with its version (0):
//!
//! | part | content |
//! |---|---|
//! | `LASS` | kind of the index: 0, a quadtree |
//! | `LASQ` | levels, two unused numbers, then as `f32` smallest and largest x, smallest and largest y of the root |
//! | `LASV` | number of cells; of each its index, number of intervals, number of points, and the intervals: first and last point |
//!
//! The index of a cell is the number of cells of all coarser levels plus its position in its level
//! in quadtree order: two bits per level from the root on, bit 0 for the right half, bit 1 for the
//! upper half. LASzip bisects in `f32`. Cell lengths are therefore powers of two and cells begin at
//! multiples of their length, so `f32` represents every border exactly.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Largest gap that is read instead of skipped, points.
///
/// As in LAStools.
const GAP: u32 = 1000;
/// Maximum number of intervals.
///
/// Beyond it, the cell length is doubled.
const MOST_INTERVALS: usize = 1 << 17;
/// Maximum depth of the quadtree: 4096 cells along each axis.
const MOST_LEVELS: u32 = 12;
/// Initial cell length, coordinate steps: 16 m at 1 mm.
///
/// It is rounded down to a power of two.
const FIRST_CELL_STEPS: f64 = 16_384.0;
/// Largest cell number; `f32` represents integers exactly up to here.
const MOST_CELLS_FROM_ZERO: i64 = 1 << 24;

/// User ID of the record of an appended index.
pub(super) const USER_ID: &str = "LAStools";
/// Record ID of an appended index.
pub(super) const RECORD_ID: u16 = 30;

/// Returns the paths where LASzip looks for an index (`LASindex::read`).
///
/// LASzip follows the case of the point file's own extension; the file may not exist.
pub fn beside(points: &Path) -> [PathBuf; 2] {
    ["lax", "LAX"].map(|extension| points.with_extension(extension))
}

/// Index builder; bounds memory by enlarging cells.
#[derive(Debug)]
pub(super) struct Lax {
    /// Cell length: a power of two, in units of the coordinates.
    cell_length: f64,
    cells: BTreeMap<GridCell, IndexCell>,
    n_intervals: usize,
    most_intervals: usize,
    /// Current run of consecutive points in one cell.
    run: Option<CellRun>,
    n_points: u64,
}

/// Column and row of a cell, relative to zero coordinates.
type GridCell = (i64, i64);

#[derive(Debug, Default, PartialEq)]
struct IndexCell {
    points: u32,
    /// First and last point of each interval, in order.
    intervals: Vec<(u32, u32)>,
}

/// Consecutive points in one cell.
#[derive(Debug, Clone, Copy)]
struct CellRun {
    place: GridCell,
    first: u32,
    last: u32,
}

impl Lax {
    /// Creates an index for points with this coordinate step.
    pub(super) fn new(coordinate_step: f64) -> Lax {
        let cell_length = (coordinate_step * FIRST_CELL_STEPS).log2().floor().exp2();
        Lax {
            cell_length,
            cells: BTreeMap::new(),
            n_intervals: 0,
            most_intervals: MOST_INTERVALS,
            run: None,
            n_points: 0,
        }
    }

    /// Adds the next point of the file.
    pub(super) fn add(&mut self, x: f64, y: f64) {
        let point = u32::try_from(self.n_points);
        self.n_points += 1;
        let Ok(point) = point else { return };
        match &mut self.run {
            Some(run) if run.place == place(x, y, self.cell_length) => run.last = point,
            _ => {
                // `end_run` may change the cell length.
                self.end_run();
                self.run = Some(CellRun { place: place(x, y, self.cell_length), first: point, last: point });
            }
        }
    }

    /// Adds the current run to its cell.
    fn end_run(&mut self) {
        let Some(run) = self.run.take() else { return };
        let cell = self.cells.entry(run.place).or_default();
        cell.points += run.last - run.first + 1;
        match cell.intervals.last_mut() {
            Some(last) if run.first - last.1 <= GAP => last.1 = run.last,
            _ => {
                cell.intervals.push((run.first, run.last));
                self.n_intervals += 1;
            }
        }
        while self.n_intervals > self.most_intervals && self.cells.len() > 1 {
            self.coarsen();
        }
    }

    /// Doubles the cell length.
    fn coarsen(&mut self) {
        self.cell_length *= 2.0;
        let mut coarse: BTreeMap<GridCell, IndexCell> = BTreeMap::new();
        for ((column, row), cell) in std::mem::take(&mut self.cells) {
            let into = coarse.entry((column >> 1, row >> 1)).or_default();
            into.points += cell.points;
            into.intervals.extend(cell.intervals);
        }
        coarse.values_mut().for_each(IndexCell::join);
        self.n_intervals = coarse.values().map(|cell| cell.intervals.len()).sum();
        self.cells = coarse;
    }

    /// Encodes the index.
    ///
    /// `None` for more points than 32 bits can count.
    pub(super) fn finish(mut self) -> Option<Vec<u8>> {
        if self.n_points > u64::from(u32::MAX) {
            return None;
        }
        self.end_run();
        while !self.fits_a_tree() {
            self.coarsen();
        }
        let (low, high) = self.corners();
        let widest = (high.0 - low.0).max(high.1 - low.1) + 1;
        let levels = u64::BITS - (widest as u64 - 1).leading_zeros();
        let levels = levels.max(1);
        let side = 1i64 << levels;
        let border = |cells: i64| (cells as f64 * self.cell_length) as f32;
        let mut out = Vec::with_capacity(64 + 12 * self.cells.len() + 8 * self.n_intervals);
        out.extend(b"LASX\0\0\0\0LASS\0\0\0\0LASQ\0\0\0\0");
        [levels, 0, 0].into_iter().for_each(|number| out.extend(number.to_le_bytes()));
        for border in [border(low.0), border(low.0 + side), border(low.1), border(low.1 + side)] {
            out.extend(border.to_le_bytes());
        }
        out.extend(b"LASV\0\0\0\0");
        out.extend((self.cells.len() as u32).to_le_bytes());
        let mut cells: Vec<(u32, &IndexCell)> = self
            .cells
            .iter()
            .map(|((column, row), cell)| (index(levels, column - low.0, row - low.1), cell))
            .collect();
        cells.sort_unstable_by_key(|(index, _)| *index);
        for (index, cell) in cells {
            [index, cell.intervals.len() as u32, cell.points]
                .into_iter()
                .chain(cell.intervals.iter().flat_map(|(first, last)| [*first, *last]))
                .for_each(|number| out.extend(number.to_le_bytes()));
        }
        Some(out)
    }

    /// Returns whether a quadtree can represent the cells.
    ///
    /// The depth is within the limit, and `f32` represents all cell borders.
    fn fits_a_tree(&self) -> bool {
        let (low, high) = self.corners();
        let most = 1i64 << MOST_LEVELS;
        let is_small = high.0.saturating_sub(low.0) < most && high.1.saturating_sub(low.1) < most;
        let reach = MOST_CELLS_FROM_ZERO - most;
        is_small && [low.0, low.1, high.0, high.1].iter().all(|place| place.saturating_abs() <= reach)
    }

    /// Returns the smallest and largest column and row in use.
    fn corners(&self) -> (GridCell, GridCell) {
        let mut places = self.cells.keys().copied();
        let Some(first) = places.next() else { return ((0, 0), (0, 0)) };
        places.fold((first, first), |(low, high), place| {
            ((low.0.min(place.0), low.1.min(place.1)), (high.0.max(place.0), high.1.max(place.1)))
        })
    }
}

fn place(x: f64, y: f64, cell_length: f64) -> GridCell {
    // Float-to-integer casts clamp.
    ((x / cell_length).floor() as i64, (y / cell_length).floor() as i64)
}

impl IndexCell {
    /// Sorts the intervals and joins those with small gaps.
    ///
    /// Intervals of different cells may overlap, because gaps that are read may hold points of
    /// other cells.
    fn join(&mut self) {
        self.intervals.sort_unstable();
        self.intervals.dedup_by(|next, before| {
            let near = next.0 <= before.1.saturating_add(GAP);
            if near {
                before.1 = before.1.max(next.1);
            }
            near
        });
    }
}

/// Returns the index of a cell of the finest level.
fn index(levels: u32, column: i64, row: i64) -> u32 {
    // 4^0 + 4^1 + ... + 4^(levels - 1).
    let coarser = ((1u32 << (2 * levels)) - 1) / 3;
    let place = (0..levels).fold(0u32, |place, level| {
        let bit = |number: i64| (number >> level & 1) as u32;
        place | bit(column) << (2 * level) | bit(row) << (2 * level + 1)
    });
    coarser + place
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn of(points: &[(f64, f64)]) -> Lax {
        let mut lax = Lax::new(0.001);
        points.iter().for_each(|(x, y)| lax.add(*x, *y));
        lax
    }

    #[test]
    fn an_index_is_spelled_out() {
        let mut points = vec![(500_000.0, 5_000_000.0); 3];
        points.extend([(500_016.0, 4_999_999.0), (500_000.0, 5_000_001.0), (500_047.9, 5_000_000.0)]);
        let mut expected = b"LASX\0\0\0\0LASS\0\0\0\0LASQ\0\0\0\0".to_vec();
        [2u32, 0, 0].iter().for_each(|number| expected.extend(number.to_le_bytes()));
        let borders = [500_000f32, 500_064.0, 4_999_984.0, 5_000_048.0];
        borders.iter().for_each(|border| expected.extend(border.to_le_bytes()));
        expected.extend(b"LASV\0\0\0\0");
        // Five cells are coarser. In the next level (column 1, row 0) is the lower right of the
        // lower left, and so on.
        let cells = [vec![5 + 1, 1, 1, 3, 3], vec![5 + 2, 1, 4, 0, 4], vec![5 + 6, 1, 1, 5, 5]];
        expected.extend((cells.len() as u32).to_le_bytes());
        cells.iter().flatten().for_each(|number: &u32| expected.extend(number.to_le_bytes()));
        assert_eq!(of(&points).finish().unwrap(), expected);
    }

    #[test]
    fn no_points_are_an_index_without_cells() {
        let bytes = of(&[]).finish().unwrap();
        assert_eq!(bytes.len(), 64);
        assert_eq!(bytes[60..], [0; 4]);
    }

    #[test]
    fn far_intervals_stay_apart() {
        let mut points = vec![(0.0, 0.0)];
        points.extend(vec![(100.0, 0.0); 1000]);
        points.push((0.0, 0.0));
        points.extend(vec![(100.0, 0.0); 999]);
        points.push((0.0, 0.0));
        let lax = of(&points);
        let first = lax.cells.values().next().unwrap();
        assert_eq!(first.intervals, [(0, 0), (1001, 1001)]);
        let found = read(&lax.finish().unwrap());
        assert_eq!(found.cells[0], (found.cells[0].0, 3, vec![(0, 0), (1001, 2001)]));
    }

    #[test]
    fn more_points_than_can_be_named_are_no_index() {
        let mut lax = Lax { n_points: u64::from(u32::MAX) - 1, ..Lax::new(1.0) };
        lax.add(0.0, 0.0);
        assert_eq!(read(&lax.finish().unwrap()).cells[0].2, [(u32::MAX - 1, u32::MAX - 1)]);
        let mut lax = Lax { n_points: u64::from(u32::MAX), ..Lax::new(1.0) };
        lax.add(0.0, 0.0);
        assert_eq!(lax.finish(), None);
    }

    #[test]
    fn memory_is_bounded_by_larger_cells() {
        let mut lax = Lax { most_intervals: 128, ..Lax::new(0.001) };
        for i in 0..200_000u32 {
            lax.add(f64::from(i % 2000), f64::from(i / 2000) * 30.0);
            assert!(lax.n_intervals <= 128);
        }
        assert!(lax.cell_length > 16.0 && lax.cells.len() > 1);
        let points: u32 = read(&lax.finish().unwrap()).cells.iter().map(|cell| cell.1).sum();
        assert_eq!(points, 200_000);
    }

    /// Decoded index.
    struct DecodedIndex {
        levels: u32,
        root: [f32; 4],
        cells: Vec<DecodedCell>,
    }

    /// Index, points, intervals.
    type DecodedCell = (u32, u32, Vec<(u32, u32)>);

    fn read(bytes: &[u8]) -> DecodedIndex {
        let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
        let mut at = 64;
        let mut next = || {
            at += 4;
            word(at - 4)
        };
        let cells = (0..word(60)).map(|_| {
            let (index, intervals, points) = (next(), next(), next());
            (index, points, (0..intervals).map(|_| (next(), next())).collect())
        });
        let cells = cells.collect();
        assert_eq!(at, bytes.len());
        DecodedIndex { levels: word(24), root: [36, 40, 44, 48].map(|at| f32::from_bits(word(at))), cells }
    }

    impl DecodedIndex {
        /// Finds the cell of a position as LASzip does.
        ///
        /// By bisection in `f32`.
        fn cell_of(&self, x: f64, y: f64) -> u32 {
            let [mut x0, mut x1, mut y0, mut y1] = self.root;
            assert!(f64::from(x0) <= x && x < f64::from(x1) && f64::from(y0) <= y && y < f64::from(y1));
            let mut place = 0;
            for _ in 0..self.levels {
                let (x_mid, y_mid) = ((x0 + x1) / 2.0, (y0 + y1) / 2.0);
                place <<= 2;
                if x < f64::from(x_mid) {
                    x1 = x_mid;
                } else {
                    x0 = x_mid;
                    place |= 1;
                }
                if y < f64::from(y_mid) {
                    y1 = y_mid;
                } else {
                    y0 = y_mid;
                    place |= 2;
                }
            }
            (0..self.levels).map(|level| 4u32.pow(level)).sum::<u32>() + place
        }
    }

    proptest! {
        #[test]
        fn every_point_is_in_an_interval_of_its_cell(
            start in (-1e7..1e7f64, -1e7..1e7f64),
            gaps in prop::collection::vec((-900.0..1000.0f64, -900.0..1000.0f64), 1..300),
            step in prop::sample::select(vec![1e-7f64, 0.001, 0.01, 0.25]),
        ) {
            let stretch: f64 = step * 1000.0;
            let mut at = (start.0 * stretch.min(1.0), start.1 * stretch.min(1.0));
            let mut lax = Lax { most_intervals: 40, ..Lax::new(step) };
            let mut points = Vec::new();
            for (x, y) in gaps {
                at = (at.0 + x * stretch, at.1 + y * stretch);
                lax.add(at.0, at.1);
                points.push(at);
            }
            let found = read(&lax.finish().unwrap());
            prop_assert!(found.cells.is_sorted_by(|a, b| a.0 < b.0));
            prop_assert_eq!(found.cells.iter().map(|cell| cell.1 as usize).sum::<usize>(), points.len());
            for (number, (x, y)) in points.into_iter().enumerate() {
                let index = found.cell_of(x, y);
                let cell = found.cells.iter().find(|cell| cell.0 == index).expect("a cell of its own");
                let number = number as u32;
                prop_assert!(cell.2.iter().any(|interval| interval.0 <= number && number <= interval.1));
            }
        }
    }
}
