//! Outline of a box of coordinates on the earth.

use super::Crs;
use super::definition::Definition;

/// Parts of each side of the outline; sides are curved in longitude and latitude.
const PARTS: usize = 4;
/// Steps of longitudes and latitudes per degree: about 1 cm.
const STEPS: f64 = 1e7;

/// Outline of a box on the earth.
#[derive(Clone, Debug, PartialEq)]
pub struct Outline {
    /// EPSG code of the whole system; `None` without one.
    pub epsg: Option<u32>,
    /// Longitude and latitude, degrees, counter-clockwise; the first corner is also the last.
    ///
    /// `None` for boxes that cannot be converted or that cross the meridian of 180 degrees.
    pub ring: Option<Vec<[f64; 2]>>,
}

impl Outline {
    /// Outline of the box from `min` to `max` in the system of a WKT.
    ///
    /// Heights count only in earth-centred systems, whose boxes become the box of their corners.
    /// `None` for texts that are no supported system.
    pub fn new(wkt: &str, min: [f64; 3], max: [f64; 3]) -> Option<Outline> {
        let definition = Definition::of_wkt(wkt).ok()?;
        let is_compound = definition.vertical.is_some();
        let epsg = definition.epsg.filter(|code| *code > 0 && !is_compound);
        let crs = Crs::horizontal(definition)?;
        let ring = if crs.is_ecef() { corners(&crs, min, max) } else { sides(&crs, min, max) };
        let is_in_one_piece = |ring: &Vec<[f64; 2]>| {
            let (west, east) = ends(ring, 0);
            ring.iter().flatten().all(|degrees| degrees.is_finite()) && east - west < 180.0
        };
        Some(Outline { epsg, ring: ring.filter(is_in_one_piece) })
    }

    /// West, south, east and north end of the outline, degrees.
    pub fn bounds(&self) -> Option<[f64; 4]> {
        let ring = self.ring.as_ref()?;
        let ((west, east), (south, north)) = (ends(ring, 0), ends(ring, 1));
        Some([west, south, east, north])
    }
}

/// Smallest and largest longitude (0) or latitude (1).
fn ends(ring: &[[f64; 2]], axis: usize) -> (f64, f64) {
    let values = ring.iter().map(|place| place[axis]);
    values
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(least, most), value| (least.min(value), most.max(value)))
}

fn place(crs: &Crs, coordinates: [f64; 3]) -> Option<[f64; 2]> {
    let geodetic = crs.to_geodetic(coordinates).ok()?;
    let degrees = [geodetic.longitude_rad, geodetic.latitude_rad].map(f64::to_degrees);
    Some(degrees.map(|degrees| (degrees * STEPS).round() / STEPS))
}

/// Points along the four sides of a box.
fn sides(crs: &Crs, min: [f64; 3], max: [f64; 3]) -> Option<Vec<[f64; 2]>> {
    let corners = [[min[0], min[1]], [max[0], min[1]], [max[0], max[1]], [min[0], max[1]]];
    let mut ring = Vec::with_capacity(4 * PARTS + 1);
    for (number, from) in corners.into_iter().enumerate() {
        let to = corners[(number + 1) % 4];
        for part in 0..PARTS {
            let along = part as f64 / PARTS as f64;
            let [x, y] = [0, 1].map(|axis| from[axis] + (to[axis] - from[axis]) * along);
            ring.push(place(crs, [x, y, min[2]])?);
        }
    }
    ring.push(*ring.first()?);
    Some(ring)
}

/// The box around the corners of an earth-centred box.
fn corners(crs: &Crs, min: [f64; 3], max: [f64; 3]) -> Option<Vec<[f64; 2]>> {
    let corner =
        |number: usize| [0, 1, 2].map(|axis| if number >> axis & 1 == 0 { min[axis] } else { max[axis] });
    let places: Option<Vec<[f64; 2]>> = (0..8).map(|number| place(crs, corner(number))).collect();
    let places = places?;
    let ((west, east), (south, north)) = (ends(&places, 0), ends(&places, 1));
    Some(vec![[west, south], [east, south], [east, north], [west, north], [west, south]])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::crs::wkt_of_epsg;
    use crate::ellipsoid::{Geodetic, WGS84};

    #[test]
    fn a_box_of_a_projection_has_curved_sides() {
        let (min, max) = ([400_000.0, 5_300_000.0, 100.0], [600_000.0, 5_400_000.0, 300.0]);
        let outline = Outline::new(&wkt_of_epsg(32633).unwrap(), min, max).unwrap();
        let [west, south, east, north] = outline.bounds().unwrap();
        let ring = outline.ring.unwrap();
        assert_eq!((outline.epsg, ring.len(), ring[0]), (Some(32633), 17, ring[16]));
        assert!(west < 13.64 && east > 16.36 && (south - 47.84).abs() < 0.02 && (north - 48.75).abs() < 0.02);
        // Northern side: the middle is further north than the corners.
        assert!(ring[10][1] > ring[8][1] + 0.008 && ring[10][1].to_bits() == north.to_bits());
        // Counter-clockwise.
        let area: f64 = ring.windows(2).map(|side| side[0][0] * side[1][1] - side[1][0] * side[0][1]).sum();
        assert!(area > 0.0);
    }

    #[test]
    fn heights_above_a_geoid_need_no_geoid() {
        let wkt = format!(
            "COMPD_CS[\"a\",{},VERT_CS[\"NAVD88 height\",VERT_DATUM[\"NAVD88\",2005],UNIT[\"metre\",1]]]",
            wkt_of_epsg(32633).unwrap()
        );
        let outline = Outline::new(&wkt, [5e5, 5e6, 0.0], [5.1e5, 5.1e6, 0.0]).unwrap();
        assert!(outline.epsg.is_none() && outline.ring.is_some());
    }

    #[test]
    fn an_earth_centred_box_has_the_box_of_its_corners() {
        let of = |longitude: f64| {
            let at = Geodetic { latitude_rad: 0.8, longitude_rad: longitude.to_radians(), height_m: 0.0 };
            WGS84.ecef_of(at)
        };
        let centre = of(15.0);
        let (min, max) = (centre.map(|m| m - 1000.0), centre.map(|m| m + 1000.0));
        let outline = Outline::new(&wkt_of_epsg(4978).unwrap(), min, max).unwrap();
        let [west, _, east, _] = outline.bounds().unwrap();
        assert!(west < 15.0 && east > 15.0 && east - west < 0.1);
        let (min, max) = (of(180.0).map(|m| m - 1000.0), of(180.0).map(|m| m + 1000.0));
        assert_eq!(Outline::new(&wkt_of_epsg(4978).unwrap(), min, max).unwrap().ring, None);
    }

    #[test]
    fn other_texts_have_none() {
        assert_eq!(Outline::new("PROJCS[\"x\"]", [0.0; 3], [1.0; 3]), None);
        assert_eq!(Outline::new("", [0.0; 3], [1.0; 3]), None);
    }
}
