//! Copies of files with other classes.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::{self, Cursor, Read, Seek, SeekFrom, Write};
use std::path::Path;

use laz::LazVlr;
use laz::laszip::{ChunkTable, ChunkTableEntry};
use laz::record::{LayeredPointRecordCompressor, SequentialPointRecordCompressor};
use rayon::prelude::*;

use super::contained::contained;
use super::copc::{COPC, compress_with};
use super::encoding;
use super::header::LasHeader;
use super::point::PointLayout;
use super::raw::RawPoints;
use super::shifted::{EVLRS_AT, WAVEFORMS_AT, supersede};
use super::vlr::{EVLR_HEADER, VLR_HEADER, Vlr};
use crate::{Error, Result, regular_file};

/// Uncompressed points that are compressed at once, bytes.
const AT_ONCE: u64 = 32 << 20;
/// Largest chunk, uncompressed, bytes.
const LARGEST_CHUNK: u64 = 1 << 30;
/// Points of uncompressed files that are written at once.
const RECORDS_AT_ONCE: u64 = 4096;
/// Record IDs of the COPC record and of its octree.
const COPC_INFO: u16 = 1;
const COPC_OCTREE: u16 = 1000;
/// Place of the offset and size of the octree's first page in the COPC record (COPC 1.0, "info VLR").
const FIRST_PAGE_AT: usize = 40;
/// Length of an entry of the octree, bytes: level, x, y, z, offset, bytes, points (COPC 1.0, "hierarchy VLR").
const ENTRY_BYTES: usize = 32;
/// Place of the offset of the special extended records in the LASzip record.
const SPECIAL_AT: usize = 24;

/// What a copy with other classes differs in.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ClassifiedCopy {
    /// Number of points.
    pub n_points: u64,
    /// Number of points whose class differs from that of the source.
    pub n_changed: u64,
    /// Whether the octree of a COPC source is damaged; its records are marked as superseded.
    pub lost_octree: bool,
    /// Whether waveforms are in a file of their own, which is not copied.
    pub has_waveform_file: bool,
}

/// Copies a LAS, LAZ or COPC file with other classes; every other bit of points, header and records stays.
///
/// `class_of` gets the index of each point, from 0, and its class, and returns the class to store; of formats 0 to 5, at most 31.
/// Order of points and chunks stays, so octrees and spatial indexes are valid; offsets of what follows compressed points are
/// those of the copy. Times of compressed points that are -0 become 0, which LASzip takes as equal. `sink` starts at the first
/// byte of the file; `path` names it in errors. The bytes do not depend on threads.
///
/// # Errors
/// The source is not LAS, is cut off or damaged; has a chunk of more than 1 GiB; or writing fails.
pub fn write_classified<W: Write + Seek>(
    source: &Path,
    mut sink: W,
    path: &Path,
    mut class_of: impl FnMut(u64, u8) -> u8,
) -> Result<ClassifiedCopy> {
    let mut points = RawPoints::open(source)?;
    let header = points.header().clone();
    let mut input = regular_file(source)?;
    let start = u64::from(header.offset_to_points);
    let mut before = Vec::new();
    (&mut input).take(start).read_to_end(&mut before).map_err(Error::io(source, "read the header"))?;
    let mut copy = ClassifiedCopy {
        has_waveform_file: header.has_waveforms() && header.global_encoding & encoding::WAVES_BESIDE != 0,
        ..ClassifiedCopy::default()
    };
    let written = Error::io(path, "write");
    sink.write_all(&before).map_err(&written)?;
    let mut classes = Classes::new(&header, &mut class_of);
    if points.compressed().is_some() {
        let chunks = write_chunks(source, &mut points, &mut sink, path, &mut classes)?;
        let tail = Tail::copy(&header, (source, &mut input), &mut sink, path)?;
        for (at, bytes) in patches(&points, &before, &chunks, &tail, &mut copy) {
            sink.seek(SeekFrom::Start(at)).and_then(|_| sink.write_all(&bytes)).map_err(&written)?;
        }
    } else {
        let mut slab = Vec::new();
        while let Some(record) = points.next_record()? {
            let at = slab.len();
            slab.extend_from_slice(record);
            classes.set(&mut slab[at..]);
            if classes.n_points.is_multiple_of(RECORDS_AT_ONCE) {
                sink.write_all(&slab).map_err(&written)?;
                slab.clear();
            }
        }
        sink.write_all(&slab).map_err(&written)?;
        let end = start + header.n_points * u64::from(header.record_length);
        input.seek(SeekFrom::Start(end)).map_err(Error::io(source, "seek to the extended records"))?;
        io::copy(&mut input, &mut sink).map_err(&written)?;
    }
    (copy.n_points, copy.n_changed) = (classes.n_points, classes.n_changed);
    sink.seek(SeekFrom::End(0)).and_then(|_| sink.flush()).map_err(&written)?;
    Ok(copy)
}

