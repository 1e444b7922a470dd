//! The whole chain, from a recording to files.

use std::collections::BTreeMap;
use std::path::Path;

use wavex::engine::RunSummary;

use wavex_testkit::georeferenced_flight::{Flight, Truth, distance_m, fly, run};

const INSTALLED: &str = "lever_arm_m = [0.8, -0.35, 1.1]\nboresight_deg = [0.4, -0.7, 1.3]\n";
pub const SWAYING: &str =
    "roll_deg = 8.0\npitch_deg = 5.0\nyaw_deg = 5.0\nmotion_period_s = 4.0\nheading_deg = 70.0\n";
const GEOMETRY: &str = "trajectory = '*.out'\n\
                        calibration = { lever_arm_m = [0.8, -0.35, 1.1], boresight_deg = [0.4, -0.7, 1.3] }\n";
const TO_FILES: &str = "[[stage]]\ntype = 'calibrate'\nwaveforms = 2000\nresponse = 'gaussian'\n\
                        [[stage]]\ntype = 'decompose'\n\
                        [[stage]]\ntype = 'georeference'\n\
                        [[stage]]\ntype = 'write_table'\npath = '*_returns.csv'\n\
                        [[stage]]\ntype = 'write_las'\npath = '*.las'\n\
                        [[stage]]\ntype = 'write_lstat'\n";

/// Runs the chain over a flight, with stages between reader and `calibrate`.
#[track_caller]
pub fn process(flight: &Flight, threads: usize, geometry: &str, before: &str) -> RunSummary {
    let job = format!(
        "[job]\nthreads = {threads}\n[job.geometry]\n{geometry}\n\
         [[stage]]\ntype = 'read_arrow'\npath = 'a.arrow'\n{before}{TO_FILES}"
    );
    run(flight.folder(), &job).unwrap_or_else(|error| panic!("{error}"))
}

/// A return of the table.
pub struct Found {
    pub shot: u64,
    pub range_m: f64,
    pub point_m: [f64; 3],
    pub total_uncertainty_m: f64,
}

/// Returns of a run.
pub fn returns(folder: &Path) -> Vec<Found> {
    let text = std::fs::read_to_string(folder.join("a_returns.csv")).unwrap();
    let mut lines = text.lines();
    let names: Vec<&str> = lines.next().unwrap().split(',').collect();
    let of_row = |row: &str| {
        let cells: Vec<&str> = row.split(',').collect();
        let cell = |name: &str| cells[names.iter().position(|other| *other == name).unwrap()];
        let number = |name: &str| cell(name).parse::<f64>().unwrap_or(f64::NAN);
        Found {
            shot: number("shot") as u64,
            range_m: number("range_m"),
            point_m: ["x", "y", "z"].map(number),
            total_uncertainty_m: number("total_uncertainty_m"),
        }
    };
    lines.map(of_row).collect()
}

/// Pairs each return with the nearest true one of its shot.
pub fn pairs<'t>(flight: &'t Flight, found: &'t [Found]) -> Vec<(&'t Found, &'t Truth)> {
    let mut by_shot: BTreeMap<u64, Vec<&Truth>> = BTreeMap::new();
    flight.truth.iter().for_each(|truth| by_shot.entry(truth.shot).or_default().push(truth));
    let nearest = |found: &Found| {
        let off = |truth: &&&Truth| (truth.range_m - found.range_m).abs();
        by_shot.get(&found.shot)?.iter().min_by(|a, b| off(a).total_cmp(&off(b))).copied()
    };
    found.iter().filter_map(|found| nearest(found).map(|truth| (found, truth))).collect()
}

/// Point error beyond the range error, m: point distance minus range error.
fn beyond_range_m((found, truth): &(&Found, &Truth)) -> f64 {
    (distance_m(found.point_m, truth.point_m) - (found.range_m - truth.range_m).abs()).abs()
}

/// `decompose` has range errors above 1 mm in places without noise, because the digitiser rounds;
/// the chain must add none.
#[test]
fn points_are_off_by_what_their_ranges_are() {
    let flight = fly(&format!(
        "lines = 60\nshots_per_line = 100\npulse_rate_hz = 50000\nnoise_sd_dn = 0.0\nnoise_autocorrelation = []\n\
         response = 'gaussian'\n{INSTALLED}{SWAYING}"
    ));
    let report = process(&flight, 2, GEOMETRY, "");
    let found = returns(flight.folder());
    let pairs = pairs(&flight, &found);
    assert!(pairs.len() > 5500, "{}", pairs.len());
    let worst_m = pairs.iter().map(beyond_range_m).fold(0.0, f64::max);
    let mut errors: Vec<f64> = pairs.iter().map(|(f, t)| distance_m(f.point_m, t.point_m)).collect();
    errors.sort_by(f64::total_cmp);
    println!(
        "{} points: median {:.3} mm off, of which at most {:.4} mm are not the range's",
        pairs.len(),
        1e3 * errors[errors.len() / 2],
        1e3 * worst_m
    );
    assert!(worst_m < 1e-3, "{worst_m}");
    assert!(errors[errors.len() / 2] < 1e-3, "{}", errors[errors.len() / 2]);
    let input = &report.inputs[0];
    assert_eq!(input.totals["n_georef"], input.totals["np"]);
    assert_eq!(input.frame.as_deref(), Some("earth"));
}

