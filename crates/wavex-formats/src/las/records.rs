//! Point records in slabs, read directly (LAS) or decompressed (LAZ).

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use super::chunks::Chunks;
use super::header::LasHeader;
use super::vlr::Vlr;
use crate::{Error, Result, regular_file};

/// Records per slab.
const SLAB: u64 = 1024;

/// Iterator over the records of a file.
pub(super) struct RecordReader {
    source: RecordSource,
    record_length: usize,
    /// Number of records in the file.
    count: u64,
    /// Number of records not yet in a slab.
    left: u64,
    slab: Vec<u8>,
    /// Offset of the current record in the slab.
    at: usize,
}

enum RecordSource {
    /// The file, its path and the offset of its first point.
    Plain(File, PathBuf, u64),
    Compressed(Box<Chunks>),
}

impl RecordReader {
    /// Starts at the first point of the file `path`.
    ///
    /// # Errors
    /// The LASzip record is missing or contradicts the header.
    pub(super) fn open(
        path: &Path,
        header: &LasHeader,
        vlrs: &[Vlr],
        file_length: u64,
    ) -> Result<RecordReader> {
        let mut file = regular_file(path)?;
        let source = if header.compressed {
            RecordSource::Compressed(Box::new(Chunks::open(file, path, header, vlrs, file_length)?))
        } else {
            let start = u64::from(header.offset_to_points);
            file.seek(SeekFrom::Start(start)).map_err(Error::io(path, "seek to the points"))?;
            RecordSource::Plain(file, path.to_path_buf(), start)
        };
        let record_length = header.record_length.into();
        let count = header.n_points;
        Ok(RecordReader { source, record_length, count, left: count, slab: Vec::new(), at: 0 })
    }

    /// The compressed points; `None` if they are not compressed.
    pub(super) fn compressed(&self) -> Option<&Chunks> {
        match &self.source {
            RecordSource::Compressed(chunks) => Some(chunks),
            RecordSource::Plain(..) => None,
        }
    }

    /// See [`Reader::skip_unused_fields`](super::Reader::skip_unused_fields).
    pub(super) fn skip_unused_fields(&mut self) {
        if let RecordSource::Compressed(chunks) = &mut self.source {
            chunks.skip_unused_fields();
        }
    }

    /// Continues with record `index`, from 0; at the end if there are fewer.
    ///
    /// # Errors
    /// The file cannot be read, or the compressed points before the record in its chunk are damaged.
    pub(super) fn seek(&mut self, index: u64) -> Result<()> {
        self.slab.clear();
        (self.at, self.left) = (0, 0);
        let Some(left) = self.count.checked_sub(index) else { return Ok(()) };
        match &mut self.source {
            RecordSource::Plain(file, path, start) => {
                let to = SeekFrom::Start(*start + index * self.record_length as u64);
                file.seek(to).map_err(Error::io(path, "seek to a point"))?;
            }
            RecordSource::Compressed(chunks) => chunks.seek(index)?,
        }
        self.left = left;
        Ok(())
    }

    /// Advances to the next record.
    ///
    /// `false` at the end or after an error.
    ///
    /// # Errors
    /// The file cannot be read, or its compressed points are damaged. Iteration then ends, because
    /// later compressed data depend on earlier data.
    pub(super) fn advance(&mut self) -> Result<bool> {
        self.at += self.record_length;
        if self.at < self.slab.len() {
            return Ok(true);
        }
        let count = self.left.min(SLAB);
        self.at = 0;
        self.slab.resize(count as usize * self.record_length, 0);
        self.left -= count;
        let filled = match &mut self.source {
            RecordSource::Plain(file, path, _) => {
                file.read_exact(&mut self.slab).map_err(Error::io(path, "read the points"))
            }
            RecordSource::Compressed(chunks) => chunks.fill(&mut self.slab),
        };
        if filled.is_err() {
            self.slab.clear();
            self.left = 0;
        }
        filled.map(|()| count > 0)
    }

    /// Returns the current record.
    ///
    /// Empty before the first and after the last.
    pub(super) fn record(&self) -> &[u8] {
        self.slab.get(self.at..self.at + self.record_length).unwrap_or_default()
    }
}
