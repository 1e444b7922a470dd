//! A buffered view of a file: reads that follow one another cost no system call of their own.

use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use crate::formats::{Error, Result};

/// How much is read ahead, in bytes: more than a thousand pulse records, or the waves of some hundred pulses.
const READ_AHEAD: usize = 1 << 16;

const CUT: &str = "it is cut off or damaged: copy it again from its source";

/// A window of bytes that moves over `source`.
#[derive(Debug)]
pub(super) struct Window<R> {
    source: R,
    file: PathBuf,
    length: u64,
    start: u64,
    buffer: Vec<u8>,
}

impl<R: Read + Seek> Window<R> {
    /// A window over `source`, which is the file named `file` and `length` bytes long.
    pub(super) fn new(source: R, file: &Path, length: u64) -> Window<R> {
        Window { source, file: file.to_path_buf(), length, start: 0, buffer: Vec::new() }
    }

    /// The file's name, for errors.
    pub(super) fn file(&self) -> &Path {
        &self.file
    }

    /// The file's size in bytes.
    pub(super) fn length(&self) -> u64 {
        self.length
    }

    /// The `n` bytes at `offset` and the file's name, or an error about `field` where the file ends before them. The
    /// buffer never holds more than `n` bytes and the read-ahead, nor more than the file.
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

    /// Where in the buffer the `n` bytes at `offset` stand, if all of them do.
    fn at(&self, offset: u64, n: usize) -> Option<usize> {
        let from = usize::try_from(offset.checked_sub(self.start)?).ok()?;
        (from.checked_add(n)? <= self.buffer.len()).then_some(from)
    }

    /// Moves the window so that it holds the `n` bytes at `offset`, which lie within the file.
    ///
    /// A step backwards leaves room before it, so that a file whose records stand in reverse is read ahead as well.
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

    fn window(n: usize) -> Window<Counted> {
        let bytes = (0..n).map(|i| (i % 251) as u8).collect();
        Window::new(Counted { source: Cursor::new(bytes), seeks: 0 }, Path::new("f"), n as u64)
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
