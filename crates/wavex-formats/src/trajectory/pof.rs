//! POF, RIEGL's position and orientation file, versions 1.0 and 1.1.
//!
//! Written as 1.1. The layout is taken from public readers; it is not verified with an original
//! RIEGL file. All fields are little-endian and packed: a header of 315 bytes, then records
//! of 64 bytes. Records of version 1.0 lack the distance.

use super::super::bytes::Fields;
use super::axis::Stated;
use super::input::InputFile;
use super::{Raw, Records, Result, check, sample_of_degrees};
use wavex_geodesy::frames::Attitude;
use wavex_geodesy::time_axis::Clock;

/// First bytes of a POF file.
pub(super) const MAGIC: &[u8; 27] = b"RIEGL POSITION&ORIENTATION\0";

/// Size of the header that [`PofHeader::encode`] writes.
///
/// The records follow it.
pub(super) const HEADER_BYTES: usize = 315;

/// Size of a record of version 1.1, bytes.
pub(super) const RECORD_BYTES: usize = 64;

/// POF header.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PofHeader {
    /// Year, month and day of the recording.
    pub date: [u16; 3],
    /// Number of records.
    pub records: i64,
    /// Smallest and largest longitude, degrees.
    pub longitude_deg: [f64; 2],
    /// Smallest and largest latitude, degrees.
    pub latitude_deg: [f64; 2],
    /// Smallest and largest height above the ellipsoid, m.
    pub altitude_m: [f64; 2],
    /// Mean, maximum and standard deviation of the time between records, s.
    pub time_step_s: [f64; 3],
    /// Clock: 1 seconds of the day, 2 seconds of the week.
    pub time_unit: u8,
    /// Time system: 0 GPS, 1 UTC, 2 unknown.
    pub time_info: u8,
}

/// POF record.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PofRecord {
    /// Time in the header's `time_unit`, s.
    pub time_s: f64,
    /// Longitude, degrees, positive to the east.
    pub longitude_deg: f64,
    /// Latitude, degrees, positive to the north.
    pub latitude_deg: f64,
    /// Height above the ellipsoid, m.
    pub altitude_m: f64,
    /// Roll, degrees; positive with the right wing down.
    pub roll_deg: f64,
    /// Pitch, degrees; positive with the nose up.
    pub pitch_deg: f64,
    /// Heading clockwise from north, degrees.
    pub yaw_deg: f64,
    /// Path length from the first record, m.
    pub distance_m: f64,
}

impl PofHeader {
    /// Encodes the header.
    ///
    /// Texts (zone, location, device, project, company) are empty.
    pub fn encode(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(HEADER_BYTES);
        bytes.extend(MAGIC);
        bytes.extend([1u16, 1].map(u16::to_le_bytes).as_flattened());
        bytes.extend((HEADER_BYTES as u32).to_le_bytes());
        bytes.extend(self.date.map(u16::to_le_bytes).as_flattened());
        bytes.extend(self.records.to_le_bytes());
        let ranges = [self.longitude_deg, self.latitude_deg, self.altitude_m];
        for number in ranges.as_flattened().iter().chain(&self.time_step_s) {
            bytes.extend(number.to_le_bytes());
        }
        bytes.extend([self.time_unit, self.time_info]);
        bytes.resize(HEADER_BYTES, 0);
        bytes
    }
}

impl PofRecord {
    /// Encodes the record.
    pub fn encode(&self) -> [u8; RECORD_BYTES] {
        let fields = [
            self.time_s,
            self.longitude_deg,
            self.latitude_deg,
            self.altitude_m,
            self.roll_deg,
            self.pitch_deg,
            self.yaw_deg,
            self.distance_m,
        ];
        let mut bytes = [0; RECORD_BYTES];
        for (place, field) in bytes.chunks_exact_mut(8).zip(fields) {
            place.copy_from_slice(&field.to_le_bytes());
        }
        bytes
    }
}

/// Size of the header before its texts, bytes.
///
/// Records cannot begin earlier.
const NEEDED_BYTES: u32 = 123;
/// Size of a record of version 1.0, bytes.
const RECORD_BYTES_1_0: usize = 56;

/// Decodes header, version and offset of the records.
fn decode_header(mut fields: Fields) -> Result<(PofHeader, [u16; 2], u32)> {
    fields.skip(MAGIC.len(), "magic")?;
    let version = [fields.u16("major version")?, fields.u16("minor version")?];
    if version[0] != 1 {
        let problem = format!("version {}.{} is not supported", version[0], version[1]);
        return Err(fields.bad("version", problem, "export the trajectory as POF 1.1 or as SBET"));
    }
    let begin = fields.clone();
    let data_offset = fields.u32("data offset")?;
    if data_offset < NEEDED_BYTES {
        let problem = format!("records at byte {data_offset} would lie in the header");
        return Err(begin.bad("data offset", problem, "the file is damaged: export it again"));
    }
    let mut header = PofHeader {
        date: [fields.u16("year")?, fields.u16("month")?, fields.u16("day")?],
        records: fields.i64("records")?,
        ..PofHeader::default()
    };
    let mut pair = |field: &str| Ok([fields.f64(field)?, fields.f64(field)?]);
    header.longitude_deg = pair("longitude range")?;
    header.latitude_deg = pair("latitude range")?;
    header.altitude_m = pair("altitude range")?;
    for statistic in &mut header.time_step_s {
        *statistic = fields.f64("time step")?;
    }
    header.time_unit = fields.u8("time unit")?;
    header.time_info = fields.u8("time info")?;
    Ok((header, version, data_offset))
}

