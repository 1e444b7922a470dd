//! Public header block.
//!
//! LAS 1.4 R15, section "Public Header Block", and LAS 1.5. LAS 1.5 appends three fields.

use std::io::Read;
use std::path::Path;

use super::encoding;
use super::point::PointLayout;
use crate::bytes::{Fields, text};
use crate::other_format::other_format;
use crate::{Error, Result};

/// Length of the longest header (LAS 1.5), bytes.
const LONGEST: u16 = 393;
const DAMAGED: &str = "the header is damaged: export the file again";
const CUT_OFF: &str = "the file is cut off: copy it again from its source";
/// Bit of the point format that marks compressed points (LASzip).
const COMPRESSED: u8 = 0x80;

/// Largest coordinate of a point, in units of the coordinate system.
///
/// The radius of the Earth is 6.4e9 mm, and no system has smaller units.
pub const MAX_COORDINATE: f64 = 1e10;

/// Smallest and largest step of coordinates: a whole axis of 4 mm, and a kilometre.
const STEPS: std::ops::RangeInclusive<f64> = 1e-12..=1e3;

/// Returns the length of the header of LAS 1.`minor`, bytes.
pub(super) fn header_bytes(minor: u8) -> u16 {
    match minor {
        0..=2 => 227,
        3 => 235,
        4 => 375,
        _ => LONGEST,
    }
}

/// Time system of the points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum GpsTime {
    /// Seconds of the GPS week.
    Week,
    /// Standard GPS time minus an offset, s.
    ///
    /// The offset is 1e9 for adjusted standard GPS time; other offsets exist from LAS 1.5 on.
    Standard {
        /// Offset subtracted from standard GPS time, s.
        offset_s: f64,
    },
}

/// Public header block.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct LasHeader {
    /// File source ID (flight line), 0 if unassigned.
    pub file_source_id: u16,
    /// Field "global encoding" as stored.
    pub global_encoding: u16,
    /// Project GUID as stored.
    pub guid: [u8; 16],
    /// Major and minor version: (1, 0) to (1, 5).
    pub version: (u8, u8),
    /// System that created the data.
    pub system_identifier: String,
    /// Software that wrote the file.
    pub generating_software: String,
    /// Day of the year of file creation, from 1.
    pub creation_day: u16,
    /// Year of file creation.
    pub creation_year: u16,
    /// Length of the header, bytes.
    pub header_size: u16,
    /// File offset of the first point or the LAZ data, bytes.
    pub offset_to_points: u32,
    /// Number of variable length records (VLRs) before the points.
    pub n_vlrs: u32,
    /// Point data record format, 0 to 10.
    pub point_format: u8,
    /// Whether the points are compressed (LAZ).
    pub compressed: bool,
    /// Length of an uncompressed point, bytes.
    ///
    /// Beyond the format's fields are extra bytes.
    pub record_length: u16,
    /// Number of points.
    pub n_points: u64,
    /// Number of points by return number, from 1.
    ///
    /// Five counts before LAS 1.4.
    pub n_points_by_return: [u64; 15],
    /// Scale factors of x, y, z.
    pub scale: [f64; 3],
    /// Offsets of x, y, z, in units of the coordinate system.
    pub offset: [f64; 3],
    /// Smallest x, y, z according to the header.
    pub min: [f64; 3],
    /// Largest x, y, z according to the header.
    pub max: [f64; 3],
    /// Offset of the waveform packet record.
    ///
    /// 0 if there is none or the version lacks the field.
    pub start_of_waveforms: u64,
    /// Offset of the first extended variable length record (EVLR).
    ///
    /// 0 before LAS 1.4.
    pub start_of_evlrs: u64,
    /// Number of extended variable length records; 0 before LAS 1.4.
    pub n_evlrs: u32,
    /// LAS 1.5: offset of GPS time, millions of seconds; else 0.
    pub time_offset_megaseconds: u16,
}

impl LasHeader {
    /// Returns whether points of this format refer to waveforms: formats 4, 5, 9 and 10.
    pub fn has_waveforms(&self) -> bool {
        PointLayout::of(self.point_format).wave.is_some()
    }

    /// Reads the header at the start of `file`, which has `file_length` bytes.
    ///
    /// # Errors
    /// The file is empty, is not LAS, has an unknown version or point format, or contradictory
    /// sizes; or reading fails.
    pub(super) fn read(input: &mut impl Read, file: &Path, file_length: u64) -> Result<LasHeader> {
        let (header, missing) = LasHeader::read_partial(input, file, file_length)?;
        missing.map_or(Ok(header), Err)
    }

