//! The coordinates that points get.

use std::path::Path;

use super::keys::GeometryKeys;
use crate::geo::ellipsoid::WGS84;
use crate::geo::frames::Vector;
use crate::geo::transverse_mercator::{Parameters, TransverseMercator};
use crate::stage::Result;

/// What the job asks for, as far as it does not depend on the place.
#[derive(Clone, Debug, Default)]
pub struct Wanted {}

/// Coordinates of points.
#[derive(Debug)]
pub struct Target {
    map: TransverseMercator,
}

impl Wanted {
    pub(super) fn load(_keys: &GeometryKeys, _input_dir: &Path) -> Result<Wanted> {
        Ok(Wanted {})
    }

    pub(super) fn at(&self, first_m: Vector) -> std::result::Result<Target, (String, String)> {
        let place = WGS84.geodetic_of(first_m);
        let zone = (place.longitude_rad.to_degrees() / 6.0).floor() as i64 + 31;
        Ok(Target {
            map: TransverseMercator::new(WGS84, Parameters::utm(zone.clamp(1, 60) as u8, place.latitude_rad >= 0.0)),
        })
    }
}

impl Target {
    /// A point's coordinates.
    pub fn from_ecef(&self, ecef_m: Vector) -> Result<Vector> {
        let place = WGS84.geodetic_of(ecef_m);
        let (x, y) = self.map.project(place.latitude_rad, place.longitude_rad);
        Ok([x, y, place.height_m])
    }

    /// What outputs say of them.
    pub fn wkt(&self) -> &str {
        ""
    }

    /// Step and offset of coordinates in degrees.
    pub fn grid(&self) -> Option<([f64; 3], [f64; 3])> {
        None
    }
}
