//! Output to the user: results on standard output, all else on standard error.

use std::borrow::Cow;
use std::io::{self, ErrorKind, IsTerminal, Write};
use std::path::{Path, PathBuf};

use super::Failure;
use crate::archive::plain;

/// Prints a result.
///
/// A closed pipe (`wavex stages | head`) is not an error.
pub(super) fn print(text: &str) -> Result<(), Failure> {
    let mut out = io::stdout().lock();
    match out.write_all(harmless(text).as_bytes()).and_then(|()| out.flush()) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => {
            Err(Failure::Run(format!("cannot write to standard output: {error}; check where it leads")))
        }
        _ => Ok(()),
    }
}

/// Replaces control characters, which names of files could contain, except line feeds and tabs.
///
/// A terminal would execute them. Colours, `ESC [ digits m`, stay.
pub(super) fn harmless(text: &str) -> Cow<'_, str> {
    let is_harmful = |character: char| character.is_control() && !matches!(character, '\n' | '\t');
    if !text.contains(is_harmful) {
        return Cow::Borrowed(text);
    }
    let mut safe = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(character) = rest.chars().next() {
        let length = colour_length(rest).unwrap_or(0);
        let (kept, later) = rest.split_at(length.max(character.len_utf8()));
        safe.push_str(if length == 0 && is_harmful(character) { "\u{fffd}" } else { kept });
        rest = later;
    }
    Cow::Owned(safe)
}

/// Length of the colour that a text starts with, bytes.
fn colour_length(text: &str) -> Option<usize> {
    let parameters = text.strip_prefix("\x1b[")?;
    let end = parameters.find(|character: char| !character.is_ascii_digit() && character != ';')?;
    parameters.get(end..)?.starts_with('m').then_some(2 + end + 1)
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

/// Prints an error to standard error.
pub(super) fn print_error(text: &str) {
    // If standard error cannot be written, there is no other place to report it.
    let _ = io::stderr().lock().write_all(harmless(text).as_bytes());
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

#[cfg(test)]
mod tests {
    use super::harmless;

    #[test]
    fn control_characters_are_replaced_but_not_colours() {
        assert_eq!(harmless("\x1b[1;31merror\x1b[0m: é\ta\n"), "\x1b[1;31merror\x1b[0m: é\ta\n");
        assert_eq!(
            harmless("a\x1b[2Jb\x1b]0;c\x07\r\u{9b}\x1b["),
            "a\u{fffd}[2Jb\u{fffd}]0;c\u{fffd}\u{fffd}\u{fffd}\u{fffd}["
        );
    }
}
