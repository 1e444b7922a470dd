//! Overhead of the engine.
//!
//! Time per scan line and stage in chains of no-op stages. `cargo bench --bench engine` prints a
//! table; the goal is below 5 microseconds.
#![allow(clippy::print_stdout, reason = "a bench prints its figures")]

use std::time::Instant;

use wavex::engine::{self, Options};
use wavex::stage::StageSpec;
use wavex_testkit::engine_stages::{COUNT, WORK, WRITE_NUMBERS, into, job};

const LINES: usize = 100_000;

/// Returns the median of five runs, microseconds per line and stage.
fn cost_us(maps: usize, threads: usize) -> f64 {
    let folder = std::env::temp_dir();
    let count = format!("lines = {LINES}\nshots = 1");
    let mut stages: Vec<(&'static StageSpec, &str)> = vec![(&COUNT, &count)];
    stages.extend((0..maps).map(|_| (&WORK, "")));
    let job = job(&stages);
    let options = Options { threads, ..into(&job, &folder) };
    let mut costs: Vec<f64> = (0..5)
        .map(|_| {
            let started = Instant::now();
            let done = engine::run(&job, &options).map(|report| report.inputs[0].totals["nw"]);
            assert!(done.is_ok_and(|lines| lines == LINES as u64), "every line arrives");
            started.elapsed().as_secs_f64() * 1e6 / (LINES * stages.len()) as f64
        })
        .collect();
    costs.sort_by(f64::total_cmp);
    costs[2]
}

fn main() {
    let _ = &WRITE_NUMBERS;
    println!("{:>6} {:>8} {:>24}   goal: below 5", "stages", "workers", "us per line and stage");
    for (maps, threads) in [(1, 1), (4, 1), (8, 1), (4, 2), (4, 4)] {
        println!("{:>6} {threads:>8} {:>24.2}", maps + 1, cost_us(maps, threads));
    }
}
