//! Georeferencing speed on one core.
//!
//! Points per second, and poses of shots per second. `cargo bench --bench georeference` prints
//! rates, and their ratio to the goal of 2 million points per second.
#![allow(clippy::print_stdout, clippy::panic, reason = "a bench prints its figures and panics on failure")]

use std::sync::Arc;
use std::time::Instant;

use wavex::scan_line::{Blocks, Content, Return, ScanLine};
use wavex::stage::pose_source::PoseSource;
use wavex::stage::{Context, RunContext, Source};
use wavex_testkit::georeferenced_flight::{Flight, fly, georeference, return_of, run_context, source};

const GOAL_PER_S: f64 = 2e6;
const RUNS: usize = 9;

/// Shots of a line, with two returns each.
struct Line {
    batch: ScanLine,
    returns: Vec<Return>,
}

fn lines(run: &RunContext) -> Vec<Line> {
    let mut posed = PoseSource::new(source(run), Arc::clone(&run.geometry));
    let mut cx = Context::default();
    let mut lines = Vec::new();
    while let Some(batch) = posed.next(&mut cx).unwrap_or_else(|error| panic!("{error}")) {
        let two = |emission: u32| {
            [return_of(emission, [1, 2], 640.0), return_of(emission, [2, 2], 650.0)]
                .map(|r| Return { range_sd_m: 0.005, ..r })
        };
        let returns = (0..batch.emissions.len() as u32).flat_map(two).collect();
        lines.push(Line { batch, returns });
    }
    lines
}

/// Returns the median rate of the stage, points per second.
fn points_per_s(run: &RunContext) -> f64 {
    let lines = lines(run);
    let mut stage = georeference(run, "");
    let mut rates: Vec<f64> = (0..RUNS)
        .map(|_| {
            let fresh: Vec<ScanLine> = lines.iter().map(fresh).collect();
            let (started, mut points) = (Instant::now(), 0);
            for batch in fresh {
                let placed =
                    stage.map(batch, &mut Context::default()).unwrap_or_else(|error| panic!("{error}"));
                points += placed.n_returns();
            }
            points as f64 / started.elapsed().as_secs_f64()
        })
        .collect();
    rates.sort_by(f64::total_cmp);
    rates[RUNS / 2]
}

fn fresh(line: &Line) -> ScanLine {
    let Line { batch, returns } = line;
    let mut fresh =
        ScanLine::of_shots(Arc::clone(&batch.input), batch.line, batch.emissions.clone(), Blocks::default());
    fresh.content = Content::Returns(returns.clone());
    fresh
}

/// Source of lines that were read before.
struct Read(std::vec::IntoIter<ScanLine>);

impl Source for Read {
    fn next(&mut self, _cx: &mut Context) -> wavex::stage::Result<Option<ScanLine>> {
        Ok(self.0.next())
    }
}

/// Returns the median rate of attaching poses, shots per second.
fn shots_per_s(flight: &Flight) -> f64 {
    let lines = lines(&run_context(flight, "").unwrap_or_else(|error| panic!("{error}")));
    let shots: usize = lines.iter().map(|line| line.batch.emissions.len()).sum();
    let mut rates: Vec<f64> = (0..RUNS)
        .map(|_| {
            let run = run_context(flight, "trajectory = 'a.out'").unwrap_or_else(|error| panic!("{error}"));
            let fresh: Vec<ScanLine> = lines.iter().map(fresh).collect();
            let mut posed = PoseSource::new(Box::new(Read(fresh.into_iter())), Arc::clone(&run.geometry));
            let (started, mut cx) = (Instant::now(), Context::default());
            while posed.next(&mut cx).unwrap_or_else(|error| panic!("{error}")).is_some() {}
            shots as f64 / started.elapsed().as_secs_f64()
        })
        .collect();
    rates.sort_by(f64::total_cmp);
    rates[RUNS / 2]
}

fn main() {
    let keys = "lines = 200\nshots_per_line = 1000\nroll_deg = 5.0\npitch_deg = 3.0\nheading_deg = 40.0\n\
                lever_arm_m = [0.8, -0.35, 1.1]\nboresight_deg = [0.4, -0.7, 1.3]\n";
    let flight = fly(keys);
    wavex_testkit::georeferenced_flight::write_geoid(&flight.path("plane.gtx"), [46.0, 11.0], |_, _| 46.5);
    wavex_testkit::georeferenced_flight::write_accuracy(&flight, [0.02; 3], [0.003; 3]);
    println!("{:<44} {:>14} {:>8}   goal: 1", "one core", "million per s", "ratio");
    for (what, geometry) in [
        ("points, UTM", ""),
        ("points, UTM with a geoid", "geoid = 'plane'"),
        (
            "points, UTM with a geoid, and uncertainties",
            "geoid = 'plane'\ntrajectory_accuracy = 'smrmsg_a.out'",
        ),
        ("points, conic (EPSG:3416)", "crs = 'EPSG:3416'"),
        ("points, geodetic", "crs = 'geodetic'"),
    ] {
        let keys = format!("trajectory = 'a.out'\n{geometry}");
        let run = run_context(&flight, &keys).unwrap_or_else(|error| panic!("{error}"));
        let rate = points_per_s(&run);
        println!("{what:<44} {:>14.2} {:>8.2}", 1e-6 * rate, rate / GOAL_PER_S);
    }
    let rate = shots_per_s(&flight);
    println!("{:<44} {:>14.2} {:>8.2}", "shots, their poses", 1e-6 * rate, rate / GOAL_PER_S);
}
