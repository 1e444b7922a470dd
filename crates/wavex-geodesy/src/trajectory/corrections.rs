//! Corrections of a trajectory: offsets of position and attitude over time.
//!
//! A correction is added to what the trajectory says. The position offset moves the aircraft in north, east,
//! down at its position; the attitude offset is added to roll, pitch and heading there. Both are independent:
//! moving the aircraft does not turn it in the earth-centred frame.

use core::fmt;

use super::{Pose, Sample};
use crate::ellipsoid::{Geodetic, WGS84};
use crate::frames::{Attitude, Vector, ecef_from_ned, ecef_from_ned_at, inverse, rotate, then};

/// Offsets of a pose; all zero leaves it unchanged.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PoseOffset {
    /// North, east, down at the aircraft, m.
    pub north_east_down_m: [f64; 3],
    /// Roll, pitch, heading, rad; added to the angles of [`Attitude`].
    pub roll_pitch_heading_rad: [f64; 3],
}

/// Offsets at a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CorrectionKnot {
    /// Time on the axis of the corrections, s.
    pub time_s: f64,
    /// Offsets at that time.
    pub offset: PoseOffset,
}

/// Offsets over time: linear between knots, constant before the first and after the last.
///
/// One knot is a constant, two knots are a line.
///
/// # Examples
///
/// ```
/// use wavex_geodesy::trajectory::corrections::{CorrectionKnot, PoseOffset, TrajectoryCorrections};
///
/// let knot = |time_s, down_m| CorrectionKnot {
///     time_s,
///     offset: PoseOffset { north_east_down_m: [0.0, 0.0, down_m], ..PoseOffset::default() },
/// };
/// let corrections = TrajectoryCorrections::new(vec![knot(100.0, 0.0), knot(160.0, 0.06)])?;
/// let down_m = |time_s| corrections.at(time_s).north_east_down_m[2];
/// assert_eq!([down_m(90.0), down_m(130.0), down_m(200.0)], [0.0, 0.03, 0.06]);
/// # Ok::<(), wavex_geodesy::trajectory::corrections::CorrectionsError>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct TrajectoryCorrections {
    knots: Vec<CorrectionKnot>,
}

/// Reason why knots are not valid corrections. Knots count from 1 in messages, from 0 in fields.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum CorrectionsError {
    /// There are no knots.
    #[error("it has no knots")]
    NoKnots,
    /// NaN or infinite.
    #[error("knot {}: its {field} is {value}", knot + 1)]
    NotFinite {
        /// Index of the knot.
        knot: usize,
        /// Name of the field.
        field: &'static str,
        /// Value of the field.
        value: f64,
    },
    /// Times do not increase.
    #[error("knot {}: its time {time_s} s is not after the {before_s} s of knot {knot}", knot + 1)]
    Disorder {
        /// Index of the knot that is out of order.
        knot: usize,
        /// Time of the previous knot, s.
        before_s: f64,
        /// Time of the knot, s.
        time_s: f64,
    },
}

impl PoseOffset {
    /// Whether it changes nothing.
    pub fn is_zero(&self) -> bool {
        *self == PoseOffset::default()
    }

    /// This part of the way, 0 to 1, to another offset.
    fn towards(&self, other: &PoseOffset, part: f64) -> PoseOffset {
        let between = |a: [f64; 3], b: [f64; 3]| core::array::from_fn(|k| a[k] + part * (b[k] - a[k]));
        PoseOffset {
            north_east_down_m: between(self.north_east_down_m, other.north_east_down_m),
            roll_pitch_heading_rad: between(self.roll_pitch_heading_rad, other.roll_pitch_heading_rad),
        }
    }

    /// The pose with these offsets; its accuracy is kept.
    ///
    /// Zero offsets return the same bits.
    pub fn applied_to(&self, pose: &Pose) -> Pose {
        if self.is_zero() {
            return *pose;
        }
        let ecef_from_ned = ecef_from_ned_at(WGS84, pose.origin_in_ecef_m);
        let moved_m = rotate(&ecef_from_ned, self.north_east_down_m);
        let ecef_from_body = if self.roll_pitch_heading_rad == [0.0; 3] {
            pose.ecef_from_body
        } else {
            let recorded = Attitude::of(&then(&pose.ecef_from_body, &inverse(&ecef_from_ned)));
            then(&self.added_to(&recorded).ned_from_body(), &ecef_from_ned)
        };
        Pose {
            origin_in_ecef_m: core::array::from_fn(|axis| pose.origin_in_ecef_m[axis] + moved_m[axis]),
            ecef_from_body,
            accuracy: pose.accuracy,
        }
    }

