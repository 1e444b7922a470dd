//! Output to the user: results on standard output, all else on standard error.

use std::io::{self, ErrorKind, IsTerminal, Write};
use std::path::{Path, PathBuf};

use super::Failure;
use crate::archive::plain;
use crate::printable::printable;

/// Prints a result.
///
/// A closed pipe (`wavex stages | head`) is not an error.
pub(super) fn print(text: &str) -> Result<(), Failure> {
    let mut out = io::stdout().lock();
    match out.write_all(printable(text).as_bytes()).and_then(|()| out.flush()) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => {
            Err(Failure::Run(format!("cannot write to standard output: {error}; check where it leads")))
        }
        _ => Ok(()),
    }
}

/// Shortens a path for display: `jobs/../out` becomes `out`.
///
/// Keeps the path if a symbolic link makes the short form a different place.
pub(super) fn shown(path: &Path) -> PathBuf {
    let plain = match plain(path) {
        empty if empty.as_os_str().is_empty() => PathBuf::from("."),
        plain => plain,
    };
    match (plain.canonicalize(), path.canonicalize()) {
        (Ok(short), Ok(long)) if short == long => plain,
        _ => path.to_owned(),
    }
}

/// Prints a message to standard error.
pub(super) fn print_message(text: &str) {
    // If standard error cannot be written, there is no other place to report it.
    let _ = io::stderr().lock().write_all(printable(text).as_bytes());
}

/// Prints the reason why a command failed to standard error.
pub(super) fn print_failure(failure: &Failure) {
    let _ = io::stderr().lock().write_all(failure.message(colour()).as_bytes());
}

/// Returns whether standard error takes colours.
///
/// True for a terminal unless NO_COLOR is set (no-color.org).
pub(super) fn colour() -> bool {
    let refused = std::env::var_os("NO_COLOR").is_some_and(|value| !value.is_empty());
    !refused && io::stderr().is_terminal()
}

/// Prefix of error messages.
pub(super) fn error_word(colour: bool) -> &'static str {
    if colour { "\x1b[1;31merror\x1b[0m" } else { "error" }
}

/// Formats a number of bytes.
pub(super) fn size(bytes: u64) -> String {
    let units = [(1e12, "TB"), (1e9, "GB"), (1e6, "MB")];
    let (unit, name) = units.into_iter().find(|(unit, _)| bytes as f64 >= *unit).unwrap_or((1e3, "kB"));
    format!("{:.1} {name}", bytes as f64 / unit)
}
