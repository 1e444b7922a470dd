//! Errors in a classic command line, shown at their positions.

use std::ops::Range;
use std::sync::Arc;

/// Text that contains options: the command line or a line of a file.
#[derive(Debug, PartialEq)]
pub struct Source {
    /// File name and line number; `None` for the command line.
    pub name: Option<String>,
    /// The complete line.
    pub text: String,
}

/// Byte range in a source.
#[derive(Clone, Debug, PartialEq)]
pub struct Place {
    /// The source.
    pub source: Arc<Source>,
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
    pub place: Option<Place>,
}

impl Problem {
    /// An error at a position.
    pub fn at(place: &Place, what: String) -> Problem {
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
        let mut lines = vec![self.what.clone()];
        if let Some(place) = &self.place {
            let before = place.source.text.get(..place.range.start).unwrap_or_default().chars().count();
            let word = place.source.text.get(place.range.clone()).unwrap_or_default();
            let marks = "^".repeat(word.chars().count().max(1));
            lines.extend(place.source.name.iter().map(|name| format!(" --> {name}")));
            lines.push(format!("  | {}", place.source.text));
            lines.push(format!("  | {}{marks}", " ".repeat(before)));
        }
        if !self.help.is_empty() {
            lines.push(format!("  = help: {}", self.help));
        }
        lines.join("\n")
    }
}

/// Formats all errors as one message, without the first `error`.
pub fn message(problems: &[Problem]) -> String {
    let shown: Vec<String> = problems.iter().map(Problem::shown).collect();
    shown.join("\n\nerror: ")
}
