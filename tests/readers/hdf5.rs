//! Cuts and beams of GEDI; `tests/python/make_hdf5.py` has the formulas of the made files.

use serde_json::Value;
use wavex_testkit::{Outcome, TestFolder, data};

/// Adjusted GPS time of the first shot of the made file, s.
const FIRST_S: f64 = 1_198_800_018.0 + 4.08e7 - 1e9;
/// Time between its shots, s.
const INTERVAL_S: f64 = 0.00826;

/// The made file of 12 shots.
fn granule() -> TestFolder {
    let place = TestFolder::new();
    place.write("a.h5", include_bytes!("../../crates/wavex-hdf5/tests/data/gedi_product.h5"));
    place
}

/// Summary of a file read with these keys.
#[track_caller]
fn scanned(place: &TestFolder, keys: &[&str]) -> Value {
    let set = keys.iter().flat_map(|key| ["--set".to_owned(), format!("read_hdf5.{key}")]);
    let set: Vec<String> = set.collect();
    let arguments = [vec!["scan", "a.h5", "--json"], set.iter().map(String::as_str).collect()].concat();
    let Outcome { code, out, err } = place.wavex(&arguments);
    assert_eq!(code, Some(0), "{keys:?}: {err}");
    serde_json::from_str(&out).unwrap()
}

/// Number of shots read, and counts of the others with the reason.
fn counts(json: &Value) -> (u64, Vec<(u64, &str)>) {
    let rejected = json["rejected"].as_array().unwrap().iter();
    let rejected = rejected.map(|item| (item["count"].as_u64().unwrap(), item["reason"].as_str().unwrap()));
    (json["shots"].as_u64().unwrap(), rejected.collect())
}

#[test]
fn shots_are_cut_by_place_time_and_number() {
    let place = granule();
    // Shots are 1/1024 degrees apart, to the east and to the south.
    let json = scanned(&place, &["extent_deg=[-44.2501, -14, -44.2475, -13]"]);
    assert_eq!(counts(&json), (3, vec![(9, "outside `extent_deg`")]));
    assert_eq!(
        counts(&scanned(&place, &["extent_deg=[315, -14, 316, -13]"])),
        (12, vec![]),
        "0 to 360 degrees"
    );

    let [from_s, to_s] = [3.5, 6.5].map(|shots| FIRST_S + shots * INTERVAL_S);
    let window = format!("time_s=[{from_s:.6}, {to_s:.6}]");
    let json = scanned(&place, &[&window]);
    assert_eq!(counts(&json), (3, vec![(9, "outside `time_s`")]));
    assert!((json["first_shot_s"].as_f64().unwrap() - FIRST_S - 4.0 * INTERVAL_S).abs() < 1e-6);
    // The window counts on the sums with the offset.
    let later = format!("time_s=[{:.6}, {:.6}]", from_s + 10.0, to_s + 10.0);
    assert_eq!(counts(&scanned(&place, &[&later, "time_offset_s=10"])).0, 3);

    let numbers = [5, 7].map(|shot: u64| 19_640_513_500_108_370 + 200_000_001 * shot);
    let list = format!("shots=[{}, {}, 12]", numbers[0], numbers[1]);
    assert_eq!(counts(&scanned(&place, &[&list])), (2, vec![(10, "not in `shots`")]));
    place.write("plot.txt", format!("# plot 7\n{}\n{}\n", numbers[0], numbers[1]).as_bytes());
    let json = scanned(&place, &["shots=\"plot.txt\"", &window]);
    assert_eq!(counts(&json), (1, vec![(10, "not in `shots`"), (1, "outside `time_s`")]));
}

#[test]
fn samples_of_shots_that_are_cut_are_not_read() {
    let place = TestFolder::new();
    place.write("a.h5", include_bytes!("../../crates/wavex-hdf5/tests/data/gedi_bad_shots.h5"));
    let Outcome { code, err, .. } = place.wavex(&["scan", "a.h5"]);
    assert!(code == Some(1) && err.contains("start index 0"), "{err}");
    let found = scanned(&place, &["shots=[0]"]);
    let expected = [(1, "a shot without the positions of its first and last sample"), (3, "not in `shots`")];
    assert_eq!(counts(&found), (0, expected.to_vec()));
}

