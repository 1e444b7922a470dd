//! Validates the metadata of a record batch before decompression and decoding.
//!
//! Memory is allocated by the decompressed length stored before each compressed buffer. The decoder
//! slices the body by the offset and length of each buffer and reads list offsets as 32-bit
//! integers; invalid lengths make it abort or panic. The validation visits nodes and buffers in the
//! order of the decoder (Arrow columnar format 1.5, "RecordBatch message"). It also finds the row
//! of a list that refers to items out of bounds.
//!
//! `arrow-ipc` 60.1 cannot do this itself. Its limits (`with_max_footer_fb_tables`,
//! `with_max_footer_fb_depth`) cover the footer only, its decompressor is private and reserves the
//! stored length, and its errors name neither the column nor the row.

use std::collections::VecDeque;
use std::ops::Range;

use arrow_ipc::{CompressionType, FieldNode, MetadataVersion, RecordBatch};
use arrow_schema::{DataType, Field, Schema, UnionMode};

use super::MAX_BATCH_BYTES;
use super::location::{ContainerLocation, DAMAGED};
use crate::{Error, Result};

/// Decompressed bytes that a buffer may have beyond the need of its rows.
///
/// Writers pad buffers and may reserve capacity.
const SPARE_BYTES: u64 = 1 << 16;

/// Size of the length before a compressed buffer, bytes.
const LENGTH_BYTES: usize = 8;

/// Path of the samples of blocks.
const SAMPLES: &str = "blocks.samples";

/// Size of a view of a text (Arrow columnar format, "Variable-size Binary View Layout").
const VIEW_BYTES: usize = 16;
/// Initial capacity for buffers; more are rare.
const MOST_BUFFERS: usize = 128;

/// A buffer of a column to decode.
pub(super) struct ColumnBuffer {
    /// Index of the buffer in the record batch.
    pub(super) number: usize,
    /// Index of its column in the schema.
    pub(super) column: usize,
    /// Range of its bytes in the body, without the preceding length.
    pub(super) bytes: Range<usize>,
    /// Decompressed size, if compressed, bytes.
    pub(super) unpacks_to: Option<usize>,
    /// Whether it holds the samples of the blocks.
    pub(super) is_samples: bool,
}

/// Checks that `batch` can be decoded; see the module.
///
/// `decoded` are the columns to decode; the returned buffers belong to them.
pub(super) fn check(
    batch: &RecordBatch,
    version: MetadataVersion,
    schema: &Schema,
    decoded: &[usize],
    body: &[u8],
    location: ContainerLocation,
) -> Result<Vec<ColumnBuffer>> {
    let (Some(nodes), Some(buffers)) = (batch.nodes(), batch.buffers()) else {
        return Err(location.bad("record batch", "it lists no buffers", DAMAGED));
    };
    let rows = usize::try_from(batch.length())
        .map_err(|_| location.bad("record batch", format!("it has {} rows", batch.length()), DAMAGED))?;
    let mut walk = BufferWalk {
        nodes: nodes.iter().copied().collect(),
        buffers: buffers.iter().copied().collect(),
        views: batch.variadicBufferCounts().into_iter().flatten().collect(),
        codec: batch.compression().map(|compression| compression.codec()),
        version,
        body,
        unpacked: 0,
        column: 0,
        listed: buffers.len(),
        found: Vec::with_capacity(buffers.len().min(MOST_BUFFERS)),
        location,
    };
    for (index, field) in schema.fields().iter().enumerate() {
        walk.column = index;
        if decoded.contains(&index) {
            walk.field(field, field.name(), Some(rows), &mut Vec::new())?;
        } else {
            walk.pass(field.data_type(), field.name())?;
        }
    }
    Ok(walk.found)
}

