//! Output coordinate reference system of points.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::area_of_use::outside_of_output;
use super::keys::{GeometryKeys, UnitKey};
use super::{Error as GeorefError, Result};
use crate::keys::InvalidKey;
use wavex_formats::{geoid, read_small_text};
use wavex_geodesy::crs::{Crs, CrsError, Named, Unit};
use wavex_geodesy::ellipsoid::{Geodetic, WGS84};
use wavex_geodesy::frames::Vector;
use wavex_geodesy::geoid::{Geoid, GeoidError};

/// The requested CRS, as far as it does not depend on the position.
#[derive(Clone, Debug)]
pub struct CrsRequest {
    named: Named,
    geoid: Option<Arc<Geoid>>,
    unit: Option<Unit>,
}

/// The output CRS of a recording.
#[derive(Debug)]
pub struct OutputCrs {
    crs: Crs,
    wkt: String,
    first_place: Geodetic,
}

/// Size limit of WKT, bytes.
pub const MOST_WKT_BYTES: u64 = 1_000_000;
/// Coordinate step of longitudes and latitudes, degrees: about 1 mm.
const DEGREES_STEP: f64 = 1e-8;
/// Coordinate step of heights and of projected coordinates.
const LENGTH_STEP: f64 = 1e-3;
/// Tolerance within which a point has the same coordinates in two CRSs, in their unit.
const SAME: f64 = 1e-3;
/// Position for CRSs that do not depend on it.
pub(super) const ANYWHERE: Geodetic = Geodetic { latitude_rad: 0.0, longitude_rad: 0.0, height_m: 0.0 };

impl Default for CrsRequest {
    /// UTM in the zone of the first shot, metres, ellipsoidal heights.
    fn default() -> CrsRequest {
        CrsRequest { named: Named::Utm, geoid: None, unit: None }
    }
}

impl CrsRequest {
    /// Reads the keys and the files they name; reports an unusable CRS before the run starts.
    pub(super) fn load(keys: &GeometryKeys, input_dir: &Path) -> Result<CrsRequest> {
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
        let wanted = CrsRequest { named, geoid, unit };
        wanted.crs(ANYWHERE).map_err(|source| GeorefError::Crs { file, source })?;
        Ok(wanted)
    }

    /// This CRS with ellipsoidal heights.
    pub(super) fn of(named: Named) -> CrsRequest {
        CrsRequest { named, ..CrsRequest::default() }
    }

    /// Geoid height above the ellipsoid, m; 0 without a geoid.
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

    /// The CRS, if it does not depend on the first shot.
    pub(super) fn fixed(&self) -> Option<Crs> {
        if self.named == Named::Utm { None } else { self.crs(ANYWHERE).ok() }
    }

    /// The CRS, if it is requested by a code or as WKT: its name matters, not only its coordinates.
    pub(super) fn by_name(&self) -> Option<Crs> {
        matches!(self.named, Named::Epsg(_) | Named::Wkt(_)).then(|| self.crs(ANYWHERE).ok()).flatten()
    }

    /// The CRS of an EPSG code, with the same height reference.
    pub(super) fn in_map(&self, code: u16) -> CrsRequest {
        CrsRequest { named: Named::Epsg(code.into()), geoid: self.geoid.clone(), unit: None }
    }

    /// The CRS for a recording whose first shot is at this earth-centred position, m.
    pub(super) fn at(&self, first_m: Vector) -> Result<OutputCrs> {
        let first_place = WGS84.geodetic_of(first_m);
        let crs = self.crs(first_place)?;
        Ok(OutputCrs { wkt: crs.wkt(), crs, first_place })
    }

    /// Whether this CRS is equivalent to the CRS of a recording, judged by one point.
    pub(super) fn is_map(&self, wkt: &str, point: Vector) -> bool {
        let same = || {
            let map = |geoid| Crs::new(&Named::Wkt(wkt.to_owned()), ANYWHERE, geoid, None);
            // Heights of a vertical system need a geoid.
            let map = map(None).or_else(|_| map(self.geoid.clone()))?;
            let place = map.to_geodetic(point)?;
            self.crs(place)?.from_geodetic(place)
        };
        same().is_ok_and(|found| found.iter().zip(point).all(|(a, b)| (a - b).abs() < SAME))
    }
}

