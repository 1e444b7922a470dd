//! `wavex copc`: converts the points of a run to COPC, or reports an error.

use wavex_formats::las::RawPoints;
use wavex_testkit::{Outcome, TestFolder, outcome, wavex};

const POINTS: &str = "\
[[stage]]
type = 'simulate'
stem = 'a'
lines = 5
shots_per_line = 60
[[stage]]
type = 'calibrate'
waveforms = 250
response = 'gaussian'
[[stage]]
type = 'decompose'
mode = 'fastest'
[[stage]]
type = 'georeference'
[[stage]]
type = 'write_las'
path = '*.laz'
[[stage]]
type = 'write_las'
id = 'old'
path = '*_old.las'
version = '1.2'
";

/// Output of the program, or exit code and message if it fails.
fn copc(place: &TestFolder, arguments: &[&str]) -> Result<String, (Option<i32>, String)> {
    let command = &mut wavex();
    let Outcome { code, out, err } =
        outcome(command.arg("copc").args(arguments).current_dir(place.path("out")));
    if code == Some(0) { Ok(out) } else { Err((code, err)) }
}

fn n_points(place: &TestFolder, name: &str) -> u64 {
    let mut file = RawPoints::open(&place.path("out").join(name)).unwrap();
    let mut n = 0;
    while file.next_record().unwrap().is_some() {
        n += 1;
    }
    assert_eq!(file.header().n_points, n);
    n
}

#[test]
fn points_of_a_run_become_a_file_beside_them() {
    let place = TestFolder::new();
    assert_eq!(place.run(POINTS).code, Some(0));
    let n = n_points(&place, "a.laz");
    assert!(n > 100);
    let printed = copc(&place, &["a.laz"]).unwrap();
    assert_eq!(printed, format!("wrote a.copc.laz: {n} points, 1 node on 1 level\n"));
    assert_eq!(n_points(&place, "a.copc.laz"), n);
    assert_eq!(copc(&place, &["a.laz", "--quiet", "-o", "new/b.laz"]).unwrap(), "");
    assert_eq!(n_points(&place, "new/b.laz"), n);
    let first = std::fs::read(place.path("out/a.copc.laz")).unwrap();
    assert!(first == std::fs::read(place.path("out/new/b.laz")).unwrap(), "the same bytes every time");
}

/// As a pattern of the shell gives them, with the results of the last time.
#[test]
fn several_files_are_converted_in_turn() {
    let place = TestFolder::new();
    assert_eq!(place.run(POINTS).code, Some(0));
    fs_copy(&place, "a.laz", "b.laz");
    copc(&place, &["a.laz"]).unwrap();
    let printed = copc(&place, &["a.copc.laz", "a.laz", "b.laz"]).unwrap();
    let written: Vec<&str> = printed.lines().filter_map(|line| line.split(':').next()).collect();
    assert_eq!(written, ["wrote a.copc.laz", "wrote b.copc.laz"]);
    assert_eq!(n_points(&place, "b.copc.laz"), n_points(&place, "a.laz"));
    let (code, problem) = copc(&place, &["a.laz", "b.laz", "-o", "c.copc.laz"]).unwrap_err();
    assert!(code == Some(2) && problem.contains("--out is the name of one file; leave it out"), "{problem}");
}

fn fs_copy(place: &TestFolder, from: &str, to: &str) {
    std::fs::copy(place.path("out").join(from), place.path("out").join(to)).unwrap();
}

#[test]
fn a_stac_item_is_written_on_request() {
    let place = TestFolder::new();
    assert_eq!(place.run(POINTS).code, Some(0));
    copc(&place, &["a.laz"]).unwrap();
    assert!(!place.path("out/a.copc.json").exists());
    copc(&place, &["a.laz", "--stac"]).unwrap();
    let text = place.text("out/a.copc.json");
    let item: serde_json::Value = serde_json::from_str(&text).unwrap();
    let about = &item["properties"];
    assert_eq!(about["pc:count"], n_points(&place, "a.laz"));
    assert_eq!((&about["pc:encoding"], &about["proj:code"]), (&"COPC".into(), &"EPSG:32633".into()));
    assert_eq!(item["assets"]["data"]["href"], "./a.copc.laz");
    assert_eq!(about["start_datetime"], "2025-05-06T09:59:42.000Z");
    copc(&place, &["a.laz", "--stac"]).unwrap();
    assert_eq!(place.text("out/a.copc.json"), text, "the same bytes every time");
}

#[test]
fn failed_conversions_leave_no_file() {
    let place = TestFolder::new();
    assert_eq!(place.run(POINTS).code, Some(0));
    let mut cut = std::fs::read(place.path("out/a.laz")).unwrap();
    cut.truncate(cut.len() / 2);
    std::fs::write(place.path("out/cut.laz"), cut).unwrap();
    let before = place.outputs();
    let refused = |arguments: &[&str], code, problem: &str| {
        assert_eq!(copc(&place, arguments), Err((Some(code), format!("error: {problem}\n"))));
        assert_eq!(place.outputs(), before);
    };
    refused(
        &["a_old.las"],
        1,
        "a_old.las: COPC needs point format 6 to 10, but this is format 1; write the points with \
         `version = \"1.4\"`",
    );
    refused(&["a.laz", "-o", "a.laz"], 2, "a.laz: this is the input; give another name with --out");
    refused(&["a.laz", "-o", "b.las"], 2, "b.las: COPC is LAZ; give a name that ends in .copc.laz");
    refused(&["c.laz"], 1, "c.laz: cannot open: No such file or directory (os error 2); check the path");
    refused(
        &["a.pls"],
        2,
        "a.pls: a recording has no points before a run; write its job with `wavex init --from a.pls a.toml`, run it \
         with `wavex run a.toml`, and give the LAS or LAZ that it writes",
    );
    let (code, problem) = copc(&place, &["cut.laz"]).unwrap_err();
    assert_eq!(code, Some(1));
    assert!(problem.contains("copy it again from its source"), "{problem}");
    assert_eq!(place.outputs(), before);
}

/// An existing file is replaced as a whole or not at all.
#[test]
fn a_file_that_is_there_stays_until_the_new_one_is_whole() {
    let place = TestFolder::new();
    place.write("out/a.laz", b"LASF");
    place.write("out/a.copc.laz", b"the old one");
    assert_eq!(copc(&place, &["a.laz"]).unwrap_err().0, Some(1));
    assert_eq!(place.text("out/a.copc.laz"), "the old one");
}
