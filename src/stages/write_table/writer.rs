//! A table of returns as Arrow IPC, Parquet or CSV.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use arrow_array::RecordBatch;
use arrow_ipc::CompressionType;
use arrow_ipc::writer::{FileWriter, IpcWriteOptions};
use arrow_schema::{ArrowError, SchemaRef};
use parquet::arrow::ArrowWriter;
use parquet::basic::{Compression, ZstdLevel};
use parquet::errors::ParquetError;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::columns::{self, Row};
use crate::formats::{Error, Result};

/// How many returns are held before they are written: a row group of Parquet, a record batch of Arrow.
pub const ROWS_PER_GROUP: usize = 1 << 16;

/// The format of a table.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Format {
    /// Arrow IPC in the file format, packed with LZ4.
    Arrow,
    /// Parquet, packed with ZSTD.
    Parquet,
    /// Text: a header line, commas, nothing for a null, each number with the digits that give it back to the bit.
    Csv,
}

impl Format {
    /// The format that a path's extension names, in any case.
    pub fn of(path: &str) -> Option<Format> {
        match Path::new(path).extension()?.to_ascii_lowercase().to_str()? {
            "arrow" => Some(Format::Arrow),
            "parquet" => Some(Format::Parquet),
            "csv" => Some(Format::Csv),
            _ => None,
        }
    }
}

/// A table that is being written to `W`. The bytes depend on the rows and on the time scale alone.
pub struct TableWriter<W: Write + Send> {
    form: Form<W>,
    schema: SchemaRef,
    rows: Vec<Row>,
    file: PathBuf,
}

enum Form<W: Write + Send> {
    Arrow(Box<FileWriter<W>>),
    Parquet(Box<ArrowWriter<W>>),
    /// And whether the header line is written.
    Csv(W, bool),
}

impl<W: Write + Send> TableWriter<W> {
    /// Begins a table whose times count `time_scale` (`week`, `day`, `adjusted`, `unknown`); `file` is its name, for
    /// errors.
    pub fn new(to: W, file: &Path, format: Format, time_scale: &str) -> Result<TableWriter<W>> {
        let schema = columns::schema(time_scale);
        let form = match format {
            Format::Arrow => IpcWriteOptions::default()
                .try_with_compression(Some(CompressionType::LZ4_FRAME))
                .and_then(|options| FileWriter::try_new_with_options(to, &schema, options))
                .map(|writer| Form::Arrow(Box::new(writer))),
            Format::Parquet => ArrowWriter::try_new(to, Arc::clone(&schema), Some(properties(&schema)))
                .map(|writer| Form::Parquet(Box::new(writer)))
                .map_err(arrow_error),
            Format::Csv => Ok(Form::Csv(to, false)),
        };
        let form = form.map_err(|error| failed(file, error))?;
        let mut table = TableWriter { form, schema, rows: Vec::new(), file: file.to_path_buf() };
        if format == Format::Csv {
            // The header line comes with the first rows, even where there are none.
            table.write_rows()?;
        }
        Ok(table)
    }

    /// Adds a return.
    pub fn push(&mut self, row: Row) -> Result<()> {
        self.rows.push(row);
        if self.rows.len() >= ROWS_PER_GROUP { self.write_rows() } else { Ok(()) }
    }

    /// Writes the rows that were held.
    fn write_rows(&mut self) -> Result<()> {
        let batch = columns::record_batch(&self.schema, &self.rows);
        self.rows.clear();
        batch
            .and_then(|batch| match &mut self.form {
                Form::Arrow(writer) => writer.write(&batch),
                Form::Csv(to, has_header) => {
                    let header = !std::mem::replace(has_header, true);
                    to.write_all(&csv(&batch, header)?).map_err(ArrowError::from)
                }
                Form::Parquet(writer) => {
                    writer.write(&batch).and_then(|()| writer.flush()).map_err(arrow_error)
                }
            })
            .map_err(|error| failed(&self.file, error))
    }

    /// Writes what is left and what stands at the end, and gives back what was written to.
    pub fn finish(mut self) -> Result<W> {
        if !self.rows.is_empty() {
            self.write_rows()?;
        }
        match self.form {
            Form::Arrow(writer) => writer.into_inner(),
            Form::Parquet(writer) => writer.into_inner().map_err(arrow_error),
            Form::Csv(to, _) => Ok(to),
        }
        .map_err(|error| failed(&self.file, error))
    }
}

/// Rows as text. They are made in memory because the writer's own errors do not keep those of the system.
fn csv(batch: &RecordBatch, header: bool) -> std::result::Result<Vec<u8>, ArrowError> {
    let mut writer = arrow_csv::WriterBuilder::new().with_header(header).build(Vec::new());
    writer.write(batch)?;
    Ok(writer.into_inner())
}

/// Dictionaries are off: hardly a number of a table occurs twice, and ZSTD finds those that do. The metadata stands
/// in the file itself, too, for readers that do not know Arrow's schema.
fn properties(schema: &SchemaRef) -> WriterProperties {
    let metadata = schema.metadata().iter();
    let metadata = metadata.map(|(key, value)| KeyValue::new(key.clone(), value.clone())).collect();
    let level = ZstdLevel::default();
    WriterProperties::builder()
        .set_compression(Compression::ZSTD(level))
        .set_dictionary_enabled(false)
        .set_key_value_metadata(Some(metadata))
        .set_max_row_group_row_count(Some(ROWS_PER_GROUP))
        .set_created_by(concat!("wavex ", env!("CARGO_PKG_VERSION")).to_string())
        .build()
}

fn arrow_error(error: ParquetError) -> ArrowError {
    match error {
        ParquetError::External(source) => match source.downcast::<std::io::Error>() {
            Ok(source) => ArrowError::from(*source),
            Err(other) => ArrowError::ExternalError(other),
        },
        other => ArrowError::ParquetError(other.to_string()),
    }
}

fn failed(file: &Path, error: ArrowError) -> Error {
    match error {
        ArrowError::IoError(_, source) => Error::io(file, "write")(source),
        // The columns are such as CSV can hold: what fails is the disk, of which only the words come through.
        ArrowError::CsvError(words) => Error::io(file, "write")(std::io::Error::other(words)),
        other => Error::unusable(file, other.to_string(), "write the table in another format"),
    }
}
