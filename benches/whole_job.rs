//! A whole job, from simulated waveforms to LAZ and tables: where its time goes.
//!
//! `cargo bench --bench whole_job` prints the table that a run ends with; the stage that it marks is the bottleneck.
#![allow(clippy::print_stdout, clippy::panic, reason = "a bench prints its figures, and ends where it fails")]

use wavex::engine::{self, Options};
use wavex::job::{Job, Override};

fn main() {
    let text = include_str!("../jobs/demo.toml");
    let set = ["simulate.lines=10"].map(Override::new);
    let job = Job::parse("jobs/demo.toml", text, &set).unwrap_or_else(|errors| panic!("{errors}"));
    let folder = std::env::temp_dir().join(format!("wavex-bench-{}", std::process::id()));
    for threads in [1, 2] {
        let options = Options { threads, ..Options::of_job(&job, &folder, &folder) };
        let report = engine::run(&job, &options).unwrap_or_else(|error| panic!("{error}"));
        let input = &report.inputs[0];
        println!("{threads} threads, {} waveforms, {:.2} s", input.totals["nw"], input.wall_s);
        println!("{}{}", input.table(), input.latency_table());
    }
    // What a bench leaves in the folder of temporary files is nobody's loss if it cannot be removed.
    let _ = std::fs::remove_dir_all(&folder);
}
