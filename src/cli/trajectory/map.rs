//! The coordinates in which a trajectory is shown.

use crate::geo::ellipsoid::{Geodetic, WGS84};
use crate::geo::transverse_mercator::{Parameters, TransverseMercator};

/// What places become.
pub(super) enum Map {
    /// Easting and northing of a zone, height above the ellipsoid, m.
    Utm { zone: u8, is_north: bool, projection: TransverseMercator },
    /// Longitude and latitude, degrees, height above the ellipsoid, m.
    Geodetic,
    /// Geocentric, m.
    Ecef,
}

impl Map {
    /// What the user names: `utm`, with the zone of a place, where one is known; `utm:33N`, `geodetic`, `ecef`.
    pub(super) fn of(name: &str, place: Option<Geodetic>) -> Result<Option<Map>, String> {
        match name.to_ascii_lowercase().as_str() {
            "utm" => Ok(place.map(|place| {
                // A float converts to the nearest integer in range.
                let zone = (place.longitude_rad.to_degrees() / 6.0 + 30.0).floor() as u8 + 1;
                Map::utm(zone.clamp(1, 60), place.latitude_rad >= 0.0)
            })),
            "geodetic" => Ok(Some(Map::Geodetic)),
            "ecef" => Ok(Some(Map::Ecef)),
            other => {
                let zone = other.strip_prefix("utm:").and_then(zone_of);
                zone.map(|(zone, is_north)| Some(Map::utm(zone, is_north))).ok_or_else(|| {
                    format!("--crs {name}: not known; say utm, utm:33N, utm:33S (with a zone of 1 to 60), geodetic or ecef")
                })
            }
        }
    }

    fn utm(zone: u8, is_north: bool) -> Map {
        Map::Utm {
            zone,
            is_north,
            projection: TransverseMercator::new(WGS84, Parameters::utm(zone, is_north)),
        }
    }

    /// In words.
    pub(super) fn name(&self) -> String {
        match self {
            Map::Utm { zone, is_north, .. } => {
                format!("UTM zone {zone} {} on WGS 84", if *is_north { "north" } else { "south" })
            }
            Map::Geodetic => "geodetic, WGS 84".to_owned(),
            Map::Ecef => "geocentric (ECEF), WGS 84".to_owned(),
        }
    }

    /// Digits behind the point that x and y take.
    pub(super) fn digits(&self) -> usize {
        if matches!(self, Map::Geodetic) { 10 } else { 4 }
    }

    /// A place's coordinates.
    pub(super) fn project(&self, place: Geodetic) -> [f64; 3] {
        match self {
            Map::Utm { projection, .. } => {
                let (x, y) = projection.project(place.latitude_rad, place.longitude_rad);
                [x, y, place.height_m]
            }
            Map::Geodetic => {
                [place.longitude_rad.to_degrees(), place.latitude_rad.to_degrees(), place.height_m]
            }
            Map::Ecef => WGS84.ecef_of(place),
        }
    }

    /// The way back from easting, northing and height; `None` where this is no map.
    pub(super) fn unproject(&self) -> Option<impl Fn([f64; 3]) -> Result<Geodetic, String>> {
        let Map::Utm { projection, .. } = self else { return None };
        Some(|[x, y, height_m]: [f64; 3]| {
            let (latitude_rad, longitude_rad) = projection.unproject(x, y);
            Ok(Geodetic { latitude_rad, longitude_rad, height_m })
        })
    }
}

/// `33n` to zone and hemisphere.
fn zone_of(text: &str) -> Option<(u8, bool)> {
    let (zone, is_north) = match text.strip_suffix('n') {
        Some(zone) => (zone, true),
        None => (text.strip_suffix('s')?, false),
    };
    let zone: u8 = zone.parse().ok()?;
    (1..=60).contains(&zone).then_some((zone, is_north))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn place(latitude: f64, longitude: f64) -> Geodetic {
        Geodetic { latitude_rad: latitude.to_radians(), longitude_rad: longitude.to_radians(), height_m: 5.0 }
    }

    #[test]
    fn the_zone_is_that_of_the_place() {
        let name =
            |latitude, longitude| Map::of("utm", Some(place(latitude, longitude))).unwrap().unwrap().name();
        assert_eq!(name(48.0, 12.5), "UTM zone 33 north on WGS 84");
        assert_eq!(name(-17.0, -180.0), "UTM zone 1 south on WGS 84");
        assert_eq!(name(0.0, 180.0), "UTM zone 60 north on WGS 84");
        assert!(Map::of("utm", None).unwrap().is_none());
    }

    #[test]
    fn coordinates_are_those_of_the_name() {
        let project = |name: &str| Map::of(name, None).unwrap().unwrap().project(place(0.0, 15.0));
        assert!((project("utm:33N")[0] - 500_000.0).abs() < 1e-6 && project("utm:33N")[1].abs() < 1e-6);
        assert!((project("UTM:33s")[1] - 1e7).abs() < 1e-6);
        assert!((project("geodetic")[0] - 15.0).abs() < 1e-14);
        assert!((project("ecef")[0] - 6_378_142.0 * 15f64.to_radians().cos()).abs() < 1e-6);
        for wrong in ["utm:61N", "utm:0S", "utm:33", "utm33n", "EPSG:1", ""] {
            let told = Map::of(wrong, None).err().unwrap();
            let expected = "not known; say utm, utm:33N, utm:33S (with a zone of 1 to 60), geodetic or ecef";
            assert_eq!(told, format!("--crs {wrong}: {expected}"));
        }
    }
}
