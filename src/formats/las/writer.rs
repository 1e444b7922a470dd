//! Writing LAS and LAZ 1.4, point format 6, with extra attributes: LAS 1.4 R15.

use std::io::{self, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use laz::laszip::ChunkTable;
use laz::laszip::parallel::par_compress;
use laz::{LasZipError, LazVlr, LazVlrBuilder};

use super::extra_bytes::{DESCRIPTOR, ExtraAttribute};
use super::header::{HEADER_1_4, encoding};
use super::point::{FORMAT_6, PointOut};
use super::vlr::{EXTRA_BYTES, PROJECTION, SPEC, VLR_HEADER, WKT};
use crate::formats::{Error, Result};

/// Points of a LAZ chunk, as other writers have it.
const CHUNK: usize = 50_000;
/// Points gathered before they are written to an uncompressed file.
const PLAIN_SLAB: usize = 4096;
const POINT_FORMAT: u8 = 6;

/// What is the same for all points of a file.
#[derive(Debug, Clone)]
pub struct WriterOptions<'a> {
    /// Steps of x, y, z, in units of the coordinate system, above 0.
    pub scale: [f64; 3],
    /// Offsets of x, y, z: coordinates are stored as 32-bit numbers of steps from here.
    pub offset: [f64; 3],
    /// Coordinate system as OGC WKT 1.
    pub wkt: Option<&'a str>,
    /// What each point has behind its standard fields, in this order.
    pub extra_attributes: &'a [ExtraAttribute],
    /// The points' times are adjusted standard GPS time; `false`: seconds of the GPS week.
    pub adjusted_gps_time: bool,
    /// Day of the year of the creation, from 1.
    pub creation_day: u16,
    /// Year of the creation.
    pub creation_year: u16,
    /// What made the data; at most 32 bytes are kept.
    pub system_identifier: &'a str,
    /// The software; at most 32 bytes are kept.
    pub generating_software: &'a str,
    /// The flight line, 0 if unassigned.
    pub file_source_id: u16,
    /// Chunks of points that are compressed at a time; the bytes of the file do not depend on it. Memory is 50 000
    /// points per thread and about as much again for their compressed form.
    pub threads: usize,
}

/// A writer of points.
///
/// The sink starts at the file's first byte and is the caller's: its name until the file is complete, and the renaming.
/// Without [`Writer::finish`] the file says that it has no points.
pub struct Writer<W> {
    sink: W,
    path: PathBuf,
    scale: [f64; 3],
    offset: [f64; 3],
    header: Vec<u8>,
    record_length: usize,
    /// Records that are not written yet.
    slab: Vec<u8>,
    /// Bytes at which the slab is written.
    slab_bytes: usize,
    compression: Option<Compression>,
    totals: Totals,
}

/// State of a LAZ file: its chunks so far.
struct Compression {
    laz: LazVlr,
    table: ChunkTable,
    /// Where the place of the chunk table is to be noted.
    table_offset_at: u64,
}

/// What the header says of all points together.
struct Totals {
    points: u64,
    by_return: [u64; 15],
    min: [i32; 3],
    max: [i32; 3],
}

