//! HTML page with summary and pictures; needs no network or scripts.

use std::fmt::Write;

use super::figures::figures;
use super::summary::Summary;
use crate::cli::svg::escaped;
use crate::inspect::Survey;

/// Style sheet: follows the system's light or dark theme; prints black on white.
pub(in crate::cli) const STYLE: &str = "\
:root{color-scheme:light dark;--page:#fff;--card:#fff;--text:#222;--faint:#666;--rule:#d8d8d8;--grid:#e8e8e8;
--frame:#888;--bar:#3f7fc1;--low:#1565c0;--high:#c2590a}
@media (prefers-color-scheme:dark){:root{--page:#121417;--card:#1a1d21;--text:#ddd;--faint:#9a9a9a;--rule:#33383f;
--grid:#2b2f36;--frame:#777;--bar:#4f8fd0;--low:#64b5f6;--high:#ffb74d}}
@media print{:root{--page:#fff;--card:#fff;--text:#000;--faint:#444;--rule:#bbb;--grid:#ddd;--frame:#777;--bar:#3f7fc1;
--low:#1565c0;--high:#c2590a}}
body{margin:0 auto;max-width:1220px;padding:24px 20px 40px;background:var(--page);color:var(--text);
font:15px/1.45 'Segoe UI','Helvetica Neue','Liberation Sans','DejaVu Sans',Arial,sans-serif}
h1{font-size:24px;margin:0 0 2px;overflow-wrap:anywhere}h2{font-size:16px;margin:0 0 6px}
h3{font-size:14px;font-weight:600;margin:0 0 4px}.about{color:var(--faint);margin:0 0 18px}
.sections{columns:2;column-gap:32px}section{break-inside:avoid;padding:0 0 18px}
table{border-collapse:collapse;width:100%}td{border-top:1px solid var(--rule);padding:3px 0;vertical-align:top;
overflow-wrap:anywhere}td:first-child{color:var(--faint);padding-right:14px;width:36%;overflow-wrap:normal}
.figures{display:grid;grid-template-columns:repeat(auto-fill,minmax(min(100%,520px),1fr));gap:18px;margin-top:10px}
figure{margin:0;padding:12px;background:var(--card);border:1px solid var(--rule);border-radius:6px;break-inside:avoid}
svg{display:block;width:100%;height:auto}text{font:12px 'Segoe UI','Helvetica Neue','Liberation Sans','DejaVu Sans',
Arial,sans-serif;fill:var(--text)}.frame{fill:none;stroke:var(--frame)}.grid{stroke:var(--grid)}
.bars{fill:var(--bar);stroke:none}.dot{fill:var(--low)}polyline{fill:none;stroke-width:1.3}
polyline.low{stroke:var(--low)}polyline.high{stroke:var(--high)}.high.dot{fill:var(--high)}
@media (max-width:800px){.sections{columns:1}}
@media print{body{max-width:none;padding:0}.figures{grid-template-columns:1fr 1fr}}
";

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
