//! TRJ, TerraScan's trajectory.
//!
//! Little-endian header of 1376 bytes, then 64-byte records. Source: Terrasolid, "TerraScan User's
//! Guide", section on trajectory file formats. Positions are projected, but the file does not name
//! the projection. Headings are assumed to be relative to grid north; the guide does not say so.

use super::super::Error;
use super::super::bytes::Fields;
use super::axis::Stated;
use super::input::{InputFile, LONGEST_RECORD};
use super::{LARGEST_ANGLE_RAD, MapSample, Raw, Records, Result};
use wavex_geodesy::frames::Attitude;

/// First bytes of a TRJ file.
pub(super) const MAGIC: &[u8; 8] = b"TSCANTRJ";
/// The only known version.
const VERSION: i32 = 20_010_715;
/// Size of the header fields that are read, bytes.
const NEEDED_BYTES: i32 = 24;
/// Size of the record fields that are read, bytes.
const LEAST_RECORD: i32 = 56;

/// Reads header and records.
pub(super) fn read(input: &mut InputFile) -> Result<Raw> {
    let path = input.path.clone();
    let header = input.header(NEEDED_BYTES as usize)?;
    let mut fields = Fields::new(&path, 0, &header);
    fields.skip(MAGIC.len(), "magic")?;
    let damaged = "the file is damaged: export it again";
    let mut within = |field: &str, least: i32, most: i32| {
        let at = fields.clone();
        let value = fields.i32(field)?;
        if !(least..=most).contains(&value) {
            return Err(at.bad(field, format!("{value} is not between {least} and {most}"), damaged));
        }
        Ok(value)
    };
    within("version", VERSION, VERSION)?;
    let header_bytes = within("header size", NEEDED_BYTES, i32::MAX)?;
    let count = within("records", 0, i32::MAX)?;
    let size = within("record size", LEAST_RECORD, LONGEST_RECORD as i32)?;
    input.go_to(header_bytes as u64)?;
    let mut samples = Vec::new();
    input.each(size as usize, Some(count as u64), |number, mut fields| {
        let offset = fields.offset();
        let sample = decode(&mut fields)?;
        check(&path, offset, number, &sample)?;
        samples.push(sample);
        Ok(())
    })?;
    Ok(Raw {
        format: "TRJ".to_owned(),
        stated: Stated::default(),
        records: Records::Projected(samples),
        speeds_mps: Vec::new(),
        notes: Vec::new(),
    })
}

fn decode(fields: &mut Fields) -> Result<MapSample> {
    let time_s = fields.f64("time")?;
    let place = [fields.f64("x")?, fields.f64("y")?, fields.f64("z")?];
    let mut angle = |field: &str| Ok(fields.f64(field)?.to_radians());
    let [heading_rad, roll_rad, pitch_rad] = [angle("heading")?, angle("roll")?, angle("pitch")?];
    Ok(MapSample { time_s, place, attitude: Attitude { roll_rad, pitch_rad, heading_rad } })
}

/// Rejects invalid samples.
///
/// The error gives the offset of the record.
fn check(path: &std::path::Path, offset: u64, record: u64, sample: &MapSample) -> Result<()> {
    let MapSample { time_s, place: [x, y, z], attitude } = *sample;
    let fields = [
        ("time", time_s, f64::MAX),
        ("x", x, 1e9),
        ("y", y, 1e9),
        ("z", z, 1e9),
        ("heading", attitude.heading_rad, LARGEST_ANGLE_RAD),
        ("roll", attitude.roll_rad, LARGEST_ANGLE_RAD),
        ("pitch", attitude.pitch_rad, LARGEST_ANGLE_RAD),
    ];
    match fields.into_iter().find(|(_, value, most)| !matches!(value.abs(), size if size <= *most)) {
        Some((field, value, _)) => {
            let (field, problem) = (format!("{field} of record {record}"), format!("invalid value {value}"));
            Err(Error::malformed(path, offset, field, problem, "the file is damaged: export it again"))
        }
        None => Ok(()),
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// Builds a TRJ file of these samples.
    pub(in super::super) fn made(samples: &[MapSample]) -> Vec<u8> {
        let mut bytes = MAGIC.to_vec();
        for field in [VERSION, 1376, samples.len() as i32, 64] {
            bytes.extend(field.to_le_bytes());
        }
        bytes.resize(1376, 0);
        for MapSample { time_s, place: [x, y, z], attitude } in samples {
            let angles = [attitude.heading_rad, attitude.roll_rad, attitude.pitch_rad].map(f64::to_degrees);
            let [heading, roll, pitch] = angles;
            for field in [*time_s, *x, *y, *z, heading, roll, pitch] {
                bytes.extend(field.to_le_bytes());
            }
            bytes.extend([1, 2, 3, 4, 5, 0, 6, 0]);
        }
        bytes
    }

    #[test]
    fn a_record_spelled_out() {
        let mut bytes = Vec::new();
        for upper in
            [[0xf0, 0x3f], [0, 0x40], [8, 0x40], [0x10, 0x40], [0x56, 0x40], [0xe0, 0x3f], [0xd0, 0xbf]]
        {
            bytes.extend([0, 0, 0, 0, 0, 0]);
            bytes.extend(upper);
        }
        bytes[37] = 0x80; // 0x4056.. is 88, and this bit adds 2
        let sample = decode(&mut Fields::new(std::path::Path::new("f"), 0, &bytes)).unwrap();
        assert_eq!((sample.time_s, sample.place), (1.0, [2.0, 3.0, 4.0]));
        let Attitude { roll_rad, pitch_rad, heading_rad } = sample.attitude;
        assert_eq!([heading_rad, roll_rad, pitch_rad].map(f64::to_degrees), [90.0, 0.5, -0.25]);
    }
}