    /// As [`LasHeader::read`], with the number of points in the file, and the error if more are
    /// declared.
    pub(super) fn read_partial(
        input: &mut impl Read,
        file: &Path,
        file_length: u64,
    ) -> Result<(LasHeader, Option<Error>)> {
        let mut bytes = Vec::with_capacity(LONGEST.into());
        input.take(LONGEST.into()).read_to_end(&mut bytes).map_err(Error::io(file, "read the header"))?;
        let mut fields = Fields::new(file, 0, &bytes);
        check_signature(file, &bytes)?;
        fields.skip(4, "file signature")?;
        let file_source_id = fields.u16("file source ID")?;
        let global_encoding = fields.u16("global encoding")?;
        let guid = fields.array("project ID")?;
        let version = version(&mut fields)?;
        let system_identifier = fields.text(32, "system identifier")?;
        let generating_software = fields.text(32, "generating software")?;
        let creation_day = fields.u16("file creation day of year")?;
        let creation_year = fields.u16("file creation year")?;
        let header_size = header_size(&mut fields, version)?;
        let offset_to_points = offset_to_points(&mut fields, header_size, file_length)?;
        let n_vlrs = fields.u32("number of variable length records")?;
        let (point_format, compressed) = point_format(&mut fields, version)?;
        let record_length = record_length(&mut fields, point_format)?;
        let legacy = (fields.u32("legacy number of point records")?, legacy_by_return(&mut fields)?);
        let scale = scale(&mut fields)?;
        let offset = offset(&mut fields)?;
        let (min, max) = bounds(&mut fields)?;
        let mut header = LasHeader {
            file_source_id,
            global_encoding,
            guid,
            version,
            system_identifier,
            generating_software,
            creation_day,
            creation_year,
            header_size,
            offset_to_points,
            n_vlrs,
            point_format,
            compressed,
            record_length,
            n_points: legacy.0.into(),
            n_points_by_return: legacy.1,
            scale,
            offset,
            min,
            max,
            start_of_waveforms: 0,
            start_of_evlrs: 0,
            n_evlrs: 0,
            time_offset_megaseconds: 0,
        };
        header.later_fields(&mut fields)?;
        let missing = header.check_points_fit(file, file_length).err();
        if missing.is_some() {
            header.n_points = header.room(file_length);
        }
        Ok((header, missing))
    }

    /// Encodes the header: [`LasHeader::header_size`] bytes, zero after the fields of the version.
    ///
    /// Texts are truncated, and counts saturate. Formats 6 and above of LAS 1.4 have no legacy
    /// counts. The GPS time bounds of LAS 1.5 are zero.
    pub(super) fn write(&self) -> Vec<u8> {
        let minor = self.version.1;
        let mut out = Vec::with_capacity(self.header_size.into());
        out.extend(b"LASF");
        out.extend(self.file_source_id.to_le_bytes());
        out.extend(self.global_encoding.to_le_bytes());
        out.extend(self.guid);
        out.extend([self.version.0, minor]);
        out.extend(text::<32>(&self.system_identifier));
        out.extend(text::<32>(&self.generating_software));
        out.extend(self.creation_day.to_le_bytes());
        out.extend(self.creation_year.to_le_bytes());
        out.extend(self.header_size.to_le_bytes());
        out.extend(self.offset_to_points.to_le_bytes());
        out.extend(self.n_vlrs.to_le_bytes());
        out.push(self.point_format | if self.compressed { COMPRESSED } else { 0 });
        out.extend(self.record_length.to_le_bytes());
        let has_legacy_counts = minor <= 3 || minor == 4 && self.point_format <= 5;
        for count in [self.n_points].iter().chain(&self.n_points_by_return[..5]) {
            let count = if has_legacy_counts { u32::try_from(*count).unwrap_or(u32::MAX) } else { 0 };
            out.extend(count.to_le_bytes());
        }
        let bounds = (0..3).flat_map(|axis| [self.max[axis], self.min[axis]]);
        for value in self.scale.into_iter().chain(self.offset).chain(bounds) {
            out.extend(value.to_le_bytes());
        }
        if minor >= 3 {
            out.extend(self.start_of_waveforms.to_le_bytes());
        }
        if minor >= 4 {
            out.extend(self.start_of_evlrs.to_le_bytes());
            out.extend(self.n_evlrs.to_le_bytes());
            for count in [self.n_points].iter().chain(&self.n_points_by_return) {
                out.extend(count.to_le_bytes());
            }
        }
        if minor >= 5 {
            out.extend([0; 16]);
            out.extend(self.time_offset_megaseconds.to_le_bytes());
        }
        out.resize(self.header_size.into(), 0);
        out
    }

