//! Compresses chunks on a thread pool while further points are gathered.

use std::collections::VecDeque;
use std::io::{self, Seek, SeekFrom, Write};
use std::sync::Arc;

use crossbeam_channel::{Receiver, bounded};
use laz::LazVlr;
use laz::laszip::{ChunkTable, ChunkTableEntry};
use rayon::ThreadPool;

use super::chunk::{self, Chunk};
use crate::las::lax;
use crate::las::vlr::Vlr;

/// Compression state of a LAZ file.
pub(super) struct ChunkCompressor {
    pub(super) laz: LazVlr,
    table: ChunkTable,
    /// Offset of the field for the offset of the chunk table.
    table_offset_at: u64,
    /// Offset of the field for the location of the index.
    special_evlrs_at: u64,
    workers: Workers,
}

impl ChunkCompressor {
    /// Creates the state for a file whose points begin at `table_offset_at`.
    ///
    /// With a pool, chunks are compressed on its threads.
    pub(super) fn new(
        laz: LazVlr,
        table_offset_at: u64,
        special_evlrs_at: u64,
        pool: Option<Arc<ThreadPool>>,
    ) -> ChunkCompressor {
        let workers = Workers::new(pool);
        ChunkCompressor { laz, table: ChunkTable::default(), table_offset_at, special_evlrs_at, workers }
    }

    /// Compresses or queues the records of a chunk.
    ///
    /// Leaves an empty buffer.
    pub(super) fn put(&mut self, records: &mut Vec<u8>, sink: &mut impl Write) -> io::Result<()> {
        if self.workers.is_full() {
            self.write_next(sink)?;
        }
        if self.workers.send(records, &self.laz) {
            return Ok(());
        }
        let chunk = chunk::compress(records, &self.laz);
        records.clear();
        self.write(chunk, sink)
    }

    /// Waits for the oldest queued chunk and writes it.
    fn write_next(&mut self, sink: &mut impl Write) -> io::Result<()> {
        match self.workers.next() {
            Some(chunk) => self.write(chunk, sink),
            None => Ok(()),
        }
    }

    fn write(&mut self, chunk: Chunk, sink: &mut impl Write) -> io::Result<()> {
        let bytes = chunk?;
        let point_count = self.laz.chunk_size().into();
        self.table.push(ChunkTableEntry { point_count, byte_count: bytes.len() as u64 });
        sink.write_all(&bytes)
    }

    /// Writes pending chunks and the chunk table.
    ///
    /// Stores the offset of the table before the first chunk.
    pub(super) fn end(&mut self, sink: &mut (impl Write + Seek)) -> io::Result<()> {
        while self.workers.is_busy() {
            self.write_next(sink)?;
        }
        let table_at = sink.stream_position()?;
        self.table.write_to(&mut *sink, &self.laz)?;
        sink.seek(SeekFrom::Start(self.table_offset_at))?;
        sink.write_all(&table_at.to_le_bytes())
    }

    /// Appends the index and registers it in the LASzip record.
    pub(super) fn append(&self, sink: &mut (impl Write + Seek), index: Vec<u8>) -> io::Result<()> {
        let at = sink.seek(SeekFrom::End(0))?;
        let record = Vlr::new(lax::USER_ID, lax::RECORD_ID, "LAX spatial indexing (LASindex)", index);
        sink.write_all(&record.write_extended())?;
        sink.seek(SeekFrom::Start(self.special_evlrs_at))?;
        sink.write_all(&1i64.to_le_bytes())?;
        sink.write_all(&at.to_le_bytes())
    }
}

/// A compressed chunk and the buffer of its records, for reuse.
type Compressed = (Chunk, Vec<u8>);

/// Compresses chunks on a thread pool and returns them in order.
struct Workers {
    /// `None`: the writing thread compresses.
    pool: Option<Arc<ThreadPool>>,
    /// Chunks not yet written, in order.
    waiting: VecDeque<Receiver<Compressed>>,
    /// Record buffers for reuse.
    spare: Vec<Vec<u8>>,
}

impl Workers {
    fn new(pool: Option<Arc<ThreadPool>>) -> Workers {
        Workers { pool, waiting: VecDeque::new(), spare: Vec::new() }
    }

    /// Returns whether there are two chunks per thread, including the one being gathered.
    fn is_full(&self) -> bool {
        let most = self.pool.as_ref().map_or(0, |pool| 2 * pool.current_num_threads());
        self.is_busy() && self.waiting.len() + 1 >= most
    }

    fn is_busy(&self) -> bool {
        !self.waiting.is_empty()
    }

    /// Queues records and replaces them with an empty buffer.
    ///
    /// `false` without a pool.
    fn send(&mut self, records: &mut Vec<u8>, laz: &LazVlr) -> bool {
        let Some(pool) = &self.pool else { return false };
        let next = self.spare.pop().unwrap_or_else(|| Vec::with_capacity(records.capacity()));
        let mut full = std::mem::replace(records, next);
        let (done, chunk) = bounded(1);
        let laz = laz.clone();
        pool.spawn(move || {
            let chunk = chunk::compress(&full, &laz);
            full.clear();
            // Sending fails only if the receiver was dropped after a write error.
            let _ = done.send((chunk, full));
        });
        self.waiting.push_back(chunk);
        true
    }

    /// Waits for the oldest queued chunk.
    ///
    /// `None` if there is none.
    fn next(&mut self) -> Option<Chunk> {
        let received = self.waiting.pop_front()?.recv();
        let Ok((chunk, records)) = received else { return Some(Err(has_panicked())) };
        self.spare.push(records);
        Some(chunk)
    }
}

fn has_panicked() -> io::Error {
    io::Error::other("the compression of points panicked, which is a bug in wavex")
}
