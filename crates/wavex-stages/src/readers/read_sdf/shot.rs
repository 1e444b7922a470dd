//! Classification of SDF records: a shot, an end of line, or neither.

use wavex_formats::sdf::{SdfBlock, SdfRecord, channel, record_flags};
use wavex_line::scan_line::{Channel, Emission, emission_flags};
use wavex_line::stage::Reason;

/// Kind of a record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum What {
    /// A shot; it may also end its line.
    Shot,
    /// The end of a scan line, without a shot.
    EndOfLine,
    /// Internal data of the instrument.
    Housekeeping,
}

/// Classifies a record.
///
/// In the one known file, a line ends with a shot of flags 11, then a record of flags 15 without
/// blocks and direction. A record without blocks but with a direction is a shot that recorded
/// nothing; its echoes may be stored with later shots.
pub(super) fn what_is(record: &SdfRecord) -> What {
    let is = |flag: u16| record.flags & flag != 0;
    let is_directed = record.direction.iter().all(|x| x.is_finite());
    match is(record_flags::HOUSEKEEPING) {
        true if is(record_flags::END_OF_LINE) => What::EndOfLine,
        true => What::Housekeeping,
        false if record.blocks.is_empty() && !is_directed => What::EndOfLine,
        false => What::Shot,
    }
}

/// Result of reading a shot record.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum ReadShot {
    /// A valid shot; its number is not known yet.
    Shot(Emission),
    /// The reason why the shot is rejected.
    Wrong(Reason),
}

/// Reads the shot of a record; its time is external time.
pub(super) fn read(record: &SdfRecord) -> ReadShot {
    if let Some(reason) = wrong(record) {
        return ReadShot::Wrong(reason);
    }
    let length = length(record.direction);
    let is_unit = (length - 1.0).abs() <= AS_GOOD_AS_UNIT;
    ReadShot::Shot(Emission {
        gps_time_s: record.time_external_s,
        clock_ps: clock_ps(record.time_s) + zero_of(record).map_or(0, clock_ps),
        origin_m: record.origin_m,
        direction: if is_unit { record.direction } else { record.direction.map(|x| x / length) },
        facet: record.facet,
        flags: flags(record.flags),
        mta_zone: None,
        ..Emission::default()
    })
}

/// Whether a shot is the last of its line.
pub(super) fn ends_line(emission: &Emission) -> bool {
    emission.flags & emission_flags::EDGE_OF_FLIGHT_LINE != 0
}

/// The first three bits have the library's meaning; bits above the fourth have no known meaning.
fn flags(record: u16) -> u16 {
    const SAME: u16 = emission_flags::SYNCHRONISED
        | emission_flags::SYNCHRONISED_WITHIN_LAST_SECOND
        | emission_flags::HOUSEKEEPING;
    let edge = record & record_flags::END_OF_LINE != 0;
    record & SAME | if edge { emission_flags::EDGE_OF_FLIGHT_LINE } else { 0 }
}

/// Largest deviation of the length of a direction from 1.
const UNIT_TOLERANCE: f64 = 1e-3;
/// Below this deviation a direction is not normalised: 1 mm at 1 km.
const AS_GOOD_AS_UNIT: f64 = 1e-6;
/// Latest clock time, s: whole picoseconds would overflow 2^63 (106 days).
const LATEST_S: f64 = 9.2e6;

/// The reason to reject a shot, if any.
fn wrong(record: &SdfRecord) -> Option<Reason> {
    let length = length(record.direction);
    let has_time = |block: &SdfBlock| block.start_s.abs() <= FARTHEST_S;
    if !record.origin_m.iter().all(|x| x.is_finite()) {
        Some(Reason::OriginNotFinite)
    } else if !length.is_finite() {
        Some(Reason::DirectionNotFinite)
    } else if (length - 1.0).abs() > UNIT_TOLERANCE {
        Some(Reason::DirectionNotUnit)
    } else if record.time_external_s.is_infinite() {
        Some(Reason::TimeInfinite)
    } else if !record.time_s.is_finite() {
        Some(Reason::ClockNotFinite)
    } else if record.time_s.abs() > LATEST_S {
        Some(Reason::ClockTooLate)
    } else if record.blocks.iter().any(|block| channel_of(block.channel).is_none()) {
        Some(Reason::ShotWithUnknownChannel)
    } else if !record.blocks.iter().all(has_time) {
        Some(Reason::BlockWithoutTime)
    } else {
        None
    }
}