/// Reads header and records.
pub(super) fn read(input: &mut InputFile) -> Result<Raw> {
    let path = input.path.clone();
    let header = input.header(HEADER_BYTES)?;
    let (header, version, data_offset) = decode_header(Fields::new(&path, 0, &header))?;
    let mut notes = Vec::new();
    let stated = stated(&header, &mut notes);
    let size = if version[1] == 0 { RECORD_BYTES_1_0 } else { RECORD_BYTES };
    input.go_to(data_offset.into())?;
    let count = counted(&header, input, size, &mut notes);
    let mut samples = Vec::new();
    input.each(size, count, |number, mut fields| {
        let offset = fields.offset();
        let time_s = fields.f64("time")?;
        let place = [fields.f64("longitude")?, fields.f64("latitude")?, fields.f64("altitude")?];
        let mut angle = |field: &str| Ok(fields.f64(field)?.to_radians());
        let attitude =
            Attitude { roll_rad: angle("roll")?, pitch_rad: angle("pitch")?, heading_rad: angle("yaw")? };
        let sample = sample_of_degrees(time_s, place, attitude);
        check(&path, offset, number, &sample)?;
        samples.push(sample);
        Ok(())
    })?;
    let format = format!("POF {}.{}", version[0], version[1]);
    Ok(Raw { format, stated, records: Records::Geodetic(samples), speeds_mps: Vec::new(), notes })
}

/// Returns the header's declarations about times.
fn stated(header: &PofHeader, notes: &mut Vec<String>) -> Stated {
    let clock = match header.time_unit {
        1 => Some(Clock::Day),
        2 => Some(Clock::Week),
        _ => None,
    };
    if header.time_info > 1 {
        notes.push("the header does not say whether times are GPS or UTC: assuming GPS".to_owned());
    }
    Stated { clock, is_utc: header.time_info == 1, date: Some(header.date) }
}

/// Returns the number of records to read.
///
/// The header's count, or all if it gives none.
fn counted(header: &PofHeader, input: &InputFile, size: usize, notes: &mut Vec<String>) -> Option<u64> {
    let bytes = input.length.saturating_sub(input.offset);
    match u64::try_from(header.records) {
        Ok(count) if count > 0 => {
            let more = (bytes / size as u64).saturating_sub(count);
            if more > 0 {
                notes.push(format!("records beyond the header's count of {count} are not read: {more}"));
            }
            Some(count)
        }
        _ => {
            notes.push(format!(
                "the header declares {} records: reading all to the end of the file",
                header.records
            ));
            None
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_header_spelled_out() {
        let header = PofHeader {
            date: [2025, 5, 6],
            records: 258,
            longitude_deg: [-1.0, 1.0],
            latitude_deg: [2.0, 4.0],
            altitude_m: [8.0, 16.0],
            time_step_s: [32.0, 64.0, 128.0],
            time_unit: 2,
            time_info: 0,
        };
        let bytes = header.encode();
        assert_eq!(bytes.len(), HEADER_BYTES);
        assert_eq!(bytes[..27], *b"RIEGL POSITION&ORIENTATION\0");
        assert_eq!(bytes[27..31], [1, 0, 1, 0], "version 1.1");
        assert_eq!(bytes[31..35], [59, 1, 0, 0], "315: where the records begin");
        assert_eq!(bytes[35..41], [0xe9, 0x07, 5, 0, 6, 0]);
        assert_eq!(bytes[41..49], [2, 1, 0, 0, 0, 0, 0, 0]);
        let upper: Vec<[u8; 2]> = bytes[49..121].chunks(8).map(|field| [field[6], field[7]]).collect();
        let powers = [[0xf0, 0xbf], [0xf0, 0x3f], [0, 0x40], [0x10, 0x40], [0x20, 0x40], [0x30, 0x40]];
        assert_eq!(upper[..6], powers);
        assert_eq!(upper[6..], [[0x40, 0x40], [0x50, 0x40], [0x60, 0x40]]);
        assert_eq!(bytes[121..123], [2, 0]);
        // Zone, location, device, reserved, project, company, reserved.
        assert_eq!(HEADER_BYTES - 123, 16 + 16 + 32 + 32 + 32 + 32 + 32);
        assert!(bytes[123..].iter().all(|&byte| byte == 0));
    }

    #[test]
    fn a_record_spelled_out() {
        let record = PofRecord {
            time_s: 1.0,
            longitude_deg: 2.0,
            latitude_deg: 4.0,
            altitude_m: 8.0,
            roll_deg: 16.0,
            pitch_deg: 32.0,
            yaw_deg: 64.0,
            distance_m: 128.0,
        };
        let bytes = record.encode();
        let upper: Vec<[u8; 2]> = bytes.chunks(8).map(|field| [field[6], field[7]]).collect();
        let powers = [[0xf0, 0x3f], [0, 0x40], [0x10, 0x40], [0x20, 0x40]];
        assert_eq!(upper[..4], powers);
        assert_eq!(upper[4..], [[0x30, 0x40], [0x40, 0x40], [0x50, 0x40], [0x60, 0x40]]);
        assert!(bytes.chunks(8).all(|field| field[..6] == [0; 6]));
    }
}