/// Remaining nodes and buffers of a record batch.
struct BufferWalk<'a> {
    nodes: VecDeque<FieldNode>,
    buffers: VecDeque<arrow_ipc::Buffer>,
    /// Numbers of buffers of the view columns.
    views: VecDeque<i64>,
    codec: Option<CompressionType>,
    version: MetadataVersion,
    body: &'a [u8],
    /// Decompressed size of the buffers so far, bytes.
    unpacked: u64,
    /// Index of the current column.
    column: usize,
    /// Number of buffers listed by the record batch.
    listed: usize,
    found: Vec<ColumnBuffer>,
    location: ContainerLocation<'a>,
}

/// Uncompressed offsets of lists.
#[derive(Clone, Copy)]
struct Offsets<'a> {
    bytes: &'a [u8],
    /// Size of an offset, 4 or 8 bytes.
    width: usize,
}

/// Offsets of the lists around a field, outermost first; `None` if compressed.
type Around<'a> = Vec<Option<Offsets<'a>>>;

impl<'a> BufferWalk<'a> {
    /// Checks a field that will be decoded.
    ///
    /// `len` is its required number of values, if known.
    fn field(
        &mut self,
        field: &Field,
        path: &str,
        len: Option<usize>,
        around: &mut Around<'a>,
    ) -> Result<()> {
        let node = self.node(path, len)?;
        let (len, nulls) = (node.length() as usize, node.null_count() > 0);
        let bitmap = len.div_ceil(8);
        self.buffer(path, if nulls { bitmap } else { 0 }, Some(bitmap))?;
        match field.data_type() {
            DataType::List(item) | DataType::LargeList(item) => {
                let width = if matches!(field.data_type(), DataType::List(_)) { 4 } else { 8 };
                let offsets = self.offsets(path, len, width)?;
                let items = self.peek(path)?;
                if let Some(offsets) = offsets {
                    self.check_offsets(path, offsets, items, around)?;
                }
                around.push(offsets);
                self.field(item, path, None, around)?;
                around.pop();
            }
            DataType::FixedSizeList(item, size) => {
                let items = usize::try_from(*size).ok().and_then(|size| len.checked_mul(size));
                around.push(None);
                self.field(item, path, items, around)?;
                around.pop();
            }
            DataType::Struct(fields) => {
                for field in fields {
                    self.field(field, &format!("{path}.{}", field.name()), Some(len), around)?;
                }
            }
            DataType::Boolean => drop(self.buffer(path, bitmap, Some(bitmap))?),
            DataType::Utf8 | DataType::Binary => {
                self.offsets(path, len, 4)?;
                self.buffer(path, 0, None)?;
            }
            DataType::LargeUtf8 => {
                self.offsets(path, len, 8)?;
                self.buffer(path, 0, None)?;
            }
            DataType::Utf8View => {
                self.buffer(path, VIEW_BYTES * len, Some(VIEW_BYTES * len))?;
                for _ in 0..self.view_buffers() {
                    self.buffer(path, 0, None)?;
                }
            }
            other => match other.primitive_width() {
                Some(width) => {
                    self.buffer(path, len * width, Some(len * width))?;
                    if let Some(values) = self.found.last_mut() {
                        values.is_samples = path == SAMPLES;
                    }
                }
                None => {
                    let problem = format!("a list cannot be passed over that holds a {other}");
                    return Err(self.location.bad_column(path, None, problem, "make it a column of its own"));
                }
            },
        }
        Ok(())
    }