#[test]
fn shots_are_cut_by_polygons() {
    let place = granule();
    // Shots 0 to 11 are on the line from -44.25, -13.75 to the south-east, 1/1024 degrees apart.
    let at = |shot: f64| [-44.25 + shot / 1024.0, -13.75 - shot / 1024.0];
    let ([first_x, first_y], [last_x, last_y]) = (at(2.0), at(5.0));
    // Two opposite corners are shots: borders are inside.
    let corners = format!(
        "[[{first_x}, {first_y}], [{last_x}, {first_y}], [{last_x}, {last_y}], [{first_x}, {last_y}]]"
    );
    let json = scanned(&place, &[&format!("extent_deg={corners}")]);
    assert_eq!(counts(&json), (4, vec![(8, "outside `extent_deg`")]));
    let closed = corners.replace("]]", &format!("], [{first_x}, {first_y}]]"));
    let ([hole_x, hole_y], [to_x, to_y]) = (at(2.5), at(4.5));
    let hole = format!(
        "[[{hole_x}, {hole_y}], [{to_x}, {hole_y}], [{to_x}, {to_y}], [{hole_x}, {to_y}], [{hole_x}, {hole_y}]]"
    );
    let ([far_x, far_y], [end_x, end_y]) = (at(9.5), at(20.0));
    let far = format!("[[{far_x}, {far_y}], [{end_x}, {far_y}], [{end_x}, {end_y}], [{far_x}, {far_y}]]");
    let geometry = format!("{{\"type\": \"MultiPolygon\", \"coordinates\": [[{closed}, {hole}], [{far}]]}}");
    place.write("plots.geojson", format!("{{\"type\": \"Feature\", \"geometry\": {geometry}}}").as_bytes());
    // Shots 2 and 5 around the hole; 10 and 11 on the long edge of the triangle.
    let json = scanned(&place, &["extent_deg=\"plots.geojson\""]);
    assert_eq!(counts(&json), (4, vec![(8, "outside `extent_deg`")]));
    let both = scanned(&place, &["extent_deg=\"plots.geojson\"", "shots=[12]"]);
    assert_eq!(counts(&both), (0, vec![(12, "not in `shots`")]));
}

#[test]
fn a_wrong_file_of_polygons_is_an_error_with_the_key() {
    let place = granule();
    place.write("line.geojson", b"{\"type\": \"LineString\", \"coordinates\": [[1, 2], [3, 4]]}");
    let scan =
        |name: &str| place.wavex(&["scan", "a.h5", "--set", &format!("read_hdf5.extent_deg=\"{name}\"")]);
    let Outcome { code, err, .. } = scan("line.geojson");
    let problem = "line.geojson: it has a LineString; `extent_deg` takes a Polygon or MultiPolygon in longitude and latitude";
    assert!(code == Some(1) && err.contains(problem), "{err}");
    let Outcome { code, err, .. } = scan("lines.geojson");
    assert!(code == Some(1) && err.contains("lines.geojson"), "{err}");
}

/// A run with a file of polygons is archived with it, and replayed.
#[test]
fn a_file_of_polygons_is_an_input_of_the_archive() {
    let Some(place) = real("extent_deg = 'plot.geojson'\n") else { return };
    let world = "[[[-180, -90], [0, -90], [180, -90], [180, 90], [0, 90], [-180, 90]]]";
    place.write("plot.geojson", format!("{{\"type\": \"Polygon\", \"coordinates\": {world}}}").as_bytes());
    let Outcome { code, err, .. } =
        place.wavex(&["run", "job.toml", "--archive", "archive", "--progress", "never"]);
    assert_eq!(code, Some(0), "{err}");
    let archive: Value = serde_json::from_str(&place.text("archive/archive.json")).unwrap();
    let inputs: Vec<&Value> =
        archive["inputs"]["files"].as_array().unwrap().iter().map(|file| &file["path"]).collect();
    assert_eq!(inputs, ["in/a.h5", "plot.geojson"]);
    let Outcome { code, err, .. } = place.wavex(&["replay", "archive"]);
    assert_eq!(code, Some(0), "{err}");
}

#[test]
fn a_cut_without_shots_is_a_warning_with_the_ranges_of_the_file() {
    let place = granule();
    let note = |key: &str| scanned(&place, &[key])["notes"][0].as_str().unwrap().to_owned();
    assert_eq!(
        note("extent_deg=[10, 50, 11, 51]"),
        "no shot is left by the cuts (`extent_deg`: longitudes are -44.2500 to -44.2393, latitudes -13.7607 to \
         -13.7500 degrees); correct or remove the keys"
    );
    assert_eq!(
        note("extent_deg=[[-14, -45], [-13, -45], [-13, -44]]"),
        "no shot is left by the cuts (`extent_deg`: longitudes are -44.2500 to -44.2393, latitudes -13.7607 to \
         -13.7500 degrees, and longitude comes first in each point); correct or remove the keys"
    );
    let last_s = FIRST_S + 11.0 * INTERVAL_S;
    assert_eq!(
        note("time_s=[1, 2]"),
        format!(
            "no shot is left by the cuts (`time_s`: times are {FIRST_S:.3} to {last_s:.3} s); correct or remove the keys"
        )
    );
    assert_eq!(
        note("shots=[7]"),
        "no shot is left by the cuts (`shots`: numbers are 19640513500108370 to 19640515700108381); correct or \
         remove the keys"
    );
}

