//! HTML page with summary and pictures; needs no network or scripts.

use std::fmt::Write;

use super::figures::figures;
use super::summary::Summary;
use crate::inspect::Survey;
use crate::report::style::STYLE;
use crate::report::svg::escaped;

/// Renders the page as HTML.
pub(super) fn page(summary: &Summary, survey: &Survey) -> String {
    let name = escaped(&summary.file);
    let mut page = format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<title>{name}</title>\n\
         <style>\n{STYLE}</style>\n</head>\n<body>\n<h1>{name}</h1>\n\
         <p class=\"about\">Summary of the recording, by wavex scan {}</p>\n<div class=\"sections\">\n",
        env!("CARGO_PKG_VERSION")
    );
    for section in &summary.sections {
        let _ = write!(page, "<section>\n<h2>{}</h2>\n<table>\n", escaped(&section.title));
        for (name, value) in &section.rows {
            let _ = writeln!(page, "<tr><td>{}</td><td>{}</td></tr>", escaped(name), escaped(value));
        }
        page.push_str("</table>\n</section>\n");
    }
    page.push_str("</div>\n<div class=\"figures\">\n");
    for figure in figures(survey) {
        let _ = write!(page, "<figure>\n<h3>{}</h3>\n{}</figure>\n", escaped(&figure.title), figure.svg);
    }
    page.push_str("</div>\n</body>\n</html>\n");
    page
}
