//! Simulated flights as recorded by an instrument, and results of the program.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::OnceLock;
use std::time::Duration;

use serde_json::Value;
use wavex::scan_line::emission_flags::SCAN_DIRECTION_POSITIVE;

use wavex_testkit::container::{Row, container, rows};
use wavex_testkit::sdf::header;
use wavex_testkit::{Outcome, TestFolder};

/// Keys of a flight with three to five pulses in the air.
pub const FLIGHT: &str = "seed = 5\nlandscape = 'country'\nlines = 64\nshots_per_line = 240\npulse_rate_hz = 400000\n\
                          modulation_ns = 15\nflying_height_m = 1500\nrelief_m = 120\nwater_ratio = 0.02\n\
                          false_alarm_rate = 0.002\nblind_gap_ns = 15\nroll_deg = 2\n";

/// End of a chain without points, in the fast mode.
pub const TO_RETURNS: &str = "\
[[stage]]
type = 'calibrate'
waveforms = 2000
response = 'gaussian'
[[stage]]
type = 'decompose'
mode = 'fastest'
[[stage]]
type = 'write_table'
path = 'returns.csv'
";

/// A simulated recording with the truth of its returns.
pub struct Flight {
    pub recording: Vec<u8>,
    pub truth: String,
}

/// Simulates a flight with these keys into `recording.arrow`.
pub fn fly(keys: &str) -> Flight {
    let place = TestFolder::new();
    let job = format!(
        "[[stage]]\ntype = 'simulate'\ntruth = 'truth.csv'\n{keys}\n\
         [[stage]]\ntype = 'write_arrow'\npath = 'recording.arrow'\ncompression = 'none'\n"
    );
    assert_eq!(place.run(&job), Outcome::success());
    Flight {
        recording: std::fs::read(place.path("out/recording.arrow")).unwrap(),
        truth: place.text("out/truth.csv"),
    }
}

/// [`FLIGHT`] as recorded, in map coordinates.
pub fn recorded() -> &'static Flight {
    static FOUND: OnceLock<Flight> = OnceLock::new();
    FOUND.get_or_init(|| fly(&format!("{FLIGHT}as_recorded = true")))
}

/// The same in the scanner's frame, with the content that SDF can store.
pub fn in_scanner_frame() -> &'static Flight {
    static FOUND: OnceLock<Flight> = OnceLock::new();
    FOUND.get_or_init(|| in_sdf(fly(&format!("{FLIGHT}as_recorded = true\nsbet = 'flight.sbet'"))))
}

/// The part of a flight that SDF can store.
pub fn in_sdf(flight: Flight) -> Flight {
    let mut lines = lines_of(&flight.recording);
    lines.iter_mut().flatten().for_each(as_sdf);
    Flight { recording: container(&header(), &lines), ..flight }
}

/// Removes content that SDF cannot store.
fn as_sdf(row: &mut Row) {
    row.shot.scan_angle_deg = None;
    row.shot.frame_scale = None;
    row.shot.flags &= !SCAN_DIRECTION_POSITIVE;
    row.blocks.iter_mut().for_each(|block| block.1 = (block.1 * 1e6).round() / 1e6);
}

/// Rows of a container by line.
pub fn lines_of(recording: &[u8]) -> Vec<Vec<Row>> {
    let place = TestFolder::with(&[("a.arrow", recording)]);
    rows(&place.path("a.arrow"))
}

/// Results of a run.
pub struct Found {
    pub report: Value,
    pub returns: String,
}

/// Reads a container, resolves it with these keys, and finds the returns.
#[track_caller]
pub fn resolve(recording: &[u8], keys: &str) -> Found {
    let place = TestFolder::with(&[("a.arrow", recording)]);
    resolve_in(&place, keys)
}

/// The same for `a.arrow` of a folder.
#[track_caller]
pub fn resolve_in(place: &TestFolder, keys: &str) -> Found {
    let report = place.succeeds("read_arrow", "a.arrow", &chain(keys));
    Found { report, returns: place.text("out/returns.csv") }
}

/// The stages after a reader.
pub fn chain(keys: &str) -> String {
    format!("[[stage]]\ntype = 'resolve_mta'\n{keys}\n{TO_RETURNS}")
}

/// Asserts that a container cannot be resolved, with this message.
#[track_caller]
pub fn refused(recording: &[u8], keys: &str, message: &str) {
    let place = TestFolder::with(&[("a.arrow", recording)]);
    let outcome = place.read("read_arrow", "a.arrow", &chain(keys));
    place.left_nothing(outcome, &format!("stage resolve_mta: ./a.arrow: {message}"));
}

