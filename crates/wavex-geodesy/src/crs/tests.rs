//! Coordinates are compared with PROJ 9.5.1 (through pyproj 3.7.2); `tests/python/check_crs.py` does so for many more.

use proptest::prelude::*;

use super::*;
use crate::ellipsoid::{GRS80, WGS84};
use crate::geoid::Grid;

const NOWHERE: Geodetic = Geodetic { latitude_rad: 0.0, longitude_rad: 0.0, height_m: 0.0 };

fn place(longitude_deg: f64, latitude_deg: f64, height_m: f64) -> Geodetic {
    Geodetic { latitude_rad: latitude_deg.to_radians(), longitude_rad: longitude_deg.to_radians(), height_m }
}

fn named(word: &str) -> Named {
    Named::parse(word).unwrap().unwrap()
}

fn crs(word: &str) -> Crs {
    Crs::new(&named(word), NOWHERE, None, None).unwrap()
}

fn of_wkt(text: &str) -> Result<Crs, CrsError> {
    Crs::new(&Named::Wkt(text.into()), NOWHERE, None, None)
}

/// A geoid of this name, 30 m above the ellipsoid in an area of Europe.
fn geoid(name: &str) -> Option<Arc<Geoid>> {
    let grid = Grid {
        south_deg: 40.0,
        west_deg: 0.0,
        latitude_step_deg: 10.0,
        longitude_step_deg: 10.0,
        rows: 2,
        columns: 3,
        heights_m: vec![30.0; 6],
    };
    Some(Arc::new(Geoid::new(name, grid).unwrap()))
}

fn apart(a: Vector, b: Vector) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

/// False eastings in feet are rounded to 0.1 µm when converted to metres.
#[test]
fn systems_agree_with_proj() {
    for (word, longitude, latitude, x, y) in [
        ("utm:33N", 12.5, 47.5, 311_721.566_438_456, 5_263_759.096_231_15),
        ("utm:33N", 21.0, -0.5, 1_168_856.201_483_264, -55_571.505_481_370),
        ("utm:33N", 3.0, 70.0, 44_517.171_795_343, 7_810_897.730_920_66),
        ("utm:56S", 151.2, -33.9, 333_568.941_011_552, 6_247_473.336_844_02),
        ("EPSG:2154", 2.3, 48.8, 648_583.262_125_228, 6_855_774.715_696_833),
        ("EPSG:6578", -97.7, 30.3, 3_127_546.442_529_794, 10_082_681.230_377_365),
        ("EPSG:2225", -122.5, 41.0, 6_423_664.628_129_591, 2_247_969.698_295_947),
        ("EPSG:2193", 174.8, -41.3, 1_750_697.521_334_191, 5_426_376.623_168_275),
        ("EPSG:3979", -75.7, 45.4, 1_511_127.635_735_647, -172_193.059_898_162),
        ("EPSG:3035", 5.2, 52.1, 3_992_354.836_448_035, 3_231_957.165_111_102),
        ("EPSG:5070", -100.2, 40.1, -354_804.344_917_499, 1_906_023.525_735_163),
        ("EPSG:3031", 45.0, -80.0, 770_166.179_002_347, 770_166.179_002_347),
        ("EPSG:3857", 12.5, 47.5, 1_391_493.634_915_92, 6_024_072.119_373_784),
        ("geodetic", 12.5, 47.5, 12.5, 47.5),
        ("EPSG:4979", -100.25, -47.5, -100.25, -47.5),
    ] {
        let crs = crs(word);
        let height = 123.0 / crs.height_unit().metres;
        let found = crs.from_geodetic(place(longitude, latitude, 123.0)).unwrap();
        assert!(apart(found, [x, y, height]) < 2e-7, "{word}: {found:?}");
        let back = crs.to_geodetic(found).unwrap();
        assert!((back.longitude_rad.to_degrees() - longitude).abs() < 1e-12, "{word}: {back:?}");
        assert!((back.latitude_rad.to_degrees() - latitude).abs() < 1e-12, "{word}: {back:?}");
    }
}