impl<W: Write + Seek> Writer<W> {
    /// Writes all that stands before the points. `path` names the file in errors, and its extension decides between LAS
    /// and LAZ.
    ///
    /// # Errors
    /// The extension is neither, an option is out of its bounds, or the sink refuses.
    pub fn new(mut sink: W, path: &Path, options: &WriterOptions) -> Result<Writer<W>> {
        let compressed = is_laz(path)?;
        check(path, options)?;
        let extra: usize = options.extra_attributes.iter().map(|attribute| attribute.data_type.bytes()).sum();
        let record_length = FORMAT_6 + extra;
        let laz = compressed.then(|| laz_vlr(path, extra)).transpose()?;
        let vlrs = vlrs(path, options, laz.as_ref())?;
        let offset_to_points = usize::from(HEADER_1_4) + vlrs.iter().map(Vec::len).sum::<usize>();
        let header = header(options, record_length, vlrs.len(), offset_to_points, compressed);
        let write = |sink: &mut W| {
            sink.write_all(&header)?;
            vlrs.iter().try_for_each(|vlr| sink.write_all(vlr))?;
            // LASzip's data begin with the place of the chunk table: -1 until it is known.
            if compressed { sink.write_all(&(-1i64).to_le_bytes()) } else { Ok(()) }
        };
        write(&mut sink).map_err(Error::io(path, "write"))?;
        let slab = if compressed { options.threads.max(1) * CHUNK } else { PLAIN_SLAB };
        Ok(Writer {
            sink,
            path: path.to_path_buf(),
            scale: options.scale,
            offset: options.offset,
            header,
            record_length,
            slab: Vec::with_capacity(slab * record_length),
            slab_bytes: slab * record_length,
            compression: laz.map(|laz| Compression {
                laz,
                table: ChunkTable::default(),
                table_offset_at: offset_to_points as u64,
            }),
            totals: Totals { points: 0, by_return: [0; 15], min: [i32::MAX; 3], max: [i32::MIN; 3] },
        })
    }

    /// Writes one point with its extra attributes, as [`ExtraAttribute::push`] made them, in the order of the options.
    ///
    /// # Errors
    /// A coordinate does not fit 32 bits at this scale and offset (or is not finite), the extra bytes are not as many as
    /// the options say: the point is left out then. Or the sink refuses: the file cannot be completed then.
    pub fn write_point(&mut self, point: &PointOut, extra: &[u8]) -> Result<()> {
        if FORMAT_6 + extra.len() != self.record_length {
            let problem = format!(
                "point {} has {} extra bytes, and the attributes need {}",
                self.totals.points,
                extra.len(),
                self.record_length - FORMAT_6
            );
            return Err(Error::unusable(
                &self.path,
                problem,
                "give each attribute of the options once, in order",
            ));
        }
        let xyz = [point.x, point.y, point.z];
        let raw = [self.steps(xyz, 0)?, self.steps(xyz, 1)?, self.steps(xyz, 2)?];
        self.slab.extend_from_slice(&point.encode(raw));
        self.slab.extend_from_slice(extra);
        self.totals.add(raw, point.return_number);
        if self.slab.len() >= self.slab_bytes { self.flush_slab() } else { Ok(()) }
    }

    /// Writes what is left, the chunk table and the header's sums, and gives the sink back, flushed.
    ///
    /// # Errors
    /// The sink refuses.
    pub fn finish(mut self) -> Result<W> {
        self.flush_slab()?;
        self.totals.patch(&mut self.header, &self.scale, &self.offset);
        let Writer { mut sink, header, compression, .. } = self;
        let mut end = || {
            if let Some(compression) = &compression {
                let table_at = sink.stream_position()?;
                compression.table.write_to(&mut sink, &compression.laz)?;
                sink.seek(SeekFrom::Start(compression.table_offset_at))?;
                sink.write_all(&table_at.to_le_bytes())?;
            }
            sink.seek(SeekFrom::Start(0))?;
            sink.write_all(&header)?;
            sink.seek(SeekFrom::End(0))?;
            sink.flush()
        };
        end().map_err(Error::io(&self.path, "write"))?;
        Ok(sink)
    }

    /// Number of points written so far.
    pub fn n_points(&self) -> u64 {
        self.totals.points
    }

    fn steps(&self, xyz: [f64; 3], axis: usize) -> Result<i32> {
        let steps = ((xyz[axis] - self.offset[axis]) / self.scale[axis]).round();
        if steps >= f64::from(i32::MIN) && steps <= f64::from(i32::MAX) {
            return Ok(steps as i32);
        }
        let problem = format!(
            "point {} at {xyz:?} cannot be stored: {} = {} is too far from the offset {} for steps of {}",
            self.totals.points,
            ["x", "y", "z"][axis],
            xyz[axis],
            self.offset[axis],
            self.scale[axis]
        );
        Err(Error::unusable(&self.path, problem, "choose an offset near the points, or a larger scale"))
    }

