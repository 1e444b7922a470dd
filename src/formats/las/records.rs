//! The points' records in slabs: straight from the file (LAS) or decompressed (LAZ).

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use super::chunks::Chunks;
use super::header::Header;
use super::vlr::Vlr;
use crate::formats::{Error, Result};

/// Records of a slab.
const SLAB: u64 = 1024;

/// A walk over the records of a file.
pub(super) struct Records {
    source: Source,
    record_length: usize,
    /// Records that are not in a slab yet.
    left: u64,
    slab: Vec<u8>,
    /// Where the next record starts in the slab.
    at: usize,
}

enum Source {
    Plain(File, PathBuf),
    Compressed(Box<Chunks>),
}

impl Records {
    /// Starts at the first point of the file `path`.
    ///
    /// # Errors
    /// What LASzip says of itself in the file is missing or contradicts the header.
    pub(super) fn open(path: &Path, header: &Header, vlrs: &[Vlr], file_length: u64) -> Result<Records> {
        let mut file = File::open(path).map_err(Error::io(path, "open"))?;
        let source = if header.compressed {
            Source::Compressed(Box::new(Chunks::open(file, path, header, vlrs, file_length)?))
        } else {
            let start = SeekFrom::Start(header.offset_to_points.into());
            file.seek(start).map_err(Error::io(path, "seek to the points"))?;
            Source::Plain(file, path.to_path_buf())
        };
        let record_length = header.record_length.into();
        Ok(Records { source, record_length, left: header.n_points, slab: Vec::new(), at: 0 })
    }

    /// Goes to the next record; `false`: there is none, or an error came before.
    ///
    /// # Errors
    /// The file cannot be read, or its compressed points are damaged. The walk is over then: what follows in a compressed
    /// file depends on what came before.
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
            Source::Plain(file, path) => {
                file.read_exact(&mut self.slab).map_err(Error::io(path, "read the points"))
            }
            Source::Compressed(chunks) => chunks.fill(&mut self.slab),
        };
        if filled.is_err() {
            self.slab.clear();
            self.left = 0;
        }
        filled.map(|()| count > 0)
    }

    /// The record gone to last; empty before the first and after the last.
    pub(super) fn record(&self) -> &[u8] {
        self.slab.get(self.at..self.at + self.record_length).unwrap_or_default()
    }
}
