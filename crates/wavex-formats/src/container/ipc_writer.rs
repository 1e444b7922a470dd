//! Writer of Arrow IPC whose parts have digests.
//!
//! The writers of `arrow-ipc` cannot add metadata to messages. This one encodes record batches with
//! `arrow-ipc`, and writes messages and footer itself (Arrow columnar format 1.5, "Encapsulated
//! message format", "IPC streaming format" and "IPC file format").

use std::io::Write;

use arrow_array::RecordBatch;
use arrow_ipc::convert::schema_to_fb_offset;
use arrow_ipc::writer::{DictionaryTracker, IpcDataGenerator, IpcWriteContext, IpcWriteOptions};
use arrow_ipc::{
    Block, BodyCompressionArgs, CompressionType, FooterArgs, KeyValue, KeyValueArgs, MessageArgs,
    MessageHeader, MetadataVersion, RecordBatchArgs, root_as_footer, root_as_message,
};
use arrow_schema::{ArrowError, SchemaRef};
use flatbuffers::{FlatBufferBuilder, ForwardsUOffset, UnionWIPOffset, Vector, WIPOffset};

use super::digest;
use super::messages::{CONTINUATION, MAGIC};

/// Alignment of messages and of the buffers in their bodies, bytes.
const ALIGNMENT: usize = 64;

/// Writer of an Arrow file or stream; each record batch has a digest.
///
/// Readers of this crate check the digests. Other readers ignore them.
pub struct IpcWriter<W: Write> {
    to: W,
    schema: SchemaRef,
    options: IpcWriteOptions,
    context: IpcWriteContext,
    /// Record batches for the footer; `None` in a stream.
    blocks: Option<Vec<Block>>,
    /// Number of bytes written.
    at: usize,
    with_digests: bool,
}

impl<W: Write> IpcWriter<W> {
    /// Starts a file; its buffers are compressed by `compression`.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn file(
        to: W,
        schema: SchemaRef,
        compression: Option<CompressionType>,
    ) -> Result<IpcWriter<W>, ArrowError> {
        IpcWriter::begin(to, schema, compression, true, true)
    }

    /// Starts a stream, which has an end mark but no footer.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn stream(
        to: W,
        schema: SchemaRef,
        compression: Option<CompressionType>,
    ) -> Result<IpcWriter<W>, ArrowError> {
        IpcWriter::begin(to, schema, compression, false, true)
    }

    /// Starts a file or stream, with or without digests.
    pub(super) fn begin(
        to: W,
        schema: SchemaRef,
        compression: Option<CompressionType>,
        is_file: bool,
        with_digests: bool,
    ) -> Result<IpcWriter<W>, ArrowError> {
        let options = IpcWriteOptions::default().try_with_compression(compression)?;
        let context = IpcWriteContext::default();
        let blocks = is_file.then(Vec::new);
        let mut writer = IpcWriter { to, schema, options, context, blocks, at: 0, with_digests };
        if is_file {
            let mut start = [0; ALIGNMENT];
            start.iter_mut().zip(MAGIC).for_each(|(to, from)| *to = *from);
            writer.put(&start)?;
        }
        let mut builder = FlatBufferBuilder::new();
        let header = schema_to_fb_offset(&mut builder, &writer.schema).as_union_value();
        writer.message(builder, MessageHeader::Schema, header, &[])?;
        Ok(writer)
    }

    /// Writes a record batch.
    ///
    /// # Errors
    /// It cannot be written, or has a dictionary.
    pub fn write(&mut self, batch: &RecordBatch) -> Result<(), ArrowError> {
        let mut tracker = DictionaryTracker::new(true);
        let generator = IpcDataGenerator::default();
        let (dictionaries, encoded) =
            generator.encode(batch, &mut tracker, &self.options, &mut self.context)?;
        if !dictionaries.is_empty() {
            return Err(ArrowError::NotYetImplemented("columns with dictionaries".into()));
        }
        let mut builder = FlatBufferBuilder::new();
        let header = copy_record_batch(&mut builder, &encoded.ipc_message)?;
        let start = self.at;
        let head = self.message(builder, MessageHeader::RecordBatch, header, &encoded.arrow_data)?;
        let too_long = |_| ArrowError::IpcError("the metadata of a record batch exceed 2^31 bytes".into());
        if let Some(blocks) = &mut self.blocks {
            let head = i32::try_from(head).map_err(too_long)?;
            blocks.push(Block::new(start as i64, head, encoded.arrow_data.len() as i64));
        }
        Ok(())
    }

    /// Writes the end mark and the footer, and returns the underlying writer.
    ///
    /// # Errors
    /// They cannot be written.
    pub fn finish(mut self) -> Result<W, ArrowError> {
        self.put(&CONTINUATION)?;
        self.put(&[0; 4])?;
        if let Some(blocks) = self.blocks.take() {
            let footer = self.footer(&blocks)?;
            self.put(&footer)?;
            self.put(&(footer.len() as i32).to_le_bytes())?;
            self.put(MAGIC)?;
        }
        self.to.flush()?;
        Ok(self.to)
    }

    fn footer(&self, blocks: &[Block]) -> Result<Vec<u8>, ArrowError> {
        let mut builder = FlatBufferBuilder::new();
        let args = FooterArgs {
            version: MetadataVersion::V5,
            schema: Some(schema_to_fb_offset(&mut builder, &self.schema)),
            dictionaries: Some(builder.create_vector::<Block>(&[])),
            recordBatches: Some(builder.create_vector(blocks)),
            custom_metadata: self.blank_digest(&mut builder),
        };
        let root = arrow_ipc::Footer::create(&mut builder, &args);
        builder.finish(root, None);
        let mut footer = builder.finished_data().to_vec();
        let entries = root_as_footer(&footer).map_err(invalid)?.custom_metadata();
        let value = digest::location_of(&footer, entries);
        fill_in(&mut footer, value, &[]);
        Ok(footer)
    }

    /// Writes a message; returns the size of its metadata with prefix and padding, bytes.
    fn message(
        &mut self,
        mut builder: FlatBufferBuilder,
        header_type: MessageHeader,
        header: WIPOffset<UnionWIPOffset>,
        body: &[u8],
    ) -> Result<usize, ArrowError> {
        let args = MessageArgs {
            version: MetadataVersion::V5,
            header_type,
            header: Some(header),
            bodyLength: body.len() as i64,
            custom_metadata: self.blank_digest(&mut builder),
        };
        let root = arrow_ipc::Message::create(&mut builder, &args);
        builder.finish(root, None);
        let mut flatbuffer = builder.finished_data().to_vec();
        let head = (CONTINUATION.len() + 4 + flatbuffer.len()).next_multiple_of(ALIGNMENT);
        flatbuffer.resize(head - CONTINUATION.len() - 4, 0);
        let entries = root_as_message(&flatbuffer).map_err(invalid)?.custom_metadata();
        let value = digest::location_of(&flatbuffer, entries);
        fill_in(&mut flatbuffer, value, body);
        self.put(&CONTINUATION)?;
        self.put(&(flatbuffer.len() as i32).to_le_bytes())?;
        self.put(&flatbuffer)?;
        self.put(body)?;
        Ok(head)
    }

    /// Adds custom metadata with a blank digest.
    fn blank_digest<'b>(
        &self,
        builder: &mut FlatBufferBuilder<'b>,
    ) -> Option<WIPOffset<Vector<'b, ForwardsUOffset<KeyValue<'b>>>>> {
        self.with_digests.then(|| {
            let key = Some(builder.create_string(digest::KEY));
            let value = Some(builder.create_string(digest::BLANK));
            let entry = KeyValue::create(builder, &KeyValueArgs { key, value });
            builder.create_vector(&[entry])
        })
    }

    fn put(&mut self, bytes: &[u8]) -> Result<(), ArrowError> {
        self.to.write_all(bytes)?;
        self.at += bytes.len();
        Ok(())
    }
}

