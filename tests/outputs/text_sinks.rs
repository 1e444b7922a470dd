//! Text sinks: their output against that of the other sinks of the same run.

use std::path::Path;
use wavex::registry::STAGES;

use wavex::engine;
use wavex::job::Job;

const TO_POINTS: &str = "\
[[stage]]
type = 'simulate'
stem = 'a'
lines = 6
shots_per_line = 150
[[stage]]
type = 'calibrate'
waveforms = 300
response = 'gaussian'
[[stage]]
type = 'decompose'
[[stage]]
type = 'georeference'
";

/// Runs a job of simulator, points, and these stages.
#[track_caller]
fn run(folder: &Path, stages: &str) -> engine::RunSummary {
    let job = Job::parse(STAGES, "job.toml", &format!("{TO_POINTS}{stages}"), &[])
        .unwrap_or_else(|e| panic!("{e}"));
    engine::run(&job, &engine::Options::of_job(&job, folder, folder)).unwrap_or_else(|e| panic!("{e}"))
}

/// Every row of the text equals the point of the LAS file, read by the crate `las`.
#[test]
fn text_says_what_las_says() {
    let folder = tempfile::tempdir().unwrap();
    run(
        folder.path(),
        "[[stage]]\ntype = 'write_las'\npath = '*.las'\nattribute_layout = '1.1'\n\
         [[stage]]\ntype = 'write_ascii'\ncolumns = 'txyzirncuaedph0123'\nseparator = 'tab'\n",
    );
    let text = std::fs::read_to_string(folder.path().join("a.txt")).unwrap();
    let mut reader = las::Reader::from_path(folder.path().join("a.las")).unwrap();
    let mut rows = text.lines();
    let mut n_points = 0;
    for point in reader.read_all().unwrap().points() {
        let point = point.unwrap();
        let row: Vec<&str> = rows.next().unwrap().split('\t').collect();
        let number = |column: usize| row[column].parse::<f64>().unwrap();
        assert_eq!(number(0), point.gps_time.unwrap());
        for (column, place) in [(1, point.x), (2, point.y), (3, point.z)] {
            assert!((number(column) - place).abs() < 1e-8, "{row:?}");
            assert_eq!(row[column].split('.').nth(1).unwrap().len(), 3, "a millimetre has three decimals");
        }
        let (bytes, bit) = (&point.extra_bytes, |set: bool| f64::from(u8::from(set)));
        let right = matches!(point.scan_direction, las::point::ScanDirection::LeftToRight);
        let whole = [
            f64::from(point.intensity),
            f64::from(point.return_number),
            f64::from(point.number_of_returns),
            f64::from(u8::from(point.classification)),
            f64::from(point.user_data),
        ];
        (0..5).for_each(|index| assert_eq!(number(4 + index), whole[index], "column {index}: {row:?}"));
        assert!((number(9) - f64::from(point.scan_angle)).abs() < 1e-4, "{row:?}");
        let flags = [bit(point.is_edge_of_flight_line), bit(right), f64::from(point.point_source_id)];
        (0..3).for_each(|index| assert_eq!(number(10 + index), flags[index], "column {index}: {row:?}"));
        assert_eq!(number(13), bit(point.is_withheld));
        let attributes = [
            f64::from(bytes[0]) * 0.025 + 0.5,
            f64::from(bytes[1]) * 0.008,
            f64::from(u16::from_le_bytes([bytes[2], bytes[3]])),
            f64::from(bytes[4]) * 0.1,
        ];
        (0..4).for_each(|index| assert!((number(14 + index) - attributes[index]).abs() < 1e-9, "{row:?}"));
        n_points += 1;
    }
    assert!(n_points > 800 && rows.next().is_none(), "{n_points}");
}

/// Rows of a text as numbers, without the header line.
fn numbers(folder: &Path, name: &str) -> Vec<Vec<f64>> {
    let text = std::fs::read_to_string(folder.join(name)).unwrap();
    let rows = text.lines().filter(|line| !line.starts_with('#'));
    rows.map(|row| row.split(' ').map(|cell| cell.parse().unwrap()).collect()).collect()
}

fn names(folder: &Path, name: &str) -> Vec<String> {
    let text = std::fs::read_to_string(folder.join(name)).unwrap();
    text.lines().next().unwrap().trim_start_matches("# ").split(' ').map(str::to_owned).collect()
}

