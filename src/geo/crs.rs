//! Coordinate reference systems: from the earth-centred frame to a user's coordinates and back.
//!
//! The earth-centred frames of WGS 84, ITRF, ETRS89, NAD83, GDA and their kind are taken as one: no datum shift is applied,
//! and a system whose datum needs one is refused. Geodetic coordinates are those on the system's own ellipsoid, WGS 84 or
//! GRS 80, which differ by at most 0.1 mm. Transverse Mercator, Lambert's conformal conic, geodetic and earth-centred
//! coordinates have the same bits on every machine; other projections follow the system's mathematical library.

mod definition;
mod describe;
mod error;
mod geotiff;
mod methods;
mod named;
#[cfg(feature = "proj")]
mod proj;
mod projection;
mod unit;
mod wkt;

use std::sync::Arc;

use super::conformal::Normal;
use super::ellipsoid::{Ellipsoid, Geodetic};
use super::frames::Vector;
use super::geoid::Geoid;
use definition::{Definition, Method};
pub use error::CrsError;
pub use geotiff::{GeoKeys, geotiff_keys_of_wkt};
pub use named::{Named, utm_zone_at};
use projection::Projection;
pub use unit::Unit;

/// Places that are worked on at a time: as many as let the processor's registers and nearest memory hold all steps.
const TOGETHER: usize = 16;

/// A coordinate reference system, with its heights and its unit.
#[derive(Debug)]
pub struct Crs {
    definition: Definition,
    projection: Projection,
    geoid: Option<Arc<Geoid>>,
    /// Of eastings and northings, or of earth-centred coordinates.
    unit: Unit,
    /// Of heights.
    height_unit: Unit,
}

impl Crs {
    /// The system that `named` names.
    ///
    /// `first_place` decides the zone of [`Named::Utm`] and nothing else. With a geoid, heights are above it, else above
    /// the ellipsoid. Coordinates and heights are in `unit`, where given; else coordinates in that of the system, and
    /// heights in that of its vertical part, or the same where it has none.
    ///
    /// # Errors
    /// An unknown code, a text that cannot be read, a datum that needs a shift, a projection that is not supported,
    /// heights over a geoid without one, or earth-centred coordinates with one.
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

    /// For people: `EPSG:32633 (WGS 84 / UTM zone 33N)`.
    pub fn name(&self) -> &str {
        &self.definition.name
    }

    /// The code of EPSG for the horizontal part, where it has one.
    pub fn epsg(&self) -> Option<u32> {
        self.definition.epsg
    }

    /// The unit of x and y, or of all three earth-centred coordinates. Geodetic ones are in degrees, whatever this says.
    pub fn unit(&self) -> &Unit {
        &self.unit
    }

    /// The unit of heights.
    pub fn height_unit(&self) -> &Unit {
        &self.height_unit
    }

    /// The geoid from which heights count, else they count from the ellipsoid.
    pub fn geoid(&self) -> Option<&Geoid> {
        self.geoid.as_deref()
    }

    /// The ellipsoid of geodetic coordinates.
    pub fn ellipsoid(&self) -> Ellipsoid {
        self.definition.ellipsoid
    }

    /// Coordinates are longitude and latitude, degrees.
    pub fn is_geodetic(&self) -> bool {
        matches!(self.projection, Projection::Geodetic)
    }

    /// Coordinates are earth-centred.
    pub fn is_ecef(&self) -> bool {
        matches!(self.projection, Projection::Ecef)
    }

    /// The coordinates of a place in the earth-centred frame, m: easting, northing, height; or longitude and latitude in
    /// degrees and height; or earth-centred ones.
    ///
    /// # Errors
    /// The place cannot be projected, or the geoid has no height there.
    pub fn from_ecef(&self, ecef_m: Vector) -> Result<Vector, CrsError> {
        let [coordinates] = self.of_ecef(&[ecef_m])?;
        Ok(coordinates)
    }

