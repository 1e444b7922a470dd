//! Records by key in a temporary file.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::Path;
use std::sync::{Mutex, PoisonError};

/// Bytes of a key that are written at once.
const BLOCK_BYTES: usize = 64 << 10;
/// Bytes that a writer holds.
const HELD_BYTES: usize = 32 << 20;

/// Records by key, each of [`Spool::new`]'s length, in a temporary file without a name.
///
/// The order of the records of a key is that of the writers, so it depends on threads.
pub struct Spool<K> {
    content: Mutex<Content<K>>,
    record_bytes: usize,
}

struct Content<K> {
    file: File,
    end: u64,
    /// Offset and length of the blocks of a key.
    blocks: BTreeMap<K, Vec<(u64, usize)>>,
}

impl<K: Ord + Copy> Spool<K> {
    /// Spool of records of this length, in a file in `folder`.
    ///
    /// # Errors
    /// The file cannot be created.
    pub fn new(folder: &Path, record_bytes: usize) -> io::Result<Spool<K>> {
        let content = Content { file: tempfile::tempfile_in(folder)?, end: 0, blocks: BTreeMap::new() };
        Ok(Spool { content: Mutex::new(content), record_bytes })
    }

    /// Keys with records, in ascending order.
    pub fn keys(&self) -> Vec<K> {
        self.content.lock().unwrap_or_else(PoisonError::into_inner).blocks.keys().copied().collect()
    }

    /// Number of records of a key.
    pub fn count(&self, key: K) -> u64 {
        let content = self.content.lock().unwrap_or_else(PoisonError::into_inner);
        let bytes = content.blocks.get(&key).into_iter().flatten().map(|(_, length)| *length as u64);
        bytes.sum::<u64>() / self.record_bytes as u64
    }

    /// Writer for one thread.
    pub fn writer(&self) -> SpoolWriter<'_, K> {
        SpoolWriter { spool: self, buffers: SpoolBuffers::default() }
    }

    /// Gives all records of a key.
    ///
    /// # Errors
    /// The temporary file cannot be read.
    pub fn read(&self, key: K, mut each: impl FnMut(&[u8])) -> io::Result<()> {
        let mut block = Vec::new();
        for number in 0.. {
            {
                let mut content = self.content.lock().unwrap_or_else(PoisonError::into_inner);
                let found = content.blocks.get(&key).and_then(|blocks| blocks.get(number)).copied();
                let Some((at, length)) = found else { break };
                block.resize(length, 0);
                content.file.seek(SeekFrom::Start(at))?;
                content.file.read_exact(&mut block)?;
            }
            block.chunks_exact(self.record_bytes).for_each(&mut each);
        }
        Ok(())
    }

    fn append(&self, key: K, bytes: &[u8]) -> io::Result<()> {
        let mut content = self.content.lock().unwrap_or_else(PoisonError::into_inner);
        let at = content.end;
        content.file.seek(SeekFrom::Start(at))?;
        content.file.write_all(bytes)?;
        content.end += bytes.len() as u64;
        content.blocks.entry(key).or_default().push((at, bytes.len()));
        Ok(())
    }
}

/// Records that a thread has not yet written.
///
/// Each call gets the same spool; [`SpoolBuffers::flush`] writes the rest.
pub struct SpoolBuffers<K> {
    buffers: BTreeMap<K, Vec<u8>>,
    held: usize,
}

impl<K> Default for SpoolBuffers<K> {
    fn default() -> SpoolBuffers<K> {
        SpoolBuffers { buffers: BTreeMap::new(), held: 0 }
    }
}

impl<K: Ord + Copy> SpoolBuffers<K> {
    /// Adds a record.
    ///
    /// # Errors
    /// The temporary file cannot be written.
    pub fn push(&mut self, spool: &Spool<K>, key: K, record: &[u8]) -> io::Result<()> {
        let buffer = self.buffers.entry(key).or_default();
        buffer.extend_from_slice(record);
        self.held += record.len();
        if buffer.len() >= BLOCK_BYTES {
            self.held -= buffer.len();
            spool.append(key, buffer)?;
            buffer.clear();
        }
        if self.held >= HELD_BYTES { self.flush(spool) } else { Ok(()) }
    }

    /// Writes all records.
    ///
    /// # Errors
    /// The temporary file cannot be written.
    pub fn flush(&mut self, spool: &Spool<K>) -> io::Result<()> {
        self.held = 0;
        let buffers = std::mem::take(&mut self.buffers).into_iter();
        buffers
            .filter(|(_, buffer)| !buffer.is_empty())
            .try_for_each(|(key, buffer)| spool.append(key, &buffer))
    }
}

/// Writer of one thread; [`SpoolWriter::finish`] writes what it holds.
pub struct SpoolWriter<'a, K> {
    spool: &'a Spool<K>,
    buffers: SpoolBuffers<K>,
}

impl<K: Ord + Copy> SpoolWriter<'_, K> {
    /// Adds a record.
    ///
    /// # Errors
    /// The temporary file cannot be written.
    pub fn push(&mut self, key: K, record: &[u8]) -> io::Result<()> {
        self.buffers.push(self.spool, key, record)
    }

    /// Writes what it holds.
    ///
    /// # Errors
    /// The temporary file cannot be written.
    pub fn finish(mut self) -> io::Result<()> {
        self.buffers.flush(self.spool)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn records_of_a_key_are_found_again() {
        let spool = Spool::new(&std::env::temp_dir(), 4).unwrap();
        let (mut one, mut other) = (spool.writer(), spool.writer());
        for k in 0..40_000u32 {
            let writer = if k % 3 == 0 { &mut one } else { &mut other };
            writer.push(k % 2, &k.to_le_bytes()).unwrap();
        }
        one.finish().unwrap();
        other.finish().unwrap();
        assert_eq!((spool.keys(), spool.count(1), spool.count(7)), (vec![0, 1], 20_000, 0));
        let mut found = Vec::new();
        spool.read(1, |record| found.push(u32::from_le_bytes(record.try_into().unwrap()))).unwrap();
        found.sort();
        assert!(found.iter().zip(0..).all(|(found, k)| *found == 2 * k + 1));
    }
}
