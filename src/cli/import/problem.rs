//! What is wrong with a classic line, shown at its place.

use std::ops::Range;
use std::sync::Arc;

/// A text that options stand in: the line itself, or a line of a file.
#[derive(Debug, PartialEq)]
pub struct Source {
    /// The file and the line's number in it; `None` for the command line.
    pub name: Option<String>,
    /// The whole line.
    pub text: String,
}

/// A place in a source, in bytes.
#[derive(Clone, Debug, PartialEq)]
pub struct Place {
    /// Which.
    pub source: Arc<Source>,
    /// From where to where.
    pub range: Range<usize>,
}

/// One thing that is wrong with a line.
#[derive(Clone, Debug, PartialEq)]
pub struct Problem {
    /// What, in one sentence.
    pub what: String,
    /// What to do about it; empty where `what` says it.
    pub help: String,
    /// Where; `None`: the line as a whole.
    pub place: Option<Place>,
}

impl Problem {
    /// Something wrong at a place.
    pub fn at(place: &Place, what: String) -> Problem {
        Problem { what, help: String::new(), place: Some(place.clone()) }
    }

    /// Something wrong with the whole.
    pub fn of_line(what: impl Into<String>, help: impl Into<String>) -> Problem {
        Problem { what: what.into(), help: help.into(), place: None }
    }

    /// The same, with what to do about it.
    pub fn help(mut self, help: impl Into<String>) -> Problem {
        self.help = help.into();
        self
    }

    /// As it is shown behind the word `error`: the sentence, the line, a mark under the place, the remedy.
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

/// All problems as one message, whose first word `error` the caller writes.
pub fn message(problems: &[Problem]) -> String {
    let shown: Vec<String> = problems.iter().map(Problem::shown).collect();
    shown.join("\n\nerror: ")
}
