//! Coordinate system in which a trajectory is written and drawn.

use std::path::Path;

use wavex_formats::read_small_text;
use wavex_geodesy::crs::{Crs, Named};
use wavex_geodesy::ellipsoid::{Geodetic, WGS84};
use wavex_geodesy::trajectory::Sample;
use wavex_line::georef::MOST_WKT_BYTES;

/// Projection of positions into a coordinate system.
pub(super) struct TrajectoryMap {
    crs: Crs,
}

/// Placeholder position for systems that do not depend on one.
const ANYWHERE: Geodetic = Geodetic { latitude_rad: 0.0, longitude_rad: 0.0, height_m: 0.0 };

impl TrajectoryMap {
    /// Coordinate system named by the user; `None` for `utm` without a position.
    ///
    /// `word` is `utm` (zone of `place`), `utm:33N`, `EPSG:2154`, `geodetic`, `ecef`, or the path
    /// of a WKT file.
    pub(super) fn of(word: &str, place: Option<Geodetic>) -> Result<Option<TrajectoryMap>, String> {
        let message = |problem: &dyn std::fmt::Display| format!("--crs {word}: {problem}");
        let named = match Named::parse(word).map_err(|error| message(&error))? {
            Some(Named::Utm) if place.is_none() => return Ok(None),
            Some(named) => named,
            None => {
                let remedy = "give utm, utm:33N, EPSG:2154, geodetic, ecef or a WKT file";
                let text = read_small_text(Path::new(word), MOST_WKT_BYTES, "WKT", remedy);
                Named::Wkt(text.map_err(|error| message(&format!("{error}; {remedy}")))?)
            }
        };
        let crs = Crs::new(&named, place.unwrap_or(ANYWHERE), None, None).map_err(|error| message(&error))?;
        Ok(Some(TrajectoryMap { crs }))
    }

    /// Geodetic coordinates, which need no first position.
    pub(super) fn geodetic() -> Result<TrajectoryMap, String> {
        TrajectoryMap::of("geodetic", None)?.ok_or_else(|| "no geodetic coordinates".into())
    }

    /// Name for display.
    pub(super) fn name(&self) -> &str {
        self.crs.name()
    }

    /// Decimal places of x and y.
    pub(super) fn digits(&self) -> usize {
        if self.crs.is_geodetic() { 10 } else { 4 }
    }

    /// Returns whether x and y are map coordinates in metres.
    pub(super) fn is_plane(&self) -> bool {
        !self.crs.is_geodetic() && !self.crs.is_ecef() && self.crs.unit().metres == 1.0
    }

    /// Checks that all positions can be projected; the error names the first that cannot.
    pub(super) fn covers(&self, samples: &[Sample]) -> Result<(), String> {
        let projected = |sample: &Sample| self.crs.from_ecef(WGS84.ecef_of(sample.place)).map(drop);
        samples.iter().try_for_each(projected).map_err(|error| error.to_string())
    }

    /// Projects a position; NaN outside the domain of the projection.
    pub(super) fn project(&self, place: Geodetic) -> [f64; 3] {
        self.crs.from_ecef(WGS84.ecef_of(place)).unwrap_or([f64::NAN; 3])
    }

    /// Inverse projection from easting, northing and height; `None` for non-map systems.
    pub(super) fn unproject(&self) -> Option<impl Fn([f64; 3]) -> Result<Geodetic, String>> {
        let is_map = !self.crs.is_geodetic() && !self.crs.is_ecef();
        is_map.then_some(|place| {
            let ecef_m = self.crs.to_ecef(place).map_err(|error| error.to_string())?;
            Ok(WGS84.geodetic_of(ecef_m))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn place(latitude: f64, longitude: f64) -> Geodetic {
        Geodetic { latitude_rad: latitude.to_radians(), longitude_rad: longitude.to_radians(), height_m: 5.0 }
    }

    #[test]
    fn coordinates_are_those_of_the_name() {
        let project = |name: &str| {
            TrajectoryMap::of(name, Some(place(0.0, 15.0))).unwrap().unwrap().project(place(0.0, 15.0))
        };
        assert!((project("utm")[0] - 500_000.0).abs() < 1e-6);
        assert!((project("utm:33S")[1] - 1e7).abs() < 1e-6);
        assert!((project("geodetic")[0] - 15.0).abs() < 1e-13);
        assert!((project("ecef")[0] - 6_378_142.0 * 15f64.to_radians().cos()).abs() < 1e-6);
        assert!(TrajectoryMap::of("utm", None).unwrap().is_none());
        assert!(TrajectoryMap::of("EPSG:2154", None).unwrap().unwrap().is_plane());
    }

    #[test]
    fn a_map_leads_back_to_the_place() {
        let map = TrajectoryMap::of("EPSG:2154", None).unwrap().unwrap();
        let there = map.project(place(46.5, 3.0));
        let back = (map.unproject().unwrap())(there).unwrap();
        assert!(
            (back.latitude_rad - 46.5f64.to_radians()).abs() < 1e-11 && (back.height_m - 5.0).abs() < 1e-6
        );
        assert!(TrajectoryMap::geodetic().unwrap().unproject().is_none());
    }

    #[test]
    fn unknown_words_are_errors() {
        let message = TrajectoryMap::of("nowhere.wkt", None).err().unwrap();
        assert!(message.starts_with("--crs nowhere.wkt: nowhere.wkt: cannot open: "), "{message}");
        let message = TrajectoryMap::of("EPSG:1", None).err().unwrap();
        assert!(message.starts_with("--crs EPSG:1: "), "{message}");
    }
}
