//! Point encoding.
//!
//! LAS 1.4 R15, sections "Point Data Record Format 0" to "Point Data Record Format 10".

use wavex_simd::quantise::Steps;

use super::point::{SCAN_ANGLE_STEP_DEG, Wave};

/// Largest scan angle of formats 6 to 10, steps.
///
/// 180 degrees.
const SCAN_ANGLE_MAX: i32 = 30_000;
/// Largest scan angle of formats 0 to 5, degrees.
const SCAN_ANGLE_RANK_MAX: i32 = 90;
/// Largest return number and number of returns in formats 0 to 5.
pub(super) const LEGACY_RETURNS: u8 = 7;
/// Largest return number and number of returns in formats 6 to 10.
pub(super) const RETURNS: u8 = 15;
/// Largest class of formats 0 to 5.
const LEGACY_CLASSES: u8 = 31;

/// Point for output.
///
/// Values out of range are clamped, never wrapped.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PointOut {
    /// Coordinate in the file's coordinate system.
    pub x: f64,
    /// Coordinate in the file's coordinate system.
    pub y: f64,
    /// Coordinate in the file's coordinate system.
    pub z: f64,
    /// Intensity of the return.
    pub intensity: u16,
    /// Return number, from 1.
    ///
    /// At most 15, in formats 0 to 5 at most 7.
    pub return_number: u8,
    /// Number of returns of the shot.
    ///
    /// At most 15, in formats 0 to 5 at most 7.
    pub number_of_returns: u8,
    /// Whether the mirror moved from left to right.
    pub scan_direction: bool,
    /// Whether the point is the last before the scan turns.
    pub edge_of_flight_line: bool,
    /// ASPRS class: at most 31 in formats 0 to 5.
    pub classification: u8,
    /// Whether the point should be treated as deleted.
    pub withheld: bool,
    /// Scanner channel, 0 to 3.
    ///
    /// Not in formats 0 to 5.
    pub scanner_channel: u8,
    /// Scan angle, degrees; NaN becomes 0.
    ///
    /// Within -180 to 180; in formats 0 to 5 whole degrees within -90 to 90.
    pub scan_angle_deg: f32,
    /// User data.
    pub user_data: u8,
    /// Point source ID.
    ///
    /// The file or flight line of the point.
    pub point_source_id: u16,
    /// Time in the system of the writer's options, s.
    pub gps_time: f64,
    /// Waveform that contains the return; ignored by formats without waveforms.
    pub wave: Wave,
}

impl PointOut {
    /// Encodes the bytes between intensity and time, from the lowest.
    ///
    /// There are 8 bytes, or 6 in formats 0 to 5. The bytes of the scan angle are 0.
    #[inline]
    pub(super) fn fields(&self, format: u8) -> u64 {
        let bytes = if format <= 5 { self.legacy_fields() } else { self.new_fields() };
        u64::from_le_bytes(bytes)
    }

    /// Encodes bytes 14 to 19 of formats 0 to 5.
    #[inline]
    fn legacy_fields(&self) -> [u8; 8] {
        let returns = self.return_number.min(LEGACY_RETURNS)
            | self.number_of_returns.min(LEGACY_RETURNS) << 3
            | u8::from(self.scan_direction) << 6
            | u8::from(self.edge_of_flight_line) << 7;
        let class = self.classification.min(LEGACY_CLASSES) | u8::from(self.withheld) << 7;
        let [source_low, source_high] = self.point_source_id.to_le_bytes();
        [returns, class, 0, self.user_data, source_low, source_high, 0, 0]
    }

    /// Encodes bytes 14 to 21 of formats 6 to 10.
    #[inline]
    fn new_fields(&self) -> [u8; 8] {
        let returns = self.return_number.min(RETURNS) | self.number_of_returns.min(RETURNS) << 4;
        let flags = u8::from(self.withheld) << 2
            | self.scanner_channel.min(3) << 4
            | u8::from(self.scan_direction) << 6
            | u8::from(self.edge_of_flight_line) << 7;
        let [source_low, source_high] = self.point_source_id.to_le_bytes();
        [returns, flags, self.classification, self.user_data, 0, 0, source_low, source_high]
    }

    /// Returns the quantised scan angle of formats 6 to 10, degrees.
    pub fn stored_scan_angle_deg(&self) -> f64 {
        let mut steps = [0];
        scan_angle_steps(6).count(&[f64::from(self.scan_angle_deg)], &mut steps);
        f64::from(steps[0]) * SCAN_ANGLE_STEP_DEG
    }
}

/// Returns the quantisation of scan angles in a format.
pub(super) fn scan_angle_steps(format: u8) -> Steps {
    let (scale, largest) =
        if format <= 5 { (1.0, SCAN_ANGLE_RANK_MAX) } else { (SCAN_ANGLE_STEP_DEG, SCAN_ANGLE_MAX) };
    Steps { offset: 0.0, scale, least: -largest, largest, nan: 0 }
}

