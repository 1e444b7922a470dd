//! Messages read sequentially.

use std::io::{self, BufReader, Cursor, Read};
use std::path::{Path, PathBuf};

use arrow_buffer::Buffer;
use arrow_ipc::{MessageHeader, root_as_message};
use arrow_schema::Schema;

use super::{
    CONTINUATION, IpcMessage, MAGIC, MAX_METADATA_BYTES, SHORTER, check_digest, first_line, read_up_to,
    too_long,
};
use crate::container::checked_schema::schema_of;
use crate::container::location::{CUT_OFF, ContainerLocation, DAMAGED};
use crate::container::{MAX_BATCH_BYTES, digest};
use crate::{Error, Result};

/// Messages of a stream, or of a file read sequentially.
pub(in crate::container) struct StreamMessages {
    name: PathBuf,
    from: BufReader<Box<dyn Read + Send>>,
    /// Number of bytes read.
    pub(super) at: u64,
    /// Total number of bytes, if known.
    pub(super) len: Option<u64>,
    /// Whether it is a file, which starts with the magic.
    is_file: bool,
    state: StreamState,
    /// Whether the schema has a digest; each record batch then needs one.
    has_digests: bool,
    /// Number of messages read after the schema.
    batches: usize,
}

#[derive(Clone, Copy, PartialEq)]
enum StreamState {
    Open,
    /// The end marker was read.
    Ended,
    /// The bytes ended without it.
    Stopped,
}

impl StreamMessages {
    /// Reads the schema at the start of `from`.
    pub(super) fn open(name: &Path, mut from: Box<dyn Read + Send>) -> Result<(StreamMessages, Schema)> {
        let start = read_up_to(&mut from, 8).map_err(Error::io(name, "read"))?;
        if start.is_empty() {
            return Err(Error::unusable(name, "the file is empty", "copy it again from its source"));
        }
        let is_file = start.starts_with(MAGIC);
        let (from, at): (Box<dyn Read + Send>, u64) = match is_file {
            true => (from, 8),
            false => (Box::new(Cursor::new(start).chain(from)), 0),
        };
        let from = BufReader::with_capacity(1 << 18, from);
        let name = name.to_path_buf();
        let (state, has_digests) = (StreamState::Open, false);
        let mut stream =
            StreamMessages { name, from, at, len: None, is_file, state, has_digests, batches: 0 };
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
        let location = ContainerLocation { file: &self.name, offset: message.offset, first_row: 0 };
        let parsed = root_as_message(&message.metadata)
            .map_err(|e| location.bad("schema", first_line(&e), DAMAGED))?;
        let Some(schema) = parsed.header_as_schema() else {
            return Err(location.bad("schema", "the first message is no schema", DAMAGED));
        };
        self.has_digests =
            digest::check(&message.metadata, &[], parsed.custom_metadata(), "schema", location)?;
        schema_of(schema, location)
    }

    /// Returns the next message, or `None` at the end.
    pub(super) fn next(&mut self) -> Result<Option<IpcMessage>> {
        if self.state != StreamState::Open {
            return Ok(None);
        }
        let offset = self.at;
        let Some(length) = self.length()? else {
            return Ok(None);
        };
        let metadata = Buffer::from_vec(self.take(length, "metadata of a message")?);
        let location = ContainerLocation { file: &self.name, offset, first_row: 0 };
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
        let message = IpcMessage { offset, metadata: metadata.clone(), body };
        if !is_schema {
            let location = ContainerLocation { file: &self.name, offset, first_row: 0 };
            check_digest(&message, &parsed, self.batches, self.has_digests, location)?;
            self.batches += 1;
        }
        Ok(Some(message))
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
                self.state = StreamState::Stopped;
                Ok(None)
            }
            Some(0) => {
                self.state = StreamState::Ended;
                Ok(None)
            }
            Some(length) => match usize::try_from(length) {
                Ok(length) if length <= MAX_METADATA_BYTES => Ok(Some(length)),
                _ if start == 0 => Err(not_arrow(&self.name)),
                _ => {
                    let location = ContainerLocation { file: &self.name, offset: start, first_row: 0 };
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
        let location = ContainerLocation { file: &self.name, offset, first_row: 0 };
        location.bad(field, format!("the bytes end at byte {}", self.at), CUT_OFF)
    }

    /// Whether the bytes ended without the end-of-stream marker.
    pub(in crate::container) fn stopped(&self) -> bool {
        self.state == StreamState::Stopped
    }
}

fn not_arrow(name: &Path) -> Error {
    Error::unusable(
        name,
        "neither an Arrow IPC file nor a stream",
        "give a waveform container, or use the reader of the file's own format",
    )
}
