//! From a record batch with packed buffers to the same one with plain buffers.
//!
//! `arrow-ipc` could unpack them too, one allocation and two copies for each. Here they are unpacked into one body, whose
//! memory serves again once the line before it has been dropped. The metadata is changed in place: the field
//! `compression` goes, and each buffer's entry says where it lies now (FlatBuffers internals, "Tables" and "Vectors").

use std::ops::Range;

use arrow_buffer::Buffer;
use arrow_ipc::{CompressionType, RecordBatch};

use super::messages::Message;
use super::{MOST_KEPT_BYTES, lz4};

/// A buffer of a column that will be decoded.
pub(super) struct Found {
    /// Its number in the record batch.
    pub(super) number: usize,
    /// The number of its column in the schema.
    pub(super) column: usize,
    /// Where its bytes lie in the body, without the length before them.
    pub(super) bytes: Range<usize>,
    /// How many bytes it unpacks to, where it is packed.
    pub(super) unpacks_to: Option<usize>,
}

/// Why a record batch could not be unpacked: the column, where it is one's fault, and the problem.
pub(super) type Failure = (Option<usize>, String);

/// Where buffers begin in the new body: at multiples of so many bytes (Arrow columnar format, "Buffer Alignment").
const ALIGNMENT: usize = 64;

/// Unpacks record batches; keeps its memory from one to the next.
#[derive(Default)]
pub(super) struct Unpacker {
    zstd: Option<zstd::bulk::Decompressor<'static>>,
    /// The last body: its memory is free once no line uses it.
    last: Option<Buffer>,
}

impl Unpacker {
    /// The message with the buffers `found` unpacked; those of other columns are no longer in its body.
    pub(super) fn unpack(
        &mut self,
        message: &Message,
        batch: &RecordBatch,
        codec: CompressionType,
        found: &[Found],
    ) -> Result<Message, Failure> {
        let table = batch._tab.loc();
        let mut metadata = message.metadata.to_vec();
        let entries = buffer_entries(&metadata, table).ok_or((None, "its buffers are not listed".into()))?;
        let mut body = self.last.take().and_then(|last| last.into_mutable().ok()).unwrap_or_default();
        let mut at = 0;
        for buffer in found {
            let from = message.body.get(buffer.bytes.clone()).unwrap_or_default();
            let size = buffer.unpacks_to.unwrap_or(from.len());
            let end = at + size;
            // A step at a time: a buffer that cannot be unpacked ends this before others take memory.
            if body.len() < end {
                body.resize(end, 0);
            }
            let to = body.get_mut(at..end).unwrap_or_default();
            let done = match buffer.unpacks_to {
                None => {
                    to.copy_from_slice(from);
                    Ok(())
                }
                Some(0) => Ok(()),
                Some(_) => self.unpack_one(codec, from, to),
            };
            done.map_err(|problem| (Some(buffer.column), problem))?;
            put(&mut metadata, entries + 16 * buffer.number, (at as i64).to_le_bytes());
            put(&mut metadata, entries + 16 * buffer.number + 8, (size as i64).to_le_bytes());
            at = end.next_multiple_of(ALIGNMENT);
        }
        if let Some(compression) = entry_of(&metadata, table, RecordBatch::VT_COMPRESSION) {
            put(&mut metadata, compression, [0; 2]);
        }
        let body = Buffer::from(body);
        self.last = (body.len() <= MOST_KEPT_BYTES).then(|| body.clone());
        Ok(Message { offset: message.offset, metadata: Buffer::from_vec(metadata), body })
    }

    /// Unpacks a buffer, which must fill `to` to the last byte.
    fn unpack_one(&mut self, codec: CompressionType, from: &[u8], to: &mut [u8]) -> Result<(), String> {
        match codec {
            CompressionType::LZ4_FRAME => lz4::unpack(from, to).map_err(str::to_owned),
            CompressionType::ZSTD => {
                let size = self.unpack_zstd(from, to).map_err(|error| error.to_string())?;
                let whole = size == to.len();
                if whole {
                    Ok(())
                } else {
                    Err(format!("{size} bytes unpacked, where {} are said to be", to.len()))
                }
            }
            other => Err(format!("the compression {other:?} is not known")),
        }
    }

    fn unpack_zstd(&mut self, from: &[u8], to: &mut [u8]) -> std::io::Result<usize> {
        let zstd = match self.zstd.take() {
            Some(zstd) => zstd,
            None => zstd::bulk::Decompressor::new()?,
        };
        self.zstd.insert(zstd).decompress_to_buffer(from, to)
    }
}

/// Where the vtable of the table at `table` tells about a field, if it does.
fn entry_of(bytes: &[u8], table: usize, field: u16) -> Option<usize> {
    let back = i32::from_le_bytes(get(bytes, table)?);
    let vtable = usize::try_from(table as i64 - i64::from(back)).ok()?;
    let size = u16::from_le_bytes(get(bytes, vtable)?);
    (field + 2 <= size).then_some(vtable + usize::from(field))
}

/// Where the entries of a record batch's buffers begin: 16 bytes each, offset and length.
fn buffer_entries(bytes: &[u8], table: usize) -> Option<usize> {
    let field = u16::from_le_bytes(get(bytes, entry_of(bytes, table, RecordBatch::VT_BUFFERS)?)?);
    let field = table + usize::from(field);
    let vector = field + u32::from_le_bytes(get(bytes, field)?) as usize;
    Some(vector + 4)
}

fn get<const N: usize>(bytes: &[u8], at: usize) -> Option<[u8; N]> {
    bytes.get(at..)?.first_chunk().copied()
}

/// Writes where there is room.
fn put<const N: usize>(bytes: &mut [u8], at: usize, value: [u8; N]) {
    if let Some(place) = bytes.get_mut(at..).and_then(|rest| rest.first_chunk_mut()) {
        *place = value;
    }
}
