//! LAS and LAZ writer with extra attributes and waveforms.
//!
//! LAS 1.4 R15 with point formats 6 and 9; LAS 1.2 and 1.3 with point formats 1 and 4.

mod byte_layers;
mod chunk;
mod compression;
mod options;
mod records;
mod tile;

use std::io::{self, Read, Seek, SeekFrom, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};

use super::descriptor::PacketDescriptor;
use super::header::LasHeader;
use super::lax::Lax;
use super::point::PointLayout;
use super::point_out::{LEGACY_RETURNS, PointOut, RETURNS};
use super::round::nearest;
use super::totals::PointTotals;
use crate::{Error, Result};
pub(super) use chunk::into_io;
use compression::ChunkCompressor;
pub use options::{IndexPlace, LasVersion, WavePlace, WriterOptions};
use records::EncodedVlrs;
pub(super) use records::laz_record;
use tile::PointTile;
#[cfg(test)]
pub(super) use tile::record;
pub use tile::{ExtraColumns, TOGETHER};

/// Points per LAZ chunk, as in other writers.
const CHUNK: usize = 50_000;
/// Points buffered before they are written to an uncompressed file.
const PLAIN_SLAB: usize = 4096;

/// LAS or LAZ point writer.
///
/// The sink starts at the first byte of the file. The caller owns the sink and the temporary name
/// of the file until it is complete. Without [`Writer::finish`] the header declares no points.
pub struct Writer<W> {
    sink: W,
    path: PathBuf,
    version: LasVersion,
    header: LasHeader,
    /// Length of a record, bytes.
    record_length: usize,
    /// Length of the standard fields of a record, bytes.
    standard_length: usize,
    /// Points being encoded.
    tile: Box<PointTile>,
    /// Encoded records that are not yet written.
    slab: Vec<u8>,
    /// Size at which the slab is written, bytes.
    slab_bytes: usize,
    compression: Option<ChunkCompressor>,
    index: Option<Lax>,
    totals: PointTotals,
    /// Offset reserved for the waveform descriptors.
    descriptors_at: u64,
}

impl<W: Write + Seek> Writer<W> {
    /// Writes the header and VLRs.
    ///
    /// `path` names the file in errors; its extension selects LAS or LAZ.
    ///
    /// # Errors
    /// The extension is neither, an option is out of bounds, or writing fails.
    pub fn new(mut sink: W, path: &Path, options: &WriterOptions) -> Result<Writer<W>> {
        let compressed = options::is_laz(path)?;
        options.check(path)?;
        let laz = compressed.then(|| records::laz_vlr(path, options)).transpose()?;
        let records = EncodedVlrs::new(path, options, laz.as_ref())?;
        let standard_length = PointLayout::of(options.point_format()).length;
        let record_length = standard_length + options.extra_bytes();
        let mut header = options.header();
        let header_bytes = usize::from(header.header_size);
        let offset_to_points = header_bytes + records.bytes.len();
        header.offset_to_points = offset_to_points as u32;
        header.n_vlrs = records.count;
        header.compressed = compressed;
        header.record_length = record_length as u16;
        let write = |sink: &mut W| {
            sink.write_all(&header.write())?;
            sink.write_all(&records.bytes)?;
            // LASzip data begin with the offset of the chunk table: -1 until it is known.
            if compressed { sink.write_all(&(-1i64).to_le_bytes()) } else { Ok(()) }
        };
        write(&mut sink).map_err(Error::io(path, "write"))?;
        let slab = if compressed { CHUNK } else { PLAIN_SLAB };
        Ok(Writer {
            sink,
            path: path.to_path_buf(),
            version: options.version,
            header,
            record_length,
            standard_length,
            tile: Box::new(PointTile::new(options.point_format())),
            slab: Vec::with_capacity(slab * record_length),
            slab_bytes: slab * record_length,
            compression: laz.map(|laz| {
                let special_evlrs_at = (header_bytes + records.special_evlrs_at) as u64;
                ChunkCompressor::new(laz, offset_to_points as u64, special_evlrs_at, options.pool.clone())
            }),
            index: (options.index != IndexPlace::None).then(|| Lax::new(options.scale[0])),
            totals: PointTotals::new(),
            descriptors_at: (header_bytes + records.descriptors_at) as u64,
        })
    }

