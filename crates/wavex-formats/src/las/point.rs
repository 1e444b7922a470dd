//! Point data records.
//!
//! LAS 1.4 R15, sections "Point Data Record Format 0" to "Point Data Record Format 10".

/// Degrees per step of the scan angle in formats 6 to 10.
pub(super) const SCAN_ANGLE_STEP_DEG: f64 = 0.006;

/// Point as read, also in physical units.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Point {
    /// Stored coordinates.
    pub raw: [i32; 3],
    /// Coordinate in the file's coordinate system, `raw * scale + offset`.
    pub x: f64,
    /// Coordinate in the file's coordinate system.
    pub y: f64,
    /// Coordinate in the file's coordinate system.
    pub z: f64,
    /// Intensity of the return; the scale depends on the file.
    pub intensity: u16,
    /// Return number, from 1.
    ///
    /// At most 7 in formats 0 to 5, 15 in the others.
    pub return_number: u8,
    /// Number of returns of the shot.
    pub number_of_returns: u8,
    /// Whether the mirror moved from left to right.
    pub scan_direction: bool,
    /// Whether the point is the last before the scan turns.
    pub edge_of_flight_line: bool,
    /// ASPRS class; at most 31 in formats 0 to 5.
    pub classification: u8,
    /// Whether the point was created by other means than lidar.
    pub synthetic: bool,
    /// Whether the point is a model key point.
    pub key_point: bool,
    /// Whether the point should be treated as deleted.
    pub withheld: bool,
    /// Whether the point lies in the overlap of flight lines.
    ///
    /// Formats 6 to 10 only.
    pub overlap: bool,
    /// Scanner channel, 0 to 3; formats 6 to 10 only.
    pub scanner_channel: u8,
    /// Scan angle, degrees, positive to the right.
    ///
    /// Whole degrees in formats 0 to 5, steps of 0.006 degrees in the others.
    pub scan_angle_deg: f32,
    /// User data.
    pub user_data: u8,
    /// Point source ID.
    ///
    /// The file or flight line of the point.
    pub point_source_id: u16,
    /// Time in the system of [`LasHeader::gps_time`](super::LasHeader::gps_time), s.
    ///
    /// 0 in formats without time.
    pub gps_time: f64,
    /// Waveform that contains the return.
    pub wave: Wave,
}

/// Location of a point's waveform in file and space.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Wave {
    /// Index of the waveform descriptor, 1 to 255.
    ///
    /// 0 without waveform.
    pub descriptor: u8,
    /// Offset of the packet in the waveform packet record, bytes.
    ///
    /// It counts from the record header.
    pub offset: u64,
    /// Length of the packet, bytes.
    pub size: u32,
    /// Time from the first sample to the return, ps.
    pub location_ps: f32,
    /// Change of position per picosecond backwards in time.
    ///
    /// In units of the coordinate system. Points from the target to the sensor (see
    /// [`Wave::sample_position`]).
    pub direction_per_ps: [f32; 3],
}

impl Wave {
    /// Returns the position of a sample.
    ///
    /// `P + (location - sample * spacing) * direction`. `point` is the position `P` of the point;
    /// `sample` counts from 0 and may be fractional. The specification's anchor is the first
    /// sample, `P + location * direction`. Its further formula, which adds time times direction to
    /// the anchor, would not lead back to the point. Files of RIEGL and Leica instruments follow
    /// the sign used here.
    pub fn sample_position(&self, point: [f64; 3], sample: f64, spacing_ps: f64) -> [f64; 3] {
        let time_ps = f64::from(self.location_ps) - sample * spacing_ps;
        std::array::from_fn(|axis| point[axis] + time_ps * f64::from(self.direction_per_ps[axis]))
    }
}

/// Field layout of a point format.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct PointLayout {
    /// Length of the format's fields, bytes; extra bytes follow.
    pub(super) length: usize,
    /// Whether the format is 0 to 5.
    legacy: bool,
    /// Offset of the time, if any.
    pub(super) gps_time: Option<usize>,
    /// Offset of the 29 waveform bytes, if any.
    ///
    /// Formats 4, 5, 9 and 10 have them.
    pub(super) wave: Option<usize>,
}

