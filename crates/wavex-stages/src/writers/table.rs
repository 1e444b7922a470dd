//! Tables as Arrow IPC, Parquet or CSV.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use arrow_array::RecordBatch;
use arrow_ipc::CompressionType;
use arrow_schema::{ArrowError, SchemaRef};
use parquet::arrow::ArrowWriter;
use parquet::basic::{Compression, ZstdLevel};
use parquet::errors::ParquetError;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::{EnabledStatistics, WriterProperties};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::container_info::time_scale_of;
use geo::GeoParquetColumn;
use wavex_formats::Error;
use wavex_formats::container::IpcWriter;
use wavex_formats::extensions::has_extension;
use wavex_line::keys::InvalidKey;
use wavex_line::scan_line::InputInfo;
use wavex_line::stage::{self, Context, OutputFile, RunContext, StageError};

mod geo;

type Result<T, E = Error> = std::result::Result<T, E>;

/// Rows buffered before writing: a Parquet row group, or an Arrow record batch.
pub const ROWS_PER_GROUP: usize = 1 << 16;

/// File format of a table.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum TableFormat {
    /// Arrow IPC file format, compressed with LZ4.
    Arrow,
    /// Parquet, compressed with ZSTD.
    Parquet,
    /// Text with a header line, commas, and empty fields for null; numbers have enough digits to be
    /// read back exactly.
    Csv,
}

impl TableFormat {
    /// The format of a path's extension, case-insensitive.
    pub fn of(path: &str) -> Option<TableFormat> {
        match Path::new(path).extension()?.to_ascii_lowercase().to_str()? {
            "arrow" => Some(TableFormat::Arrow),
            "parquet" => Some(TableFormat::Parquet),
            "csv" => Some(TableFormat::Csv),
            _ => None,
        }
    }
}

/// Columns of a table, and how its rows become columns and text.
pub trait TableColumns {
    /// A row.
    type Row;

    /// Rows buffered before writing.
    const ROWS_PER_GROUP: usize = ROWS_PER_GROUP;

    /// Schema with its metadata: time scale, and coordinate reference system of the points.
    fn schema(&self, time_scale: &str, crs_wkt: Option<&str>) -> SchemaRef;

    /// Converts rows to a record batch of this schema.
    fn batch(&self, schema: &SchemaRef, rows: &[Self::Row]) -> Result<RecordBatch, ArrowError>;

    /// Header line of CSV.
    fn csv_header(&self) -> String;

    /// Rows as lines of CSV.
    fn csv(&self, rows: &[Self::Row]) -> String;

    /// Position of a row in the output frame, if known.
    fn point(row: &Self::Row) -> Option<[f64; 3]>;
}

/// Writes a table to `W`. The bytes depend only on the rows and the info.
pub struct TableWriter<W: Write + Send, C: TableColumns> {
    form: TableFile<W>,
    columns: C,
    schema: SchemaRef,
    rows: Vec<C::Row>,
    file: PathBuf,
}

enum TableFile<W: Write + Send> {
    Arrow(Box<IpcWriter<W>>),
    Parquet(Box<ParquetForm<W>>),
    Csv(W),
}

struct ParquetForm<W: Write + Send> {
    writer: ArrowWriter<W>,
    schema: SchemaRef,
    geometry: Option<GeoParquetColumn>,
}

impl<W: Write + Send> ParquetForm<W> {
    fn new(
        to: W,
        table: &SchemaRef,
        geometry: Option<GeoParquetColumn>,
    ) -> Result<ParquetForm<W>, ArrowError> {
        let schema = if geometry.is_some() { GeoParquetColumn::extend(table) } else { Arc::clone(table) };
        let writer = ArrowWriter::try_new(to, Arc::clone(&schema), Some(properties(&schema)));
        Ok(ParquetForm { writer: writer.map_err(arrow_error)?, schema, geometry })
    }

    /// Writes a row group.
    fn write<C: TableColumns>(&mut self, batch: &RecordBatch, rows: &[C::Row]) -> Result<(), ArrowError> {
        let points = rows.iter().map(C::point);
        let with_points = self.geometry.as_mut().map(|column| column.add(&self.schema, batch, points));
        let with_points = with_points.transpose()?;
        self.writer.write(with_points.as_ref().unwrap_or(batch)).map_err(arrow_error)?;
        self.writer.flush().map_err(arrow_error)
    }

    fn finish(mut self) -> Result<W, ArrowError> {
        if let Some(geometry) = &self.geometry {
            let value = KeyValue::new("geo".to_owned(), geometry.metadata());
            self.writer.append_key_value_metadata(value);
        }
        self.writer.into_inner().map_err(arrow_error)
    }
}

/// Time scale, coordinate reference system and points of a table.
#[derive(Debug, Default, Clone, Copy)]
pub struct TableInfo<'a> {
    /// Time scale: `week`, `day`, `adjusted` or `unknown`.
    pub time_scale: &'a str,
    /// Coordinate reference system of the points, WKT.
    pub crs_wkt: Option<&'a str>,
    /// Whether rows have points; Parquet then has the column `geometry`.
    pub has_points: bool,
}