    /// Reads the fields appended by LAS 1.3, 1.4 and 1.5.
    fn later_fields(&mut self, fields: &mut Fields) -> Result<()> {
        let minor = self.version.1;
        if minor >= 3 {
            self.start_of_waveforms = fields.u64("start of waveform data packet record")?;
        }
        if minor >= 4 {
            self.start_of_evlrs = fields.u64("start of first extended variable length record")?;
            self.n_evlrs = fields.u32("number of extended variable length records")?;
            let n_points = fields.u64("number of point records")?;
            let mut by_return = [0; 15];
            for count in &mut by_return {
                *count = fields.u64("number of points by return")?;
            }
            // LAS 1.4 files with old point formats sometimes fill only the legacy counts, which LAS
            // 1.5 lacks.
            if n_points > 0 || minor >= 5 {
                (self.n_points, self.n_points_by_return) = (n_points, by_return);
            }
        }
        if minor >= 5 {
            fields.skip(16, "GPS time bounds")?;
            self.time_offset_megaseconds = fields.u16("time offset")?;
        }
        Ok(())
    }

    /// Number of uncompressed points that fit into the file.
    fn room(&self, file_length: u64) -> u64 {
        (file_length - u64::from(self.offset_to_points)) / u64::from(self.record_length)
    }

    fn check_points_fit(&self, file: &Path, file_length: u64) -> Result<()> {
        let room = self.room(file_length);
        if self.compressed || self.n_points <= room {
            return Ok(());
        }
        let problem = format!(
            "the header declares {} points of {} bytes, but only {room} fit into the file",
            self.n_points, self.record_length
        );
        Err(Error::malformed(file, self.count_at(), "number of point records", problem, CUT_OFF))
    }

    /// Returns the offset of the number of points, bytes.
    pub(super) fn count_at(&self) -> u64 {
        if self.version.1 >= 4 { 247 } else { 107 }
    }

    /// Returns the time system of the points.
    ///
    /// LAS 1.4 R15, "Global Encoding", bit 0; LAS 1.5, bit 6.
    pub fn gps_time(&self) -> GpsTime {
        let has = |bit| self.global_encoding & bit != 0;
        match (has(encoding::ADJUSTED_TIME), has(encoding::TIME_OFFSET) && self.version.1 >= 5) {
            (false, _) => GpsTime::Week,
            (true, false) => GpsTime::Standard { offset_s: 1e9 },
            (true, true) => GpsTime::Standard { offset_s: f64::from(self.time_offset_megaseconds) * 1e6 },
        }
    }

    /// Returns the coordinates of stored numbers, in units of the coordinate system.
    pub(super) fn coordinates(&self, raw: [i32; 3]) -> [f64; 3] {
        std::array::from_fn(|axis| f64::from(raw[axis]) * self.scale[axis] + self.offset[axis])
    }

    /// Returns whether the header declares a WKT coordinate system.
    ///
    /// Some files of formats 6 and above do not, although the specification requires it.
    pub fn says_wkt(&self) -> bool {
        self.global_encoding & encoding::WKT != 0
    }
}

fn check_signature(file: &Path, bytes: &[u8]) -> Result<()> {
    if bytes.is_empty() {
        return Err(Error::unusable(file, "the file is empty", "copy it again from its source"));
    }
    if bytes.starts_with(b"LASF") {
        return Ok(());
    }
    Err(other_format(file, bytes, "read_las").unwrap_or_else(|| {
        Error::malformed(file, 0, "file signature", "expected `LASF`", "give a LAS or LAZ file")
    }))
}

fn version(fields: &mut Fields) -> Result<(u8, u8)> {
    let start = fields.clone();
    let version = (fields.u8("version major")?, fields.u8("version minor")?);
    if version.0 == 1 && version.1 <= 5 {
        return Ok(version);
    }
    let problem = format!("LAS {}.{} is not supported", version.0, version.1);
    Err(start.bad("version", problem, "convert the file to LAS 1.4"))
}

