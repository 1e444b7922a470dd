//! Decodes messages to lines; the only use of the decoder of `arrow-ipc`.

use std::collections::HashMap;
use std::sync::Arc;

use arrow_array::{ArrayRef, RecordBatch};
use arrow_buffer::Buffer;
use arrow_ipc::reader::read_record_batch;
use arrow_ipc::{MessageHeader, MetadataVersion, root_as_message};
use arrow_schema::{DataType, Field, FieldRef, Schema, SchemaRef};

use super::guard::ColumnBuffer;
use super::location::{ContainerLocation, DAMAGED};
use super::messages::{IpcMessage, first_line};
use super::unpack::Unpacker;
use super::{ContainerLine, guard};
use crate::Result;

/// Decoder of the record batches of one container.
pub(super) struct Decoder {
    /// Columns of the container, all nullable, because nulls are reported with better messages
    /// here.
    schema: SchemaRef,
    /// Indices of the layout's columns; see [`super::layout::find`].
    columns: Vec<Option<usize>>,
    /// Indices of the layout's columns that exist.
    present: Vec<usize>,
    unpacker: Unpacker,
}

impl Decoder {
    /// `columns` is the result of [`super::layout::find`].
    pub(super) fn new(schema: &Schema, columns: Vec<Option<usize>>) -> Decoder {
        let fields: Vec<FieldRef> = schema.fields().iter().map(nullable).collect();
        let present = columns.iter().flatten().copied().collect();
        Decoder { schema: Arc::new(Schema::new(fields)), columns, present, unpacker: Unpacker::default() }
    }

    /// Leaves compressed samples as they are; samples of lines then have any values.
    pub(super) fn skip_samples(&mut self) {
        self.unpacker.without_samples = true;
    }

    /// Decodes the line of a message; `None` if it is not a record batch.
    pub(super) fn line(
        &mut self,
        message: &IpcMessage,
        location: ContainerLocation,
    ) -> Result<Option<ContainerLine>> {
        let batch = self.batch(message, location)?;
        batch.map(|batch| ContainerLine::try_new(&self.arrays(&batch), location)).transpose()
    }

    /// Decodes the layout's columns of a message, in the order of the file.
    ///
    /// `None` if the message is not a record batch.
    pub(super) fn batch(
        &mut self,
        message: &IpcMessage,
        location: ContainerLocation,
    ) -> Result<Option<RecordBatch>> {
        let parsed = parsed(message, location)?;
        let Some(batch) = record_batch_of(&parsed, location)? else { return Ok(None) };
        let found = self.check(message, &parsed, &batch, location)?;
        let Some(compression) = batch.compression() else {
            return self.plain(message, &parsed, batch, location).map(Some);
        };
        let unpacked = self.unpacker.unpack(message, &batch, compression.codec(), &found);
        let unpacked = unpacked.map_err(|(column, problem)| {
            let column = column.map_or("record batch".into(), |column| self.name(column));
            location.bad(self.rows(&column, batch.length(), location), problem, DAMAGED)
        })?;
        self.unpacked(&unpacked, location)
    }

    /// Checks a decompressed message as if it came from the file.
    ///
    /// Offsets of compressed lists are accessible only now.
    fn unpacked(&self, message: &IpcMessage, location: ContainerLocation) -> Result<Option<RecordBatch>> {
        let parsed = parsed(message, location)?;
        let Some(batch) = record_batch_of(&parsed, location)? else { return Ok(None) };
        if batch.compression().is_some() {
            return Err(location.bad("record batch", "its metadata overlap", DAMAGED));
        }
        self.check(message, &parsed, &batch, location)?;
        self.plain(message, &parsed, batch, location).map(Some)
    }

    fn check(
        &self,
        message: &IpcMessage,
        parsed: &arrow_ipc::Message,
        batch: &arrow_ipc::RecordBatch,
        location: ContainerLocation,
    ) -> Result<Vec<ColumnBuffer>> {
        guard::check(batch, parsed.version(), &self.schema, &self.present, &message.body, location)
    }

    /// Decodes a record batch without compressed buffers.
    fn plain(
        &self,
        message: &IpcMessage,
        parsed: &arrow_ipc::Message,
        batch: arrow_ipc::RecordBatch,
        location: ContainerLocation,
    ) -> Result<RecordBatch> {
        let decode =
            |columns: &[usize]| decode(&message.body, batch, &self.schema, columns, parsed.version());
        decode(&self.present).map_err(|error| {
            // The decoder does not name the column: find one that fails by itself.
            let culprit = self.present.iter().find_map(|&column| Some((column, decode(&[column]).err()?)));
            let (column, problem) = culprit
                .map_or_else(|| ("record batch".into(), error), |(column, error)| (self.name(column), error));
            location.bad(self.rows(&column, batch.length(), location), problem, DAMAGED)
        })
    }

    /// Name of a column for messages.
    fn name(&self, column: usize) -> String {
        format!("column `{}`", self.schema.field(column).name())
    }

    /// Builds a column with the number of rows of a record batch.
    fn rows(&self, column: &str, rows: i64, location: ContainerLocation) -> String {
        let last = location.first_row + (rows.max(1) as u64 - 1);
        format!("{column}, rows {} to {last}", location.first_row)
    }

    /// Fields of the layout's columns.
    fn arrays(&self, decoded: &RecordBatch) -> Vec<Option<ArrayRef>> {
        let mut arrays = decoded.columns().iter();
        self.columns.iter().map(|column| column.and_then(|_| arrays.next().cloned())).collect()
    }
}

fn parsed<'a>(message: &'a IpcMessage, location: ContainerLocation) -> Result<arrow_ipc::Message<'a>> {
    root_as_message(&message.metadata).map_err(|e| location.bad("message", first_line(&e), DAMAGED))
}

/// Returns the record batch of a message; `None` for a dictionary.
fn record_batch_of<'a>(
    message: &arrow_ipc::Message<'a>,
    location: ContainerLocation,
) -> Result<Option<arrow_ipc::RecordBatch<'a>>> {
    let Some(batch) = message.header_as_record_batch() else {
        return match message.header_type() {
            // Only ignored columns can have a dictionary.
            MessageHeader::DictionaryBatch | MessageHeader::NONE => Ok(None),
            _ => Err(location.bad("message", "neither a record batch nor a dictionary", DAMAGED)),
        };
    };
    let version = message.version();
    if version < MetadataVersion::V4 {
        let problem = format!("a record batch of the metadata version {version:?}");
        return Err(location.bad("message", problem, "write it with Arrow 0.8 or later"));
    }
    Ok(Some(batch))
}

/// Selects the columns `columns` of a record batch, in that order.
fn decode(
    body: &Buffer,
    batch: arrow_ipc::RecordBatch,
    schema: &SchemaRef,
    columns: &[usize],
    version: MetadataVersion,
) -> std::result::Result<RecordBatch, String> {
    read_record_batch(body, batch, Arc::clone(schema), &HashMap::new(), Some(columns), &version)
        .map_err(|error| error.to_string())
}

/// Makes a field and its children nullable.
fn nullable(field: &FieldRef) -> FieldRef {
    let data_type = match field.data_type() {
        DataType::List(item) => DataType::List(nullable(item)),
        DataType::LargeList(item) => DataType::LargeList(nullable(item)),
        DataType::FixedSizeList(item, n) => DataType::FixedSizeList(nullable(item), *n),
        DataType::Struct(fields) => DataType::Struct(fields.iter().map(nullable).collect()),
        other => other.clone(),
    };
    Arc::new(Field::new(field.name(), data_type, true))
}