    /// Writes the slab. A full one holds whole chunks only, so that the chunks do not depend on its size.
    fn flush_slab(&mut self) -> Result<()> {
        if self.slab.is_empty() {
            return Ok(());
        }
        let io = Error::io(&self.path, "write");
        match &mut self.compression {
            None => self.sink.write_all(&self.slab).map_err(io)?,
            Some(compression) => {
                let table = par_compress(&mut self.sink, &self.slab, &compression.laz);
                compression.table.extend(&table.map_err(into_io).map_err(io)?);
            }
        }
        self.slab.clear();
        Ok(())
    }
}

fn into_io(error: LasZipError) -> io::Error {
    match error {
        LasZipError::IoError(error) => error,
        other => io::Error::other(other),
    }
}

impl Totals {
    fn add(&mut self, raw: [i32; 3], return_number: u8) {
        self.points += 1;
        // A return number of 0 belongs to no column; those above 15 are written as 15.
        let column = usize::from(return_number.min(15)).checked_sub(1);
        if let Some(count) = column.and_then(|column| self.by_return.get_mut(column)) {
            *count += 1;
        }
        for (axis, value) in raw.into_iter().enumerate() {
            self.min[axis] = self.min[axis].min(value);
            self.max[axis] = self.max[axis].max(value);
        }
    }

    /// Puts the sums into the header. The bounding box is that of the coordinates as stored.
    fn patch(&self, header: &mut [u8], scale: &[f64; 3], offset: &[f64; 3]) {
        let mut put = |at: usize, bytes: [u8; 8]| header[at..at + 8].copy_from_slice(&bytes);
        put(247, self.points.to_le_bytes());
        for (column, count) in self.by_return.iter().enumerate() {
            put(255 + 8 * column, count.to_le_bytes());
        }
        if self.points == 0 {
            return;
        }
        for axis in 0..3 {
            let place = |raw: i32| f64::from(raw) * scale[axis] + offset[axis];
            put(179 + 16 * axis, place(self.max[axis]).to_le_bytes());
            put(187 + 16 * axis, place(self.min[axis]).to_le_bytes());
        }
    }
}

fn is_laz(path: &Path) -> Result<bool> {
    let extension = path.extension().unwrap_or_default();
    match (extension.eq_ignore_ascii_case("las"), extension.eq_ignore_ascii_case("laz")) {
        (true, _) => Ok(false),
        (_, true) => Ok(true),
        _ => Err(Error::unusable(
            path,
            "the extension is neither `las` nor `laz`",
            "give the output one of them",
        )),
    }
}

fn check(path: &Path, options: &WriterOptions) -> Result<()> {
    let bad = |problem: String, remedy| Err(Error::unusable(path, problem, remedy));
    if !options.scale.iter().all(|scale| scale.is_finite() && *scale > 0.0) {
        return bad(format!("the scale {:?} is not positive", options.scale), "give a scale like 0.001");
    }
    if !options.offset.iter().all(|offset| offset.is_finite()) {
        return bad(
            format!("the offset {:?} is not finite", options.offset),
            "give an offset near the points",
        );
    }
    for (number, attribute) in options.extra_attributes.iter().enumerate() {
        let name = attribute.name;
        if options.extra_attributes[..number].iter().any(|other| other.name == name) {
            return bad(format!("the extra attribute {name} stands twice in the list"), "give it once");
        }
    }
    Ok(())
}

fn laz_vlr(path: &Path, extra: usize) -> Result<LazVlr> {
    let extra = u16::try_from(extra).map_err(|_| too_much(path, "the extra attributes"))?;
    let builder = LazVlrBuilder::default().with_point_format(POINT_FORMAT, extra);
    let builder = builder.map_err(into_io).map_err(Error::io(path, "prepare the compression"))?;
    Ok(builder.with_fixed_chunk_size(CHUNK as u32).build())
}

