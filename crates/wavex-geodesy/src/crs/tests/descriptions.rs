//! Systems as WKT and GeoTIFF keys.

use super::*;

fn keys_of(crs: &Crs) -> Option<GeoKeys> {
    geotiff_keys_of_wkt(&crs.wkt())
}

/// The WKT written to a LAS file can be read again, whatever the source and the unit.
#[test]
fn written_wkt_defines_the_same_system() {
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

/// The keys give heights in feet even if the code of the CRS does not, also for a CRS without a
/// code.
#[test]
fn keys_have_the_unit_of_heights() {
    let value = |keys: &GeoKeys, key: u16| {
        let words: Vec<u16> =
            keys.directory.as_chunks().0.iter().map(|word| u16::from_le_bytes(*word)).collect();
        words.chunks(4).skip(1).find(|entry| entry[0] == key).map(|entry| entry[3])
    };
    let of = |word: &str, geoid, unit| {
        let crs = Crs::new(&named(word), NOWHERE, geoid, unit).unwrap();
        keys_of(&crs).unwrap()
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

/// EPSG code in a GeoTIFF key directory: that of the projected CRS, else of the geographic one.
fn epsg_key(directory: &[u8]) -> Option<u16> {
    let words: Vec<u16> = directory.chunks_exact(2).map(|w| u16::from_le_bytes([w[0], w[1]])).collect();
    let value = |key| words[4..].chunks_exact(4).find(|entry| entry[0] == key && entry[1] == 0);
    [3072, 2048].into_iter().find_map(value).map(|entry| entry[3]).filter(|&code| code < 32767)
}

#[test]
fn keys_contain_the_code_if_known() {
    let keys = keys_of(&Crs::new(&named("EPSG:2154"), NOWHERE, geoid("raf20"), None).unwrap()).unwrap();
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
    assert_eq!(epsg_key(&keys_of(&crs("geodetic")).unwrap().directory), Some(4326));
    assert_eq!(epsg_key(&keys_of(&crs("ecef")).unwrap().directory), Some(4978));
}

#[test]
fn keys_define_a_projection_without_a_code() {
    let keys = keys_of(&of_wkt(ESRI).unwrap()).unwrap();
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
    let utm = keys_of(&Crs::new(&named("utm:33S"), NOWHERE, None, Some(Unit::foot())).unwrap()).unwrap();
    assert_eq!((epsg_key(&utm.directory), utm.doubles.len()), (None, 40));
    let albers = Crs::new(&named("EPSG:5070"), NOWHERE, None, Some(Unit::foot())).unwrap();
    assert_eq!(keys_of(&albers), None);
}