/// A block recorded with a later shot gets the pose of the shot that caused it.
#[test]
fn echoes_have_the_pose_of_their_own_shot() {
    let flight = fly(&format!(
        "landscape = 'country'\nlines = 48\nshots_per_line = 240\npulse_rate_hz = 400000\nmodulation_ns = 15\n\
         flying_height_m = 1500\nas_recorded = true\nresponse = 'gaussian'\n{INSTALLED}{SWAYING}"
    ));
    process(&flight, 2, GEOMETRY, "[[stage]]\ntype = 'resolve_mta'\n");
    let found = returns(flight.folder());
    let pairs = pairs(&flight, &found);
    let right: Vec<_> = pairs.iter().filter(|(f, t)| (f.range_m - t.range_m).abs() < 0.3).collect();
    assert!(
        right.len() > 10_000 && right.len() * 100 > 98 * found.len(),
        "{} of {}",
        right.len(),
        found.len()
    );
    let worst_m = right.into_iter().map(beyond_range_m).fold(0.0, f64::max);
    println!("several pulses in the air: at most {:.4} mm beyond the range's own error", 1e3 * worst_m);
    assert!(worst_m < 1e-3, "{worst_m}");
}

/// A terrain model in the map of the points can replace the missing variation of the pulse rate.
#[test]
fn a_terrain_model_in_the_points_map_resolves_a_constant_rate() {
    let flight = fly(&format!(
        "lines = 30\nshots_per_line = 200\npulse_rate_hz = 400000\nflying_height_m = 1500\nas_recorded = true\n\
         canopy_height_m = 0.0\nresponse = 'gaussian'\n{INSTALLED}{SWAYING}"
    ));
    // Level ground at 400 m in all cells.
    let level = "400 ".repeat(41);
    let rows = format!("{level}\n").repeat(41);
    let grid = format!("ncols 41\nnrows 41\nxllcorner 318000\nyllcorner 5298000\ncellsize 100\n{rows}");
    std::fs::write(flight.path("dtm.asc"), grid).unwrap();
    process(&flight, 1, GEOMETRY, "[[stage]]\ntype = 'resolve_mta'\nterrain = 'dtm.asc'\n");
    let found = returns(flight.folder());
    let right = pairs(&flight, &found).iter().filter(|(f, t)| distance_m(f.point_m, t.point_m) < 0.3).count();
    assert!(right > 5000 && right * 1000 > 999 * found.len(), "{right} of {}", found.len());
}

#[test]
fn the_bytes_do_not_depend_on_the_threads() {
    let flight = fly(&format!("lines = 30\nshots_per_line = 100\n{INSTALLED}{SWAYING}"));
    let files = ["a.las", "a_returns.csv", "a_lstat.txt"];
    let made = |threads| {
        process(&flight, threads, GEOMETRY, "");
        files.map(|name| std::fs::read(flight.path(name)).unwrap())
    };
    assert!(made(1) == made(2), "the same job gave different bytes");
}

/// CRS of the LAS file, and height above ground of each line.
#[test]
fn files_have_coordinates_and_height_above_ground() {
    let flight = fly(&format!(
        "lines = 20\nshots_per_line = 100\nbuilding_height_m = 0\ncanopy_height_m = 0\nresponse = 'gaussian'\n{SWAYING}"
    ));
    process(&flight, 1, "trajectory = 'a.pof'\n", "");
    let las = std::fs::read(flight.path("a.las")).unwrap();
    let text = String::from_utf8_lossy(&las);
    assert!(text.contains("PROJCS[\"WGS 84 / UTM zone 33N\""), "no coordinate reference system");
    let lstat = std::fs::read_to_string(flight.path("a_lstat.txt")).unwrap();
    for line in lstat.lines().skip(1) {
        let agl_m: f64 = line.split(' ').next_back().unwrap().parse().unwrap();
        assert!((agl_m - 600.0).abs() < 0.05, "600 m above level ground: {agl_m}");
    }
}
