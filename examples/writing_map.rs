//! A map of your own: changes scan lines, one at a time, in parallel.
//!
//!     cargo run --example writing_map -- out
#![allow(clippy::print_stdout, reason = "an example prints what it finds")]

use anyhow::{Context as _, Result};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use wavex::engine::{self, Options};
use wavex::job::Job;
use wavex::registry::STAGES;
use wavex::scan_line::{Content, Kind, ScanLine};
use wavex::stage::{self, Config, Context, Item, Map, MapConfig, Reason, RunContext, StageSpec};

/// Name, role and accepted kinds of line of the stage.
///
/// The output has the same kind.
const DROP_WEAK: StageSpec = StageSpec::map::<DropWeak>("drop_weak", &[Kind::Returns], None);

/// Drops weak returns.
///
/// This comment is the stage's page in `wavex stages`.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
struct DropWeak {
    /// Smallest amplitude to keep, digitiser steps.
    least_amplitude_dn: f64,
}

impl Default for DropWeak {
    fn default() -> DropWeak {
        DropWeak { least_amplitude_dn: 20.0 }
    }
}

impl Config for DropWeak {}

impl MapConfig for DropWeak {
    fn make(&self, _: &RunContext) -> stage::Result<Box<dyn Map>> {
        Ok(Box::new(self.clone()))
    }
}

impl Map for DropWeak {
    /// Filters one line.
    ///
    /// The engine runs lines in parallel, so a map must keep no state between them.
    fn map(&mut self, mut line: ScanLine, cx: &mut Context) -> stage::Result<ScanLine> {
        if let Content::Returns(returns) = &mut line.content {
            let before = returns.len();
            returns.retain(|found| found.amplitude_dn >= self.least_amplitude_dn);
            // Rejected items are counted with a reason: the engine compares input and output of
            // each stage.
            cx.reject(Reason::Custom(Item::Returns, "too weak"), (before - returns.len()) as u64);
        }
        Ok(line)
    }
}

const JOB: &str = "\
[[stage]]
type = 'simulate'
lines = 4
shots_per_line = 100

[[stage]]
type = 'calibrate'

[[stage]]
type = 'decompose'

[[stage]]
type = 'drop_weak'
least_amplitude_dn = 30.0

[[stage]]
type = 'write_table'
path = '*.csv'
";

fn main() -> Result<()> {
    let folder = std::env::args().nth(1).context("missing argument: output folder")?;
    let stages: Vec<&'static StageSpec> = STAGES.iter().copied().chain([&DROP_WEAK]).collect();
    let job = Job::parse_with(&stages, "the job of this example", JOB, &[], &[])?;
    let report = engine::run(&job, &Options::of_job(&job, ".", &folder))?;
    for stage in report.inputs.iter().flat_map(|input| &input.stages) {
        println!("{}: {} returns out, dropped {:?}", stage.id, stage.items_out.returns, stage.rejected);
    }
    Ok(())
}
