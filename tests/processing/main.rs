//! Processing stages through the whole chain, against the truth of simulated recordings.
#![allow(
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a test fails by panicking, and prints its figures and what it skips"
)]

mod agc;
mod align;
mod align_clouds;
mod classify;
mod classify_run;
mod classify_stage;
mod false_alarms;
mod footprint_models;
mod from_returns;
mod fusion;
mod georeference;
mod keys;
mod mta;
mod online;
mod outliers;
mod scenes;
mod write_dem;
