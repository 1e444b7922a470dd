//! Files as other decoders may read them: with checked sizes, and without records that these trust.

use std::fs::File;
use std::io::{self, Cursor, Read, Seek, SeekFrom};
use std::path::Path;

use laz::LazVlr;
use laz::laszip::ChunkTable;

use super::header::{LasHeader, header_bytes};
use super::raw::RawPoints;
use crate::{Error, Result, regular_file};

/// Offset and length of the number of points, in total and by return, in headers before LAS 1.4.
const LEGACY_COUNTS: std::ops::Range<usize> = 107..131;

/// LAS 1.4 file with a header of its own, the LASzip record, and the points of another file.
///
/// For decoders that trust sizes: the crate `las` allocates records before it reads them, holds waveforms of gigabytes as a record, and
/// refuses some pairs of version and point format. Offsets of the header belong to this file. What follows the points is
/// readable, but the header names none of it.
#[derive(Debug)]
pub struct CheckedFile {
    head: Cursor<Vec<u8>>,
    points: File,
    /// Offset of the first byte of `points` after the head.
    start: u64,
    length: u64,
    at: u64,
}

impl RawPoints {
    /// Opens the file once more, for another decoder; `path` is that of the file.
    ///
    /// Reads the head of each compressed chunk.
    ///
    /// # Errors
    /// The file cannot be read, or sizes within its compressed points contradict each other.
    pub fn checked_file(&self, path: &Path) -> Result<CheckedFile> {
        let source = self.header();
        let failed = Error::io(path, "read");
        let laz = self.vlrs().iter().find(|vlr| vlr.is(LazVlr::USER_ID, LazVlr::RECORD_ID));
        let laz = laz.filter(|_| source.compressed).map_or(Ok(Vec::new()), |vlr| vlr.write(path))?;
        let header_size = header_bytes(4);
        let offset_to_points = u32::from(header_size) + laz.len() as u32;
        let header = LasHeader {
            version: (1, 4),
            header_size,
            offset_to_points,
            n_vlrs: u32::from(source.compressed),
            point_format: source.point_format,
            compressed: source.compressed,
            record_length: source.record_length,
            n_points: source.n_points,
            scale: source.scale,
            offset: source.offset,
            min: source.min,
            max: source.max,
            ..LasHeader::default()
        };
        let mut head = header.write();
        head[LEGACY_COUNTS].fill(0);
        head.extend(laz);
        let points = regular_file(path)?;
        let mut start = u64::from(source.offset_to_points);
        if let Some(chunks) = self.compressed() {
            chunks.check_heads()?;
            let table = chunks.table_at() - start + u64::from(offset_to_points);
            head.extend(table.to_le_bytes());
            start += ChunkTable::OFFSET_SIZE as u64;
        }
        let length = points.metadata().map_err(failed)?.len().saturating_sub(start) + head.len() as u64;
        Ok(CheckedFile { head: Cursor::new(head), points, start, length, at: 0 })
    }
}

impl Read for CheckedFile {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        let head = self.head.get_ref().len() as u64;
        let n = if self.at < head {
            self.head.set_position(self.at);
            self.head.read(out)?
        } else {
            self.points.seek(SeekFrom::Start(self.at - head + self.start))?;
            self.points.read(out)?
        };
        self.at += n as u64;
        Ok(n)
    }
}

impl Seek for CheckedFile {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let at = match to {
            SeekFrom::Start(at) => Some(at),
            SeekFrom::End(by) => self.length.checked_add_signed(by),
            SeekFrom::Current(by) => self.at.checked_add_signed(by),
        };
        self.at = at.ok_or_else(|| io::Error::from(io::ErrorKind::InvalidInput))?;
        Ok(self.at)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::las::tests::made::{Made, evlr};

    fn open(bytes: &[u8]) -> (tempfile::TempDir, Result<CheckedFile>) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.laz");
        std::fs::write(&path, bytes).unwrap();
        let file = RawPoints::open(&path).and_then(|points| points.checked_file(&path));
        (folder, file)
    }

    fn made() -> Made {
        let mut made = Made::new(4, 9);
        made.records = (0..200u8).map(|k| [&[k; 12][..], &[k, 0, 0x11], &[0; 44]].concat()).collect();
        made
    }

    #[test]
    fn another_decoder_reads_the_same_records() {
        let mut plain = made();
        plain.tail = evlr("someone", 1, &[7; 70_000]);
        plain.n_evlrs = 1;
        for bytes in [plain.las(), made().laz(64), made().laz_in_two(70)] {
            let (_folder, file) = open(&bytes);
            let mut reader = las::Reader::new(io::BufReader::new(file.unwrap())).unwrap();
            assert_eq!(reader.read_all().unwrap().raw_bytes(), made().records.concat());
            assert_eq!(reader.header().vlrs().len(), usize::from(bytes != plain.las()));
        }
    }

    #[test]
    fn layers_longer_than_their_chunk_are_refused() {
        let mut bytes = made().laz(200);
        let first = u32::from_le_bytes(bytes[96..100].try_into().unwrap()) as usize + 8;
        assert!(open(&bytes).1.is_ok());
        // The sizes of the layers follow the first point and the number of points.
        bytes[first + 59 + 4..][..4].copy_from_slice(&u32::MAX.to_le_bytes());
        let problem = open(&bytes).1.unwrap_err().to_string();
        assert!(problem.contains("layers of a chunk"), "{problem}");
    }

    #[test]
    fn seeking_before_the_start_fails() {
        let (_folder, file) = open(&made().las());
        let mut file = file.unwrap();
        assert_eq!(file.seek(SeekFrom::End(0)).unwrap(), file.length);
        assert!(file.seek(SeekFrom::Current(-1_000_000)).is_err());
    }
}
