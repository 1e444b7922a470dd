//! HTML page of a run; needs no network or scripts.

use std::borrow::Cow;
use std::collections::BTreeMap;

use maud::{Markup, html};
use serde_json::Value;

use super::overview::{Overview, QuantityHistogram};
use super::tables::points;
use crate::numbers::{label, short};
use crate::page::{PagePart, badge, document, figure, figures, section, table, tiles, with_contents, worst};
use crate::verdict::{self, Grade, QualityCheck};

mod content;
mod details;
pub(super) mod drift;
mod flight;
mod footprints;
mod ground;
mod results;
mod stages_and_sensor;
mod waveforms;
pub(super) mod words;

/// Reason why a report has no page.
#[derive(Debug, thiserror::Error)]
pub(super) enum NoPage {
    /// The overview of an input cannot be read.
    #[error("the overview of {stem:?} is invalid: {source}")]
    Overview {
        /// Stem of the input.
        stem: String,
        /// Problem of the JSON.
        source: serde_json::Error,
    },
    /// The overview of an input has a list that no run makes so long.
    #[error("the overview of {stem:?} is invalid: {problem}")]
    TooMany {
        /// Stem of the input.
        stem: String,
        /// The list and its length.
        problem: String,
    },
    /// An entry cannot be read.
    #[error(transparent)]
    Entry(#[from] serde_json::Error),
    /// The page exceeds its limit.
    #[error("its page would be larger than {} MB", limit / 1_000_000)]
    TooLarge {
        /// Limit, bytes.
        limit: usize,
    },
}

/// Renders a report and the entries of its inputs as HTML; omits parts that the report lacks.
///
/// # Errors
/// If an entry or its overview is invalid, or the page is larger than about `limit` bytes.
pub(super) fn page<'r>(
    report: &Value,
    inputs: impl Iterator<Item = serde_json::Result<Cow<'r, Value>>>,
    limit: usize,
) -> Result<String, NoPage> {
    let chain: Vec<String> = list(report, "stages").iter().map(name).collect();
    let (mut names, mut rows, mut shown) = (Vec::new(), Vec::new(), Vec::new());
    let mut started: Option<String> = None;
    let mut bytes = 0;
    for (number, input) in inputs.enumerate() {
        let input = &*input?;
        names.push(plain(&input["stem"]));
        let at = input["started"].as_str().filter(|text| !text.is_empty()).map(str::to_owned);
        started = started.into_iter().chain(at).min();
        let part =
            if input["status"] == "not_run" { None } else { Some(InputPart::of(report, input, number)?) };
        rows.push(input_row(input, part.as_ref()));
        bytes += part.as_ref().map_or(0, |part| part.body.0.len());
        if bytes > limit {
            return Err(NoPage::TooLarge { limit });
        }
        shown.extend(part.map(|part| part.body));
    }
    let title = format!("wavex report: {}", names.join(", "));
    let header = html! {
        h1 { "Report of a run" }
        p.about { (about_run(report, started)) }
        p.chain { (chain.join(" → ")) }
    };
    let main = html! {
        (of_inputs(&rows))
        (drift::of_survey(&report["survey_models"]))
        @for body in &shown { (body) }
        details.job open { summary { "Job with all keys" } (details::all_keys(report)) }
    };
    drop(shown);
    let page = document(&title, "", &header, &main);
    if page.len() > limit { Err(NoPage::TooLarge { limit }) } else { Ok(page) }
}

/// Date, version, computer, threads and duration of a run.
fn about_run(report: &Value, started: Option<String>) -> String {
    let date = started.map(|text| text.replace('T', " ").replace('Z', " UTC"));
    let commit =
        report["commit"].as_str().and_then(|commit| commit.get(..7)).map(|commit| format!(" ({commit})"));
    let version = format!("wavex {}{}", plain(&report["wavex"]), commit.unwrap_or_default());
    let host = report["host"].as_str().map(|host| format!("on {host}"));
    let threads = report["threads"]
        .as_u64()
        .map(|threads| format!("{threads} {}", if threads == 1 { "thread" } else { "threads" }));
    let duration = report["wall_s"].as_f64().map(|wall_s| format!("{} s", short(wall_s)));
    [date, Some(version), host, threads, duration].into_iter().flatten().collect::<Vec<String>>().join(", ")
}

