//! Systems from GeoTIFF keys.

use super::*;

fn keys(entries: &[[u16; 4]], doubles: &[f64], ascii: &str) -> GeoKeys {
    let head = [1, 1, 0, entries.len() as u16];
    GeoKeys {
        directory: head.iter().chain(entries.as_flattened()).flat_map(|word| word.to_le_bytes()).collect(),
        doubles: doubles.iter().flat_map(|value| value.to_le_bytes()).collect(),
        ascii: ascii.as_bytes().to_vec(),
    }
}

fn read(entries: &[[u16; 4]], doubles: &[f64]) -> RecordedSystem {
    system_of_geotiff_keys(&keys(entries, doubles, "")).unwrap().unwrap()
}

fn error(entries: &[[u16; 4]], doubles: &[f64]) -> String {
    system_of_geotiff_keys(&keys(entries, doubles, "")).unwrap_err().to_string()
}

const UTM_12: [[u16; 4]; 3] = [[1024, 0, 1, 1], [3072, 0, 1, 26912], [3076, 0, 1, 9001]];

#[test]
fn heights_in_feet_above_a_named_datum_are_kept() {
    let of = |vertical: &[[u16; 4]]| read(&[&UTM_12, vertical].concat(), &[]).wkt;
    for vertical in [
        &[[4096, 0, 1, 6360], [4099, 0, 1, 9003]][..],
        &[[4096, 0, 1, 5103], [4099, 0, 1, 9003]],
        &[[4096, 0, 1, 6360]],
    ] {
        let wkt = of(vertical);
        assert!(wkt.contains("NAVD88 height") && wkt.contains("\"6360\""), "{wkt}");
        let crs = Crs::new(&Named::Wkt(wkt), NOWHERE, geoid("g2018u0"), None).unwrap();
        assert_eq!((crs.unit(), crs.height_unit()), (&Unit::metre(), &Unit::us_survey_foot()));
    }
    // Heights above the ellipsoid need no geoid; metres need no vertical system.
    let ellipsoidal = of_wkt(&of(&[[4096, 0, 1, 5019], [4099, 0, 1, 9002]])).unwrap();
    assert_eq!(ellipsoidal.height_unit(), &Unit::foot());
    assert!(of(&[[4099, 0, 1, 9001]]).starts_with("PROJCS["));
    assert!(of(&[[4099, 0, 1, 9003]]).contains("VERT_CS[\"Height\""));
    let unknown = read(&[&UTM_12[..], &[[4099, 0, 1, 9123]]].concat(), &[]);
    assert!(unknown.wkt.starts_with("PROJCS[") && unknown.problems[0].contains("unit 9123"));
}

#[test]
fn user_defined_projections_have_their_parameters() {
    let base = [[1024, 0, 1, 1], [2048, 0, 1, 4269], [3072, 0, 1, 32767], [3074, 0, 1, 32767]];
    let double = |key: u16, place: u16| [key, 34736, 1, place];
    let with = |method: u16, keys: &[u16]| {
        let places = keys.iter().zip(0..).map(|(key, place)| double(*key, place));
        base.into_iter().chain([[3075, 0, 1, method]]).chain(places).collect::<Vec<_>>()
    };
    let at = place(-111.5, 40.0, 10.0);
    let same = |entries: &[[u16; 4]], doubles: &[f64], code: &str| {
        let found = of_wkt(&read(entries, doubles).wkt).unwrap().from_geodetic(at).unwrap();
        let expected = crs(code).from_geodetic(at).unwrap();
        assert!(apart(found, expected) < 1e-6, "{found:?} {expected:?}");
    };
    let utm = [-111.0, 0.0, 500_000.0, 0.0, 0.9996];
    same(&with(1, &[3080, 3081, 3082, 3083, 3092]), &utm, "EPSG:26912");
    // The same without model type, and with the keys of a false origin.
    same(&with(1, &[3080, 3081, 3082, 3083, 3092])[1..], &utm, "EPSG:26912");
    same(&with(1, &[3084, 3085, 3086, 3087, 3092]), &utm, "EPSG:26912");
    let utah =
        [41.783_333_333_333_3, 40.716_666_666_666_7, -111.5, 40.333_333_333_333_3, 500_000.0, 1_000_000.0];
    same(&with(8, &[3078, 3079, 3084, 3085, 3086, 3087]), &utah, "EPSG:32142");
    let mut of_projection = base;
    of_projection[3][3] = 16012;
    same(&of_projection, &[], "EPSG:26912");
    let missing = error(&with(1, &[3080, 3081, 3082, 3083]), &utm);
    assert!(missing.contains("they have no scale_factor (key 3092)"), "{missing}");
    assert!(error(&with(3, &[]), &[]).contains("projection method 3"));
}

