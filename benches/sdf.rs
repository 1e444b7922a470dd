//! Compares `read_sdf` with `read_arrow` on the same recording, into line statistics.
//!
//! `cargo build --release --example sdf_stand_in && cargo bench --bench sdf` prints shots per
//! second of `read_sdf -> write_lstat`, through the stand-in for RIEGL's library, and of
//! `read_arrow -> write_lstat`. The goal is a ratio of at least 1/3. The stand-in reads the
//! container and copies every record twice, which counts against `read_sdf`.
#![allow(clippy::print_stdout, clippy::panic, reason = "a bench prints its figures and panics on failure")]

use std::path::Path;
use wavex::registry::STAGES;

use wavex::engine::{self, Options};
use wavex::job::{Job, Override};
use wavex_testkit::sdf::stand_in;

const LINES: u32 = 200;
const SHOTS_PER_LINE: u32 = 1000;
const RUNS: usize = 7;

/// Runs a job with keys of the command line and returns its duration, s.
fn run(text: &str, set: &[Override], folder: &Path) -> f64 {
    let job = Job::parse(STAGES, "bench", text, set).unwrap_or_else(|errors| panic!("{errors}"));
    let options = Options { threads: 1, ..Options::of_job(&job, folder, folder) };
    let report = engine::run(&job, &options).unwrap_or_else(|error| panic!("{error}"));
    report.inputs[0].wall_s
}

fn median(mut times: Vec<f64>) -> f64 {
    times.sort_by(f64::total_cmp);
    times[times.len() / 2]
}

fn main() {
    let library = [Override::new(format!("read_sdf.library='{}'", stand_in().display()))];
    let folder = std::env::temp_dir().join(format!("wavex-bench-sdf-{}", std::process::id()));
    let sink = |name: &str| format!("[[stage]]\ntype = 'write_lstat'\npath = '{name}.txt'\n");
    run(
        &format!(
            "[[stage]]\ntype = 'simulate'\nlines = {LINES}\nshots_per_line = {SHOTS_PER_LINE}\n\
             [[stage]]\ntype = 'write_arrow'\npath = 'flight.arrow'\ncompression = 'none'\n"
        ),
        &[],
        &folder,
    );
    // The stand-in accepts any container, whatever its name.
    let copied = std::fs::copy(folder.join("flight.arrow"), folder.join("250506_100000.sdf"));
    copied.unwrap_or_else(|error| panic!("{error}"));
    let arrow = format!("[[stage]]\ntype = 'read_arrow'\npath = 'flight.arrow'\n{}", sink("arrow"));
    let sdf = format!("[[stage]]\ntype = 'read_sdf'\npath = '250506_100000.sdf'\n{}", sink("sdf"));
    let (mut by_arrow, mut by_sdf) = (Vec::new(), Vec::new());
    for _ in 0..RUNS {
        by_arrow.push(run(&arrow, &[], &folder));
        by_sdf.push(run(&sdf, &library, &folder));
    }
    let shots = f64::from(LINES * SHOTS_PER_LINE);
    let (by_arrow, by_sdf) = (median(by_arrow), median(by_sdf));
    println!("read_arrow -> write_lstat: {:>10.0} shots/s", shots / by_arrow);
    println!("read_sdf   -> write_lstat: {:>10.0} shots/s", shots / by_sdf);
    println!("ratio: {:.2}   goal: at least 0.33", by_arrow / by_sdf);
    // A failure to remove the temporary folder is harmless.
    let _ = std::fs::remove_dir_all(&folder);
}
