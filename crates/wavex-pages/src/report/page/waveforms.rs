//! Waveform figures of a run's page.

use maud::{Markup, PreEscaped, html};

use crate::numbers::label;
use crate::page::wide_table;
use crate::plot::{Anchor, Panels, Svg, WIDTH, fit_marks};
use crate::report::overview::{ShownKind, ShownReturn, ShownShot, WeakReturns};
use wavex_line::stage::FittedBlock;

/// Maximum number of returns in the table of a shot.
const MOST_RETURNS: usize = 6;

/// Draws a shot: samples with fit, residuals, and a table of returns.
pub(super) fn figure(shot: &ShownShot) -> Markup {
    let mut svg = Svg::new();
    let panels = Panels { x: [62.0, 548.0], gap: 16.0, samples: [10.0, 210.0], residual: [228.0, 308.0] };
    let blocks: Vec<&FittedBlock> = shot.blocks.iter().collect();
    panels.draw(&mut svg, &blocks);
    svg.text("", [305.0, 344.0], Anchor::Middle, "time of flight, ns");
    svg.upright_text("", [17.0, 110.0], "digitiser steps, DN");
    svg.upright_text("", [17.0, 268.0], "residual, SD");
    let title = title(shot);
    let picture = svg.inline(WIDTH, 352.0, &title);
    let rows = shot.returns.iter().take(MOST_RETURNS).map(cells);
    let more = shot.returns.len().saturating_sub(MOST_RETURNS);
    html! {
        figure {
            h3 { (title) }
            (PreEscaped(picture))
            (wide_table("Returns of the shot", &["return", "range, m", "amplitude, DN", "width ratio", "flags"], rows))
            @if more > 0 { p.about { "and " (more) " more" } }
        }
    }
}

fn title(shot: &ShownShot) -> String {
    let kind = match shot.kind {
        ShownKind::Good => "Good",
        ShownKind::Overlapping => "Overlapping",
        ShownKind::Saturated => "Saturated",
        ShownKind::Worst => "Worst fit",
    };
    let deviation_ratio = label(shot.deviation_ratio, 1);
    format!("{kind}: shot {}, scan line {}, deviation ratio {deviation_ratio}", shot.shot, shot.line)
}

fn cells(found: &ShownReturn) -> Vec<String> {
    let known = |value: Option<f64>, digits: usize| value.map(|value| format!("{value:.digits$}"));
    let with_sd = |value: Option<String>, sd: Option<String>| match (value, sd) {
        (Some(value), Some(sd)) => format!("{value} ± {sd}"),
        (value, _) => value.unwrap_or_else(|| "unknown".to_owned()),
    };
    vec![
        found.number.to_string(),
        with_sd(known(found.range_m, 3), known(found.range_sd_m, 3)),
        with_sd(known(found.amplitude_dn, 1), known(found.amplitude_sd_dn, 1)),
        known(found.width_ratio, 2).unwrap_or_default(),
        found.flags.clone(),
    ]
}

/// Table of the weak returns behind strong ones, by distance.
pub(super) fn weak_returns(weak: &WeakReturns) -> Markup {
    let rows = weak.by_lag().into_iter().enumerate().filter(|(_, count)| *count > 0).map(|(lag, count)| {
        let [from, until] = [lag, lag + 1].map(|lag| label(lag as f64 * weak.pulse_fwhm_ns, 0));
        let percent = 100.0 * count as f64 / weak.strong_shots.max(1) as f64;
        vec![format!("{from} to {until}"), label(count as f64, 0), format!("{percent:.2}")]
    });
    let pile_up = weak.pile_up();
    html! {
        (wide_table("Weak returns behind strong ones", &["lag, ns", "returns", "% of the shots"], rows))
        p.about {
            "Returns of at most 1/16 of the strongest return before them, in the "
            (label(weak.strong_shots as f64, 0)) " shots whose strongest return has at least 100 standard deviations. "
            "Targets lie at any distance. "
            @if pile_up.percent > 0.0 {
                "Returns pile up at " (label(pile_up.lag_ns[0], 0)) " to " (label(pile_up.lag_ns[1], 0))
                " ns, in " (format!("{:.1}", pile_up.percent)) " % of these shots: they are likely caused by the receiver."
            }
        }
    }
}

/// Legend of the waveform figures: a small picture and a text for each mark.
pub(super) fn legend() -> Markup {
    let mut marks = fit_marks("pulse of one return");
    // The band is last.
    marks[4..].rotate_left(1);
    html! {
        ul.legend { @for (mark, text) in marks { li { (PreEscaped(mark.picture(text))) (text) } } }
    }
}