    /// Puts the coordinates of places in the earth-centred frame, m, where the places stood: the same as one by one, and
    /// twice as fast.
    ///
    /// # Errors
    /// As [`Crs::from_ecef`], of the first place that has one; then some places may have coordinates already.
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
        let (normals, heights_m) = Normal::through_each(self.definition.ellipsoid, ecef_m);
        self.of_normals(&normals, &heights_m)
    }

    /// The coordinates of a place given on the system's ellipsoid.
    ///
    /// # Errors
    /// As [`Crs::from_ecef`].
    pub fn from_geodetic(&self, place: Geodetic) -> Result<Vector, CrsError> {
        if self.is_ecef() {
            return self.from_ecef(self.definition.ellipsoid.ecef_of(place));
        }
        let [coordinates] = self.of_normals(&[Normal::from(place)], &[place.height_m])?;
        Ok(coordinates)
    }

    /// The place in the earth-centred frame, m, of coordinates.
    ///
    /// # Errors
    /// There is no such point on the map, or the geoid has no height there.
    pub fn to_ecef(&self, coordinates: Vector) -> Result<Vector, CrsError> {
        if self.is_ecef() {
            return Ok(coordinates.map(|value| value * self.unit.metres));
        }
        Ok(self.definition.ellipsoid.ecef_of(self.to_geodetic(coordinates)?))
    }

    /// The place on the system's ellipsoid of coordinates, its longitude between -π and π.
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

    /// The system as WKT 1 (OGC 01-009), as LAS files hold it; with its vertical part where heights count from a geoid or
    /// are not in metres.
    pub fn wkt(&self) -> String {
        describe::wkt(self)
    }

    /// The system as GeoTIFF keys, as LAS files before version 1.4 hold it; `None` where they have no words for it.
    pub fn geotiff_keys(&self) -> Option<GeoKeys> {
        geotiff::keys(self)
    }

    fn of_normals<const N: usize>(
        &self,
        normals: &[Normal; N],
        heights_m: &[f64; N],
    ) -> Result<[Vector; N], CrsError> {
        let on_map = self.projection.project_each(normals, heights_m);
        let mut coordinates = [[0.0; 3]; N];
        for i in 0..N {
            coordinates[i] = self.of_point(on_map[i], &normals[i], heights_m[i])?;
        }
        Ok(coordinates)
    }

    /// Coordinates of a place and what the projection says of it.
    fn of_point(&self, on_map: Option<[f64; 2]>, normal: &Normal, height_m: f64) -> Result<Vector, CrsError> {
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

    /// What the projection gives per unit of x and y: metres or degrees, or the own unit of a system of PROJ.
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

/// What the pure part refuses, by PROJ, where this build has it; but for parameters that are missing, which PROJ takes as
/// zeros.
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

/// Heights over a geoid need one, and earth-centred coordinates have no heights.
fn check_heights(definition: &Definition, geoid: Option<&Geoid>) -> Result<(), CrsError> {
    match (geoid, definition.vertical_name()) {
        (Some(geoid), _) if definition.method == Method::Ecef => Err(CrsError::Unsupported {
            name: definition.name.clone(),
            problem: format!(
                "earth-centred coordinates have no height that the geoid {} could change",
                geoid.name()
            ),
            remedy: "leave the geoid out, or choose a projected or geodetic system",
        }),
        (None, Some(vertical)) => Err(CrsError::NoGeoid { name: definition.name.clone(), vertical }),
        _ => Ok(()),
    }
}

/// An angle of which every turn is the same, between -π and π.
fn within_turn(angle_rad: f64) -> f64 {
    const TURN_RAD: f64 = 2.0 * core::f64::consts::PI;
    if angle_rad.abs() <= core::f64::consts::PI {
        return angle_rad;
    }
    angle_rad - TURN_RAD * (angle_rad / TURN_RAD).round()
}

#[cfg(test)]
mod tests;