#[test]
fn earth_centred_coordinates_stay() {
    let place_m = [4_214_805.233_063_108, 934_399.824_249_622_6, 4_679_792.656_921_2];
    assert_eq!(crs("ecef").from_ecef(place_m).unwrap(), place_m);
    assert_eq!(crs("ecef").to_ecef(place_m).unwrap(), place_m);
    assert!(apart(crs("EPSG:4978").from_geodetic(place(12.5, 47.5, 400.0)).unwrap(), place_m) < 5e-9);
    let geodetic = crs("geodetic").from_ecef(place_m).unwrap();
    assert!(apart(geodetic, [12.5, 47.5, 400.0]) < 5e-9, "{geodetic:?}");
    let feet = Crs::new(&Named::Ecef, NOWHERE, None, Some(Unit::foot())).unwrap();
    assert_eq!(feet.from_ecef([0.3048, 3.048, -0.3048]).unwrap(), [1.0, 10.0, -1.0]);
    assert!(feet.wkt().contains(r#"UNIT["foot",0.3048"#));
}

#[test]
fn the_zone_follows_from_the_first_place() {
    for (longitude, latitude, name) in [
        (12.6, 47.8, "EPSG:32633 (WGS 84 / UTM zone 33N)"),
        (151.2, -33.9, "EPSG:32756 (WGS 84 / UTM zone 56S)"),
        (5.0, 60.0, "EPSG:32631 (WGS 84 / UTM zone 31N)"),
        (-180.0, 0.0, "EPSG:32601 (WGS 84 / UTM zone 1N)"),
    ] {
        let crs = Crs::new(&Named::Utm, place(longitude, latitude, 0.0), None, None).unwrap();
        assert_eq!(crs.name(), name);
    }
}

const ESRI: &str = concat!(
    r#"PROJCS["NAD_1983_2011_StatePlane_Texas_Central_FIPS_4203_Ft_US",GEOGCS["GCS_NAD_1983_2011","#,
    r#"DATUM["D_NAD_1983_2011",SPHEROID["GRS_1980",6378137.0,298.257222101]],PRIMEM["Greenwich",0.0],"#,
    r#"UNIT["Degree",0.0174532925199433]],PROJECTION["Lambert_Conformal_Conic"],"#,
    r#"PARAMETER["False_Easting",2296583.333],PARAMETER["False_Northing",9842500.0],"#,
    r#"PARAMETER["Central_Meridian",-100.333333333333],PARAMETER["Standard_Parallel_1",31.8833333333333],"#,
    r#"PARAMETER["Standard_Parallel_2",30.1166666666667],PARAMETER["Latitude_Of_Origin",29.6666666666667],"#,
    r#"UNIT["US survey foot",0.304800609601219]]"#,
);

const WKT_2: &str = concat!(
    r#"PROJCRS["Texas, central",BASEGEOGCRS["NAD83(2011)","#,
    r#"DATUM["NAD83 (National Spatial Reference System 2011)",ELLIPSOID["GRS 1980",6378137,298.257222101,"#,
    r#"LENGTHUNIT["metre",1]]],PRIMEM["Greenwich",0,ANGLEUNIT["degree",0.0174532925199433]],ID["EPSG",6318]],"#,
    r#"CONVERSION["c",METHOD["Lambert Conic Conformal (2SP)",ID["EPSG",9802]],"#,
    r#"PARAMETER["Latitude of false origin",29.6666666666667,ANGLEUNIT["degree",0.0174532925199433],ID["EPSG",8821]],"#,
    r#"PARAMETER["Longitude of false origin",-100.333333333333,ANGLEUNIT["degree",0.0174532925199433]],"#,
    r#"PARAMETER["Latitude of 1st standard parallel",31.8833333333333,ANGLEUNIT["degree",0.0174532925199433]],"#,
    r#"PARAMETER["Latitude of 2nd standard parallel",30.1166666666667,ANGLEUNIT["degree",0.0174532925199433]],"#,
    r#"PARAMETER["Easting at false origin",2296583.333,LENGTHUNIT["US survey foot",0.304800609601219]],"#,
    r#"PARAMETER["Northing at false origin",9842500,LENGTHUNIT["US survey foot",0.304800609601219]]],"#,
    r#"CS[Cartesian,2],AXIS["easting (X)",east,ORDER[1],LENGTHUNIT["US survey foot",0.304800609601219]],"#,
    r#"AXIS["northing (Y)",north,ORDER[2],LENGTHUNIT["US survey foot",0.304800609601219]],ID["EPSG",6578]]"#,
);

/// Fifteen digits of a third of a degree correspond to 0.1 µm.
#[test]
fn every_dialect_gives_the_same_coordinates() {
    let by_code = crs("EPSG:6578").from_geodetic(place(-97.7, 30.3, 50.0)).unwrap();
    for text in [ESRI, WKT_2, &crs("EPSG:6578").wkt()] {
        let crs = of_wkt(text).unwrap();
        assert!(apart(crs.from_geodetic(place(-97.7, 30.3, 50.0)).unwrap(), by_code) < 2e-7, "{text}");
        assert_eq!((crs.unit(), crs.height_unit()), (&Unit::us_survey_foot(), &Unit::us_survey_foot()));
    }
}

/// The WKT written to a LAS file can be read again, whatever the source and the unit.
#[test]
fn a_systems_wkt_is_the_system() {
    let oblique = r#"GEOGCS["d",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.257223563]],PRIMEM["Greenwich",0],UNIT["degree",0.0174532925199433]]"#;
    let one_parallel = format!(
        r#"PROJCS["one",{oblique},PROJECTION["Lambert_Conformal_Conic_1SP"],PARAMETER["latitude_of_origin",30.5],PARAMETER["central_meridian",-98],PARAMETER["scale_factor",0.9999],PARAMETER["false_easting",1000],PARAMETER["false_northing",0],UNIT["link",0.201168]]"#
    );
    let utm_2 = WKT_2
        .replace(
            "Lambert Conic Conformal (2SP)\",ID[\"EPSG\",9802]",
            "Transverse Mercator\",ID[\"EPSG\",9807]",
        )
        .replace("Latitude of false origin\",29.6666666666667", "Latitude of natural origin\",29.6")
        .replace("ID[\"EPSG\",8821]", "ID[\"EPSG\",8801]")
        .replace("Longitude of false origin", "Longitude of natural origin")
        .replace(
            r#"PARAMETER["Latitude of 1st standard parallel",31.8833333333333,ANGLEUNIT["degree",0.0174532925199433]],"#,
            r#"PARAMETER["Scale factor at natural origin",0.9999,SCALEUNIT["unity",1]],"#,
        )
        .replace(
            r#"PARAMETER["Latitude of 2nd standard parallel",30.1166666666667,ANGLEUNIT["degree",0.0174532925199433]],"#,
            "",
        )
        .replace("Easting at false origin", "False easting")
        .replace("Northing at false origin", "False northing");
    let equal_area_2 = WKT_2.replace(
        "Lambert Conic Conformal (2SP)\",ID[\"EPSG\",9802]",
        "Albers Equal Area\",ID[\"EPSG\",9822]",
    );
    let systems = [
        named("utm:14N"),
        named("EPSG:6578"),
        named("EPSG:5070"),
        named("EPSG:3857"),
        named("EPSG:4979"),
        named("geodetic"),
        named("ecef"),
        Named::Wkt(ESRI.into()),
        Named::Wkt(WKT_2.into()),
        Named::Wkt(one_parallel),
        Named::Wkt(utm_2),
        Named::Wkt(equal_area_2),
    ];
    for named in systems {
        for unit in [None, Some(Unit::metre()), Some(Unit::us_survey_foot()), Some(Unit::foot())] {
            let crs = Crs::new(&named, NOWHERE, None, unit).unwrap();
            let coordinates = crs.from_geodetic(place(-97.7, 30.3, 50.0)).unwrap();
            let again = of_wkt(&crs.wkt()).unwrap_or_else(|error| panic!("{error}: {}", crs.wkt()));
            let found = again.from_geodetic(place(-97.7, 30.3, 50.0)).unwrap();
            assert!(apart(found, coordinates) < 3e-7, "{named:?} {found:?} {coordinates:?} {}", crs.wkt());
            assert_eq!(again.height_unit(), crs.height_unit(), "{}", crs.wkt());
        }
    }
}

#[test]
fn a_unit_of_the_job_holds_for_all_three() {
    let feet = Crs::new(&named("utm:33N"), NOWHERE, None, Some(Unit::us_survey_foot())).unwrap();
    let found = feet.from_geodetic(place(15.0, 0.0, 1200.0)).unwrap();
    assert!(apart(found, [500_000.0 * 3937.0 / 1200.0, 0.0, 3937.0]) < 1e-8, "{found:?}");
    let wkt = feet.wkt();
    assert!(
        wkt.starts_with(r#"COMPD_CS["WGS 84 / UTM zone 33N (US survey foot) + Ellipsoidal height",PROJCS["#)
    );
    assert!(wkt.contains(r#"PARAMETER["false_easting",1640416.6666666667]"#), "{wkt}");
    assert!(!wkt.contains("32633"), "{wkt}");
    assert_eq!(
        wkt.matches(r#"UNIT["US survey foot",0.3048006096012192,AUTHORITY["EPSG","9003"]]"#).count(),
        2
    );
    let degrees = Crs::new(&Named::Geodetic, NOWHERE, None, Some(Unit::foot())).unwrap();
    assert!(apart(degrees.from_geodetic(place(9.0, 48.0, 0.3048)).unwrap(), [9.0, 48.0, 1.0]) < 1e-13);
}

#[test]
fn heights_count_from_the_geoid() {
    let crs = Crs::new(&named("utm:32N"), NOWHERE, geoid("EGM96"), None).unwrap();
    let found = crs.from_geodetic(place(9.0, 48.0, 530.0)).unwrap();
    assert_eq!(found[2], 500.0);
    assert!((crs.to_geodetic(found).unwrap().height_m - 530.0).abs() < 1e-12);
    assert!(crs.wkt().ends_with(concat!(
        r#",VERT_CS["EGM96 height",VERT_DATUM["EGM96 geoid",2005,AUTHORITY["EPSG","5171"]],"#,
        r#"UNIT["metre",1,AUTHORITY["EPSG","9001"]],AXIS["Up",UP],AUTHORITY["EPSG","5773"]]]"#
    )));
    let feet = Crs::new(&named("EPSG:2225"), NOWHERE, geoid("g2018u0"), None).unwrap();
    assert!(feet.wkt().ends_with(concat!(
        r#",VERT_CS["NAVD88 height",VERT_DATUM["North American Vertical Datum 1988",2005,AUTHORITY["EPSG","5103"]],"#,
        r#"UNIT["US survey foot",0.3048006096012192,AUTHORITY["EPSG","9003"]],AXIS["Up",UP],AUTHORITY["EPSG","6360"]]]"#
    )));
    let other = Crs::new(&named("utm:32N"), NOWHERE, geoid("local_2020"), None).unwrap().wkt();
    assert!(other.contains(r#"VERT_CS["local_2020 height",VERT_DATUM["local_2020",2005],UNIT["#), "{other}");
}

/// NAD83(2011) / California zone 1 (ftUS) + NAVD88 height (ftUS): neither unit is the metre.
#[test]
fn a_systems_own_vertical_part_names_the_heights() {
    let error = Crs::new(&named("EPSG:8714"), NOWHERE, None, None).unwrap_err().to_string();
    assert_eq!(
        error,
        "EPSG:8714 (NAD83 / California zone 1 (ftUS)): its heights are NAVD88 height (ftUS), which need a \
         geoid; set `geoid`, or use a CRS without a vertical part for ellipsoidal heights"
    );
    let crs = Crs::new(&named("EPSG:8714"), NOWHERE, geoid("mine"), None).unwrap();
    assert_eq!((crs.epsg(), crs.height_unit()), (Some(2225), &Unit::us_survey_foot()));
    assert!(
        crs.wkt().contains(
            r#"VERT_CS["NAVD88 height (ftUS)",VERT_DATUM["North American Vertical Datum 1988",2005"#
        )
    );
    let metres = Crs::new(&named("EPSG:8714"), NOWHERE, geoid("mine"), Some(Unit::metre())).unwrap();
    assert!(!metres.wkt().contains("6360"), "{}", metres.wkt());
}

#[test]
fn systems_that_cannot_be_had_say_why() {
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
fn texts_that_cannot_be_used_say_why() {
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
fn every_parameter_of_every_projection_is_needed() {
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
fn what_would_be_left_out_is_refused() {
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
fn systems_of_the_table_are_complete() {
    for code in [
        2154, 3035, 3031, 3857, 5041, 3408, 6966, 2193, 3765, 5514, 3067, 3794, 28992, 3844, 5880, 6372, 3347,
    ] {
        let error = Definition::of_epsg(code).map(|_| ()).err();
        assert!(!matches!(error, Some(CrsError::Incomplete { .. })), "{code}: {error:?}");
    }
}

/// The keys give heights in feet even if the code of the CRS does not, also for a CRS without a
/// code.
#[test]
fn keys_of_a_text_have_the_unit_of_heights() {
    let value = |keys: &GeoKeys, key: u16| {
        let words: Vec<u16> =
            keys.directory.as_chunks().0.iter().map(|word| u16::from_le_bytes(*word)).collect();
        words.chunks(4).skip(1).find(|entry| entry[0] == key).map(|entry| entry[3])
    };
    let of = |word: &str, geoid, unit| {
        let crs = Crs::new(&named(word), NOWHERE, geoid, unit).unwrap();
        let keys = geotiff_keys_of_wkt(&crs.wkt()).unwrap();
        assert_eq!(
            [3072, 3076, 4096, 4099].map(|key| value(&keys, key)),
            [3072, 3076, 4096, 4099].map(|key| value(&crs.geotiff_keys().unwrap(), key))
        );
        keys
    };
    let california = of("EPSG:2225", None, None);
    assert_eq!([3072, 3076, 4099].map(|key| value(&california, key)), [Some(2225), Some(9003), Some(9003)]);
    let navd = of("EPSG:2225", geoid("g2018u0"), None);
    assert_eq!([4096, 4099].map(|key| value(&navd, key)), [Some(6360), Some(9003)]);
    let feet = of("utm:33N", None, Some(Unit::foot()));
    assert_eq!(
        [3072, 3075, 3076, 4099].map(|key| value(&feet, key)),
        [Some(32767), Some(1), Some(9002), Some(9002)]
    );
    let ecef = of("ecef", None, None);
    assert_eq!([1024, 2048, 3076].map(|key| value(&ecef, key)), [Some(3), Some(4978), Some(9001)]);
}

#[test]
fn points_that_are_none_are_named() {
    let error = crs("utm:33N").from_geodetic(place(-90.0, 3.0, 0.0)).unwrap_err().to_string();
    assert_eq!(
        error,
        "EPSG:32633 (WGS 84 / UTM zone 33N): the point at latitude 3.000000, longitude -90.000000 degrees \
         cannot be projected; check the trajectory, or choose a CRS for that area"
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

/// EPSG code in a GeoTIFF key directory: that of the projected CRS, else of the geographic one.
fn epsg_key(directory: &[u8]) -> Option<u16> {
    let words: Vec<u16> = directory.chunks_exact(2).map(|w| u16::from_le_bytes([w[0], w[1]])).collect();
    let value = |key| words[4..].chunks_exact(4).find(|entry| entry[0] == key && entry[1] == 0);
    [3072, 2048].into_iter().find_map(value).map(|entry| entry[3]).filter(|&code| code < 32767)
}

#[test]
fn keys_name_a_code_where_there_is_one() {
    let keys = Crs::new(&named("EPSG:2154"), NOWHERE, geoid("raf20"), None).unwrap().geotiff_keys().unwrap();
    assert_eq!(epsg_key(&keys.directory), Some(2154));
    assert_eq!(keys.ascii, b"RGF93 / Lambert-93|\0");
    let words: Vec<u16> = keys.directory.as_chunks().0.iter().map(|word| u16::from_le_bytes(*word)).collect();
    let expected = [
        [1, 1, 0, 7],
        [1024, 0, 1, 1],
        [1025, 0, 1, 1],
        [1026, 34737, 19, 0],
        [3072, 0, 1, 2154],
        [3076, 0, 1, 9001],
        [4096, 0, 1, 5720],
        [4099, 0, 1, 9001],
    ];
    assert_eq!(words, expected.as_flattened());
    assert!(keys.doubles.is_empty());
    assert_eq!(epsg_key(&crs("geodetic").geotiff_keys().unwrap().directory), Some(4326));
    assert_eq!(epsg_key(&crs("ecef").geotiff_keys().unwrap().directory), Some(4978));
}

#[test]
fn keys_say_a_projection_without_a_code() {
    let keys = of_wkt(ESRI).unwrap().geotiff_keys().unwrap();
    let words: Vec<u16> = keys.directory.as_chunks().0.iter().map(|word| u16::from_le_bytes(*word)).collect();
    let entries: Vec<&[u16]> = words.chunks(4).skip(1).collect();
    assert!(entries.is_sorted(), "{entries:?}");
    let value = |key: u16| entries.iter().find(|entry| entry[0] == key).map(|entry| entry[3]);
    let keys_and_values =
        [(1024, 1), (2048, 32767), (2056, 7019), (3072, 32767), (3075, 8), (3076, 9003), (4099, 9003)];
    assert!(keys_and_values.iter().all(|(key, wanted)| value(*key) == Some(*wanted)), "{entries:?}");
    let doubles: Vec<f64> =
        keys.doubles.as_chunks().0.iter().map(|bytes| f64::from_le_bytes(*bytes)).collect();
    let double = |key: u16| doubles[usize::from(value(key).unwrap())];
    assert!((double(3078) - 31.883_333_333_333_3).abs() < 1e-12);
    assert!((double(3084) + 100.333_333_333_333).abs() < 1e-12);
    assert!((double(3086) - 2_296_583.333).abs() < 1e-6);
    let utm = Crs::new(&named("utm:33S"), NOWHERE, None, Some(Unit::foot())).unwrap().geotiff_keys().unwrap();
    assert_eq!((epsg_key(&utm.directory), utm.doubles.len()), (None, 40));
    let albers = Crs::new(&named("EPSG:5070"), NOWHERE, None, Some(Unit::foot())).unwrap();
    assert_eq!(albers.geotiff_keys(), None);
}

#[test]
fn threads_share_a_system() {
    fn shared<T: Send + Sync>(_: &T) {}
    shared(&crs("EPSG:3035"));
}

#[test]
fn a_geodetic_system_has_its_own_ellipsoid() {
    let (wgs84, etrs89) = (crs("geodetic"), crs("EPSG:4258"));
    assert_eq!((wgs84.ellipsoid(), etrs89.ellipsoid()), (WGS84, GRS80));
    let pole_m = [0.0, 0.0, 6_356_752.314_245_179];
    let heights = [&wgs84, &etrs89].map(|crs| crs.from_ecef(pole_m).unwrap()[2]);
    assert!((heights[1] - heights[0] - 0.000_105).abs() < 1e-6, "{heights:?}");
}

proptest! {
    #[test]
    fn points_come_back(longitude in -9.0..9.0, latitude in -75.0..75.0, height in -100.0..9000.0) {
        for (word, meridian, sign) in [
            ("utm:33N", 15.0, 1.0), ("utm:7S", -141.0, 1.0), ("EPSG:2154", 3.0, 1.0), ("EPSG:3112", 134.0, -1.0),
            ("EPSG:2225", -122.0, 1.0), ("EPSG:3035", 10.0, 1.0), ("geodetic", 179.0, 1.0), ("ecef", 0.0, 1.0),
        ] {
            let crs = crs(word);
            let latitude: f64 = if word.contains("utm") { latitude } else { sign * latitude.abs().max(20.0) };
            let place_m = crs.ellipsoid().ecef_of(place(meridian + longitude, latitude, height));
            let there = crs.from_ecef(place_m).unwrap();
            let back_m = crs.to_ecef(there).unwrap();
            prop_assert!(apart(back_m, place_m) < 2e-8, "{} {:?} {:?}", word, back_m, place_m);
        }
    }

    #[test]
    fn many_places_have_the_coordinates_of_each(
        n in 0..40usize,
        longitude in 9.0..11.0,
        latitude in 41.0..49.0,
        word in prop::sample::select(vec!["utm:33N", "utm:32N", "EPSG:3034", "EPSG:3035", "geodetic", "ecef"]),
        with_geoid in any::<bool>(),
    ) {
        let geoid = if with_geoid && word != "ecef" { geoid("here") } else { None };
        let crs = Crs::new(&named(word), NOWHERE, geoid, None).unwrap();
        let place = |i: usize| place(longitude + i as f64 * 1e-4, latitude - i as f64 * 1e-3, i as f64 * 7.0);
        let mut places: Vec<Vector> = (0..n).map(|i| crs.ellipsoid().ecef_of(place(i))).collect();
        let expected: Vec<Vector> = places.iter().map(|place| crs.from_ecef(*place).unwrap()).collect();
        crs.replace_ecef(&mut places).unwrap();
        prop_assert_eq!(places, expected);
    }
}

#[test]
fn the_first_of_many_places_that_has_no_coordinates_is_named() {
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
