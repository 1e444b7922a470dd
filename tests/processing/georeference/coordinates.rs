//! One flight in every kind of coordinate system.

use wavex_formats::trajectory::sbet::RECORD_BYTES;
use wavex_geodesy::crs::{Crs, Named};
use wavex_geodesy::ellipsoid::{Geodetic, WGS84};
use wavex_geodesy::transverse_mercator::{TransverseMercator, TransverseMercatorParameters};

use super::flights::QUIET;
use wavex_testkit::georeferenced_flight::{Flight, Placed, distance_m, fly, write_geoid};

const KEYS: &str = "start_deg = [-122.0, 41.0]\nheading_deg = 70.0\nroll_deg = 8.0\npitch_deg = 5.0\n\
                    lever_arm_m = [0.8, -0.35, 1.1]\nboresight_deg = [0.4, -0.7, 1.3]\n";
const GEOMETRY: &str = "trajectory = '*.out'\n\
                        calibration = { lever_arm_m = [0.8, -0.35, 1.1], boresight_deg = [0.4, -0.7, 1.3] }\n";

fn flight() -> Flight {
    fly(&format!("{QUIET}{KEYS}"))
}

/// Positions of the true returns: UTM zone 10 north, in which the flight starts.
fn places(flight: &Flight) -> Vec<Geodetic> {
    let map = TransverseMercator::new(WGS84, TransverseMercatorParameters::utm(10, true));
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
    // One metre north and east, in degrees.
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

/// A user-defined zone, in international feet.
#[test]
fn a_zone_and_a_unit_can_be_chosen() {
    let flight = flight();
    let placed = placed(&flight, "crs = 'utm:11N'\nunit = 'ft'");
    let map = TransverseMercator::new(WGS84, TransverseMercatorParameters::utm(11, true));
    let expected = places(&flight).into_iter().map(|place| {
        let (x, y) = map.project(place.latitude_rad, place.longitude_rad);
        [x, y, place.height_m].map(|metres| metres / 0.3048)
    });
    assert!(worst("zone 11, feet", &placed, expected) < 1e-3 / 0.3048);
    assert!(placed.wkt.unwrap().contains("UNIT[\"foot\",0.3048"));
}

/// A planar geoid, which interpolation reproduces exactly.
fn undulation_m(latitude: f64, longitude: f64) -> f64 {
    -25.0 + 0.5 * (latitude - 41.0) - 0.25 * (longitude + 122.0)
}

/// California zone 1: a conformal conic in US survey feet.
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

/// Writes the trajectory as TRJ in UTM zone 10.
///
/// The flight starts at the central meridian, so grid north equals true north within the length of
/// a line.
fn write_trj(flight: &Flight, name: &str, height_m: impl Fn(Geodetic) -> f64) {
    let bytes = std::fs::read(flight.path("a.out")).unwrap();
    let (records, _) = bytes.as_chunks::<RECORD_BYTES>();
    let map = TransverseMercator::new(WGS84, TransverseMercatorParameters::utm(10, true));
    let mut trj = b"TSCANTRJ".to_vec();
    for field in [20_010_715, 1376, records.len() as i32, 64] {
        trj.extend(field.to_le_bytes());
    }
    trj.resize(1376, 0);
    for bytes in records {
        let value = |index: usize| f64::from_le_bytes(bytes[8 * index..8 * index + 8].try_into().unwrap());
        let [time_s, latitude_rad, longitude_rad, above_m] = [0, 1, 2, 3].map(value);
        let (x, y) = map.project(latitude_rad, longitude_rad);
        let z = height_m(Geodetic { latitude_rad, longitude_rad, height_m: above_m });
        let convergence_rad = (longitude_rad + 123f64.to_radians()) * latitude_rad.sin();
        let [heading, roll, pitch] =
            [value(9) - value(10) - convergence_rad, value(7), value(8)].map(f64::to_degrees);
        for field in [time_s, x, y, z, heading, roll, pitch] {
            trj.extend(field.to_le_bytes());
        }
        trj.extend([1, 2, 3, 4, 5, 0, 6, 0]);
    }
    std::fs::write(flight.path(name), trj).unwrap();
}

/// The job defines the height reference of a trajectory: for TRJ, which does not state it, and for
/// other formats.
#[test]
fn heights_of_a_trajectory_count_from_what_the_job_says() {
    let flight = fly(&format!("{QUIET}start_deg = [-123.0, 41.0]\n"));
    let plane = |latitude, longitude| 46.0 + 0.5 * (latitude - 41.0) - 0.25 * (longitude + 122.0);
    write_geoid(&flight.path("plane.gtx"), [40.0, -124.0], plane);
    let undulation_m =
        |place: Geodetic| plane(place.latitude_rad.to_degrees(), place.longitude_rad.to_degrees());
    write_trj(&flight, "ellipsoid.trj", |place| place.height_m);
    write_trj(&flight, "geoid.trj", |place| place.height_m - undulation_m(place));
    let map = TransverseMercator::new(WGS84, TransverseMercatorParameters::utm(10, true));
    let above_geoid: Vec<[f64; 3]> = flight
        .truth
        .iter()
        .map(|truth| {
            let [x, y, height_m] = truth.point_m;
            let (latitude_rad, longitude_rad) = map.unproject(x, y);
            [x, y, height_m - undulation_m(Geodetic { latitude_rad, longitude_rad, height_m })]
        })
        .collect();
    let keys = "crs = 'utm:10N'\ngeoid = 'plane'\n";
    let place = |geometry: String| flight.place(&geometry, |truth| truth.range_m).unwrap();
    let notes = |placed: &Placed| format!("{:?}", placed.cx.counters().notes);
    let silent = "a TRJ does not define its height reference: heights are assumed to be above ";
    for (file, said) in [
        ("ellipsoid.trj", "trajectory_heights = 'ellipsoid'"),
        ("geoid.trj", "trajectory_heights = 'geoid'"),
        ("geoid.trj", ""),
        ("a.out", "trajectory_heights = 'ellipsoid'"),
    ] {
        let placed = place(format!("trajectory = '{file}'\n{keys}{said}"));
        // The TRJ heading refers to meridians of a sphere: 0.1 mm at the edge of the swath.
        let off = worst(&format!("{file} {said}"), &placed, above_geoid.iter().copied());
        assert!(off < 5e-3, "{file} {said}: {off} m");
        let is_said = notes(&placed).contains(&format!("{silent}the geoid plane; if that is wrong"));
        assert_eq!(is_said, said.is_empty(), "{file} {said}: {}", notes(&placed));
    }
    // Heights of another format, declared as above the geoid: the geoid height is added.
    let higher = place(format!("trajectory = 'a.out'\n{keys}trajectory_heights = 'geoid'"));
    let expected = flight.truth.iter().map(|truth| truth.point_m);
    let off = worst("SBET above the geoid", &higher, expected);
    assert!(off < 5e-3, "{off} m");
    let without = place("trajectory = 'ellipsoid.trj'\ncrs = 'utm:10N'".to_owned());
    assert!(
        notes(&without).contains(&format!("{silent}the ellipsoid; if that is wrong")),
        "{}",
        notes(&without)
    );
}

/// The message names the WKT file that cannot be used.
#[test]
fn a_wkt_that_cannot_be_used_names_its_file() {
    let flight = fly(QUIET);
    std::fs::write(flight.path("zone.prj"), "PROJCS[\"x\"").unwrap();
    let error = flight.place("trajectory = '*.out'\ncrs = 'zone.prj'", |truth| truth.range_m).err().unwrap();
    let named = format!("{}: the WKT cannot be read: ", flight.path("zone.prj").display());
    assert!(error.starts_with(&named), "{error}");
}

#[test]
fn a_point_outside_the_geoid_is_named() {
    let flight = fly(&format!("{QUIET}start_deg = [-110.0, 41.0]"));
    write_geoid(&flight.path("plane.gtx"), [40.0, -123.0], undulation_m);
    let error = flight.place("trajectory = '*.out'\ngeoid = 'PLANE'", |truth| truth.range_m).err().unwrap();
    assert!(
        error.starts_with("geoid plane: the point at latitude 41.0")
            && error.ends_with(
                " degrees lies outside its area, latitude 40 to 42, longitude -123 to -121; use a geoid \
                 that covers the survey, or remove it for ellipsoidal heights"
            ),
        "{error}"
    );
}
