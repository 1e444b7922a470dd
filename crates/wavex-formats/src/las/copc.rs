//! Cloud-optimised point clouds (COPC).
//!
//! LAZ with one chunk per octree node. Viewers fetch only the parts they show. The specification is
//! COPC 1.0 (<https://copc.io>): LAS 1.4 in point format 6, 7 or 8, LASzip chunks of variable size,
//! the record `copc`/1 first, and the octree as extended record `copc`/1000. Points are copied as
//! records, bit by bit. Records with waveforms (formats 9 and 10) lose the reference to their
//! packet, which COPC cannot store.
//!
//! The source is read twice: for the bounding cube, and for the points. Memory is bounded: points
//! are sorted in runs that the caller stores, and nodes are written as soon as they are complete.

mod cube;
mod header;
mod octree;
mod passes;
mod sort;

use std::io::{self, Cursor, Seek, SeekFrom, Write};
use std::path::Path;

use laz::laszip::{ChunkTable, ChunkTableEntry};
use laz::record::{LayeredPointRecordCompressor, RecordCompressor};
use laz::{LazVlr, LazVlrBuilder};

use super::contained::contained;
use super::header::LasHeader;
use super::point::PointLayout;
use super::point_out::RETURNS;
use super::raw::RawPoints;
use super::totals::PointTotals;
use super::vlr::{SPEC, Vlr, WAVEFORM_PACKETS};
use super::writer::into_io;
use super::{descriptor::FIRST_DESCRIPTOR, lax};
use crate::{Error, Result};
use cube::Cube;
use header::{HierarchyEntry, Metadata};
use octree::{Octree, OctreeNode};
use passes::Passes;
use sort::Sorter;

pub use passes::ProgressObserver;
pub use sort::Keep;

/// User ID of the records defined by COPC.
pub(super) const COPC: &str = "copc";
/// Maximum number of points of an octree leaf.
const LEAF_POINTS: u64 = 50_000;
/// Memory for sorting points, bytes.
const SORT_BYTES: usize = 512 << 20;

/// Summary of a written COPC file.
#[derive(Debug, Clone, PartialEq)]
pub struct CopcSummary {
    /// Number of points, as in the source.
    pub n_points: u64,
    /// Number of octree nodes; each is a chunk.
    pub n_nodes: usize,
    /// Number of octree levels.
    pub n_levels: u32,
    /// Whether waveforms of formats 9 and 10 were dropped.
    pub is_without_waveforms: bool,
    /// Smallest and largest finite time of the points, as stored, s; both 0 without any.
    pub times_s: [f64; 2],
    /// Problems of the source's records of its coordinate reference system; for messages.
    pub crs_problems: Vec<String>,
}

/// Memory limits.
#[derive(Debug, Clone, Copy)]
struct MemoryLimits {
    leaf_points: u64,
    sort_bytes: usize,
}

/// Copies the points of a LAS or LAZ file as COPC.
///
/// `sink` starts at the first byte of the file; `path` names it in errors. `keep` stores sorted
/// runs that exceed the memory limit; `watch` gets the part done from time to time. Needs about 512 MiB plus the nodes on the path to a point,
/// about 50 000 points each. More points than that within 1 / 2^14 of the cube's edge form one
/// node, which is held in memory.
///
/// # Errors
/// The source is not LAS, is damaged, has no points, or has content that COPC cannot store: point
/// formats 0 to 5, or LAS 1.5 times with another offset. Or writing or `keep` fails.
pub fn write_copc(
    source: &Path,
    sink: impl Write + Seek,
    path: &Path,
    keep: Keep,
    watch: ProgressObserver,
) -> Result<CopcSummary> {
    write_within(
        source,
        sink,
        path,
        keep,
        watch,
        MemoryLimits { leaf_points: LEAF_POINTS, sort_bytes: SORT_BYTES },
    )
}

fn write_within(
    source: &Path,
    sink: impl Write + Seek,
    path: &Path,
    keep: Keep,
    watch: ProgressObserver,
    limits: MemoryLimits,
) -> Result<CopcSummary> {
    let mut passes = Passes::new(watch);
    let extent = PointSums::of(source, &mut passes)?;
    let mut points = RawPoints::open(source)?;
    let records = Reshape::of(source, points.header())?;
    let header = points.header().clone();
    let cube = extent.cube(&header);
    let mut sorter = Sorter::new(records.length(), limits.sort_bytes, keep);
    let mut out = Vec::with_capacity(records.length());
    while let Some(record) = points.next_record()? {
        records.reshape(record, &mut out);
        sorter.push(cube.key(header.coordinates(raw(record))), &out)?;
        passes.count();
    }
    let metadata = Metadata::new(source, &header, (points.vlrs(), &records), &extent)?;
    drop(points);
    let crs_problems = metadata.crs_problems.clone();
    let mut writer = CopcWriter::new(sink, path, &records, metadata)?;
    let mut octree = Octree::new(limits.leaf_points);
    let mut done = |node: OctreeNode| writer.write_node(&node);
    sorter.finish(path, |key, record| {
        passes.count();
        octree.push(key, record, &mut done)
    })?;
    octree.finish(&mut done)?;
    let (n_nodes, n_levels) = (writer.entries.len(), writer.n_levels());
    writer.finish(&cube)?;
    let is_without_waveforms = records.format != header.point_format;
    let (n_points, times_s) = (extent.totals.points, extent.times);
    Ok(CopcSummary { n_points, n_nodes, n_levels, is_without_waveforms, times_s, crs_problems })
}