/// Part of the page about one input.
struct InputPart {
    /// Anchor of its heading.
    id: String,
    grade: Grade,
    body: Markup,
}

/// Contents of a run of several inputs: verdict, status, points, time, reason of a failure.
fn of_inputs(rows: &[Markup]) -> Markup {
    html! {
        @if rows.len() > 1 {
            section.data {
                h2 { "Inputs" }
                div.scroll tabindex="0" role="region" aria-label="Inputs" {
                    table.wide {
                        thead { tr { @for head in ["input", "verdict", "status", "points", "time, s", "reason"] { th scope="col" { (head) } } } }
                        tbody { @for row in rows { (row) } }
                    }
                }
            }
        }
    }
}

fn input_row(input: &Value, part: Option<&InputPart>) -> Markup {
    let stem = plain(&input["stem"]);
    html! {
        tr {
            td { @if let Some(part) = part { a href={ "#" (part.id) } { (stem) } } @else { (stem) } }
            td { (badge(part.map_or(Grade::NotAssessed, |part| part.grade))) }
            td { (plain(&input["status"]).replace('_', " ")) }
            td { (label(points(input) as f64, 0)) }
            td { (seconds(&input["wall_s"])) }
            td.text { (input["failure"].as_str().unwrap_or_default()) }
        }
    }
}

impl InputPart {
    fn of(report: &Value, input: &Value, number: usize) -> Result<InputPart, NoPage> {
        let stem = plain(&input["stem"]);
        let overview: Option<Overview> = match &input["overview"] {
            Value::Null => None,
            value => Some(
                serde_json::from_value(value.clone())
                    .map_err(|source| NoPage::Overview { stem: stem.clone(), source })?,
            ),
        };
        if let Some(problem) = overview.as_ref().and_then(Overview::excess) {
            return Err(NoPage::TooMany { stem, problem });
        }
        let id = format!("input-{number}");
        let parts = parts(report, input, overview.as_ref(), number);
        let heading = html! {
            @if let Some(failure) = input["failure"].as_str() { section { h2 { "Failed" } p { (failure) } } }
            (key_figures(input, overview.as_ref()))
        };
        let body = html! {
            h1.input id=(id) { (stem) }
            (with_contents(&parts, &format!("{id}-"), &heading))
        };
        Ok(InputPart { id, grade: worst(&parts), body })
    }
}

/// Parts of an input in their order.
fn parts(report: &Value, input: &Value, overview: Option<&Overview>, number: usize) -> Vec<PagePart> {
    let mut parts = vec![notes(input)];
    if let Some(overview) = overview {
        parts.push(content::extent(overview, input));
        parts.push(content::from_above(overview, report, input, number));
        parts.extend(ground::part(overview, report, input, number));
        parts.push(flight::part(overview));
        parts.push(of_returns(overview));
        parts.extend(of_zones(overview));
        match &overview.footprints {
            Some(found) => parts.push(footprints::part(found)),
            None => parts.push(of_waveforms(overview, input)),
        }
    }
    parts.extend([
        of_sensor(&input["sensor_model"]),
        of_run(input),
        PagePart::new("Details", details::tables(input)),
    ]);
    parts
}

