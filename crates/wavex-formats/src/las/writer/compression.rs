//! Compresses chunks on worker threads while further points are gathered.

use std::collections::VecDeque;
use std::io::{self, Seek, SeekFrom, Write};
use std::thread::{self, JoinHandle};

use crossbeam_channel::{Receiver, Sender, bounded};
use laz::laszip::{ChunkTable, ChunkTableEntry};
use laz::{LasZipError, LazVlr};

use super::chunk::{self, Chunk};
use crate::las::lax;
use crate::las::vlr::Vlr;

/// ChunkCompressor state of a LAZ file.
pub(super) struct ChunkCompressor {
    pub(super) laz: LazVlr,
    table: ChunkTable,
    /// Offset of the field for the offset of the chunk table.
    table_offset_at: u64,
    /// Offset of the field for the location of the index.
    special_evlrs_at: u64,
    /// Worker threads; without any, the writing thread compresses.
    workers: Workers,
}

impl ChunkCompressor {
    /// Creates the state for a file whose points begin at `table_offset_at`.
    ///
    /// With more than one thread, chunks are compressed in the background.
    pub(super) fn new(
        laz: LazVlr,
        table_offset_at: u64,
        special_evlrs_at: u64,
        threads: usize,
    ) -> ChunkCompressor {
        let workers = Workers::start(&laz, threads);
        ChunkCompressor { laz, table: ChunkTable::default(), table_offset_at, special_evlrs_at, workers }
    }

    /// Compresses or queues the records of a chunk.
    ///
    /// Leaves an empty buffer.
    pub(super) fn put(&mut self, records: &mut Vec<u8>, sink: &mut impl Write) -> io::Result<()> {
        if self.workers.is_full() {
            self.write_next(sink)?;
        }
        if self.workers.send(records) {
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

/// Records of a chunk, and the channel for the result.
///
/// The result is the chunk and the buffer for reuse.
type Job = (Vec<u8>, Sender<(Chunk, Vec<u8>)>);

/// Worker threads that compress chunks.
struct Workers {
    /// Job queue; `None` without threads.
    jobs: Option<Sender<Job>>,
    /// Chunks not yet written, in order.
    waiting: VecDeque<Receiver<(Chunk, Vec<u8>)>>,
    /// Maximum number of chunks in flight.
    ///
    /// Two per thread, including the one being gathered.
    most: usize,
    threads: Vec<JoinHandle<()>>,
    /// Record buffers for reuse.
    spare: Vec<Vec<u8>>,
}

impl Workers {
    /// Starts the threads; none if one thread has to suffice.
    fn start(laz: &LazVlr, n_threads: usize) -> Workers {
        let n_threads = if n_threads > 1 { n_threads } else { 0 };
        let (jobs, to_do) = bounded::<Job>(2 * n_threads);
        let start = |_| {
            let (laz, to_do) = (laz.clone(), to_do.clone());
            let work = move || {
                for (mut records, done) in to_do {
                    let chunk = chunk::compress(&records, &laz);
                    records.clear();
                    // Sending fails only if the receiver was dropped after a write error.
                    let _ = done.send((chunk, records));
                }
            };
            thread::Builder::new().name("compress".into()).spawn(work).ok()
        };
        // Starting fewer threads than requested only reduces speed.
        let threads: Vec<JoinHandle<()>> = (0..n_threads).filter_map(start).collect();
        let jobs = (!threads.is_empty()).then_some(jobs);
        let most = 2 * threads.len();
        Workers { jobs, waiting: VecDeque::new(), most, threads, spare: Vec::new() }
    }

    fn is_full(&self) -> bool {
        self.is_busy() && self.waiting.len() + 1 >= self.most
    }

    fn is_busy(&self) -> bool {
        !self.waiting.is_empty()
    }

    /// Queues records and replaces them with an empty buffer.
    ///
    /// `false` without threads.
    fn send(&mut self, records: &mut Vec<u8>) -> bool {
        let Some(jobs) = &self.jobs else { return false };
        let next = self.spare.pop().unwrap_or_else(|| Vec::with_capacity(records.capacity()));
        let full = std::mem::replace(records, next);
        let (done, chunk) = bounded(1);
        // If all threads have died, the error is reported when the chunk is received.
        let _ = jobs.send((full, done));
        self.waiting.push_back(chunk);
        true
    }

    /// Waits for the oldest queued chunk.
    ///
    /// `None` if there is none.
    fn next(&mut self) -> Option<Chunk> {
        let received = self.waiting.pop_front()?.recv();
        let Ok((chunk, records)) = received else { return Some(Err(has_ended())) };
        self.spare.push(records);
        Some(chunk)
    }
}

impl Drop for Workers {
    fn drop(&mut self) {
        self.jobs = None;
        for thread in self.threads.drain(..) {
            // A panic was already reported when its chunk was received.
            let _ = thread.join();
        }
    }
}

fn has_ended() -> io::Error {
    io::Error::other("a compression thread has ended")
}

pub(in crate::las) fn into_io(error: LasZipError) -> io::Error {
    match error {
        LasZipError::IoError(error) => error,
        other => io::Error::other(other),
    }
}
