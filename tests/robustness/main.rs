//! Rules that always hold: bad input, truncation, killed runs, repetition, every stage.
#![allow(
    clippy::panic,
    clippy::print_stdout,
    clippy::unwrap_used,
    clippy::zombie_processes,
    reason = "a test fails by panicking, and prints its figures and what it skips"
)]

mod bad_input;
mod contract;
mod engine;
mod fuzz_corpora;
#[cfg(unix)]
mod hostile;
#[cfg(unix)]
mod killed;
mod repeatable;
#[cfg(unix)]
mod resumed;
mod stream;
mod survey;
mod survey_model;
mod truncation;
mod view;
