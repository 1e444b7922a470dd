//! Output to the user: results on standard output, all else on standard error.

use std::io::{self, ErrorKind, IsTerminal, Write};

use wavex_line::printable::printable;
use wavex_run::Failure;

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

/// Prints a message to standard error.
pub(super) fn print_message(text: &str) {
    // If standard error cannot be written, there is no other place to report it.
    let _ = io::stderr().lock().write_all(printable(text).as_bytes());
}

/// Prints the reason why a command failed to standard error.
pub(super) fn print_failure(failure: &Failure) {
    let _ = io::stderr().lock().write_all(message(failure, colour()).as_bytes());
}

/// Returns whether standard error takes colours.
///
/// True for a terminal unless NO_COLOR is set (no-color.org).
pub(super) fn colour() -> bool {
    let refused = std::env::var_os("NO_COLOR").is_some_and(|value| !value.is_empty());
    !refused && io::stderr().is_terminal()
}

/// Prefix of error messages.
fn error_word(colour: bool) -> &'static str {
    if colour { "\x1b[1;31merror\x1b[0m" } else { "error" }
}

/// Formats a number of bytes.
pub(super) fn size(bytes: u64) -> String {
    let units = [(1e12, "TB"), (1e9, "GB"), (1e6, "MB")];
    let (unit, name) = units.into_iter().find(|(unit, _)| bytes as f64 >= *unit).unwrap_or((1e3, "kB"));
    format!("{:.1} {name}", bytes as f64 / unit)
}

/// Exit code of a failed command.
pub(super) fn exit_code(failure: &Failure) -> u8 {
    match failure {
        Failure::Run(_) => 1,
        Failure::Job(_) | Failure::Wrong(_) => 2,
    }
}

/// Error message for the user, safe to print; ends with a line feed.
pub(super) fn message(failure: &Failure, colour: bool) -> String {
    match failure {
        Failure::Job(errors) => errors.render(colour),
        Failure::Wrong(problem) | Failure::Run(problem) => {
            format!("{}: {}\n", error_word(colour), printable(problem))
        }
    }
}