#[test]
fn a_wrong_list_of_shots_is_an_error_with_its_line() {
    let place = granule();
    place.write("plot.txt", b"12\n1.5e3\n");
    let Outcome { code, err, .. } = place.wavex(&["scan", "a.h5", "--set", "read_hdf5.shots=\"plot.txt\""]);
    let problem = "plot.txt: line 2: `1.5e3` is no shot number; write one whole number per line";
    assert!(code == Some(1) && err.contains(problem), "{err}");
    let Outcome { code, err, .. } = place.wavex(&["scan", "a.h5", "--set", "read_hdf5.shots=\"plots.txt\""]);
    assert!(code == Some(1) && err.contains("plots.txt"), "{err}");
}

/// Stages from samples to files.
const STAGES: &str = "[[stage]]\ntype = 'measure_footprints'\n[[stage]]\ntype = 'georeference'\n\
                      [[stage]]\ntype = 'write_footprints'\npath = '*.csv'\n[[stage]]\ntype = 'write_las'\npath = '*.las'\n";

/// A job over the real file with these keys of the reader; `None` without data.
fn real(keys: &str) -> Option<TestFolder> {
    let data = data()?;
    let place = TestFolder::new();
    place.write("in/a.h5", &std::fs::read(data.join("gedi/gedi_l1b.h5")).unwrap());
    let job =
        format!("[job]\noutput_dir = 'out'\n[[stage]]\ntype = 'read_hdf5'\npath = 'in/*.h5'\n{keys}{STAGES}");
    place.write("job.toml", job.as_bytes());
    Some(place)
}

/// Rows of a table without its header.
fn rows(place: &TestFolder, name: &str) -> Vec<String> {
    place.text(name).lines().skip(1).map(str::to_owned).collect()
}

#[test]
fn each_beam_is_a_recording() {
    let (Some(place), Some(whole)) = (real("split_beams = true\n"), real("")) else { return };
    for place in [&place, &whole] {
        let Outcome { code, err, .. } = place.wavex(&["run", "job.toml", "--progress", "never"]);
        assert_eq!(code, Some(0), "{err}");
        assert!(!err.contains("scan angles"), "beams of large footprints do not scan: {err}");
    }
    let report: Value = serde_json::from_str(&place.text("out/job_report.json")).unwrap();
    let inputs = report["inputs"].as_array().unwrap();
    assert_eq!(inputs.len(), 4);
    // Noise and response are those of the beam in either case.
    let mut all = Vec::new();
    for input in inputs {
        let stem = input["stem"].as_str().unwrap();
        assert!(stem.starts_with("a_BEAM") && place.path(&format!("out/{stem}.las")).exists(), "{stem}");
        all.extend(rows(&place, &format!("out/{stem}.csv")));
    }
    // Only the running number of the shot begins anew.
    let without_number = |rows: &[String]| -> Vec<String> {
        rows.iter().map(|row| row.split_once(',').unwrap().1.to_owned()).collect()
    };
    assert!(without_number(&all) == without_number(&rows(&whole, "out/a.csv")), "tables differ");
    assert!(!place.path("out/a.csv").exists());

    let Outcome { code, out, err } = place.wavex(&["check", "job.toml"]);
    assert!(code == Some(0) && out.contains("files:  1, "), "{out}{err}");
    // A file that cannot be read is one input, which fails.
    place.write("in/b.h5", b"no HDF5");
    let Outcome { code, err, .. } = place.wavex(&["run", "job.toml", "--resume", "--progress", "never"]);
    assert!(code == Some(1) && err.contains("a_BEAM0101: skipped") && err.contains("b.h5: "), "{err}");
}

#[test]
fn a_run_without_shots_ends_with_the_warning() {
    let Some(place) = real("split_beams = true\nextent_deg = [-10, 50, -9, 51]\n") else { return };
    let Outcome { code, err, .. } = place.wavex(&["run", "job.toml", "--progress", "never"]);
    assert_eq!(code, Some(0), "{err}");
    assert_eq!(err.matches("no shot is left by the cuts (`extent_deg`: longitudes are ").count(), 4, "{err}");
}
