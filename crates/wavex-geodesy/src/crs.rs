//! Coordinate reference systems: conversion between earth-centred and user coordinates.
//!
//! The earth-centred frames of WGS 84, ITRF, ETRS89, NAD83, GDA and similar are treated as one: no
//! datum shift is applied, and a CRS whose datum needs one is rejected. Geodetic coordinates refer
//! to the CRS's own ellipsoid, WGS 84 or GRS 80, which differ by at most 0.1 mm. Transverse
//! Mercator, Lambert conformal conic, geodetic and earth-centred coordinates are bit-identical on
//! every machine; other projections depend on the system's mathematical library.

mod definition;
mod describe;
mod epsg_table;
mod error;
mod geotiff;
mod methods;
mod named;
mod outline;
#[cfg(feature = "proj")]
mod proj;
mod proj_string;
mod projection;
mod projjson;
mod records;
mod unit;
mod wkt;

use std::sync::Arc;

use super::conformal::EllipsoidNormal;
use super::ellipsoid::{Ellipsoid, Geodetic};
use super::frames::Vector;
use super::geoid::Geoid;
use definition::{Definition, ProjectionMethod};
pub use epsg_table::{AreaOfUse, area_of_epsg, wkt_of_epsg};
pub use error::CrsError;
pub use geotiff::{GeoKeys, geotiff_keys_of_wkt, system_of_geotiff_keys};
pub use named::Named;
use named::utm_zone_at;
pub use outline::Outline;
use projection::Projection;
pub use projjson::projjson_of_wkt;
pub use records::{RecordedSystem, are_contradictory, system_of_wkt, units_of_wkt, with_heights_in_map_unit};
pub use unit::Unit;

/// Number of positions processed together: their intermediate values fit into registers and the
/// first-level cache.
const TOGETHER: usize = 16;

/// Coordinate reference system with its height reference and units.
///
/// # Examples
///
/// ```
/// use wavex_geodesy::crs::{Crs, Named};
/// use wavex_geodesy::ellipsoid::Geodetic;
///
/// let place = Geodetic {
///     latitude_rad: 48.8_f64.to_radians(),
///     longitude_rad: 2.3_f64.to_radians(),
///     height_m: 100.0,
/// };
/// let lambert_93 = Crs::new(&Named::Epsg(2154), place, None, None)?;
/// let [x, y, height_m] = lambert_93.from_geodetic(place)?;
/// assert!((x - 648_583.262).abs() < 1e-3 && (y - 6_855_774.716).abs() < 1e-3);
/// assert_eq!(height_m, 100.0);
/// # Ok::<(), wavex_geodesy::crs::CrsError>(())
/// ```
#[derive(Debug)]
pub struct Crs {
    definition: Definition,
    projection: Projection,
    geoid: Option<Arc<Geoid>>,
    /// Unit of eastings and northings, or of earth-centred coordinates.
    unit: Unit,
    /// Unit of heights.
    height_unit: Unit,
}

impl Crs {
    /// Creates the CRS that `named` names.
    ///
    /// `first_place` determines only the zone of [`Named::Utm`]. With a geoid, heights are above
    /// it, otherwise above the ellipsoid. Coordinates and heights are in `unit` if given. Otherwise
    /// coordinates are in the unit of the CRS, and heights in the unit of its vertical part, or in the
    /// same unit without one.
    ///
    /// # Errors
    /// An unknown code, unreadable text, a datum that needs a shift, an unsupported projection,
    /// heights that need a geoid without one, or earth-centred coordinates with one.
    pub fn new(
        named: &Named,
        first_place: Geodetic,
        geoid: Option<Arc<Geoid>>,
        unit: Option<Unit>,
    ) -> Result<Crs, CrsError> {
        let definition = definition_of(named, first_place).or_else(|refused| by_proj(named, refused))?;
        let projection = Projection::new(&definition)?;
        check_heights(&definition, geoid.as_deref())?;
        let own_height_unit = definition.vertical_unit().unwrap_or_else(|| definition.unit.clone());
        let height_unit = unit.clone().unwrap_or(own_height_unit);
        let unit = unit.unwrap_or_else(|| definition.unit.clone());
        Ok(Crs { definition, projection, geoid, unit, height_unit })
    }

    /// Display name, such as `EPSG:32633 (WGS 84 / UTM zone 33N)`.
    pub fn name(&self) -> &str {
        &self.definition.name
    }

    /// EPSG code of the horizontal part, if it has one.
    pub fn epsg(&self) -> Option<u32> {
        self.definition.epsg
    }

    /// Area of use; `None` if it is unknown or the whole earth.
    pub fn area_of_use(&self) -> Option<AreaOfUse> {
        #[cfg(feature = "proj")]
        if let Projection::Foreign(foreign) = &self.projection
            && let Some(area) = foreign.area_of_use()
        {
            return Some(area);
        }
        area_of_epsg(u16::try_from(self.definition.epsg?).ok()?)
    }

