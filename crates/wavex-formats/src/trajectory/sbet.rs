//! SBET, smoothed best estimate of trajectory.
//!
//! Records of 17 little-endian doubles, no header. Source: Applanix, "POSPac MMS User Guide",
//! appendix on output file formats.

use super::axis::Stated;
use super::input::InputFile;
use super::{HIGHEST_M, Raw, Records, Result, check, wrapped_rad};
use wavex_geodesy::ellipsoid::Geodetic;
use wavex_geodesy::frames::Attitude;
use wavex_geodesy::trajectory::Sample;

/// Size of a record, bytes.
pub const RECORD_BYTES: usize = 136;

/// SBET record, in the order of its fields.
///
/// The wander frame is level; its x axis has the azimuth `-wander_angle_rad`. The heading from
/// north is `platform_heading_rad - wander_angle_rad`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SbetRecord {
    /// GPS time, s of the week.
    pub time_s: f64,
    /// Geodetic latitude, rad.
    pub latitude_rad: f64,
    /// Longitude, rad, positive to the east.
    pub longitude_rad: f64,
    /// Height above the ellipsoid, m.
    pub height_m: f64,
    /// Velocity along the axes of the wander frame (x, y, down), m/s.
    pub velocity_mps: [f64; 3],
    /// Roll, rad; positive with the right wing down.
    pub roll_rad: f64,
    /// Pitch, rad; positive with the nose up.
    pub pitch_rad: f64,
    /// Heading clockwise from the x axis of the wander frame, rad.
    pub platform_heading_rad: f64,
    /// Angle from north to the wander frame, rad.
    pub wander_angle_rad: f64,
    /// Acceleration along the body axes, m/s^2.
    pub acceleration_mps2: [f64; 3],
    /// Angular rate about the body axes, rad/s.
    pub angular_rate_rad_per_s: [f64; 3],
}

impl SbetRecord {
    /// Encodes the record.
    pub fn encode(&self) -> [u8; RECORD_BYTES] {
        let [vx, vy, vz] = self.velocity_mps;
        let [ax, ay, az] = self.acceleration_mps2;
        let [wx, wy, wz] = self.angular_rate_rad_per_s;
        let fields = [
            self.time_s,
            self.latitude_rad,
            self.longitude_rad,
            self.height_m,
            vx,
            vy,
            vz,
            self.roll_rad,
            self.pitch_rad,
            self.platform_heading_rad,
            self.wander_angle_rad,
            ax,
            ay,
            az,
            wx,
            wy,
            wz,
        ];
        let mut bytes = [0; RECORD_BYTES];
        for (place, field) in bytes.chunks_exact_mut(8).zip(fields) {
            place.copy_from_slice(&field.to_le_bytes());
        }
        bytes
    }

    /// Converts to a sample with the heading from north.
    fn sample(&self) -> Sample {
        Sample {
            time_s: self.time_s,
            place: Geodetic {
                latitude_rad: self.latitude_rad,
                longitude_rad: wrapped_rad(self.longitude_rad),
                height_m: self.height_m,
            },
            attitude: Attitude {
                roll_rad: self.roll_rad,
                pitch_rad: self.pitch_rad,
                heading_rad: wrapped_rad(self.platform_heading_rad - self.wander_angle_rad),
            },
        }
    }

    /// Decodes a record.
    pub fn decode(bytes: &[u8; RECORD_BYTES]) -> SbetRecord {
        let mut fields = [0.0; 17];
        for (field, place) in fields.iter_mut().zip(bytes.chunks_exact(8)) {
            let mut eight = [0; 8];
            eight.copy_from_slice(place);
            *field = f64::from_le_bytes(eight);
        }
        let [time_s, latitude_rad, longitude_rad, height_m, vx, vy, vz, roll_rad, pitch_rad, rest @ ..] =
            fields;
        let [platform_heading_rad, wander_angle_rad, ax, ay, az, wx, wy, wz] = rest;
        SbetRecord {
            time_s,
            latitude_rad,
            longitude_rad,
            height_m,
            velocity_mps: [vx, vy, vz],
            roll_rad,
            pitch_rad,
            platform_heading_rad,
            wander_angle_rad,
            acceleration_mps2: [ax, ay, az],
            angular_rate_rad_per_s: [wx, wy, wz],
        }
    }
}

