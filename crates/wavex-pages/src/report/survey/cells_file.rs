//! File of a strip's cells (`*_cells.arrow`): Arrow IPC, so other programs can read it.
//!
//! One row per cell with points. Rows are sorted from north to south, then from west to east, in
//! record batches of at most [`ROWS_PER_BATCH`]. The schema's metadata have the version
//! (`wavex.cells`) and the strip's [`StripFacts`] as JSON (`wavex.strip`).

use std::collections::HashMap;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use arrow_array::cast::AsArray;
use arrow_array::types::{Int32Type, Int64Type, UInt32Type};
use arrow_array::{ArrayRef, Int32Array, Int64Array, RecordBatch, UInt32Array};
use arrow_ipc::CompressionType;
use arrow_ipc::writer::{FileWriter, IpcWriteOptions};
use arrow_schema::{ArrowError, DataType, Field, Schema};

use super::cell::CellSums;
use super::grid::{PlacedCell, coarser};
use super::strip::{CollectedStrip, StripFacts};
use wavex_formats::container::TableReader;
use wavex_formats::{Error, Result};
use wavex_line::stage::OutputFile;

/// Version of the layout.
const VERSION: &str = "1";
const VERSION_KEY: &str = "wavex.cells";
const STRIP_KEY: &str = "wavex.strip";
const ROWS_PER_BATCH: usize = 1 << 14;
const REMEDY: &str = "run its strip again with `survey_page`";

/// Columns of 32 bits; the first two are signed.
const SMALL: [&str; 8] = ["column", "row", "reference", "lowest", "highest", "points", "pulses", "n"];
/// Columns of 64 bits: sums over the single returns.
const SUMS: [&str; 9] = ["x", "y", "z", "xx", "xy", "yy", "xz", "yz", "zz"];
/// Number of signed columns of 32 bits.
const SIGNED: usize = 5;

/// Writes the cells of a strip.
///
/// # Errors
/// If the file cannot be written.
pub fn write_cells(strip: &CollectedStrip, mut file: OutputFile) -> Result<PathBuf> {
    let path = file.path().to_owned();
    let written = write(strip, &mut file);
    written.map_err(|error| match error {
        ArrowError::IoError(_, error) => Error::io(&path, "write")(error),
        other => Error::unusable(&path, other.to_string(), "please report this bug in wavex"),
    })?;
    file.finish()?.publish()
}

fn write(strip: &CollectedStrip, file: &mut (impl Write + Send)) -> std::result::Result<(), ArrowError> {
    let facts =
        serde_json::to_string(&strip.facts).map_err(|error| ArrowError::JsonError(error.to_string()))?;
    let small = SMALL.iter().enumerate().map(|(i, name)| {
        Field::new(*name, if i < SIGNED { DataType::Int32 } else { DataType::UInt32 }, false)
    });
    let sums = SUMS.iter().map(|name| Field::new(*name, DataType::Int64, false));
    let metadata = [(VERSION_KEY.to_owned(), VERSION.to_owned()), (STRIP_KEY.to_owned(), facts)];
    let schema =
        Schema::new(small.chain(sums).collect::<Vec<Field>>()).with_metadata(HashMap::from(metadata));
    let schema = Arc::new(schema);
    let options = IpcWriteOptions::default().try_with_compression(Some(CompressionType::ZSTD))?;
    let mut writer = FileWriter::try_new_with_options(file, &schema, options)?;
    for cells in strip.cells.chunks(ROWS_PER_BATCH) {
        writer.write(&RecordBatch::try_new(Arc::clone(&schema), columns(cells))?)?;
    }
    writer.finish()
}

fn columns(cells: &[PlacedCell]) -> Vec<ArrayRef> {
    let signed = |of: &dyn Fn(&PlacedCell) -> i32| -> ArrayRef {
        Arc::new(cells.iter().map(of).collect::<Int32Array>())
    };
    let unsigned = |of: &dyn Fn(&PlacedCell) -> u32| -> ArrayRef {
        Arc::new(cells.iter().map(of).collect::<UInt32Array>())
    };
    let low = |cell: &PlacedCell| cell.sums.lowered(cell.sums.reference());
    let sum = |of: &dyn Fn(&CellSums) -> i64| -> ArrayRef {
        Arc::new(cells.iter().map(|cell| of(&low(cell))).collect::<Int64Array>())
    };
    vec![
        signed(&|cell| cell.column),
        signed(&|cell| cell.row),
        signed(&|cell| cell.sums.reference()),
        signed(&|cell| low(cell).lowest),
        signed(&|cell| low(cell).highest),
        unsigned(&|cell| cell.sums.points),
        unsigned(&|cell| cell.sums.pulses),
        unsigned(&|cell| cell.sums.n),
        sum(&|sums| sums.x),
        sum(&|sums| sums.y),
        sum(&|sums| sums.z),
        sum(&|sums| sums.xx),
        sum(&|sums| sums.xy),
        sum(&|sums| sums.yy),
        sum(&|sums| sums.xz),
        sum(&|sums| sums.yz),
        sum(&|sums| sums.zz),
    ]
}

/// Reads the cells of a strip, row by row from north to south.
pub(super) struct CellsReader {
    path: PathBuf,
    table: TableReader,
    pub(super) facts: StripFacts,
    /// Cells read but not yet returned.
    cells: std::vec::IntoIter<PlacedCell>,
    /// Next cell.
    next: Option<PlacedCell>,
    /// Place of the last cell, to check the order.
    last: Option<(i64, i32)>,
}

