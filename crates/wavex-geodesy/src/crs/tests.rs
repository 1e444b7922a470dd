//! Coordinates are compared with PROJ 9.5.1 (through pyproj 3.7.2); `tests/python/check_crs.py` does so for many more.

use proptest::prelude::*;

use super::*;
use crate::ellipsoid::{GRS80, WGS84};
use crate::geoid::GeoidGrid;

mod descriptions;
mod read_geotiff_keys;
mod rejected;

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
    let grid = GeoidGrid {
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

#[test]
fn a_requested_unit_applies_to_all_coordinates() {
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
fn heights_are_above_the_geoid() {
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
fn the_vertical_part_defines_heights() {
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
    fn batches_equal_single_conversions(
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
