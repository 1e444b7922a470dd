//! Messages of an IPC file or stream; lengths are checked before memory is allocated.
//!
//! Arrow columnar format 1.5, "Encapsulated message format", "IPC streaming format" and "IPC file
//! format".

mod stream;

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use arrow_buffer::Buffer;
use arrow_ipc::{Block, Footer, root_as_footer, root_as_message};
use arrow_schema::Schema;

use super::checked_schema::schema_of;
use super::location::{CUT_OFF, ContainerLocation, DAMAGED};
use super::{MAX_BATCH_BYTES, MOST_KEPT_BYTES, digest};
use crate::other_format::{DECISIVE_BYTES, other_format};
use crate::{Error, Result, make_room};
use stream::StreamMessages;

/// First and last bytes of the file format.
pub(super) const MAGIC: &[u8; 6] = b"ARROW1";

/// Marker before the length of a message, since format version 0.15.
pub(super) const CONTINUATION: [u8; 4] = [0xff; 4];

/// Longest accepted metadata of a message, bytes.
///
/// A thousand times the size needed for a scan line.
const MAX_METADATA_BYTES: usize = 1 << 24;

/// Memory allocated for a stream's message before its bytes arrive, bytes.
const MAX_AHEAD: usize = 1 << 22;

/// Bytes with random access.
pub(super) trait Searchable: Read + Seek + Send {}

impl<T: Read + Seek + Send> Searchable for T {}

/// One message: a record batch, or a dictionary.
pub(super) struct IpcMessage {
    /// Start of the message, bytes from the beginning of the file.
    pub(super) offset: u64,
    /// The flatbuffer.
    pub(super) metadata: Buffer,
    /// The buffers.
    pub(super) body: Buffer,
}

/// Messages of a container, in order.
pub(super) enum Messages {
    /// By the list at the end of a file.
    File(FileMessages),
    /// Sequentially.
    Stream(StreamMessages),
}

impl Messages {
    /// Opens a file of either format and reads its schema.
    pub(super) fn open(path: &Path) -> Result<(Messages, Schema)> {
        let file = File::open(path).map_err(Error::io(path, "open"))?;
        let about = file.metadata().map_err(Error::io(path, "open"))?;
        if !about.is_file() {
            return Messages::stream(path, Box::new(file));
        }
        Messages::searchable(path, Box::new(file), about.len())
    }

    /// Reads `len` bytes of either format with random access.
    pub(super) fn searchable(
        name: &Path,
        mut from: Box<dyn Searchable>,
        len: u64,
    ) -> Result<(Messages, Schema)> {
        let start = read_up_to(&mut from, DECISIVE_BYTES).map_err(Error::io(name, "read"))?;
        from.seek(SeekFrom::Start(0)).map_err(Error::io(name, "read"))?;
        if start.starts_with(MAGIC) {
            let (messages, schema) = FileMessages::open(name, from, len)?;
            return Ok((Messages::File(messages), schema));
        }
        let opened = StreamMessages::open(name, Box::new(from)).map_err(|error| match error {
            Error::Unusable { .. } => other_format(name, &start, "read_arrow").unwrap_or(error),
            error => error,
        });
        let (mut stream, schema) = opened?;
        stream.len = Some(len);
        Ok((Messages::Stream(stream), schema))
    }

    /// Reads a stream, or a file sequentially, and its schema.
    pub(super) fn stream(name: &Path, from: Box<dyn Read + Send>) -> Result<(Messages, Schema)> {
        let (messages, schema) = StreamMessages::open(name, from)?;
        Ok((Messages::Stream(messages), schema))
    }

    /// Returns the next message, or `None` at the end.
    pub(super) fn next(&mut self) -> Result<Option<IpcMessage>> {
        match self {
            Messages::File(messages) => messages.next(),
            Messages::Stream(messages) => messages.next(),
        }
    }

    /// Fraction of the container that was read, 0 to 1, if its length is known.
    pub(super) fn progress(&self) -> Option<f64> {
        match self {
            Messages::File(messages) if messages.blocks.is_empty() => Some(1.0),
            Messages::File(messages) => Some(messages.next as f64 / messages.blocks.len() as f64),
            Messages::Stream(messages) => messages.len.map(|len| messages.at as f64 / (len as f64).max(1.0)),
        }
    }
}

