//! Decompresses the buffers of record batches.
//!
//! `arrow-ipc` needs one allocation and two copies per buffer and accepts no other memory: its
//! decompressor is private. Here all buffers are decompressed into one body, whose memory is reused
//! once the previous line has been dropped. The
//! metadata is changed in place: the field `compression` is removed, and each buffer entry gets its
//! new location (FlatBuffers internals, "Tables" and "Vectors").

use arrow_buffer::Buffer;
use arrow_ipc::{CompressionType, RecordBatch};

use super::guard::ColumnBuffer;
use super::messages::IpcMessage;
use super::{MOST_KEPT_BYTES, lz4};

/// Error of decompression: the column, if known, and the problem.
pub(super) type UnpackError = (Option<usize>, String);

/// Alignment of buffers in the new body, bytes (Arrow columnar format, "Buffer Alignment").
const ALIGNMENT: usize = 64;

/// Decompresses record batches; reuses its memory.
#[derive(Default)]
pub(super) struct Unpacker {
    zstd: Option<zstd::bulk::Decompressor<'static>>,
    /// The last body; reused once no line uses it.
    last: Option<Buffer>,
    /// If true, samples are not decompressed and have any values.
    pub(super) without_samples: bool,
}

impl Unpacker {
    /// Decompresses the buffers `found` of a message.
    ///
    /// Buffers of other columns are removed from its body.
    pub(super) fn unpack(
        &mut self,
        message: &IpcMessage,
        batch: &RecordBatch,
        codec: CompressionType,
        found: &[ColumnBuffer],
    ) -> Result<IpcMessage, UnpackError> {
        let table = batch._tab.loc();
        let mut metadata = message.metadata.to_vec();
        let entries = buffer_entries(&metadata, table).ok_or((None, "its buffers are not listed".into()))?;
        let mut body = self.last.take().and_then(|last| last.into_mutable().ok()).unwrap_or_default();
        let mut at = 0;
        for buffer in found {
            let from = message.body.get(buffer.bytes.clone()).unwrap_or_default();
            let size = buffer.unpacks_to.unwrap_or(from.len());
            let end = at + size;
            // Grow step by step, so that a damaged buffer ends this before others take memory.
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
                Some(_) if self.without_samples && buffer.is_samples => Ok(()),
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
        Ok(IpcMessage { offset: message.offset, metadata: Buffer::from_vec(metadata), body })
    }

    /// Decompresses a buffer, which must fill `to` exactly.
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

/// Position in the vtable of a field of the table at `table`, if present.
fn entry_of(bytes: &[u8], table: usize, field: u16) -> Option<usize> {
    let back = i32::from_le_bytes(get(bytes, table)?);
    let vtable = usize::try_from(table as i64 - i64::from(back)).ok()?;
    let size = u16::from_le_bytes(get(bytes, vtable)?);
    (field + 2 <= size).then_some(vtable + usize::from(field))
}

/// Start of the buffer entries of a record batch: 16 bytes each, offset and length.
fn buffer_entries(bytes: &[u8], table: usize) -> Option<usize> {
    let field = u16::from_le_bytes(get(bytes, entry_of(bytes, table, RecordBatch::VT_BUFFERS)?)?);
    let field = table + usize::from(field);
    let vector = field + u32::from_le_bytes(get(bytes, field)?) as usize;
    Some(vector + 4)
}

fn get<const N: usize>(bytes: &[u8], at: usize) -> Option<[u8; N]> {
    bytes.get(at..)?.first_chunk().copied()
}

/// Writes if there is room.
fn put<const N: usize>(bytes: &mut [u8], at: usize, value: [u8; N]) {
    if let Some(place) = bytes.get_mut(at..).and_then(|rest| rest.first_chunk_mut()) {
        *place = value;
    }
}