/// Shows the key figures of an input.
fn key_figures(input: &Value, overview: Option<&Overview>) -> Markup {
    let total = |key: &str| input["totals"][key].as_u64();
    let wall_s = input["wall_s"].as_f64().filter(|wall_s| *wall_s > 0.0);
    let lines = list(input, "stages").last().and_then(|stage| stage["lines_out"].as_u64());
    let count = |value: Option<u64>| value.map(|value| label(value as f64, 0));
    let rate = total("nw").zip(wall_s).map(|(waveforms, wall_s)| label(waveforms as f64 / wall_s, 0));
    let densities = overview.and_then(|overview| overview.map.as_ref()?.densities.as_ref());
    let range_sd = overview.and_then(|overview| content::median(overview, "range uncertainty"));
    tiles([
        ("scan lines", count(lines)),
        ("waveforms", count(total("nw"))),
        ("returns", count(total("np"))),
        ("points", count(total("n_georef"))),
        ("pulses per m², mean", densities.map(|of| short(of.pulses.mean_per_m2))),
        ("points per m², mean", densities.map(|of| short(of.points.mean_per_m2))),
        ("range SD, median", range_sd.map(|range_m| format!("{} mm", short(1e3 * range_m)))),
        ("duration of the run", wall_s.map(|wall_s| format!("{} s", short(wall_s)))),
        ("waveforms per second", rate),
    ])
}

/// Lists warnings and rejections, then findings that need no action.
fn notes(input: &Value) -> PagePart {
    let (mut warnings, mut findings) = (Vec::new(), Vec::new());
    let mut consequences = BTreeMap::<String, Vec<String>>::new();
    for stage in list(input, "stages") {
        let of_stage = |text: String| (name(stage), text);
        warnings.extend(list(stage, "notes").iter().map(plain).map(of_stage));
        for (cause, texts) in stage["consequences"].as_object().into_iter().flatten() {
            for text in texts.as_array().into_iter().flatten() {
                consequences.entry(cause.clone()).or_default().push(plain(text));
            }
        }
        findings.extend(list(stage, "findings").iter().map(plain).map(of_stage));
        for (what, n) in stage["rejected"].as_object().into_iter().flatten() {
            let n = label(n.as_f64().unwrap_or(0.0), 0);
            match list(stage, "set_aside").iter().any(|other| other == what) {
                true => findings.push(of_stage(format!("set aside {n} {what}"))),
                false => warnings.push(of_stage(format!("rejected {n} {what}"))),
            }
        }
    }
    warnings.extend(consequences.into_iter().map(|(cause, texts)| (cause, texts.join("; "))));
    let listed = |items: &[(String, String)]| {
        html! { ul.notes { @for (stage, text) in items { li { b { (stage) } ": " (text) } } } }
    };
    let body = html! {
        section {
            h2 { "Warnings" }
            @if warnings.is_empty() { p { "None: no warnings and no rejected items." } }
            @else { (listed(&warnings)) }
        }
        @if !findings.is_empty() { section { h2 { "Findings" } (listed(&findings)) } }
    };
    let mut checks = vec![verdict::WARNINGS.check(Some(warnings.len() as f64), 1)];
    if input["status"] == "failed" {
        let [measured, rule] =
            ["the input failed", "good if it was processed completely, else bad"].map(str::to_owned);
        checks.insert(0, QualityCheck { grade: Grade::Bad, measured, rule });
    }
    PagePart::new("Result", body).judged(checks)
}

fn of_returns(overview: &Overview) -> PagePart {
    let drawn = overview.histograms.iter().filter_map(|histogram| {
        let (svg, words) = results::histogram(histogram, "returns")?;
        Some(figure(&capitalised(&histogram.quantity), svg, &words))
    });
    // The limits are those of small footprints.
    if overview.footprints.is_some() {
        return PagePart::new("Returns", figures(&drawn.collect::<Vec<Markup>>()));
    }
    let mut checks = vec![verdict::RANGE_SD.check(
        content::median(overview, "range uncertainty"),
        content::total(overview, "range uncertainty"),
    )];
    let known = content::total(overview, "total uncertainty");
    if known > 0 {
        checks.push(verdict::TOTAL_SD.check(content::median(overview, "total uncertainty"), known));
    }
    PagePart::new("Returns", figures(&drawn.collect::<Vec<Markup>>())).judged(checks)
}

