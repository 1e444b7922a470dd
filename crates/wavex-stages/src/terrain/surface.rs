//! Highest first returns of an area in a temporary file.

use std::io;
use std::path::Path;

use wavex_ground::terrain::CellRange;

use super::points::{Square, square_of, squares_within};
use super::spool::{Spool, SpoolBuffers};

/// Bytes of a point: column, row, height.
const RECORD_BYTES: usize = 8 + 8 + 4;

/// First returns of an area: their cells and heights.
pub struct SurfacePoints {
    cell_m: f64,
    spool: Spool<Square>,
}

impl SurfacePoints {
    /// No points; the temporary file is in `folder` and ends with this.
    ///
    /// # Errors
    /// The file cannot be created.
    pub fn new(folder: &Path, cell_m: f64) -> io::Result<SurfacePoints> {
        Ok(SurfacePoints { cell_m, spool: Spool::new(folder, RECORD_BYTES)? })
    }

    /// Adds a first return; points without a position are left out.
    ///
    /// # Errors
    /// The temporary file cannot be written.
    pub fn push(&self, buffers: &mut SpoolBuffers<Square>, position_m: [f64; 3]) -> io::Result<()> {
        if !position_m.iter().all(|x| x.is_finite()) {
            return Ok(());
        }
        let [column, row] = [0, 1].map(|i| (position_m[i] / self.cell_m).floor() as i64);
        let mut record = [0; RECORD_BYTES];
        record[..8].copy_from_slice(&column.to_le_bytes());
        record[8..16].copy_from_slice(&row.to_le_bytes());
        record[16..].copy_from_slice(&(position_m[2] as f32).to_le_bytes());
        buffers.push(&self.spool, square_of(&position_m), &record)
    }

    /// Writes the points that are still in `buffers`.
    ///
    /// # Errors
    /// The temporary file cannot be written.
    pub fn flush(&self, buffers: &mut SpoolBuffers<Square>) -> io::Result<()> {
        buffers.flush(&self.spool)
    }

    /// First and last column and row of the cells with points; `None` without points.
    ///
    /// # Errors
    /// The temporary file cannot be read.
    pub(super) fn extent(&self) -> io::Result<Option<[[i64; 2]; 2]>> {
        let mut extent: Option<[[i64; 2]; 2]> = None;
        for square in self.spool.keys() {
            self.spool.read(square, |record| {
                let Some((cell, _)) = parsed(record) else { return };
                let [low, high] = extent.get_or_insert([cell, cell]);
                for axis in 0..2 {
                    low[axis] = low[axis].min(cell[axis]);
                    high[axis] = high[axis].max(cell[axis]);
                }
            })?;
        }
        Ok(extent)
    }

    /// Largest height of each cell, row by row from the north-west, m; NaN: no point.
    ///
    /// # Errors
    /// The temporary file cannot be read.
    pub(super) fn highest(&self, cells: CellRange) -> io::Result<Vec<f32>> {
        let mut highest = vec![f32::NAN; cells.columns * cells.rows];
        let south_row = cells.north_row + 1 - cells.rows as i64;
        let low = [cells.first_column, south_row].map(|i| i as f64 * self.cell_m);
        let size = [cells.columns, cells.rows].map(|n| n as f64 * self.cell_m);
        for square in squares_within(low, [low[0] + size[0], low[1] + size[1]]) {
            self.spool.read(square, |record| {
                let Some(([column, row], height_m)) = parsed(record) else { return };
                let at = [column - cells.first_column, cells.north_row - row].map(usize::try_from);
                if let [Ok(column), Ok(row)] = at
                    && column < cells.columns
                    && row < cells.rows
                {
                    let of_cell = &mut highest[row * cells.columns + column];
                    // The maximum of NaN and a number is the number.
                    *of_cell = of_cell.max(height_m);
                }
            })?;
        }
        Ok(highest)
    }
}

/// Column and row, and height, m.
fn parsed(record: &[u8]) -> Option<(Square, f32)> {
    let (column, rest) = record.split_first_chunk()?;
    let (row, rest) = rest.split_first_chunk()?;
    let height = f32::from_le_bytes(*rest.first_chunk()?);
    Some(([i64::from_le_bytes(*column), i64::from_le_bytes(*row)], height))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_highest_of_a_cell_is_found_whatever_the_squares() {
        // Cells of 3 m: the cell from 126 to 129 m lies in two squares.
        let surface = SurfacePoints::new(&std::env::temp_dir(), 3.0).unwrap();
        let mut buffers = SpoolBuffers::default();
        let points = [[127.9, 1.0, 5.0], [128.1, 1.0, 9.0], [130.0, 1.0, 4.0], [f64::INFINITY, 0.0, 0.0]];
        for point in points {
            surface.push(&mut buffers, point).unwrap();
        }
        surface.flush(&mut buffers).unwrap();
        assert_eq!(surface.extent().unwrap(), Some([[42, 0], [43, 0]]));
        let cells = CellRange { first_column: 41, north_row: 1, columns: 3, rows: 2 };
        let found = surface.highest(cells).unwrap();
        assert!(found[..4].iter().all(|height| height.is_nan()));
        assert_eq!(found[4..], [9.0, 4.0]);
    }
}
