//! A sink of your own: writes a file from scan lines.
//!
//!     cargo run --example writing_sink -- out
//!
//! The file has one row per scan line: its number and the highest return.
#![allow(clippy::print_stdout, reason = "an example prints what it finds")]

use std::io::Write;

use anyhow::{Context as _, Result};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use wavex::engine::{self, Options};
use wavex::job::Job;
use wavex::registry::STAGES;
use wavex::scan_line::{Kind, ScanLine};
use wavex::stage::{self, Config, Context, OutputFile, RunContext, Sink, SinkConfig, StageSpec};
use wavex_formats::Error;

/// Name of the stage, and kinds of the lines that it accepts.
const WRITE_HIGHEST: StageSpec =
    StageSpec::sink::<WriteHighest>("write_highest", &[Kind::Returns, Kind::Points]);

/// Writes the largest amplitude of each scan line.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct WriteHighest {
    /// File to write; `*` is replaced by the stem of the input.
    #[schemars(extend("x-file" = "output"))]
    path: String,
}

impl Config for WriteHighest {}

impl SinkConfig for WriteHighest {
    /// The engine claims these files, so that no other run writes them.
    fn outputs(&self) -> Vec<&str> {
        vec![&self.path]
    }

    fn make(&self, run: &RunContext) -> stage::Result<Box<dyn Sink>> {
        Ok(Box::new(Writer { file: run.create(&self.path)? }))
    }
}

struct Writer {
    /// Has its final name only when the run has succeeded.
    file: OutputFile,
}

impl Sink for Writer {
    fn write(&mut self, line: &ScanLine, _: &mut Context) -> stage::Result<()> {
        let amplitudes = line.returns().into_iter().flatten().map(|found| found.amplitude_dn);
        let highest_dn = amplitudes.fold(0.0, f64::max);
        let written = writeln!(self.file, "{} {highest_dn:.1}", line.line);
        Ok(written.map_err(Error::io(self.file.path(), "write"))?)
    }

    fn finish(self: Box<Self>, cx: &mut Context) -> stage::Result<()> {
        cx.publish(self.file.finish()?);
        Ok(())
    }
}

const JOB: &str = "\
[[stage]]
type = 'simulate'
lines = 3
shots_per_line = 100

[[stage]]
type = 'calibrate'

[[stage]]
type = 'decompose'

[[stage]]
type = 'write_highest'
path = 'highest.txt'
";

fn main() -> Result<()> {
    let folder = std::env::args().nth(1).context("missing argument: output folder")?;
    let stages: Vec<&'static StageSpec> = STAGES.iter().copied().chain([&WRITE_HIGHEST]).collect();
    let job = Job::parse(&stages, "the job of this example", JOB, &[])?;
    let run = engine::run(&job, &Options::of_job(&job, ".", &folder))?;
    for path in run.inputs.iter().flat_map(|input| &input.outputs) {
        println!("wrote {}", path.display());
    }
    Ok(())
}