/// Both layouts agree line by line and satisfy the counter identities; their sums equal the report.
#[test]
fn both_layouts_of_line_statistics_keep_the_laws() {
    let folder = tempfile::tempdir().unwrap();
    let report = run(
        folder.path(),
        "[[stage]]\ntype = 'write_lstat'\nid = 'new'\n\
         [[stage]]\ntype = 'write_lstat'\nid = 'old'\nlayout = '1.0'\npath = 'old.txt'\n",
    );
    let totals = &report.inputs[0].totals;
    let (new, old) = (names(folder.path(), "a_lstat.txt"), names(folder.path(), "old.txt"));
    assert_eq!((new.len(), old.len()), (20, 11));
    let (rows, old_rows) = (numbers(folder.path(), "a_lstat.txt"), numbers(folder.path(), "old.txt"));
    assert_eq!((rows.len(), old_rows.len()), (6, 6));
    for (row, old_row) in rows.iter().zip(&old_rows) {
        let get = |name: &str| row[new.iter().position(|column| column == name).unwrap()];
        let was = |name: &str| old_row[old.iter().position(|column| column == name).unwrap()];
        assert!(get("nw") >= get("nw_empty") + get("nw_deleted") && get("np") > 0.0);
        assert_eq!(get("n_georef"), get("np"));
        assert!(get("nw_refined2x") <= get("nw_refined1x") && get("nw_refined1x") <= get("nw"));
        assert_eq!(
            [was("gps_time"), was("n_waveforms"), was("n_points")],
            [get("gps_time"), get("nw"), get("np")]
        );
        assert_eq!(was("n_empty"), get("nw_empty") + get("nw_deleted"));
        assert_eq!(was("n_refined"), get("np"), "this mode refines every return");
        for (then, now) in [
            ("n_filtered", "np_filtered"),
            ("n_merged", "np_merged"),
            ("n_air", "np_air"),
            ("n_low", "np_low"),
            ("n_range", "np_range"),
            ("n_atm", "np_atm"),
        ] {
            assert_eq!(was(then), get(now), "{now}");
        }
        assert!(get("AGL") > 300.0);
    }
    for (index, name) in new.iter().enumerate().filter(|(_, name)| name.starts_with('n')) {
        let sum: f64 = rows.iter().map(|row| row[index]).sum();
        assert_eq!(sum as u64, totals[name.as_str()], "{name}");
    }
    assert_eq!(totals["nw"], totals["nw_empty"] + totals["nw_deleted"] + totals["nw_with_points"]);
    let by_reason = &report.inputs[0].filtered_by_reason;
    assert_eq!(by_reason.values().sum::<u64>(), totals["np_filtered"], "{by_reason:?}");
    assert!(by_reason["too weak"] > 0, "{by_reason:?}");
    assert_eq!(
        totals["n_candidates"] + totals["n_added"],
        totals["np"] + totals["np_filtered"] + totals["np_merged"] + totals["np_xtalk_dropped"]
    );
}

const LONG: &str =
    "[[stage]]\ntype = 'simulate'\nstem = 'a'\nlines = 120\nshots_per_line = 100\npulse_rate_hz = 6000\n";

/// Sensor path estimated from beams of a simulated flight, against the truth.
#[test]
fn sensor_path_from_origins_equals_that_from_beams() {
    let circular =
        "scanner = 'circular'\nscan_angle_deg = [-20, 20]\nrotation_hz = 25\nroll_deg = 5\npitch_deg = 3\n";
    for keys in ["", circular] {
        path_from_beams(&format!("{LONG}{keys}"));
    }
}

fn path_from_beams(flight: &str) {
    let folder = tempfile::tempdir().unwrap();
    let job = format!(
        "{flight}[[stage]]\ntype = 'write_trajectory'\nid = 'origins'\ninterval_s = 0\n\
         [[stage]]\ntype = 'write_trajectory'\nid = 'met'\nsensor = 'beams'\npath = 'met.txt'\n\
         [[stage]]\ntype = 'write_trajectory'\nid = 'some'\nevery = 5000\npath = 'some.txt'\nheader = false\n"
    );
    let job = Job::parse(STAGES, "job.toml", &job, &[]).unwrap_or_else(|e| panic!("{e}"));
    engine::run(&job, &engine::Options::of_job(&job, folder.path(), folder.path())).unwrap();
    let rows = numbers(folder.path(), "a_traj.txt");
    let met = numbers(folder.path(), "met.txt");
    assert_eq!(names(folder.path(), "met.txt"), ["gps_time", "X", "Y", "Z"]);
    assert_eq!(rows.len(), 12_000);
    let some = numbers(folder.path(), "some.txt");
    assert_eq!(some, [0, 5000, 10_000, 11_999].map(|index: usize| rows[index].clone()), "and the last shot");
    assert!(met.len() >= 15, "{}", met.len());
    let mut worst_m = 0.0f64;
    for row in &met {
        // The scanner pauses between lines; the path continues straight.
        let after = rows.partition_point(|other| other[0] <= row[0]);
        let (from, to) = (&rows[after - 1], &rows[after]);
        let share = (row[0] - from[0]) / (to[0] - from[0]);
        let off = |axis: usize| from[axis] + share * (to[axis] - from[axis]) - row[axis];
        let error_m = (1..4).map(|axis| off(axis).powi(2)).sum::<f64>().sqrt();
        worst_m = error_m.max(worst_m);
    }
    // A microsecond in the text's time is 0.06 mm of flight.
    println!("the place from beams is right within {worst_m} m");
    assert!(worst_m < 0.001, "{worst_m} m");
}

