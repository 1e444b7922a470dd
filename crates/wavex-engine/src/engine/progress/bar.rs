//! The bar on the terminal, and output next to it.

use std::borrow::Cow;
use std::sync::Mutex;

use console::Term;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use wavex_line::printable::printable;
use wavex_line::system::Unpoisoned as _;

/// Largest number of characters of a label: with bar, percentage and message, a line has 80.
const LABEL_CHARS: usize = 24;

/// The bar that is drawn now.
static DRAWN: Mutex<Option<ProgressBar>> = Mutex::new(None);

/// Writes to the terminal while no bar is drawn there; the bar is drawn again afterwards.
pub fn without_bar<T>(write: impl FnOnce() -> T) -> T {
    let drawn = DRAWN.lock().unpoisoned().clone();
    match drawn {
        Some(bar) => bar.suspend(write),
        None => write(),
    }
}

/// Number of columns of standard output; `None` if it is no terminal.
pub fn terminal_columns() -> Option<usize> {
    Term::stdout().size_checked().map(|(_, columns)| usize::from(columns))
}

/// A bar with a text, the done percentage and a message, cut to the width of the terminal.
#[derive(Debug)]
pub(super) struct Bar(ProgressBar);

impl Bar {
    pub(super) fn new() -> Bar {
        let bar = ProgressBar::with_draw_target(Some(1_000_000), ProgressDrawTarget::stderr());
        let style = ProgressStyle::with_template("{prefix} [{bar:12}] {percent:>3}% {wide_msg}");
        bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()).progress_chars("=> "));
        *DRAWN.lock().unpoisoned() = Some(bar.clone());
        Bar(bar)
    }

    /// Shows a text and a fraction, 0 to 1; an unknown one leaves the bar as it is.
    pub(super) fn show(&self, text: &str, fraction: Option<f64>) {
        self.0.set_prefix(printable(text).into_owned());
        if let Some(fraction) = fraction {
            self.0.set_position((fraction * 1e6) as u64);
        }
    }

    pub(super) fn set_message(&self, message: &str) {
        self.0.set_message(message.to_owned());
    }

    #[cfg(test)]
    pub(super) fn shown(&self) -> ProgressBar {
        self.0.clone()
    }
}

impl Drop for Bar {
    fn drop(&mut self) {
        *DRAWN.lock().unpoisoned() = None;
        self.0.finish_and_clear();
    }
}

/// A label cut to [`LABEL_CHARS`] characters.
pub(super) fn shortened(label: &str) -> Cow<'_, str> {
    if label.chars().count() <= LABEL_CHARS {
        return Cow::Borrowed(label);
    }
    label.chars().take(LABEL_CHARS - 1).chain(['…']).collect::<String>().into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_labels_are_cut() {
        assert_eq!(shortened("strip07"), "strip07");
        let label = shortened("an_extraordinarily_long_name_of_a_strip");
        assert_eq!((label.chars().count(), label.ends_with('…')), (LABEL_CHARS, true));
    }

    #[test]
    fn a_bar_is_known_while_it_is_drawn() {
        let bar = Bar::new();
        assert_eq!(without_bar(|| 1), 1);
        bar.show("a processing", Some(0.5));
        bar.show("a processing", None);
        let shown = bar.shown();
        assert_eq!((shown.position(), shown.prefix().as_str()), (500_000, "a processing"));
        drop(bar);
        assert!(shown.is_finished());
        assert_eq!(without_bar(|| 2), 2);
    }
}
