//! The keys of `[job.geometry]`.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::calibration::Calibration;
use super::mount::Mount;
use crate::stage::{InvalidKey, Keys};

/// The table `[job.geometry]`: where the scanner was, how it is mounted, and in which coordinates points come out.
///
/// `docs/explanation/georeferencing.md` has the formulas. Relative paths start where inputs do.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct GeometryKeys {
    /// The file of positions and attitudes: SBET, POF, SOL, TRJ or columns of text, told apart by what is in it; `*` is the
    /// input's stem. Shots of the scanner's or the aircraft's frame get their pose from it.
    #[schemars(extend("x-file" = "input"))]
    pub trajectory: Option<String>,
    /// What the times of the trajectory count, where its format does not say it.
    pub trajectory_time: Option<TimeKey>,
    /// The unit of the trajectory's angles, where its format does not say it.
    pub trajectory_angles: Option<AnglesKey>,
    /// The columns of a trajectory in text, a letter each: `t` time, `x` longitude, `y` latitude, `z` height above the
    /// ellipsoid, `w` roll, `p` pitch, `k` heading; any other letter passes a column over. Without `w` the roll is 0, with a warning.
    #[schemars(extend("x-file" = "none"))]
    pub trajectory_columns: Option<String>,
    /// What the trajectory's heights count from. When not given: the ellipsoid; but the job's geoid, where there is one, for
    /// a TRJ, which does not say it.
    pub trajectory_heights: Option<HeightsKey>,
    /// The file of the trajectory's standard deviations: RIEGL's POQ or Applanix' `smrmsg`; `*` is the input's stem. With it
    /// points have a total uncertainty.
    #[schemars(extend("x-file" = "input"))]
    pub trajectory_accuracy: Option<String>,
    /// How the scanner's frame stands in the aircraft: a name, or roll, pitch and yaw in degrees; `level` when not given.
    pub mount: Option<Mount>,
    /// Lever arm, boresight and internal parameters: a table with `lever_arm_m` (forward, right, down), `boresight_deg` (roll,
    /// pitch, yaw) and `e0` to `e7`, each 0 when not given; or a file that holds them.
    #[schemars(extend("x-file" = "input"))]
    pub calibration: Option<CalibrationKey>,
    /// The coordinates of the points: `utm` (the zone of the first shot), `utm:33N`, `EPSG:2154`, a file with WKT,
    /// `geodetic` (longitude and latitude in degrees), or `ecef`; `utm` when not given.
    #[schemars(extend("x-file" = "input_or_name"))]
    pub crs: Option<String>,
    /// The geoid that heights are to count from: the name of a file without its extension (`.bin`, `.gtx`), in any case;
    /// above the ellipsoid when not given.
    #[schemars(extend("x-file" = "geoid"))]
    pub geoid: Option<String>,
    /// Where geoids lie; the folder of inputs when not given. Without `geoid` it has no effect.
    #[schemars(extend("x-file" = "geoid_folder"))]
    pub geoid_dir: Option<String>,
    /// The unit of all three coordinates; that of the coordinate reference system when not given.
    pub unit: Option<UnitKey>,
}

/// What times count.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum TimeKey {
    /// Seconds of the GPS week.
    Week,
    /// Seconds of the day.
    Day,
    /// Seconds since 1980-01-06 minus 1e9.
    Adjusted,
}

/// What heights count from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum HeightsKey {
    /// The geoid that the job names.
    Geoid,
    /// The ellipsoid of WGS 84.
    Ellipsoid,
}

/// The unit of angles.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum AnglesKey {
    /// Degrees.
    Deg,
    /// Radians.
    Rad,
}

/// The unit of coordinates.
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

/// A calibration, or the file that holds it.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum CalibrationKey {
    /// The file.
    File(String),
    /// The calibration itself.
    Inline(Calibration),
}

/// What a key is of no use without.
type Companion = (&'static str, &'static str, fn(&GeometryKeys) -> bool, fn(&GeometryKeys) -> bool);

