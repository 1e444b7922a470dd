//! Reading a container.

use std::io::Read;
use std::path::{Path, PathBuf};

use super::decode::Decoder;
use super::messages::Messages;
use super::place::Place;
use super::{ContainerHeader, ContainerLine, layout};
use crate::formats::Result;

/// A container that is being read, one record batch after the other.
pub struct ContainerReader {
    file: PathBuf,
    header: ContainerHeader,
    messages: Messages,
    decoder: Decoder,
    /// How many rows were read.
    rows: u64,
}

impl ContainerReader {
    /// Opens a file of the file or of the stream format, as its first bytes say.
    pub fn open(path: &Path) -> Result<ContainerReader> {
        let (messages, schema) = Messages::open(path)?;
        ContainerReader::new(path, messages, &schema)
    }

    /// Reads either format from beginning to end, without searching: standard input. `name` is for errors.
    pub fn from_stream(name: &Path, from: Box<dyn Read>) -> Result<ContainerReader> {
        let (messages, schema) = Messages::stream(name, from)?;
        ContainerReader::new(name, messages, &schema)
    }

    /// Reads a container of either format in memory, as from a file.
    #[cfg(test)]
    pub(super) fn from_bytes(name: &Path, bytes: Vec<u8>) -> Result<ContainerReader> {
        let len = bytes.len() as u64;
        let (messages, schema) = Messages::searchable(name, Box::new(std::io::Cursor::new(bytes)), len)?;
        ContainerReader::new(name, messages, &schema)
    }

    fn new(file: &Path, messages: Messages, schema: &arrow_schema::Schema) -> Result<ContainerReader> {
        let place = Place { file, offset: 0, first_row: 0 };
        let header = ContainerHeader::from_metadata(schema.metadata(), place)?;
        let decoder = Decoder::new(schema, layout::find(schema, place)?);
        Ok(ContainerReader { file: file.to_path_buf(), header, messages, decoder, rows: 0 })
    }

    /// What the container says of the recording as a whole.
    pub fn header(&self) -> &ContainerHeader {
        &self.header
    }

    /// `file` or `stream`.
    pub fn form(&self) -> &'static str {
        match &self.messages {
            Messages::File(_) => "file",
            Messages::Stream(_) => "stream",
        }
    }

    /// The next record batch, or `None` at the end. An error names the column and the row, counted through the
    /// container from 0.
    pub fn next_line(&mut self) -> Result<Option<ContainerLine>> {
        while let Some(message) = self.messages.next()? {
            let place = Place { file: &self.file, offset: message.offset, first_row: self.rows };
            if let Some(line) = self.decoder.line(&message, place)? {
                self.rows += line.rows() as u64;
                return Ok(Some(line));
            }
        }
        Ok(None)
    }

    /// How far the container has been read, from 0 to 1, where its length is known.
    pub fn progress(&self) -> Option<f64> {
        self.messages.progress()
    }

    /// Whether a stream ended without the mark that says so: it may have been cut off between two lines.
    pub fn ended_without_mark(&self) -> bool {
        matches!(&self.messages, Messages::Stream(stream) if stream.stopped())
    }
}
