//! Rejected systems, texts and positions, with their messages.

use super::*;

#[test]
fn unsupported_systems_are_errors() {
    let error = |word: &str| Crs::new(&named(word), NOWHERE, None, None).unwrap_err().to_string();
    assert_eq!(
        error("EPSG:99999"),
        "EPSG:99999 is not in the table of coordinate reference systems; check the code, or use a WKT file"
    );
    assert_eq!(
        error("EPSG:27700"),
        "EPSG:27700 (OSGB 1936 / British National Grid): its datum, OSGB_1936, uses another ellipsoid \
         (Airy 1830), but datum shifts are not supported; choose a CRS on WGS 84, ETRS89, NAD83 or a \
         similar frame, or build wavex with the feature `proj`"
    );
    assert!(error("EPSG:23032").contains("European_Datum_1950, uses another ellipsoid (International 1924)"));
    assert!(error("EPSG:2100").contains("Greek_Geodetic_Reference_System_1987, is metres away from WGS 84"));
    assert!(error("EPSG:3296").contains(", has a shift to WGS 84"));
    assert_eq!(
        error("EPSG:2048"),
        "EPSG:2048 (Hartebeesthoek94 / Lo19): its axes are `wsu`; choose a CRS with eastings and northings \
         from Greenwich, or build wavex with the feature `proj`"
    );
    let error = Crs::new(&Named::Ecef, NOWHERE, geoid("egm96"), None).unwrap_err().to_string();
    assert_eq!(
        error,
        "EPSG:4978 (WGS 84): earth-centred coordinates have no height to which the geoid egm96 could \
         apply; remove the geoid, or choose a projected or geodetic system"
    );
}

