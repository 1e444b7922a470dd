//! Header of the pulse file.

use std::path::Path;

use crate::bytes::Fields;
use crate::other_format::other_format;
use crate::{Error, Result};

/// Signature of a pulse file, without its terminating zero.
const SIGNATURE: &[u8] = b"PulseWavesPulse";
/// Signature of a waves file, without its terminating zero.
const WAVES_SIGNATURE: &[u8] = b"PulseWavesWaves";
/// Compression scheme of a waves file: arithmetic coding.
const WAVES_COMPRESSED: u32 = 1;
/// Size of the header in version 0.3, bytes.
pub(super) const HEADER_BYTES: usize = 352;
/// Size of the header of the waves file, bytes.
pub(super) const WAVES_HEADER_BYTES: usize = 60;
/// Size of pulse record type 0 without attributes, bytes.
pub(super) const PULSE_BYTES: u32 = 48;
/// Largest accepted size of a pulse record, bytes.
const MOST_PULSE_BYTES: u32 = 1 << 20;
/// Bit of `pulse_attributes`: a 16-bit source ID follows the record.
const SOURCE_ID_16: u32 = 1;
/// Bit of `pulse_attributes`: a 32-bit source ID follows the record.
const SOURCE_ID_32: u32 = 2;
/// Maximum number of records.
///
/// Far above the 255 each of scanners, descriptors and tables.
const MOST_RECORDS: u32 = 1 << 16;
/// Seconds per week.
const WEEK_S: f64 = 604_800.0;

const EXPORT: &str = "export the file again from its source";

/// Pulse header (PulseWaves specification 0.3, "The Pulse Header", 352 bytes).
///
/// The project GUID is not read.
#[derive(Debug, Clone, PartialEq)]
pub struct PulseHeader {
    /// Bit field of global properties; version 0.3 defines none.
    pub global_parameters: u32,
    /// Flight line or scan; 0 after merging several.
    pub source_id: u32,
    /// Sensor or process that created the pulses.
    pub system_identifier: String,
    /// Software that wrote the file.
    pub generating_software: String,
    /// Day of the year of file creation, from 1.
    ///
    /// 0 if not set.
    pub creation_day: u16,
    /// Year of file creation; 0 if not set.
    pub creation_year: u16,
    /// Major and minor version.
    pub version: (u8, u8),
    /// Size of this header, bytes; at least 352.
    pub header_size: u16,
    /// File offset of the first pulse record, bytes.
    pub offset_to_pulses: u64,
    /// Declared number of pulses; [`super::Reader::pulse_count`] is the actual number.
    pub pulse_count: u64,
    /// Format of the pulse records: 0.
    pub pulse_format: u32,
    /// Bit mask of attributes after each record.
    ///
    /// 1 a 16-bit source ID, 2 a 32-bit one.
    pub pulse_attributes: u32,
    /// Size of a pulse record, bytes; at least 48.
    ///
    /// It includes attributes and extra bytes.
    pub pulse_size: u32,
    /// Compression of the pulse records; compressed files have a record of PulseZIP, but often 0 here.
    pub pulse_compression: u32,
    /// Number of variable length records before the pulses.
    pub vlr_count: u32,
    /// Number of appended records after the pulses; -1 if unknown.
    ///
    /// Not relied on: writers leave it at 0 although there is one.
    pub avlr_count: i32,
    /// Seconds per step of T, above 0.
    pub t_scale_s: f64,
    /// Seconds added to the scaled T.
    pub t_offset_s: f64,
    /// Smallest raw T of all pulses.
    pub min_t: i64,
    /// Largest raw T of all pulses.
    pub max_t: i64,
    /// Coordinate steps of x, y, z, above 0, in units of the coordinate system.
    pub scale: [f64; 3],
    /// Coordinate offsets of x, y, z.
    ///
    /// In units of the coordinate system.
    pub offset: [f64; 3],
    /// Smallest x, y, z of the returning waveforms.
    ///
    /// Of their sampled parts, according to the writer.
    pub min: [f64; 3],
    /// Largest x, y, z of the returning waveforms.
    ///
    /// Of their sampled parts, according to the writer.
    pub max: [f64; 3],
}

/// Epoch of [`PulseHeader::gps_time_s`].
///
/// The format has no flag for it (specification 0.3, "T Offset", "GPS timestamp T"); it is inferred
/// from offset and values.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TimeAxis {
    /// Seconds of the GPS week.
    WeekSeconds,
    /// Standard GPS time: seconds since 1980-01-06.
    ///
    /// LAS adjusted standard time is this minus 1e9 s.
    Standard,
    /// Undecided.
    ///
    /// For example, T is below one week with an offset of 1e9 s. The reference library presets that
    /// offset, so week or day seconds of a careless export look like standard times of September
    /// 2011.
    Undecided,
}

