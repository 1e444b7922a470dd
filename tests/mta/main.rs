//! MTA resolution: from recorded blocks to their pulses, through the whole chain.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a test fails by panicking and prints its figures"
)]

mod circular;
mod faults;
mod flights;
mod long_lines;
mod memory;
mod priors;
mod ten_scenes;
mod zones;
