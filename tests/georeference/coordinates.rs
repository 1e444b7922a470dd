//! The same flight in every kind of coordinates.

use wavex::geo::crs::{Crs, Named};
use wavex::geo::ellipsoid::{Geodetic, WGS84};
use wavex::geo::transverse_mercator::{Parameters, TransverseMercator};

use super::flights::QUIET;
use super::made::{Flight, Placed, distance_m, fly, write_geoid};

const KEYS: &str = "start_deg = [-122.0, 41.0]\nheading_deg = 70.0\nroll_deg = 8.0\npitch_deg = 5.0\n\
                    lever_arm_m = [0.8, -0.35, 1.1]\nboresight_deg = [0.4, -0.7, 1.3]\n";
const GEOMETRY: &str = "trajectory = '*.out'\n\
                        calibration = { lever_arm_m = [0.8, -0.35, 1.1], boresight_deg = [0.4, -0.7, 1.3] }\n";

fn flight() -> Flight {
    fly(&format!("{QUIET}{KEYS}"))
}

/// Where the true returns are: zone 10 north, in which the flight starts.
fn places(flight: &Flight) -> Vec<Geodetic> {
    let map = TransverseMercator::new(WGS84, Parameters::utm(10, true));
    let place = |[x, y, height_m]: [f64; 3]| {
        let (latitude_rad, longitude_rad) = map.unproject(x, y);
        Geodetic { latitude_rad, longitude_rad, height_m }
    };
    flight.truth.iter().map(|truth| place(truth.point_m)).collect()
}

#[track_caller]
fn placed(flight: &Flight, keys: &str) -> Placed {
    flight.place(&format!("{GEOMETRY}{keys}"), |truth| truth.range_m).unwrap()
}

#[track_caller]
fn worst(what: &str, placed: &Placed, expected: impl Iterator<Item = [f64; 3]>) -> f64 {
    assert!(placed.points.len() > 4000);
    let worst = expected.zip(&placed.points).map(|(a, b)| distance_m(a, *b)).fold(0.0, f64::max);
    println!("{what}: {} points, the farthest {worst:.2e} off", placed.points.len());
    worst
}

#[test]
fn geodetic_coordinates_are_degrees() {
    let flight = flight();
    let placed = placed(&flight, "crs = 'geodetic'");
    // A metre to the north, and to the east, in degrees.
    let metre = [1.0 / 84_300.0, 1.0 / 111_040.0, 1.0];
    let in_metres = |point: [f64; 3]| std::array::from_fn(|axis| point[axis] / metre[axis]);
    let expected = places(&flight).into_iter().map(|place| {
        in_metres([place.longitude_rad.to_degrees(), place.latitude_rad.to_degrees(), place.height_m])
    });
    let placed = Placed { points: placed.points.iter().map(|point| in_metres(*point)).collect(), ..placed };
    assert!(worst("geodetic, m", &placed, expected) < 1e-3);
    assert!(placed.wkt.unwrap().starts_with("GEOGCS[\"WGS 84\""));
}

#[test]
fn earth_centred_coordinates_are_metres() {
    let flight = flight();
    let placed = placed(&flight, "crs = 'ecef'");
    let expected = places(&flight).into_iter().map(|place| WGS84.ecef_of(place));
    assert!(worst("earth-centred, m", &placed, expected) < 1e-3);
    assert!(placed.wkt.unwrap().starts_with("GEOCCS["));
}

/// A zone of one's own choice, in international feet.
#[test]
fn a_zone_and_a_unit_can_be_chosen() {
    let flight = flight();
    let placed = placed(&flight, "crs = 'utm:11N'\nunit = 'ft'");
    let map = TransverseMercator::new(WGS84, Parameters::utm(11, true));
    let expected = places(&flight).into_iter().map(|place| {
        let (x, y) = map.project(place.latitude_rad, place.longitude_rad);
        [x, y, place.height_m].map(|metres| metres / 0.3048)
    });
    assert!(worst("zone 11, feet", &placed, expected) < 1e-3 / 0.3048);
    assert!(placed.wkt.unwrap().contains("UNIT[\"foot\",0.3048"));
}

/// A geoid whose heights are a plane, which interpolation between its values gives back as it is.
fn undulation_m(latitude: f64, longitude: f64) -> f64 {
    -25.0 + 0.5 * (latitude - 41.0) - 0.25 * (longitude + 122.0)
}

/// California's first zone: a conformal conic in US survey feet.
#[test]
fn a_conic_in_feet_with_a_geoid() {
    let flight = flight();
    std::fs::create_dir(flight.path("geoids")).unwrap();
    write_geoid(&flight.path("geoids/Plane.GTX"), [40.0, -123.0], undulation_m);
    let placed = placed(&flight, "crs = 'EPSG:2225'\ngeoid = 'plane'\ngeoid_dir = 'geoids'");
    let places = places(&flight);
    let crs = Crs::new(&Named::Epsg(2225), places[0], None, None).unwrap();
    let expected = places.iter().map(|place| {
        let [x, y, _] = crs.from_geodetic(*place).unwrap();
        let above_m =
            place.height_m - undulation_m(place.latitude_rad.to_degrees(), place.longitude_rad.to_degrees());
        [x, y, above_m * 3937.0 / 1200.0]
    });
    assert!(worst("conic in US survey feet", &placed, expected) < 1e-3 * 3937.0 / 1200.0);
    let wkt = placed.wkt.unwrap();
    assert!(wkt.starts_with("COMPD_CS[") && wkt.contains("VERT_CS["), "{wkt}");
}

#[test]
fn a_point_outside_the_geoid_is_named() {
    let flight = fly(&format!("{QUIET}start_deg = [-110.0, 41.0]"));
    write_geoid(&flight.path("plane.gtx"), [40.0, -123.0], undulation_m);
    let error = flight.place("trajectory = '*.out'\ngeoid = 'PLANE'", |truth| truth.range_m).err().unwrap();
    assert!(
        error.starts_with("geoid plane: the point at latitude 41.0")
            && error.ends_with(
                " degrees lies outside its area, latitude 40 to 42, longitude -123 to -121; give a geoid that covers the \
                 survey, or leave it out for heights above the ellipsoid"
            ),
        "{error}"
    );
}
