//! The trajectory of a run, on its own time axis.

use std::path::{Path, PathBuf};

use super::Result;
use super::keys::{AnglesKey, GeometryKeys, HeightsKey, OutliersKey, TimeKey};
use super::output_crs::CrsRequest;
use crate::plausibility::Check;
use wavex_formats::Error;
use wavex_formats::trajectory::{self, Angles, FileTime, Options, Records, Unproject};
use wavex_geodesy::crs::CrsError;
use wavex_geodesy::ellipsoid::Geodetic;
use wavex_geodesy::time_axis::TimeSpan;
use wavex_geodesy::trajectory::outliers::{
    FEWEST_FROZEN, LEAST_M, LEAST_RAD, LEAST_SPEED_MPS, MOST_ACCELERATION_MPS2, MOST_TURNING_RADPS2, Outlier,
    RecordFault, outliers,
};
use wavex_geodesy::trajectory::plausibility::{
    Contradiction, ContradictionKind, MotionLimits, contradiction,
};
use wavex_geodesy::trajectory::{Gap, Trajectory, TrajectoryError};

/// A trajectory and its files.
#[derive(Debug)]
pub(super) struct Track {
    file: PathBuf,
    accuracy: Option<PathBuf>,
    pub(super) trajectory: Trajectory,
    /// Time span.
    pub(super) times: TimeSpan,
    pub(super) knows_accuracy: bool,
    /// Notes for the user.
    pub(super) notes: Vec<String>,
}

impl Track {
    /// The file it was read from.
    pub(super) fn file(&self) -> &Path {
        &self.file
    }

    /// Whether it was read from these files.
    pub(super) fn is_of(&self, file: &Path, accuracy: Option<&Path>) -> bool {
        self.file == file && self.accuracy.as_deref() == accuracy
    }

    /// Reads a trajectory and its accuracies; projected positions are in the requested CRS.
    ///
    /// # Errors
    /// See [`trajectory::read`] and [`trajectory::Recorded::into_trajectory`].
    pub(super) fn read(
        file: &Path,
        accuracy: Option<&Path>,
        keys: &GeometryKeys,
        wanted: &CrsRequest,
    ) -> Result<Track> {
        let accuracy = accuracy.map(Path::to_path_buf);
        let options = options(keys, accuracy.clone());
        let mut recorded = trajectory::read(file, &options)?;
        let (times, mut notes) = (recorded.times(), recorded.notes.clone());
        let knows_accuracy = !recorded.accuracies.is_empty();
        let map = wanted.fixed();
        match &mut recorded.records {
            Records::Geodetic(samples) if keys.trajectory_heights == Some(HeightsKey::Geoid) => {
                for sample in samples {
                    let place = &mut sample.place;
                    let [latitude, longitude] =
                        [place.latitude_rad, place.longitude_rad].map(f64::to_degrees);
                    place.height_m += wanted.undulation_m(latitude, longitude).map_err(CrsError::from)?;
                }
            }
            Records::Projected(_) if keys.trajectory_heights.is_none() => notes.push(heights_note(keys)),
            _ => {}
        }
        let is_ellipsoidal = keys.trajectory_heights == Some(HeightsKey::Ellipsoid);
        let unproject = map.as_ref().map(|map| {
            move |place: [f64; 3]| {
                let found = map.to_geodetic(place).map_err(|error| error.to_string())?;
                let own_m = place[2] * map.height_unit().metres;
                Ok(if is_ellipsoidal { Geodetic { height_m: own_m, ..found } } else { found })
            }
        });
        let speeds_mps = std::mem::take(&mut recorded.speeds_mps);
        let is_text = recorded.is_text();
        let trajectory =
            recorded.into_trajectory(unproject.as_ref().map(|unproject| unproject as &Unproject))?;
        let limits = keys.trajectory_limits.limits();
        if let Some(found) =
            limits.and_then(|limits| contradiction(trajectory.samples(), &speeds_mps, limits))
        {
            let remedy = remedy(&found, is_text, options.angles);
            return Err(Error::unusable(file, found.problem, remedy).into());
        }
        let trajectory = match keys.trajectory_outliers {
            OutliersKey::Keep => trajectory,
            OutliersKey::Exclude => {
                let (trajectory, note) = without_outliers(file, trajectory, limits)?;
                notes.extend(note);
                trajectory
            }
        };
        notes.extend(gaps(file, &trajectory));
        Ok(Track { file: file.to_path_buf(), accuracy, trajectory, times, knows_accuracy, notes })
    }
}

