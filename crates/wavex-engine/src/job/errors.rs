//! Errors in a job, shown at their positions in the text.

use std::fmt;
use std::ops::Range;

use annotate_snippets::{AnnotationKind, Level, Origin, Renderer, Snippet};

use super::sources::{JobSources, TextPosition, shown};
use wavex_line::stage::nearest_of;

/// Maximum number of errors that are reported.
pub(super) const MAX_ERRORS: usize = 100;

/// Remedy for backslashes in text.
pub(super) const BACKSLASHES: &str =
    "a backslash begins an escape; write paths with `/`, or in single quotes: 'C:\\data\\flight.las'";

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

/// All errors in a job in the order of the text, at most 100.
///
/// Displays for each error its file, line and column, the line itself, a caret below the position,
/// and remedies.
#[derive(Clone, Debug)]
pub struct JobErrors {
    errors: Vec<JobError>,
    /// Whether there are more than the reported ones.
    has_more: bool,
    sources: JobSources,
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

    /// Suggests a key like [`JobError::meant`], or the shortest one with `name` as one of its words.
    pub(super) fn meant_key(self, name: &str, keys: &[&str]) -> JobError {
        let has_word = |key: &&&str| key.split('_').any(|word| word == name);
        let with_word = || keys.iter().filter(has_word).min_by_key(|key| key.len()).copied();
        match nearest_of(name, keys.iter().copied()).or_else(with_word) {
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

/// Width beyond which a line of the job is cut, columns.
const WIDEST: usize = 1000;

impl JobErrors {
    pub(super) fn new(mut errors: Vec<JobError>, sources: JobSources) -> JobErrors {
        errors.sort_by_key(|error| error.span.clone().map_or((0, 0), |span| (span.start, span.end)));
        // An error in an included file is reported once for each stage of the type.
        errors.dedup();
        let has_more = errors.len() > MAX_ERRORS;
        errors.truncate(MAX_ERRORS);
        JobErrors { errors, has_more, sources }
    }

    /// Returns the errors in the order of the text.
    pub fn errors(&self) -> &[JobError] {
        &self.errors
    }

    /// Position of an error: file or `--set`, line and column from 1; `None` if it has none.
    pub fn position(&self, error: &JobError) -> Option<(&str, usize, usize)> {
        let place = self.sources.place(error.span.as_ref()?);
        Some((place.name, place.line, place.column))
    }

    /// Name of the job.
    pub fn job_name(&self) -> &str {
        self.sources.name()
    }

    /// Renders all errors, in terminal colours if requested; ends with a line feed.
    pub fn render(&self, colour: bool) -> String {
        let renderer = if colour { Renderer::styled() } else { Renderer::plain() }.term_width(WIDEST);
        let each = self.errors.iter().map(|error| self.show(error, &renderer) + "\n");
        let more =
            self.has_more.then(|| format!("more than {MAX_ERRORS} errors: the others are not shown\n"));
        each.chain(more).collect::<Vec<String>>().join("\n")
    }

    fn show(&self, error: &JobError, renderer: &Renderer) -> String {
        let title = Level::ERROR.primary_title(shown(&error.problem));
        let group = match &error.span {
            None => title.element(Origin::path(shown(self.sources.name()))),
            Some(span) => {
                let TextPosition { name, line, column, text, marked } = self.sources.place(span);
                let is_shown = !text.is_empty() || column == 1;
                let snippet = Snippet::source(text).line_start(line).path(shown(name));
                if is_shown {
                    title.element(snippet.annotation(AnnotationKind::Primary.span(marked)))
                } else {
                    title.element(Origin::path(shown(name)).line(line).char_column(column))
                }
            }
        };
        let help = error.help.iter().map(|help| Level::HELP.message(shown(help)));
        renderer.render(&[group.elements(help)])
    }
}

impl fmt::Display for JobErrors {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.render(false))
    }
}

impl std::error::Error for JobErrors {}