/// The records between the header and the points.
fn vlrs(path: &Path, options: &WriterOptions, laz: Option<&LazVlr>) -> Result<Vec<Vec<u8>>> {
    let mut vlrs = Vec::new();
    if let Some(wkt) = options.wkt {
        let data = [wkt.as_bytes(), &[0]].concat();
        vlrs.push(vlr(path, PROJECTION, WKT, "OGC coordinate system WKT", &data)?);
    }
    if !options.extra_attributes.is_empty() {
        let mut data = Vec::with_capacity(options.extra_attributes.len() * DESCRIPTOR);
        options.extra_attributes.iter().for_each(|attribute| data.extend(attribute.descriptor()));
        vlrs.push(vlr(path, SPEC, EXTRA_BYTES, "Extra bytes", &data)?);
    }
    if let Some(laz) = laz {
        let mut data = Vec::new();
        laz.write_to(&mut data).map_err(Error::io(path, "prepare the compression"))?;
        vlrs.push(vlr(path, LazVlr::USER_ID, LazVlr::RECORD_ID, LazVlr::DESCRIPTION, &data)?);
    }
    Ok(vlrs)
}

fn vlr(path: &Path, user_id: &str, record_id: u16, description: &str, data: &[u8]) -> Result<Vec<u8>> {
    let length = u16::try_from(data.len()).map_err(|_| too_much(path, description))?;
    let mut bytes = Vec::with_capacity(VLR_HEADER as usize + data.len());
    bytes.extend([0; 2]);
    bytes.extend(text::<16>(user_id));
    bytes.extend(record_id.to_le_bytes());
    bytes.extend(length.to_le_bytes());
    bytes.extend(text::<32>(description));
    bytes.extend(data);
    Ok(bytes)
}

fn too_much(path: &Path, what: &str) -> Error {
    let problem = format!("{what}: more than the 65535 bytes that a LAS record may have");
    Error::unusable(path, problem, "give a shorter WKT, or fewer extra attributes")
}

/// Text of a fixed length, cut or filled with zeros.
fn text<const N: usize>(text: &str) -> [u8; N] {
    let mut bytes = [0; N];
    bytes.iter_mut().zip(text.bytes()).for_each(|(place, byte)| *place = byte);
    bytes
}

/// The header of LAS 1.4 with zeros for what only the points know.
fn header(
    options: &WriterOptions,
    record_length: usize,
    n_vlrs: usize,
    offset_to_points: usize,
    compressed: bool,
) -> Vec<u8> {
    let bit = |set: bool, bit: u16| if set { bit } else { 0 };
    let encoding =
        bit(options.adjusted_gps_time, encoding::ADJUSTED_TIME) | bit(options.wkt.is_some(), encoding::WKT);
    let mut header = Vec::with_capacity(HEADER_1_4.into());
    header.extend(b"LASF");
    header.extend(options.file_source_id.to_le_bytes());
    header.extend(encoding.to_le_bytes());
    header.extend([0; 16]); // project ID
    header.extend([1, 4]);
    header.extend(text::<32>(options.system_identifier));
    header.extend(text::<32>(options.generating_software));
    header.extend(options.creation_day.to_le_bytes());
    header.extend(options.creation_year.to_le_bytes());
    header.extend(HEADER_1_4.to_le_bytes());
    header.extend((offset_to_points as u32).to_le_bytes());
    header.extend((n_vlrs as u32).to_le_bytes());
    header.push(POINT_FORMAT | if compressed { 0x80 } else { 0 });
    header.extend((record_length as u16).to_le_bytes());
    header.extend([0; 24]); // legacy counts: 0 for formats 6 and above
    options.scale.iter().chain(&options.offset).for_each(|value| header.extend(value.to_le_bytes()));
    header.resize(HEADER_1_4.into(), 0);
    header
}
