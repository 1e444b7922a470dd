//! Trajectories, mounts and dates that contradict physics, the beams or each other.

use std::fmt::Write;

use super::flights::QUIET;
use wavex_testkit::georeferenced_flight::{Flight, Placed, fly};
use wavex_testkit::{outcome, wavex};

/// Metres of a degree of longitude at 47 degrees of latitude.
const METRES_PER_DEGREE: f64 = 76_000.0;

/// Text of a flight at 60 m/s to the east around the time of the recording, with these angles.
fn text(roll: f64, pitch: f64, heading: f64) -> String {
    let mut text = String::new();
    for k in 0..400 {
        let since_s = 0.05 * f64::from(k);
        let (time_s, longitude) = (208_795.0 + since_s, 15.0 + 60.0 * since_s / METRES_PER_DEGREE);
        writeln!(text, "{time_s:.2} {longitude:.9} 47.0 1000.0 {roll} {pitch} {heading}").unwrap();
    }
    text
}

fn placed(flight: &Flight, keys: &str) -> Result<Placed, String> {
    flight.place(keys, |truth| truth.range_m)
}

#[test]
fn a_trajectory_that_contradicts_itself_is_refused_with_the_key_that_mends_it() {
    let flight = fly(QUIET);
    let of = |[roll, pitch, heading]: [f64; 3], keys: &str| {
        std::fs::write(flight.path("a.txt"), text(roll, pitch, heading)).unwrap();
        placed(&flight, &format!("trajectory = 'a.txt'\ntrajectory_columns = 'txyzwpk'\n{keys}")).map(|_| ())
    };
    let (degrees, radians) = ([3.0, 2.0, 92.0], [3.0, 2.0, 92.0].map(f64::to_radians));
    assert_eq!(of(degrees, ""), Ok(()));
    assert_eq!(of(radians, "trajectory_angles = 'rad'"), Ok(()));
    let small = of(radians, "").unwrap_err();
    assert!(small.contains("a.txt") && small.contains("set `trajectory_angles = \"rad\"`"), "{small}");
    let large = of(degrees, "trajectory_angles = 'rad'").unwrap_err();
    assert!(large.contains("set `trajectory_angles = \"deg\"`"), "{large}");

    let rolled = of([90.0, 2.0, 92.0], "").unwrap_err();
    assert!(rolled.contains("its roll exceeds 75 degrees in 100.0 % of the flight"), "{rolled}");
    assert_eq!(of([90.0, 2.0, 92.0], "trajectory_limits = 'none'"), Ok(()));

    let across = of([3.0, 2.0, 0.0], "").unwrap_err();
    assert!(across.contains("differ by 90 degrees") && across.contains("trajectory_limits"), "{across}");
    assert_eq!(of([3.0, 2.0, 0.0], "trajectory_limits = 'helicopter'"), Ok(()));
}

#[test]
fn beams_far_from_nadir_are_a_warning_that_names_the_mount() {
    let flight = fly(QUIET);
    let notes = |mount: &str| {
        let keys = format!("trajectory = 'a.out'\nmount = '{mount}'");
        placed(&flight, &keys).unwrap().cx.counters().notes.clone()
    };
    assert_eq!(notes("level"), Vec::<String>::new());
    let notes = notes("x_down_z_right");
    let is_said = |note: &String| note.contains("away from straight down") && note.contains("`mount`");
    assert!(notes.iter().any(is_said), "{notes:?}");
}

#[test]
fn points_above_the_sensor_or_below_all_ground_are_a_warning() {
    let flight = fly(QUIET);
    let notes = |measured: fn(f64) -> f64| {
        let placed = flight.place("trajectory = 'a.out'", |truth| measured(truth.range_m)).unwrap();
        placed.cx.counters().notes.clone()
    };
    assert_eq!(notes(|range_m| range_m), Vec::<String>::new());
    for (measured, words) in [
        ((|range_m| -range_m) as fn(f64) -> f64, "100 % of the returns lie above the sensor"),
        (|range_m| range_m + 2000.0, "lie where the earth has no ground"),
    ] {
        let notes = notes(measured);
        assert!(notes.len() == 1 && notes[0].contains(words), "{notes:?}");
    }
}

#[test]
fn a_system_of_another_area_is_a_warning() {
    let flight = fly(QUIET);
    let notes = |crs: &str| {
        let keys = format!("trajectory = 'a.out'\ncrs = '{crs}'");
        placed(&flight, &keys).unwrap().cx.counters().notes.clone()
    };
    for right in ["utm", "EPSG:32633", "EPSG:25833", "geodetic", "ecef"] {
        assert_eq!(notes(right), Vec::<String>::new(), "{right}");
    }
    for (wrong, mistake) in [
        ("EPSG:2271", "the code"),
        ("EPSG:32733", "the hemisphere"),
        ("utm:33S", "the hemisphere"),
        ("utm:31N", "the zone"),
    ] {
        let notes = notes(wrong);
        let words = format!("longitude 12.6, latitude 47.8: the likely mistake is {mistake}");
        assert!(notes.len() == 1 && notes[0].contains(&words), "{wrong}: {notes:?}");
    }
}

#[test]
fn the_program_warns_once_of_a_system_of_another_area() {
    let flight = fly(QUIET);
    let said = |crs: &str| {
        let job = format!(
            "[job.geometry]\ntrajectory = 'a.out'\ncrs = '{crs}'\n[[stage]]\ntype = 'read_arrow'\npath = 'a.arrow'\n\
             [[stage]]\ntype = 'calibrate'\nwaveforms = 500\nresponse = 'gaussian'\n[[stage]]\ntype = 'decompose'\n\
             [[stage]]\ntype = 'georeference'\n[[stage]]\ntype = 'write_table'\npath = 'a.csv'\n"
        );
        std::fs::write(flight.path("job.toml"), job).unwrap();
        let outcome = outcome(wavex().args(["run", "job.toml"]).current_dir(flight.folder()));
        assert_eq!(outcome.code, Some(0), "{}", outcome.err);
        let report = std::fs::read_to_string(flight.path("job_report.json")).unwrap();
        [outcome.err, report].map(|text| text.matches("is made for").count())
    };
    assert_eq!(
        ["EPSG:2271", "EPSG:32733", "EPSG:32633", "EPSG:25833"].map(said),
        [[1, 1], [1, 1], [0, 0], [0, 0]]
    );
}

/// Year in the header of a POF, after magic, version and offset of the records.
const YEAR: std::ops::Range<usize> = 35..37;

#[test]
fn a_trajectory_of_another_year_is_refused() {
    let flight = fly(QUIET);
    let mut pof = std::fs::read(flight.path("a.pof")).unwrap();
    assert_eq!(pof[YEAR], 2025u16.to_le_bytes());
    assert!(placed(&flight, "trajectory = 'a.pof'").is_ok());
    pof[YEAR].copy_from_slice(&2024u16.to_le_bytes());
    std::fs::write(flight.path("a.pof"), pof).unwrap();
    let error = placed(&flight, "trajectory = 'a.pof'").err().unwrap();
    assert!(error.starts_with("timestamp not found in PO file"), "{error}");
    assert!(error.contains("2025-05-06") && error.contains("check date"), "{error}");
}

#[test]
fn the_week_is_that_of_a_dated_trajectory() {
    let flight = fly(QUIET).of_no_week();
    assert_eq!(placed(&flight, "trajectory = 'a.out'").unwrap().gps_week, None);
    assert_eq!(placed(&flight, "trajectory = 'a.pof'").unwrap().gps_week, Some(2365));
}
