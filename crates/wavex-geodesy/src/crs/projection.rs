//! Conversion between positions on the ellipsoid and projected coordinates.

use std::fmt;

use proj4rs::Proj;

use super::CrsError;
use super::definition::{Definition, ProjectionMethod};
use crate::conformal::EllipsoidNormal;
use crate::lambert::LambertConformal;
use crate::transverse_mercator::TransverseMercator;

/// Largest plausible projected coordinate, m: twice around the earth.
const FARTHEST_M: f64 = 8e7;

/// Conversion between positions on the ellipsoid and projected coordinates.
#[derive(Debug)]
pub(super) enum Projection {
    /// Longitude and latitude in degrees.
    Geodetic,
    /// The earth-centred frame itself.
    Ecef,
    TransverseMercator(TransverseMercator),
    Lambert(LambertConformal),
    Other(Box<Proj4Projection>),
    #[cfg(feature = "proj")]
    Foreign(super::proj::Foreign),
}

impl Projection {
    pub(super) fn new(definition: &Definition) -> Result<Projection, CrsError> {
        let unsupported = |problem: String| CrsError::Unsupported {
            name: definition.name.clone(),
            problem,
            remedy: "choose another system, or build wavex with the feature `proj`",
        };
        Ok(match &definition.method {
            ProjectionMethod::Geodetic => Projection::Geodetic,
            ProjectionMethod::Ecef => Projection::Ecef,
            ProjectionMethod::TransverseMercator(parameters) => {
                Projection::TransverseMercator(TransverseMercator::new(definition.ellipsoid, *parameters))
            }
            ProjectionMethod::Lambert(parameters) => {
                let projection = LambertConformal::new(definition.ellipsoid, *parameters);
                Projection::Lambert(
                    projection.ok_or_else(|| unsupported("its standard parallels define no cone".into()))?,
                )
            }
            #[cfg(feature = "proj")]
            ProjectionMethod::Foreign(text) => Projection::Foreign(
                super::proj::Foreign::new(text)
                    .ok_or_else(|| unsupported("PROJ has no transformation to it from WGS 84".into()))?,
            ),
            ProjectionMethod::Other(text) => Projection::Other(Box::new(
                Proj4Projection::new(text)
                    .map_err(|problem| unsupported(format!("its projection: {problem}")))?,
            )),
        })
    }

    /// Easting and northing, m, or longitude and latitude, degrees; `None` outside the projection.
    ///
    /// `height_m`: ellipsoidal height of the position.
    #[cfg_attr(not(feature = "proj"), allow(unused_variables, reason = "only PROJ asks for the height"))]
    pub(super) fn project(&self, normal: &EllipsoidNormal, height_m: f64) -> Option<[f64; 2]> {
        let (x, y) = match self {
            Projection::Geodetic | Projection::Ecef => {
                let (latitude_rad, longitude_rad) = normal.angles_rad();
                (longitude_rad.to_degrees(), latitude_rad.to_degrees())
            }
            Projection::TransverseMercator(map) => {
                let (x, y) = map.project_normal(normal);
                return map.reaches(x, y).then_some([x, y]);
            }
            Projection::Lambert(map) => map.project_normal(normal),
            Projection::Other(map) => map.project(normal)?,
            #[cfg(feature = "proj")]
            Projection::Foreign(map) => {
                let (latitude_rad, longitude_rad) = normal.angles_rad();
                return map.project(longitude_rad.to_degrees(), latitude_rad.to_degrees(), height_m);
            }
        };
        (x.abs() < FARTHEST_M && y.abs() < FARTHEST_M).then_some([x, y])
    }

    /// [`Projection::project`] for several positions.
    pub(super) fn project_each<const N: usize>(
        &self,
        normals: &[EllipsoidNormal; N],
        heights_m: &[f64; N],
    ) -> [Option<[f64; 2]>; N] {
        match self {
            Projection::TransverseMercator(map) => {
                map.project_each(normals).map(|(x, y)| map.reaches(x, y).then_some([x, y]))
            }
            _ => std::array::from_fn(|i| self.project(&normals[i], heights_m[i])),
        }
    }

    /// Inverse of [`Projection::project`]: latitude and longitude, rad.
    #[cfg_attr(not(feature = "proj"), allow(unused_variables, reason = "only PROJ asks for the height"))]
    pub(super) fn unproject(&self, [x, y]: [f64; 2], height_m: f64) -> Option<(f64, f64)> {
        if !(x.abs() < FARTHEST_M && y.abs() < FARTHEST_M) {
            return None;
        }
        let (latitude_rad, longitude_rad) = match self {
            Projection::Geodetic | Projection::Ecef => (y.to_radians(), x.to_radians()),
            Projection::TransverseMercator(map) if map.reaches(x, y) => map.unproject(x, y),
            Projection::TransverseMercator(_) => return None,
            Projection::Lambert(map) => map.unproject(x, y),
            Projection::Other(map) => map.unproject(x, y)?,
            #[cfg(feature = "proj")]
            Projection::Foreign(map) => {
                let [longitude_deg, latitude_deg] = map.unproject(x, y, height_m)?;
                (latitude_deg.to_radians(), longitude_deg.to_radians())
            }
        };
        let sound = latitude_rad.abs() <= core::f64::consts::FRAC_PI_2 + 1e-9 && longitude_rad.is_finite();
        sound.then_some((latitude_rad, longitude_rad))
    }
}

/// A projection of the crate `proj4rs`, a port of PROJ; depends on the system's mathematical
/// library.
pub(super) struct Proj4Projection {
    text: String,
    from: Proj,
    to: Proj,
}

impl Proj4Projection {
    fn new(text: &str) -> Result<Proj4Projection, proj4rs::errors::Error> {
        // Same figure of the earth on both sides: a projection of the sphere uses angles unchanged.
        let is_figure = |word: &&str| ["+a=", "+b=", "+rf=", "+R="].iter().any(|key| word.starts_with(key));
        let figure: Vec<&str> = text.split(' ').filter(is_figure).collect();
        let from = format!("+proj=longlat {} +no_defs", figure.join(" "));
        Ok(Proj4Projection {
            text: text.into(),
            from: Proj::from_proj_string(&from)?,
            to: Proj::from_proj_string(text)?,
        })
    }

    fn project(&self, normal: &EllipsoidNormal) -> Option<(f64, f64)> {
        let (latitude_rad, longitude_rad) = normal.angles_rad();
        proj4rs::adaptors::transform_xy(&self.from, &self.to, longitude_rad, latitude_rad).ok()
    }

    fn unproject(&self, x: f64, y: f64) -> Option<(f64, f64)> {
        let (longitude_rad, latitude_rad) =
            proj4rs::adaptors::transform_xy(&self.to, &self.from, x, y).ok()?;
        Some((latitude_rad, longitude_rad))
    }
}

impl fmt::Debug for Proj4Projection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Other").field(&self.text).finish()
    }
}