    /// Checks an ignored column; only its numbers of nodes and buffers matter.
    fn pass(&mut self, data_type: &DataType, path: &str) -> Result<()> {
        use DataType as T;
        self.next_node(path)?;
        let buffers = match data_type {
            T::Null | T::RunEndEncoded(..) => 0,
            T::Struct(_) | T::FixedSizeList(..) => 1,
            T::Utf8 | T::Binary | T::LargeUtf8 | T::LargeBinary => 3,
            T::ListView(_) | T::LargeListView(_) => 3,
            T::Utf8View | T::BinaryView => self.view_buffers().saturating_add(2),
            T::Union(_, mode) => {
                let nulls = usize::from(self.version < MetadataVersion::V5);
                nulls + 1 + usize::from(*mode == UnionMode::Dense)
            }
            _ => 2,
        };
        if buffers > self.buffers.len() {
            return Err(self.missing(path));
        }
        self.buffers.drain(..buffers);
        match data_type {
            T::List(item) | T::LargeList(item) | T::Map(item, _) => self.pass(item.data_type(), path),
            T::ListView(item) | T::LargeListView(item) => self.pass(item.data_type(), path),
            T::FixedSizeList(item, _) => self.pass(item.data_type(), path),
            T::Struct(fields) => fields.iter().try_for_each(|field| self.pass(field.data_type(), path)),
            T::Union(fields, _) => {
                fields.iter().try_for_each(|(_, field)| self.pass(field.data_type(), path))
            }
            T::RunEndEncoded(ends, values) => {
                self.pass(ends.data_type(), path)?;
                self.pass(values.data_type(), path)
            }
            _ => Ok(()),
        }
    }

    /// Number of buffers with the texts of the next column of views; too many to exist if it is not listed.
    fn view_buffers(&mut self) -> usize {
        self.views.pop_front().and_then(|views| usize::try_from(views).ok()).unwrap_or(usize::MAX)
    }

    fn missing(&self, path: &str) -> Error {
        let problem = "the record batch lists fewer buffers than its schema needs";
        self.location.bad_column(path, None, problem, DAMAGED)
    }

    fn next_node(&mut self, path: &str) -> Result<FieldNode> {
        self.nodes.pop_front().ok_or_else(|| self.missing(path))
    }

    /// Number of items of the current list: the length of the next node.
    fn peek(&self, path: &str) -> Result<i64> {
        self.nodes.front().map(FieldNode::length).ok_or_else(|| self.missing(path))
    }

    /// Reads a node with plausible numbers.
    fn node(&mut self, path: &str, len: Option<usize>) -> Result<FieldNode> {
        let node = self.next_node(path)?;
        let (length, nulls) = (node.length(), node.null_count());
        let possible = (0..=i64::from(i32::MAX)).contains(&length) && (0..=length).contains(&nulls);
        if !possible || len.is_some_and(|len| len as i64 != length) {
            let expected = len.map_or(String::new(), |len| format!(", where {len} are expected"));
            let problem = format!("{length} values, {nulls} of them null{expected}");
            return Err(self.location.bad_column(path, None, problem, DAMAGED));
        }
        Ok(node)
    }

    /// Reads the next buffer.
    ///
    /// Its decompressed size must be at least `least` bytes and not much above `most`, if known.
    /// Returns the size, and the bytes if uncompressed.
    fn buffer(&mut self, path: &str, least: usize, most: Option<usize>) -> Result<(u64, Option<&'a [u8]>)> {
        let entry = self.buffers.pop_front().ok_or_else(|| self.missing(path))?;
        let bad = |problem| Err(self.location.bad_column(path, None, problem, DAMAGED));
        let (offset, length) = (usize::try_from(entry.offset()), usize::try_from(entry.length()));
        let bytes = match (offset, length) {
            (Ok(offset), Ok(length)) => self.body.get(offset..).and_then(|rest| rest.get(..length)),
            _ => None,
        };
        let Some(bytes) = bytes else {
            let (offset, length, end) = (entry.offset(), entry.length(), self.body.len());
            return bad(format!("a buffer of {length} bytes at byte {offset} of a body of {end}"));
        };
        let (size, raw) = match self.unpacked(bytes) {
            Ok(found) => found,
            Err(problem) => return bad(problem),
        };
        if size < least as u64 {
            return bad(format!("a buffer of {size} bytes, where {least} are needed"));
        }
        if raw.is_none()
            && let Some(most) = most.filter(|&most| size > 2 * most as u64 + SPARE_BYTES)
        {
            return bad(format!("a buffer that unpacks to {size} bytes, where {most} are needed"));
        }
        // Uncompressed buffers are copied as well, and many columns may list the same one.
        if self.codec.is_some() {
            self.unpacked += size;
        }
        if self.unpacked > MAX_BATCH_BYTES {
            return bad(format!("the record batch unpacks to over {MAX_BATCH_BYTES} bytes"));
        }
        // The buffer is in the body, and the length before compressed bytes is part of it.
        let end = entry.offset() as usize + bytes.len();
        let (start, unpacks_to) = match raw {
            Some(raw) => (end - raw.len(), None),
            None => (end - bytes.len() + LENGTH_BYTES, Some(size as usize)),
        };
        let number = self.listed - self.buffers.len() - 1;
        self.found.push(ColumnBuffer {
            number,
            column: self.column,
            bytes: start..end,
            unpacks_to,
            is_samples: false,
        });
        Ok((size, raw))
    }

