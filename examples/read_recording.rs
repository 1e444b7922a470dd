//! Reads a recording line by line and prints a summary.
//!
//! All formats are supported.
//!
//!     cargo run --example read_recording -- flight7.pls
#![allow(clippy::print_stdout, reason = "an example prints what it finds")]

use std::path::Path;
use wavex::registry::STAGES;

use anyhow::{Context as _, Result, anyhow, bail};
use wavex::job::Job;
use wavex::stage::{Context, Plan, RunContext};
use wavex_formats::format::reader_of;

fn main() -> Result<()> {
    let file = std::env::args()
        .nth(1)
        .context("missing argument: recording (.las, .laz, .pls, .sdf, .wfm or .arrow)")?;
    // A reader is a stage with keys, as in a job; the file extension selects it.
    let reader = reader_of(&file).map_err(|problem| anyhow!(problem))?;
    let text = format!("[[stage]]\ntype = \"{reader}\"\npath = {}\n", toml::Value::String(file.clone()));
    let job = Job::parse(STAGES, "example", &text, &[])?;
    let Plan::Source(source) = &job.stages.first().context("one stage")?.planned.plan else {
        bail!("{reader} is a reader");
    };
    let mut source = source.make(&RunContext::alone(Path::new(&file)))?;
    // The context counts rejected items.
    let mut cx = Context::default();
    let (mut lines, mut shots, mut samples) = (0, 0, 0);
    while let Some(line) = source.next(&mut cx)? {
        lines += 1;
        shots += line.emissions.len();
        let blocks = line.blocks().context("a reader delivers sample blocks")?;
        for block in blocks.iter().filter(|block| block.channel.is_echo()) {
            let shot = &line.emissions[block.emission as usize];
            let echo = blocks.samples(block);
            if samples == 0 {
                println!("{}, group velocity {} m/s", line.input.format, line.input.group_velocity_mps);
                println!("shot {} at {} s: {echo:?}", shot.shot, shot.gps_time_s);
            }
            samples += echo.len();
        }
    }
    println!("{lines} scan lines, {shots} shots, {samples} samples of echoes");
    for ((item, reason), n) in &cx.counters().rejected {
        println!("dropped {n} {}: {reason}", item.name());
    }
    Ok(())
}
