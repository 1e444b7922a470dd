//! The texts of a job, concatenated: job file, included files, overrides.
//!
//! A span past the end of one text belongs to a later text, so errors need not store their source.

use std::ops::Range;

use wavex_line::printable::printable;

/// A file that a job includes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Include {
    /// Name in errors.
    pub name: String,
    /// Content of the file.
    pub text: String,
}

/// A value set from outside the text: `STAGE.KEY=VALUE`.
///
/// STAGE is a stage's `id` or type, or `job`. KEY is one of its keys, dotted inside tables. VALUE
/// is TOML. A value that is not valid TOML is text, and so is any value of a key that accepts only
/// text. Quotation marks, which a shell would remove, are therefore optional.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Override {
    /// Text as given.
    pub text: String,
}

impl Override {
    /// Creates an override; errors are reported when the job is parsed.
    pub fn new(text: impl Into<String>) -> Override {
        Override { text: text.into() }
    }
}

/// The job's text, its includes, and its overrides.
#[derive(Clone, Debug)]
pub(super) struct JobSources {
    file: JobSource,
    /// Included files, then overrides.
    others: Vec<JobSource>,
    /// Number of included files.
    n_includes: usize,
}

#[derive(Clone, Debug)]
struct JobSource {
    name: String,
    text: String,
    /// Start of the text in the concatenation, bytes.
    start: usize,
}

/// Length of a line beyond which errors do not show it, bytes.
const LONGEST_LINE: usize = 10_000;

/// Position of a span as an error shows it.
#[derive(Debug, PartialEq)]
pub(super) struct TextPosition<'s> {
    /// The file, or `--set`.
    pub name: &'s str,
    /// Line number, from 1.
    pub line: usize,
    /// Column, from 1.
    pub column: usize,
    /// The line; empty if it is longer than [`LONGEST_LINE`].
    pub text: String,
    /// Byte range of the span in the line; empty at its end.
    pub marked: Range<usize>,
}

impl JobSources {
    pub(super) fn new(name: &str, text: &str, includes: &[Include], overrides: &[Override]) -> JobSources {
        let file = JobSource { name: name.to_owned(), text: text.to_owned(), start: 0 };
        let mut end = text.len();
        let follow = |(name, text): (&str, &str)| {
            // A gap of one byte separates the end of one text from the start of the next.
            let start = end + 1;
            end = start + text.len();
            JobSource { name: name.to_owned(), text: text.to_owned(), start }
        };
        let files = includes.iter().map(|file| (file.name.as_str(), file.text.as_str()));
        let changes = overrides.iter().map(|change| ("--set", change.text.as_str()));
        JobSources { file, others: files.chain(changes).map(follow).collect(), n_includes: includes.len() }
    }

    /// Name of the job in errors.
    pub(super) fn name(&self) -> &str {
        &self.file.name
    }

    /// Each included file with its start.
    pub(super) fn includes(&self) -> impl Iterator<Item = (usize, &str)> {
        self.others.iter().take(self.n_includes).map(|source| (source.start, source.text.as_str()))
    }

    /// Each override with its start.
    pub(super) fn overrides(&self) -> impl Iterator<Item = (usize, &str)> {
        self.others.iter().skip(self.n_includes).map(|source| (source.start, source.text.as_str()))
    }

    /// Position of a span.
    pub(super) fn place(&self, span: &Range<usize>) -> TextPosition<'_> {
        let source = self.others.iter().rfind(|source| source.start <= span.start).unwrap_or(&self.file);
        let text = &source.text;
        let start = text.floor_char_boundary(span.start - source.start);
        let end = text.floor_char_boundary(span.end.saturating_sub(source.start)).max(start);
        let line_start = text[..start].rfind('\n').map_or(0, |at| at + 1);
        let line_end = text[start..].find('\n').map_or(text.len(), |at| start + at);
        let is_short = line_end - line_start <= LONGEST_LINE;
        let line_end = if is_short { line_end } else { line_start };
        let line = shown(text[line_start..line_end].trim_end_matches('\r'));
        let before = shown(&text[line_start..start]);
        let column = before.chars().count() + 1;
        let before = before.len().min(line.len());
        let width = shown(text[start..end.min(line_end).max(start)].trim_end()).len();
        TextPosition {
            name: &source.name,
            line: text[..start].matches('\n').count() + 1,
            column,
            marked: before..(before + width).min(line.len()),
            text: line,
        }
    }
}

/// Makes a text safe for a terminal.
///
/// Tabs become blanks; line feeds and control characters are replaced.
pub(super) fn shown(text: &str) -> String {
    let text = printable(text).replace('\t', " ").replace('\n', "\u{fffd}");
    text.replace('\u{feff}', "")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn place(text: &str, overrides: &[&str], span: Range<usize>) -> (String, usize, String, Range<usize>) {
        let overrides: Vec<Override> = overrides.iter().map(|&text| Override::new(text)).collect();
        let sources = JobSources::new("job.toml", text, &[], &overrides);
        let TextPosition { name, line, text, marked, .. } = sources.place(&span);
        (name.to_owned(), line, text, marked)
    }

    #[test]
    fn a_span_has_a_line_and_a_range_in_it() {
        let at = place("a = 1\n\tbé = 22\r\nc", &[], 13..15);
        assert_eq!(at, ("job.toml".into(), 2, " bé = 22".into(), 7..9));
        assert_eq!(place("a = 1\n", &[], 6..6), ("job.toml".into(), 2, String::new(), 0..0));
        assert_eq!(place("", &[], 0..0), ("job.toml".into(), 1, String::new(), 0..0));
    }

    #[test]
    fn a_span_over_lines_ends_with_its_first() {
        assert_eq!(place("a = [\n1,\n2]", &[], 4..11), ("job.toml".into(), 1, "a = [".into(), 4..5));
    }

    #[test]
    fn spans_past_the_end_are_those_of_the_overrides() {
        let texts = ["x.y=1", "z.w=2"];
        assert_eq!(place("ab", &texts, 3..4), ("--set".into(), 1, "x.y=1".into(), 0..1));
        assert_eq!(place("ab", &texts, 2..2).0, "job.toml", "the end of the file belongs to the file");
        assert_eq!(place("ab", &texts, 11..14), ("--set".into(), 1, "z.w=2".into(), 2..5));
    }

    #[test]
    fn what_would_command_a_terminal_is_not_shown() {
        assert_eq!(place("a\x1b[2Jb = 1", &[], 0..1).2, "a\u{fffd}[2Jb = 1");
        assert_eq!(place("\u{feff}ab = 1", &[], 4..5), ("job.toml".into(), 1, "ab = 1".into(), 1..2));
    }
}