fn header_size(fields: &mut Fields, version: (u8, u8)) -> Result<u16> {
    let start = fields.clone();
    let size = fields.u16("header size")?;
    let least = header_bytes(version.1);
    if size >= least {
        return Ok(size);
    }
    let problem = format!("{size} bytes, but LAS {}.{} needs {least}", version.0, version.1);
    Err(start.bad("header size", problem, DAMAGED))
}

fn offset_to_points(fields: &mut Fields, header_size: u16, file_length: u64) -> Result<u32> {
    let start = fields.clone();
    let offset = fields.u32("offset to point data")?;
    if offset < u32::from(header_size) {
        let problem = format!("{offset} lies inside the header of {header_size} bytes");
        return Err(start.bad("offset to point data", problem, DAMAGED));
    }
    if u64::from(offset) > file_length {
        let problem = format!("{offset} is beyond the end of the file ({file_length} bytes)");
        return Err(start.bad("offset to point data", problem, CUT_OFF));
    }
    Ok(offset)
}

/// Reads point format and compression.
///
/// LASzip marks compressed points with bit 7.
fn point_format(fields: &mut Fields, version: (u8, u8)) -> Result<(u8, bool)> {
    let start = fields.clone();
    let byte = fields.u8("point data record format")?;
    let format = byte & !COMPRESSED;
    if format > 10 {
        let problem = format!("format {format} is unknown");
        return Err(start.bad(
            "point data record format",
            problem,
            "convert the file to LAS 1.4, format 9 or 10",
        ));
    }
    // Their number of points would be read as 0, from the field for older formats.
    if format >= 6 && version.1 < 4 {
        let problem = format!("LAS {}.{} has no format {format}", version.0, version.1);
        return Err(start.bad(
            "point data record format",
            problem,
            "the version or the format is wrong: export the file again",
        ));
    }
    Ok((format, byte & COMPRESSED != 0))
}

fn record_length(fields: &mut Fields, format: u8) -> Result<u16> {
    let start = fields.clone();
    let length = fields.u16("point data record length")?;
    let least = PointLayout::of(format).length;
    if usize::from(length) >= least {
        return Ok(length);
    }
    let problem = format!("{length} bytes, but format {format} needs {least}");
    Err(start.bad("point data record length", problem, DAMAGED))
}

fn legacy_by_return(fields: &mut Fields) -> Result<[u64; 15]> {
    let mut counts = [0; 15];
    for count in counts.iter_mut().take(5) {
        *count = fields.u32("legacy number of points by return")?.into();
    }
    Ok(counts)
}

fn scale(fields: &mut Fields) -> Result<[f64; 3]> {
    let start = fields.clone();
    let scale = three(fields, "scale factor")?;
    if scale.contains(&0.0) {
        let problem = format!("{scale:?} has a zero, so that all points coincide");
        return Err(start.bad("scale factor", problem, DAMAGED));
    }
    if !scale.iter().all(|step| STEPS.contains(&step.abs())) {
        let problem = format!("{scale:?} is not between {:e} and {:e}", STEPS.start(), STEPS.end());
        return Err(start.bad("scale factor", problem, DAMAGED));
    }
    Ok(scale)
}

/// Reads the offset of coordinates.
fn offset(fields: &mut Fields) -> Result<[f64; 3]> {
    let start = fields.clone();
    let offset = three(fields, "offset")?;
    if offset.iter().all(|value| value.abs() <= MAX_COORDINATE) {
        return Ok(offset);
    }
    let problem = format!("{offset:?} is no position on the Earth, beyond {MAX_COORDINATE:e}");
    Err(start.bad("offset", problem, DAMAGED))
}

/// Reads three finite numbers.
fn three(fields: &mut Fields, name: &str) -> Result<[f64; 3]> {
    let start = fields.clone();
    let values = [fields.f64(name)?, fields.f64(name)?, fields.f64(name)?];
    if values.iter().all(|value| value.is_finite()) {
        return Ok(values);
    }
    let problem = format!("{values:?} is not finite");
    Err(start.bad(name, problem, DAMAGED))
}

/// Reads the bounding box.
///
/// Stored as max x, min x, max y, min y, max z, min z.
fn bounds(fields: &mut Fields) -> Result<([f64; 3], [f64; 3])> {
    let (mut min, mut max) = ([0.0; 3], [0.0; 3]);
    for axis in 0..3 {
        max[axis] = fields.f64("bounding box")?;
        min[axis] = fields.f64("bounding box")?;
    }
    Ok((min, max))
}

#[cfg(test)]
mod tests;
