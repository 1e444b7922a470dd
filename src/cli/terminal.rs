//! Output to the user: results on standard output, all else on standard error.

use std::io::{self, ErrorKind, IsTerminal, Write};

use wavex_engine::engine::without_bar;
use wavex_line::printable::printable;
use wavex_run::Failure;
use wavex_run::run::{EndMessage, Ending};

/// Prints a result.
///
/// A closed pipe (`wavex stages | head`) is not an error.
pub(super) fn print(text: &str) -> Result<(), Failure> {
    print_raw(&printable(text))
}

/// The same for text that is safe to print.
fn print_raw(text: &str) -> Result<(), Failure> {
    let mut out = io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => {
            Err(Failure::Run(format!("cannot write to standard output: {error}; check where it leads")))
        }
        _ => Ok(()),
    }
}

/// Prints the messages at the end of a run, with colours if standard output takes them.
pub(super) fn print_ending(ending: &Ending) -> Result<(), Failure> {
    print_raw(&coloured(ending, takes_colour(io::stdout().is_terminal())))
}

/// Text of the messages at the end of a run.
fn coloured(ending: &Ending, colour: bool) -> String {
    let line = |message: &EndMessage| {
        let style = match message {
            EndMessage::Result(_) => "1",
            EndMessage::Warning(_) => "33",
            EndMessage::Next(_) => "36",
            EndMessage::File(_) => "2",
            EndMessage::Table(_) => "",
        };
        let text = printable(message.text());
        if colour && !style.is_empty() {
            format!("\x1b[{style}m{text}\x1b[0m\n")
        } else {
            format!("{text}\n")
        }
    };
    ending.0.iter().map(line).collect()
}

/// Prints a message to standard error.
pub(super) fn print_message(text: &str) {
    // If standard error cannot be written, there is no other place to report it.
    let _ = without_bar(|| io::stderr().lock().write_all(printable(text).as_bytes()));
}

/// Prints the reason why a command failed to standard error.
pub(super) fn print_failure(failure: &Failure) {
    let _ = without_bar(|| io::stderr().lock().write_all(message(failure, colour()).as_bytes()));
}

/// Returns whether standard error takes colours.
///
/// True for a terminal unless NO_COLOR is set (no-color.org).
pub(super) fn colour() -> bool {
    takes_colour(io::stderr().is_terminal())
}

fn takes_colour(is_terminal: bool) -> bool {
    let refused = std::env::var_os("NO_COLOR").is_some_and(|value| !value.is_empty());
    !refused && is_terminal
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_do_not_change_the_text() {
        let ending = Ending(vec![
            EndMessage::Result("a: 2 waveforms".into()),
            EndMessage::File("wrote \x1b]0;a.laz".into()),
            EndMessage::Next("look: wavex view out".into()),
        ]);
        assert_eq!(
            coloured(&ending, false),
            "a: 2 waveforms\nwrote \u{fffd}]0;a.laz\nlook: wavex view out\n"
        );
        let in_colour = coloured(&ending, true);
        assert!(in_colour.starts_with("\x1b[1ma: 2 waveforms\x1b[0m\n"), "{in_colour:?}");
        assert!(!in_colour.contains("\x1b]0;"), "escape codes of names are replaced");
    }
}