    /// The record with these offsets, as [`PoseOffset::applied_to`] its pose.
    ///
    /// The heading stays within half a turn of the recorded one.
    pub fn applied_to_sample(&self, sample: &Sample) -> Sample {
        if self.is_zero() {
            return *sample;
        }
        let frame_at = |place: &Geodetic| ecef_from_ned(place.latitude_rad, place.longitude_rad);
        let recorded_frame = frame_at(&sample.place);
        let (origin_m, moved_m): (Vector, Vector) =
            (WGS84.ecef_of(sample.place), rotate(&recorded_frame, self.north_east_down_m));
        let place = WGS84.geodetic_of(core::array::from_fn(|axis| origin_m[axis] + moved_m[axis]));
        let ecef_from_body = then(&self.added_to(&sample.attitude).ned_from_body(), &recorded_frame);
        let mut attitude = Attitude::of(&then(&ecef_from_body, &inverse(&frame_at(&place))));
        let turn_rad = core::f64::consts::TAU;
        let near = |angle_rad: f64, recorded_rad: f64| {
            angle_rad + turn_rad * ((recorded_rad - angle_rad) / turn_rad).round()
        };
        attitude.heading_rad = near(attitude.heading_rad, sample.attitude.heading_rad);
        let longitude_rad = near(place.longitude_rad, sample.place.longitude_rad);
        Sample { time_s: sample.time_s, place: Geodetic { longitude_rad, ..place }, attitude }
    }

    fn added_to(&self, attitude: &Attitude) -> Attitude {
        let [roll_rad, pitch_rad, heading_rad] = self.roll_pitch_heading_rad;
        Attitude {
            roll_rad: attitude.roll_rad + roll_rad,
            pitch_rad: attitude.pitch_rad + pitch_rad,
            heading_rad: attitude.heading_rad + heading_rad,
        }
    }
}

impl TrajectoryCorrections {
    /// Corrections from knots in order of time.
    ///
    /// # Errors
    /// No knots, values that are not finite, times that do not increase.
    pub fn new(knots: Vec<CorrectionKnot>) -> Result<TrajectoryCorrections, CorrectionsError> {
        if knots.is_empty() {
            return Err(CorrectionsError::NoKnots);
        }
        for (knot, CorrectionKnot { time_s, offset }) in knots.iter().enumerate() {
            let [north, east, down] = offset.north_east_down_m;
            let [roll, pitch, heading] = offset.roll_pitch_heading_rad;
            let fields = [
                ("time", *time_s),
                ("offset to the north", north),
                ("offset to the east", east),
                ("offset downwards", down),
                ("offset of the roll", roll),
                ("offset of the pitch", pitch),
                ("offset of the heading", heading),
            ];
            if let Some((field, value)) = fields.into_iter().find(|(_, value)| !value.is_finite()) {
                return Err(CorrectionsError::NotFinite { knot, field, value });
            }
        }
        let steps = knots.array_windows().enumerate();
        for (before, [CorrectionKnot { time_s: before_s, .. }, CorrectionKnot { time_s, .. }]) in steps {
            if time_s <= before_s {
                let (before_s, time_s) = (*before_s, *time_s);
                return Err(CorrectionsError::Disorder { knot: before + 1, before_s, time_s });
            }
        }
        Ok(TrajectoryCorrections { knots })
    }

    /// The knots, in order of time; at least one.
    pub fn knots(&self) -> &[CorrectionKnot] {
        &self.knots
    }

    /// Offsets at a time on the axis of the knots, s.
    pub fn at(&self, time_s: f64) -> PoseOffset {
        let after = self.knots.partition_point(|knot| knot.time_s <= time_s);
        match (after.checked_sub(1).and_then(|before| self.knots.get(before)), self.knots.get(after)) {
            (Some(before), Some(after)) => {
                let part = (time_s - before.time_s) / (after.time_s - before.time_s);
                before.offset.towards(&after.offset, part)
            }
            (Some(only), None) | (None, Some(only)) => only.offset,
            (None, None) => PoseOffset::default(),
        }
    }
}

/// Formats as `north 0.012, east -0.003, down 0.000 m; roll 0.0010, pitch 0.0000, heading -0.0020 degrees`.
impl fmt::Display for PoseOffset {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [north, east, down] = self.north_east_down_m;
        let [roll, pitch, heading] = self.roll_pitch_heading_rad.map(f64::to_degrees);
        write!(f, "north {north:.3}, east {east:.3}, down {down:.3} m; ")?;
        write!(f, "roll {roll:.4}, pitch {pitch:.4}, heading {heading:.4} degrees")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frames::LocalFrame;
    use crate::trajectory::Trajectory;
    use proptest::prelude::*;

    fn knot(time_s: f64, value: f64) -> CorrectionKnot {
        let offset = PoseOffset {
            north_east_down_m: [value, -value, 2.0 * value],
            roll_pitch_heading_rad: [1e-3 * value, 0.0, -1e-3 * value],
        };
        CorrectionKnot { time_s, offset }
    }

    fn sample(place: [f64; 3], attitude: [f64; 3]) -> Sample {
        let [latitude_rad, longitude_rad, height_m] = place;
        let [roll_rad, pitch_rad, heading_rad] = attitude;
        Sample {
            time_s: 7.0,
            place: Geodetic { latitude_rad, longitude_rad, height_m },
            attitude: Attitude { roll_rad, pitch_rad, heading_rad },
        }
    }

