//! `read_sdf` through the stand-in for RIEGL's library (`examples/sdf_stand_in`).
//!
//! Compared with `read_arrow`, and with faults of the library or the data.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a test fails by panicking, and prints what it skips"
)]

mod faults;
mod index;
mod library;
mod same;
mod shots;
mod stand_in;
mod times;