    /// Unit of x and y, or of all earth-centred coordinates. Geodetic coordinates are always in
    /// degrees.
    pub fn unit(&self) -> &Unit {
        &self.unit
    }

    /// Unit of heights.
    pub fn height_unit(&self) -> &Unit {
        &self.height_unit
    }

    /// Geoid to which heights refer; `None` for ellipsoidal heights.
    pub fn geoid(&self) -> Option<&Geoid> {
        self.geoid.as_deref()
    }

    /// Ellipsoid of geodetic coordinates.
    pub fn ellipsoid(&self) -> Ellipsoid {
        self.definition.ellipsoid
    }

    /// Whether coordinates are longitude and latitude, degrees.
    pub fn is_geodetic(&self) -> bool {
        matches!(self.projection, Projection::Geodetic)
    }

    /// Whether coordinates are earth-centred.
    pub fn is_ecef(&self) -> bool {
        matches!(self.projection, Projection::Ecef)
    }

    /// Converts an earth-centred position, m, to coordinates.
    ///
    /// The result is easting, northing, height; or longitude and latitude in degrees and height; or
    /// earth-centred coordinates.
    ///
    /// # Errors
    /// The position cannot be projected, or the geoid has no height there.
    pub fn from_ecef(&self, ecef_m: Vector) -> Result<Vector, CrsError> {
        let [coordinates] = self.of_ecef(&[ecef_m])?;
        Ok(coordinates)
    }

    /// Converts earth-centred positions, m, to coordinates in place.
    ///
    /// Equal to [`Crs::from_ecef`] for each position, and twice as fast.
    ///
    /// # Errors
    /// As [`Crs::from_ecef`], for the first failing position; some positions may already be
    /// converted.
    pub fn replace_ecef(&self, places: &mut [Vector]) -> Result<(), CrsError> {
        let (groups, rest) = places.as_chunks_mut::<TOGETHER>();
        for group in groups {
            *group = self.of_ecef(group)?;
        }
        for place in rest {
            *place = self.from_ecef(*place)?;
        }
        Ok(())
    }

    fn of_ecef<const N: usize>(&self, ecef_m: &[Vector; N]) -> Result<[Vector; N], CrsError> {
        if self.is_ecef() {
            return Ok(ecef_m.map(|place| place.map(|metres| metres / self.unit.metres)));
        }
        let (normals, heights_m) = EllipsoidNormal::through(self.definition.ellipsoid, ecef_m);
        self.of_normals(&normals, &heights_m)
    }

    /// Converts a position on the CRS's ellipsoid to coordinates.
    ///
    /// # Errors
    /// As [`Crs::from_ecef`].
    pub fn from_geodetic(&self, place: Geodetic) -> Result<Vector, CrsError> {
        if self.is_ecef() {
            return self.from_ecef(self.definition.ellipsoid.ecef_of(place));
        }
        let [coordinates] = self.of_normals(&[EllipsoidNormal::from(place)], &[place.height_m])?;
        Ok(coordinates)
    }

    /// Converts coordinates to an earth-centred position, m.
    ///
    /// # Errors
    /// Coordinates outside the projection, or the geoid has no height there.
    pub fn to_ecef(&self, coordinates: Vector) -> Result<Vector, CrsError> {
        if self.is_ecef() {
            return Ok(coordinates.map(|value| value * self.unit.metres));
        }
        Ok(self.definition.ellipsoid.ecef_of(self.to_geodetic(coordinates)?))
    }

    /// Converts coordinates to geodetic ones, with longitude from -π to π.
    ///
    /// # Errors
    /// As [`Crs::to_ecef`].
    pub fn to_geodetic(&self, coordinates: Vector) -> Result<Geodetic, CrsError> {
        if self.is_ecef() {
            return Ok(self.definition.ellipsoid.geodetic_of(self.to_ecef(coordinates)?));
        }
        let [x, y, height] = coordinates;
        let scale = self.horizontal_scale();
        let outside = || CrsError::OutsideMap { name: self.name().into(), x, y };
        let (latitude_rad, longitude_rad) = self
            .projection
            .unproject([x * scale, y * scale], height * self.height_unit.metres)
            .ok_or_else(outside)?;
        let longitude_rad = within_turn(longitude_rad);
        let undulation_m = self.undulation_m(latitude_rad, longitude_rad)?;
        let height_m = height * self.height_unit.metres + undulation_m;
        Ok(Geodetic { latitude_rad, longitude_rad, height_m })
    }

    /// The CRS as WKT 1 (OGC 01-009), as stored in LAS files.
    ///
    /// Has a vertical part if heights refer to a geoid or are not in metres.
    pub fn wkt(&self) -> String {
        describe::wkt(self)
    }