/// Record batches listed in the footer of a file.
pub(super) struct FileMessages {
    name: PathBuf,
    file: Box<dyn Searchable>,
    blocks: Vec<Block>,
    next: usize,
    /// Whether the footer has a digest; each record batch then needs one.
    has_digests: bool,
    /// Bytes of the last message; reused once nobody uses them.
    last: Option<Buffer>,
}

impl FileMessages {
    fn open(name: &Path, mut file: Box<dyn Searchable>, len: u64) -> Result<(FileMessages, Schema)> {
        let (offset, bytes) = footer_bytes(name, &mut *file, len)?;
        let location = ContainerLocation { file: name, offset, first_row: 0 };
        let footer = root_as_footer(&bytes).map_err(|e| location.bad("footer", first_line(&e), DAMAGED))?;
        let has_digests = digest::check(&bytes, &[], footer.custom_metadata(), "footer", location)?;
        let schema = footer.schema().ok_or_else(|| location.bad("footer", "it has no schema", DAMAGED))?;
        let schema = schema_of(schema, location)?;
        let blocks = blocks_of(&footer, offset, location)?;
        let name = name.to_path_buf();
        Ok((FileMessages { name, file, blocks, next: 0, has_digests, last: None }, schema))
    }

    /// Number of record batches.
    pub(super) fn count(&self) -> u64 {
        self.blocks.len() as u64
    }

    /// Continues with message `index`, from 0.
    pub(super) fn seek(&mut self, index: u64) {
        self.next = usize::try_from(index).unwrap_or(usize::MAX);
    }

    fn next(&mut self) -> Result<Option<IpcMessage>> {
        let Some(block) = self.blocks.get(self.next) else {
            return Ok(None);
        };
        self.next += 1;
        // `blocks_of` has checked the signs and that the block is in the file.
        let (offset, head) = (block.offset() as u64, block.metaDataLength() as usize);
        let len = head + block.bodyLength() as usize;
        let io = Error::io(&self.name, "read a record batch of");
        self.file.seek(SeekFrom::Start(offset)).map_err(&io)?;
        let mut bytes = self.last.take().and_then(|last| last.into_vec().ok()).unwrap_or_default();
        read_into(&mut self.file, len, &mut bytes).map_err(&io)?;
        let bytes = Buffer::from_vec(bytes);
        self.last = (len <= MOST_KEPT_BYTES).then(|| bytes.clone());
        let location = ContainerLocation { file: &self.name, offset, first_row: 0 };
        if bytes.len() < len {
            return Err(location.bad("record batch", "the file has become shorter", CUT_OFF));
        }
        let (start, length) = prefix(&bytes);
        let fits = start.checked_add(length).is_some_and(|end| end <= head);
        if !fits {
            return Err(location.bad("length of the metadata", "it passes the record batch", DAMAGED));
        }
        let metadata = bytes.slice_with_length(start, length);
        let message = IpcMessage { offset, metadata, body: bytes.slice(head) };
        let parsed = root_as_message(&message.metadata)
            .map_err(|e| location.bad("message", first_line(&e), DAMAGED))?;
        check_digest(&message, &parsed, self.next - 1, self.has_digests, location)?;
        Ok(Some(message))
    }
}

/// Checks the digest of record batch `index`; `required` if it must have one.
fn check_digest(
    message: &IpcMessage,
    parsed: &arrow_ipc::Message,
    index: usize,
    required: bool,
    location: ContainerLocation,
) -> Result<()> {
    let name = format!("record batch {index}");
    let entries = parsed.custom_metadata();
    if !digest::check(&message.metadata, &message.body, entries, &name, location)? && required {
        return Err(location.bad(name, "it has no digest, but the schema has one", DAMAGED));
    }
    Ok(())
}

