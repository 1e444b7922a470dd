//! Reader of containers.

use std::io::Read;
use std::path::{Path, PathBuf};

use super::decode::Decoder;
use super::location::ContainerLocation;
use super::messages::Messages;
use super::{ContainerHeader, ContainerLine, layout};
use crate::Result;

/// Reader of a container, one record batch at a time.
pub struct ContainerReader {
    file: PathBuf,
    header: ContainerHeader,
    messages: Messages,
    decoder: Decoder,
    /// Number of rows read.
    rows: u64,
}

impl ContainerReader {
    /// Opens a file in the file format or the stream format.
    ///
    /// The first bytes determine the format.
    pub fn open(path: &Path) -> Result<ContainerReader> {
        let (messages, schema) = Messages::open(path)?;
        ContainerReader::new(path, messages, &schema)
    }

    /// Reads either format sequentially, such as from standard input.
    ///
    /// `name` is for errors.
    pub fn from_stream(name: &Path, from: Box<dyn Read + Send>) -> Result<ContainerReader> {
        let (messages, schema) = Messages::stream(name, from)?;
        ContainerReader::new(name, messages, &schema)
    }

    /// Reads a container of either format from memory.
    #[cfg(test)]
    pub(super) fn from_bytes(name: &Path, bytes: Vec<u8>) -> Result<ContainerReader> {
        let len = bytes.len() as u64;
        let (messages, schema) = Messages::searchable(name, Box::new(std::io::Cursor::new(bytes)), len)?;
        ContainerReader::new(name, messages, &schema)
    }

    fn new(file: &Path, messages: Messages, schema: &arrow_schema::Schema) -> Result<ContainerReader> {
        let location = ContainerLocation { file, offset: 0, first_row: 0 };
        let header = ContainerHeader::from_metadata(schema.metadata(), location)?;
        let decoder = Decoder::new(schema, layout::find(schema, header.has_fractions, location)?);
        Ok(ContainerReader { file: file.to_path_buf(), header, messages, decoder, rows: 0 })
    }

    /// Leaves compressed samples as they are, which makes reading fast.
    ///
    /// The samples of later lines have their number, but any values.
    pub fn skip_samples(&mut self) {
        self.decoder.skip_samples();
    }

    /// Metadata of the recording.
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

    /// Returns the next record batch, or `None` at the end.
    ///
    /// Errors name the column and the row, counted from the start of the container, from 0.
    pub fn next_line(&mut self) -> Result<Option<ContainerLine>> {
        while let Some(message) = self.messages.next()? {
            let location =
                ContainerLocation { file: &self.file, offset: message.offset, first_row: self.rows };
            if let Some(line) = self.decoder.line(&message, location)? {
                self.rows += line.rows() as u64;
                return Ok(Some(line));
            }
        }
        Ok(None)
    }

    /// Continues with record batch `index`, from 0; `false` if the container is a stream.
    ///
    /// Rows in later errors count from this record batch.
    pub fn seek(&mut self, index: u64) -> bool {
        let Messages::File(messages) = &mut self.messages else { return false };
        messages.seek(index);
        self.rows = 0;
        true
    }

    /// Continues with the last record batch; `false` if the container is a stream.
    ///
    /// Rows in later errors count from this record batch.
    pub fn seek_last(&mut self) -> bool {
        let Messages::File(messages) = &self.messages else { return false };
        self.seek(messages.count().saturating_sub(1))
    }

    /// Fraction of the container that was read, 0 to 1, if its length is known.
    pub fn progress(&self) -> Option<f64> {
        self.messages.progress()
    }

    /// Whether a stream ended without an end-of-stream marker.
    ///
    /// It may have been cut off between two lines.
    pub fn ended_without_mark(&self) -> bool {
        matches!(&self.messages, Messages::Stream(stream) if stream.stopped())
    }
}