/// Sums over all points, for the header and the `copc` record.
#[derive(Debug)]
struct PointSums {
    totals: PointTotals,
    /// Smallest and largest finite time; both 0 without any.
    times: [f64; 2],
}

impl PointSums {
    /// Reads all points of a file.
    fn of(source: &Path, passes: &mut Passes) -> Result<PointSums> {
        let mut points = RawPoints::open(source)?;
        check(source, points.header())?;
        passes.expect(points.header().n_points);
        let mut totals = PointTotals::new();
        let mut times = [f64::INFINITY, f64::NEG_INFINITY];
        while let Some(record) = points.next_record()? {
            // The return number is in the lowest four bits.
            let return_number = record.get(14).map_or(0, |byte| byte & 15);
            totals.add(raw(record).map(|raw| (raw, raw)), &[return_number], RETURNS);
            let time = gps_time(record);
            if time.is_finite() {
                times = [times[0].min(time), times[1].max(time)];
            }
            passes.count();
        }
        if totals.points == 0 {
            return Err(Error::unusable(source, "it has no points", "give a file with points"));
        }
        let times = if times[0] <= times[1] { times } else { [0.0; 2] };
        Ok(PointSums { totals, times })
    }

    /// Returns the octree's cube.
    ///
    /// Its edge is at least one coordinate step.
    fn cube(&self, header: &LasHeader) -> Cube {
        let [min, max] = self.totals.bounds(header);
        Cube::around(min, max, header.scale.into_iter().map(f64::abs).fold(0.0, f64::max))
    }
}

fn check(source: &Path, header: &LasHeader) -> Result<()> {
    if header.point_format <= 5 {
        let problem = format!("COPC needs point format 6 to 10, but this is format {}", header.point_format);
        return Err(Error::unusable(source, problem, "write the points with `version = \"1.4\"`"));
    }
    if header.time_offset_megaseconds != 0 && header.time_offset_megaseconds != 1000 {
        let problem = format!(
            "its times have an offset of {} million seconds, which LAS 1.4 cannot store",
            header.time_offset_megaseconds
        );
        return Err(Error::unusable(source, problem, "convert the file to LAS 1.4"));
    }
    Ok(())
}

/// Returns the stored coordinates of a record.
fn raw(record: &[u8]) -> [i32; 3] {
    std::array::from_fn(|axis| {
        record
            .get(4 * axis..)
            .and_then(|rest| rest.first_chunk())
            .map_or(0, |bytes| i32::from_le_bytes(*bytes))
    })
}

/// Returns the GPS time of a record of formats 6 to 10.
fn gps_time(record: &[u8]) -> f64 {
    record.get(22..).and_then(|rest| rest.first_chunk()).map_or(0.0, |bytes| f64::from_le_bytes(*bytes))
}

/// Conversion of source records to COPC records, without waveform bytes.
#[derive(Debug)]
struct Reshape {
    format: u8,
    /// Number of bytes before the waveform bytes.
    head: usize,
    /// Offset of the extra bytes in the source.
    extra: usize,
    extra_length: u16,
}

impl Reshape {
    fn of(source: &Path, header: &LasHeader) -> Result<Reshape> {
        let format = match header.point_format {
            9 => 6,
            10 => 8,
            format => format,
        };
        let extra = PointLayout::of(header.point_format).length;
        let extra_length = usize::from(header.record_length).checked_sub(extra);
        let extra_length = extra_length.and_then(|length| u16::try_from(length).ok()).ok_or_else(|| {
            let problem = format!("{} bytes are too few for its point format", header.record_length);
            Error::malformed(source, 105, "point data record length", problem, "export the file again")
        })?;
        Ok(Reshape { format, head: PointLayout::of(format).length, extra, extra_length })
    }

    /// Returns the length of a COPC record, bytes.
    fn length(&self) -> usize {
        self.head + usize::from(self.extra_length)
    }

    fn reshape(&self, record: &[u8], out: &mut Vec<u8>) {
        out.clear();
        out.extend_from_slice(record.get(..self.head).unwrap_or_default());
        out.extend_from_slice(record.get(self.extra..).unwrap_or_default());
        // The compressor takes -0 and 0 as the same time, but derives later times from their bits.
        if let Some(time) = out.get_mut(22..30).filter(|time| **time == (-0.0f64).to_le_bytes()) {
            time.fill(0);
        }
    }

    fn laz(&self) -> laz::Result<LazVlr> {
        let builder = LazVlrBuilder::default().with_point_format(self.format, self.extra_length)?;
        Ok(builder.with_variable_chunk_size().build())
    }
}