/// The coordinate system named by the keys, and its file if it is WKT.
fn named(keys: &GeometryKeys, input_dir: &Path) -> Result<(Named, Option<PathBuf>)> {
    let Some(word) = &keys.crs else { return Ok((Named::Utm, None)) };
    match Named::parse(word)? {
        Some(named) => Ok((named, None)),
        None => {
            let file = input_dir.join(word);
            if is_name(word) && !file.exists() {
                let problem = "it is neither a known system nor a file";
                return Err(CrsError::Word { word: word.clone(), problem }.into());
            }
            Ok((Named::Wkt(read_wkt(&file)?), Some(file)))
        }
    }
}

/// Whether a word looks like the name of a system, not like a path: no folder and no extension.
fn is_name(word: &str) -> bool {
    !word.contains(['/', '\\']) && Path::new(word).extension().is_none()
}

/// Checks the key `crs`, except a file.
///
/// # Errors
/// A name that is not a CRS, or a system that cannot be computed.
pub fn check_crs_name(keys: &GeometryKeys) -> std::result::Result<(), InvalidKey> {
    let check = |word: &String| match Named::parse(word)? {
        Some(named) => Crs::new(&named, ANYWHERE, None, None).map(drop),
        None => Ok(()),
    };
    let checked = keys.crs.as_ref().map_or(Ok(()), check);
    checked.map_err(|error: CrsError| InvalidKey::new("geometry.crs", error.to_string()))
}

/// Checks the coordinate reference system of a job.
///
/// A missing WKT file passes, because it may exist at the time of the run.
///
/// # Errors
/// A system that cannot be computed. The message names its file and the missing or unsupported part.
pub fn check_crs(keys: &GeometryKeys, input_dir: &Path) -> Result<()> {
    let is_missing = |word: &String| {
        matches!(Named::parse(word), Ok(None)) && !is_name(word) && !input_dir.join(word).is_file()
    };
    if keys.crs.as_ref().is_some_and(is_missing) {
        return Ok(());
    }
    let (named, file) = named(keys, input_dir)?;
    Crs::new(&named, ANYWHERE, None, None).map_err(|source| GeorefError::Crs { file, source })?;
    Ok(())
}

pub(super) fn read_wkt(path: &Path) -> Result<String> {
    let remedy = "give the .prj or .wkt file of a coordinate reference system";
    Ok(read_small_text(path, MOST_WKT_BYTES, "WKT", remedy)?)
}

impl OutputCrs {
    /// Coordinates of an earth-centred position, m.
    ///
    /// # Errors
    /// A point that cannot be projected, or outside the geoid; the message names it.
    pub fn coordinates(&self, ecef_m: Vector) -> Result<Vector> {
        Ok(self.crs.from_ecef(ecef_m)?)
    }

    /// Converts earth-centred positions, m, to coordinates in place.
    ///
    /// # Errors
    /// As [`OutputCrs::coordinates`].
    pub fn replace(&self, ecef_m: &mut [Vector]) -> Result<()> {
        Ok(self.crs.replace_ecef(ecef_m)?)
    }

    /// WKT 1 for outputs, with a vertical part for heights above a geoid.
    pub fn wkt(&self) -> &str {
        &self.wkt
    }

    /// Display name.
    pub fn name(&self) -> &str {
        self.crs.name()
    }

    /// A warning if the first shot is outside the area of use of the CRS.
    pub fn outside_area(&self) -> Option<String> {
        outside_of_output(&self.crs, self.first_place)
    }

    /// Step and offset for integer coordinates, if they are in degrees.
    pub fn grid(&self) -> Option<([f64; 3], [f64; 3])> {
        let offset = [self.first_place.longitude_rad, self.first_place.latitude_rad]
            .map(|rad| rad.to_degrees().round());
        let [longitude, latitude] = offset;
        self.crs
            .is_geodetic()
            .then_some(([DEGREES_STEP, DEGREES_STEP, LENGTH_STEP], [longitude, latitude, 0.0]))
    }
}
