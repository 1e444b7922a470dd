//! Systems supported only by the library PROJ (feature `proj`), against PROJ 9.5.1 through pyproj
//! 3.7.2, without grids.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::sync::Arc;

use wavex_geodesy::crs::{Crs, Named, Unit};
use wavex_geodesy::ellipsoid::{Geodetic, WGS84};

fn place(longitude_deg: f64, latitude_deg: f64, height_m: f64) -> Geodetic {
    Geodetic { latitude_rad: latitude_deg.to_radians(), longitude_rad: longitude_deg.to_radians(), height_m }
}

fn crs(named: &Named, unit: Option<Unit>) -> Crs {
    Crs::new(named, place(0.0, 0.0, 0.0), None, unit).unwrap()
}

/// Three-dimensional datum shifts: at 4000 m, a shift computed at ground level would be 6 cm off.
const PLACES: [(u32, [f64; 3], [f64; 2]); 7] = [
    (27700, [-1.5, 52.2, 100.0], [434_269.900_571_9, 255_869.773_312_9]),
    (27700, [-4.2, 57.5, 1200.0], [268_260.985_366_1, 847_667.878_752_4]),
    (23032, [9.5, 48.2, 500.0], [537_236.214_803_6, 5_338_850.829_215_9]),
    (23032, [11.0, 44.0, 2500.0], [660_431.836_867_8, 4_874_013.988_484_6]),
    (2056, [7.5, 46.9, 600.0], [2_604_676.036_308_2, 1_194_322.875_148_0]),
    (2056, [9.8, 46.5, 4000.0], [2_781_243.473_501_7, 1_152_581.480_039_4]),
    // Westings and southings, as the system defines them.
    (2048, [18.9, -33.9, 300.0], [9_249.292_055_9, 3_752_573.795_700_7]),
];

#[test]
fn other_datums_are_shifted_as_proj_does() {
    for (code, [longitude, latitude, height_m], [x, y]) in PLACES {
        let crs = crs(&Named::Epsg(code), None);
        assert_eq!(crs.epsg(), Some(code));
        let place_m = WGS84.ecef_of(place(longitude, latitude, height_m));
        let found = crs.from_ecef(place_m).unwrap();
        let apart = (found[0] - x).abs().max((found[1] - y).abs()).max((found[2] - height_m).abs());
        assert!(apart < 1e-6, "EPSG:{code}: {found:?}");
        let back_m = crs.to_ecef(found).unwrap();
        let apart = back_m.iter().zip(place_m).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(apart < 1e-6, "EPSG:{code}: {back_m:?}");
    }
}

#[test]
fn what_is_written_is_the_system_again() {
    let british = crs(&Named::Epsg(27700), None);
    assert!(british.name().starts_with("EPSG:27700 (OSGB36 / British National Grid)"), "{}", british.name());
    assert!(british.wkt().starts_with("PROJCS[\"OSGB36 / British National Grid\","), "{}", british.wkt());
    let again = crs(&Named::Wkt(british.wkt()), None);
    let there = place(-1.5, 52.2, 100.0);
    assert_eq!(again.from_geodetic(there).unwrap(), british.from_geodetic(there).unwrap());
    let [x, y, z] = british.from_geodetic(there).unwrap();
    let feet = crs(&Named::Epsg(27700), Some(Unit::foot())).from_geodetic(there).unwrap();
    let apart =
        feet.iter().zip([x, y, z]).map(|(feet, metres)| (feet * 0.3048 - metres).abs()).fold(0.0, f64::max);
    assert!(apart < 1e-8, "{feet:?}");
}

#[test]
fn each_thread_has_its_own() {
    let crs = Arc::new(crs(&Named::Epsg(2056), None));
    let there = place(7.5, 46.9, 600.0);
    let here = crs.from_geodetic(there).unwrap();
    let threads: Vec<_> = (0..4)
        .map(|_| {
            let crs = Arc::clone(&crs);
            std::thread::spawn(move || (0..1000).all(|_| crs.from_geodetic(there).ok() == Some(here)))
        })
        .collect();
    assert!(threads.into_iter().all(|thread| thread.join().unwrap()));
}

#[test]
fn what_proj_does_not_know_is_refused_as_before() {
    let refused = |named| Crs::new(&named, place(0.0, 0.0, 0.0), None, None).unwrap_err().to_string();
    assert!(refused(Named::Epsg(99999)).starts_with(
        "EPSG:99999 is not in the table of coordinate \
                                                     reference systems;"
    ));
    assert!(refused(Named::Wkt("nothing".into())).starts_with("the WKT cannot be read: "));
}