/// Time span of a trajectory, read with the keys of a job; see [`trajectory::time_span`].
///
/// # Errors
/// As [`trajectory::time_span`].
pub fn trajectory_times(keys: &GeometryKeys, file: &Path) -> wavex_formats::Result<TimeSpan> {
    trajectory::time_span(file, &options(keys, None))
}

/// The key that mends a contradiction, and the key that overrides the check.
pub fn remedy(found: &Contradiction, is_text: bool, angles: Option<Angles>) -> String {
    let mend = match found.kind {
        ContradictionKind::AnglesAreRadians if is_text => "set `trajectory_angles = \"rad\"`",
        ContradictionKind::AnglesAreDegrees if is_text => "set `trajectory_angles = \"deg\"`",
        ContradictionKind::Attitude if is_text && angles == Some(Angles::Radians) => {
            "set `trajectory_angles = \"deg\"` if its angles are degrees"
        }
        ContradictionKind::Attitude | ContradictionKind::Motion | ContradictionKind::Heading if is_text => {
            "check the order and units of its columns in `trajectory_columns`"
        }
        ContradictionKind::AnglesAreRadians => "export it again with angles in degrees",
        ContradictionKind::AnglesAreDegrees => "export it again with angles in radians",
        ContradictionKind::Attitude | ContradictionKind::Motion | ContradictionKind::Heading => {
            "export it again, and check its units and time scale"
        }
    };
    let wider = match found.kind {
        ContradictionKind::Heading => "if it flies sideways or its axes are turned by the `mount`",
        _ => "if it is right",
    };
    format!("{mend}; {wider}, set `trajectory_limits` to \"helicopter\" (also for drones) or \"none\"")
}

/// Reader options from the keys.
fn options(keys: &GeometryKeys, accuracy: Option<PathBuf>) -> Options {
    let time = keys.trajectory_time.map(|time| match time {
        TimeKey::Week => FileTime::Week,
        TimeKey::Day => FileTime::Day,
        TimeKey::Adjusted => FileTime::Adjusted,
        TimeKey::Standard => FileTime::Standard,
        TimeKey::Unix => FileTime::Unix,
    });
    let angles = keys.trajectory_angles.map(|angles| match angles {
        AnglesKey::Deg => Angles::Degrees,
        AnglesKey::Rad => Angles::Radians,
    });
    Options { time, angles, columns: keys.trajectory_columns.clone(), accuracy }
}

/// Notes the height reference assumed for a TRJ, which does not define it.
fn heights_note(keys: &GeometryKeys) -> String {
    let (taken, otherwise) = match &keys.geoid {
        Some(geoid) => (format!("the geoid {geoid}"), "`trajectory_heights = \"ellipsoid\"`"),
        None => ("the ellipsoid".to_owned(), "`trajectory_heights = \"geoid\"` and `geoid`"),
    };
    format!(
        "a TRJ does not define its height reference: heights are assumed to be above {taken}; if that is wrong, all points \
         are off by the height of the geoid (tens of metres): set {otherwise} in `[job.geometry]`"
    )
}

/// Words of the messages.
const FAR: &str = "are far from their neighbours";
const TURNED: &str = "have another attitude than their neighbours";
const BEYOND: &str = "have a roll or pitch beyond the limits";
const REPEATED: &str = "repeat a position although the vehicle moves";

