//! Errors in a classic command line, shown at their positions.

use std::ops::Range;
use std::sync::Arc;

/// Text that contains options: the command line or a line of a file.
#[derive(Debug, PartialEq)]
pub struct OptionText {
    /// File name and line number; `None` for the command line.
    pub name: Option<String>,
    /// The complete line.
    pub text: String,
}

/// Byte range in a source.
#[derive(Clone, Debug, PartialEq)]
pub struct OptionPlace {
    /// The source.
    pub source: Arc<OptionText>,
    /// The range, bytes.
    pub range: Range<usize>,
}

/// One error in a command line.
#[derive(Clone, Debug, PartialEq)]
pub struct Problem {
    /// The error in one sentence.
    pub what: String,
    /// Remedy; empty if `what` implies it.
    pub help: String,
    /// Position; `None` for the line as a whole.
    pub place: Option<OptionPlace>,
}

impl Problem {
    /// An error at a position.
    pub fn at(place: &OptionPlace, what: String) -> Problem {
        Problem { what, help: String::new(), place: Some(place.clone()) }
    }

    /// An error of the whole line.
    pub fn of_line(what: impl Into<String>, help: impl Into<String>) -> Problem {
        Problem { what: what.into(), help: help.into(), place: None }
    }

    /// Adds the remedy.
    pub fn help(mut self, help: impl Into<String>) -> Problem {
        self.help = help.into();
        self
    }

    /// Formats the error, without the leading `error`: sentence, line, marker, remedy.
    pub fn shown(&self) -> String {
        let mut lines = vec![shortened(&self.what)];
        if let Some(place) = &self.place {
            let (text, marked) = excerpt(&place.source.text, &place.range);
            lines.extend(place.source.name.iter().map(|name| format!(" --> {}", shortened(name))));
            lines.push(format!("  | {text}"));
            lines.push(format!("  | {}{}", " ".repeat(marked.start), "^".repeat(marked.len())));
        }
        if !self.help.is_empty() {
            lines.push(format!("  = help: {}", shortened(&self.help)));
        }
        lines.join("\n")
    }
}

/// A text in one line, without control characters.
pub fn plain(text: &str) -> String {
    text.replace(char::is_control, "?")
}

/// Longest sentence or remedy of an error, characters: the word that it names may be of any length.
const LONGEST: usize = 2000;

/// The start of a text.
fn shortened(text: &str) -> String {
    match text.char_indices().nth(LONGEST) {
        Some((end, _)) => format!("{} ...", text.get(..end).unwrap_or_default()),
        None => text.to_owned(),
    }
}

/// Maximum number of errors in a message.
pub const MOST_SHOWN: usize = 20;

/// Formats errors as one message, without the first `error`; at most [`MOST_SHOWN`].
pub fn message(problems: &[Problem]) -> String {
    let shown: Vec<String> = problems.iter().take(MOST_SHOWN).map(Problem::shown).collect();
    let mut message = shown.join("\n\nerror: ");
    if problems.len() > MOST_SHOWN {
        message += "\n\nfurther errors are not shown";
    }
    message
}

/// Characters of a line shown before and after a position.
const AROUND: usize = 200;

/// Part of a line around a byte range, and the range in characters of that part.
///
/// Lines are shown in full up to twice [`AROUND`] characters.
fn excerpt(text: &str, range: &Range<usize>) -> (String, Range<usize>) {
    let (start, end) = (text.floor_char_boundary(range.start), text.floor_char_boundary(range.end));
    let is_long = text.len() > 2 * AROUND;
    let first = if is_long { text.floor_char_boundary(start.saturating_sub(AROUND)) } else { 0 };
    let last = if is_long { text.floor_char_boundary(start.saturating_add(AROUND)) } else { text.len() };
    let count = |from: usize, to: usize| text.get(from..to).unwrap_or_default().chars().count();
    let before = if first > 0 { "... " } else { "" };
    let after = if last < text.len() { " ..." } else { "" };
    let marked = before.len() + count(first, start);
    let width = count(start, end.min(last)).max(1);
    (format!("{before}{}{after}", text.get(first..last).unwrap_or_default()), marked..marked + width)
}