    /// The pose of a record, by the interpolation of a trajectory at its time.
    fn pose(sample: &Sample) -> Pose {
        let later = Sample { time_s: sample.time_s + 1.0, ..*sample };
        Trajectory::new(vec![*sample, later]).unwrap().pose(sample.time_s).unwrap()
    }

    fn distance(a: Vector, b: Vector) -> f64 {
        a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt()
    }

    #[test]
    fn offsets_are_linear_between_knots_and_constant_beyond() {
        let corrections = TrajectoryCorrections::new(vec![knot(10.0, 1.0), knot(20.0, 3.0)]).unwrap();
        for (time_s, value) in [(-1e9, 1.0), (10.0, 1.0), (15.0, 2.0), (20.0, 3.0), (1e9, 3.0)] {
            assert_eq!(corrections.at(time_s), knot(time_s, value).offset, "{time_s}");
        }
        let constant = TrajectoryCorrections::new(vec![knot(10.0, 4.0)]).unwrap();
        assert_eq!([0.0, 10.0, 20.0].map(|time_s| constant.at(time_s)), [knot(0.0, 4.0).offset; 3]);
    }

    #[test]
    fn unusable_knots_are_refused() {
        let problem = |knots| TrajectoryCorrections::new(knots).unwrap_err().to_string();
        assert_eq!(problem(vec![]), "it has no knots");
        assert_eq!(
            problem(vec![knot(1.0, 0.0), knot(1.0, 0.0)]),
            "knot 2: its time 1 s is not after the 1 s of knot 1"
        );
        assert_eq!(problem(vec![knot(f64::NAN, 0.0)]), "knot 1: its time is NaN");
        assert_eq!(
            problem(vec![knot(0.0, 0.0), knot(1.0, f64::INFINITY)]),
            "knot 2: its offset to the north is inf"
        );
    }

    #[test]
    fn zero_offsets_keep_every_bit() {
        let record = sample([0.83, 3.5, 1000.0], [0.1, -0.2, 6.0]);
        let zero = PoseOffset::default();
        assert_eq!(zero.applied_to(&pose(&record)), pose(&record));
        assert_eq!(zero.applied_to_sample(&record), record);
    }

    #[test]
    fn a_position_offset_moves_without_turning() {
        let record = sample([0.83, 0.2, 1000.0], [0.1, -0.2, 3.0]);
        let offset = PoseOffset { north_east_down_m: [3.0, -2.0, 1.5], ..PoseOffset::default() };
        let (before, after) = (pose(&record), offset.applied_to(&pose(&record)));
        assert_eq!(after.ecef_from_body, before.ecef_from_body);
        let frame = LocalFrame::at(WGS84, record.place);
        let expected = WGS84.ecef_of(frame.geodetic_of([-2.0, 3.0, -1.5]));
        assert!(distance(after.origin_in_ecef_m, expected) < 1e-8);
    }

    /// Each angle is that of the record plus its offset.
    #[test]
    fn attitude_offsets_are_added_to_the_angles() {
        let record = sample([0.83, 0.2, 1000.0], [0.1, -0.2, 3.0]);
        let offset = PoseOffset { roll_pitch_heading_rad: [0.01, 0.02, 0.3], ..PoseOffset::default() };
        let after = offset.applied_to(&pose(&record));
        let expected = pose(&sample([0.83, 0.2, 1000.0], [0.11, -0.18, 3.3]));
        for (row, wanted) in after.ecef_from_body.iter().zip(expected.ecef_from_body) {
            assert!(distance(*row, wanted) < 1e-14, "{row:?} {wanted:?}");
        }
        assert!(distance(after.origin_in_ecef_m, expected.origin_in_ecef_m) < 1e-8);
        let corrected = offset.applied_to_sample(&record).attitude;
        assert!((corrected.heading_rad - 3.3).abs() < 1e-14, "beyond half a turn, as recorded");
    }

    proptest! {
        /// A corrected record and a corrected pose are the same.
        #[test]
        fn a_corrected_record_has_the_corrected_pose(
            latitude in -1.5..1.5, longitude in -3.1..6.2, height in 0.0..9000.0,
            roll in -0.7..0.7, pitch in -0.7..0.7, heading in -3.1..6.2,
            north in -50.0..50.0, east in -50.0..50.0, down in -50.0..50.0,
            by in proptest::array::uniform3(-0.05..0.05),
        ) {
            let record = sample([latitude, longitude, height], [roll, pitch, heading]);
            let offset = PoseOffset { north_east_down_m: [north, east, down], roll_pitch_heading_rad: by };
            let (moved, expected) = (pose(&offset.applied_to_sample(&record)), offset.applied_to(&pose(&record)));
            prop_assert!(distance(moved.origin_in_ecef_m, expected.origin_in_ecef_m) < 1e-8);
            for (row, wanted) in moved.ecef_from_body.iter().zip(expected.ecef_from_body) {
                prop_assert!(distance(*row, wanted) < 1e-13, "{row:?} {wanted:?}");
            }
            let turned = offset.applied_to_sample(&record);
            prop_assert!((turned.attitude.heading_rad - heading).abs() < 3.2);
            prop_assert!((turned.place.longitude_rad - longitude).abs() < 3.2);
        }
    }
}
