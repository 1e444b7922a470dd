//! Bad input: exit codes, messages and remaining files.

mod containers;
mod las;
mod outputs;
mod pulsewaves;
mod recordings;
#[cfg(unix)]
mod runs;
mod wrong_files;