/// COPC file being written.
struct CopcWriter<'a, W> {
    sink: W,
    path: &'a Path,
    metadata: Metadata,
    laz: LazVlr,
    table: ChunkTable,
    entries: Vec<HierarchyEntry>,
    /// Offset of the field for the offset of the chunk table.
    table_offset_at: u64,
    /// Offset of the next chunk.
    at: u64,
}

impl<'a, W: Write + Seek> CopcWriter<'a, W> {
    fn new(mut sink: W, path: &'a Path, records: &Reshape, metadata: Metadata) -> Result<CopcWriter<'a, W>> {
        let laz = records.laz().map_err(into_io).map_err(Error::io(path, "prepare the compression"))?;
        let before = metadata.before_points(path, None)?;
        // LASzip data begin with the offset of the chunk table: -1 until it is known.
        let written = sink.write_all(&before).and_then(|()| sink.write_all(&(-1i64).to_le_bytes()));
        written.map_err(Error::io(path, "write"))?;
        let table_offset_at = before.len() as u64;
        let at = table_offset_at + ChunkTable::OFFSET_SIZE as u64;
        Ok(CopcWriter {
            sink,
            path,
            metadata,
            laz,
            table: ChunkTable::default(),
            entries: Vec::new(),
            table_offset_at,
            at,
        })
    }

    /// Compresses a node as one chunk, sorted by time.
    fn write_node(&mut self, node: &OctreeNode) -> Result<()> {
        let length = self.laz.items_size() as usize;
        let mut records: Vec<&[u8]> = node.records.chunks_exact(length).collect();
        records.sort_by(|one, other| gps_time(one).total_cmp(&gps_time(other)));
        let chunk = compress(&self.laz, &records.concat()).map_err(Error::io(self.path, "compress"))?;
        let too_many = || {
            let problem = format!("{} points share one position", records.len());
            Error::unusable(self.path, problem, "thin the points first")
        };
        let points = i32::try_from(records.len()).map_err(|_| too_many())?;
        let bytes = i32::try_from(chunk.len()).map_err(|_| too_many())?;
        self.sink.write_all(&chunk).map_err(Error::io(self.path, "write"))?;
        self.table
            .push(ChunkTableEntry { point_count: records.len() as u64, byte_count: chunk.len() as u64 });
        self.entries.push(HierarchyEntry {
            level: node.level,
            prefix: node.prefix,
            at: self.at,
            bytes,
            points,
        });
        self.at += chunk.len() as u64;
        Ok(())
    }

    fn n_levels(&self) -> u32 {
        self.entries.iter().map(|entry| entry.level + 1).max().unwrap_or(0)
    }

    /// Writes chunk table and EVLRs; rewrites header and VLRs.
    fn finish(mut self, cube: &Cube) -> Result<()> {
        self.entries.sort_by_key(|entry| (entry.level, entry.prefix));
        let failed = Error::io(self.path, "write");
        self.table.write_to(&mut self.sink, &self.laz).map_err(&failed)?;
        let evlrs_at = self.sink.stream_position().map_err(&failed)?;
        let hierarchy = header::hierarchy(evlrs_at, &self.entries);
        let before = self.metadata.before_points(self.path, Some((cube, &hierarchy)))?;
        let mut write = || {
            self.sink.write_all(&hierarchy.record)?;
            self.sink.write_all(&self.metadata.evlrs)?;
            self.sink.seek(SeekFrom::Start(0))?;
            self.sink.write_all(&before)?;
            self.sink.seek(SeekFrom::Start(self.table_offset_at))?;
            self.sink.write_all(&self.at.to_le_bytes())?;
            self.sink.seek(SeekFrom::End(0))?;
            self.sink.flush()
        };
        write().map_err(&failed)
    }
}

/// Compresses records as one chunk of LASzip's layered compression.
fn compress(laz: &LazVlr, records: &[u8]) -> io::Result<Vec<u8>> {
    contained(|| {
        let mut chunk = Cursor::new(Vec::new());
        compress_with(LayeredPointRecordCompressor::new(&mut chunk), laz, records)?;
        Ok(chunk.into_inner())
    })
}

/// Compresses all records of a chunk.
pub(super) fn compress_with<W>(
    mut compressor: impl RecordCompressor<W>,
    laz: &LazVlr,
    records: &[u8],
) -> io::Result<()> {
    compressor.set_fields_from(laz.items()).map_err(into_io)?;
    compressor.compress_many(records)?;
    compressor.done()
}

/// Returns whether a record is invalid for reordered points without waveforms.
fn is_left_out(vlr: &Vlr) -> bool {
    let descriptors = FIRST_DESCRIPTOR..FIRST_DESCRIPTOR + 255;
    vlr.user_id == COPC
        || vlr.user_id == LazVlr::USER_ID
        || vlr.is(lax::USER_ID, lax::RECORD_ID)
        || vlr.is(SPEC, WAVEFORM_PACKETS)
        || vlr.user_id == SPEC && descriptors.contains(&vlr.record_id)
}

#[cfg(test)]
mod tests;
