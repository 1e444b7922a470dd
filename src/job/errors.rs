//! Errors in a job, shown at their positions in the text.

use std::fmt;
use std::ops::Range;

use super::sources::{Place, Sources, shown};
use crate::registry::nearest_of;

/// One error in a job.
#[derive(Clone, Debug, PartialEq)]
pub struct JobError {
    /// The problem in one sentence.
    pub problem: String,
    /// Remedies, one per line.
    pub help: Vec<String>,
    /// Byte range in the job's text, or past its end in the included files and overrides.
    pub(super) span: Option<Range<usize>>,
}

/// All errors in a job, in the order of the text.
///
/// Displays for each error its file, line and column, the line itself, a caret below the position,
/// and remedies.
#[derive(Clone, Debug)]
pub struct JobErrors {
    errors: Vec<JobError>,
    sources: Sources,
}

impl JobError {
    /// An error at a position in the text.
    pub(super) fn at(span: Range<usize>, problem: impl Into<String>) -> JobError {
        JobError { problem: problem.into(), help: Vec::new(), span: Some(span) }
    }

    /// An error of the job as a whole.
    pub(super) fn of_job(problem: impl Into<String>) -> JobError {
        JobError { problem: problem.into(), help: Vec::new(), span: None }
    }

    /// Adds the most similar of `names` as a suggestion, if any is close to `name`.
    pub(super) fn meant<'n>(self, name: &str, names: impl IntoIterator<Item = &'n str>) -> JobError {
        match nearest_of(name, names) {
            Some(meant) => self.help(format!("did you mean `{meant}`?")),
            None => self,
        }
    }

    /// Adds a remedy.
    pub(super) fn help(mut self, help: impl Into<String>) -> JobError {
        self.help.push(help.into());
        self
    }
}

impl JobErrors {
    pub(super) fn new(mut errors: Vec<JobError>, sources: Sources) -> JobErrors {
        errors.sort_by_key(|error| error.span.clone().map_or((0, 0), |span| (span.start, span.end)));
        // An error in an included file is reported once for each stage of the type.
        errors.dedup();
        JobErrors { errors, sources }
    }

    /// Returns the errors in the order of the text.
    pub fn errors(&self) -> &[JobError] {
        &self.errors
    }

    /// Renders all errors, in terminal colours if requested; ends with a line feed.
    pub fn render(&self, colour: bool) -> String {
        let paint = Paint { colour };
        let each: Vec<String> = self.errors.iter().map(|error| self.show(error, &paint)).collect();
        each.join("\n")
    }

    fn show(&self, error: &JobError, paint: &Paint) -> String {
        let heading = format!("{}: {}\n", paint.red("error"), paint.bold(&shown(&error.problem)));
        let (bar, arrow) = (paint.blue("|"), paint.blue("-->"));
        let Some(span) = &error.span else {
            return format!("{heading} {arrow} {}\n{}", shown(self.sources.name()), help(error, "", paint));
        };
        let Place { name, line, column, text, before, width } = self.sources.place(span);
        let (number, margin) = (line.to_string(), " ".repeat(line.to_string().len()));
        let (indent, carets) = (" ".repeat(before), paint.red(&"^".repeat(width)));
        let mut lines = format!("{heading}{margin}{arrow} {}:{line}:{column}\n{margin} {bar}\n", shown(name));
        lines += format!("{} {bar} {text}", paint.blue(&number)).trim_end();
        lines += &format!("\n{margin} {bar} {indent}{carets}\n");
        if !error.help.is_empty() {
            lines += &format!("{margin} {bar}\n{}", help(error, &margin, paint));
        }
        lines
    }
}

/// Formats the remedies of an error, one per line.
fn help(error: &JobError, margin: &str, paint: &Paint) -> String {
    let line = |help: &String| format!("{margin} {} help: {}\n", paint.blue("="), shown(help));
    error.help.iter().map(line).collect()
}

impl fmt::Display for JobErrors {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.render(false))
    }
}

impl std::error::Error for JobErrors {}

/// Text styles for a terminal, or plain text.
struct Paint {
    colour: bool,
}

impl Paint {
    fn red(&self, words: &str) -> String {
        self.with("1;31", words)
    }

    fn blue(&self, words: &str) -> String {
        self.with("1;34", words)
    }

    fn bold(&self, words: &str) -> String {
        self.with("1", words)
    }

    fn with(&self, code: &str, words: &str) -> String {
        if self.colour { format!("\x1b[{code}m{words}\x1b[0m") } else { words.to_owned() }
    }
}
