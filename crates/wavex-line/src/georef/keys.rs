//! Keys of `[job.geometry]`.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::calibration::Calibration;
use super::mount::Mount;
use crate::keys::{InvalidKey, Keys, listed};
use crate::scan_line::Frame;
use wavex_geodesy::trajectory::plausibility::MotionLimits;

/// Table `[job.geometry]`: trajectory, mounting of the scanner, and output coordinates.
///
/// `docs/explanation/georeferencing.md` gives the formulas. Relative paths start at the input folder.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct GeometryKeys {
    /// File of positions and attitudes: SBET, POF, SOL, TRJ or columns of text, detected from its
    /// content; `*` is the input's stem. Shots in the scanner or body frame get their poses from
    /// it.
    #[schemars(extend("x-file" = "input"))]
    pub trajectory: Option<String>,
    /// Time scale of the trajectory, if its format does not define it.
    pub trajectory_time: Option<TimeKey>,
    /// Unit of the trajectory's angles, if its format does not define it.
    pub trajectory_angles: Option<AnglesKey>,
    /// Columns of a text trajectory, one letter each: `t` time, `x` longitude, `y` latitude, `z`
    /// ellipsoidal height, `w` roll, `p` pitch, `k` heading; any other letter skips a column.
    /// Without `w` the roll is 0, with a warning.
    #[schemars(extend("x-file" = "none"))]
    pub trajectory_columns: Option<String>,
    /// Records that contradict their neighbours, such as a position of 0 or a single jump: `exclude`
    /// (default) leaves them out with a warning, `keep` uses them.
    #[serde(skip_serializing_if = "OutliersKey::is_default")]
    pub trajectory_outliers: OutliersKey,
    /// Limits of plausible attitudes and motion: `airplane` (default), `helicopter` for helicopters and
    /// drones, which may fly sideways, or `none`. A trajectory beyond them in more than 5 % of its
    /// records is an error, fewer records are outliers.
    #[serde(skip_serializing_if = "LimitsKey::is_default")]
    pub trajectory_limits: LimitsKey,
    /// Height reference of the trajectory. Defaults to the ellipsoid, except for TRJ, which does
    /// not define it: there, to the geoid of the job, if one is given.
    pub trajectory_heights: Option<HeightsKey>,
    /// File of the trajectory's standard deviations: RIEGL POQ or Applanix `smrmsg`; `*` is the
    /// input's stem. With it, points get a total uncertainty.
    #[schemars(extend("x-file" = "input"))]
    pub trajectory_accuracy: Option<String>,
    /// Orientation of the scanner frame in the body frame: a name, or roll, pitch and yaw in
    /// degrees. Defaults to `level`.
    pub mount: Option<Mount>,
    /// Lever arm, boresight and internal parameters: a table with `lever_arm_m` (forward, right,
    /// down), `boresight_deg` (roll, pitch, yaw), `e0` to `e7` and `time_offset_s` (added to the times of
    /// shots), each 0 by default; or a file that contains them, such as that of `wavex align`.
    #[schemars(extend("x-file" = "input"))]
    pub calibration: Option<CalibrationKey>,
    /// File of corrections of the trajectory: offsets of position and attitude over time for each
    /// recording, as strip adjustment estimates them. Recordings without an entry are not corrected,
    /// with a warning.
    #[schemars(extend("x-file" = "input"))]
    pub corrections: Option<String>,
    /// Coordinate reference system of the points: `utm` (the zone of the first shot), `utm:33N`,
    /// `EPSG:2154`, a file with WKT, `geodetic` (longitude and latitude in degrees), or `ecef`.
    /// Defaults to `utm`.
    #[schemars(extend("x-file" = "input_or_name"))]
    pub crs: Option<String>,
    /// Geoid for heights: name of a file without its extension (`.bin`, `.gtx`), case-insensitive.
    /// By default heights are ellipsoidal.
    #[schemars(extend("x-file" = "geoid"))]
    pub geoid: Option<String>,
    /// Folder of the geoids. Defaults to the input folder. Has no effect without `geoid`.
    #[schemars(extend("x-file" = "geoid_folder"))]
    pub geoid_dir: Option<String>,
    /// Unit of all three coordinates. Defaults to that of the coordinate reference system.
    pub unit: Option<UnitKey>,
}

/// Time scale.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum TimeKey {
    /// Seconds of the GPS week.
    Week,
    /// Seconds of the day.
    Day,
    /// Adjusted GPS time: seconds since 1980-01-06, minus 1e9.
    Adjusted,
    /// Standard GPS time: seconds since 1980-01-06.
    Standard,
    /// Unix time: seconds of UTC since 1970-01-01.
    Unix,
}

/// Height reference.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum HeightsKey {
    /// The geoid of the job.
    Geoid,
    /// The WGS 84 ellipsoid.
    Ellipsoid,
}

/// Use of trajectory records that contradict their neighbours.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum OutliersKey {
    /// Left out, with a warning.
    #[default]
    Exclude,
    /// Used.
    Keep,
}

impl OutliersKey {
    fn is_default(&self) -> bool {
        *self == OutliersKey::Exclude
    }
}