/// Sets the classes of records, one after the other.
struct Classes<'a> {
    class_of: &'a mut dyn FnMut(u64, u8) -> u8,
    /// Place and bits of the class in a record.
    at: usize,
    mask: u8,
    n_points: u64,
    n_changed: u64,
}

impl<'a> Classes<'a> {
    fn new(header: &LasHeader, class_of: &'a mut dyn FnMut(u64, u8) -> u8) -> Classes<'a> {
        let (at, mask) = if header.point_format <= 5 { (15, 31) } else { (16, 255) };
        Classes { class_of, at, mask, n_points: 0, n_changed: 0 }
    }

    fn set(&mut self, record: &mut [u8]) {
        let Some(byte) = record.get_mut(self.at) else { return };
        let class = *byte & self.mask;
        let other = (self.class_of)(self.n_points, class) & self.mask;
        *byte = *byte & !self.mask | other;
        self.n_points += 1;
        self.n_changed += u64::from(class != other);
    }
}

/// Chunks of a copy.
struct CopiedChunks {
    /// Offset of each chunk in the source: offset in the copy, and bytes.
    places: BTreeMap<u64, (u64, u64)>,
    /// Offset of the chunk table in the copy.
    table_at: u64,
}

/// Writes all points in the chunks of the source, and the chunk table.
fn write_chunks(
    source: &Path,
    points: &mut RawPoints,
    sink: &mut (impl Write + Seek),
    path: &Path,
    classes: &mut Classes<'_>,
) -> Result<CopiedChunks> {
    let written = Error::io(path, "write the points");
    let time_at = PointLayout::of(points.header().point_format).gps_time;
    let length = u64::from(points.header().record_length);
    let mut at = u64::from(points.header().offset_to_points) + ChunkTable::OFFSET_SIZE as u64;
    sink.write_all(&(-1i64).to_le_bytes()).map_err(&written)?;
    let Some(chunks) = points.compressed() else {
        return Ok(CopiedChunks { places: BTreeMap::new(), table_at: at });
    };
    let (laz, is_layered, offsets) = (chunks.laz().clone(), chunks.is_layered(), chunks.offsets());
    let counts: Vec<u64> = chunks.n_points().collect();
    if let Some(most) = counts.iter().max().filter(|most| most.saturating_mul(length) > LARGEST_CHUNK) {
        let problem = format!("it has a chunk of {most} points, which would need more than 1 GiB of memory");
        return Err(Error::unusable(source, problem, "compress it again with chunks of 50000 points"));
    }
    let (mut table, mut places) = (ChunkTable::default(), BTreeMap::new());
    let mut first = 0;
    while first < counts.len() {
        let (mut batch, mut bytes) = (Vec::new(), 0);
        while let Some(n) = counts.get(first + batch.len()).filter(|_| batch.is_empty() || bytes < AT_ONCE) {
            let mut records = Vec::new();
            for _ in 0..*n {
                let Some(record) = points.next_record()? else { break };
                let at = records.len();
                records.extend_from_slice(record);
                classes.set(&mut records[at..]);
                // The compressor takes -0 and 0 as the same time, but derives later times from their bits.
                let time = time_at.and_then(|start| records.get_mut(at + start..at + start + 8));
                if let Some(time) = time.filter(|time| **time == (-0.0f64).to_le_bytes()) {
                    time.fill(0);
                }
            }
            bytes += records.len() as u64;
            batch.push(records);
        }
        let compressed: Vec<io::Result<Vec<u8>>> =
            batch.par_iter().map(|records| compress(&laz, is_layered, records)).collect();
        for (chunk, number) in compressed.into_iter().zip(first..) {
            let chunk = chunk.map_err(Error::io(path, "compress"))?;
            sink.write_all(&chunk).map_err(&written)?;
            let byte_count = chunk.len() as u64;
            table.push(ChunkTableEntry { point_count: counts[number], byte_count });
            places.insert(offsets[number], (at, byte_count));
            at += byte_count;
        }
        first += batch.len();
    }
    table.write_to(&mut *sink, &laz).map_err(&written)?;
    Ok(CopiedChunks { places, table_at: at })
}

/// Compresses the records of a chunk.
fn compress(laz: &LazVlr, is_layered: bool, records: &[u8]) -> io::Result<Vec<u8>> {
    if records.is_empty() {
        return Ok(Vec::new());
    }
    contained(|| {
        let mut chunk = Cursor::new(Vec::new());
        match is_layered {
            true => compress_with(LayeredPointRecordCompressor::new(&mut chunk), laz, records)?,
            false => compress_with(SequentialPointRecordCompressor::new(&mut chunk), laz, records)?,
        }
        Ok(chunk.into_inner())
    })
}

/// What follows compressed points: waveforms and extended records.
struct Tail {
    /// Offset in the source; none has a larger one if there is no tail.
    from: u64,
    /// Offset in the copy.
    to: u64,
}

impl Tail {
    /// Copies the tail.
    fn copy(
        header: &LasHeader,
        (source, input): (&Path, &mut File),
        sink: &mut (impl Write + Seek),
        path: &Path,
    ) -> Result<Tail> {
        let written = Error::io(path, "write");
        let to = sink.stream_position().map_err(&written)?;
        let has_waveforms = header.has_waveforms() && header.global_encoding & encoding::WAVES_INSIDE != 0;
        let waveforms = has_waveforms.then_some(header.start_of_waveforms);
        let evlrs = (header.n_evlrs > 0).then_some(header.start_of_evlrs);
        let is_after = |at: &u64| *at > u64::from(header.offset_to_points);
        let Some(from) = [waveforms, evlrs].into_iter().flatten().filter(is_after).min() else {
            return Ok(Tail { from: u64::MAX, to });
        };
        input.seek(SeekFrom::Start(from)).map_err(Error::io(source, "seek to the extended records"))?;
        io::copy(input, sink).map_err(&written)?;
        Ok(Tail { from, to })
    }

