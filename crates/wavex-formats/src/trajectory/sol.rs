//! SOL, the solution of Leica IPAS.
//!
//! Packed little-endian records of 184 bytes, no header. The layout is taken from one public
//! reader; it is not verified with an original file.

use super::super::Error;
use super::axis::Stated;
use super::input::InputFile;
use super::{HIGHEST_M, Raw, Records, Result, check, wrapped_rad};
use crate::bytes::Fields;
use wavex_geodesy::ellipsoid::Geodetic;
use wavex_geodesy::frames::Attitude;
use wavex_geodesy::time::{ADJUSTMENT_S, WEEK_S};
use wavex_geodesy::time_axis::Clock;
use wavex_geodesy::trajectory::Sample;

/// Size of a record, bytes.
pub(super) const RECORD_BYTES: usize = 184;
/// Offset of the check byte.
///
/// It is the XOR of the bytes before it.
const CHECK_BYTE: usize = 34;

/// Returns whether a file may be SOL.
///
/// It needs a valid check byte and a plausible first record.
pub(super) fn is_one(head: &[u8]) -> bool {
    use core::f64::consts::{FRAC_PI_2, TAU};
    let Some(record) = head.get(..RECORD_BYTES) else { return false };
    let Ok((week, sample)) = decode(Fields::new(std::path::Path::new(""), 0, record)) else { return false };
    let angles = [sample.place.longitude_rad, sample.attitude.roll_rad, sample.attitude.heading_rad];
    holds(record)
        && (1..10_000).contains(&week)
        && sample.place.latitude_rad.abs() <= FRAC_PI_2
        && sample.place.height_m.abs() <= HIGHEST_M
        && sample.attitude.pitch_rad.abs() <= FRAC_PI_2
        && angles.into_iter().all(|angle| angle.abs() <= TAU)
}

fn holds(record: &[u8]) -> bool {
    let (before, from) = record.split_at(CHECK_BYTE.min(record.len()));
    from.first() == Some(&before.iter().fold(0, |check, byte| check ^ byte))
}

/// Decodes GPS week and sample.
///
/// The time is in adjusted seconds.
fn decode(mut fields: Fields) -> Result<(u16, Sample)> {
    fields.skip(16, "header of the record")?;
    let week = fields.u16("GPS week")?;
    let time_s = fields.f64("time")?;
    fields.skip(16, "bytes 26 to 41")?;
    let [latitude_rad, longitude_rad] = [fields.f64("latitude")?, fields.f64("longitude")?];
    let height_m = fields.f64("height")?;
    fields.skip(12, "bytes 66 to 77")?;
    let [roll_rad, pitch_rad, heading_rad] =
        [fields.f64("roll")?, fields.f64("pitch")?, fields.f64("true heading")?];
    let sample = Sample {
        time_s: time_s + (f64::from(week) * WEEK_S - ADJUSTMENT_S),
        place: Geodetic { latitude_rad, longitude_rad: wrapped_rad(longitude_rad), height_m },
        attitude: Attitude { roll_rad, pitch_rad, heading_rad },
    };
    Ok((week, sample))
}

/// Reads all records.
pub(super) fn read(input: &mut InputFile) -> Result<Raw> {
    let path = input.path.clone();
    let mut samples = Vec::new();
    input.each(RECORD_BYTES, None, |number, fields| {
        let offset = fields.offset();
        if !holds(fields.clone().take(RECORD_BYTES, "record")?) {
            let (field, problem) =
                (format!("check byte of record {number}"), "it is not the XOR of the bytes before it");
            let remedy = "the file is damaged: copy it again from its source";
            return Err(Error::malformed(&path, offset + CHECK_BYTE as u64, field, problem, remedy));
        }
        let (_, sample) = decode(fields)?;
        check(&path, offset, number, &sample)?;
        samples.push(sample);
        Ok(())
    })?;
    Ok(Raw {
        format: "SOL".to_owned(),
        stated: Stated { clock: Some(Clock::Adjusted), ..Stated::default() },
        records: Records::Geodetic(samples),
        speeds_mps: Vec::new(),
        notes: Vec::new(),
    })
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// Builds a record of this week and time.
    pub(in super::super) fn made(week: u16, time_s: f64, sample: &Sample) -> Vec<u8> {
        let mut bytes = vec![0xa5; RECORD_BYTES];
        bytes[16..18].copy_from_slice(&week.to_le_bytes());
        let (place, attitude) = (sample.place, sample.attitude);
        let fields = [
            (18, time_s),
            (42, place.latitude_rad),
            (50, place.longitude_rad),
            (58, place.height_m),
            (78, attitude.roll_rad),
            (86, attitude.pitch_rad),
            (94, attitude.heading_rad),
        ];
        for (at, value) in fields {
            bytes[at..at + 8].copy_from_slice(&value.to_le_bytes());
        }
        bytes[34] = bytes[..34].iter().fold(0, |check, byte| check ^ byte);
        bytes
    }

    #[test]
    fn a_record_spelled_out() {
        let mut bytes = vec![0; RECORD_BYTES];
        bytes[16..18].copy_from_slice(&[0x3d, 0x09]);
        // 1, 2, -2, 4, 0.5, 0.25 and 8 as little-endian doubles: sign and exponent are in the last
        // two bytes.
        for (at, upper) in [
            (18, [0xf0, 0x3f]),
            (42, [0xf0, 0x3f]),
            (50, [0x00, 0xc0]),
            (58, [0x10, 0x40]),
            (78, [0xe0, 0x3f]),
            (86, [0xd0, 0x3f]),
            (94, [0x08, 0x40]),
        ] {
            bytes[at + 6..at + 8].copy_from_slice(&upper);
        }
        assert!(!is_one(&bytes));
        bytes[34] = 0x3d ^ 0x09 ^ 0xf0 ^ 0x3f;
        assert!(is_one(&bytes));
        let (week, sample) = decode(Fields::new(std::path::Path::new("f"), 0, &bytes)).unwrap();
        assert_eq!((week, sample.time_s), (2365, 2365.0 * 604_800.0 - 1e9 + 1.0));
        let place = Geodetic { latitude_rad: 1.0, longitude_rad: -2.0, height_m: 4.0 };
        assert_eq!(sample.place, place);
        assert_eq!(sample.attitude, Attitude { roll_rad: 0.5, pitch_rad: 0.25, heading_rad: 3.0 });
        let made = made(2365, 1.0, &sample);
        assert_eq!(decode(Fields::new(std::path::Path::new("f"), 0, &made)).unwrap(), (week, sample));
    }
}
