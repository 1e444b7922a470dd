use std::fs;

use super::*;

/// Two rows of three values from latitude 40, longitude 260, in steps of 1 and 0.5 degrees.
const HEADER_BE: [u8; 40] = [
    0x40, 0x44, 0, 0, 0, 0, 0, 0, // south 40
    0x40, 0x70, 0x40, 0, 0, 0, 0, 0, // west 260
    0x3f, 0xf0, 0, 0, 0, 0, 0, 0, // 1 to the north
    0x3f, 0xe0, 0, 0, 0, 0, 0, 0, // 0.5 to the east
    0, 0, 0, 2, // rows
    0, 0, 0, 3, // columns
];
/// 1, -2, 0.5; 4, -88.8888, 6.
const VALUES_BE: [u8; 24] = [
    0x3f, 0x80, 0, 0, 0xc0, 0, 0, 0, 0x3f, 0, 0, 0, //
    0x40, 0x80, 0, 0, 0xc2, 0xb1, 0xc7, 0x11, 0x40, 0xc0, 0, 0,
];

fn gtx() -> Vec<u8> {
    [HEADER_BE.as_slice(), &VALUES_BE].concat()
}

fn bin_be() -> Vec<u8> {
    [HEADER_BE.as_slice(), &[0, 0, 0, 1], &VALUES_BE].concat()
}

fn bin_le() -> Vec<u8> {
    let big = bin_be();
    let turned = |bytes: &[u8], size: usize| {
        bytes.chunks(size).flat_map(|c| c.iter().rev().copied()).collect::<Vec<u8>>()
    };
    [turned(&big[..32], 8), turned(&big[32..], 4)].concat()
}

fn folder_of(files: &[(&str, Vec<u8>)]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    files.iter().for_each(|(name, bytes)| fs::write(folder.path().join(name), bytes).unwrap());
    folder
}

/// Returns the error of reading a file with these bytes, without its folder.
fn error_of(name: &str, bytes: Vec<u8>) -> String {
    let folder = folder_of(&[(name, bytes)]);
    let error = read(&folder.path().join(name)).unwrap_err().to_string();
    error.replace(&format!("{}/", folder.path().display()), "")
}

#[test]
fn a_gtx_is_read() {
    let grid = gtx::parse(Path::new("f"), &gtx()).unwrap();
    assert_eq!((grid.south_deg, grid.west_deg), (40.0, 260.0));
    assert_eq!((grid.latitude_step_deg, grid.longitude_step_deg), (1.0, 0.5));
    assert_eq!((grid.rows, grid.columns), (2, 3));
    assert_eq!(grid.heights_m[..4], [1.0, -2.0, 0.5, 4.0]);
    assert!(grid.heights_m[4].is_nan() && grid.heights_m[5] == 6.0);
}

#[test]
fn a_bin_is_read_in_both_byte_orders() {
    let big = ngs_bin::parse(Path::new("f"), &bin_be()).unwrap();
    let little = ngs_bin::parse(Path::new("f"), &bin_le()).unwrap();
    assert_eq!(big, little);
    assert_eq!((big.south_deg, big.west_deg, big.rows, big.columns), (40.0, 260.0, 2, 3));
    assert_eq!(big.heights_m, [1.0, -2.0, 0.5, 4.0, -88.8888, 6.0]);
    let mut holed = bin_be();
    holed[44..48].copy_from_slice(&(-9999f32).to_be_bytes());
    assert!(ngs_bin::parse(Path::new("f"), &holed).unwrap().heights_m[0].is_nan());
}

#[test]
fn a_geoid_is_found_in_any_case() {
    let folder = folder_of(&[("g2012Bu0.bin", bin_le()), ("EGM96.GTX", gtx()), ("notes.txt", vec![])]);
    for name in ["g2012bu0", "G2012BU0.BIN", "g2012Bu0"] {
        let geoid = find(folder.path(), name).unwrap();
        assert_eq!((geoid.name(), geoid.height_m(40.0, -100.0).unwrap()), ("g2012Bu0", 1.0));
    }
    assert_eq!(find(folder.path(), "egm96").unwrap().height_m(40.5, -100.0).unwrap(), 2.5);
    assert!(find(folder.path(), "egm96").unwrap().height_m(40.5, -99.5).is_err());
}

#[test]
fn a_missing_geoid_names_those_that_are_there() {
    let folder = folder_of(&[("b.gtx", gtx()), ("a.bin", bin_le()), ("notes.txt", vec![])]);
    let remedy = "check `geoid` and `geoid_dir`, or put the grid's .bin or .gtx file there";
    let at = folder.path().display();
    assert_eq!(
        find(folder.path(), "c").unwrap_err().to_string(),
        format!("{at}: there is no geoid `c` in this folder, which holds a.bin, b.gtx; {remedy}")
    );
    let many: Vec<(String, Vec<u8>)> = (0..23).map(|i| (format!("{i:02}.gtx"), vec![])).collect();
    many.iter().for_each(|(name, bytes)| fs::write(folder.path().join(name), bytes).unwrap());
    let error = find(folder.path(), "c").unwrap_err().to_string();
    assert!(error.contains("which holds 00.gtx, ") && error.contains(", 19.gtx and 5 more; "), "{error}");
    let empty = folder_of(&[]);
    let error = find(empty.path(), "c").unwrap_err().to_string();
    assert!(error.contains("which holds no .bin or .gtx file; "), "{error}");
    let nowhere = empty.path().join("none");
    let error = find(&nowhere, "c").unwrap_err().to_string();
    assert!(error.starts_with(&format!("{}: cannot list the geoids of: ", nowhere.display())), "{error}");
}

