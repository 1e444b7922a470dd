//! Areas to read: boxes and polygons.

use std::path::Path;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use wavex_formats::geojson::read_polygons;
use wavex_geodesy::polygon::Polygon;
use wavex_line::keys::InvalidKey;
use wavex_line::stage::{Result, RunContext};

/// Name of the key.
const KEY: &str = "extent_deg";

/// A box, a polygon, or a file of polygons.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum ExtentKey {
    /// West, south, east and north.
    Box([f64; 4]),
    /// Longitude and latitude of the corners of a polygon.
    Polygon(Vec<[f64; 2]>),
    /// A GeoJSON file.
    File(String),
}

impl ExtentKey {
    pub(super) fn check(&self) -> std::result::Result<(), InvalidKey> {
        match self {
            ExtentKey::Box([west, south, east, north]) => InvalidKey::unless(
                west != east && -90.0 <= *south && south < north && *north <= 90.0,
                KEY,
                "it must be [west, south, east, north], with the south below the north and both between -90 and 90",
            ),
            ExtentKey::Polygon(corners) => match Polygon::new(vec![corners.clone()]) {
                Ok(_) => Ok(()),
                Err(error) => Err(InvalidKey::new(KEY, error.to_string())),
            },
            ExtentKey::File(_) => Ok(()),
        }
    }

    /// The file, if it is one.
    pub(super) fn file(&self) -> Option<&str> {
        match self {
            ExtentKey::File(name) => Some(name),
            _ => None,
        }
    }
}

/// Area to read.
pub(super) enum Extent {
    Box([f64; 4]),
    Polygons(Vec<Polygon>),
}

impl Extent {
    /// Reads the polygons.
    ///
    /// # Errors
    /// If the file cannot be read or has no polygons.
    pub(super) fn of(key: &ExtentKey, run: &RunContext) -> Result<Extent> {
        Ok(match key {
            ExtentKey::Box(sides_deg) => Extent::Box(*sides_deg),
            // The check has refused other corners.
            ExtentKey::Polygon(corners) => {
                Extent::Polygons(Polygon::new(vec![corners.clone()]).into_iter().collect())
            }
            ExtentKey::File(name) => Extent::Polygons(read_polygons(&run.input_path(Path::new(name)), KEY)?),
        })
    }

    /// Whether a place is in the area.
    pub(super) fn includes(&self, longitude_deg: f64, latitude_deg: f64) -> bool {
        match self {
            Extent::Box(sides_deg) => is_in_box(*sides_deg, longitude_deg, latitude_deg),
            Extent::Polygons(polygons) => {
                polygons.iter().any(|polygon| polygon.includes(longitude_deg, latitude_deg))
            }
        }
    }

    /// Whether polygons with longitude and latitude exchanged would overlap these ranges.
    pub(super) fn is_swapped(&self, longitudes_deg: [f64; 2], latitudes_deg: [f64; 2]) -> bool {
        let overlap = |least: f64, most: f64, [from, to]: [f64; 2]| least <= to && from <= most;
        match self {
            Extent::Box(_) => false,
            Extent::Polygons(polygons) => polygons.iter().any(|polygon| {
                let [west, south, east, north] = polygon.bounds_deg();
                overlap(south, north, longitudes_deg) && overlap(west, east, latitudes_deg)
            }),
        }
    }
}

/// Whether a place is in a box; a box with its west east of its east crosses the antimeridian.
fn is_in_box([west, south, east, north]: [f64; 4], longitude_deg: f64, latitude_deg: f64) -> bool {
    let width = if east - west >= 360.0 { 360.0 } else { (east - west).rem_euclid(360.0) };
    (longitude_deg - west).rem_euclid(360.0) <= width && (south..=north).contains(&latitude_deg)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boxes_may_cross_the_antimeridian() {
        let pacific = [170.0, -20.0, -170.0, 20.0];
        assert!(is_in_box(pacific, 175.0, 0.0) && is_in_box(pacific, -175.0, 20.0));
        assert!(!is_in_box(pacific, 0.0, 0.0) && !is_in_box(pacific, 175.0, 20.1));
        // Longitudes from 0 to 360 degrees, as in LVIS.
        assert!(is_in_box([310.0, 60.0, 320.0, 70.0], -45.0, 65.0));
        assert!(is_in_box([-180.0, -90.0, 180.0, 90.0], 12.0, 50.0));
    }
}