    /// Writes one point with its extra attributes.
    ///
    /// `extra` holds the attributes as encoded by
    /// [`ExtraAttribute::push`](super::ExtraAttribute::push), in the order of the options.
    ///
    /// # Errors
    /// A coordinate is not finite or exceeds 32 bits at this scale and offset, the number of extra
    /// bytes is wrong, or the version cannot count more points; the point is then skipped. Or
    /// writing fails; the file cannot be completed then.
    pub fn write_point(&mut self, point: &PointOut, extra: &[u8]) -> Result<()> {
        let mut refused = None;
        let put = |_, columns: &mut ExtraColumns| columns.put_all(extra);
        self.write_points(1, |_| point.clone(), put, |error| refused = Some(error))?;
        refused.map_or(Ok(()), Err)
    }

    /// Writes points 0 to `n - 1`, faster than individually.
    ///
    /// `extra` adds the extra attributes in the order of the options, for up to [`TOGETHER`] points
    /// at a time. It is called again for single points if one of them is skipped. `refused` gets
    /// the error of each skipped point, as in [`Writer::write_point`]; the others are written.
    ///
    /// # Errors
    /// The number of extra bytes is wrong; the requested points are then skipped. Or writing fails;
    /// the file cannot be completed then.
    pub fn write_points(
        &mut self,
        n: usize,
        point: impl Fn(usize) -> PointOut,
        extra: impl Fn(Range<usize>, &mut ExtraColumns),
        mut refused: impl FnMut(Error),
    ) -> Result<()> {
        let mut next = 0;
        while next < n {
            let points = next..n.min(next + self.room());
            next = points.end;
            // Extra attributes come first: in their short loops the processor prefetches many
            // points.
            let start = self.slab.len();
            self.put_extra(points.len(), |columns| extra(points.clone(), columns))?;
            self.tile.fill(points.clone().map(&point));
            if let Some(ends) = self.tile.count_steps(self.header.scale, self.header.offset)
                && self.may_count(points.len())
            {
                self.put(start, ends)?;
                continue;
            }
            self.slab.truncate(start);
            let tile = self.tile.clone();
            for number in points.clone() {
                self.tile.take_one(&tile, number - points.start);
                match self.check_one() {
                    Ok(raw) => {
                        self.put_extra(1, |columns| extra(number..number + 1, columns))?;
                        self.put(self.slab.len() - self.record_length, raw.map(|raw| (raw, raw)))?;
                    }
                    Err(error) => refused(error),
                }
            }
        }
        Ok(())
    }

    /// Returns the number of points to encode at once.
    ///
    /// The slab may be full after them; at least one.
    fn room(&self) -> usize {
        (self.slab_bytes.saturating_sub(self.slab.len()) / self.record_length).clamp(1, TOGETHER)
    }

    /// Returns whether the version can count this many more points.
    fn may_count(&self, n: usize) -> bool {
        !self.version.is_legacy() || self.totals.points + n as u64 <= u64::from(u32::MAX)
    }

    /// Quantises the single point of the tile.
    fn check_one(&mut self) -> Result<[i32; 3]> {
        if !self.may_count(1) {
            let problem = format!("LAS 1.{} holds at most {} points", self.version.minor(), u32::MAX);
            return Err(Error::unusable(&self.path, problem, "write LAS 1.4"));
        }
        let xyz = self.tile.first();
        let raw = [self.steps(xyz, 0)?, self.steps(xyz, 1)?, self.steps(xyz, 2)?];
        self.tile.set_raw(raw);
        Ok(raw)
    }

    /// Starts `n` records in the slab with their extra attributes.
    fn put_extra(&mut self, n: usize, extra: impl FnOnce(&mut ExtraColumns)) -> Result<()> {
        let start = self.slab.len();
        self.slab.resize(start + n * self.record_length, 0);
        let records = &mut self.slab[start..];
        let mut columns = ExtraColumns::new(records, self.record_length, self.standard_length);
        extra(&mut columns);
        let left = columns.left();
        if left == 0 {
            return Ok(());
        }
        self.slab.truncate(start);
        Err(self.wrong_extra_bytes(left))
    }

    /// Completes the records of the tile, from `start` in the slab.
    ///
    /// `ends` are the smallest and largest stored coordinates.
    fn put(&mut self, start: usize, ends: [(i32, i32); 3]) -> Result<()> {
        self.tile.encode(&mut self.slab[start..], self.record_length);
        let most_returns = if self.version.is_legacy() { LEGACY_RETURNS } else { RETURNS };
        self.totals.add(ends, self.tile.return_numbers(), most_returns);
        if let Some(index) = &mut self.index {
            for (x, y) in self.tile.raw(0).iter().zip(self.tile.raw(1)) {
                let [x, y, _] = self.header.coordinates([*x, *y, 0]);
                index.add(x, y);
            }
        }
        if self.slab.len() >= self.slab_bytes { self.flush_slab() } else { Ok(()) }
    }