impl<W: Write + Send, C: TableColumns> TableWriter<W, C> {
    /// Starts a table.
    ///
    /// `file` is the name used in errors.
    pub fn new(
        mut to: W,
        file: &Path,
        format: TableFormat,
        columns: C,
        info: TableInfo,
    ) -> Result<TableWriter<W, C>> {
        let schema = columns.schema(info.time_scale, info.crs_wkt.filter(|_| info.has_points));
        let form = match format {
            TableFormat::Arrow => IpcWriter::file(to, Arc::clone(&schema), Some(CompressionType::LZ4_FRAME))
                .map(|writer| TableFile::Arrow(Box::new(writer))),
            TableFormat::Parquet => {
                let geometry = info.has_points.then(|| GeoParquetColumn::new(info.crs_wkt));
                ParquetForm::new(to, &schema, geometry).map(|form| TableFile::Parquet(Box::new(form)))
            }
            TableFormat::Csv => to
                .write_all(columns.csv_header().as_bytes())
                .map(|()| TableFile::Csv(to))
                .map_err(ArrowError::from),
        };
        let form = form.map_err(|error| failed(file, error))?;
        Ok(TableWriter { form, columns, schema, rows: Vec::new(), file: file.to_path_buf() })
    }

    /// Adds a row.
    pub fn push(&mut self, row: C::Row) -> Result<()> {
        self.rows.push(row);
        if self.rows.len() >= C::ROWS_PER_GROUP { self.write_rows() } else { Ok(()) }
    }

    /// Writes the buffered rows.
    fn write_rows(&mut self) -> Result<()> {
        let rows = std::mem::take(&mut self.rows);
        let batch = || self.columns.batch(&self.schema, &rows);
        let written = match &mut self.form {
            TableFile::Arrow(writer) => batch().and_then(|batch| writer.write(&batch)),
            TableFile::Csv(to) => to.write_all(self.columns.csv(&rows).as_bytes()).map_err(ArrowError::from),
            TableFile::Parquet(form) => batch().and_then(|batch| form.write::<C>(&batch, &rows)),
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
            TableFile::Arrow(writer) => writer.finish(),
            TableFile::Parquet(form) => form.finish(),
            TableFile::Csv(to) => Ok(to),
        }
        .map_err(|error| failed(&self.file, error))
    }
}

/// Format of an output: the given one, else that of the extension.
///
/// # Errors
/// There is no path, or neither says the format.
pub(super) fn format_of(path: &str, format: Option<TableFormat>) -> Result<TableFormat, InvalidKey> {
    InvalidKey::unless(!path.is_empty(), "path", "the path is empty")?;
    let is_spreadsheet =
        ["xlsx", "xls", "ods"].iter().any(|extension| has_extension(Path::new(path), extension));
    let spreadsheet = "files of spreadsheet programs are not written; they read .csv: end the name in .csv";
    InvalidKey::unless(!is_spreadsheet, "path", spreadsheet)?;
    let problem = "it does not end in .arrow, .parquet or .csv: set the key `format`";
    format.or_else(|| TableFormat::of(path)).ok_or_else(|| InvalidKey::new("path", problem))
}

/// A table of a sink, which begins when the first line gives its columns.
pub(super) enum SinkTable<C: TableColumns> {
    /// Waiting for the first line.
    Waiting(OutputFile, TableFormat),
    Open(Box<TableWriter<OutputFile, C>>),
    /// A write failed; the run ends.
    Failed,
}

impl<C: TableColumns> SinkTable<C> {
    /// Creates the file of a table.
    pub(super) fn create(
        run: &RunContext,
        path: &str,
        format: Option<TableFormat>,
    ) -> stage::Result<SinkTable<C>> {
        let format = format_of(path, format).unwrap_or(TableFormat::Parquet);
        Ok(SinkTable::Waiting(run.create(path)?, format))
    }

    /// The table, begun with what the first line has.
    pub(super) fn writer(
        &mut self,
        columns: impl FnOnce() -> C,
        input: &InputInfo,
        has_points: bool,
    ) -> stage::Result<&mut TableWriter<OutputFile, C>> {
        if let SinkTable::Waiting(..) = self
            && let SinkTable::Waiting(to, format) = std::mem::replace(self, SinkTable::Failed)
        {
            let path = to.path().to_path_buf();
            let time_scale = time_scale_of(input.time_scale).name();
            let info = TableInfo { time_scale, crs_wkt: input.crs_wkt.as_deref(), has_points };
            *self = SinkTable::Open(Box::new(TableWriter::new(to, &path, format, columns(), info)?));
        }
        match self {
            SinkTable::Open(writer) => Ok(writer),
            _ => Err(StageError::Stopped),
        }
    }

    /// Completes the file; a table without lines still has its columns.
    pub(super) fn finish(mut self, columns: impl FnOnce() -> C, cx: &mut Context) -> stage::Result<()> {
        self.writer(columns, &InputInfo::default(), false)?;
        if let SinkTable::Open(writer) = self {
            cx.publish(writer.finish()?.finish()?);
        }
        Ok(())
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
        // Smallest and largest bytes of WKB say nothing; x, y and z have statistics.
        .set_column_statistics_enabled(geo::COLUMN.into(), EnabledStatistics::None)
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