#[test]
fn a_figure_of_the_earth_is_enough_as_base() {
    // As written by RIEGL.
    let entries = [
        [1024, 0, 1, 1],
        [2048, 0, 1, 32767],
        [2050, 0, 1, 32767],
        [2057, 34736, 1, 0],
        [2059, 34736, 1, 1],
        [3072, 0, 1, 32767],
        [3075, 0, 1, 1],
        [3080, 34736, 1, 4],
        [3081, 34736, 1, 3],
        [3082, 34736, 1, 5],
        [3083, 34736, 1, 6],
        [3092, 34736, 1, 7],
    ];
    let doubles = [6_378_137.0, 298.257_223_563, 0.0, 0.0, 15.0, 500_000.0, 0.0, 0.9996];
    let crs = of_wkt(&read(&entries, &doubles).wkt).unwrap();
    let at = place(15.5, 48.0, 0.0);
    let expected = self::crs("EPSG:32633").from_geodetic(at).unwrap();
    assert!(apart(crs.from_geodetic(at).unwrap(), expected) < 1e-6);
    let point = error(&entries, &[0.0, 298.257_223_563, 0.0, 0.0, 15.0, 500_000.0, 0.0, 0.9996]);
    assert!(point.contains("the ellipsoid has a semi-major axis of 0 m (key 2057)"), "{point}");
    assert_eq!(
        system_of_geotiff_keys(&keys(&entries, &[0.0; 8], "")).unwrap(),
        None,
        "all parameters are missing"
    );
}

#[test]
fn a_unit_other_than_that_of_the_code_is_named() {
    let system = read(&[[1024, 0, 1, 1], [3072, 0, 1, 26912], [3076, 0, 1, 9003]], &[]);
    assert!(system.problems[0].contains("EPSG:26912 is in the unit metre"), "{:?}", system.problems);
    assert_eq!(of_wkt(&system.wkt).unwrap().unit(), &Unit::us_survey_foot());
}

#[test]
fn keys_without_system_are_none_and_damaged_keys_an_error() {
    let of = |entries: &[[u16; 4]]| system_of_geotiff_keys(&keys(entries, &[], ""));
    assert_eq!(
        of(&[[1024, 0, 1, 1], [3076, 0, 1, 65535], [4096, 0, 1, 32767], [4099, 0, 1, 9001]]).unwrap(),
        None
    );
    assert_eq!(of(&[]).unwrap(), None);
    assert!(error(&[[1024, 0, 1, 1], [3072, 0, 1, 30000]], &[]).contains("EPSG:30000 is not in the table"));
    let whole = keys(&UTM_12, &[], "");
    for length in 0..whole.directory.len() {
        let cut = GeoKeys { directory: whole.directory[..length].to_vec(), ..GeoKeys::default() };
        assert!(system_of_geotiff_keys(&cut).is_err(), "{length}");
    }
}

#[test]
fn written_keys_define_the_same_system() {
    for (word, unit) in [
        ("utm:14N", None),
        ("EPSG:2154", None),
        ("EPSG:6578", None),
        ("EPSG:6578", Some(Unit::metre())),
        ("utm:14N", Some(Unit::foot())),
        ("geodetic", None),
        ("ecef", None),
    ] {
        let crs = Crs::new(&named(word), NOWHERE, None, unit).unwrap();
        let keys = geotiff_keys_of_wkt(&crs.wkt()).unwrap();
        let system = system_of_geotiff_keys(&keys).unwrap().unwrap();
        let again = of_wkt(&system.wkt).unwrap();
        let at = place(-97.7, 30.3, 50.0);
        let [found, expected] = [&again, &crs].map(|crs| crs.from_geodetic(at).unwrap());
        assert!(apart(found, expected) < 3e-7, "{word} {found:?} {expected:?}");
        assert_eq!(system.problems, [""; 0]);
    }
}

/// As written by ESRI.
#[test]
fn a_horizontal_and_a_vertical_system_in_a_row_are_compound() {
    let vertical = r#"VERTCS["NAVD_1988",VDATUM["North_American_Vertical_Datum_1988"],PARAMETER["Vertical_Shift",0.0],PARAMETER["Direction",1.0],UNIT["Foot_US",0.3048006096012192]]"#;
    let pair = format!("{},{vertical}", wkt_of_epsg(26912).unwrap());
    assert!(matches!(of_wkt(&pair), Err(CrsError::NoGeoid { .. })));
    let crs = Crs::new(&Named::Wkt(pair.clone()), NOWHERE, geoid("g2018u0"), None).unwrap();
    assert_eq!((crs.unit(), crs.height_unit()), (&Unit::metre(), &Unit::us_survey_foot()));
    let system = system_of_wkt(&pair).unwrap();
    assert!(
        system.wkt.starts_with("COMPD_CS[\"NAD83 / UTM zone 12N + NAVD_1988\",PROJCS["),
        "{}",
        system.wkt
    );
    let two = format!("{0},{0}", wkt_of_epsg(26912).unwrap());
    assert!(of_wkt(&two).unwrap_err().to_string().contains("the second system is not a vertical one"));
    let ellipsoidal = pair.replace(
        "VDATUM[\"North_American_Vertical_Datum_1988\"]",
        r#"DATUM["D_NAD_1983",SPHEROID["GRS_1980",6378137,298.257222101]]"#,
    );
    assert_eq!(of_wkt(&ellipsoidal).unwrap().height_unit(), &Unit::us_survey_foot());
}
