//! Ground and noise that `classify` has found.

use maud::{Markup, html};
use serde_json::Value;

use super::{PagePart, list, results, words};
use crate::numbers::{label, short};
use crate::page::{figure, maps, table};
use crate::report::overview::Overview;
use crate::report::overview::map::EXAGGERATION;
use crate::verdict::{self, Grade, QualityCheck};

/// A check with the reason of its limits, and what to do beyond them.
struct Advice {
    check: QualityCheck,
    reason: &'static str,
    remedy: &'static str,
}

/// Shares of classes, and the map of the ground; `None` if the chain has no stage `classify`.
pub(super) fn part(overview: &Overview, report: &Value, input: &Value, number: usize) -> Option<PagePart> {
    let stage = list(report, "stages").iter().find(|stage| stage["type"] == "classify")?;
    let map = overview.map.as_ref();
    let figures: Vec<Markup> = map
        .and_then(|map| {
            let view = results::MapView::new(map, input["frame"].as_str());
            let [low, high] = map.ground_range.map(|height| label(height, 1));
            let words = format!(
                "lowest ground point of each cell, 98 % of them from {low} to {high}; light from the north-west, heights \
                 exaggerated {EXAGGERATION} times"
            );
            Some(maps("", view.width(), &[figure("Ground", view.ground(&format!("ground-{number}"))?, &words)]))
        })
        .into_iter()
        .collect();
    let advice = advice(overview, stage["keys"]["ground"] != false);
    let body = html! {
        (by_class(overview))
        (to_do(&advice))
        @for figure in &figures { (figure) }
    };
    Some(PagePart::new("Ground and terrain", body).judged(advice.into_iter().map(|of| of.check).collect()))
}

/// Number, share and density of each class.
fn by_class(overview: &Overview) -> Markup {
    let counts = overview.points.iter().flat_map(|points| &points.by_class);
    let all: u64 = counts.clone().map(|(_, count)| count).sum();
    let area_m2 = area_m2(overview);
    let rows = counts.map(|(class, count)| {
        let count = *count as f64;
        let density = area_m2.map_or_else(String::new, |area_m2| short(count / area_m2));
        vec![
            format!("{class}: {}", words::of_class(*class)),
            label(count, 0),
            format!("{:.2}", 100.0 * count / all.max(1) as f64),
            density,
        ]
    });
    table("Share of each class", &["class", "returns", "%", "per m²"], rows)
}

/// Area with points, m².
fn area_m2(overview: &Overview) -> Option<f64> {
    Some(overview.map.as_ref()?.densities.as_ref()?.area_m2).filter(|area_m2| *area_m2 > 0.0)
}

/// Checks of the ground, if it was searched, and of the noise.
fn advice(overview: &Overview, has_ground: bool) -> Vec<Advice> {
    let count = |class: u8| {
        overview.points.as_ref().and_then(|points| points.by_class.get(&class)).copied().unwrap_or(0)
    };
    let all: u64 = overview.points.iter().flat_map(|points| points.by_class.values()).sum();
    let mut advice = Vec::new();
    if has_ground {
        let ground = overview.ground.as_ref();
        let density = ground.zip(area_m2(overview)).map(|(ground, area_m2)| ground.points as f64 / area_m2);
        let points = overview.map.as_ref().map_or(0, |map| map.points);
        advice.push(Advice {
            check: verdict::GROUND_DENSITY.check(density, points),
            reason: "with less than 0.5 ground points per m², cells of 1 m are on average more than 0.7 m from the nearest one",
            remedy: "Classify overlapping strips together with `wavex classify`, or choose larger cells for the terrain model. \
                     Without any ground, check the heights and the unit of the points",
        });
        let cells = ground.and_then(|ground| ground.covered_cells.zip(ground.bare_cells));
        advice.push(Advice {
            check: match cells {
                Some((covered, bare)) => verdict::BARE_AREA.share(bare, covered),
                None => verdict::BARE_AREA.check(None, 0),
            },
            reason: "roofs and water are bare, but terrain that is more than 5 m from ground points is interpolated",
            remedy: "Compare the map with buildings, water and woods. If open land is bare, colour its points by class in \
                     `wavex view`",
        });
    }
    advice.push(Advice {
        check: verdict::LOW_NOISE.share(count(7), all),
        reason: "multipath and false returns are usually a few in a thousand",
        remedy: "Colour by class in `wavex view`. Surfaces of class 7 are cellars, pits, or strips at another height; many \
                 single points are false returns, which a larger `detection_sigma` of `decompose` avoids",
    });
    advice.push(Advice {
        check: verdict::HIGH_NOISE.share(count(18), all),
        reason: "birds, haze and false returns are usually less than 1 %",
        remedy: "Colour by class in `wavex view`. Layers of class 18 are clouds or echoes of a wrong MTA zone: use \
                 `resolve_mta`",
    });
    advice
}

