//! Buffered window over a file; consecutive reads share system calls.

use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use crate::{Error, Result};

/// Read-ahead, bytes.
///
/// Over a thousand pulse records, or the waves of some hundred pulses.
const READ_AHEAD: usize = 1 << 16;

const CUT: &str = "it is cut off or damaged: copy it again from its source";

/// Window of bytes that moves over `source`.
#[derive(Debug)]
pub(super) struct FileWindow<R> {
    source: R,
    file: PathBuf,
    length: u64,
    start: u64,
    buffer: Vec<u8>,
}

impl<R: Read + Seek> FileWindow<R> {
    /// Creates a window over `source`, the file `file` of `length` bytes.
    pub(super) fn new(source: R, file: &Path, length: u64) -> FileWindow<R> {
        FileWindow { source, file: file.to_path_buf(), length, start: 0, buffer: Vec::new() }
    }

    /// Returns the file name, for errors.
    pub(super) fn file(&self) -> &Path {
        &self.file
    }

    /// Returns the size of the file, bytes.
    pub(super) fn length(&self) -> u64 {
        self.length
    }

    /// Reads `n` bytes at `offset`; also returns the file name.
    ///
    /// The error names `field` if the file ends earlier. The buffer never exceeds `n` bytes plus
    /// the read-ahead, nor the file size.
    pub(super) fn bytes(&mut self, offset: u64, n: usize, field: &str) -> Result<(&Path, &[u8])> {
        let left = self.length.saturating_sub(offset);
        if n as u64 > left {
            let problem = format!("{n} bytes needed, {left} left in the file");
            return Err(Error::malformed(&self.file, offset, field, problem, CUT));
        }
        if self.at(offset, n).is_none() {
            self.fill(offset, n)?;
        }
        let held = self.at(offset, n).and_then(|from| self.buffer.get(from..from + n));
        Ok((&self.file, held.unwrap_or(&[])))
    }

    /// Returns the position of bytes in the buffer.
    ///
    /// `None` unless it contains all `n` bytes at `offset`.
    fn at(&self, offset: u64, n: usize) -> Option<usize> {
        let from = usize::try_from(offset.checked_sub(self.start)?).ok()?;
        (from.checked_add(n)? <= self.buffer.len()).then_some(from)
    }

    /// Moves the window to the `n` bytes at `offset`.
    ///
    /// They must be within the file. A step backwards also loads bytes before it, so files with
    /// records in reverse order are read ahead as well.
    fn fill(&mut self, offset: u64, n: usize) -> Result<()> {
        let back = if offset < self.start { offset.min(READ_AHEAD as u64 / 2) } else { 0 };
        let start = offset - back;
        let wanted = READ_AHEAD.max(n + back as usize) as u64;
        let size = wanted.min(self.length - start) as usize;
        self.start = start;
        self.buffer.resize(size, 0);
        let read = self
            .source
            .seek(SeekFrom::Start(start))
            .and_then(|_| self.source.read_exact(&mut self.buffer))
            .map_err(Error::io(&self.file, "read"));
        if read.is_err() {
            self.buffer.clear();
        }
        read
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::{self, Cursor};

    struct Counted {
        source: Cursor<Vec<u8>>,
        seeks: usize,
    }

    impl Read for Counted {
        fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
            self.source.read(out)
        }
    }

    impl Seek for Counted {
        fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
            self.seeks += 1;
            self.source.seek(to)
        }
    }

    fn window(n: usize) -> FileWindow<Counted> {
        let bytes = (0..n).map(|i| (i % 251) as u8).collect();
        FileWindow::new(Counted { source: Cursor::new(bytes), seeks: 0 }, Path::new("f"), n as u64)
    }

    #[test]
    fn reads_in_order_seek_once_per_window() {
        let n = 3 * READ_AHEAD;
        let mut window = window(n);
        for offset in (0..n).step_by(16) {
            assert_eq!(window.bytes(offset as u64, 16, "x").unwrap().1[0], (offset % 251) as u8);
        }
        assert_eq!(window.source.seeks, 3);
    }

    #[test]
    fn reads_in_reverse_seek_once_per_half_window() {
        let n = 3 * READ_AHEAD;
        let mut window = window(n);
        for offset in (0..n).step_by(16).rev() {
            assert_eq!(window.bytes(offset as u64, 16, "x").unwrap().1[0], (offset % 251) as u8);
        }
        assert!(window.source.seeks <= 7, "{}", window.source.seeks);
    }

    #[test]
    fn what_the_file_does_not_hold_is_an_error() {
        let mut window = window(100);
        assert_eq!(window.bytes(99, 1, "x").unwrap().1, [99]);
        assert!(window.bytes(100, 0, "x").unwrap().1.is_empty());
        assert!(window.bytes(u64::MAX, 2, "x").is_err());
        assert!(window.bytes(0, usize::MAX, "x").is_err());
        assert_eq!(
            window.bytes(99, 2, "samples").unwrap_err().to_string(),
            "f: byte 99: samples: 2 bytes needed, 1 left in the file; it is cut off or damaged: \
             copy it again from its source"
        );
    }

    #[test]
    fn a_record_larger_than_the_window_is_held_whole() {
        let mut window = window(3 * READ_AHEAD);
        assert_eq!(window.bytes(10, 2 * READ_AHEAD, "x").unwrap().1.len(), 2 * READ_AHEAD);
        assert_eq!(window.bytes(5, 2 * READ_AHEAD, "x").unwrap().1[0], 5);
    }

    #[test]
    fn a_file_that_shrank_is_an_error_and_the_rest_stays_readable() {
        let mut window = window(100);
        window.length = 200;
        let error = window.bytes(150, 10, "x").unwrap_err().to_string();
        assert!(error.starts_with("f: cannot read: "), "{error}");
        window.length = 100;
        assert_eq!(window.bytes(7, 1, "x").unwrap().1, [7]);
    }
}
