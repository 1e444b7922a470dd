//! Sequential reader of fixed-size records and lines.
//!
//! Allocates nothing by sizes from the file.

use std::fs::File;
use std::io::{BufRead, BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use super::super::bytes::Fields;
use super::super::{Error, Result, regular_file};

/// Number of bytes read to recognise a file, at most.
const HEAD_BYTES: usize = 4096;
/// Largest accepted record, bytes.
pub(super) const LONGEST_RECORD: usize = 4096;
/// Size of the parts of a text that are read for its ends, bytes.
const END_BYTES: u64 = 1 << 16;

/// Sequential reader of a file.
pub(super) struct InputFile {
    pub(super) path: PathBuf,
    /// Length of the file, bytes.
    pub(super) length: u64,
    /// Offset of the next byte.
    pub(super) offset: u64,
    reader: BufReader<File>,
    /// Whether records and lines between the first and the last ones are skipped.
    skips: bool,
}

impl InputFile {
    pub(super) fn open(path: &Path) -> Result<InputFile> {
        let file = regular_file(path)?;
        let length = file.metadata().map_err(Error::io(path, "open"))?.len();
        Ok(InputFile {
            path: path.to_owned(),
            length,
            offset: 0,
            reader: BufReader::with_capacity(1 << 16, file),
            skips: false,
        })
    }

    /// Skips all records but the first and the last, and the middle of a text.
    pub(super) fn only_ends(&mut self) {
        self.skips = true;
    }

    /// Returns the first bytes, at most [`HEAD_BYTES`], without advancing.
    pub(super) fn head(&mut self) -> Result<Vec<u8>> {
        let head = self.header(HEAD_BYTES)?;
        self.go_to(0)?;
        Ok(head)
    }

    /// Reads this many bytes, or as many as are left.
    pub(super) fn header(&mut self, bytes: usize) -> Result<Vec<u8>> {
        let mut header = vec![0; bytes.min(HEAD_BYTES)];
        let read = self.fill(&mut header)?;
        header.truncate(read);
        Ok(header)
    }

    /// Seeks to this offset.
    pub(super) fn go_to(&mut self, offset: u64) -> Result<()> {
        self.reader.seek(SeekFrom::Start(offset)).map_err(Error::io(&self.path, "read"))?;
        self.offset = offset;
        Ok(())
    }

    /// Reads records of `size` bytes, at most [`LONGEST_RECORD`].
    ///
    /// Stops after `count` records, or at the end of the file if `count` is `None`. `each` gets the
    /// number of the record, from 1, and its fields.
    pub(super) fn each(
        &mut self,
        size: usize,
        count: Option<u64>,
        mut each: impl FnMut(u64, Fields) -> Result<()>,
    ) -> Result<()> {
        let mut bytes = vec![0; size.clamp(1, LONGEST_RECORD)];
        let mut record = 0;
        let size_bytes = bytes.len() as u64;
        let total = count.unwrap_or(self.length.saturating_sub(self.offset) / size_bytes);
        while count.is_none_or(|count| record < count) {
            if self.skips && record == 1 && total > 2 {
                self.go_to(self.offset.saturating_add((total - 2).saturating_mul(size_bytes)))?;
                record = total - 1;
            }
            record += 1;
            let offset = self.offset;
            let read = self.fill(&mut bytes)?;
            if read == 0 && count.is_none() {
                break;
            }
            if read < bytes.len() {
                let problem = format!("{size} bytes needed, {read} left");
                let remedy = "the file is cut off: copy it again from its source";
                return Err(Error::malformed(
                    &self.path,
                    offset,
                    format!("record {record}"),
                    problem,
                    remedy,
                ));
            }
            each(record, Fields::new(&self.path, offset, &bytes))?;
        }
        Ok(())
    }

    /// Reads a line of at most `longest` bytes, without its end.
    ///
    /// `None` at the end of the file. Invalid UTF-8 is replaced.
    pub(super) fn line(&mut self, longest: u64) -> Result<Option<String>> {
        if self.skips && (END_BYTES..self.length.saturating_sub(END_BYTES)).contains(&self.offset) {
            self.go_to(self.length - END_BYTES)?;
            // The rest of the line at this place.
            self.line(longest)?;
        }
        let mut bytes = Vec::new();
        let read = self.reader.by_ref().take(longest + 1).read_until(b'\n', &mut bytes);
        let read = read.map_err(Error::io(&self.path, "read"))? as u64;
        if read == 0 {
            return Ok(None);
        }
        if read > longest && !bytes.ends_with(b"\n") {
            let problem = format!("it is longer than {longest} bytes");
            return Err(Error::malformed(
                &self.path,
                self.offset,
                "line",
                problem,
                "give a table with one line per record",
            ));
        }
        self.offset += read;
        Ok(Some(String::from_utf8_lossy(&bytes).trim().to_owned()))
    }

    /// Fills the buffer as far as possible; returns the count.
    fn fill(&mut self, buffer: &mut [u8]) -> Result<usize> {
        let mut filled = 0;
        while filled < buffer.len() {
            match self.reader.read(&mut buffer[filled..]) {
                Ok(0) => break,
                Ok(read) => filled += read,
                Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
                Err(error) => return Err(Error::io(&self.path, "read")(error)),
            }
        }
        self.offset += filled as u64;
        Ok(filled)
    }
}
