//! Errors of coordinate reference systems and their points.

use crate::geoid::GeoidError;

/// Error of a coordinate reference system, or of a point in it.
#[derive(Debug, thiserror::Error)]
pub enum CrsError {
    /// Invalid name in the job.
    #[error(
        "crs `{word}`: {problem}; write `utm`, `utm:33N`, `EPSG:2154`, `geodetic`, `ecef` or the path of a WKT file"
    )]
    Word {
        /// The name.
        word: String,
        /// Description of the problem.
        problem: &'static str,
    },
    /// A system spelled in another way.
    #[error("crs `{word}`: {problem}; write `{meant}`")]
    Spelling {
        /// The name.
        word: String,
        /// Description of the problem.
        problem: &'static str,
        /// The right spelling.
        meant: String,
    },
    /// EPSG code that is not in the table.
    #[error(
        "EPSG:{0} is not in the table of coordinate reference systems; check the code, or use a WKT file"
    )]
    UnknownEpsg(u32),
    /// Text that is not the WKT of a coordinate reference system.
    #[error("the WKT cannot be read: {0}; check the text, or use an EPSG code")]
    Wkt(String),
    /// GeoTIFF keys that give no system.
    #[error("the GeoTIFF keys cannot be read ({0})")]
    GeoKeys(String),
    /// The datum differs from the earth-centred frame of the trajectory.
    #[error(
        "{name}: its datum, {datum}, {reason}, but datum shifts are not supported; choose a CRS on WGS 84, ETRS89, NAD83 or \
         a similar frame, or build wavex with the feature `proj`"
    )]
    Datum {
        /// The CRS.
        name: String,
        /// Its datum.
        datum: String,
        /// Reason why it cannot be used.
        reason: String,
    },
    /// WKT without parameters that its projection needs; they would count as zeros.
    #[error(
        "{name}: its projection has no {missing}; complete the parameters in its WKT, or use an EPSG code"
    )]
    Incomplete {
        /// The CRS.
        name: String,
        /// WKT 1 names of the missing parameters.
        missing: String,
    },
    /// Another unsupported feature.
    #[error("{name}: {problem}; {remedy}")]
    Unsupported {
        /// The CRS.
        name: String,
        /// Description of the unsupported feature.
        problem: String,
        /// Remedy for the user.
        remedy: &'static str,
    },
    /// The heights of the CRS need a geoid.
    #[error(
        "{name}: its heights are {vertical}, which need a geoid; set `geoid`, or use a CRS without a vertical part for \
         ellipsoidal heights"
    )]
    NoGeoid {
        /// The CRS.
        name: String,
        /// Name of its vertical part.
        vertical: String,
    },
    /// A point far outside the area of the projection.
    #[error(
        "{name}: the point at latitude {latitude_deg:.6}, longitude {longitude_deg:.6} degrees cannot be projected; \
         choose a CRS for that area; with a trajectory, check its positions"
    )]
    OutsideProjection {
        /// The CRS.
        name: String,
        /// Latitude of the point.
        latitude_deg: f64,
        /// Longitude of the point.
        longitude_deg: f64,
    },
    /// Coordinates outside the projection.
    #[error("{name}: the coordinates {x}, {y} are outside the projection; check them and their unit")]
    OutsideMap {
        /// The CRS.
        name: String,
        /// Easting, in the unit of the CRS.
        x: f64,
        /// Northing, in the unit of the CRS.
        y: f64,
    },
    /// The geoid has no height at a point.
    #[error(transparent)]
    Geoid(#[from] GeoidError),
}
