//! From a message to a line: the one place where `arrow-ipc` decodes.

use std::collections::HashMap;
use std::sync::Arc;

use arrow_array::{ArrayRef, RecordBatch};
use arrow_buffer::Buffer;
use arrow_ipc::convert::try_fb_to_schema;
use arrow_ipc::reader::read_record_batch;
use arrow_ipc::{Endianness, Field as FbField, MessageHeader, MetadataVersion, root_as_message};
use arrow_schema::{DataType, Field, FieldRef, Schema, SchemaRef};

use super::messages::{Message, first_line};
use super::place::{DAMAGED, Place};
use super::unpack::{Found, Unpacker};
use super::{ContainerLine, guard};
use crate::formats::Result;

/// The schema that a file or stream starts with.
pub(super) fn schema_of(schema: arrow_ipc::Schema, place: Place) -> Result<Schema> {
    if schema.endianness() != Endianness::Little {
        return Err(place.bad("schema", "the numbers are big-endian", "write the file on a common machine"));
    }
    for field in schema.fields().iter().flatten() {
        check_unions(field, place)?;
    }
    try_fb_to_schema(schema).map_err(|e| place.bad("schema", e.to_string(), "leave such columns out"))
}

/// `arrow-ipc` panics on a union of over 128 types.
fn check_unions(field: FbField, place: Place) -> Result<()> {
    let children = field.children().unwrap_or_default();
    if field.type_as_union().is_some() && children.len() > 128 {
        let name = field.name().unwrap_or_default();
        return Err(place.bad(format!("column `{name}`"), "a union of over 128 types", "leave it out"));
    }
    children.iter().try_for_each(|child| check_unions(child, place))
}

/// How the record batches of one container are decoded.
pub(super) struct Decoder {
    /// The container's columns, each allowed to hold nulls: what they hold is checked with better words.
    schema: SchemaRef,
    /// Where the columns of the layout stand; see [`super::layout::find`].
    columns: Vec<Option<usize>>,
    /// Those that are there.
    present: Vec<usize>,
    unpacker: Unpacker,
}

impl Decoder {
    /// `columns` as [`super::layout::find`] gives them.
    pub(super) fn new(schema: &Schema, columns: Vec<Option<usize>>) -> Decoder {
        let fields: Vec<FieldRef> = schema.fields().iter().map(nullable).collect();
        let present = columns.iter().flatten().copied().collect();
        Decoder { schema: Arc::new(Schema::new(fields)), columns, present, unpacker: Unpacker::default() }
    }

    /// The line in a message; `None` where the message is none.
    pub(super) fn line(&mut self, message: &Message, place: Place) -> Result<Option<ContainerLine>> {
        let batch = self.batch(message, place)?;
        batch.map(|batch| ContainerLine::try_new(&self.arrays(&batch), place)).transpose()
    }

    /// The columns of the layout in a message, in the order of the file; `None` where the message is no record batch.
    pub(super) fn batch(&mut self, message: &Message, place: Place) -> Result<Option<RecordBatch>> {
        let parsed = parsed(message, place)?;
        let Some(batch) = record_batch_of(&parsed, place)? else { return Ok(None) };
        let found = self.check(message, &parsed, &batch, place)?;
        let Some(compression) = batch.compression() else {
            return self.plain(message, &parsed, batch, place).map(Some);
        };
        let unpacked = self.unpacker.unpack(message, &batch, compression.codec(), &found);
        let unpacked = unpacked.map_err(|(column, problem)| {
            let column = column.map_or("record batch".into(), |column| self.name(column));
            place.bad(self.rows(&column, batch.length(), place), problem, DAMAGED)
        })?;
        self.unpacked(&unpacked, place)
    }

    /// The same of a message that has just been unpacked. It is checked as if it came from the file: only now do the lists'
    /// offsets lie open.
    fn unpacked(&self, message: &Message, place: Place) -> Result<Option<RecordBatch>> {
        let parsed = parsed(message, place)?;
        let Some(batch) = record_batch_of(&parsed, place)? else { return Ok(None) };
        if batch.compression().is_some() {
            return Err(place.bad("record batch", "its metadata overlap", DAMAGED));
        }
        self.check(message, &parsed, &batch, place)?;
        self.plain(message, &parsed, batch, place).map(Some)
    }

    fn check(
        &self,
        message: &Message,
        parsed: &arrow_ipc::Message,
        batch: &arrow_ipc::RecordBatch,
        place: Place,
    ) -> Result<Vec<Found>> {
        guard::check(batch, parsed.version(), &self.schema, &self.present, &message.body, place)
    }

    /// Decodes a record batch without packed buffers.
    fn plain(
        &self,
        message: &Message,
        parsed: &arrow_ipc::Message,
        batch: arrow_ipc::RecordBatch,
        place: Place,
    ) -> Result<RecordBatch> {
        let decode =
            |columns: &[usize]| decode(&message.body, batch, &self.schema, columns, parsed.version());
        decode(&self.present).map_err(|error| {
            // The decoder does not say which column it was at: whichever fails by itself, too.
            let culprit = self.present.iter().find_map(|&column| Some((column, decode(&[column]).err()?)));
            let (column, problem) = culprit
                .map_or_else(|| ("record batch".into(), error), |(column, error)| (self.name(column), error));
            place.bad(self.rows(&column, batch.length(), place), problem, DAMAGED)
        })
    }

    /// A column in words.
    fn name(&self, column: usize) -> String {
        format!("column `{}`", self.schema.field(column).name())
    }

    /// A column and the rows that a record batch has.
    fn rows(&self, column: &str, rows: i64, place: Place) -> String {
        let last = place.first_row + (rows.max(1) as u64 - 1);
        format!("{column}, rows {} to {last}", place.first_row)
    }

    /// The columns of the layout.
    fn arrays(&self, decoded: &RecordBatch) -> Vec<Option<ArrayRef>> {
        let mut arrays = decoded.columns().iter();
        self.columns.iter().map(|column| column.and_then(|_| arrays.next().cloned())).collect()
    }
}

fn parsed<'a>(message: &'a Message, place: Place) -> Result<arrow_ipc::Message<'a>> {
    root_as_message(&message.metadata).map_err(|e| place.bad("message", first_line(&e), DAMAGED))
}

/// The record batch that a message is; `None` for a dictionary.
fn record_batch_of<'a>(
    message: &arrow_ipc::Message<'a>,
    place: Place,
) -> Result<Option<arrow_ipc::RecordBatch<'a>>> {
    let Some(batch) = message.header_as_record_batch() else {
        return match message.header_type() {
            // Only columns that are passed over can have a dictionary.
            MessageHeader::DictionaryBatch | MessageHeader::NONE => Ok(None),
            _ => Err(place.bad("message", "neither a record batch nor a dictionary", DAMAGED)),
        };
    };
    let version = message.version();
    if version < MetadataVersion::V4 {
        let problem = format!("a record batch of the metadata version {version:?}");
        return Err(place.bad("message", problem, "write it with Arrow 0.8 or later"));
    }
    Ok(Some(batch))
}

/// A record batch with the columns `columns`, in that order.
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

/// The same field, allowed to hold nulls, and so on inwards.
fn nullable(field: &FieldRef) -> FieldRef {
    let data_type = match field.data_type() {
        DataType::List(item) => DataType::List(nullable(item)),
        DataType::FixedSizeList(item, n) => DataType::FixedSizeList(nullable(item), *n),
        DataType::Struct(fields) => DataType::Struct(fields.iter().map(nullable).collect()),
        other => other.clone(),
    };
    Arc::new(Field::new(field.name(), data_type, true))
}
