//! Messages of an IPC file or stream; lengths are checked before memory is allocated.
//!
//! Arrow columnar format 1.5, "Encapsulated message format", "IPC streaming format" and "IPC file
//! format".

use std::fs::File;
use std::io::{self, BufReader, Cursor, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use arrow_buffer::Buffer;
use arrow_ipc::{Block, Footer, MessageHeader, root_as_footer, root_as_message};
use arrow_schema::Schema;

use super::decode::schema_of;
use super::location::{CUT_OFF, DAMAGED, Location};
use super::{MAX_BATCH_BYTES, MOST_KEPT_BYTES};
use crate::{Error, Result};

/// First and last bytes of the file format.
const MAGIC: &[u8; 6] = b"ARROW1";

/// Marker before the length of a message, since format version 0.15.
const CONTINUATION: [u8; 4] = [0xff; 4];

/// Longest accepted metadata of a message, bytes.
///
/// A thousand times the size needed for a scan line.
const MAX_METADATA_BYTES: usize = 1 << 24;

/// Memory allocated for a stream's message before its bytes arrive, bytes.
const MAX_AHEAD: usize = 1 << 22;

/// Bytes with random access.
pub(super) trait Searchable: Read + Seek {}

impl<T: Read + Seek> Searchable for T {}

/// One message: a record batch, or a dictionary.
pub(super) struct Message {
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
        let start = read_up_to(&mut from, MAGIC.len()).map_err(Error::io(name, "read"))?;
        from.seek(SeekFrom::Start(0)).map_err(Error::io(name, "read"))?;
        if start == MAGIC {
            let (messages, schema) = FileMessages::open(name, from, len)?;
            return Ok((Messages::File(messages), schema));
        }
        let (mut stream, schema) = StreamMessages::open(name, Box::new(from))?;
        stream.len = Some(len);
        Ok((Messages::Stream(stream), schema))
    }

    /// Reads a stream, or a file sequentially, and its schema.
    pub(super) fn stream(name: &Path, from: Box<dyn Read>) -> Result<(Messages, Schema)> {
        let (messages, schema) = StreamMessages::open(name, from)?;
        Ok((Messages::Stream(messages), schema))
    }

    /// Returns the next message, or `None` at the end.
    pub(super) fn next(&mut self) -> Result<Option<Message>> {
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
    /// Bytes of the last message; reused once nobody uses them.
    last: Option<Buffer>,
}

impl FileMessages {
    fn open(name: &Path, mut file: Box<dyn Searchable>, len: u64) -> Result<(FileMessages, Schema)> {
        let (offset, bytes) = footer_bytes(name, &mut *file, len)?;
        let location = Location { file: name, offset, first_row: 0 };
        let footer = root_as_footer(&bytes).map_err(|e| location.bad("footer", first_line(&e), DAMAGED))?;
        let schema = footer.schema().ok_or_else(|| location.bad("footer", "it has no schema", DAMAGED))?;
        let schema = schema_of(schema, location)?;
        let blocks = blocks_of(&footer, offset, location)?;
        Ok((FileMessages { name: name.to_path_buf(), file, blocks, next: 0, last: None }, schema))
    }

    fn next(&mut self) -> Result<Option<Message>> {
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
        let location = Location { file: &self.name, offset, first_row: 0 };
        if bytes.len() < len {
            return Err(location.bad("record batch", "the file has become shorter", CUT_OFF));
        }
        let (start, length) = prefix(&bytes);
        let fits = start.checked_add(length).is_some_and(|end| end <= head);
        if !fits {
            return Err(location.bad("length of the metadata", "it passes the record batch", DAMAGED));
        }
        let metadata = bytes.slice_with_length(start, length);
        Ok(Some(Message { offset, metadata, body: bytes.slice(head) }))
    }
}

/// Reads the footer of a file; returns it with its start.
fn footer_bytes(name: &Path, file: &mut dyn Searchable, len: u64) -> Result<(u64, Vec<u8>)> {
    let location = Location { file: name, offset: len.saturating_sub(10), first_row: 0 };
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
fn blocks_of(footer: &Footer, end: u64, location: Location) -> Result<Vec<Block>> {
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

/// Messages of a stream, or of a file read sequentially.
pub(super) struct StreamMessages {
    name: PathBuf,
    from: BufReader<Box<dyn Read>>,
    /// Number of bytes read.
    at: u64,
    /// Total number of bytes, if known.
    len: Option<u64>,
    /// Whether it is a file, which starts with the magic.
    is_file: bool,
    state: State,
}

#[derive(Clone, Copy, PartialEq)]
enum State {
    Open,
    /// The end marker was read.
    Ended,
    /// The bytes ended without it.
    Stopped,
}

impl StreamMessages {
    fn open(name: &Path, mut from: Box<dyn Read>) -> Result<(StreamMessages, Schema)> {
        let start = read_up_to(&mut from, 8).map_err(Error::io(name, "read"))?;
        if start.is_empty() {
            return Err(Error::unusable(name, "the file is empty", "copy it again from its source"));
        }
        let is_file = start.starts_with(MAGIC);
        let (from, at): (Box<dyn Read>, u64) = match is_file {
            true => (from, 8),
            false => (Box::new(Cursor::new(start).chain(from)), 0),
        };
        let from = BufReader::with_capacity(1 << 18, from);
        let name = name.to_path_buf();
        let mut stream = StreamMessages { name, from, at, len: None, is_file, state: State::Open };
        if is_file {
            stream.skip_padding()?;
        }
        let schema = stream.schema()?;
        Ok((stream, schema))
    }

    /// Skips the zeros with which a writer may pad the magic to 16, 32 or 64 bytes.
    fn skip_padding(&mut self) -> Result<()> {
        while self.at < 64 {
            let buffered = io::BufRead::fill_buf(&mut self.from).map_err(Error::io(&self.name, "read"))?;
            match buffered.first() {
                Some(0) => io::BufRead::consume(&mut self.from, 1),
                _ => break,
            }
            self.at += 1;
        }
        Ok(())
    }

    fn schema(&mut self) -> Result<Schema> {
        let Some(message) = self.next()? else {
            return Err(not_arrow(&self.name));
        };
        let location = Location { file: &self.name, offset: message.offset, first_row: 0 };
        let parsed = root_as_message(&message.metadata)
            .map_err(|e| location.bad("schema", first_line(&e), DAMAGED))?;
        match parsed.header_as_schema() {
            Some(schema) => schema_of(schema, location),
            None => Err(location.bad("schema", "the first message is no schema", DAMAGED)),
        }
    }

    fn next(&mut self) -> Result<Option<Message>> {
        if self.state != State::Open {
            return Ok(None);
        }
        let offset = self.at;
        let Some(length) = self.length()? else {
            return Ok(None);
        };
        let metadata = Buffer::from_vec(self.take(length, "metadata of a message")?);
        let location = Location { file: &self.name, offset, first_row: 0 };
        let parsed =
            root_as_message(&metadata).map_err(|e| location.bad("message", first_line(&e), DAMAGED))?;
        let (body, is_schema) = (parsed.bodyLength(), parsed.header_type() == MessageHeader::Schema);
        let bytes = match u64::try_from(body) {
            Ok(bytes) if bytes <= MAX_BATCH_BYTES && !(is_schema && bytes > 0) => bytes as usize,
            Ok(bytes) if bytes > MAX_BATCH_BYTES => {
                return Err(location.bad("length of the body", too_long(body), SHORTER));
            }
            _ => return Err(location.bad("length of the body", format!("it is {body}"), DAMAGED)),
        };
        let body = Buffer::from_vec(self.take(bytes, "body of a message")?);
        Ok(Some(Message { offset, metadata, body }))
    }

    /// Reads the length of the next message's metadata; `None` at the end.
    fn length(&mut self) -> Result<Option<usize>> {
        let start = self.at;
        let mut word = self.word()?;
        if word == Some(CONTINUATION) {
            word = self.word()?;
            if word.is_none() {
                return Err(self.cut_off(start, "length of a message"));
            }
        }
        match word.map(i32::from_le_bytes) {
            None if self.is_file => Err(self.cut_off(start, "end of the file")),
            None => {
                self.state = State::Stopped;
                Ok(None)
            }
            Some(0) => {
                self.state = State::Ended;
                Ok(None)
            }
            Some(length) => match usize::try_from(length) {
                Ok(length) if length <= MAX_METADATA_BYTES => Ok(Some(length)),
                _ if start == 0 => Err(not_arrow(&self.name)),
                _ => {
                    let location = Location { file: &self.name, offset: start, first_row: 0 };
                    Err(location.bad("length of a message", format!("it is {length}"), DAMAGED))
                }
            },
        }
    }

    /// Reads the next four bytes; `None` if the bytes end before them.
    fn word(&mut self) -> Result<Option<[u8; 4]>> {
        let bytes = read_up_to(&mut self.from, 4).map_err(Error::io(&self.name, "read"))?;
        let start = self.at;
        self.at += bytes.len() as u64;
        match (bytes.first_chunk::<4>(), bytes.is_empty()) {
            (Some(word), _) => Ok(Some(*word)),
            (None, true) => Ok(None),
            (None, false) => Err(self.cut_off(start, "length of a message")),
        }
    }

    fn take(&mut self, n: usize, field: &str) -> Result<Vec<u8>> {
        let start = self.at;
        let bytes = read_up_to(&mut self.from, n).map_err(Error::io(&self.name, "read"))?;
        self.at += bytes.len() as u64;
        if bytes.len() == n { Ok(bytes) } else { Err(self.cut_off(start, field)) }
    }

    fn cut_off(&self, offset: u64, field: &str) -> Error {
        let location = Location { file: &self.name, offset, first_row: 0 };
        location.bad(field, format!("the bytes end at byte {}", self.at), CUT_OFF)
    }

    /// Whether the bytes ended without the end-of-stream marker.
    pub(super) fn stopped(&self) -> bool {
        self.state == State::Stopped
    }
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
    bytes.reserve_exact(n.min(MAX_AHEAD));
    from.take(n as u64).read_to_end(bytes)?;
    Ok(())
}

fn not_arrow(name: &Path) -> Error {
    Error::unusable(
        name,
        "neither an Arrow IPC file nor a stream",
        "give a waveform container, or use the reader of the file's own format",
    )
}

/// First line of a flatbuffer error; the others trace the verifier.
pub(super) fn first_line(error: &impl std::fmt::Display) -> String {
    error.to_string().lines().next().unwrap_or("is not readable").trim_end_matches('.').to_string()
}