/// Shows the share of each MTA zone, and the recording computed with each zone.
fn of_zones(overview: &Overview) -> Option<PagePart> {
    let zones = overview.zones.as_ref()?;
    let sum = |of: fn(&super::overview::ZoneShare) -> u64| zones.shares.iter().map(of).sum::<u64>();
    let all = sum(|share| share.returns);
    let percent = |part: u64, of: u64| format!("{:.2}", 100.0 * part as f64 / of.max(1) as f64);
    let rows = zones.shares.iter().map(|share| {
        let zone = if share.zone < 0 { "unresolved".to_owned() } else { share.zone.to_string() };
        let [returns, uncertain] = [share.returns, share.uncertain].map(|count| label(count as f64, 0));
        vec![zone, returns, percent(share.returns, all), uncertain, percent(share.uncertain, share.returns)]
    });
    let clouds = zones.clouds.as_ref().map(|clouds| {
        let words = format!(
            "range (m) against shot: the middle of scan line {}, with all echoes in one zone. Above each plot: median difference of \
             neighbouring ranges, which is smallest for the correct zone if pulse intervals vary",
            clouds.line
        );
        figure("Range with each MTA zone", results::clouds(clouds), &words)
    });
    let heads = ["zone", "returns", "% of all", "uncertain", "% of the zone"];
    let body = html! {
        (figures(clouds.as_slice()))
        (table("Returns by MTA zone", &heads, rows))
    };
    let checks = vec![verdict::UNCERTAIN_ZONES.share(sum(|share| share.uncertain), all)];
    Some(PagePart::new("Multiple time around", body).judged(checks))
}

/// Deviation ratio above which a fit does not explain its waveform; below its negative, the expected
/// misfit is too large.
const UNEXPLAINED: f64 = super::survey::UNEXPLAINED;

fn of_waveforms(overview: &Overview, input: &Value) -> PagePart {
    let shots: Vec<Markup> = overview.waveforms.iter().map(waveforms::figure).collect();
    let weak = overview.weak_returns.as_ref();
    let body = html! {
        @if !shots.is_empty() { (waveforms::legend()) (figures(&shots)) }
        @if let Some(weak) = weak { (waveforms::weak_returns(weak)) }
    };
    let total = |key: &str| input["totals"][key].as_u64().unwrap_or(0);
    let deviations = overview.histograms.iter().find(|of| of.quantity == "deviation ratio");
    let mut checks = deviation_checks(deviations);
    checks.push(
        verdict::PILE_UP
            .check(weak.map(|weak| weak.pile_up().percent), weak.map_or(0, |weak| weak.strong_shots)),
    );
    checks.push(verdict::SATURATED.share(total("nw_saturated"), total("nw")));
    PagePart::new("Waveforms and their fits", body).judged(checks)
}

/// Checks of both sides of the deviation ratio and of its centre.
fn deviation_checks(deviations: Option<&QuantityHistogram>) -> Vec<verdict::QualityCheck> {
    let returns = deviations.map_or(0, QuantityHistogram::total);
    let count = |is_beyond: fn([f64; 2]) -> bool| -> u64 {
        let bins = deviations.into_iter().flat_map(|of| of.bins());
        bins.filter(|(edges, _)| is_beyond(*edges)).map(|(_, count)| count).sum()
    };
    let [below, above] = deviations.map_or([0, 0], |of| [of.below, of.above]);
    // A median outside the bins is at least as far from 0 as their nearer end.
    let centre = deviations.map(|of| of.quantile(0.5).map_or(10.0, f64::abs));
    vec![
        verdict::UNEXPLAINED.share(above + count(|[low, _]| low >= UNEXPLAINED), returns),
        verdict::OVERESTIMATED.share(below + count(|[_, high]| high <= -UNEXPLAINED), returns),
        verdict::DEVIATION_CENTRE.check(centre, returns),
    ]
}

