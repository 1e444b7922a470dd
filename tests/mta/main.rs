//! MTA resolution: from recorded blocks to their pulses, through the whole chain.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a test fails by panicking and prints its figures"
)]

#[path = "../sdf/made.rs"]
#[allow(dead_code, reason = "each test binary uses its own part")]
mod made;
#[path = "../support/mod.rs"]
mod support;

mod circular;
mod faults;
mod flights;
mod long_lines;
mod memory;
mod priors;
mod ten_scenes;
mod zones;
