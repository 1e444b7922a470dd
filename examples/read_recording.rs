//! Reads a recording line by line and prints a summary.
//!
//! All formats are supported.
//!
//!     cargo run --example read_recording -- flight7.pls
#![allow(clippy::print_stdout, reason = "an example prints what it finds")]

use anyhow::{Context as _, Result};

fn main() -> Result<()> {
    let file = std::env::args()
        .nth(1)
        .context("missing argument: recording (.las, .laz, .pls, .plz, .sdf, .wfm or .arrow)")?;
    let recording = wavex::open(file.as_ref())?;
    println!("{}, group velocity {} m/s", recording.input().format, recording.input().group_velocity_mps);
    let (mut n_lines, mut n_shots, mut n_samples) = (0, 0, 0);
    let mut lines = recording.scan_lines()?;
    for line in lines.by_ref() {
        let line = line?;
        n_lines += 1;
        n_shots += line.emissions.len();
        let blocks = line.blocks().context("a reader delivers sample blocks")?;
        for block in blocks.iter().filter(|block| block.channel.is_echo()) {
            let shot = &line.emissions[block.emission as usize];
            let echo = blocks.samples(block);
            if n_samples == 0 {
                println!("shot {} at {} s: {echo:?}", shot.shot, shot.gps_time_s);
            }
            n_samples += echo.len();
        }
    }
    println!("{n_lines} scan lines, {n_shots} shots, {n_samples} samples of echoes");
    for ((item, reason), n) in &lines.context().counters().rejected {
        println!("dropped {n} {}: {reason}", item.name());
    }
    Ok(())
}