/// Part of a report for one stage.
pub fn stage<'r>(report: &'r Value, name: &str) -> &'r Value {
    report["stages"].as_array().unwrap().iter().find(|stage| stage["type"] == name).unwrap()
}

/// A text table by column.
pub struct Table {
    names: Vec<String>,
    rows: Vec<Vec<String>>,
}

impl Table {
    pub fn of(text: &str) -> Table {
        let split = |line: &str| line.split(',').map(str::to_owned).collect::<Vec<_>>();
        let mut lines = text.lines().map(split);
        Table { names: lines.next().unwrap(), rows: lines.collect() }
    }

    pub fn numbers(&self, name: &str) -> Vec<f64> {
        self.texts(name).iter().map(|cell| cell.parse().unwrap_or(f64::NAN)).collect()
    }

    pub fn texts(&self, name: &str) -> Vec<&str> {
        let column = self.names.iter().position(|other| other == name).unwrap();
        self.rows.iter().map(|row| row[column].as_str()).collect()
    }
}

/// Score for the true returns of surfaces.
#[derive(Debug, Default)]
pub struct Score {
    /// True returns well above the threshold.
    pub true_returns: usize,
    /// Of these, those with a return of their shot within [`NEAR_M`].
    pub right: usize,
    /// Of these, those with a zone different from the truth.
    pub other_zones: usize,
    /// Range errors, m, ascending.
    pub errors_m: Vec<f64>,
    /// Shots of missed returns.
    pub missed_shots: Vec<u64>,
}

/// Tolerance of a match, m: zones are over 300 m apart, so chance matches are excluded.
const NEAR_M: f64 = 1.5;
/// Amplitude at which an isolated true return is found, DN.
const CLEAR_DN: f64 = 12.0;

/// Compares returns with the truth; a return assigned to another shot is missed.
pub fn score(truth: &str, returns: &str) -> Score {
    let (truth, returns) = (Table::of(truth), Table::of(returns));
    let mut by_shot: BTreeMap<u64, Vec<(f64, i64)>> = BTreeMap::new();
    let found = returns.numbers("shot").into_iter().zip(returns.numbers("range_m"));
    for ((shot, range_m), zone) in found.zip(returns.numbers("mta_zone")) {
        by_shot.entry(shot as u64).or_default().push((range_m, zone as i64));
    }
    let mut score = Score::default();
    let rows = truth.numbers("shot").into_iter().zip(truth.numbers("range_m")).zip(truth.numbers("zone"));
    let rows = rows.zip(truth.numbers("amplitude_dn")).zip(truth.texts("class"));
    for ((((shot, range_m), zone), amplitude_dn), class) in rows {
        if amplitude_dn < CLEAR_DN || class == "false_alarm" {
            continue;
        }
        score.true_returns += 1;
        let near = by_shot.get(&(shot as u64)).into_iter().flatten();
        let nearest = near.min_by(|a, b| (a.0 - range_m).abs().total_cmp(&(b.0 - range_m).abs()));
        match nearest {
            Some((found_m, found_zone)) if (found_m - range_m).abs() <= NEAR_M => {
                score.right += 1;
                score.other_zones += usize::from(*found_zone != zone as i64);
                score.errors_m.push((found_m - range_m).abs());
            }
            _ => score.missed_shots.push(shot as u64),
        }
    }
    score.errors_m.sort_by(f64::total_cmp);
    score
}

impl Score {
    /// Fraction of the true returns found at their position.
    pub fn part_right(&self) -> f64 {
        self.right as f64 / self.true_returns as f64
    }

    /// Percentile of the range errors, m.
    pub fn error_m(&self, percent: usize) -> f64 {
        self.errors_m[self.errors_m.len() * percent / 100]
    }
}

/// Path of a file as text.
pub fn text(path: &Path) -> String {
    path.display().to_string()
}

/// Runs a command to its end; also returns its peak memory, kB (0 if unknown).
pub fn peak_kb(command: &mut Command) -> (Outcome, u64) {
    let mut child = command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    let status = format!("/proc/{}/status", child.id());
    let mut peak_kb = 0;
    while child.try_wait().unwrap().is_none() {
        // The peak only grows, so the last reading counts; the end of a run takes less memory than
        // its middle.
        let text = std::fs::read_to_string(&status).unwrap_or_default();
        let peak = text.lines().find_map(|line| line.strip_prefix("VmHWM:"));
        let peak = peak.and_then(|peak| peak.trim().strip_suffix(" kB")?.parse().ok());
        peak_kb = peak.unwrap_or(peak_kb);
        std::thread::sleep(Duration::from_millis(2));
    }
    let output = child.wait_with_output().unwrap();
    let err = String::from_utf8_lossy(&output.stderr).into_owned();
    (Outcome { code: output.status.code(), out: String::new(), err }, peak_kb)
}