const COMPANIONS: [Companion; 6] = [
    ("geometry.trajectory_time", "trajectory", |keys| keys.trajectory_time.is_some(), has_trajectory),
    ("geometry.trajectory_angles", "trajectory", |keys| keys.trajectory_angles.is_some(), has_trajectory),
    ("geometry.trajectory_columns", "trajectory", |keys| keys.trajectory_columns.is_some(), has_trajectory),
    ("geometry.trajectory_accuracy", "trajectory", |keys| keys.trajectory_accuracy.is_some(), has_trajectory),
    ("geometry.trajectory_heights", "trajectory", |keys| keys.trajectory_heights.is_some(), has_trajectory),
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
    /// The keys of the table with their meaning.
    pub fn keys() -> Keys {
        Keys::of(GeometryKeys::json_schema)
    }

    /// What the types alone cannot say of the keys.
    ///
    /// # Errors
    /// A key whose value cannot be used, or that is of no use without another.
    pub fn check(&self) -> Result<(), InvalidKey> {
        for (key, needs, is_given, has_companion) in COMPANIONS {
            if is_given(self) && !has_companion(self) {
                return Err(InvalidKey::new(key, format!("it is of no use without `{needs}`")));
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
                format!("`{missing}` must stand in it once: t, x, y, z, p and k are needed, w is the roll");
            return Err(InvalidKey::new("geometry.trajectory_columns", problem));
        }
        if let Some(CalibrationKey::Inline(calibration)) = &self.calibration {
            calibration.check().map_err(|problem| InvalidKey::new("geometry.calibration", problem))?;
        }
        if let Some(Mount::Angles(degrees)) = self.mount {
            let whole = degrees.iter().all(|angle| angle.abs() <= 360.0);
            InvalidKey::unless(whole, "geometry.mount", "must be three angles of at most 360 degrees")?;
        }
        Ok(())
    }

    /// Gives the keys that are not given, and whose defaults hang on no data, the values that count in their place.
    pub fn spell_out(&mut self) {
        self.mount.get_or_insert_default();
        self.calibration.get_or_insert(CalibrationKey::Inline(Calibration::default()));
    }

    /// Whether the job says where scanners are.
    pub fn places_scanners(&self) -> bool {
        let none = CalibrationKey::Inline(Calibration::default());
        self.trajectory.is_some()
            || self.turns_scanners()
            || self.calibration.as_ref().is_some_and(|calibration| *calibration != none)
    }

    /// Whether the job has a mount that leaves axes other than they are.
    pub fn turns_scanners(&self) -> bool {
        self.mount.is_some_and(|mount| mount != Mount::default())
    }

    /// Whether the job asks for coordinates of a kind.
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
        for key in ["trajectory_time = 'day'", "trajectory_angles = 'rad'", "trajectory_accuracy = 'a.poq'"] {
            let problem = checked(key).unwrap_err();
            assert_eq!(problem.problem, "it is of no use without `trajectory`", "{key}");
            assert_eq!(checked(&format!("trajectory = 'a.out'\n{key}")), Ok(()));
        }
        let heights = checked("trajectory = 'a.trj'\ntrajectory_heights = 'geoid'").unwrap_err();
        assert_eq!(heights.problem, "it is of no use without `geoid`");
        assert_eq!(checked("trajectory = 'a.trj'\ntrajectory_heights = 'ellipsoid'"), Ok(()));
        // What several jobs share may name the folder alone.
        assert_eq!(checked("geoid_dir = 'g'"), Ok(()));
    }

    #[test]
    fn columns_name_each_quantity_once() {
        let of = |columns: &str| checked(&format!("trajectory = 'a.txt'\ntrajectory_columns = '{columns}'"));
        assert_eq!(of("txyzwpk"), Ok(()));
        assert_eq!(of("t#yx.zwpk"), Ok(()));
        assert_eq!(of("xyztpk"), Ok(()), "the roll may be missing");
        let problem = "`k` must stand in it once: t, x, y, z, p and k are needed, w is the roll";
        assert_eq!(of("txyzwp"), Err(InvalidKey::new("geometry.trajectory_columns", problem)));
        assert!(of("ttxyzwpk").is_err());
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
        assert_eq!((keys.check(), keys.places_scanners(), keys.wants_coordinates()), (Ok(()), false, false));
        let given = "mount = 'x_down_z_left'\ncalibration = 'c.toml'";
        let mut keys: GeometryKeys = toml::from_str(given).unwrap();
        let before = keys.clone();
        keys.spell_out();
        assert_eq!((&keys, keys.turns_scanners(), keys.places_scanners()), (&before, true, true));
    }

    #[test]
    fn lengths_and_angles_have_limits() {
        let error = checked("calibration = { lever_arm_m = [0.0, 0.0, 1000.0] }").unwrap_err();
        assert_eq!(
            (error.key, error.problem.as_str()),
            ("geometry.calibration", "`lever_arm_m` must be three lengths of at most 100 m")
        );
        let error = checked("mount = [0, 0, 361]").unwrap_err();
        assert_eq!(error, InvalidKey::new("geometry.mount", "must be three angles of at most 360 degrees"));
    }
}
