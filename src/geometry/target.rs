//! The coordinates that points get.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::keys::{GeometryKeys, UnitKey};
use crate::formats::{Error, geoid};
use crate::geo::crs::{Crs, CrsError, Named, Unit};
use crate::geo::ellipsoid::{Geodetic, WGS84};
use crate::geo::frames::Vector;
use crate::geo::geoid::{Geoid, GeoidError};
use crate::stage::{Result, StageError};

/// What the job asks for, as far as it does not depend on the place.
#[derive(Clone, Debug)]
pub struct Wanted {
    named: Named,
    geoid: Option<Arc<Geoid>>,
    unit: Option<Unit>,
}

/// Coordinates of points.
#[derive(Debug)]
pub struct Target {
    crs: Crs,
    wkt: String,
    first_place: Geodetic,
}

/// A text of WKT that is longer is none.
const MOST_WKT_BYTES: u64 = 1_000_000;
/// Step of longitudes and latitudes in degrees: a millimetre.
const DEGREES_STEP: f64 = 1e-8;
/// Step of heights and of all coordinates that are lengths.
const LENGTH_STEP: f64 = 1e-3;
/// Two systems are one where a point has the same coordinates in both within this, in their unit.
const SAME: f64 = 1e-3;
/// A place for systems that are the same everywhere.
pub(super) const ANYWHERE: Geodetic = Geodetic { latitude_rad: 0.0, longitude_rad: 0.0, height_m: 0.0 };

impl Default for Wanted {
    /// UTM in the zone of the first shot, metres, heights above the ellipsoid.
    fn default() -> Wanted {
        Wanted { named: Named::Utm, geoid: None, unit: None }
    }
}

impl Wanted {
    /// What the keys say, with the files that they name; a system that is none is found here, and not after hours.
    pub(super) fn load(keys: &GeometryKeys, input_dir: &Path) -> Result<Wanted> {
        let (named, file) = named(keys, input_dir)?;
        let geoid = match &keys.geoid {
            None => None,
            Some(name) => {
                let folder =
                    keys.geoid_dir.as_ref().map_or(input_dir.to_path_buf(), |dir| input_dir.join(dir));
                Some(Arc::new(geoid::find(&folder, name)?))
            }
        };
        let unit = keys.unit.map(|unit| match unit {
            UnitKey::M => Unit::metre(),
            UnitKey::UsFt => Unit::us_survey_foot(),
            UnitKey::Ft => Unit::foot(),
        });
        let wanted = Wanted { named, geoid, unit };
        wanted.crs(ANYWHERE).map_err(|error| unusable(&error, file.as_deref()))?;
        Ok(wanted)
    }

    /// This system, and heights above the ellipsoid.
    pub(super) fn of(named: Named) -> Wanted {
        Wanted { named, ..Wanted::default() }
    }

    /// The height of the geoid above the ellipsoid, m; 0 where the job has none.
    pub(super) fn undulation_m(
        &self,
        latitude_deg: f64,
        longitude_deg: f64,
    ) -> std::result::Result<f64, GeoidError> {
        self.geoid.as_ref().map_or(Ok(0.0), |geoid| geoid.height_m(latitude_deg, longitude_deg))
    }

    fn crs(&self, first_place: Geodetic) -> std::result::Result<Crs, CrsError> {
        Crs::new(&self.named, first_place, self.geoid.clone(), self.unit.clone())
    }

    /// The system, where it is the same wherever the first shot is.
    pub(super) fn fixed(&self) -> Option<Crs> {
        if self.named == Named::Utm { None } else { self.crs(ANYWHERE).ok() }
    }

    /// The same heights in the map, and its unit, of a code of EPSG.
    pub(super) fn in_map(&self, code: u16) -> Wanted {
        Wanted { named: Named::Epsg(code.into()), geoid: self.geoid.clone(), unit: None }
    }

    /// The system for a recording whose first shot is here, m in the earth's frame.
    pub(super) fn at(&self, first_m: Vector) -> Result<Target> {
        let first_place = WGS84.geodetic_of(first_m);
        let crs = self.crs(first_place).map_err(|error| failed(&error))?;
        Ok(Target { wkt: crs.wkt(), crs, first_place })
    }