#[test]
fn invalid_wkt_is_an_error() {
    let error = |text: &str| of_wkt(text).unwrap_err().to_string();
    assert_eq!(
        error("PROJCS[\"x\""),
        "the WKT cannot be read: a comma or a closing bracket is expected at character 11; check the text, \
         or use an EPSG code"
    );
    assert!(
        error(r#"VERT_CS["x",UNIT["metre",1]]"#)
            .contains("VERT_CS is not a projected, geodetic or earth-centred system")
    );
    let unknown = ESRI.replace("Lambert_Conformal_Conic", "Origami");
    assert!(error(&unknown).starts_with("the WKT cannot be read: WKT error: No projection mapping found"));
    let equator = ESRI.replace("31.8833333333333", "-30.1166666666667");
    assert!(error(&equator).contains(": its standard parallels define no cone; choose another system"));
    let paris = ESRI.replace("PRIMEM[\"Greenwich\",0.0]", "PRIMEM[\"Paris\",2.33722917]");
    assert!(error(&paris).contains(": its prime meridian is `2.33722917`; choose a CRS with"));
    let letters = ESRI.replace("False_Easting\",2296583.333", "False_Easting\",\"far\"");
    assert!(error(&letters).contains("the WKT cannot be read"), "{}", error(&letters));
    let nowhere = ESRI.replace("Central_Meridian", "Middle");
    assert!(
        error(&nowhere).ends_with(
            ": its projection has no central_meridian; complete the parameters in its WKT, or use an EPSG \
             code"
        ),
        "{}",
        error(&nowhere)
    );
    let no_parallel = ESRI.replace("Standard_Parallel_1", "One");
    assert!(
        error(&no_parallel).contains(": its projection has no standard_parallel_1; complete"),
        "{}",
        error(&no_parallel)
    );
    let no_unit = ESRI.replace("0.304800609601219]]", "0]]");
    assert!(error(&no_unit).contains(": its unit of length is unknown; use a WKT file"));
}

/// A WKT 1 CRS on WGS 84 with these parameters.
fn projected(projection: &str, parameters: &[(&str, f64)]) -> String {
    let parameters: String =
        parameters.iter().map(|(name, value)| format!(r#"PARAMETER["{name}",{value}],"#)).collect();
    format!(
        r#"PROJCS["own",GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.257223563]],PRIMEM["Greenwich",0],UNIT["degree",0.0174532925199433]],PROJECTION["{projection}"],{parameters}UNIT["metre",1]]"#
    )
}

const NATURAL: [(&str, f64); 2] = [("latitude_of_origin", 49.5), ("central_meridian", 24.5)];
const CENTRE: [(&str, f64); 2] = [("latitude_of_center", 49.5), ("longitude_of_center", 24.5)];
const FALSE: [(&str, f64); 2] = [("false_easting", 500_000.0), ("false_northing", 200_000.0)];
const SCALE: (&str, f64) = ("scale_factor", 0.9999);
const PARALLEL: (&str, f64) = ("standard_parallel_1", 52.0);
const SECOND: (&str, f64) = ("standard_parallel_2", 47.0);
const AZIMUTH: (&str, f64) = ("azimuth", 30.288_139_722_222_2);
const SKEW: (&str, f64) = ("rectified_grid_angle", 53.130_102_361_111_1);

/// Supported WKT 1 methods with their required parameters.
fn methods() -> Vec<(&'static str, Vec<(&'static str, f64)>)> {
    let of = |parts: &[&[(&'static str, f64)]]| [parts.concat(), FALSE.to_vec()].concat();
    vec![
        ("Transverse_Mercator", of(&[&NATURAL, &[SCALE]])),
        ("Lambert_Conformal_Conic_1SP", of(&[&NATURAL, &[SCALE]])),
        ("Lambert_Conformal_Conic_2SP", of(&[&NATURAL, &[PARALLEL, SECOND]])),
        ("Albers_Conic_Equal_Area", of(&[&CENTRE, &[PARALLEL, SECOND]])),
        ("Equidistant_Conic", of(&[&CENTRE, &[PARALLEL, SECOND]])),
        ("Lambert_Azimuthal_Equal_Area", of(&[&CENTRE])),
        ("Azimuthal_Equidistant", of(&[&CENTRE])),
        ("Mercator_1SP", of(&[&NATURAL[1..], &[SCALE]])),
        ("Mercator_2SP", of(&[&NATURAL[1..], &[PARALLEL]])),
        ("Oblique_Stereographic", of(&[&NATURAL, &[SCALE]])),
        ("Stereographic", of(&[&NATURAL, &[SCALE]])),
        ("Polyconic", of(&[&NATURAL])),
        ("Cassini_Soldner", of(&[&NATURAL])),
        ("Krovak", of(&[&CENTRE, &[AZIMUTH, SCALE]])),
        ("Cylindrical_Equal_Area", of(&[&NATURAL[1..], &[PARALLEL]])),
        ("Hotine_Oblique_Mercator", of(&[&CENTRE, &[AZIMUTH, SKEW, SCALE]])),
        ("Hotine_Oblique_Mercator_Azimuth_Center", of(&[&CENTRE, &[AZIMUTH, SKEW, SCALE]])),
    ]
}

/// A missing parameter would count as 0: each one is reported by name, for every projection.
#[test]
fn every_projection_parameter_is_required() {
    for (method, parameters) in methods() {
        of_wkt(&projected(method, &parameters)).unwrap_or_else(|error| panic!("{method}: {error}"));
        for (missing, _) in &parameters {
            let rest: Vec<_> = parameters.iter().filter(|(name, _)| name != missing).copied().collect();
            let found = of_wkt(&projected(method, &rest));
            // Only this angle has a default other than 0, as in PROJ: the azimuth.
            if *missing == "rectified_grid_angle" {
                assert!(found.is_ok(), "{method}");
                continue;
            }
            let error = found.map(|crs| crs.name().to_owned()).unwrap_err().to_string();
            let name = match *missing {
                "latitude_of_center" => "latitude_of_origin",
                "longitude_of_center" if !method.starts_with("Hotine") => "central_meridian",
                name => name,
            };
            assert!(
                error.starts_with("own: its projection has no ") && error.contains(name),
                "{method} without {missing}: {error}"
            );
        }
        let error = of_wkt(&projected(method, &[])).map(|_| ()).unwrap_err().to_string();
        assert!(
            error.contains("false_easting, false_northing; complete the parameters in its WKT"),
            "{error}"
        );
    }
}

/// Methods that differ from PROJ and unknown parameters are rejected rather than ignored.
#[test]
fn unsupported_parameters_are_errors() {
    let error = |text: &str| of_wkt(text).map(|_| ()).unwrap_err().to_string();
    let miller = projected("Miller_Cylindrical", &[NATURAL[1], FALSE[0], FALSE[1]]);
    assert_eq!(
        error(&miller),
        "own: its projection method, Miller_Cylindrical, is not known to agree with PROJ; choose another \
         system, or build wavex with the feature `proj`"
    );
    let michigan = projected(
        "Lambert_Conformal_Conic_2SP",
        &[NATURAL[0], NATURAL[1], PARALLEL, SECOND, FALSE[0], FALSE[1], SCALE],
    );
    assert_eq!(
        error(&michigan),
        "own: its parameter `scale_factor` is not known for the projection; correct its name, use an EPSG \
         code, or build wavex with the feature `proj`"
    );
    let south = projected("Cassini_Soldner", &[NATURAL[0], NATURAL[1], FALSE[0], FALSE[1]])
        .replace(r#"UNIT["metre",1]]"#, r#"UNIT["metre",1],AXIS["y",SOUTH],AXIS["x",WEST]]"#);
    assert!(
        error(&south).contains(": its axes do not point east and north; choose a CRS with"),
        "{}",
        error(&south)
    );
    let extended = |proj: &str| {
        projected("custom", &[]).replace(
            r#"UNIT["metre",1]]"#,
            &format!(r#"UNIT["metre",1],EXTENSION["PROJ4","{proj} +units=m"]]"#),
        )
    };
    assert!(of_wkt(&extended("+proj=laea +lat_0=52 +lon_0=10 +ellps=GRS80")).is_ok());
    for (proj, problem) in [
        ("+proj=ob_tran +o_proj=longlat", "its projection method, custom, is not known"),
        ("+proj=omerc +lonc=10 +alpha=5 +no_rot", "its PROJ parameter `no_rot` is not known for `omerc`"),
        ("+proj=laea +lat_0=52 +towgs84=100,0,0", "its PROJ string has a datum shift to WGS 84"),
        ("+proj=laea +lat_0=52 +nadgrids=x.gsb", "its PROJ string has a datum shift to WGS 84"),
        ("+proj=laea +lat_0=52 +ellps=bessel", "its PROJ string has another figure of the earth"),
        ("+proj=tmerc +lat_0=52 +R=6371000", "its PROJ string has another figure of the earth"),
        ("+proj=utm +ellps=WGS84", "its PROJ string has no UTM zone from 1 to 60"),
    ] {
        assert!(error(&extended(proj)).contains(problem), "{proj}: {}", error(&extended(proj)));
    }
}

/// No CRS of the table lacks parameters.
#[test]
fn table_systems_have_all_parameters() {
    for code in [
        2154, 3035, 3031, 3857, 5041, 3408, 6966, 2193, 3765, 5514, 3067, 3794, 28992, 3844, 5880, 6372, 3347,
    ] {
        let error = Definition::of_epsg(code).map(|_| ()).err();
        assert!(!matches!(error, Some(CrsError::Incomplete { .. })), "{code}: {error:?}");
    }
}

#[test]
fn invalid_positions_are_reported() {
    let error = crs("utm:33N").from_geodetic(place(-90.0, 3.0, 0.0)).unwrap_err().to_string();
    assert_eq!(
        error,
        "EPSG:32633 (WGS 84 / UTM zone 33N): the point at latitude 3.000000, longitude -90.000000 degrees \
         cannot be projected; choose a CRS for that area; with a trajectory, check its positions"
    );
    let error = crs("EPSG:2154").to_ecef([f64::NAN, 0.0, 0.0]).unwrap_err().to_string();
    assert_eq!(
        error,
        "EPSG:2154 (RGF93 / Lambert-93): the coordinates NaN, 0 are outside the projection; check them and \
         their unit"
    );
    assert!(crs("utm:33N").from_ecef([f64::NAN; 3]).is_err());
    let crs = Crs::new(&named("utm:32N"), NOWHERE, geoid("here"), None).unwrap();
    assert_eq!(
        crs.from_geodetic(place(9.0, 39.0, 0.0)).unwrap_err().to_string(),
        "geoid here: the point at latitude 39.000000, longitude 9.000000 degrees lies outside its area, \
         latitude 40 to 50, longitude 0 to 20; use a geoid that covers the survey, or remove it for \
         ellipsoidal heights"
    );
}

#[test]
fn the_first_invalid_position_of_a_batch_is_reported() {
    let crs = crs("utm:33N");
    let mut places: Vec<Vector> = (0..40)
        .map(|i| crs.ellipsoid().ecef_of(place(if i < 20 { 15.0 } else { -90.0 - f64::from(i) }, 3.0, 0.0)))
        .collect();
    let error = crs.replace_ecef(&mut places).unwrap_err().to_string();
    assert!(
        error.contains("the point at latitude 3.000000, longitude -110.000000 degrees cannot"),
        "{error}"
    );
}
