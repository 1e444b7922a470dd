//! What reaches the user: results on standard output, everything else on standard error.

use std::io::{self, ErrorKind, IsTerminal, Write};

use tracing::level_filters::LevelFilter;

use super::Failure;
use crate::stage::StageError;

/// Prints a result. A reader that has seen enough (`wavex stages | head`) is no failure.
pub(super) fn print(text: &str) -> Result<(), Failure> {
    let mut out = io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => {
            let problem = format!("cannot write to standard output: {error}");
            Err(Failure::Run(StageError::failed(problem, "look where it leads")))
        }
        _ => Ok(()),
    }
}

/// Prints what went wrong.
pub(super) fn print_error(text: &str) {
    // Nobody is left to be told that standard error cannot be written.
    let _ = io::stderr().lock().write_all(text.as_bytes());
}

/// Whether standard error takes colours: a terminal does, unless NO_COLOR is set (no-color.org).
pub(super) fn colour() -> bool {
    let refused = std::env::var_os("NO_COLOR").is_some_and(|value| !value.is_empty());
    !refused && io::stderr().is_terminal()
}

/// The word that errors begin with.
pub(super) fn error_word(colour: bool) -> &'static str {
    if colour { "\x1b[1;31merror\x1b[0m" } else { "error" }
}

/// Begins the log on standard error: warnings, or as much as is asked for.
pub(super) fn log(verbose: u8, quiet: bool) {
    let level = match (quiet, verbose) {
        (true, _) => LevelFilter::ERROR,
        (false, 0) => LevelFilter::WARN,
        (false, 1) => LevelFilter::INFO,
        (false, _) => LevelFilter::DEBUG,
    };
    let log = tracing_subscriber::fmt().with_max_level(level).with_writer(io::stderr).with_ansi(colour());
    // A log that exists already stays: this is the process's first unless a test has made one.
    let _ = log.without_time().with_target(false).try_init();
}
