//! Detection rate, loss and speed of `filter_outliers` on eight simulated scenes.
//!
//! `cargo bench --bench outliers` prints the table of docs/explanation/outliers.md; `seed=300` selects other
//! scenes of the same kind.
#![allow(missing_docs, reason = "a bench is never imported")]
#![allow(clippy::print_stdout, clippy::expect_used, clippy::panic, reason = "a bench prints its figures")]
#![allow(dead_code, reason = "the tests use the rest of the scenes' module")]

use std::collections::HashSet;

use wavex_testkit::false_returns::{
    Flight, SCENES, Score, copy, filtered, fly, kept, score, score_of_stage, without_trajectory,
};

const GOAL_TOLD: f64 = 95.0;
const GOAL_LOST: f64 = 0.1;
/// Speed goal, million returns per second and core.
const GOAL_SPEED: f64 = 2.0;

fn main() {
    let seed = std::env::args().find_map(|arg| arg.strip_prefix("seed=")?.parse().ok()).unwrap_or(1);
    println!(
        "goals: at least {GOAL_TOLD} % of outliers found, at most {GOAL_LOST} % of true returns lost, {GOAL_SPEED} M returns/s\n\
         {:<16} {:>8} {:>7} {:>7} | {:>7} {:>7} {:>7} {:>7} {:>7} {:>8} {:>7} | {:>11} {:>7} {:>7} | {:>7} | {:>7} {:>7} {:>7}",
        "scene",
        "returns",
        "false",
        "among",
        "found",
        "true",
        "wires",
        "roofs",
        "leaves",
        "rejected",
        "M/s",
        "scanner:",
        "true",
        "wires",
        "differ",
        "plain",
        "true",
        "wires"
    );
    for scene in &SCENES {
        let flight = fly(scene, seed);
        let (lines, speed) = fastest(&flight);
        let s = score_of_stage(&flight, &lines, scene.margin_m);
        let in_scanner_frame = without_trajectory(&flight, scene, seed);
        let (in_scanner_frame, ..) = filtered(in_scanner_frame, "", usize::MAX);
        let alone = score_of_stage(&flight, &in_scanner_frame, scene.margin_m);
        let differ = kept(&lines).symmetric_difference(&kept(&in_scanner_frame)).count();
        let plain = plain_rule(&flight, scene.margin_m);
        let n: usize = flight.truth.iter().map(Vec::len).sum();
        println!(
            "{:<16} {n:>8} {:>7} {:>7} | {:>6.2}% {:>6.3}% {:>6.3}% {:>6.3}% {:>6.3}% {:>8} {speed:>7.2} | {:>10.2}% {:>6.3}% {:>6.3}% {differ:>7} | {:>6.2}% {:>6.3}% {:>6.3}%",
            scene.name,
            s.outliers[0],
            s.among[0],
            s.detected_percent(),
            s.lost_percent(None),
            s.lost_percent(Some("wire")),
            s.lost_percent(Some("roof")),
            s.lost_percent(Some("leaves")),
            s.rejected,
            alone.detected_percent(),
            alone.lost_percent(None),
            alone.lost_percent(Some("wire")),
            plain.detected_percent(),
            plain.lost_percent(None),
            plain.lost_percent(Some("wire")),
        );
    }
}

/// Returns the filtered lines and the speed.
///
/// The speed is that of the fastest of five runs, million returns per second.
fn fastest(flight: &Flight) -> (Vec<wavex::scan_line::ScanLine>, f64) {
    let n: usize = flight.truth.iter().map(Vec::len).sum();
    let mut best = f64::INFINITY;
    let mut lines = Vec::new();
    for _ in 0..5 {
        let (given_on, _, seconds) = filtered(flight.lines.iter().map(copy).collect(), "", usize::MAX);
        best = best.min(seconds);
        lines = given_on;
    }
    (lines, n as f64 / best / 1e6)
}

/// Evaluates a simple reference rule.
///
/// A point is an outlier if no other lies within 4 m among three waveforms before and after it in
/// its line and in the adjacent lines, or if it lies more than 50 m above or below both its
/// neighbours in the line.
fn plain_rule(flight: &Flight, margin_m: f64) -> Score {
    let mut out = HashSet::new();
    for (line, rows) in flight.truth.iter().enumerate() {
        let waves = |at: usize| flight.lines.get(at).and_then(|batch| batch.returns());
        let own = waves(line).expect("returns");
        for (index, row) in rows.iter().enumerate() {
            let wave = own[index].emission;
            let near = |at: usize| {
                let Some(returns) = waves(at) else { return false };
                let from = returns.partition_point(|r| r.emission + 3 < wave);
                let until = returns.partition_point(|r| r.emission <= wave + 3);
                (from..until).any(|other| {
                    let q = flight.truth[at][other].point_m;
                    let d: f64 = (0..3).map(|a| (row.point_m[a] - q[a]).powi(2)).sum();
                    (at, other) != (line, index) && d <= 16.0
                })
            };
            let lines = [Some(line), line.checked_sub(1), Some(line + 1)];
            let is_alone = !lines.into_iter().flatten().any(near);
            let step = |other: Option<usize>| Some(row.point_m[2] - rows.get(other?)?.point_m[2]);
            let (before, behind) = (step(index.checked_sub(1)), step(Some(index + 1)));
            let is_off = match (before, behind) {
                (Some(a), Some(b)) => a.abs() > 50.0 && b.abs() > 50.0 && a * b > 0.0,
                _ => false,
            };
            if is_alone || is_off {
                out.insert((line, index));
            }
        }
    }
    score(flight, margin_m, |line, index| out.contains(&(line, index)))
}
