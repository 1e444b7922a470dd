//! Builder of the pages: document, parts with verdicts, contents, figures and tables.

use maud::{DOCTYPE, Markup, PreEscaped, html};

use crate::verdict::{Grade, QualityCheck, Verdict};
use style::{RUN_STYLE, STYLE};
use wavex_line::printable::printable;

mod style;

/// Content security policy: only styles and pictures embedded in the page.
const POLICY: &str = "default-src 'none'; style-src 'unsafe-inline'; img-src data:";

/// A part of a page, which the contents list.
pub(crate) struct PagePart {
    pub(crate) title: String,
    /// Checks of the part; `None` if there is nothing to judge.
    pub(crate) verdict: Option<Verdict>,
    pub(crate) body: Markup,
}

impl PagePart {
    /// A part without verdict.
    pub(crate) fn new(title: &str, body: Markup) -> PagePart {
        PagePart { title: title.to_owned(), verdict: None, body }
    }

    /// Adds the verdict of some checks.
    pub(crate) fn judged(self, checks: Vec<QualityCheck>) -> PagePart {
        PagePart { verdict: Some(Verdict(checks)), ..self }
    }

    fn id(&self, prefix: &str) -> String {
        let letters =
            self.title.chars().map(|c| if c.is_ascii_alphanumeric() { c.to_ascii_lowercase() } else { '-' });
        format!("{prefix}{}", letters.collect::<String>())
    }
}

/// Worst grade of some parts.
pub(crate) fn worst(parts: &[PagePart]) -> Grade {
    let grades = parts.iter().filter_map(|part| Some(part.verdict.as_ref()?.grade()));
    grades.max().unwrap_or(Grade::NotAssessed)
}

/// Contents, then `first`, then the parts; empty parts are omitted. Their names begin with `prefix`.
pub(crate) fn with_contents(parts: &[PagePart], prefix: &str, first: &Markup) -> Markup {
    let shown: Vec<&PagePart> = parts.iter().filter(|part| !part.body.0.is_empty()).collect();
    html! {
        nav aria-label="Contents" {
            ol {
                @for part in &shown {
                    li { a href={ "#" (part.id(prefix)) } { (part.title) } @if let Some(verdict) = &part.verdict { " " (badge(verdict.grade())) } }
                }
            }
        }
        (first)
        @for part in &shown {
            div.part id=(part.id(prefix)) {
                h2.group { (part.title) @if let Some(verdict) = &part.verdict { " " (badge(verdict.grade())) } }
                @if let Some(verdict) = &part.verdict { (checks(verdict)) }
                (part.body)
            }
        }
    }
}

/// Grade as a coloured word.
pub(crate) fn badge(grade: Grade) -> Markup {
    let class = match grade {
        Grade::NotAssessed => "badge none",
        Grade::Good => "badge good",
        Grade::Look => "badge look",
        Grade::Bad => "badge bad",
    };
    html! { span class=(class) { (grade.words()) } }
}

fn checks(verdict: &Verdict) -> Markup {
    html! {
        ul.checks {
            @for check in &verdict.0 {
                li { (badge(check.grade)) " " b { (check.measured) } " " span.about { "(" (check.rule) ")" } }
            }
        }
    }
}

/// A complete page, with further styles; it needs no network or scripts.
pub(crate) fn document(title: &str, style: &str, header: &Markup, main: &Markup) -> String {
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta http-equiv="Content-Security-Policy" content=(POLICY);
                meta name="viewport" content="width=device-width, initial-scale=1";
                title { (title) }
                style { (PreEscaped(STYLE)) (PreEscaped(RUN_STYLE)) (PreEscaped(style)) }
            }
            body {
                header { (header) }
                main { (main) }
            }
        }
    };
    printable(&page.into_string()).into_owned()
}

/// Figures side by side; empty if there are none.
pub(crate) fn figures(figures: &[Markup]) -> Markup {
    html! { @if !figures.is_empty() { div.figures { @for figure in figures { (figure) } } } }
}

/// Pictures of `width` SVG units with an introduction: as many side by side as there is room.
pub(crate) fn maps(about: &str, width: f64, figures: &[Markup]) -> Markup {
    let columns =
        format!("grid-template-columns:repeat(auto-fill,minmax(min(100%,{:.0}px),1fr))", 0.92 * width);
    html! {
        @if !figures.is_empty() {
            @if !about.is_empty() { p.about { (about) } }
            div.figures style=(columns) { @for figure in figures { (figure) } }
        }
    }
}

/// A figure with title and caption.
pub(crate) fn figure(title: &str, svg: String, words: &str) -> Markup {
    html! {
        figure {
            h3 { (title) }
            (PreEscaped(svg))
            @if !words.is_empty() { figcaption { (words) } }
        }
    }
}

/// A titled table of names and values; empty without rows.
pub(crate) fn section(title: &str, rows: impl Iterator<Item = (String, String)>) -> Markup {
    let mut rows = rows.peekable();
    html! {
        @if rows.peek().is_some() {
            section {
                h3 { (title) }
                table { @for (name, value) in rows { tr { td { (name) } td { (value) } } } }
            }
        }
    }
}

/// A titled table with header; empty without rows.
pub(crate) fn table(title: &str, heads: &[&str], rows: impl Iterator<Item = Vec<String>>) -> Markup {
    let mut rows = rows.peekable();
    html! {
        @if rows.peek().is_some() { section.data { h3 { (title) } (wide_table(title, heads, rows)) } }
    }
}

/// Cells with more characters are text, which wraps.
const TEXT: usize = 30;

/// A table with header, which scrolls on narrow screens.
pub(crate) fn wide_table(title: &str, heads: &[&str], rows: impl Iterator<Item = Vec<String>>) -> Markup {
    let rows: Vec<Vec<String>> = rows.collect();
    let is_text = |cell: &String| cell.chars().count() > TEXT;
    let has_text = |column: usize| rows.iter().any(|row| row.get(column).is_some_and(is_text));
    html! {
        div.scroll tabindex="0" role="region" aria-label=(title) {
            table.wide {
                thead { tr { @for (column, head) in heads.iter().enumerate() {
                    @if has_text(column) { th.text scope="col" { (head) } } @else { th scope="col" { (head) } }
                } } }
                tbody {
                    @for row in &rows {
                        tr { @for cell in row { @if is_text(cell) { td.text { (cell) } } @else { td { (cell) } } } }
                    }
                }
            }
        }
    }
}

/// Key figures as tiles; unknown ones are omitted.
pub(crate) fn tiles<'t>(figures: impl IntoIterator<Item = (&'t str, Option<String>)>) -> Markup {
    html! {
        div.tiles {
            @for (what, value) in figures {
                @if let Some(value) = value { div { b { (value) } span { (what) } } }
            }
        }
    }
}