/// Limits of plausible attitudes and motion.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum LimitsKey {
    /// Those of an airplane; its heading is that of its course.
    #[default]
    Airplane,
    /// Those of a helicopter or drone.
    Helicopter,
    /// None.
    None,
}

impl LimitsKey {
    fn is_default(&self) -> bool {
        *self == LimitsKey::Airplane
    }

    /// The limits, if any.
    pub fn limits(self) -> Option<&'static MotionLimits> {
        match self {
            LimitsKey::Airplane => Some(&MotionLimits::AIRPLANE),
            LimitsKey::Helicopter => Some(&MotionLimits::HELICOPTER),
            LimitsKey::None => None,
        }
    }
}

/// Unit of angles.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum AnglesKey {
    /// Degrees.
    Deg,
    /// Radians.
    Rad,
}

/// Unit of coordinates.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum UnitKey {
    /// Metres.
    M,
    /// US survey feet.
    UsFt,
    /// International feet.
    Ft,
}

/// A calibration, or the file that contains it.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum CalibrationKey {
    /// The file.
    File(String),
    /// The calibration itself.
    Inline(Calibration),
}

/// A key, the key it requires, and tests for the presence of both.
type Companion = (&'static str, &'static str, fn(&GeometryKeys) -> bool, fn(&GeometryKeys) -> bool);

const COMPANIONS: [Companion; 9] = [
    ("geometry.trajectory_time", "trajectory", |keys| keys.trajectory_time.is_some(), has_trajectory),
    ("geometry.trajectory_angles", "trajectory", |keys| keys.trajectory_angles.is_some(), has_trajectory),
    ("geometry.trajectory_columns", "trajectory", |keys| keys.trajectory_columns.is_some(), has_trajectory),
    (
        "geometry.trajectory_outliers",
        "trajectory",
        |keys| !keys.trajectory_outliers.is_default(),
        has_trajectory,
    ),
    ("geometry.trajectory_limits", "trajectory", |keys| !keys.trajectory_limits.is_default(), has_trajectory),
    ("geometry.trajectory_accuracy", "trajectory", |keys| keys.trajectory_accuracy.is_some(), has_trajectory),
    ("geometry.trajectory_heights", "trajectory", |keys| keys.trajectory_heights.is_some(), has_trajectory),
    ("geometry.corrections", "trajectory", |keys| keys.corrections.is_some(), has_trajectory),
    (
        "geometry.trajectory_heights",
        "geoid",
        |keys| keys.trajectory_heights == Some(HeightsKey::Geoid),
        |keys| keys.geoid.is_some(),
    ),
];

fn has_trajectory(keys: &GeometryKeys) -> bool {
    keys.trajectory.is_some()
}

impl GeometryKeys {
    /// The keys of the table with their descriptions.
    pub fn keys() -> Keys {
        Keys::of(GeometryKeys::json_schema)
    }

    /// Checks what the types alone cannot.
    ///
    /// # Errors
    /// A key with an invalid value, or without another key that it requires.
    pub fn check(&self) -> Result<(), InvalidKey> {
        for (key, needs, is_given, has_companion) in COMPANIONS {
            if is_given(self) && !has_companion(self) {
                return Err(InvalidKey::new(key, format!("it has no effect without `{needs}`")));
            }
        }
        let is_wrong = |columns: &str, letter: char| match columns.matches(letter).count() {
            0 => letter != 'w',
            count => count > 1,
        };
        if let Some(columns) = &self.trajectory_columns
            && let Some(missing) = "txyzwpk".chars().find(|&letter| is_wrong(columns, letter))
        {
            let problem =
                format!("it must contain `{missing}` once: t, x, y, z, p and k are required, w is the roll");
            return Err(InvalidKey::new("geometry.trajectory_columns", problem));
        }
        Ok(())
    }

    /// Sets omitted keys to their defaults, where these do not depend on data.
    pub fn spell_out(&mut self) {
        self.mount.get_or_insert_default();
        self.calibration.get_or_insert(CalibrationKey::Inline(Calibration::default()));
    }

    /// Warning about keys that a recording with coordinates does not use; `None` in other frames.
    pub fn unused_in(&self, frame: Frame) -> Option<String> {
        let is_map = match frame {
            Frame::Map => true,
            Frame::Earth => false,
            Frame::Scanner | Frame::Body => return None,
        };
        let own = if is_map { "already in a projected CRS" } else { "already georeferenced" };
        // Ranges from the sensor are corrected in the earth-centred frame only.
        let calibration = if is_map { "`calibration`" } else { "the angles and lever arm of `calibration`" };
        let calibrates = match &self.calibration {
            Some(CalibrationKey::Inline(given)) if is_map => *given != Calibration::default(),
            Some(CalibrationKey::Inline(given)) => {
                Calibration { e0: 0.0, e1: 0.0, e7: 0.0, ..*given } != Calibration::default()
            }
            Some(CalibrationKey::File(_)) => true,
            None => false,
        };
        let given = [
            ("`trajectory`", self.trajectory.is_some()),
            ("`corrections`", self.corrections.is_some()),
            ("`mount`", self.turns_scanners()),
            (calibration, calibrates),
        ];
        let unused: Vec<String> =
            given.into_iter().filter(|(_, is_given)| *is_given).map(|(name, _)| name.to_owned()).collect();
        let (are, them) = match unused.as_slice() {
            [] => return None,
            [one] if one != "the angles and lever arm of `calibration`" => ("is", "it"),
            _ => ("are", "them"),
        };
        let names = listed(&unused, "and");
        Some(format!("the recording is {own}: {names} {are} not used; remove {them} from `[job.geometry]`"))
    }

