//! What reaches the user: results on standard output, everything else on standard error.

use std::io::{self, ErrorKind, IsTerminal, Write};
use std::path::{Path, PathBuf};

use super::Failure;
use crate::archive::plain;

/// Prints a result. A reader that has seen enough (`wavex stages | head`) is no failure.
pub(super) fn print(text: &str) -> Result<(), Failure> {
    let mut out = io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => {
            Err(Failure::Run(format!("cannot write to standard output: {error}; look where it leads")))
        }
        _ => Ok(()),
    }
}

/// A path as users read it: `jobs/../out` is `out`, where both are the same place (a symbolic link may lead elsewhere).
pub(super) fn shown(path: &Path) -> PathBuf {
    let plain = plain(path);
    match (plain.canonicalize(), path.canonicalize()) {
        (Ok(short), Ok(long)) if short == long => plain,
        _ => path.to_owned(),
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