    /// Returns the spatial index of the points written.
    ///
    /// It is for a separate file. The index is then not appended. `None` if the options request
    /// none, or for more than 2^32 - 1 points.
    pub fn take_index(&mut self) -> Option<Vec<u8>> {
        self.index.take()?.finish()
    }

    /// Writes remaining points, chunk table, appended index and final header.
    ///
    /// Returns the flushed sink.
    ///
    /// # Errors
    /// Writing fails.
    pub fn finish(self) -> Result<W> {
        self.finish_with_waveforms(&[], None)
    }

    /// Finishes a file with waveforms, like [`Writer::finish`].
    ///
    /// Writes the descriptors of the packet `kinds`, as returned by
    /// [`PacketWriter::finish`](super::PacketWriter::finish). `inside` is the packet record with
    /// its header, if packets go inside the file.
    ///
    /// # Errors
    /// Writing fails, or the packets cannot be read.
    pub fn finish_with_waveforms(
        mut self,
        kinds: &[PacketDescriptor],
        inside: Option<&mut dyn Read>,
    ) -> Result<W> {
        self.flush_slab()?;
        let index = self.take_index();
        self.totals.store(&mut self.header);
        self.header.n_vlrs += kinds.len() as u32;
        let descriptors = records::descriptors(&self.path, kinds)?;
        self.end(&descriptors, inside, index).map_err(Error::io(&self.path, "write"))?;
        Ok(self.sink)
    }

    /// Writes everything that is known only after the last point.
    fn end(
        &mut self,
        descriptors: &[u8],
        packets: Option<&mut dyn Read>,
        index: Option<Vec<u8>>,
    ) -> io::Result<()> {
        let sink = &mut self.sink;
        if let Some(compression) = &mut self.compression {
            compression.end(sink)?;
        }
        let packets_at = sink.seek(SeekFrom::End(0))?;
        if let Some(packets) = packets {
            io::copy(packets, sink)?;
            self.header.start_of_waveforms = packets_at;
            if self.version == LasVersion::V1_4 {
                (self.header.start_of_evlrs, self.header.n_evlrs) = (packets_at, 1);
            }
        }
        if let (Some(compression), Some(index)) = (&self.compression, index) {
            compression.append(sink, index)?;
        }
        sink.seek(SeekFrom::Start(self.descriptors_at))?;
        sink.write_all(descriptors)?;
        sink.seek(SeekFrom::Start(0))?;
        sink.write_all(&self.header.write())?;
        sink.seek(SeekFrom::End(0))?;
        sink.flush()
    }

    /// Returns the number of points written so far.
    pub fn n_points(&self) -> u64 {
        self.totals.points
    }

    fn steps(&self, xyz: [f64; 3], axis: usize) -> Result<i32> {
        let (scale, offset) = (self.header.scale[axis], self.header.offset[axis]);
        let steps = (xyz[axis] - offset) / scale;
        if steps.is_finite()
            && let Ok(steps) = i32::try_from(nearest(steps))
        {
            return Ok(steps);
        }
        let problem = format!(
            "point {} at {xyz:?} cannot be stored: {} = {} is too far from the offset {offset} for steps of {scale}",
            self.totals.points,
            ["x", "y", "z"][axis],
            xyz[axis],
        );
        Err(Error::unusable(&self.path, problem, "choose an offset near the points, or a larger scale"))
    }

    /// Creates the error for `left` missing extra bytes.
    ///
    /// Negative for too many.
    fn wrong_extra_bytes(&self, left: i64) -> Error {
        let need = (self.record_length - self.standard_length) as i64;
        let problem = format!(
            "point {} has {} extra bytes, but the attributes need {need}",
            self.totals.points,
            need - left
        );
        Error::unusable(&self.path, problem, "give each attribute of the options once, in order")
    }

    /// Writes the slab; with compression, it is one chunk.
    fn flush_slab(&mut self) -> Result<()> {
        if self.slab.is_empty() {
            return Ok(());
        }
        let io = Error::io(&self.path, "write");
        match &mut self.compression {
            Some(compression) => compression.put(&mut self.slab, &mut self.sink).map_err(io),
            None => {
                self.sink.write_all(&self.slab).map_err(io)?;
                self.slab.clear();
                Ok(())
            }
        }
    }
}
