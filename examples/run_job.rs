//! Runs a job from Rust, like `wavex run`.
//!
//! Returns the report as a value.
//!
//!     cargo run --example run_job -- out
#![allow(clippy::print_stdout, reason = "an example prints what it finds")]

use anyhow::{Context, Result};
use wavex::engine::{self, Options};
use wavex::job::{Job, Override};
use wavex::registry::STAGES;

const JOB: &str = "\
[[stage]]
type = 'simulate'
stem = 'demo'
lines = 20
shots_per_line = 100

[[stage]]
type = 'calibrate'

[[stage]]
type = 'decompose'

[[stage]]
type = 'georeference'

[[stage]]
type = 'write_las'
";

fn main() -> Result<()> {
    let folder = std::env::args().nth(1).context("missing argument: output folder")?;
    // Like `--set` on the command line: overrides a key of a stage for this run.
    let overrides = [Override::new("simulate.lines=4")];
    let job = Job::parse(STAGES, "the job of this example", JOB, &overrides)?;
    // The two paths are the base of relative input and output paths.
    let report = engine::run(&job, &Options::of_job(&job, ".", &folder))?;
    for input in &report.inputs {
        println!("{}: {} waveforms, {} returns", input.stem, input.totals["nw"], input.totals["np"]);
        for note in input.stages.iter().flat_map(|stage| &stage.notes) {
            println!("note: {note}");
        }
        for output in &input.outputs {
            println!("wrote {}", output.display());
        }
    }
    Ok(())
}