    /// Offset in the copy; `None` if it is not in the tail.
    fn moved(&self, at: u64) -> Option<u64> {
        Some(self.to + at.checked_sub(self.from)?)
    }
}

/// Offset in a copy, and the bytes that belong there.
type BytePatch = (u64, Vec<u8>);

/// Offsets of what has moved.
fn patches(
    points: &RawPoints,
    before: &[u8],
    chunks: &CopiedChunks,
    tail: &Tail,
    copy: &mut ClassifiedCopy,
) -> Vec<BytePatch> {
    let header = points.header();
    let start = u64::from(header.offset_to_points);
    let mut patches = vec![(start, chunks.table_at.to_le_bytes().to_vec())];
    let mut moved =
        |place: u64, at: u64| patches.extend(tail.moved(at).map(|at| (place, at.to_le_bytes().to_vec())));
    if header.version.1 >= 3 {
        moved(WAVEFORMS_AT as u64, header.start_of_waveforms);
    }
    if header.version.1 >= 4 {
        moved(EVLRS_AT as u64, header.start_of_evlrs);
    }
    let laz = points.vlrs().iter().find(|vlr| vlr.is(LazVlr::USER_ID, LazVlr::RECORD_ID));
    if let Some(laz) = laz.filter(|laz| laz.offset < start) {
        let special = u64_at(&laz.data, SPECIAL_AT).filter(|at| *at <= i64::MAX as u64);
        special.into_iter().for_each(|at| moved(laz.offset + SPECIAL_AT as u64, at));
    }
    let of_copc: Vec<&Vlr> = points.vlrs().iter().filter(|vlr| vlr.user_id == COPC).collect();
    let record = |id: u16| of_copc.iter().find(|vlr| vlr.record_id == id);
    if let Some(info) = record(COPC_INFO) {
        let octree = record(COPC_OCTREE);
        match octree.and_then(|octree| octree_patches(before, (info, octree), chunks, tail)) {
            Some(octree) => patches.extend(octree),
            None => {
                copy.lost_octree = true;
                patches.extend(of_copc.iter().filter_map(|vlr| superseding(vlr, start, tail)));
            }
        }
    }
    patches
}

/// Marks a record of the copy as superseded; `None` if it is neither before the points nor in the tail.
fn superseding(vlr: &Vlr, start: u64, tail: &Tail) -> Option<BytePatch> {
    let at = match vlr.offset <= start {
        true => vlr.offset - VLR_HEADER,
        false => tail.moved(vlr.offset - EVLR_HEADER)?,
    };
    let mut name = [0; 20];
    supersede(&mut name, 0);
    Some((at + 2, name[2..].to_vec()))
}

/// Offsets of pages and chunks in a COPC octree; `None` if it contradicts the file.
fn octree_patches(
    before: &[u8],
    (info, octree): (&Vlr, &Vlr),
    chunks: &CopiedChunks,
    tail: &Tail,
) -> Option<Vec<BytePatch>> {
    let first_page_at = info.offset + FIRST_PAGE_AT as u64;
    let field = before.get(first_page_at as usize..)?;
    let (first, length) = (u64_at(field, 0)?, u64_at(field, 8)?);
    let mut data = octree.data.clone();
    let (mut pages, mut seen) = (vec![(first, length)], BTreeSet::new());
    while let Some((page_at, length)) = pages.pop() {
        let from = usize::try_from(page_at.checked_sub(octree.offset)?).ok()?;
        let page = data.get_mut(from..from.checked_add(usize::try_from(length).ok()?)?)?;
        for (entry, number) in page.chunks_exact_mut(ENTRY_BYTES).zip(0..) {
            // Entries of pages that overlap would be moved twice.
            if !seen.insert(from + number * ENTRY_BYTES) {
                return None;
            }
            let (at, bytes) = (u64_at(entry, 16)?, i32_at(entry, 24)?);
            match i32_at(entry, 28)? {
                0 => {}
                -1 => {
                    pages.push((at, u64::try_from(bytes).ok()?));
                    entry[16..24].copy_from_slice(&tail.moved(at)?.to_le_bytes());
                }
                _ => {
                    let (at, bytes) = chunks.places.get(&at)?;
                    entry[16..24].copy_from_slice(&at.to_le_bytes());
                    entry[24..28].copy_from_slice(&i32::try_from(*bytes).ok()?.to_le_bytes());
                }
            }
        }
    }
    Some(vec![(first_page_at, tail.moved(first)?.to_le_bytes().to_vec()), (tail.moved(octree.offset)?, data)])
}

fn u64_at(bytes: &[u8], at: usize) -> Option<u64> {
    bytes.get(at..)?.first_chunk().map(|bytes| u64::from_le_bytes(*bytes))
}

fn i32_at(bytes: &[u8], at: usize) -> Option<i32> {
    bytes.get(at..)?.first_chunk().map(|bytes| i32::from_le_bytes(*bytes))
}

#[cfg(test)]
mod tests;