    /// Whether a point of a map has the same coordinates here: whether this is the map that a recording is in already.
    pub(super) fn is_map(&self, wkt: &str, point: Vector) -> bool {
        let same = || {
            let map = Crs::new(&Named::Wkt(wkt.to_owned()), ANYWHERE, None, None)?;
            let place = map.to_geodetic(point)?;
            self.crs(place)?.from_geodetic(place)
        };
        same().is_ok_and(|found| found.iter().zip(point).all(|(a, b)| (a - b).abs() < SAME))
    }
}

/// The system that the keys name, and its file where it is WKT.
fn named(keys: &GeometryKeys, input_dir: &Path) -> Result<(Named, Option<PathBuf>)> {
    let Some(word) = &keys.crs else { return Ok((Named::Utm, None)) };
    match Named::parse(word).map_err(|error| failed(&error))? {
        Some(named) => Ok((named, None)),
        None => {
            let file = input_dir.join(word);
            Ok((Named::Wkt(read_wkt(&file)?), Some(file)))
        }
    }
}

fn unusable(error: &CrsError, file: Option<&Path>) -> StageError {
    match file {
        Some(file) => failed(&format_args!("{}: {error}", file.display())),
        None => failed(error),
    }
}

/// Checks the coordinate reference system of a job.
///
/// A WKT file that does not exist passes: it may be there by the time of the run.
///
/// # Errors
/// A system that cannot be computed: the message names its file and what is missing or not understood.
pub fn check_crs(keys: &GeometryKeys, input_dir: &Path) -> Result<()> {
    let is_missing =
        |word: &String| matches!(Named::parse(word), Ok(None)) && !input_dir.join(word).is_file();
    if keys.crs.as_ref().is_some_and(is_missing) {
        return Ok(());
    }
    let (named, file) = named(keys, input_dir)?;
    Crs::new(&named, ANYWHERE, None, None).map_err(|error| unusable(&error, file.as_deref()))?;
    Ok(())
}

pub(super) fn read_wkt(path: &Path) -> Result<String> {
    let bytes = std::fs::metadata(path).map_err(Error::io(path, "open the WKT of `crs`"))?.len();
    if bytes > MOST_WKT_BYTES {
        let problem = format!("{bytes} bytes are too many for WKT");
        return Err(Error::unusable(
            path,
            problem,
            "give the .prj or .wkt file of a coordinate reference system",
        )
        .into());
    }
    Ok(std::fs::read_to_string(path).map_err(Error::io(path, "read the WKT of `crs`"))?)
}

impl Target {
    /// The coordinates of a place in the earth's frame, m.
    ///
    /// # Errors
    /// A point that cannot be projected, or of which the geoid says nothing; the message names it.
    pub fn coordinates(&self, ecef_m: Vector) -> Result<Vector> {
        self.crs.from_ecef(ecef_m).map_err(|error| failed(&error))
    }

    /// Puts the coordinates of places in the earth's frame, m, where the places stood.
    ///
    /// # Errors
    /// As [`Target::coordinates`].
    pub fn replace(&self, ecef_m: &mut [Vector]) -> Result<()> {
        self.crs.replace_ecef(ecef_m).map_err(|error| failed(&error))
    }

    /// What outputs say of them: WKT 1, with the vertical part where heights count from a geoid.
    pub fn wkt(&self) -> &str {
        &self.wkt
    }

    /// For people.
    pub fn name(&self) -> &str {
        self.crs.name()
    }

    /// Step and offset with which integers hold the coordinates, where they are degrees.
    pub fn grid(&self) -> Option<([f64; 3], [f64; 3])> {
        let offset = [self.first_place.longitude_rad, self.first_place.latitude_rad]
            .map(|rad| rad.to_degrees().round());
        let [longitude, latitude] = offset;
        self.crs
            .is_geodetic()
            .then_some(([DEGREES_STEP, DEGREES_STEP, LENGTH_STEP], [longitude, latitude, 0.0]))
    }
}

/// An error of `geo`, whose words are problem and remedy.
pub(super) fn failed(error: &dyn std::fmt::Display) -> StageError {
    let text = error.to_string();
    let (problem, remedy) = text.split_once("; ").unwrap_or((&text, "check `[job.geometry]`"));
    StageError::failed(problem, remedy)
}
