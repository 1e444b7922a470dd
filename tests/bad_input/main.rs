//! Bad input: exit codes, messages and remaining files.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    clippy::zombie_processes,
    reason = "a test fails by panicking, and prints what it skips; the caller waits for what `begin` starts"
)]

mod containers;
mod las;
mod outputs;
mod pulsewaves;
mod recordings;
#[cfg(unix)]
mod runs;
mod wrong_files;
