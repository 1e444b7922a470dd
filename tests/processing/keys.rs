//! Effects of the keys of readers, `calibrate` and `decompose` on the results.

mod corrections;
mod crosstalk;
mod effects;
mod models;
mod modes;

use wavex_formats::container::EmissionReference;
use wavex_testkit::container::{Shot, of_shots};
use wavex_testkit::table::{self, Row};
use wavex_testkit::{Outcome, TestFolder, shots};

const SHOTS: usize = 320;
/// Channel codes of the container.
const LOW: u8 = 1;
const REFERENCE: u8 = 3;
/// Interval between shots.
const INTERVAL_NS: f64 = 5000.0;

fn flags_of(row: &Row) -> u16 {
    row["flags"].parse().unwrap()
}

/// Reads a container with these keys: table of returns, and report of the input.
fn run(place: &TestFolder, reader: &str, calibrate: &str, decompose: &str) -> (Vec<Row>, serde_json::Value) {
    let job = format!(
        "[[stage]]\ntype = 'read_arrow'\npath = 'a.arrow'\n{reader}\n[[stage]]\ntype = 'calibrate'\n{calibrate}\n\
         [[stage]]\ntype = 'decompose'\n{decompose}\n[[stage]]\ntype = 'write_table'\npath = '*.csv'\n"
    );
    assert_eq!(place.run(&job), Outcome::success());
    let rows = table::rows(&place.text("out/a.csv"));
    let report: serde_json::Value = serde_json::from_str(&place.text("out/job_report.json")).unwrap();
    (rows, report["inputs"][0]["totals"].clone())
}

/// A waveform of pulses (peak sample, amplitude) with its own noise.
fn samples(shot: usize, pulses: &[(f64, f64)]) -> Vec<u16> {
    samples_at(shot, pulses, |k| k as f64)
}

/// The same waveform with sample `k` taken at another time.
fn samples_at(shot: usize, pulses: &[(f64, f64)], taken_at: impl Fn(usize) -> f64) -> Vec<u16> {
    let noise = shots::waveform(shot, 1e6, 0.0);
    let signal = |k: usize| {
        let of = |&(peak, height): &(f64, f64)| {
            let x = (taken_at(k) - peak) / (4.5 / 2.354_82);
            height * f64::exp(-0.5 * x * x)
        };
        pulses.iter().map(of).sum::<f64>()
    };
    noise
        .iter()
        .enumerate()
        .map(|(k, &n)| (f64::from(n) + signal(k)).round().clamp(0.0, 255.0) as u16)
        .collect()
}

/// Shots with an outgoing pulse at their clock and one echo 1024 ns later; `change` modifies some.
fn recording(change: impl Fn(usize, &mut Shot)) -> TestFolder {
    let shot = |number: usize| {
        let place = 0.1 * (number % 7) as f64;
        let mut shot = Shot {
            clock_ps: (number as f64 * INTERVAL_NS * 1000.0) as i64,
            blocks: vec![
                (REFERENCE, -20.0, samples(1000 + number, &[(20.0, 150.0)])),
                (LOW, 1000.0, samples(number, &[(24.0 + place, 120.0)])),
            ],
        };
        change(number, &mut shot);
        shot
    };
    let all: Vec<Shot> = (0..SHOTS).map(shot).collect();
    TestFolder::with(&[("a.arrow", &of_shots(&all, EmissionReference::OutgoingPulse, true))])
}

fn of_shot(rows: &[Row], shot: usize) -> Vec<&Row> {
    let shot = (100 + shot).to_string();
    rows.iter().filter(|row| row["shot"] == shot).collect()
}