/// Reason and remedy of each value beyond its limit.
fn to_do(advice: &[Advice]) -> Markup {
    let beyond = || advice.iter().filter(|of| matches!(of.check.grade, Grade::Look | Grade::Bad));
    html! {
        @if beyond().next().is_some() {
            section {
                h3 { "What to do" }
                ul.notes { @for of in beyond() { li { b { (of.check.measured) } ": " (of.reason) ". " (of.remedy) "." } } }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::{GroundSummary, PointSummary};
    use serde_json::json;

    /// An overview of 1000 returns on 400 m², with these of the classes 2, 7 and 18, and bare cells of 100.
    fn overview(ground: u64, bare: u64, [low, high]: [u64; 2]) -> Overview {
        let by_class = [(1, 1000 - ground - low - high), (2, ground), (7, low), (18, high)].into();
        let density = json!({"count": 1000, "mean_per_m2": 2.5, "quantiles_per_m2": [1, 2, 4], "picture": "", "range_per_m2": [0, 1]});
        let map = json!({
            "axes": "coordinates", "unit": "m", "west": 0, "south": 0, "cell": 2, "columns": 10, "rows": 10, "points": 1000,
            "outside": 0, "heights": "", "height_range_m": [0, 1], "intensities": "", "intensity_range": [0, 1],
            "median_density": 2, "lines": [], "ground": "", "ground_range": [95.3, 130],
            "densities": {"area_m2": 400, "cells": 100, "pulses": density, "points": density},
        });
        let lines = json!({"lines_per_group": 1, "lines": "", "waveforms": "", "returns": "", "points": ""});
        let overview = json!({"histograms": [], "lines": lines, "map": map, "waveforms": []});
        let mut overview: Overview = serde_json::from_value(overview).unwrap();
        overview.points = Some(PointSummary { by_class, ..PointSummary::default() });
        overview.ground =
            Some(GroundSummary { points: ground, covered_cells: Some(100), bare_cells: Some(bare) });
        overview
    }

    fn shown(overview: &Overview, keys: &Value) -> PagePart {
        let report = json!({"stages": [{"type": "classify", "keys": keys}]});
        part(overview, &report, &Value::Null, 0).unwrap()
    }

    fn grades(overview: &Overview) -> Vec<Grade> {
        let part = shown(overview, &json!({"ground": true}));
        part.verdict.unwrap().0.iter().map(|check| check.grade).collect()
    }

    #[test]
    fn each_check_speaks() {
        let (good, look, bad) = (Grade::Good, Grade::Look, Grade::Bad);
        assert_eq!(grades(&overview(600, 5, [1, 5])), [good; 4]);
        assert_eq!(grades(&overview(100, 5, [1, 5])), [look, good, good, good]);
        assert_eq!(grades(&overview(0, 100, [1, 5])), [bad, bad, good, good]);
        assert_eq!(grades(&overview(600, 20, [1, 5])), [good, look, good, good]);
        assert_eq!(grades(&overview(600, 5, [10, 5])), [good, good, look, good]);
        assert_eq!(grades(&overview(600, 5, [30, 5])), [good, good, bad, good]);
        assert_eq!(grades(&overview(600, 5, [1, 20])), [good, good, good, look]);
        assert_eq!(grades(&overview(600, 5, [1, 60])), [good, good, good, bad]);
    }

    #[test]
    fn unknown_ground_is_not_assessed() {
        let (none, good) = (Grade::NotAssessed, Grade::Good);
        let mut overview = overview(600, 5, [1, 5]);
        overview.ground = Some(GroundSummary { points: 600, covered_cells: None, bare_cells: None });
        assert_eq!(grades(&overview), [good, none, good, good]);
        overview.ground = None;
        assert_eq!(grades(&overview), [none, none, good, good]);
        let noise_only = shown(&overview, &json!({"ground": false}));
        assert_eq!(noise_only.verdict.unwrap().0.len(), 2);
        assert!(part(&overview, &json!({"stages": []}), &Value::Null, 0).is_none());
    }

    #[test]
    fn values_beyond_their_limits_have_a_remedy() {
        let text = |overview: Overview| shown(&overview, &json!({"ground": true})).body.into_string();
        let good = text(overview(600, 5, [1, 5]));
        for words in ["2: ground", "60.00", "1.5", "98 % of them from 95.3 to 130.0"] {
            assert!(good.contains(words), "{words}: {good}");
        }
        assert!(!good.contains("What to do"));
        let bad = text(overview(0, 100, [30, 60]));
        assert_eq!(bad.matches("<li>").count(), 4, "{bad}");
        assert!(bad.contains("high noise (18): 6 %</b>: birds"), "{bad}");
    }
}