impl PulseHeader {
    /// Parses the header of `file`.
    ///
    /// `bytes` are its first [`HEADER_BYTES`], or all of a shorter file.
    pub(super) fn parse(file: &Path, bytes: &[u8]) -> Result<PulseHeader> {
        check_signature(file, bytes)?;
        let mut f = Fields::new(file, 0, bytes);
        f.skip(16, "file signature")?;
        let global_parameters = f.u32("global parameters")?;
        let source_id = f.u32("file source ID")?;
        f.skip(16, "project ID")?;
        let system_identifier = f.text(64, "system identifier")?;
        let generating_software = f.text(64, "generating software")?;
        let creation_day = f.u16("file creation day of year")?;
        let creation_year = f.u16("file creation year")?;
        let version = version(file, &mut f)?;
        let (header_size, offset_to_pulses, pulse_count) = sizes(&mut f)?;
        let (pulse_format, pulse_attributes, pulse_size, pulse_compression) = record_layout(file, &mut f)?;
        f.skip(8, "reserved")?;
        let at = f.clone();
        let vlr_count = f.u32("number of variable length records")?;
        if vlr_count > MOST_RECORDS {
            let problem = format!("{vlr_count} is above {MOST_RECORDS}");
            return Err(at.bad("number of variable length records", problem, EXPORT));
        }
        let avlr_count = f.i32("number of appended variable length records")?;
        let t_scale_s = scale(&mut f, "T scale factor")?;
        let t_offset_s = finite(&mut f, "T offset")?;
        let (min_t, max_t) = (f.i64("min T")?, f.i64("max T")?);
        let scale = three(&mut f, ["x scale factor", "y scale factor", "z scale factor"], scale)?;
        let offset = three(&mut f, ["x offset", "y offset", "z offset"], finite)?;
        let (mut min, mut max) = ([0.0; 3], [0.0; 3]);
        for axis in 0..3 {
            min[axis] = f.f64("min x, y, z")?;
            max[axis] = f.f64("max x, y, z")?;
        }
        Ok(PulseHeader {
            global_parameters,
            source_id,
            system_identifier,
            generating_software,
            creation_day,
            creation_year,
            version,
            header_size,
            offset_to_pulses,
            pulse_count,
            pulse_format,
            pulse_attributes,
            pulse_size,
            pulse_compression,
            vlr_count,
            avlr_count,
            t_scale_s,
            t_offset_s,
            min_t,
            max_t,
            scale,
            offset,
            min,
            max,
        })
    }

    /// Converts a raw `t` to GPS time, s.
    ///
    /// `t * scale + offset`; see [`PulseHeader::time_axis`] for the epoch. With an offset of 1e9 s a
    /// double resolves 0.12 µs: compare and order pulses by raw T.
    pub fn gps_time_s(&self, t: i64) -> f64 {
        t as f64 * self.t_scale_s + self.t_offset_s
    }

    /// Infers the epoch from offset, smallest and largest T.
    ///
    /// Offset 0 and times within one week are week seconds, as the specification advises. Times
    /// above 1e9 s are standard GPS time, unless they are less than a week above the offset 1e9.
    pub fn time_axis(&self) -> TimeAxis {
        let within_week = |s: f64| (0.0..WEEK_S).contains(&s);
        let (first, last) = (self.min_t as f64 * self.t_scale_s, self.max_t as f64 * self.t_scale_s);
        let short = within_week(first) && within_week(last);
        if self.min_t > self.max_t || (self.min_t == 0 && self.max_t == 0) {
            TimeAxis::Undecided
        } else if self.t_offset_s == 0.0 && short {
            TimeAxis::WeekSeconds
        } else if self.gps_time_s(self.min_t) >= 1e9 && !short {
            TimeAxis::Standard
        } else {
            TimeAxis::Undecided
        }
    }

    /// Returns the size of the supported part of a pulse record, bytes: type 0 and its source ID.
    pub(super) fn known_pulse_bytes(&self) -> usize {
        known_pulse_bytes(self.pulse_attributes) as usize
    }

    /// Returns the offset of record `index` from the start of the file, bytes.
    pub(super) fn record_at(&self, index: u64) -> u64 {
        self.offset_to_pulses.saturating_add(index.saturating_mul(u64::from(self.pulse_size)))
    }

    /// Returns whether a 16-bit source ID and a 32-bit one follow each pulse.
    pub(super) fn source_ids(&self) -> (bool, bool) {
        (self.pulse_attributes & SOURCE_ID_16 != 0, self.pulse_attributes & SOURCE_ID_32 != 0)
    }
}

/// Returns the size of record type 0 with its known attributes, bytes.
fn known_pulse_bytes(attributes: u32) -> u32 {
    let short = if attributes & SOURCE_ID_16 != 0 { 2 } else { 0 };
    let long = if attributes & SOURCE_ID_32 != 0 { 4 } else { 0 };
    PULSE_BYTES + short + long
}