#[test]
fn a_path_gets_the_two_keys() {
    let folder = folder_of(&[("b.gtx", gtx())]);
    let (elsewhere, dir) = (folder_of(&[]), folder.path().display());
    let error = |name: &Path| find(elsewhere.path(), &name.to_string_lossy()).unwrap_err().to_string();
    let of_file = error(&folder.path().join("b.gtx"));
    assert!(
        of_file.ends_with(&format!("; write `geoid = \"b\"` and `geoid_dir = {:?}`", dir.to_string())),
        "{of_file}"
    );
    let of_nothing = error(&folder.path().join("c.gtx"));
    assert!(of_nothing.ends_with("; write the folder of the grid in `geoid_dir`"), "{of_nothing}");
}

#[test]
fn a_name_of_two_files_is_an_error() {
    let folder = folder_of(&[("a.bin", bin_le()), ("a.gtx", gtx())]);
    assert_eq!(
        find(folder.path(), "A").unwrap_err().to_string(),
        format!(
            "{}: the geoid `A` matches more than one file: a.bin, a.gtx; give the name with its \
             extension, or keep only one of them",
            folder.path().display()
        )
    );
    assert_eq!(find(folder.path(), "a.gtx").unwrap().grid().heights_m[0], 1.0);
}

#[test]
fn damaged_files_say_what_is_wrong() {
    let remedy = "copy the file again from its source, or check its format";
    let mut longer = gtx();
    longer.push(0);
    assert_eq!(
        error_of("a.gtx", longer),
        format!(
            "a.gtx: its header says 2 rows of 3 values, 24 bytes, but 25 bytes follow it; \
                 {remedy}"
        )
    );
    let mut rowless = gtx();
    rowless[35] = 1;
    assert_eq!(
        error_of("a.gtx", rowless),
        format!(
            "a.gtx: its header says 1 rows and 3 columns from latitude 40, longitude 260 in steps \
             of 1 and 0.5 degrees, which is not a valid grid; {remedy}"
        )
    );
    let mut kindless = bin_le();
    kindless[40] = 2;
    assert_eq!(
        error_of("a.bin", kindless),
        "a.bin: byte 40: kind: 2 in little-endian and 33554432 in big-endian order, not 1 in either; give a geoid's .bin \
         file as NGS publishes it"
    );
    assert_eq!(
        error_of("a.txt", vec![]),
        "a.txt: the extension `txt` is not a geoid format; give a .bin file of NGS or a .gtx file"
    );
    let huge = [&HEADER_BE[..32], &[0x7f, 0xff, 0xff, 0xff, 0x7f, 0xff, 0xff, 0xff, 0, 0, 0, 1]].concat();
    assert!(error_of("a.bin", huge).contains("18446744056529682436 bytes, but 0 bytes follow it"));
    for length in 0..bin_le().len() {
        assert!(error_of("a.bin", bin_le()[..length].to_vec()).starts_with("a.bin: "), "{length}");
        assert!(
            error_of("a.gtx", gtx()[..length.min(gtx().len() - 1)].to_vec()).starts_with("a.gtx: "),
            "{length}"
        );
    }
}

/// Compares real grids with PROJ's values at 120 points.
#[test]
fn real_grids_agree_with_proj() {
    let Some(data) = std::env::var_os("WAVEX_DATA") else {
        println!("skipped: WAVEX_DATA not set");
        return;
    };
    let folder = Path::new(&data).join("geoid");
    let table = fs::read_to_string(folder.join("undulations_by_proj.csv")).unwrap();
    let mut worst_m = 0f64;
    for line in table.lines().skip(1) {
        let cells: Vec<&str> = line.split(',').collect();
        let numbers: Vec<f64> = cells[1..].iter().map(|cell| cell.parse().unwrap()).collect();
        let geoid = find(&folder, &cells[0].to_lowercase()).unwrap();
        worst_m = worst_m.max((geoid.height_m(numbers[1], numbers[0]).unwrap() - numbers[2]).abs());
    }
    assert_eq!(table.lines().count(), 121);
    assert!(worst_m < 1e-5, "{worst_m}");
    println!("largest difference from PROJ: {worst_m:.2e} m");
    let holed = find(&folder, "test_nodata").unwrap();
    assert_eq!(holed.height_m(52.15, 4.15).unwrap(), 10.0);
    let error = holed.height_m(52.05, 4.05).unwrap_err().to_string();
    assert!(
        error.contains(
            "the point at latitude 52.050000, longitude 4.050000 degrees lies where it has no value"
        )
    );
}