    fn of_normals<const N: usize>(
        &self,
        normals: &[EllipsoidNormal; N],
        heights_m: &[f64; N],
    ) -> Result<[Vector; N], CrsError> {
        let on_map = self.projection.project_each(normals, heights_m);
        let mut coordinates = [[0.0; 3]; N];
        for i in 0..N {
            coordinates[i] = self.of_point(on_map[i], &normals[i], heights_m[i])?;
        }
        Ok(coordinates)
    }

    /// Coordinates from a position and its projection.
    fn of_point(
        &self,
        on_map: Option<[f64; 2]>,
        normal: &EllipsoidNormal,
        height_m: f64,
    ) -> Result<Vector, CrsError> {
        let undulation_m = match &self.geoid {
            None => 0.0,
            Some(geoid) => {
                let (latitude_rad, longitude_rad) = normal.angles_rad();
                geoid.height_m(latitude_rad.to_degrees(), longitude_rad.to_degrees())?
            }
        };
        let Some([x, y]) = on_map else {
            let (latitude_rad, longitude_rad) = normal.angles_rad();
            return Err(CrsError::OutsideProjection {
                name: self.name().into(),
                latitude_deg: latitude_rad.to_degrees(),
                longitude_deg: longitude_rad.to_degrees(),
            });
        };
        let scale = self.horizontal_scale();
        Ok([x / scale, y / scale, (height_m - undulation_m) / self.height_unit.metres])
    }

    fn undulation_m(&self, latitude_rad: f64, longitude_rad: f64) -> Result<f64, CrsError> {
        match &self.geoid {
            None => Ok(0.0),
            Some(geoid) => Ok(geoid.height_m(latitude_rad.to_degrees(), longitude_rad.to_degrees())?),
        }
    }

    /// Size of the projection's unit in units of x and y: metres or degrees, or the CRS's own unit
    /// with PROJ.
    fn horizontal_scale(&self) -> f64 {
        match self.projection {
            Projection::Geodetic => 1.0,
            #[cfg(feature = "proj")]
            Projection::Foreign(_) => self.unit.metres / self.definition.unit.metres,
            _ => self.unit.metres,
        }
    }
}

fn definition_of(named: &Named, first_place: Geodetic) -> Result<Definition, CrsError> {
    let utm =
        |zone: u8, north: bool| Definition::of_epsg(if north { 32600 } else { 32700 } + u32::from(zone));
    match named {
        Named::Utm => utm(utm_zone_at(first_place.longitude_rad), first_place.latitude_rad >= 0.0),
        Named::UtmZone { zone, north } => utm(*zone, *north),
        Named::Epsg(code) => Definition::of_epsg(*code),
        Named::Wkt(text) => Definition::of_wkt(text),
        Named::Geodetic => Definition::of_epsg(4326),
        Named::Ecef => Definition::of_epsg(4978),
    }
}

/// Falls back to PROJ, if built in, for a rejected CRS.
///
/// Not for missing parameters, which PROJ would take as zeros.
#[cfg(feature = "proj")]
fn by_proj(named: &Named, refused: CrsError) -> Result<Definition, CrsError> {
    let found = match named {
        _ if matches!(refused, CrsError::Incomplete { .. }) => None,
        Named::Epsg(code) => definition::of_proj(&format!("EPSG:{code}")),
        Named::Wkt(text) => definition::of_proj(text),
        _ => None,
    };
    found.ok_or(refused)
}

#[cfg(not(feature = "proj"))]
fn by_proj(_: &Named, refused: CrsError) -> Result<Definition, CrsError> {
    Err(refused)
}

/// Checks that geoid and vertical part match: heights above a geoid need one, earth-centred
/// coordinates have no heights.
fn check_heights(definition: &Definition, geoid: Option<&Geoid>) -> Result<(), CrsError> {
    match (geoid, definition.vertical_name()) {
        (Some(geoid), _) if definition.method == ProjectionMethod::Ecef => Err(CrsError::Unsupported {
            name: definition.name.clone(),
            problem: format!(
                "earth-centred coordinates have no height to which the geoid {} could apply",
                geoid.name()
            ),
            remedy: "remove the geoid, or choose a projected or geodetic system",
        }),
        (None, Some(vertical)) => Err(CrsError::NoGeoid { name: definition.name.clone(), vertical }),
        _ => Ok(()),
    }
}

/// Reduces an angle to the range -π to π.
fn within_turn(angle_rad: f64) -> f64 {
    const TURN_RAD: f64 = 2.0 * core::f64::consts::PI;
    if angle_rad.abs() <= core::f64::consts::PI {
        return angle_rad;
    }
    angle_rad - TURN_RAD * (angle_rad / TURN_RAD).round()
}

#[cfg(test)]
mod tests;
