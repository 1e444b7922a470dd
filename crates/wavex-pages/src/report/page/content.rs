//! Extent, content and density of the points on a run's page.

use maud::{Markup, html};
use serde_json::Value;

use super::{results, words};
use crate::numbers::{label, short};
use crate::page::{PagePart, figure, maps, section, table};
use crate::report::overview::{MapAxes, MapPicture, Overview, PointSummary};
use crate::verdict::{self, Rule};

/// Median of a quantity of the returns; `None` if unknown.
pub(super) fn median(overview: &Overview, quantity: &str) -> Option<f64> {
    overview.histograms.iter().find(|of| of.quantity == quantity)?.quantile(0.5)
}

/// Number of returns with a quantity.
pub(super) fn total(overview: &Overview, quantity: &str) -> u64 {
    overview.histograms.iter().find(|of| of.quantity == quantity).map_or(0, |of| of.total())
}

fn percent(part: u64, of: u64) -> String {
    format!("{:.2}", 100.0 * part as f64 / of.max(1) as f64)
}

/// Extent, dates, classes and return numbers.
pub(super) fn extent(overview: &Overview, input: &Value) -> PagePart {
    let points = overview.points.clone().unwrap_or_default();
    let body = html! {
        div.sections {
            (section("Extent", extent_rows(overview, &points, input)))
            (shots_by_returns(&points))
            (by_return_number(&points))
            (by_class(&points))
        }
    };
    let returns = points.by_class.values().sum();
    let total = |key: &str| input["totals"][key].as_u64().unwrap_or(0);
    let checks = vec![
        verdict::WITHHELD.share(points.withheld, returns),
        verdict::WITHOUT_RETURN.share(total("nw_empty"), total("nw")),
    ];
    let is_known = overview.points.is_some() || overview.times.is_some();
    PagePart::new("Extent and content", if is_known { body } else { Markup::default() }).judged(checks)
}

fn extent_rows(
    overview: &Overview,
    points: &PointSummary,
    input: &Value,
) -> impl Iterator<Item = (String, String)> {
    let map = overview.map.as_ref();
    let mut rows = vec![("coordinate reference system", crs(points, map, input))];
    if let Some(bounds) = points.bounds {
        let is_degrees = map.is_some_and(|map| map.axes == MapAxes::Degrees);
        let names = match map.map(|map| map.axes) {
            Some(MapAxes::Plane) => ["x", "y", "z"],
            Some(MapAxes::Degrees) => ["longitude", "latitude", "height"],
            _ if matches!(input["frame"].as_str(), Some("scanner" | "body")) => ["x", "y", "z"],
            _ => ["east", "north", "height"],
        };
        let unit = map.filter(|_| !is_degrees).map_or("m", |map| map.unit.as_str());
        for (i, (name, [low, high])) in names.into_iter().zip(bounds).enumerate() {
            let (unit, digits) = if is_degrees && i < 2 { ("°", 7) } else { (unit, 2) };
            rows.push((name, format!("{} to {} {unit}", label(low, digits), label(high, digits))));
        }
    }
    if let Some(times) = &overview.times {
        let [from, until] = times.span_s.map(|time_s| label(time_s, 3));
        let span = format!("{from} to {until} s ({} s)", short(times.span_s[1] - times.span_s[0]));
        rows.push(("times of the shots", span));
        if let Some([from, until]) = &times.gps_dates {
            rows.push((
                "recorded (GPS time)",
                format!("{} to {}", from.replace('T', " "), until.replace('T', " ")),
            ));
        }
    }
    rows.into_iter().map(|(name, value)| (name.to_owned(), value))
}

/// Coordinate reference system in words.
fn crs(points: &PointSummary, map: Option<&MapPicture>, input: &Value) -> String {
    let name = input["coordinates"].as_str().or(points.crs.as_deref());
    let kind = match map {
        Some(map) => match (map.axes, map.unit.as_str()) {
            (MapAxes::Degrees, _) => "geographic: longitude and latitude in degrees",
            (MapAxes::Plane, _) => "earth-centred: x, y and z in metres",
            (MapAxes::Coordinates, "ft") => "east and north in feet",
            (MapAxes::Coordinates, _) if matches!(input["frame"].as_str(), Some("scanner" | "body")) => {
                "axes of the instrument, in metres"
            }
            (MapAxes::Coordinates, _) => "east and north in metres",
        },
        None => "no points",
    };
    format!("{}; {kind}", name.unwrap_or("not given by the input"))
}

