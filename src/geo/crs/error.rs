//! What can be wrong with a coordinate reference system, or with a point for it.

use crate::geo::geoid::GeoidError;

/// What can be wrong with a coordinate reference system, or with a point for it.
#[derive(Debug, thiserror::Error)]
pub enum CrsError {
    /// The job's word names no system.
    #[error(
        "crs `{word}`: {problem}; write `utm`, `utm:33N`, `EPSG:2154`, `geodetic`, `ecef` or the path of a WKT file"
    )]
    Word {
        /// The word.
        word: String,
        /// What is wrong with it.
        problem: &'static str,
    },
    /// A code that is not in the table.
    #[error("EPSG:{0} is not in the table of systems; check the code, or give the system as a WKT file")]
    UnknownEpsg(u32),
    /// A text that is not well-known text of a coordinate reference system.
    #[error("the WKT cannot be read: {0}; check the text, or give an EPSG code")]
    Wkt(String),
    /// The system's datum lies elsewhere than the earth-centred frame of the trajectory.
    #[error(
        "{name}: its datum, {datum}, {reason}, and no datum shift is applied; choose a system on WGS 84, ETRS89, NAD83 or \
         another frame of their kind, or build wavex with the feature `proj`"
    )]
    Datum {
        /// The system.
        name: String,
        /// Its datum.
        datum: String,
        /// Why it cannot be used.
        reason: String,
    },
    /// A well-known text without parameters that its projection needs; they would count as zeros.
    #[error(
        "{name}: its projection has no {missing}; complete the parameters in its WKT, or give an EPSG code"
    )]
    Incomplete {
        /// The system.
        name: String,
        /// What is missing, as WKT 1 names it.
        missing: String,
    },
    /// Something else that is not supported.
    #[error("{name}: {problem}; {remedy}")]
    Unsupported {
        /// The system.
        name: String,
        /// What is not supported.
        problem: String,
        /// What the user can do.
        remedy: &'static str,
    },
    /// The system's heights count from a surface that only a geoid gives.
    #[error(
        "{name}: its heights are {vertical}, which need a geoid; give one with `geoid`, or a system without heights to \
         get those above the ellipsoid"
    )]
    NoGeoid {
        /// The system.
        name: String,
        /// Its vertical part.
        vertical: String,
    },
    /// A point far outside the area where the projection makes sense.
    #[error(
        "{name}: the point at latitude {latitude_deg:.6}, longitude {longitude_deg:.6} degrees cannot be projected; \
         check the trajectory, or choose a system made for that area"
    )]
    OutsideProjection {
        /// The system.
        name: String,
        /// The point's latitude.
        latitude_deg: f64,
        /// The point's longitude.
        longitude_deg: f64,
    },
    /// Coordinates that are no point of the map.
    #[error("{name}: the coordinates {x}, {y} are no point of the map; check them and their unit")]
    OutsideMap {
        /// The system.
        name: String,
        /// Easting, in the system's unit.
        x: f64,
        /// Northing, in the system's unit.
        y: f64,
    },
    /// The geoid says nothing of a point.
    #[error(transparent)]
    Geoid(#[from] GeoidError),
}
