//! First difference of two Arrow or Parquet files: row and column.

use std::path::Path;

use arrow_array::{Array, RecordBatch};
use arrow_schema::Schema;
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;

use super::instead;
use wavex_formats::container::TableReader;
use wavex_formats::{Error, Result, regular_file};

const REMEDY: &str = "open it with another program to find the problem";
/// Start of the Parquet library's message for a compression that is not built in.
const NOT_BUILT_IN: &str = "Disabled feature";
/// Maximum number of Parquet rows decoded at once.
const MOST_ROWS_AT_ONCE: usize = 1 << 16;

pub(super) fn compare_parquet(then: &Path, now: &Path) -> Result<Option<String>> {
    compare(parquet(then)?, parquet(now)?)
}

pub(super) fn compare_arrow(then: &Path, now: &Path) -> Result<Option<String>> {
    compare(arrow(then)?, arrow(now)?)
}

/// Error for a Parquet file that cannot be read.
pub(super) fn unreadable(path: &Path, error: &dyn std::fmt::Display) -> Error {
    let error = error.to_string();
    if error.contains(NOT_BUILT_IN) {
        let problem = "its compression method is not supported by wavex: rows are not compared";
        return Error::unusable(
            path,
            problem,
            "save it with zstd, snappy or no compression and compare again",
        );
    }
    Error::unusable(path, error, REMEDY)
}

fn parquet(path: &Path) -> Result<TableRows> {
    let file = regular_file(path)?;
    let builder = ParquetRecordBatchReaderBuilder::try_new(file).map_err(|error| unreadable(path, &error))?;
    let schema = Schema::clone(builder.schema());
    let mut reader =
        builder.with_batch_size(MOST_ROWS_AT_ONCE).build().map_err(|error| unreadable(path, &error))?;
    let path = path.to_path_buf();
    let next = move || reader.next().transpose().map_err(|error| unreadable(&path, &error));
    Ok(TableRows { schema, next: Box::new(next), batch: None })
}

fn arrow(path: &Path) -> Result<TableRows> {
    let mut reader = TableReader::open(path)?;
    Ok(TableRows {
        schema: reader.schema().clone(),
        next: Box::new(move || reader.next_batch()),
        batch: None,
    })
}

/// Rows of a file, read batch by batch.
struct TableRows {
    schema: Schema,
    next: Box<dyn FnMut() -> Result<Option<RecordBatch>>>,
    /// Remaining rows of the current batch.
    batch: Option<RecordBatch>,
}

impl TableRows {
    /// Number of available rows; 0 at the end.
    fn at_hand(&mut self) -> Result<usize> {
        while self.batch.as_ref().is_none_or(|batch| batch.num_rows() == 0) {
            match (self.next)()? {
                None => return Ok(0),
                found => self.batch = found,
            }
        }
        Ok(self.batch.as_ref().map_or(0, RecordBatch::num_rows))
    }

    /// Takes the next rows, at most as many as are available.
    fn take(&mut self, rows: usize) -> Option<RecordBatch> {
        let batch = self.batch.take()?;
        let taken = batch.slice(0, rows);
        self.batch = Some(batch.slice(rows, batch.num_rows() - rows));
        Some(taken)
    }
}

fn compare(mut then: TableRows, mut now: TableRows) -> Result<Option<String>> {
    let (was, is) = (then.schema.clone(), now.schema.clone());
    let columns = |schema: &Schema| -> Vec<String> {
        schema.fields().iter().map(|field| format!("{} {}", field.name(), field.data_type())).collect()
    };
    let (columns_then, columns_now) = (columns(&was), columns(&is));
    if columns_then != columns_now {
        let names = |columns: &[String]| format!("the columns {}", columns.join(", "));
        return Ok(Some(format!("it has {}", instead(&names(&columns_now), &names(&columns_then)))));
    }
    let mut row = 0;
    loop {
        let (left, right) = (then.at_hand()?, now.at_hand()?);
        match (left, right) {
            (0, 0) => break,
            (_, 0) => return Ok(Some(format!("it ends before row {row}"))),
            (0, _) => return Ok(Some(format!("it continues with row {row}"))),
            _ => {}
        }
        let rows = left.min(right);
        let (Some(a), Some(b)) = (then.take(rows), now.take(rows)) else { break };
        if let Some((at, column, then, now)) = first_cell(&a, &b) {
            return Ok(Some(format!("row {}, column {column}: {}", row + at, instead(&now, &then))));
        }
        row += rows;
    }
    let (was, is) = (was.metadata(), is.metadata());
    let key = was.keys().chain(is.keys()).filter(|key| was.get(key) != is.get(key)).min();
    let of_file = key.map(|key| format!("metadata, key {key}"));
    Ok(of_file.or_else(|| column_besides(&then.schema, &now.schema)))
}

/// First column whose schema differs in more than name and type.
fn column_besides(then: &Schema, now: &Schema) -> Option<String> {
    let mut columns = then.fields().iter().zip(now.fields().iter());
    let (column, _) = columns.find(|(then, now)| then != now)?;
    Some(format!("schema of the column {}", column.name()))
}

/// First row and column in which two batches of equal length differ, with both values.
fn first_cell(then: &RecordBatch, now: &RecordBatch) -> Option<(usize, String, String, String)> {
    let schema = then.schema();
    let columns = schema.fields().iter().zip(then.columns().iter().zip(now.columns()));
    let differing = columns.filter_map(|(field, (a, b))| Some((first_row(a, b)?, field.name(), a, b)));
    let (row, name, a, b) = differing.min_by_key(|(row, ..)| *row)?;
    Some((row, name.clone(), value(a, row), value(b, row)))
}

/// First row in which two columns differ, by bisection.
fn first_row(a: &dyn Array, b: &dyn Array) -> Option<usize> {
    if a.to_data() == b.to_data() {
        return None;
    }
    let (mut same, mut different) = (0, a.len());
    while different - same > 1 {
        let middle = same + (different - same) / 2;
        let count = middle - same;
        if a.slice(same, count).to_data() == b.slice(same, count).to_data() {
            same = middle;
        } else {
            different = middle;
        }
    }
    Some(same)
}

/// Formats a value: the text that Arrow prints for a one-element array.
fn value(column: &dyn Array, row: usize) -> String {
    let text = format!("{:?}", column.slice(row, 1));
    let inner = text
        .split_once('[')
        .and_then(|(_, rest)| rest.rsplit_once(']'))
        .map_or(text.as_str(), |(inner, _)| inner);
    let words: Vec<&str> = inner.split_whitespace().collect();
    words.join(" ").trim_end_matches(',').to_owned()
}