/// A recording shorter than the interval of rows has one row from its beams.
#[test]
fn a_short_recording_has_one_row_from_its_beams() {
    let folder = tempfile::tempdir().unwrap();
    // 70 ms and three pauses.
    let job = "[[stage]]\ntype = 'simulate'\nstem = 'a'\nlines = 4\nshots_per_line = 100\npulse_rate_hz = 6000\n\
               [[stage]]\ntype = 'write_trajectory'\nid = 'origins'\ninterval_s = 0\n\
               [[stage]]\ntype = 'write_trajectory'\nid = 'met'\nsensor = 'beams'\npath = 'met.txt'\n";
    let job = Job::parse(STAGES, "job.toml", job, &[]).unwrap_or_else(|e| panic!("{e}"));
    engine::run(&job, &engine::Options::of_job(&job, folder.path(), folder.path())).unwrap();
    let (rows, met) = (numbers(folder.path(), "a_traj.txt"), numbers(folder.path(), "met.txt"));
    assert!(rows.last().unwrap()[0] - rows[0][0] < 0.1, "shorter than the interval");
    assert_eq!(met.len(), 1);
    let nearest = rows.iter().min_by(|a, b| {
        let apart = |row: &[f64]| (row[0] - met[0][0]).abs();
        apart(a).total_cmp(&apart(b))
    });
    let error_m = (1..4).map(|axis| (nearest.unwrap()[axis] - met[0][axis]).powi(2)).sum::<f64>().sqrt();
    assert!(error_m < 1.0, "{error_m} m");
}

/// A path without rows still has its header line.
#[test]
fn a_path_without_rows_has_its_first_line() {
    let folder = tempfile::tempdir().unwrap();
    let run_on = |stages: &str| {
        let job = Job::parse(STAGES, "job.toml", stages, &[]).unwrap_or_else(|e| panic!("{e}"));
        engine::run(&job, &engine::Options::of_job(&job, folder.path(), folder.path())).unwrap();
    };
    let text = |name: &str| std::fs::read_to_string(folder.path().join(name)).unwrap();
    // Without its trajectory, the recording is in the scanner's frame.
    run_on(
        "[[stage]]\ntype = 'simulate'\nstem = 'a'\nlines = 2\nshots_per_line = 50\nroll_deg = 6\n\
         sbet = 'a.out'\n[[stage]]\ntype = 'write_arrow'\npath = 'a.arrow'\n",
    );
    run_on(
        "[[stage]]\ntype = 'read_arrow'\npath = 'a.arrow'\n[[stage]]\ntype = 'write_trajectory'\n\
         [[stage]]\ntype = 'write_trajectory'\nid = 'bare'\nheader = false\npath = 'bare.txt'\n",
    );
    assert_eq!((text("a_traj.txt"), text("bare.txt")), ("# gps_time X Y Z\n".into(), String::new()));
}

const WEEK_2365_S: f64 = 2365.0 * 604_800.0 - 1e9;

/// With a trajectory, rows are its poses at the times of shots.
#[test]
fn with_a_trajectory_rows_are_its_poses() {
    let folder = tempfile::tempdir().unwrap();
    let simulate = "[[stage]]\ntype = 'simulate'\nstem = 'a'\nlines = 40\nshots_per_line = 100\n\
                    pulse_rate_hz = 6000\nroll_deg = 6\npitch_deg = 3\nheading_deg = 355\nyaw_deg = 8\n\
                    motion_period_s = 2\nsbet = 'a.out'\n[[stage]]\ntype = 'write_arrow'\npath = 'a.arrow'\n";
    let read = "[job.geometry]\ntrajectory = 'a.out'\ncrs = 'geodetic'\n[[stage]]\ntype = 'read_arrow'\n\
                path = 'a.arrow'\n[[stage]]\ntype = 'write_trajectory'\n";
    for text in [simulate, read] {
        let job = Job::parse(STAGES, "job.toml", text, &[]).unwrap_or_else(|e| panic!("{e}"));
        engine::run(&job, &engine::Options::of_job(&job, folder.path(), folder.path())).unwrap();
    }
    let sbet = std::fs::read(folder.path().join("a.out")).unwrap();
    let number = |bytes: &[u8]| f64::from_le_bytes(bytes.try_into().unwrap());
    let records: Vec<Vec<f64>> =
        sbet.chunks_exact(136).map(|record| record.chunks_exact(8).map(number).collect()).collect();
    assert_eq!(names(folder.path(), "a_traj.txt").join(" "), "gps_time X Y Z roll pitch heading");
    let rows = numbers(folder.path(), "a_traj.txt");
    assert!(rows.len() >= 8, "{}", rows.len());
    for row in &rows {
        let time_s = row[0] - WEEK_2365_S;
        let after = records.partition_point(|record| record[0] <= time_s);
        let (from, to) = (&records[after - 1], &records[after]);
        let share = (time_s - from[0]) / (to[0] - from[0]);
        let at = |field: usize| from[field] + share * (to[field] - from[field]);
        let heading = (at(9) - at(10)).to_degrees();
        let expected =
            [at(2).to_degrees(), at(1).to_degrees(), at(3), at(7).to_degrees(), at(8).to_degrees()];
        for (column, (expected, within)) in
            expected.into_iter().zip([2e-9, 2e-9, 1e-3, 1e-3, 1e-3]).enumerate()
        {
            assert!((row[1 + column] - expected).abs() < within, "column {column}: {expected} {row:?}");
        }
        let apart = (row[6] - heading).rem_euclid(360.0);
        assert!(apart.min(360.0 - apart) < 1e-3 && (0.0..360.0).contains(&row[6]), "{heading} {row:?}");
    }
}

