//! Recordings, stages and checks shared by the integration tests and benches of wavex.
//!
//! | module | content |
//! |---|---|
//! | [`TestFolder`] | a temporary folder, jobs and commands of the program in it, and their results |
//! | [`flight`] | a small simulated flight, and a job with every kind of output |
//! | [`fuzz`] | fuzz targets: one function per reader of untrusted bytes, and their first inputs |
//! | [`container`], [`las`], [`pulsewaves`] | recordings built byte by byte, all of the pulses of [`shots`] |
//! | [`sdf`] | recordings that the stand-in for RIEGL's library serves without loss |
//! | [`mta`] | scenes with several pulses in the air: files, runs, comparison with the truth |
//! | [`georeferenced_flight`] | simulated flights with trajectory and true points |
//! | [`false_returns`] | scenes with false returns, and scores of outlier filters |
//! | [`instrument`], [`waveform_decomposer`] | waveforms with known truth and noise bounds, and their decomposition |
//! | [`waveforms`], [`clock`] | waveforms of the benches, and their clock |
//! | [`recordings`], [`neon`] | real recordings below `WAVEX_DATA`, with reference results |
//! | [`plausibility`] | messages of plausibility checks in the report of a run |
//! | [`table`] | rows of text tables |
//! | [`cases`] | tests whose cases are text files with an input and the expected result |
//! | [`engine_stages`] | no-op stages for tests of the engine |
//! | [`job_stages`] | stages with keys of every shape, for tests of jobs |
//!
//! Helpers panic on failure, as tests do.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a test fails by panicking, and prints what it skips"
)]
#![allow(clippy::new_without_default, clippy::len_without_is_empty, reason = "only tests use it")]

pub mod cases;
pub mod clock;
pub mod compression;
pub mod container;
pub mod engine_stages;
pub mod false_returns;
pub mod flight;
mod folder;
pub mod fuzz;
pub mod georeferenced_flight;
pub mod instrument;
pub mod job_stages;
pub mod las;
pub mod mta;
pub mod neon;
pub mod plausibility;
pub mod pulsewaves;
pub mod recordings;
pub mod sdf;
pub mod shots;
pub mod table;
pub mod view;
pub mod waveform_decomposer;
pub mod waveforms;

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

pub use folder::{Outcome, TO_TABLE, TestFolder, notes, outcome, rejected};

/// Root folder of the repository.
pub fn root() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."))
}

/// File in the build folder of the running test or bench, which cargo builds before it.
pub fn built(name: &str) -> PathBuf {
    let test = std::env::current_exe().unwrap();
    let file = test.parent().and_then(Path::parent).unwrap().join(name);
    assert!(file.is_file(), "{} is missing: build it with the same profile", file.display());
    file
}

/// Path of the program `wavex`.
pub fn program() -> PathBuf {
    built(&format!("wavex{}", std::env::consts::EXE_SUFFIX))
}

/// Command that runs the program without input, at the default log level.
pub fn wavex() -> Command {
    let mut command = Command::new(program());
    command.stdin(Stdio::null()).env_remove("RUST_LOG");
    command
}

/// Prints that a test was skipped, and why.
pub fn skipped(why: &str) {
    println!("skipped: {why}");
}

/// Folder of real recordings, from `WAVEX_DATA`; prints a notice if it is not set.
pub fn data() -> Option<PathBuf> {
    let data = std::env::var_os("WAVEX_DATA").map(PathBuf::from);
    if data.is_none() {
        skipped("WAVEX_DATA not set");
    }
    data
}
