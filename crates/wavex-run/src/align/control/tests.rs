//! Files of control points.

use super::*;
use wavex_line::georef::keys::UnitKey;

const HEADER: &str = "name,east_m,north_m,ellipsoidal_height_m,sd_east_m,sd_north_m,sd_height_m";
const ROW: &str = "P1,500000,5300000,412.5,0.01,0.01,0.02";

fn with(text: &str, keys: &GeometryKeys, crs: Option<&str>) -> Result<Control, String> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("gcp.csv");
    std::fs::write(&path, text).unwrap();
    let constraints = AlignConstraints {
        control: Some(path.clone()),
        control_crs: crs.map(str::to_owned),
        ..AlignConstraints::default()
    };
    read(&constraints, keys, folder.path()).map(Option::unwrap).map_err(|failure| match failure {
        Failure::Wrong(problem) => problem.replace(&format!("{}: ", path.display()), ""),
        other => panic!("{other:?}"),
    })
}

fn in_zone(text: &str) -> Result<Control, String> {
    with(text, &GeometryKeys::default(), Some("utm:33N"))
}

fn problem(header: &str, row: &str) -> String {
    in_zone(&format!("{header}\n{row}\n")).map(|_| ()).unwrap_err()
}

#[test]
fn points_are_read_in_their_system() {
    let text = format!(
        "\u{feff}{HEADER},slope_deg,aspect_deg\r\n{ROW},30,90\r\n\nP2,500010,5300000,410,0.01,0.02,0.03,,\n"
    );
    let control = in_zone(&text).unwrap();
    assert_eq!(control.names, ["P1", "P2"]);
    assert_eq!(control.heights, "ellipsoidal");
    let [first, second] = control.points[..] else { panic!() };
    let normal = first.normal.unwrap();
    assert!((normal[0] - 0.5).abs() < 1e-12 && normal[1].abs() < 1e-12, "it faces east: {normal:?}");
    assert_eq!((second.normal, second.sd_m), (None, [0.01, 0.02, 0.03]));
    let squares = (0..3).map(|k| (first.position_in_ecef_m[k] - second.position_in_ecef_m[k]).powi(2));
    let distance_m = squares.sum::<f64>().sqrt();
    // The zone's scale is 0.9996 on its meridian; the ellipsoid is 412 m below.
    assert!((distance_m - 10.0047_f64.hypot(2.5)).abs() < 1e-3, "{distance_m}");
    // The same place in degrees.
    let crs = Crs::new(
        &Named::Epsg(32633),
        Geodetic { latitude_rad: 0.0, longitude_rad: 0.0, height_m: 0.0 },
        None,
        None,
    );
    let place = crs.unwrap().to_geodetic([500_000.0, 5_300_000.0, 412.5]).unwrap();
    let [longitude, latitude] = [place.longitude_rad, place.latitude_rad].map(f64::to_degrees);
    let header = HEADER.replacen("east_m,north_m", "longitude_deg,latitude_deg", 1);
    let text = format!("{header}\nP1,{longitude},{latitude},412.5,0.01,0.01,0.02\n");
    let same = with(&text, &GeometryKeys::default(), Some("geodetic")).unwrap();
    for (a, b) in same.points[0].position_in_ecef_m.iter().zip(first.position_in_ecef_m) {
        assert!((a - b).abs() < 1e-6);
    }
}

/// Feet and degrees do not pass as metres.
#[test]
fn units_are_those_of_the_system() {
    let feet = HEADER
        .replacen("east_m,north_m", "east_us_ft,north_us_ft", 1)
        .replace("height_m,sd", "height_us_ft,sd");
    let row = "P1,984250,200000,32.808333333333334,0.01,0.01,0.02";
    let of =
        |header: &str, crs: &str| with(&format!("{header}\n{row}\n"), &GeometryKeys::default(), Some(crs));
    let found = of(&feet, "EPSG:2263").unwrap().points[0];
    let crs = Crs::new(
        &Named::Epsg(2263),
        Geodetic { latitude_rad: 0.0, longitude_rad: 0.0, height_m: 0.0 },
        None,
        Some(Unit::metre()),
    );
    let place = crs.unwrap().from_ecef(found.position_in_ecef_m).unwrap();
    let expected = [984_250.0 * 1200.0 / 3937.0, 200_000.0 * 1200.0 / 3937.0, 10.0];
    assert!(place.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-3), "{place:?}");
    let problem = of(HEADER, "EPSG:2263").map(|_| ()).unwrap_err();
    assert!(
        problem.contains("are in US survey foot, but those of the file in metre; correct the heading"),
        "{problem}"
    );
    let problem = of(HEADER, "geodetic").map(|_| ()).unwrap_err();
    assert!(problem.ends_with("is in degrees: give longitude_deg and latitude_deg"), "{problem}");
    // A job in feet has coordinates in feet, whatever its system.
    let keys =
        GeometryKeys { crs: Some("utm:33N".into()), unit: Some(UnitKey::Ft), ..GeometryKeys::default() };
    let problem = with(&format!("{HEADER}\n{ROW}\n"), &keys, None).map(|_| ()).unwrap_err();
    assert!(problem.contains("are in foot, but those of the file in metre"), "{problem}");
}