#[test]
fn the_statistics_in_words_have_every_part() {
    let folder = tempfile::tempdir().unwrap();
    let report = run(folder.path(), "[[stage]]\ntype = 'write_lstat'\n");
    let input = &report.inputs[0];
    let text = wavex::report::stat_log(&report, input, &["out/job_report.json".into()], None);
    let titles = ["Run time", "Input", "Decoding", "Extraction", "Trajectory", "Georeferencing", "Output"];
    let place =
        |title: &&str| text.find(&format!("\n{title}\n---")).unwrap_or_else(|| panic!("{title}: {text}"));
    assert!(titles.iter().map(place).is_sorted(), "{text}");
    let value = |name: &str| {
        let row = text.lines().find(|line| line.starts_with(&format!("{name:<36} ")));
        row.unwrap_or_else(|| panic!("{name}: {text}"))[37..].to_owned()
    };
    assert_eq!(value("waveforms"), input.totals["nw"].to_string());
    assert_eq!(value("returns"), input.totals["np"].to_string());
    assert_eq!(value("points with coordinates"), input.totals["n_georef"].to_string());
    assert_eq!((value("scan lines"), value("shots")), ("6".into(), "900".into()));
    assert!(value("calibration, low power").starts_with("noise "));
    assert!(text.contains("a_lstat.txt") && text.contains("out/job_report.json"), "{text}");
    for name in ["start", "end"] {
        assert!(value(name).ends_with('Z') && value(name).len() == 20, "{name}: {}", value(name));
    }
    assert_eq!(value("exit status"), "0, success");
    assert_eq!((value("mount"), value("calibration")), ("level".into(), "none".into()));
    assert!(value("geoid").starts_with("none: "), "{text}");
    assert_eq!(value("unit"), "as in the coordinate reference system");
}

#[test]
fn what_the_geometry_says_stands_in_the_statistics() {
    let keys = "trajectory = 'a.out'\nmount = [0.0, 0.5, 90.0]\ncalibration = 'cal.txt'\ngeoid = 'egm96'\n\
                geoid_dir = 'geoids'\nunit = 'us_ft'\n";
    let geometry = toml::from_str(keys).unwrap();
    let expected = [
        ("mount", "[0.0,0.5,90.0]"),
        ("calibration", "cal.txt"),
        ("geoid", "egm96 in geoids"),
        ("unit", "us_ft"),
    ];
    assert_eq!(
        wavex::report::geometry_words(&geometry),
        expected.map(|(name, words)| (name, words.to_owned()))
    );
}

#[test]
fn statistics_need_a_name_for_each_input() {
    for (pattern, fits) in [("", true), ("logs/*.log", true), ("stat.log", true), ("*.las", false)] {
        match Job::parse(STAGES, "job.toml", &format!("[job]\nstat_log = '{pattern}'\n{TO_POINTS}"), &[]) {
            Ok(_) => assert!(fits, "{pattern}"),
            Err(errors) => {
                let errors = errors.to_string();
                assert!(!fits && errors.contains("`stat_log`: it must end in .log"), "{errors}");
            }
        }
    }
    let several = "[job]\nstat_log = 'out/stat.log'\n[[stage]]\ntype = 'read_las'\npath = '*.las'\n";
    let errors = Job::parse(STAGES, "job.toml", several, &[]).unwrap_err().to_string();
    let expected = "error: `stat_log`: every input of this job would write the same file, \"out/stat.log\"\n--> job.toml\n = \
                    help: write `*` in place of the stem of the input, such as \"out/*_stat.log\"\n";
    assert_eq!(errors, expected);
}
