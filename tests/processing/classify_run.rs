//! `classify` in runs: the same bytes however they are scheduled, heights above the ground, and the page.

use std::collections::BTreeMap;
use std::sync::OnceLock;

use wavex::engine::{self, Options};
use wavex::job::Job;
use wavex::registry::STAGES;
use wavex_formats::las::{Point, RawPoints};
use wavex_testkit::{Outcome, TestFolder};

/// A flight over hills with houses and trees, as recording with trajectory.
const FLIGHT: &str = "[[stage]]\ntype = 'simulate'\nstem = 'flight'\nlines = 100\nshots_per_line = 100\nseed = 2\nscene_seed = 7\n\
    landscape = 'country'\nrelief_m = 8.0\nwood_ratio = 0.2\nhouse_ratio = 0.3\nwater_ratio = 0.0\nflying_height_m = 120.0\n\
    pulse_rate_hz = 10000.0\nspeed_mps = 50.0\nscan_angle_deg = [-20.0, 20.0]\nsbet = '*.out'\n\
    [[stage]]\ntype = 'write_arrow'\n";

/// A job that classifies its points.
fn job(job_keys: &str, keys: &str) -> String {
    format!(
        "[job]\ninput_dir = 'out'\noutput_dir = 'made'\n{job_keys}\n[job.geometry]\ntrajectory = 'flight.out'\ncrs = 'utm'\n\
         [[stage]]\ntype = 'read_arrow'\npath = 'flight.arrow'\n\
         [[stage]]\ntype = 'calibrate'\nwaveforms = 2000\nresponse = 'gaussian'\n\
         [[stage]]\ntype = 'decompose'\nmode = 'fastest'\n\
         [[stage]]\ntype = 'georeference'\n\
         [[stage]]\ntype = 'classify'\nblock_m = 20\nmargin_m = 15\n{keys}\n\
         [[stage]]\ntype = 'write_las'\n[[stage]]\ntype = 'write_table'\npath = '*.csv'\n[[stage]]\ntype = 'write_lstat'\n"
    )
}

/// The folder with the recording.
fn flight() -> &'static TestFolder {
    static FLIGHT_FOLDER: OnceLock<TestFolder> = OnceLock::new();
    FLIGHT_FOLDER.get_or_init(|| {
        let place = TestFolder::new();
        assert_eq!(place.run(FLIGHT), Outcome::success());
        place
    })
}

/// Outputs by name of a run with this number of threads and this length of queues.
fn outputs(threads: usize, channel_capacity: usize) -> BTreeMap<String, Vec<u8>> {
    let folder = tempfile::tempdir().unwrap();
    let text = job("", "height_above_ground = true");
    let job = Job::parse(STAGES, "job.toml", &text, &[]).unwrap_or_else(|errors| panic!("{errors}"));
    let options =
        Options { threads, channel_capacity, ..Options::of_job(&job, flight().path("out"), folder.path()) };
    let ended = engine::run(&job, &options).unwrap();
    let read = |path: &std::path::PathBuf| {
        (path.file_name().unwrap().to_string_lossy().into_owned(), std::fs::read(path).unwrap())
    };
    ended.inputs[0].outputs.iter().map(read).collect()
}

#[test]
fn threads_and_queues_change_no_byte() {
    let first = outputs(1, 1);
    assert_eq!(first.len(), 3, "{:?}", first.keys());
    for (threads, capacity) in [(4, 16), (2, 3)] {
        let again = outputs(threads, capacity);
        assert!(again == first, "{threads} threads, {capacity} lines in a queue");
    }
}

/// The program with one and with three threads, and the page of the run.
#[test]
fn the_program_writes_heights_and_a_page() {
    let place = flight();
    let mut written = Vec::new();
    for threads in [1, 3] {
        let keys = format!("threads = {threads}\nreport_page = true");
        place.write("classify.toml", job(&keys, "height_above_ground = true").as_bytes());
        assert_eq!(place.wavex(&["--quiet", "run", "classify.toml"]), Outcome::success());
        written.push(
            ["flight.laz", "flight.csv"].map(|name| std::fs::read(place.path("made").join(name)).unwrap()),
        );
    }
    assert!(written[0] == written[1]);

    let table = place.text("made/flight.csv");
    let mut rows = table.lines().map(|line| line.split(',').collect::<Vec<&str>>());
    let heads = rows.next().unwrap();
    let column = |name: &str| heads.iter().position(|head| *head == name).unwrap();
    let (class, height) = (column("class"), column("height_above_ground_m"));
    let rows: Vec<(u8, Option<f64>)> =
        rows.map(|row| (row[class].parse().unwrap(), row[height].parse().ok())).collect();
    let mut points = RawPoints::open(&place.path("made/flight.laz")).unwrap();
    let attribute = points.extra_bytes_descriptors().iter().find(|known| known.name == "Height above ground");
    let attribute = attribute.cloned().unwrap();
    let (mut point, mut n_known, mut n_high) = (Point::default(), 0, 0);
    for (class, height_m) in &rows {
        let stored_m = attribute.value(points.next_point(&mut point).unwrap().unwrap());
        assert_eq!(point.classification, *class);
        match height_m {
            Some(height_m) => assert!((height_m - stored_m).abs() < 0.0006, "{height_m} {stored_m}"),
            None => assert!(stored_m.is_nan(), "{stored_m}"),
        }
        // A ground point is a corner of the triangulation of its own block.
        let of_ground = *class == 2 && height_m.is_some_and(|height_m| height_m.abs() > 1e-3);
        assert!(!of_ground, "{height_m:?}");
        n_known += usize::from(height_m.is_some());
        n_high += usize::from(height_m.is_some_and(|height_m| height_m > 2.5));
    }
    let n_ground = rows.iter().filter(|(class, _)| *class == 2).count();
    assert!(
        n_ground > 1000 && 10 * n_known > 9 * rows.len() && n_high > 100,
        "{n_ground} {n_known} {n_high}"
    );

    let page = place.text("made/classify_report.html");
    for words in
        ["Ground and terrain", "Share of each class", ">Ground</h3>", "ground points: ", "high noise (18): "]
    {
        assert!(page.contains(words), "{words}");
    }
}

#[test]
fn heights_are_written_only_if_a_key_asks_for_them() {
    let place = flight();
    place.write("without.toml", job("", "").replace("'made'", "'without'").as_bytes());
    assert_eq!(place.wavex(&["--quiet", "run", "without.toml"]), Outcome::success());
    let points = RawPoints::open(&place.path("without/flight.laz")).unwrap();
    let names: Vec<&str> = points.extra_bytes_descriptors().iter().map(|known| known.name.as_str()).collect();
    assert!(names.contains(&"Range SD") && !names.contains(&"Height above ground"), "{names:?}");
    place.write("wrong.toml", job("", "ground = false\nheight_above_ground = true").as_bytes());
    let refused = place.wavex(&["--quiet", "check", "wrong.toml"]);
    let message =
        "`height_above_ground`: it needs `ground = true`: without ground there are no heights above it";
    assert!(refused.code == Some(2) && refused.err.contains(message), "{}", refused.err);
}