/// Reads the footer of a file; returns it with its start.
fn footer_bytes(name: &Path, file: &mut dyn Searchable, len: u64) -> Result<(u64, Vec<u8>)> {
    let location = ContainerLocation { file: name, offset: len.saturating_sub(10), first_row: 0 };
    // `ARROW1` and two zeros at the beginning; the footer's length and `ARROW1` at the end.
    let Some(end) = len.checked_sub(10).filter(|&end| end >= 8) else {
        return Err(location.bad("end of the file", "the footer is missing", CUT_OFF));
    };
    let io = Error::io(name, "read the end of");
    file.seek(SeekFrom::Start(end)).map_err(&io)?;
    let tail = read_up_to(&mut *file, 10).map_err(&io)?;
    let Some((length, magic)) = tail.split_first_chunk::<4>() else {
        return Err(location.bad("end of the file", "the footer is missing", CUT_OFF));
    };
    if magic != MAGIC {
        return Err(location.bad("end of the file", "the footer is missing", CUT_OFF));
    }
    let length = i32::from_le_bytes(*length);
    let Some(start) = u64::try_from(length).ok().and_then(|length| (end - 8).checked_sub(length)) else {
        return Err(location.bad("length of the footer", format!("it is {length}"), DAMAGED));
    };
    file.seek(SeekFrom::Start(8 + start)).map_err(&io)?;
    let bytes = read_up_to(&mut *file, length as usize).map_err(&io)?;
    Ok((8 + start, bytes))
}

/// Record batches listed in the footer.
///
/// Each is between the magic and the footer, which starts at `end`.
fn blocks_of(footer: &Footer, end: u64, location: ContainerLocation) -> Result<Vec<Block>> {
    let blocks: Vec<Block> = footer.recordBatches().iter().flatten().copied().collect();
    for (index, block) in blocks.iter().enumerate() {
        let field = format!("footer, record batch {index}");
        let numbers = (block.offset(), i64::from(block.metaDataLength()), block.bodyLength());
        let inside = match numbers {
            (8.., 8.., 0..) => block_end(numbers).is_some_and(|until| until <= end),
            _ => false,
        };
        if !inside {
            let (offset, head, body) = numbers;
            let problem = format!("{head} + {body} bytes at byte {offset} do not lie in the file");
            return Err(location.bad(field, problem, DAMAGED));
        }
        if block.bodyLength() as u64 > MAX_BATCH_BYTES {
            return Err(location.bad(field, too_long(block.bodyLength()), SHORTER));
        }
    }
    Ok(blocks)
}

/// End of a block of (offset, metadata, body), if it can be computed.
fn block_end((offset, head, body): (i64, i64, i64)) -> Option<u64> {
    offset.checked_add(head)?.checked_add(body).and_then(|end| u64::try_from(end).ok())
}

/// Start of the flatbuffer in a message, and its declared length.
fn prefix(bytes: &[u8]) -> (usize, usize) {
    let word = |at: usize| bytes.get(at..).and_then(|rest| rest.first_chunk::<4>()).copied();
    let (start, length) = match word(0) {
        Some(CONTINUATION) => (8, word(4)),
        first => (4, first),
    };
    // A negative length becomes one that fits nowhere.
    (start, length.map_or(usize::MAX, |length| i32::from_le_bytes(length) as usize))
}

const SHORTER: &str = "write one record batch per scan line";

fn too_long(bytes: i64) -> String {
    format!("a record batch of {bytes} bytes, where at most {MAX_BATCH_BYTES} are read")
}

/// Reads the next `n` bytes, or as many as there are.
///
/// Memory grows with the bytes read.
fn read_up_to(from: &mut (impl Read + ?Sized), n: usize) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    read_into(from, n, &mut bytes)?;
    Ok(bytes)
}

/// As [`read_up_to`], into the memory of `bytes`, which are cleared.
fn read_into(from: &mut (impl Read + ?Sized), n: usize, bytes: &mut Vec<u8>) -> io::Result<()> {
    bytes.clear();
    while bytes.len() < n {
        // The room is exact: `read_to_end` of a full buffer would end the process without memory.
        let step = (n - bytes.len()).min(bytes.len().max(MAX_AHEAD));
        make_room(bytes, step)?;
        if (&mut *from).take(step as u64).read_to_end(bytes)? < step {
            break;
        }
    }
    Ok(())
}

/// First line of a flatbuffer error; the others trace the verifier.
pub(super) fn first_line(error: &impl std::fmt::Display) -> String {
    error.to_string().lines().next().unwrap_or("is not readable").trim_end_matches('.').to_string()
}
