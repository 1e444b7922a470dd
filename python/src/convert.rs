//! Lines of a chain as record batches.

use arrow_array::RecordBatch;
use arrow_schema::{Schema, SchemaRef};
use pyo3::prelude::*;

use wavex::engine::Convert;
use wavex::scan_line::{InputInfo, Kind, ScanLine};
use wavex::stage::{Result, StageError};
use wavex::stages::writers::write_arrow::{shot_batch, shot_schema};
use wavex::stages::writers::write_table::{ROWS_PER_GROUP, ReturnRow, return_batch, return_schema, rows_of};

use crate::errors;

/// Columns of a table to keep; `None` keeps all.
#[derive(Clone, Debug, Default)]
pub struct Columns(Option<Vec<usize>>);

impl Columns {
    /// Finds columns by their names in a schema.
    pub fn of(names: Option<Vec<String>>, schema: &Schema) -> PyResult<Columns> {
        let Some(names) = names else { return Ok(Columns(None)) };
        let find = |name: &String| {
            schema.fields().find(name).map(|(index, _)| index).ok_or_else(|| {
                let known: Vec<&str> = schema.fields().iter().map(|field| field.name().as_str()).collect();
                errors::data(format!("there is no column `{name}`"), format!("columns: {}", known.join(", ")))
            })
        };
        Ok(Columns(Some(names.iter().map(find).collect::<PyResult<_>>()?)))
    }

    /// Columns of the table of shots.
    pub fn of_shots(names: Option<Vec<String>>) -> PyResult<Columns> {
        Columns::of(names, &shot_schema(&InputInfo::default(), false))
    }

    /// Columns of the table of returns.
    pub fn of_returns(names: Option<Vec<String>>) -> PyResult<Columns> {
        Columns::of(names, &return_schema(&InputInfo::default(), false))
    }

    /// Whether a column of this index is kept.
    pub fn has(&self, index: usize) -> bool {
        self.0.as_ref().is_none_or(|kept| kept.contains(&index))
    }

    fn keep(&self, batch: RecordBatch) -> Result<RecordBatch> {
        let Some(kept) = &self.0 else { return Ok(batch) };
        batch.project(kept).map_err(|error| StageError::failed(error.to_string(), "choose other columns"))
    }
}

/// Shots, one batch per scan line.
pub struct Shots {
    columns: Columns,
    schema: Option<SchemaRef>,
}

impl Shots {
    pub fn new(columns: Columns) -> Shots {
        Shots { columns, schema: None }
    }
}

impl Convert for Shots {
    type Item = RecordBatch;

    fn line(&mut self, line: &ScanLine) -> Result<Option<RecordBatch>> {
        let schema = self.schema.get_or_insert_with(|| {
            shot_schema(&line.input, line.blocks().is_some_and(|blocks| blocks.has_fractions()))
        });
        let batch = shot_batch(line, schema).transpose()?;
        batch.map(|batch| self.columns.keep(batch)).transpose()
    }

    fn finish(&mut self) -> Result<Option<RecordBatch>> {
        // A recording without shots still has its columns.
        if self.schema.is_some() {
            return Ok(None);
        }
        let empty = RecordBatch::new_empty(shot_schema(&InputInfo::default(), false));
        self.columns.keep(empty).map(Some)
    }
}

/// Returns, in batches of the row groups of `write_table`.
pub struct Returns {
    columns: Columns,
    schema: Option<SchemaRef>,
    rows: Vec<ReturnRow>,
    has_batches: bool,
}

impl Returns {
    pub fn new(columns: Columns) -> Returns {
        Returns { columns, schema: None, rows: Vec::new(), has_batches: false }
    }

    fn batch(&mut self, rows: &[ReturnRow]) -> Result<RecordBatch> {
        let schema = self.schema.get_or_insert_with(|| return_schema(&InputInfo::default(), false));
        self.has_batches = true;
        self.columns.keep(return_batch(schema, rows)?)
    }
}

impl Convert for Returns {
    type Item = RecordBatch;

    fn line(&mut self, line: &ScanLine) -> Result<Option<RecordBatch>> {
        self.schema.get_or_insert_with(|| return_schema(&line.input, line.kind() == Kind::Points));
        self.rows.extend(rows_of(line));
        if self.rows.len() < ROWS_PER_GROUP {
            return Ok(None);
        }
        let rest = self.rows.split_off(ROWS_PER_GROUP);
        let rows = std::mem::replace(&mut self.rows, rest);
        self.batch(&rows).map(Some)
    }

    fn finish(&mut self) -> Result<Option<RecordBatch>> {
        let rows = std::mem::take(&mut self.rows);
        match rows.is_empty() && self.has_batches {
            true => Ok(None),
            false => self.batch(&rows).map(Some),
        }
    }
}