    /// Decompressed size of a buffer, and its bytes if uncompressed.
    ///
    /// Sizes beyond the codec's limit are invalid: LZ4 expands a byte to at most 255, ZSTD four
    /// bytes to 128 KiB (a run-length block, RFC 8878, section 3.1.1.2).
    fn unpacked(&self, bytes: &'a [u8]) -> std::result::Result<(u64, Option<&'a [u8]>), String> {
        let Some(codec) = self.codec.filter(|_| !bytes.is_empty()) else {
            return Ok((bytes.len() as u64, Some(bytes)));
        };
        let Some((size, packed)) = bytes.split_first_chunk::<LENGTH_BYTES>() else {
            return Err(format!("a packed buffer of {} bytes", bytes.len()));
        };
        let most = match codec {
            CompressionType::LZ4_FRAME => 255,
            _ => 1 << 15,
        } * packed.len() as u64;
        match i64::from_le_bytes(*size) {
            -1 => Ok((packed.len() as u64, Some(packed))),
            size if u64::try_from(size).is_ok_and(|size| size <= most) => Ok((size as u64, None)),
            size => Err(format!("{} packed bytes that are said to unpack to {size}", packed.len())),
        }
    }

    /// Reads the offsets buffer of a list, `width` bytes each; `None` if compressed.
    fn offsets(&mut self, path: &str, len: usize, width: usize) -> Result<Option<Offsets<'a>>> {
        let need = if len == 0 { 0 } else { (len + 1) * width };
        let (size, raw) = self.buffer(path, need, Some((len + 1) * width))?;
        if !size.is_multiple_of(width as u64) {
            let problem = format!("offsets of {size} bytes, which is no multiple of {width}");
            return Err(self.location.bad_column(path, None, problem, DAMAGED));
        }
        Ok(raw.and_then(|raw| raw.get(..need)).map(|bytes| Offsets { bytes, width }))
    }

    /// Returns an error at the row of the first list that is not within its `items`.
    fn check_offsets(&self, path: &str, offsets: Offsets, items: i64, around: &Around) -> Result<()> {
        let mut before = 0;
        for (index, offset) in numbers(offsets).enumerate() {
            if offset < before || offset > items {
                let row = row_of(index.saturating_sub(1), around);
                let problem = format!("a list from {before} to {offset} of {items} items");
                return Err(self.location.bad_column(path, row, problem, DAMAGED));
            }
            before = offset;
        }
        Ok(())
    }
}

fn numbers(offsets: Offsets<'_>) -> impl Iterator<Item = i64> {
    offsets.bytes.chunks_exact(offsets.width).map(|bytes| {
        let wide = bytes.first_chunk().map(|bytes| i64::from_le_bytes(*bytes));
        let narrow = bytes.first_chunk().map(|bytes| i64::from(i32::from_le_bytes(*bytes)));
        wide.or(narrow).unwrap_or(-1)
    })
}

/// Row that contains item `index` of the innermost list.
///
/// `None` if the lists around it are compressed.
fn row_of(mut index: usize, around: &Around) -> Option<usize> {
    for offsets in around.iter().rev() {
        let until = numbers((*offsets)?).position(|offset| offset as usize > index)?;
        index = until.checked_sub(1)?;
    }
    Some(index)
}