#[test]
fn systems_must_be_known() {
    let text = format!("{HEADER}\n{ROW}\n");
    let of =
        |crs: Option<&str>, text: &str| with(text, &GeometryKeys::default(), crs).map(|_| ()).unwrap_err();
    for (crs, expected) in [
        (None, "its coordinate reference system is not known: give `--control-crs`, such as EPSG:25833"),
        (Some("utm"), "`utm` names no zone: give `--control-crs`, such as utm:33N"),
        (Some("EPSG:99999"), "99999"),
        (Some("absent.wkt"), "give utm:33N, EPSG:2154, geodetic or a WKT file"),
    ] {
        let problem = of(crs, &text);
        assert!(problem.contains(expected), "{problem}");
    }
    let above = text.replace("ellipsoidal_height_m", "height_above_geoid_m");
    let problem = of(Some("utm:33N"), &above);
    assert!(
        problem.starts_with("its heights are above a geoid, but the job names none; set `geoid`"),
        "{problem}"
    );
    let keys = GeometryKeys { crs: Some("utm:33N".into()), ..GeometryKeys::default() };
    assert!(with(&text, &keys, None).is_ok(), "that of the job");
}

#[test]
fn problems_are_named_with_their_line() {
    let without = |part: &str| HEADER.replace(part, "");
    for (header, row, expected) in [
        (HEADER.replace(',', ";"), "", "line 1: columns are not separated by commas; give a CSV file with"),
        (without(",sd_height_m"), "", "line 1: column sd_height_m is missing"),
        (
            without("ellipsoidal_height_m,"),
            "",
            "line 1: column ellipsoidal_height_m or height_above_geoid_m is missing",
        ),
        (format!("{HEADER},z"), "", "line 1: unknown column `z`"),
        (format!("{HEADER},name"), "", "line 1: a second column of the meaning of `name`"),
        (format!("{HEADER},slope_deg"), "", "line 1: column aspect_deg is missing"),
        (format!("{HEADER},longitude_deg"), "", "line 1: coordinates of two systems"),
        (HEADER.replacen("north_m", "north_ft", 1), "", "line 1: east is in metre, north in foot"),
        (
            HEADER.to_owned(),
            "P1,500000,5300000,412.5,0.01,0.01",
            "line 2: 6 columns instead of 7; use points as decimal",
        ),
        (HEADER.to_owned(), "P1,x,5300000,412.5,0.01,0.01,0.02", "line 2: east is `x`; give a number from"),
        (HEADER.to_owned(), "P1,500000,5300000,nan,0.01,0.01,0.02", "line 2: ellipsoidal_height is `nan`"),
        (
            HEADER.to_owned(),
            "P1,500000,5300000,412.5,0.01,0.01,20",
            "line 2: sd_height_m is `20`; give a number from 0 to 10",
        ),
        (
            HEADER.to_owned(),
            "P1,500000,5300000,412.5,0.01,0,0.02",
            "line 2: sd_north_m is 0; give the SD in metres",
        ),
        (HEADER.to_owned(), ",500000,5300000,412.5,0.01,0.01,0.02", "line 2: it has no name"),
        (HEADER.to_owned(), "", "it has no points"),
    ] {
        let problem = problem(&header, row);
        assert!(problem.starts_with(expected), "{problem}");
    }
    let twice = problem(HEADER, &format!("{ROW}\n{ROW}"));
    assert_eq!(twice, "line 3: `P1` is already in line 2; give each point its own name");
}