impl CellsReader {
    /// Opens the file of a strip.
    ///
    /// # Errors
    /// If it cannot be read or is not such a file.
    pub(super) fn open(path: &Path) -> Result<CellsReader> {
        let table = TableReader::open(path)?;
        let metadata = table.schema().metadata();
        let unusable = |problem: String| Error::unusable(path, problem, REMEDY);
        match metadata.get(VERSION_KEY).map(String::as_str) {
            Some(VERSION) => {}
            None => return Err(unusable("not the cells of a strip".to_owned())),
            Some(other) => return Err(unusable(format!("version {other} of cells is not supported"))),
        }
        let facts = metadata.get(STRIP_KEY).map(String::as_str).unwrap_or_default();
        let facts: StripFacts = serde_json::from_str(facts)
            .map_err(|error| unusable(format!("invalid facts of the strip: {error}")))?;
        let is_size = |value: f64| value.is_finite() && value > 0.0;
        if !is_size(facts.cell) || !is_size(facts.unit_m) || facts.level > 30 {
            return Err(unusable("invalid cell size".to_owned()));
        }
        let mut reader = CellsReader {
            path: path.to_owned(),
            table,
            facts,
            cells: Vec::new().into_iter(),
            next: None,
            last: None,
        };
        reader.step()?;
        Ok(reader)
    }

    /// Row of the next cell at a coarser level.
    pub(super) fn next_row(&self, level: u8) -> Option<i32> {
        self.next.map(|cell| cell.row >> level.saturating_sub(self.facts.level))
    }

    /// Adds the cells of a row at a coarser level to `row`, from west to east.
    ///
    /// # Errors
    /// If the file is damaged.
    pub(super) fn read_row(&mut self, level: u8, row: i32, to: &mut Vec<PlacedCell>) -> Result<()> {
        let first = to.len();
        while self.next_row(level) == Some(row) {
            if let Some(mut cell) = self.next {
                for level in self.facts.level + 1..=level {
                    cell = coarser(cell, level);
                }
                to.push(cell);
            }
            self.step()?;
        }
        if level > self.facts.level {
            let mut merged: Vec<PlacedCell> = to.split_off(first);
            merged.sort_by_key(|cell| cell.column);
            for cell in merged {
                match to.get_mut(first..).and_then(<[_]>::last_mut).filter(|last| last.column == cell.column)
                {
                    Some(last) => last.sums.merge(&cell.sums),
                    None => to.push(cell),
                }
            }
        }
        Ok(())
    }

    /// Moves to the next cell.
    fn step(&mut self) -> Result<()> {
        loop {
            self.next = self.cells.next();
            if let Some(cell) = self.next {
                // Rows fall, columns rise within a row.
                let place = (-i64::from(cell.row), cell.column);
                if self.last.replace(place).is_some_and(|last| last >= place) {
                    let problem = "its cells are not sorted from north to south";
                    return Err(Error::unusable(&self.path, problem, REMEDY));
                }
                let is_inside = self.facts.extent.is_some_and(|[[west, south], [east, north]]| {
                    (west..=east).contains(&cell.column) && (south..=north).contains(&cell.row)
                });
                if !is_inside {
                    let problem = "a cell is outside of the extent of the strip";
                    return Err(Error::unusable(&self.path, problem, REMEDY));
                }
                return Ok(());
            }
            match self.table.next_batch()? {
                Some(batch) => self.cells = self.cells_of(&batch)?.into_iter(),
                None => return Ok(()),
            }
        }
    }

    fn cells_of(&self, batch: &RecordBatch) -> Result<Vec<PlacedCell>> {
        let missing = |name: &str| {
            let problem = format!("column `{name}` is missing or has another type");
            Error::unusable(&self.path, problem, REMEDY)
        };
        let mut signed = Vec::new();
        for name in &SMALL[..SIGNED] {
            let column = batch.column_by_name(name).and_then(|column| column.as_primitive_opt::<Int32Type>());
            signed.push(column.ok_or_else(|| missing(name))?.values());
        }
        let mut unsigned = Vec::new();
        for name in &SMALL[SIGNED..] {
            let column =
                batch.column_by_name(name).and_then(|column| column.as_primitive_opt::<UInt32Type>());
            unsigned.push(column.ok_or_else(|| missing(name))?.values());
        }
        let mut sums = Vec::new();
        for name in &SUMS {
            let column = batch.column_by_name(name).and_then(|column| column.as_primitive_opt::<Int64Type>());
            sums.push(column.ok_or_else(|| missing(name))?.values());
        }
        let cell = |i: usize| {
            let sum = |column: usize| sums[column][i];
            let low = CellSums {
                lowest: signed[3][i],
                highest: signed[4][i],
                points: unsigned[0][i],
                pulses: unsigned[1][i],
                n: unsigned[2][i],
                x: sum(0),
                y: sum(1),
                z: sum(2),
                xx: sum(3),
                xy: sum(4),
                yy: sum(5),
                xz: sum(6),
                yz: sum(7),
                zz: sum(8),
            };
            let sums = low.lowered(signed[2][i].saturating_neg());
            PlacedCell { column: signed[0][i], row: signed[1][i], sums }
        };
        Ok((0..batch.num_rows()).map(cell).collect())
    }
}
