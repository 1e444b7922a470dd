//! Coordinate reference systems of LAS files from records that are damaged, contradict or are in feet.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use wavex_formats::container::{ContainerHeader, ContainerReader};
use wavex_formats::las::LasDescription;
use wavex_geodesy::crs::wkt_of_epsg;
use wavex_testkit::las::{Las, vlr};
use wavex_testkit::shots::METRES_PER_NS;
use wavex_testkit::{TO_TABLE, TestFolder, notes};

const PULSES: usize = 240;
const HEIGHT: usize = 8;
const VECTOR_Z: usize = 55;
const US_FOOT_M: f64 = 1200.0 / 3937.0;

/// A recording with these records of its system.
fn with_records(wkt: Option<&str>, keys: &[[u16; 4]], doubles: &[f64]) -> Las {
    let mut las = Las::new(PULSES);
    let head = [1, 1, 0, keys.len() as u16];
    let directory: Vec<u8> =
        head.iter().chain(keys.as_flattened()).flat_map(|word| word.to_le_bytes()).collect();
    las.vlrs.extend(wkt.map(|wkt| vlr("LASF_Projection", 2112, wkt.as_bytes())));
    las.vlrs.push(vlr("LASF_Projection", 34735, &directory));
    let doubles: Vec<u8> = doubles.iter().flat_map(|value| value.to_le_bytes()).collect();
    las.vlrs.push(vlr("LASF_Projection", 34736, &doubles));
    las
}

/// The same with heights and vectors in a unit of this length, 100 m above the datum.
fn with_heights_in(las: Las, unit_m: f64) -> Las {
    let height = (100.0 / unit_m / 0.01).round() as i32;
    (0..PULSES).fold(las, |las, pulse| {
        let per_ps = (METRES_PER_NS / 1000.0 / unit_m) as f32;
        las.change(pulse, VECTOR_Z, &per_ps.to_le_bytes()).change(pulse, HEIGHT, &height.to_le_bytes())
    })
}

fn place(las: &Las) -> TestFolder {
    TestFolder::with(&[("a.las", &las.las()), ("a.wdp", &las.packets)])
}

/// Notes of a copy as a container, its header, and the frame scale of its first shot.
fn copied(las: &Las) -> (Vec<String>, ContainerHeader, Option<f64>) {
    let place = place(las);
    let report =
        place.succeeds("read_las", "a.las", "[[stage]]\ntype = 'write_arrow'\npath = '*_copy.arrow'\n");
    let mut copy = ContainerReader::open(&place.path("out/a_copy.arrow")).unwrap();
    let header = copy.header().clone();
    let scale = copy.next_line().unwrap().unwrap().shot(0).frame_scale;
    (notes(&report), header, scale)
}

/// Mean height of the points that a job writes, and their system.
fn height(las: &Las) -> (f64, String) {
    let place = place(las);
    let to_las = TO_TABLE.replace("write_table'\npath = '*.csv'", "write_las'\npath = '*_out.las'");
    place.succeeds("read_las", "a.las", &to_las);
    let path = place.path("out/a_out.las");
    let mut reader = las::Reader::from_path(&path).unwrap();
    let heights: Vec<f64> = reader.read_all().unwrap().points().map(|point| point.unwrap().z).collect();
    let mean = heights.iter().sum::<f64>() / heights.len() as f64;
    (mean, described(&path).crs().wkt.unwrap_or_default())
}

/// Header and records of a file.
fn described(path: &Path) -> LasDescription {
    let mut file = BufReader::new(File::open(path).unwrap());
    let length = std::fs::metadata(path).unwrap().len();
    LasDescription::read(&mut file, path, length).unwrap()
}

const UTM_32: [[u16; 4]; 3] = [[1024, 0, 1, 1], [3072, 0, 1, 25832], [3076, 0, 1, 9001]];

#[test]
fn an_empty_record_does_not_hide_another() {
    let (notes, header, _) = copied(&with_records(Some("\0"), &UTM_32, &[]));
    assert!(header.crs_wkt.unwrap().contains("UTM zone 32N"));
    assert!(notes.iter().any(|note| note.contains("the WKT record cannot be read")), "{notes:?}");
}

#[test]
fn contradicting_records_are_named() {
    let other = wkt_of_epsg(25833).unwrap();
    let (notes, header, _) = copied(&with_records(Some(&other), &UTM_32, &[]));
    assert!(header.crs_wkt.unwrap().contains("UTM zone 33N"), "format 9 prefers WKT");
    assert!(notes.iter().any(|note| note.contains("the GeoTIFF keys give another")), "{notes:?}");
    let same = wkt_of_epsg(25832).unwrap();
    assert_eq!(copied(&with_records(Some(&same), &UTM_32, &[])).0, Vec::<String>::new());
}