fn shots_by_returns(points: &PointSummary) -> Markup {
    let shots: u64 = points.shots_by_returns.iter().sum();
    let with_returns = shots - points.shots_by_returns.first().copied().unwrap_or(0);
    let returns: u64 = points.by_class.values().sum();
    let row = |(number, count): (usize, &u64)| {
        vec![number.to_string(), label(*count as f64, 0), percent(*count, shots)]
    };
    let mean = returns as f64 / with_returns.max(1) as f64;
    html! {
        div.keep {
        (table("Returns per pulse", &["returns", "pulses", "%"], points.shots_by_returns.iter().enumerate().map(row)))
        @if with_returns > 0 { p.about { "mean of the pulses with returns: " (short(mean)) } }
        }
    }
}

fn by_return_number(points: &PointSummary) -> Markup {
    let all: u64 = points.by_return_number.iter().sum();
    let rows = points.by_return_number.iter().zip(1..).map(|(count, number): (&u64, usize)| {
        vec![number.to_string(), label(*count as f64, 0), percent(*count, all)]
    });
    table("Returns by return number", &["return number", "returns", "%"], rows)
}

fn by_class(points: &PointSummary) -> Markup {
    let all: u64 = points.by_class.values().sum();
    let rows = points.by_class.iter().map(|(class, count)| {
        vec![format!("{class}: {}", words::of_class(*class)), label(*count as f64, 0), percent(*count, all)]
    });
    let withheld = (points.withheld, percent(points.withheld, all));
    html! {
        div.keep {
        (table("Returns by class", &["class", "returns", "%"], rows))
        @if all > 0 { p.about { "withheld: " (label(withheld.0 as f64, 0)) " (" (withheld.1) " %)" } }
        }
    }
}

/// Map views and densities.
pub(super) fn from_above(overview: &Overview, report: &Value, input: &Value, number: usize) -> PagePart {
    let Some(map) = &overview.map else { return PagePart::new("Density and maps", Markup::default()) };
    let view = results::MapView::new(map, input["frame"].as_str());
    let mut figures = vec![
        figure("Points by height", view.heights(&format!("heights-{number}")), ""),
        figure("Points by intensity", view.intensities(&format!("intensities-{number}")), ""),
    ];
    if let Some(densities) = &map.densities {
        for (of, kind) in [(&densities.pulses, "pulse"), (&densities.points, "point")] {
            let svg = view.density(of, kind, &format!("{kind}-density-{number}"));
            figures.push(figure(&format!("{} density", super::capitalised(kind)), svg, ""));
        }
    }
    let zones = view.zones(&format!("zones-{number}"));
    figures.extend(zones.map(|svg| figure("Points by MTA zone", svg, "")));
    let swath = view.swath(&format!("intensities-{number}"));
    let words = "some scan lines; dot: middle of the first line";
    figures.extend(swath.map(|svg| figure("Swath on the map grid", svg, words)));
    let about = results::about(map, input["coordinates"].as_str());
    let body = html! { (densities(map)) (maps(&about, view.width(), &figures)) };
    let target = report["job"]["survey"]["target_pulses_per_m2"].as_f64();
    // The usual limit is that of small footprints; a job can have its own.
    let usual = overview.footprints.is_none().then_some(verdict::PULSE_DENSITY);
    let pulses = map.densities.as_ref().map(|densities| &densities.pulses);
    let check = |rule: Rule| rule.check(pulses.map(|of| of.mean_per_m2), pulses.map_or(0, |of| of.count));
    let checks = target.map(verdict::target_density).or(usual).map(check);
    PagePart::new("Density and maps", body).judged(checks.into_iter().collect())
}

fn densities(map: &MapPicture) -> Markup {
    let Some(densities) = &map.densities else { return Markup::default() };
    let row = |(name, of): (&str, &crate::report::Density)| {
        let mut row = vec![name.to_owned(), label(of.count as f64, 0), short(of.mean_per_m2)];
        row.extend(of.quantiles_per_m2.map(short));
        row.push(short(1.0 / of.mean_per_m2.max(1e-12).sqrt()));
        row
    };
    let heads = ["per m²", "number", "mean", "5 % below", "median", "95 % below", "spacing, m"];
    let rows = [("pulses (first returns)", &densities.pulses), ("points (all returns)", &densities.points)];
    html! {
        (table("Densities", &heads, rows.into_iter().map(row)))
        p.about {
            "Area with points: " (label(densities.area_m2, 0)) " m² in " (label(densities.cells as f64, 0))
            " cells, which include those at the edge. Spacing: square root of the area per item. Withheld returns do not count."
        }
    }
}