fn length(direction: [f64; 3]) -> f64 {
    direction.iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// The channel of a code; `None` for an unknown code.
pub(super) fn channel_of(code: u32) -> Option<Channel> {
    match code {
        channel::HIGH_POWER => Some(Channel::HighPower),
        channel::LOW_POWER => Some(Channel::LowPower),
        channel::SATURATION => Some(Channel::Saturation),
        channel::REFERENCE => Some(Channel::Reference),
        _ => None,
    }
}

/// Emission time relative to the record, s, from a reference block without samples.
pub(super) fn zero_of(record: &SdfRecord) -> Option<f64> {
    let carries = |channel: u32, is_empty: bool| channel == channel::REFERENCE && is_empty;
    record.blocks.iter().find(|block| carries(block.channel, block.is_empty())).map(|block| block.start_s)
}

/// Rounds to whole picoseconds; below 4096 s a double resolves less than that.
pub(super) fn clock_ps(time_s: f64) -> i64 {
    // Whole and fractional seconds are converted separately: each product is exact or rounded to
    // far less than 1 ps.
    let whole_s = time_s.trunc();
    whole_s as i64 * 1_000_000_000_000 + ((time_s - whole_s) * 1e12).round() as i64
}

/// Largest offset of a block from its shot, s; beyond it the time is invalid.
const FARTHEST_S: f64 = 1.0;

/// Rounds a relative time to 1e-6 ns.
///
/// This restores decimal nanoseconds that were converted to seconds.
pub(super) fn fine_ns(time_s: f64) -> f64 {
    (time_s * 1e15).round() / 1e6
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn record(flags: u16, direction: [f64; 3], blocks: usize) -> SdfRecord {
        let mut record = SdfRecord::default();
        (record.flags, record.direction) = (flags, direction);
        (0..blocks).for_each(|_| record.push(channel::LOW_POWER, 1e-6, &[1, 2, 3]));
        record
    }

    const DOWN: [f64; 3] = [0.0, 0.0, -1.0];
    const NOWHERE: [f64; 3] = [f64::NAN; 3];

    #[test]
    fn kind_of_record_follows_from_flags_and_blocks() {
        for (flags, direction, blocks, expected) in [
            (3, DOWN, 1, What::Shot),
            (3, DOWN, 0, What::Shot),
            (11, DOWN, 1, What::Shot),
            (3, NOWHERE, 1, What::Shot),
            (15, NOWHERE, 0, What::EndOfLine),
            (3, NOWHERE, 0, What::EndOfLine),
            (12, DOWN, 1, What::EndOfLine),
            (7, DOWN, 2, What::Housekeeping),
            (7, NOWHERE, 0, What::Housekeeping),
        ] {
            assert_eq!(
                what_is(&record(flags, direction, blocks)),
                expected,
                "{flags} {direction:?} {blocks}"
            );
        }
    }

    #[test]
    fn the_last_shot_of_a_line_says_so_and_unknown_bits_are_left_out() {
        let ReadShot::Shot(shot) = read(&record(0xff0b, DOWN, 1)) else { panic!("a shot") };
        assert_eq!(shot.flags, 3 | emission_flags::EDGE_OF_FLIGHT_LINE);
        assert!(ends_line(&shot));
        assert_eq!((shot.mta_zone, shot.frame_scale), (None, 1.0));
        assert!(shot.scan_angle_deg.is_nan());
    }

    #[test]
    fn each_reason_has_its_name() {
        type Change = fn(&mut SdfRecord);
        let changes: [(Reason, Change); 10] = [
            (Reason::OriginNotFinite, |record| record.origin_m[2] = f64::INFINITY),
            (Reason::DirectionNotFinite, |record| record.direction = NOWHERE),
            (Reason::DirectionNotUnit, |record| record.direction[2] = -1.0011),
            (Reason::DirectionNotUnit, |record| record.direction = [0.0; 3]),
            (Reason::TimeInfinite, |record| record.time_external_s = f64::NEG_INFINITY),
            (Reason::ClockNotFinite, |record| record.time_s = f64::NAN),
            (Reason::ClockTooLate, |record| record.time_s = 9.3e6),
            (Reason::ShotWithUnknownChannel, |record| record.push(4, 0.0, &[])),
            (Reason::BlockWithoutTime, |record| record.push(1, f64::NAN, &[])),
            (Reason::BlockWithoutTime, |record| record.push(1, 1.5, &[])),
        ];
        for (reason, change) in changes {
            let mut record = record(3, DOWN, 1);
            change(&mut record);
            assert_eq!(read(&record), ReadShot::Wrong(reason));
        }
    }

    #[test]
    fn a_direction_of_few_digits_is_made_a_unit_vector() {
        let direction_of = |z| match read(&record(3, [0.0, 0.6, z], 0)) {
            ReadShot::Shot(shot) => shot.direction,
            ReadShot::Wrong(reason) => panic!("{reason}"),
        };
        assert_eq!(direction_of(0.800_000_9), [0.0, 0.6, 0.800_000_9]);
        assert!((length(direction_of(0.8001)) - 1.0).abs() < 1e-15);
    }

    #[test]
    fn a_reference_block_without_samples_is_the_time_of_emission() {
        let mut record = record(3, DOWN, 1);
        record.time_s = 5.0;
        assert_eq!(zero_of(&record), None);
        record.push(channel::REFERENCE, -2.5e-9, &[]);
        assert_eq!(zero_of(&record), Some(-2.5e-9));
        assert!(matches!(read(&record), ReadShot::Shot(shot) if shot.clock_ps == 4_999_999_997_500));
    }

    proptest! {
        #[test]
        fn picoseconds_come_back_from_seconds(ps in -4_096_000_000_000_000_i64..4_096_000_000_000_000) {
            prop_assert_eq!(clock_ps(ps as f64 / 1e12), ps);
        }

        #[test]
        fn decimal_nanoseconds_come_back_from_seconds(millionths in -1_000_000_000_000_i64..1_000_000_000_000) {
            let ns = millionths as f64 / 1e6;
            prop_assert_eq!(fine_ns(ns / 1e9), ns);
        }
    }

    #[test]
    fn a_late_clock_is_read_to_its_own_resolution() {
        // The double next to 409 397.1 s.
        assert!((clock_ps(409_397.1) - 409_397_100_000_000_000).abs() <= 30);
    }
}
