//! Ground, canopy and sensitivity of shots with large footprints.

use maud::{Markup, html};

use super::{PagePart, capitalised, results};
use crate::numbers::label;
use crate::page::{figure, figures, table};
use crate::report::overview::Footprints;
use crate::verdict;

/// Shows flags and histograms of footprints.
pub(super) fn part(found: &Footprints) -> PagePart {
    let drawn = found.histograms.iter().filter_map(|histogram| {
        let (svg, words) = results::histogram(histogram, "shots")?;
        Some(figure(&capitalised(&histogram.quantity), svg, &words))
    });
    let flags = [
        ("ground with a probability below 0.9", found.ambiguous),
        ("no ground", found.ground_missing),
        ("signal begins before the first sample", found.top_missing),
        ("clipped samples", found.clipped),
        ("flagged by the instrument", found.degraded),
    ];
    let percent = |count: u64| format!("{:.2}", 100.0 * count as f64 / found.shots.max(1) as f64);
    let rows = flags.map(|(name, count)| vec![name.to_owned(), label(count as f64, 0), percent(count)]);
    let body = html! {
        (table("Shots by flag", &["flag", "shots", "%"], rows.into_iter()))
        (figures(&drawn.collect::<Vec<Markup>>()))
    };
    PagePart::new("Large footprints", body).judged(vec![
        verdict::GROUND_MISSING.share(found.ground_missing, found.shots),
        verdict::AMBIGUOUS_GROUND.share(found.ambiguous, found.shots),
    ])
}
