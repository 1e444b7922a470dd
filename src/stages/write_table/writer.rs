//! Writes the return table as Arrow IPC, Parquet or CSV.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;

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
use wavex_formats::{Error, Result};

/// Rows buffered before writing: a Parquet row group, or an Arrow record batch.
pub const ROWS_PER_GROUP: usize = 1 << 16;

/// File format of a table.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Format {
    /// Arrow IPC file format, compressed with LZ4.
    Arrow,
    /// Parquet, compressed with ZSTD.
    Parquet,
    /// Text with a header line, commas, and empty fields for null; numbers have enough digits to be
    /// read back exactly.
    Csv,
}

impl Format {
    /// The format of a path's extension, case-insensitive.
    pub fn of(path: &str) -> Option<Format> {
        match Path::new(path).extension()?.to_ascii_lowercase().to_str()? {
            "arrow" => Some(Format::Arrow),
            "parquet" => Some(Format::Parquet),
            "csv" => Some(Format::Csv),
            _ => None,
        }
    }
}

/// Writes a table to `W`. The bytes depend only on the rows and the time scale.
pub struct TableWriter<W: Write + Send> {
    form: Form<W>,
    schema: SchemaRef,
    rows: Vec<Row>,
    file: PathBuf,
}

enum Form<W: Write + Send> {
    Arrow(Box<FileWriter<W>>),
    Parquet(Box<ArrowWriter<W>>),
    Csv(W),
}

impl<W: Write + Send> TableWriter<W> {
    /// Starts a table with a time scale (`week`, `day`, `adjusted`, `unknown`).
    ///
    /// `file` is the name used in errors.
    pub fn new(mut to: W, file: &Path, format: Format, time_scale: &str) -> Result<TableWriter<W>> {
        let schema = columns::schema(time_scale);
        let form = match format {
            Format::Arrow => IpcWriteOptions::default()
                .try_with_compression(Some(CompressionType::LZ4_FRAME))
                .and_then(|options| FileWriter::try_new_with_options(to, &schema, options))
                .map(|writer| Form::Arrow(Box::new(writer))),
            Format::Parquet => ArrowWriter::try_new(to, Arc::clone(&schema), Some(properties(&schema)))
                .map(|writer| Form::Parquet(Box::new(writer)))
                .map_err(arrow_error),
            Format::Csv => to
                .write_all(columns::csv_header().as_bytes())
                .map(|()| Form::Csv(to))
                .map_err(ArrowError::from),
        };
        let form = form.map_err(|error| failed(file, error))?;
        Ok(TableWriter { form, schema, rows: Vec::new(), file: file.to_path_buf() })
    }

    /// Adds a return.
    pub fn push(&mut self, row: Row) -> Result<()> {
        self.rows.push(row);
        if self.rows.len() >= ROWS_PER_GROUP { self.write_rows() } else { Ok(()) }
    }

    /// Writes the buffered rows.
    fn write_rows(&mut self) -> Result<()> {
        let rows = std::mem::take(&mut self.rows);
        let batch = || columns::record_batch(&self.schema, &rows);
        let written = match &mut self.form {
            Form::Arrow(writer) => batch().and_then(|batch| writer.write(&batch)),
            Form::Csv(to) => to.write_all(columns::csv(&rows).as_bytes()).map_err(ArrowError::from),
            Form::Parquet(writer) => batch()
                .and_then(|batch| writer.write(&batch).and_then(|()| writer.flush()).map_err(arrow_error)),
        };
        self.rows = rows;
        self.rows.clear();
        written.map_err(|error| failed(&self.file, error))
    }

    /// Writes the remaining rows and the footer, and returns the writer.
    pub fn finish(mut self) -> Result<W> {
        if !self.rows.is_empty() {
            self.write_rows()?;
        }
        match self.form {
            Form::Arrow(writer) => writer.into_inner(),
            Form::Parquet(writer) => writer.into_inner().map_err(arrow_error),
            Form::Csv(to) => Ok(to),
        }
        .map_err(|error| failed(&self.file, error))
    }
}

/// Writer properties. Dictionaries are off: few numbers repeat, and ZSTD finds those that do. The
/// metadata is also stored in the file itself, for readers that ignore the Arrow schema.
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
        other => Error::unusable(file, other.to_string(), "write the table in another format"),
    }
}
