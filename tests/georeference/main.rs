//! Georeferencing of recordings in the scanner's frame with a trajectory.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a test fails by panicking and prints its figures"
)]

mod chain;
mod coordinates;
mod elsewhere;
mod flights;
mod times;
mod uncertainty;