/// Rejects empty files, waves files and other formats.
fn check_signature(file: &Path, bytes: &[u8]) -> Result<()> {
    if bytes.is_empty() {
        return Err(Error::unusable(file, "the file is empty", "copy it again from its source"));
    }
    if bytes.starts_with(WAVES_SIGNATURE) {
        let remedy = "give the .pls or .plz file of the same name";
        return Err(Error::unusable(file, "this is the waves file of a PulseWaves pair", remedy));
    }
    let start = &bytes[..bytes.len().min(SIGNATURE.len())];
    if !SIGNATURE.starts_with(start) {
        if let Some(error) = other_format(file, bytes, "read_pulsewaves") {
            return Err(error);
        }
        let start = String::from_utf8_lossy(start).escape_debug().to_string();
        let problem = format!("this is not a PulseWaves pulse file: it starts with \"{start}\"");
        return Err(Error::unusable(file, problem, "give a .pls or .plz file"));
    }
    Ok(())
}

/// Reads the version.
///
/// Only 0.3 and its forward-compatible successors have this layout.
fn version(file: &Path, f: &mut Fields<'_>) -> Result<(u8, u8)> {
    let (major, minor) = (f.u8("version major")?, f.u8("version minor")?);
    if major != 0 || minor < 3 {
        let problem = format!("PulseWaves version {major}.{minor} is not supported, only 0.3");
        return Err(Error::unusable(file, problem, "write the file again with PulseTools of version 0.3"));
    }
    Ok((major, minor))
}

/// Reads header size, offset to the pulses and number of pulses.
fn sizes(f: &mut Fields<'_>) -> Result<(u16, u64, u64)> {
    let at = f.clone();
    let header_size = f.u16("header size")?;
    if usize::from(header_size) < HEADER_BYTES {
        return Err(at.bad("header size", format!("{header_size} is below {HEADER_BYTES}"), EXPORT));
    }
    let at = f.clone();
    let offset = f.i64("offset to pulse data")?;
    let offset = u64::try_from(offset).ok().filter(|&o| o >= u64::from(header_size)).ok_or_else(|| {
        at.bad(
            "offset to pulse data",
            format!("{offset} lies within the header of {header_size} bytes"),
            EXPORT,
        )
    })?;
    let at = f.clone();
    let count = f.i64("number of pulses")?;
    let count = u64::try_from(count)
        .map_err(|_| at.bad("number of pulses", format!("{count} is negative"), EXPORT))?;
    Ok((header_size, offset, count))
}

/// Reads format, attributes, size and compression of the pulse records.
fn record_layout(file: &Path, f: &mut Fields<'_>) -> Result<(u32, u32, u32, u32)> {
    let format = f.u32("pulse format")?;
    if format != 0 {
        let problem = format!("pulse format {format} is not defined in PulseWaves 0.3, only 0 is");
        return Err(Error::unusable(file, problem, "write the file again with PulseTools of version 0.3"));
    }
    let attributes = f.u32("pulse attributes")?;
    let at = f.clone();
    let size = f.u32("pulse size")?;
    let known = known_pulse_bytes(attributes);
    if size < known {
        return Err(at.bad("pulse size", format!("{size} is below the {known} bytes of a pulse"), EXPORT));
    }
    if size > MOST_PULSE_BYTES {
        return Err(at.bad("pulse size", format!("{size} exceeds the limit of {MOST_PULSE_BYTES}"), EXPORT));
    }
    Ok((format, attributes, size, f.u32("pulse compression")?))
}

/// Reads a finite number.
fn finite(f: &mut Fields<'_>, field: &str) -> Result<f64> {
    let at = f.clone();
    let value = f.f64(field)?;
    if value.is_finite() { Ok(value) } else { Err(at.bad(field, format!("{value} is not a number"), EXPORT)) }
}

/// Reads a finite number above zero.
fn scale(f: &mut Fields<'_>, field: &str) -> Result<f64> {
    let at = f.clone();
    let value = finite(f, field)?;
    if value > 0.0 { Ok(value) } else { Err(at.bad(field, format!("{value} is not above zero"), EXPORT)) }
}

/// Reads three numbers, each with its name.
fn three<'a>(
    f: &mut Fields<'a>,
    names: [&str; 3],
    one: impl Fn(&mut Fields<'a>, &str) -> Result<f64>,
) -> Result<[f64; 3]> {
    Ok([one(f, names[0])?, one(f, names[1])?, one(f, names[2])?])
}

/// Checks the 60-byte header of the waves file (specification 0.3, "The Waves Header").
///
/// It holds the signature, the compression scheme, and zeros. Returns whether the waves are compressed.
pub(super) fn check_waves_header(file: &Path, bytes: &[u8]) -> Result<bool> {
    if bytes.is_empty() {
        return Err(Error::unusable(file, "the file is empty", "copy it again from its source"));
    }
    let mut f = Fields::new(file, 0, bytes);
    if !f.take(16, "file signature")?.starts_with(WAVES_SIGNATURE) {
        let problem = "this is not a PulseWaves waves file: its signature differs";
        return Err(Error::unusable(
            file,
            problem,
            "put the .wvs or .wvz file of the same export next to the pulses",
        ));
    }
    let at = f.clone();
    let compression = f.u32("compression")?;
    if compression > WAVES_COMPRESSED {
        return Err(at.bad("compression", format!("scheme {compression} is unknown, only 0 and 1"), EXPORT));
    }
    f.skip(40, "reserved")?;
    Ok(compression == WAVES_COMPRESSED)
}