#[test]
fn user_defined_keys_are_a_system() {
    let double = |key: u16, place: u16| [key, 34736, 1, place];
    let keys = [
        [1024, 0, 1, 1],
        [2048, 0, 1, 4269],
        [3072, 0, 1, 32767],
        [3075, 0, 1, 1],
        [3076, 0, 1, 9001],
        double(3080, 0),
        double(3081, 1),
        double(3082, 2),
        double(3083, 3),
        double(3092, 4),
    ];
    let (notes, header, _) = copied(&with_records(None, &keys, &[-111.0, 0.0, 500_000.0, 0.0, 0.9996]));
    let wkt = header.crs_wkt.unwrap();
    assert!(wkt.contains("Transverse_Mercator") && wkt.contains("-111"), "{wkt}");
    assert_eq!(notes, Vec::<String>::new());
}

#[test]
fn ranges_of_recordings_in_feet_are_metres() {
    let las = with_heights_in(Las::new(PULSES), US_FOOT_M).with_crs(&wkt_of_epsg(2225).unwrap());
    let (_, header, scale) = copied(&las);
    let velocity_mps = header.group_velocity_mps;
    assert!((velocity_mps / (2e9 * METRES_PER_NS) - 1.0).abs() < 1e-5, "{velocity_mps}");
    assert!((scale.unwrap() * US_FOOT_M - 1.0).abs() < 1e-5, "{scale:?}");
    let (height_ft, _) = height(&las);
    assert!((height_ft * US_FOOT_M - 100.0).abs() < 0.02, "{height_ft}");
}

#[test]
fn heights_in_feet_become_metres_on_a_metric_map() {
    let vertical = [[4096, 0, 1, 6360], [4099, 0, 1, 9003]];
    let las = with_heights_in(with_records(None, &[&UTM_32[..], &vertical].concat(), &[]), US_FOOT_M);
    let (notes, header, scale) = copied(&las);
    assert!(notes.iter().any(|note| note.contains("heights of the file are in another unit")), "{notes:?}");
    assert!((header.group_velocity_mps / (2e9 * METRES_PER_NS) - 1.0).abs() < 1e-5);
    assert!((scale.unwrap_or(1.0) - 1.0).abs() < 1e-5);
    let (height_m, wkt) = height(&las);
    assert!((height_m - 100.0).abs() < 0.02, "{height_m}");
    let (_, vertical) = wkt.split_once("VERT_CS").unwrap();
    assert!(vertical.contains("NAVD88 height") && vertical.contains("UNIT[\"metre\",1"), "{wkt}");
}

#[test]
fn copc_has_wkt_whatever_the_records_of_the_source() {
    let place = place(&with_records(Some("\0"), &UTM_32, &[]));
    let outcome = place.wavex(&["copc", "a.las", "--out", "a.copc.laz"]);
    assert_eq!(outcome.code, Some(0), "{}", outcome.err);
    let copc = described(&place.path("a.copc.laz"));
    let records: Vec<u16> =
        copc.vlrs.iter().filter(|vlr| vlr.user_id == "LASF_Projection").map(|vlr| vlr.record_id).collect();
    assert!(copc.header.says_wkt() && records == [2112], "{records:?}");
    assert!(copc.crs().wkt.unwrap().contains("UTM zone 32N") && copc.crs().problems.is_empty());
}

#[test]
fn coordinates_outside_the_area_of_their_system_are_a_warning() {
    // UTM coordinates of Austria, in steps of 1 cm.
    let austria = |code, unit_m| {
        let las = with_heights_in(Las::new(PULSES), unit_m).with_crs(&wkt_of_epsg(code).unwrap());
        let [x, y] = [50_000_000i32, 520_000_000].map(i32::to_le_bytes);
        (0..PULSES).fold(las, |las, pulse| las.change(pulse, 0, &[x, y].concat()))
    };
    let notes = |code, unit_m| {
        let mut notes = notes(&place(&austria(code, unit_m)).succeeds("read_las", "a.las", TO_TABLE));
        notes.retain(|note| note.contains("is made for"));
        notes
    };
    assert_eq!(
        [32633, 25833, 31256].map(|code| notes(code, 1.0)),
        [const { Vec::<String>::new() }; 3],
        "one is on another datum"
    );
    let pennsylvania = notes(2271, US_FOOT_M);
    let words = "EPSG:2271 (NAD83 / Pennsylvania North (ftUS)) is made for longitude -81 to -74 and latitude 40 to 43 degrees, \
                 but the recording begins at ";
    assert!(pennsylvania.len() == 1 && pennsylvania[0].starts_with(words), "{pennsylvania:?}");
    assert!(pennsylvania[0].contains("`crs_of_input`"), "{pennsylvania:?}");
}
