//! HTML page with summary and pictures; needs no network or scripts.

use maud::html;

use super::Inspection;
use super::figures::figures;
use super::summary::RecordingSummary;
use crate::page::{PagePart, document, figures as side_by_side, section, table, with_contents};
use crate::verdict::{self, Grade, QualityCheck};
use wavex_line::stage::Counters;

/// Renders the page as HTML; `cut`: reason why the recording could not be read to its end.
pub fn page(
    summary: &RecordingSummary,
    inspection: &Inspection,
    counters: &Counters,
    cut: Option<&str>,
) -> String {
    let beams = summary.sections.iter().find_map(|of| of.table.split_first());
    let beams = beams.map(|(heads, rows)| (heads.iter().map(String::as_str).collect::<Vec<_>>(), rows));
    let sections = html! {
        div.sections { @for of in &summary.sections { (section(&of.title, of.rows.iter().cloned())) } }
        @if let Some((heads, rows)) = beams { (table("Beams of the instrument", &heads, rows.iter().cloned())) }
    };
    let parts = [
        PagePart::new("Summary", sections).judged(checks(inspection, counters, cut)),
        PagePart::new("Figures", side_by_side(&figures(inspection))),
    ];
    let header = html! {
        h1 { (summary.file) }
        p.about { "Summary of the recording, by wavex scan " (env!("CARGO_PKG_VERSION")) }
    };
    document(&summary.file, "", &header, &with_contents(&parts, "", &html! {}))
}

fn checks(inspection: &Inspection, counters: &Counters, cut: Option<&str>) -> Vec<QualityCheck> {
    let shots = &inspection.shots;
    let whole = QualityCheck {
        grade: if cut.is_some() { Grade::Bad } else { Grade::Good },
        measured: format!("read to the end: {}", if cut.is_some() { "no" } else { "yes" }),
        rule: "good if yes, else bad".to_owned(),
    };
    let values =
        || inspection.channels.iter().filter_map(|channel| Some((channel, channel.values.as_ref()?)));
    let saturated = values().filter_map(|(_, values)| values.saturated()).map(|[_, blocks]| blocks).sum();
    let blocks =
        values().filter(|(_, values)| values.saturated().is_some()).map(|(channel, _)| channel.blocks).sum();
    vec![
        whole,
        verdict::REJECTED.check(Some(counters.rejected.len() as f64), 1),
        verdict::CLOCK_STEPS.check(Some(inspection.times.backwards.0 as f64), shots.count),
        verdict::WITHOUT_ECHO.share(shots.count - shots.with_echoes, shots.count),
        verdict::SATURATED_BLOCKS.share(saturated, blocks),
    ]
}
