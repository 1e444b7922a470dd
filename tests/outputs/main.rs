//! Outputs of runs: points, waveforms, tables, pages and archives.
#![allow(
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a test fails by panicking, and prints its figures and what it skips"
)]

mod archive;
mod archive_of_failures;
mod cluster;
mod copc;
mod corrections;
#[cfg(unix)]
mod hostile_archives;
mod report_page;
mod survey_page;
mod text_sinks;
mod trajectory;
mod wave_packets;
