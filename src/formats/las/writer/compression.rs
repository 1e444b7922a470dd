//! Compressing while further points are gathered.

use std::io::{self, Seek, SeekFrom, Write};
use std::thread::{self, JoinHandle};

use crossbeam_channel::{Receiver, Sender, bounded};
use laz::laszip::ChunkTable;
use laz::{LasZipError, LazVlr};

use super::chunk::compress_all;
use super::records;
use crate::formats::las::lax;

/// State of a LAZ file: its chunks so far.
pub(super) struct Compression {
    pub(super) laz: LazVlr,
    table: ChunkTable,
    /// Where the place of the chunk table is to be noted.
    table_offset_at: u64,
    /// Where the place of the index is to be noted.
    special_evlrs_at: u64,
    /// `None`: all is done by the thread that writes.
    beside: Option<Beside>,
}

impl Compression {
    /// For a file whose points begin at `table_offset_at`. With more than one thread a slab is compressed while the next one
    /// is gathered.
    pub(super) fn new(
        laz: LazVlr,
        table_offset_at: u64,
        special_evlrs_at: u64,
        threads: usize,
    ) -> Compression {
        // Without a second thread it works, only slower.
        let beside = if threads > 1 { Beside::start(&laz).ok() } else { None };
        Compression { laz, table: ChunkTable::default(), table_offset_at, special_evlrs_at, beside }
    }

    /// Compresses a slab of whole chunks (the last one may be cut short), or has it compressed, and leaves an empty one.
    pub(super) fn put(&mut self, slab: &mut Vec<u8>, sink: &mut impl Write) -> io::Result<()> {
        let Some(beside) = &mut self.beside else {
            self.table.extend(&compress_all(slab, &self.laz, |bytes| sink.write_all(bytes))?);
            slab.clear();
            return Ok(());
        };
        beside.collect(&mut self.table, sink)?;
        beside.send(slab)
    }

    /// Writes what is still being compressed and the chunk table, and notes before the first chunk where it is.
    pub(super) fn end(&mut self, sink: &mut (impl Write + Seek)) -> io::Result<()> {
        if let Some(beside) = &mut self.beside {
            beside.collect(&mut self.table, sink)?;
        }
        let table_at = sink.stream_position()?;
        self.table.write_to(&mut *sink, &self.laz)?;
        sink.seek(SeekFrom::Start(self.table_offset_at))?;
        sink.write_all(&table_at.to_le_bytes())
    }

    /// Writes the index behind all else, and notes in the LASzip record that it is there.
    pub(super) fn append(&self, sink: &mut (impl Write + Seek), index: &[u8]) -> io::Result<()> {
        let at = sink.seek(SeekFrom::End(0))?;
        sink.write_all(&records::evlr(
            lax::USER_ID,
            lax::RECORD_ID,
            "LAX spatial indexing (LASindex)",
            index,
        ))?;
        sink.seek(SeekFrom::Start(self.special_evlrs_at))?;
        sink.write_all(&1i64.to_le_bytes())?;
        sink.write_all(&at.to_le_bytes())
    }
}

/// A slab that was compressed: its chunks, their bytes, and the slab for further use.
struct Compressed {
    chunks: io::Result<ChunkTable>,
    bytes: Vec<u8>,
    slab: Vec<u8>,
}

/// A thread that compresses one slab at a time.
struct Beside {
    slabs: Option<Sender<Vec<u8>>>,
    compressed: Receiver<Compressed>,
    thread: Option<JoinHandle<()>>,
    is_busy: bool,
    /// The slab before the last one, empty.
    spare: Vec<u8>,
}

impl Beside {
    fn start(laz: &LazVlr) -> io::Result<Beside> {
        let (slabs, to_do) = bounded::<Vec<u8>>(1);
        let (done, compressed) = bounded(1);
        let laz = laz.clone();
        let work = move || {
            for mut slab in to_do {
                let mut bytes = Vec::new();
                let chunks = compress_all(&slab, &laz, |chunk| {
                    bytes.extend(chunk);
                    Ok(())
                });
                slab.clear();
                if done.send(Compressed { chunks, bytes, slab }).is_err() {
                    break;
                }
            }
        };
        let thread = thread::Builder::new().name("compress".into()).spawn(work)?;
        Ok(Beside { slabs: Some(slabs), compressed, thread: Some(thread), is_busy: false, spare: Vec::new() })
    }

    fn send(&mut self, slab: &mut Vec<u8>) -> io::Result<()> {
        let next = std::mem::take(&mut self.spare);
        let full = std::mem::replace(slab, next);
        slab.reserve(full.len());
        let slabs = self.slabs.as_ref().ok_or_else(has_ended)?;
        slabs.send(full).map_err(|_| has_ended())?;
        self.is_busy = true;
        Ok(())
    }

    /// Waits for the slab that is being compressed, if there is one, and writes it.
    fn collect(&mut self, table: &mut ChunkTable, sink: &mut impl Write) -> io::Result<()> {
        if !std::mem::take(&mut self.is_busy) {
            return Ok(());
        }
        let Compressed { chunks, bytes, slab } = self.compressed.recv().map_err(|_| has_ended())?;
        self.spare = slab;
        sink.write_all(&bytes)?;
        table.extend(&chunks?);
        Ok(())
    }
}

impl Drop for Beside {
    fn drop(&mut self) {
        self.slabs = None;
        if let Some(thread) = self.thread.take() {
            // What it died of has been told where its slab was waited for.
            let _ = thread.join();
        }
    }
}

fn has_ended() -> io::Error {
    io::Error::other("the thread that compresses has ended")
}

pub(super) fn into_io(error: LasZipError) -> io::Error {
    match error {
        LasZipError::IoError(error) => error,
        other => io::Error::other(other),
    }
}
