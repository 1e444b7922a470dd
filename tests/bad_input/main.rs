//! The program on bad input: its exit code, its message, and what it leaves.
#![allow(missing_docs, clippy::unwrap_used, clippy::panic)]

#[path = "../support/mod.rs"]
mod support;

mod containers;
mod las;
mod outputs;
mod pulsewaves;
mod recordings;
#[cfg(unix)]
mod runs;
mod wrong_files;
