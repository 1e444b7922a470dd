//! Positions outside the area of use of their coordinate reference system.

use crate::plausibility::Check;
use wavex_geodesy::crs::{AreaOfUse, Crs};
use wavex_geodesy::ellipsoid::Geodetic;
use wavex_geodesy::frames::Vector;

/// Distance from the area of use at which a position is outside, degrees.
const MARGIN_DEG: f64 = 1.0;
const METRES_PER_FOOT: f64 = 0.3048;
/// Words of the message.
const MADE_FOR: &str = "is made for";

/// The check of this module.
pub fn check() -> Check {
    Check::warning(
        "first position and the area of use of its CRS: that of the job, or of the records of the file",
        format!("{MARGIN_DEG} degree from the area"),
        "areas of use of the EPSG dataset, rounded outwards to whole degrees",
        MADE_FOR,
    )
    .with_key("crs")
}

/// A warning if a recording begins outside the area of use of its output CRS.
pub(super) fn outside_of_output(crs: &Crs, place: Geodetic) -> Option<String> {
    let problem = outside(crs, place, |_| None)?;
    Some(format!("{problem}; check `crs` in `[job.geometry]`; with a trajectory, also its positions"))
}

/// A warning if a recording in a map begins outside the area of use of the map's CRS.
pub(super) fn outside_of_map(crs: &Crs, point: Vector) -> Option<String> {
    let problem = outside(crs, crs.to_geodetic(point).ok()?, |area| {
        let [x, y, height] = point;
        let is_inside = |x, y| crs.to_geodetic([x, y, height]).is_ok_and(|place| is_in(area, place));
        let (factor, unit) = match crs.unit().metres {
            feet if feet < 0.5 => (1.0 / METRES_PER_FOOT, "coordinates in metres"),
            _ => (METRES_PER_FOOT, "coordinates in feet"),
        };
        match () {
            () if is_inside(y, x) => Some("that eastings and northings are exchanged"),
            () if is_inside(x * factor, y * factor) => Some(unit),
            () => None,
        }
    })?;
    Some(format!(
        "{problem}; set the right system by the reader's key `crs_of_input`, or export the file again"
    ))
}

/// Describes a position outside the area of use of a CRS, with the likely mistake, in a map that of `in_map`.
fn outside(
    crs: &Crs,
    place: Geodetic,
    in_map: impl Fn(&AreaOfUse) -> Option<&'static str>,
) -> Option<String> {
    let area = crs.area_of_use().filter(|area| !is_in(area, place))?;
    let name = label(crs);
    let [longitude, latitude] = [place.longitude_rad, place.latitude_rad].map(f64::to_degrees);
    let mistake = in_map(&area).unwrap_or_else(|| match () {
        () if area.contains(longitude, -latitude, MARGIN_DEG) => "the hemisphere",
        () if (area.south..=area.north).contains(&latitude) => "the zone, or a code of another country",
        () => "the code",
    });
    let AreaOfUse { west, south, east, north } = area;
    Some(format!(
        "{name} {MADE_FOR} longitude {west} to {east} and latitude {south} to {north} degrees, but the recording begins at \
         longitude {longitude:.1}, latitude {latitude:.1}: the likely mistake is {mistake}"
    ))
}

/// Name of a CRS with its code, such as `EPSG:32633 (WGS 84 / UTM zone 33N)`.
pub(super) fn label(crs: &Crs) -> String {
    match (crs.name(), crs.epsg()) {
        (name, Some(code)) if code > 0 && !name.starts_with("EPSG:") => format!("EPSG:{code} ({name})"),
        (name, _) => name.to_owned(),
    }
}

fn is_in(area: &AreaOfUse, place: Geodetic) -> bool {
    area.contains(place.longitude_rad.to_degrees(), place.latitude_rad.to_degrees(), MARGIN_DEG)
}

#[cfg(test)]
mod tests {
    use super::super::output_crs::ANYWHERE;
    use super::*;
    use wavex_geodesy::crs::{Named, wkt_of_epsg};

    fn at(longitude_deg: f64, latitude_deg: f64) -> Geodetic {
        let [longitude_rad, latitude_rad] = [longitude_deg, latitude_deg].map(f64::to_radians);
        Geodetic { latitude_rad, longitude_rad, height_m: 500.0 }
    }

    fn crs(code: u32) -> Crs {
        Crs::new(&Named::Epsg(code), ANYWHERE, None, None).unwrap()
    }

    #[test]
    fn the_likely_mistake_is_named() {
        let austria = at(15.04, 47.0);
        let said = |code| outside_of_output(&crs(code), austria);
        assert_eq!([32633, 25833, 4326, 4978].map(said), [const { None }; 4]);
        assert_eq!(
            said(32733).unwrap(),
            "EPSG:32733 (WGS 84 / UTM zone 33S) is made for longitude 12 to 18 and latitude -80 to 0 degrees, but the \
             recording begins at longitude 15.0, latitude 47.0: the likely mistake is the hemisphere; check `crs` in \
             `[job.geometry]`; with a trajectory, also its positions"
        );
        for (code, mistake) in [(32632, "is the zone"), (2271, "is the code"), (2154, "is the zone")] {
            assert!(said(code).unwrap().contains(mistake), "{code}");
        }
    }

    #[test]
    fn units_and_order_of_map_coordinates_are_tried() {
        let map = |code| Crs::horizontal_of_wkt(&wkt_of_epsg(code).unwrap()).unwrap();
        let pennsylvania = map(2271);
        let [x, y, _] = pennsylvania.from_geodetic(at(-76.0, 41.5)).unwrap();
        let said = |x, y| outside_of_map(&pennsylvania, [x, y, 0.0]);
        assert_eq!(said(x, y), None);
        let metres = said(x * METRES_PER_FOOT, y * METRES_PER_FOOT).unwrap();
        assert!(
            metres.contains("EPSG:2271 (") && metres.contains("is coordinates in metres; set"),
            "{metres}"
        );
        let lambert = map(2154);
        let [x, y, _] = lambert.from_geodetic(at(3.0, 46.5)).unwrap();
        for ([x, y], mistake) in [
            ([y, x], "is that eastings and northings are exchanged"),
            ([x / METRES_PER_FOOT, y / METRES_PER_FOOT], "is coordinates in feet"),
            ([x + 5e6, y], "is the"),
        ] {
            let said = outside_of_map(&lambert, [x, y, 0.0]).unwrap();
            assert!(said.contains(mistake) && said.contains("`crs_of_input`"), "{said}");
        }
    }
}