    /// Whether the job has a mount that rotates the scanner axes.
    pub fn turns_scanners(&self) -> bool {
        self.mount.is_some_and(|mount| mount != Mount::default())
    }

    /// Whether the job requests particular output coordinates.
    pub fn wants_coordinates(&self) -> bool {
        self.crs.is_some() || self.geoid.is_some() || self.unit.is_some()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn checked(text: &str) -> Result<(), InvalidKey> {
        toml::from_str::<GeometryKeys>(text).unwrap().check()
    }

    #[test]
    fn a_key_of_no_use_alone_is_refused() {
        for key in [
            "trajectory_time = 'day'",
            "trajectory_angles = 'rad'",
            "trajectory_accuracy = 'a.poq'",
            "corrections = 'c.toml'",
        ] {
            let problem = checked(key).unwrap_err();
            assert_eq!(problem.problem, "it has no effect without `trajectory`", "{key}");
            assert_eq!(checked(&format!("trajectory = 'a.out'\n{key}")), Ok(()));
        }
        let heights = checked("trajectory = 'a.trj'\ntrajectory_heights = 'geoid'").unwrap_err();
        assert_eq!(heights.problem, "it has no effect without `geoid`");
        assert_eq!(checked("trajectory = 'a.trj'\ntrajectory_heights = 'ellipsoid'"), Ok(()));
        // Keys shared by several jobs may give only the folder.
        assert_eq!(checked("geoid_dir = 'g'"), Ok(()));
    }

    #[test]
    fn columns_name_each_quantity_once() {
        let of = |columns: &str| checked(&format!("trajectory = 'a.txt'\ntrajectory_columns = '{columns}'"));
        assert_eq!(of("txyzwpk"), Ok(()));
        assert_eq!(of("t#yx.zwpk"), Ok(()));
        assert_eq!(of("xyztpk"), Ok(()), "the roll is optional");
        let problem = "it must contain `k` once: t, x, y, z, p and k are required, w is the roll";
        assert_eq!(of("txyzwp"), Err(InvalidKey::new("geometry.trajectory_columns", problem)));
        assert!(of("ttxyzwpk").is_err());
    }

    #[test]
    fn keys_that_a_recording_does_not_use_are_named() {
        let unused = |text: &str, frame| toml::from_str::<GeometryKeys>(text).unwrap().unused_in(frame);
        let all = "trajectory = 'a.out'\nmount = 'x_down_z_left'\ncalibration = 'c.toml'";
        let corrected = "trajectory = 'a.out'\ncorrections = 'c.toml'";
        let given = [
            (
                "trajectory = 'a.out'",
                Frame::Map,
                "the recording is already in a projected CRS: `trajectory` is not used; remove it from `[job.geometry]`",
            ),
            (
                all,
                Frame::Map,
                "the recording is already in a projected CRS: `trajectory`, `mount` and `calibration` are not used; \
                 remove them from `[job.geometry]`",
            ),
            (
                corrected,
                Frame::Earth,
                "the recording is already georeferenced: `trajectory` and `corrections` are not used; remove them from \
                 `[job.geometry]`",
            ),
            (
                "calibration = { e0 = 1.0, e2 = 0.1 }",
                Frame::Earth,
                "the recording is already georeferenced: the angles and lever arm of `calibration` are not used; \
                 remove them from `[job.geometry]`",
            ),
        ];
        for (text, frame, expected) in given {
            assert_eq!(unused(text, frame).as_deref(), Some(expected), "{text}");
        }
        assert_eq!(unused("calibration = { e0 = 1.0 }", Frame::Earth), None);
        assert_eq!((unused(all, Frame::Scanner), unused("crs = 'utm'", Frame::Map)), (None, None));
    }

    #[test]
    fn what_is_spelled_out_changes_nothing() {
        let mut keys = GeometryKeys::default();
        keys.spell_out();
        let zero = Calibration::default();
        let expected = GeometryKeys {
            mount: Some(Mount::default()),
            calibration: Some(CalibrationKey::Inline(zero)),
            ..GeometryKeys::default()
        };
        assert_eq!(keys, expected);
        assert_eq!(
            (keys.check(), keys.unused_in(Frame::Map), keys.wants_coordinates()),
            (Ok(()), None, false)
        );
        let given = "mount = 'x_down_z_left'\ncalibration = 'c.toml'";
        let mut keys: GeometryKeys = toml::from_str(given).unwrap();
        let before = keys.clone();
        keys.spell_out();
        assert_eq!((&keys, keys.turns_scanners()), (&before, true));
    }
}
