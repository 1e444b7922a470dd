//! HTML page with summary and pictures; needs no network or scripts.

use maud::{DOCTYPE, PreEscaped, html};

use super::Inspection;
use super::figures::figures;
use super::summary::Summary;
use crate::report::style::STYLE;

/// Renders the page as HTML.
pub fn page(summary: &Summary, inspection: &Inspection) -> String {
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                title { (summary.file) }
                style { (PreEscaped(STYLE)) }
            }
            body {
                h1 { (summary.file) }
                p.about { "Summary of the recording, by wavex scan " (env!("CARGO_PKG_VERSION")) }
                div.sections {
                    @for section in &summary.sections {
                        section {
                            h2 { (section.title) }
                            table { @for (name, value) in &section.rows { tr { td { (name) } td { (value) } } } }
                        }
                    }
                }
                div.figures {
                    @for figure in figures(inspection) {
                        figure { h3 { (figure.title) } (PreEscaped(figure.svg)) }
                    }
                }
            }
        }
    };
    page.into_string()
}