fn of_run(input: &Value) -> PagePart {
    let words = "sum over all workers of a stage; waiting: for input lines; blocked: by the next stage";
    let stages = list(input, "stages");
    let times = stages_and_sensor::times(stages).map(|svg| figure("Time per stage", svg, words));
    let tables = html! { (details::stages(input)) (details::observed(input)) };
    PagePart::new("Processing", html! { (figures(times.as_slice())) (tables) })
}

/// Channels of a sensor model that are shown, with their names.
const CHANNELS: [(&str, &str); 3] =
    [("low_power", "low power"), ("high_power", "high power"), ("reference", "outgoing pulse")];

fn of_sensor(model: &Value) -> PagePart {
    let mut drawn = Vec::new();
    for (key, channel) in CHANNELS {
        let response = stages_and_sensor::response(&model[key]["response"]);
        let title = format!("System response, {channel}");
        drawn.extend(response.map(|svg| figure(&title, svg, "at each calibrated amplitude")));
        let noise = stages_and_sensor::noise(&model[key]);
        let sd = model[key]["noise_sd_dn"].as_f64().unwrap_or(0.0);
        let words = format!("noise SD {} DN; bars: two standard deviations", short(sd));
        drawn.extend(noise.map(|svg| figure(&format!("Noise, {channel}"), svg, &words)));
    }
    let echoes = &model["low_power"];
    let errors = list(&echoes["response"], "template_error").iter().filter_map(Value::as_f64);
    let largest = errors.map(f64::abs).reduce(f64::max).map(|error| 100.0 * error);
    let checks = vec![
        verdict::CALIBRATION.check(echoes["waveforms"].as_f64(), 1),
        verdict::SHAPE_ERROR.check(largest, 1),
    ];
    PagePart::new("Sensor model", figures(&drawn)).judged(checks)
}

fn list<'v>(value: &'v Value, key: &str) -> &'v [Value] {
    value[key].as_array().map_or(&[], Vec::as_slice)
}

fn name(stage: &Value) -> String {
    plain(&stage["id"])
}

/// Formats a value as text.
fn plain(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
        Value::Null => "unknown".into(),
        other => other.to_string(),
    }
}

fn seconds(value: &Value) -> String {
    value.as_f64().map_or_else(|| plain(value), |seconds| format!("{seconds:.1}"))
}

fn capitalised(words: &str) -> String {
    let mut letters = words.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::overview::histogram::Bins;

    /// Grades with 1000 deviation ratios, most of them at `usual` and `percent` of them at `rare`.
    fn grades(usual: f64, rare: f64, percent: usize) -> Vec<Grade> {
        let mut bins = Bins::linear(-10.0, 0.25, 240);
        (0..1000).for_each(|i| bins.add(if i < 10 * percent { rare } else { usual }));
        let found = bins.finish("deviation ratio", "");
        deviation_checks(found.as_ref()).into_iter().map(|check| check.grade).collect()
    }

    #[test]
    fn deviation_ratios_are_judged_on_both_sides_and_at_their_centre() {
        let (good, look, bad) = (Grade::Good, Grade::Look, Grade::Bad);
        assert_eq!(grades(0.1, 0.1, 0), [good, good, good]);
        assert_eq!(grades(0.1, 40.0, 30), [bad, good, good]);
        assert_eq!(grades(0.1, -6.0, 30), [good, bad, good]);
        assert_eq!(grades(0.1, -45.0, 3), [good, look, good]);
        assert_eq!(grades(-2.1, 0.1, 0), [good, good, look]);
        // A median outside the bins is bad, not unknown.
        assert_eq!(grades(-18.0, 0.1, 0), [good, bad, bad]);
        assert_eq!(grades(819.0, 0.1, 0), [bad, good, bad]);
    }
}