/// Replaces a blank digest by the digest of the flatbuffer and its body.
fn fill_in(flatbuffer: &mut [u8], value: Option<std::ops::Range<usize>>, body: &[u8]) {
    let digest = digest::of(flatbuffer, body);
    if let Some(value) = value.and_then(|range| flatbuffer.get_mut(range)) {
        value.copy_from_slice(digest.as_bytes());
    }
}

/// Copies the record batch of an encoded message to another flatbuffer.
fn copy_record_batch(
    builder: &mut FlatBufferBuilder,
    encoded: &[u8],
) -> Result<WIPOffset<UnionWIPOffset>, ArrowError> {
    let message = root_as_message(encoded).map_err(invalid)?;
    let batch = message.header_as_record_batch();
    let batch = batch.ok_or_else(|| ArrowError::IpcError("a message without record batch".into()))?;
    let compression = batch.compression().map(|compression| {
        let args = BodyCompressionArgs { codec: compression.codec(), method: compression.method() };
        arrow_ipc::BodyCompression::create(builder, &args)
    });
    let nodes: Vec<_> = batch.nodes().into_iter().flatten().copied().collect();
    let buffers: Vec<_> = batch.buffers().into_iter().flatten().copied().collect();
    let views: Option<Vec<i64>> = batch.variadicBufferCounts().map(|counts| counts.iter().collect());
    let args = RecordBatchArgs {
        length: batch.length(),
        nodes: Some(builder.create_vector(&nodes)),
        buffers: Some(builder.create_vector(&buffers)),
        compression,
        variadicBufferCounts: views.map(|counts| builder.create_vector(&counts)),
    };
    Ok(arrow_ipc::RecordBatch::create(builder, &args).as_union_value())
}

fn invalid(error: impl std::fmt::Display) -> ArrowError {
    ArrowError::IpcError(error.to_string())
}