impl PointLayout {
    /// Returns the layout of `format`, at most 10.
    pub(super) fn of(format: u8) -> PointLayout {
        let (length, wave) = match format {
            0 => (20, None),
            1 => (28, None),
            2 => (26, None),
            3 => (34, None),
            4 => (57, Some(28)),
            5 => (63, Some(34)),
            6 => (30, None),
            7 => (36, None),
            8 => (38, None),
            9 => (59, Some(30)),
            _ => (67, Some(38)),
        };
        let gps_time = match format {
            0 | 2 => None,
            1..=5 => Some(20),
            _ => Some(22),
        };
        PointLayout { length, legacy: format <= 5, gps_time, wave }
    }

    /// Decodes a record of at least [`PointLayout::length`] bytes.
    pub(super) fn decode(&self, record: &[u8], scale: &[f64; 3], offset: &[f64; 3], point: &mut Point) {
        point.raw = std::array::from_fn(|axis| i32::from_le_bytes(at(record, 4 * axis)));
        [point.x, point.y, point.z] =
            std::array::from_fn(|axis| f64::from(point.raw[axis]) * scale[axis] + offset[axis]);
        point.intensity = u16::from_le_bytes(at(record, 12));
        if self.legacy {
            legacy_flags(record, point);
        } else {
            flags(record, point);
        }
        point.gps_time = self.gps_time.map_or(0.0, |start| f64::from_le_bytes(at(record, start)));
        point.wave = self.wave.map_or_else(Wave::default, |start| wave(&record[start..]));
    }
}

/// Decodes bytes 14 to 19 of formats 0 to 5.
fn legacy_flags(record: &[u8], point: &mut Point) {
    let (returns, class) = (record[14], record[15]);
    point.return_number = returns & 7;
    point.number_of_returns = returns >> 3 & 7;
    point.scan_direction = returns & 1 << 6 != 0;
    point.edge_of_flight_line = returns & 1 << 7 != 0;
    point.classification = class & 31;
    point.synthetic = class & 1 << 5 != 0;
    point.key_point = class & 1 << 6 != 0;
    point.withheld = class & 1 << 7 != 0;
    point.overlap = false;
    point.scanner_channel = 0;
    point.scan_angle_deg = f32::from(i8::from_le_bytes([record[16]]));
    point.user_data = record[17];
    point.point_source_id = u16::from_le_bytes(at(record, 18));
}

/// Decodes bytes 14 to 21 of formats 6 to 10.
fn flags(record: &[u8], point: &mut Point) {
    let (returns, bits) = (record[14], record[15]);
    point.return_number = returns & 15;
    point.number_of_returns = returns >> 4;
    point.synthetic = bits & 1 != 0;
    point.key_point = bits & 1 << 1 != 0;
    point.withheld = bits & 1 << 2 != 0;
    point.overlap = bits & 1 << 3 != 0;
    point.scanner_channel = bits >> 4 & 3;
    point.scan_direction = bits & 1 << 6 != 0;
    point.edge_of_flight_line = bits & 1 << 7 != 0;
    point.classification = record[16];
    point.user_data = record[17];
    let steps = i16::from_le_bytes(at(record, 18));
    point.scan_angle_deg = (f64::from(steps) * SCAN_ANGLE_STEP_DEG) as f32;
    point.point_source_id = u16::from_le_bytes(at(record, 20));
}

fn wave(bytes: &[u8]) -> Wave {
    let float = |start| f32::from_le_bytes(at(bytes, start));
    Wave {
        descriptor: bytes[0],
        offset: u64::from_le_bytes(at(bytes, 1)),
        size: u32::from_le_bytes(at(bytes, 9)),
        location_ps: float(13),
        direction_per_ps: [float(17), float(21), float(25)],
    }
}