#[cfg(test)]
mod tests {
    use super::super::point::{Point, PointLayout};
    use super::super::tests::made::any_point;
    use super::super::writer::record;
    use super::*;
    use proptest::prelude::*;

    /// Encodes and decodes a point.
    fn back(format: u8, point: &PointOut, raw: [i32; 3]) -> Point {
        let record = record(format, point, raw);
        assert_eq!(record.len(), PointLayout::of(format).length);
        let mut point = Point::default();
        PointLayout::of(format).decode(&record, &[1.0; 3], &[0.0; 3], &mut point);
        point
    }

    #[test]
    fn what_does_not_fit_is_clamped() {
        let point = PointOut {
            return_number: 200,
            number_of_returns: 16,
            scanner_channel: 9,
            scan_angle_deg: 1e9,
            classification: 255,
            ..PointOut::default()
        };
        let read = back(6, &point, [i32::MAX, i32::MIN, 0]);
        assert_eq!((read.return_number, read.number_of_returns, read.scanner_channel), (15, 15, 3));
        assert_eq!((read.scan_angle_deg, read.classification), (180.0, 255));
        assert_eq!(read.raw, [i32::MAX, i32::MIN, 0]);
        assert!(!read.withheld && !read.edge_of_flight_line && !read.scan_direction);
        let read = back(1, &point, [i32::MAX, i32::MIN, 0]);
        assert_eq!((read.return_number, read.number_of_returns, read.scanner_channel), (7, 7, 0));
        assert_eq!((read.scan_angle_deg, read.classification), (90.0, 31));
        assert!(!read.withheld && !read.edge_of_flight_line && !read.scan_direction);
        for format in [1, 6] {
            let of = |scan_angle_deg| PointOut { scan_angle_deg, ..PointOut::default() };
            assert_eq!(back(format, &of(f32::NAN), [0; 3]).scan_angle_deg, 0.0);
            assert!(back(format, &of(f32::NEG_INFINITY), [0; 3]).scan_angle_deg <= -90.0);
        }
    }

    #[test]
    fn format_1_is_spelled_out() {
        let point = PointOut {
            intensity: 0x1234,
            return_number: 2,
            number_of_returns: 3,
            scan_direction: true,
            classification: 20,
            withheld: true,
            scan_angle_deg: -12.6,
            user_data: 7,
            point_source_id: 258,
            gps_time: 1.0,
            ..PointOut::default()
        };
        let record = record(1, &point, [1, -2, 3]);
        let mut expected = vec![1, 0, 0, 0, 0xfe, 0xff, 0xff, 0xff, 3, 0, 0, 0, 0x34, 0x12];
        expected.extend([0b01_011_010, 0b100_10100, 0xf3, 7, 2, 1]);
        expected.extend(1f64.to_le_bytes());
        assert_eq!(record, expected);
    }

    proptest! {
        #[test]
        fn a_record_reads_back_as_it_was_written(point in any_point(), raw in any::<[i32; 3]>(), is_9 in any::<bool>()) {
            let read = back(if is_9 { 9 } else { 6 }, &point, raw);
            prop_assert_eq!(read.raw, raw);
            let wave = if is_9 { point.wave } else { Wave::default() };
            prop_assert_eq!(read.wave, wave);
            prop_assert_eq!(again(&point, &read), point);
        }

        #[test]
        fn an_old_record_reads_back_within_its_fields(point in any_point(), raw in any::<[i32; 3]>()) {
            let read = back(4, &point, raw);
            prop_assert_eq!(read.raw, raw);
            let expected = PointOut {
                return_number: point.return_number.min(7),
                number_of_returns: point.number_of_returns.min(7),
                classification: point.classification.min(31),
                scanner_channel: 0,
                scan_angle_deg: point.scan_angle_deg.round().clamp(-90.0, 90.0),
                ..point.clone()
            };
            prop_assert_eq!(again(&point, &read), expected);
        }
    }

    /// Converts a decoded point to output form, at the position of the original.
    fn again(point: &PointOut, read: &Point) -> PointOut {
        PointOut {
            intensity: read.intensity,
            return_number: read.return_number,
            number_of_returns: read.number_of_returns,
            scan_direction: read.scan_direction,
            edge_of_flight_line: read.edge_of_flight_line,
            classification: read.classification,
            withheld: read.withheld,
            scanner_channel: read.scanner_channel,
            scan_angle_deg: read.scan_angle_deg,
            user_data: read.user_data,
            point_source_id: read.point_source_id,
            gps_time: read.gps_time,
            ..point.clone()
        }
    }
}