/// The checks of this module.
pub fn checks() -> Vec<Check> {
    let check = |compared, accepted: String, source, message| {
        Check::left_out(compared, accepted, source, message).with_key("trajectory_outliers")
    };
    let limit = |compared, accepted: String, source, message| {
        Check::error(compared, accepted, source, message).with_key("trajectory_limits")
    };
    let [airplane, helicopter] = [MotionLimits::AIRPLANE, MotionLimits::HELICOPTER];
    let of_both = |of: fn(&MotionLimits) -> f64, unit: &str| {
        format!("{:.0} {unit}; helicopter {:.0}", of(&airplane), of(&helicopter))
    };
    vec![
        limit(
            "roll, in 95 % of the records",
            of_both(|limits| limits.roll_rad.to_degrees(), "degrees"),
            "steep banks",
            "its roll exceeds",
        ),
        limit(
            "pitch, in 95 % of the records",
            of_both(|limits| limits.pitch_rad.to_degrees(), "degrees"),
            "steep climbs",
            "its pitch exceeds",
        ),
        limit(
            "speed, in 95 % of the seconds",
            of_both(|limits| limits.speed_mps, "m/s"),
            "no survey flies at the speed of sound",
            "its speed exceeds",
        ),
        limit(
            "acceleration, in 95 % of the seconds",
            of_both(|limits| limits.acceleration_mps2, "m/s²"),
            "3 and 6 times that of free fall",
            "its acceleration exceeds",
        ),
        limit(
            "turn rate, in 95 % of the seconds",
            of_both(|limits| limits.turn_rate_rad_per_s.to_degrees(), "degrees/s"),
            "half a turn within a window of 1 s is ambiguous",
            "its turn rate exceeds",
        ),
        limit(
            "heading and course over ground, upper quartile",
            of_both(|limits| limits.drift_rad.to_degrees(), "degrees"),
            "strong wind explains 30 degrees; helicopters fly sideways",
            "differ by",
        ),
        limit(
            "stored velocity and velocity of the positions, median",
            "2 m/s and 10 %".into(),
            "the same quantity",
            "its stored velocity has",
        ),
        limit(
            "records that repeat the position of the one before",
            "half of them, above 5 m/s".into(),
            "positions are sparser than records",
            "repeat the position of the one before",
        ),
        check("roll and pitch of a record", "the limits above".into(), "up to 5 % of the records", BEYOND),
        check(
            "position of a record and the line through its neighbours",
            format!(
                "{LEAST_M} m, an acceleration of {MOST_ACCELERATION_MPS2} m/s², or the noise of the trajectory"
            ),
            "five times the acceleration of free fall",
            FAR,
        ),
        check(
            "roll, pitch and heading of a record and the line through its neighbours",
            format!(
                "{:.0} degree, an angular acceleration of {:.0} degrees/s², or the noise of the trajectory",
                LEAST_RAD.to_degrees(),
                MOST_TURNING_RADPS2.to_degrees()
            ),
            "small drones turn by less",
            TURNED,
        ),
        check(
            "positions of neighbouring records",
            format!(
                "fewer than {FEWEST_FROZEN} equal ones between records faster than {LEAST_SPEED_MPS} m/s"
            ),
            "receivers that lose the signal repeat their last position",
            REPEATED,
        ),
    ]
}

/// A trajectory without its outliers, and a note on them, if any.
///
/// # Errors
/// Fewer than two records are left.
pub fn without_outliers(
    file: &Path,
    trajectory: Trajectory,
    limits: Option<&MotionLimits>,
) -> std::result::Result<(Trajectory, Option<String>), Error> {
    let found = outliers(trajectory.samples(), limits);
    let Some(note) = note_on(file, &found) else { return Ok((trajectory, None)) };
    let unusable = |problem: TrajectoryError| Error::unusable(file, problem.to_string(), problem.remedy());
    Ok((trajectory.without(&found).map_err(unusable)?, Some(note)))
}

/// Note on the records left out, if any.
fn note_on(file: &Path, outliers: &[Outlier]) -> Option<String> {
    let worst = |fault| {
        let of_fault = outliers.iter().filter(move |outlier| outlier.fault == fault);
        of_fault
            .clone()
            .max_by(|a, b| a.deviation.total_cmp(&b.deviation))
            .map(|worst| (of_fault.count(), worst))
    };
    let mut parts = Vec::new();
    for (fault, what, unit, scale) in [
        (RecordFault::Position, FAR, " m", 1.0),
        (RecordFault::Attitude, TURNED, " degrees", 1f64.to_degrees()),
        (RecordFault::Limit, BEYOND, " degrees", 1f64.to_degrees()),
        (RecordFault::Frozen, REPEATED, "", 0.0),
    ] {
        if let Some((count, worst)) = worst(fault) {
            let by = if scale > 0.0 {
                format!(", {:.1}{unit} off", scale * worst.deviation)
            } else {
                String::new()
            };
            parts.push(format!("{count} {what} (record {} at {:.3} s{by})", worst.record + 1, worst.time_s));
        }
    }
    (!parts.is_empty()).then(|| {
        format!(
            "{}: outliers of the trajectory are left out, and poses there are interpolated: {}; export it again from \
             its source, or set `trajectory_outliers = \"keep\"` in `[job.geometry]`",
            file.display(),
            parts.join("; ")
        )
    })
}

/// Note on the gaps of a trajectory, if any.
fn gaps(file: &Path, trajectory: &Trajectory) -> Option<String> {
    let gaps = trajectory.gaps();
    let longest = gaps.iter().max_by(|a, b| a.length_s().total_cmp(&b.length_s()))?;
    let open = gaps.iter().filter(|gap| !gap.is_bridged).count();
    let Gap { between_s: [from_s, _], .. } = longest;
    Some(format!(
        "{}: {} steps of the trajectory exceed twice the median ({:.4} s); the longest is {:.3} s at {from_s:.3} s; poses \
         are interpolated across gaps of up to {:.3} s, and shots in the other {open} gaps are rejected",
        file.display(),
        gaps.len(),
        trajectory.median_step_s(),
        longest.length_s(),
        trajectory.longest_bridged_s(),
    ))
}