/// Returns whether a file begins with a plausible SBET record.
pub(super) fn is_one(head: &[u8]) -> bool {
    use core::f64::consts::{FRAC_PI_2, TAU};
    let Some(record) = head.first_chunk().map(SbetRecord::decode) else { return false };
    // Text and random bytes decode to numbers close to zero.
    let is_within = |value: f64, most: f64| value == 0.0 || (1e-30..=most).contains(&value.abs());
    let angles = [record.longitude_rad, record.roll_rad, record.pitch_rad];
    let headings = [record.platform_heading_rad, record.wander_angle_rad];
    let rest = [record.velocity_mps, record.acceleration_mps2, record.angular_rate_rad_per_s];
    let is_somewhere = record.time_s != 0.0 || record.latitude_rad != 0.0 || record.longitude_rad != 0.0;
    is_somewhere
        && is_within(record.time_s, 1e10)
        && is_within(record.latitude_rad, FRAC_PI_2)
        && is_within(record.height_m, HIGHEST_M)
        && angles.into_iter().all(|angle| is_within(angle, TAU))
        && headings.into_iter().all(|angle| is_within(angle, 4.0 * TAU))
        && rest.as_flattened().iter().all(|value| value.is_finite())
}

/// Reads all records.
pub(super) fn read(input: &mut InputFile) -> Result<Raw> {
    let path = input.path.clone();
    let (mut samples, mut speeds_mps) = (Vec::new(), Vec::new());
    input.each(RECORD_BYTES, None, |number, mut fields| {
        let offset = fields.offset();
        let record = SbetRecord::decode(&fields.array("record")?);
        let [vx, vy, _] = record.velocity_mps;
        speeds_mps.push((vx * vx + vy * vy).sqrt());
        let sample = record.sample();
        check(&path, offset, number, &sample)?;
        samples.push(sample);
        Ok(())
    })?;
    Ok(Raw {
        format: "SBET".to_owned(),
        stated: Stated::default(),
        records: Records::Geodetic(samples),
        speeds_mps,
        notes: Vec::new(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Builds a record whose field `k` holds the number `k`.
    fn counted() -> SbetRecord {
        SbetRecord {
            time_s: 0.0,
            latitude_rad: 1.0,
            longitude_rad: 2.0,
            height_m: 3.0,
            velocity_mps: [4.0, 5.0, 6.0],
            roll_rad: 7.0,
            pitch_rad: 8.0,
            platform_heading_rad: 9.0,
            wander_angle_rad: 10.0,
            acceleration_mps2: [11.0, 12.0, 13.0],
            angular_rate_rad_per_s: [14.0, 15.0, 16.0],
        }
    }

    #[test]
    fn a_record_spelled_out() {
        let bytes = counted().encode();
        assert_eq!(bytes.len(), 136);
        // 1, 2, 3, 7, 10 and 16 as little-endian doubles: sign and exponent are in the last two
        // bytes.
        let upper = |field: usize| [bytes[8 * field + 6], bytes[8 * field + 7]];
        assert_eq!([1, 2, 3, 7].map(upper), [[0xf0, 0x3f], [0, 0x40], [8, 0x40], [0x1c, 0x40]]);
        assert_eq!([10, 16].map(upper), [[0x24, 0x40], [0x30, 0x40]]);
        assert_eq!(bytes[..8], [0; 8]);
        assert!(bytes.chunks(8).all(|field| field[..6] == [0; 6]));
    }

    #[test]
    fn a_record_comes_back() {
        assert_eq!(SbetRecord::decode(&counted().encode()), counted());
        let odd = SbetRecord { latitude_rad: 0.1 + 0.2, time_s: -1e-300, ..counted() };
        assert_eq!(SbetRecord::decode(&odd.encode()), odd);
    }
}