/// Returns the `N` bytes from `start`.
fn at<const N: usize>(bytes: &[u8], start: usize) -> [u8; N] {
    let mut out = [0; N];
    out.copy_from_slice(&bytes[start..start + N]);
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    const UNIT: ([f64; 3], [f64; 3]) = ([1.0; 3], [0.0; 3]);

    fn decode(format: u8, record: &[u8]) -> Point {
        let mut point = Point::default();
        PointLayout::of(format).decode(record, &UNIT.0, &UNIT.1, &mut point);
        point
    }

    /// Returns the 29 waveform bytes of the test point.
    fn wave_bytes() -> Vec<u8> {
        let mut bytes = vec![2];
        bytes.extend(180u64.to_le_bytes());
        bytes.extend(120u32.to_le_bytes());
        for value in [19204.0f32, 1e-5, -2e-5, 1.4e-4] {
            bytes.extend(value.to_le_bytes());
        }
        bytes
    }

    const WAVE: Wave = Wave {
        descriptor: 2,
        offset: 180,
        size: 120,
        location_ps: 19204.0,
        direction_per_ps: [1e-5, -2e-5, 1.4e-4],
    };

    #[test]
    fn format_4_is_read_field_by_field() {
        let mut record = vec![1, 0, 0, 0, 0xfe, 0xff, 0xff, 0xff, 0, 0, 1, 0, 0x34, 0x12];
        record.extend([0b11_010_001, 0b111_00010, 0xf1, 7, 0x02, 0x01]);
        record.extend(1e6f64.to_le_bytes());
        record.extend(wave_bytes());
        let point = decode(4, &record);
        assert_eq!(point.raw, [1, -2, 65536]);
        let expected = Point {
            raw: [1, -2, 65536],
            x: 1.0,
            y: -2.0,
            z: 65536.0,
            intensity: 0x1234,
            return_number: 1,
            number_of_returns: 2,
            scan_direction: true,
            edge_of_flight_line: true,
            classification: 2,
            synthetic: true,
            key_point: true,
            withheld: true,
            scan_angle_deg: -15.0,
            user_data: 7,
            point_source_id: 258,
            gps_time: 1e6,
            wave: WAVE,
            ..Point::default()
        };
        assert_eq!(point, expected);
    }

    #[test]
    fn format_9_is_read_field_by_field() {
        let mut record = vec![0; 12];
        record.extend([0, 1, 0xf3, 0b1010_1101, 40, 9, 0x18, 0xfc, 5, 0]);
        record.extend((-2.5f64).to_le_bytes());
        record.extend(wave_bytes());
        let expected = Point {
            intensity: 256,
            return_number: 3,
            number_of_returns: 15,
            synthetic: true,
            withheld: true,
            overlap: true,
            scanner_channel: 2,
            edge_of_flight_line: true,
            classification: 40,
            user_data: 9,
            scan_angle_deg: -6.0,
            point_source_id: 5,
            gps_time: -2.5,
            wave: WAVE,
            ..Point::default()
        };
        assert_eq!(decode(9, &record), expected);
    }

    #[test]
    fn formats_5_and_10_have_colours_before_the_waveform() {
        for (format, colours_at, colours) in [(5, 28, 6), (10, 30, 8)] {
            let mut record = vec![0; colours_at];
            record.extend(vec![0xaa; colours]);
            record.extend(wave_bytes());
            assert_eq!(record.len(), PointLayout::of(format).length);
            assert_eq!(decode(format, &record).wave, WAVE);
        }
    }

    #[test]
    fn formats_without_waveforms_have_none() {
        for (format, length) in [(0, 20), (1, 28), (2, 26), (3, 34), (6, 30), (7, 36), (8, 38)] {
            assert_eq!(PointLayout::of(format).length, length);
            assert_eq!(decode(format, &vec![1; length]).wave, Wave::default());
        }
    }

    #[test]
    fn the_sample_at_the_location_is_the_point_and_earlier_ones_lie_towards_the_sensor() {
        let wave = Wave { location_ps: 2000.0, direction_per_ps: [0.0, 0.0, 1.5e-4], ..Wave::default() };
        assert_eq!(wave.sample_position([1.0, 2.0, 3.0], 2.0, 1000.0), [1.0, 2.0, 3.0]);
        let first = wave.sample_position([1.0, 2.0, 3.0], 0.0, 1000.0);
        assert!((first[2] - 3.3).abs() < 1e-7, "{first:?}");
    }
}
