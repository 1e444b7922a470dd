//! HTML page of a run; needs no network or scripts.

use maud::{DOCTYPE, Markup, PreEscaped, html};
use serde_json::Value;

use super::overview::Overview;
use super::style::{RUN_STYLE, STYLE};
use super::tables::points;
use plot::{label, short};

pub(super) mod drift;
pub(super) mod plot;
mod results;
mod stages_and_sensor;
mod waveforms;

/// Content security policy: only styles and pictures embedded in the page.
const POLICY: &str = "default-src 'none'; style-src 'unsafe-inline'; img-src data:";

/// An input whose overview cannot be shown.
#[derive(Debug, thiserror::Error)]
#[error("the overview of {stem:?} is invalid: {source}")]
pub(super) struct InvalidOverview {
    stem: String,
    source: serde_json::Error,
}

/// Renders a report as HTML; omits what the report lacks.
///
/// # Errors
/// If the overview of an input is invalid.
pub(super) fn page(report: &Value) -> Result<String, InvalidOverview> {
    let inputs = list(report, "inputs");
    let names: Vec<String> = inputs.iter().map(|input| plain(&input["stem"])).collect();
    let chain: Vec<String> = list(report, "stages").iter().map(name).collect();
    let was_run = (0..).zip(inputs).filter(|(_, input)| input["status"] != "not_run");
    let parts: Vec<Markup> = was_run.map(of_input).collect::<Result<_, _>>()?;
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            (head(&format!("wavex report: {}", names.join(", ")), ""))
            body {
                h1 { "Report of a run" }
                p.about {
                    "wavex " (plain(&report["wavex"])) ", " (plain(&report["threads"])) " threads, "
                    (seconds(&report["wall_s"])) " s"
                }
                p.chain { (chain.join(" → ")) }
                (of_inputs(inputs))
                (drift::of_survey(&report["survey_models"]))
                @for part in parts { (part) }
                div.job { (all_keys(report)) }
            }
        }
    };
    Ok(page.into_string())
}

/// Head of a page about a run or a survey, with further styles.
pub(super) fn head(title: &str, style: &str) -> Markup {
    html! {
        head {
            meta charset="utf-8";
            meta http-equiv="Content-Security-Policy" content=(POLICY);
            meta name="viewport" content="width=device-width, initial-scale=1";
            title { (title) }
            style { (PreEscaped(STYLE)) (PreEscaped(RUN_STYLE)) (PreEscaped(style)) }
        }
    }
}

/// Lists the keys of the job and of its stages.
fn all_keys(report: &Value) -> Markup {
    let keys = |table: &Value| {
        let given = table.as_object().into_iter().flatten().filter(|(_, value)| !value.is_null());
        given.map(|(key, value)| format!("{key} = {value}")).collect::<Vec<String>>().join(", ")
    };
    let stages = list(report, "stages").iter().map(|stage| (name(stage), keys(&stage["keys"])));
    let job = report["job"].is_object().then(|| ("job".to_owned(), keys(&report["job"])));
    section("Job with all keys", job.into_iter().chain(stages))
}

/// Table of several inputs: status, points, time, reason of a failure.
fn of_inputs(inputs: &[Value]) -> Markup {
    let row = |input: &Value| {
        let points = points(input).to_string();
        let status = plain(&input["status"]).replace('_', " ");
        let reason = input["failure"].as_str().unwrap_or_default().to_owned();
        vec![plain(&input["stem"]), status, points, seconds(&input["wall_s"]), reason]
    };
    let several = if inputs.len() > 1 { inputs } else { &[] };
    table("Inputs", &["input", "status", "points", "time, s", "reason"], several.iter().map(row))
}

fn of_input((number, input): (usize, &Value)) -> Result<Markup, InvalidOverview> {
    let stem = plain(&input["stem"]);
    let overview: Option<Overview> = match &input["overview"] {
        Value::Null => None,
        value => Some(
            serde_json::from_value(value.clone())
                .map_err(|source| InvalidOverview { stem: stem.clone(), source })?,
        ),
    };
    Ok(html! {
        h1.input { (stem) }
        @if let Some(failure) = input["failure"].as_str() { section { h2 { "Failed" } p { (failure) } } }
        (key_figures(input))
        (notes(input))
        @if let Some(overview) = &overview {
            (from_above(overview, input, number))
            (of_returns(overview))
            (of_zones(overview))
            (of_waveforms(overview))
        }
        (of_run(input))
        (of_sensor(&input["sensor_model"]))
        (tables(input))
    })
}

/// Shows the key figures of an input.
fn key_figures(input: &Value) -> Markup {
    let total = |key: &str| input["totals"][key].as_u64();
    let wall_s = input["wall_s"].as_f64().filter(|wall_s| *wall_s > 0.0);
    let lines = list(input, "stages").last().and_then(|stage| stage["lines_out"].as_u64());
    let count = |value: Option<u64>| value.map(|value| label(value as f64, 0));
    let rate = total("nw").zip(wall_s).map(|(waveforms, wall_s)| label(waveforms as f64 / wall_s, 0));
    let busiest = list(input, "stages").iter().max_by(|a, b| load(a).total_cmp(&load(b)));
    let figures = [
        ("scan lines", count(lines)),
        ("waveforms", count(total("nw"))),
        ("returns", count(total("np"))),
        ("points", count(total("n_georef"))),
        ("duration", wall_s.map(|wall_s| format!("{} s", short(wall_s)))),
        ("waveforms per second", rate),
        ("slowest stage", busiest.map(name)),
    ];
    html! {
        div.tiles {
            @for (what, value) in figures {
                @if let Some(value) = value { div { b { (value) } span { (what) } } }
            }
        }
    }
}

/// Working time per worker of a stage.
fn load(stage: &Value) -> f64 {
    stage["working_s"].as_f64().unwrap_or(0.0) / stage["workers"].as_f64().unwrap_or(1.0).max(1.0)
}

/// Lists warnings and rejections, then findings that need no action.
fn notes(input: &Value) -> Markup {
    let (mut warnings, mut findings) = (Vec::new(), Vec::new());
    for stage in list(input, "stages") {
        let of_stage = |text: String| (name(stage), text);
        warnings.extend(list(stage, "notes").iter().map(plain).map(of_stage));
        findings.extend(list(stage, "findings").iter().map(plain).map(of_stage));
        for (what, n) in entries(&stage["rejected"]) {
            match list(stage, "set_aside").iter().any(|other| *other == what) {
                true => findings.push(of_stage(format!("set aside {n} {what}"))),
                false => warnings.push(of_stage(format!("rejected {n} {what}"))),
            }
        }
    }
    let listed = |items: &[(String, String)]| {
        html! { ul.notes { @for (stage, text) in items { li { b { (stage) } ": " (text) } } } }
    };
    html! {
        section {
            h2 { "Warnings" }
            @if warnings.is_empty() { p { "None: no warnings and no rejected items." } }
            @else { (listed(&warnings)) }
        }
        @if !findings.is_empty() { section { h2 { "Findings" } (listed(&findings)) } }
    }
}

fn from_above(overview: &Overview, input: &Value, number: usize) -> Markup {
    let mut figures = Vec::new();
    let mut about = String::new();
    if let Some(map) = &overview.map {
        let name = format!("intensities-{number}");
        let axes = results::axes(map, input["frame"].as_str());
        let heights = results::heights(map, &axes, &format!("heights-{number}"));
        figures.push(figure("Points by height", heights, ""));
        figures.push(figure("Points by intensity", results::intensities(map, &axes, &name), ""));
        let zones = results::zones(map, &axes, &format!("zones-{number}"));
        figures.extend(zones.map(|svg| figure("Points by MTA zone", svg, "")));
        let words = "some scan lines; dot: middle of the first line";
        let swath = results::swath(map, &axes, &name);
        figures.extend(swath.map(|svg| figure("Swath on the map grid", svg, words)));
        about = results::about(map, input["coordinates"].as_str());
    }
    let along = results::along(&overview.lines);
    let words = match overview.lines.lines_per_group {
        0 | 1 => String::new(),
        lines => format!("means over {lines} lines"),
    };
    figures.extend(along.map(|svg| figure("Waveforms and returns along the flight", svg, &words)));
    group("Map views", &about, &figures)
}

fn of_returns(overview: &Overview) -> Markup {
    let drawn = overview.histograms.iter().filter_map(|histogram| {
        let (svg, words) = results::histogram(histogram)?;
        Some(figure(&capitalised(&histogram.quantity), svg, &words))
    });
    group("Returns", "", &drawn.collect::<Vec<Markup>>())
}

/// Shows the share of each MTA zone, and the recording computed with each zone.
fn of_zones(overview: &Overview) -> Markup {
    let Some(zones) = &overview.zones else { return Markup::default() };
    let all: u64 = zones.shares.iter().map(|share| share.returns).sum();
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
    html! {
        (group("Multiple time around", "", clouds.as_slice()))
        (table("Returns by MTA zone", &heads, rows))
    }
}

fn of_waveforms(overview: &Overview) -> Markup {
    let figures = overview.waveforms.iter().map(waveforms::figure);
    let figures: Vec<Markup> = std::iter::once(waveforms::legend()).chain(figures).collect();
    group("Waveforms and their fits", "", if figures.len() > 1 { &figures } else { &[] })
}

fn of_run(input: &Value) -> Markup {
    let words = "sum over all workers of a stage; waiting: for input lines; blocked: by the next stage";
    let times = figure("Time per stage", stages_and_sensor::times(list(input, "stages")), words);
    html! { (group("Run", "", &[times])) (stages(input)) (observed(input)) }
}

/// Channels of a sensor model that are shown, with their names.
const CHANNELS: [(&str, &str); 3] =
    [("low_power", "low power"), ("high_power", "high power"), ("reference", "outgoing pulse")];

fn of_sensor(model: &Value) -> Markup {
    let mut figures = Vec::new();
    for (key, channel) in CHANNELS {
        let response = stages_and_sensor::response(&model[key]["response"]);
        let title = format!("System response, {channel}");
        figures.extend(response.map(|svg| figure(&title, svg, "at each calibrated amplitude")));
        let noise = stages_and_sensor::noise(&model[key]);
        let sd = model[key]["noise_sd_dn"].as_f64().unwrap_or(0.0);
        let words = format!("noise SD {} DN; bars: two standard deviations", short(sd));
        figures.extend(noise.map(|svg| figure(&format!("Noise, {channel}"), svg, &words)));
    }
    group("Sensor model", "", &figures)
}

/// Shows a table of each channel of a sensor model.
fn of_channels(model: &Value) -> Markup {
    let of_channel = |(key, channel): (&str, &str)| {
        let model = &model[key];
        let keys = ["noise_sd_dn", "autocorrelation", "background_dn", "pulse_fwhm_ns", "waveforms"];
        let rows = keys.iter().filter(|_| model.is_object());
        let rows = rows.map(|key| (key.replace('_', " "), rounded(&model[*key])));
        section(&format!("Sensor model, {channel}"), rows)
    };
    html! { @for channel in CHANNELS { (of_channel(channel)) } }
}

/// Shows tables of the remaining values.
fn tables(input: &Value) -> Markup {
    let facts = ["path", "format", "instrument", "serial", "sampling_interval_ns", "time_scale", "frame"];
    let more = ["emission_reference", "ranges_count_from", "coordinates", "wall_s", "peak_in_flight_bytes"];
    let known = facts.iter().chain(&more).filter(|key| !input[**key].is_null());
    html! {
        div.sections {
            (section("Input", known.map(|key| (key.replace('_', " "), plain(&input[*key])))))
            (section("Totals", entries(&input["totals"])))
            (section("Trajectory", entries(&input["trajectory"])))
            (of_channels(&input["sensor_model"]))
            (section("Outputs", list(input, "outputs").iter().map(|file| ("file".to_owned(), plain(file)))))
        }
    }
}

/// A titled group of figures; empty if there are none.
pub(super) fn group(title: &str, about: &str, figures: &[Markup]) -> Markup {
    html! {
        @if !figures.is_empty() {
            h2.group { (title) }
            @if !about.is_empty() { p.about { (about) } }
            div.figures { @for figure in figures { (figure) } }
        }
    }
}

/// A figure with title and caption.
pub(super) fn figure(title: &str, svg: String, words: &str) -> Markup {
    html! {
        figure {
            h3 { (title) }
            (PreEscaped(svg))
            @if !words.is_empty() { figcaption { (words) } }
        }
    }
}

/// A titled table of names and values; empty without rows.
pub(super) fn section(title: &str, rows: impl Iterator<Item = (String, String)>) -> Markup {
    let mut rows = rows.peekable();
    html! {
        @if rows.peek().is_some() {
            section {
                h2 { (title) }
                table { @for (name, value) in rows { tr { td { (name) } td { (value) } } } }
            }
        }
    }
}

fn stages(input: &Value) -> Markup {
    let heads = ["stage", "workers", "lines", "shots", "returns", "working s", "waiting s", "blocked s"];
    let rows = list(input, "stages").iter().map(|stage| {
        let out = &stage["items_out"];
        let seconds = |key: &str| format!("{:.3}", stage[key].as_f64().unwrap_or(0.0));
        vec![
            name(stage),
            plain(&stage["workers"]),
            plain(&stage["lines_out"]),
            plain(&out["shots"]),
            plain(&out["returns"]),
            seconds("working_s"),
            seconds("waiting_s"),
            seconds("blocked_s"),
        ]
    });
    table("Stages", &heads, rows)
}

fn observed(input: &Value) -> Markup {
    let heads = ["quantity", "count", "mean", "median", "90 % below", "99 % below", "maximum"];
    let of_stage = |stage: &Value| {
        let stage_name = name(stage);
        let observed = stage["observed"].as_object().into_iter().flatten();
        let row = |(quantity, summary): (&String, &Value)| {
            let number = |key: &str| format!("{:.4}", summary[key].as_f64().unwrap_or(f64::NAN));
            let mut row = vec![format!("{stage_name}: {quantity}"), plain(&summary["count"])];
            row.extend(["mean", "p50", "p90", "p99", "max"].map(number));
            row
        };
        observed.map(row).collect::<Vec<_>>()
    };
    table("Measured", &heads, list(input, "stages").iter().flat_map(of_stage))
}

/// A titled table with header; empty without rows.
pub(super) fn table(title: &str, heads: &[&str], rows: impl Iterator<Item = Vec<String>>) -> Markup {
    let mut rows = rows.peekable();
    html! {
        @if rows.peek().is_some() { section { h2 { (title) } (wide_table(heads, rows)) } }
    }
}

/// A table with header.
fn wide_table(heads: &[&str], rows: impl Iterator<Item = Vec<String>>) -> Markup {
    html! {
        table.wide {
            tr { @for head in heads { th { (head) } } }
            @for row in rows { tr { @for cell in row { td { (cell) } } } }
        }
    }
}

fn list<'v>(value: &'v Value, key: &str) -> &'v [Value] {
    value[key].as_array().map_or(&[], Vec::as_slice)
}

/// Entries of an object; empty for any other value.
fn entries(value: &Value) -> impl Iterator<Item = (String, String)> + '_ {
    value.as_object().into_iter().flatten().map(|(key, value)| (key.clone(), plain(value)))
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

/// Formats numbers and lists of numbers with about three significant digits.
fn rounded(value: &Value) -> String {
    match value {
        Value::Array(items) => items.iter().map(rounded).collect::<Vec<String>>().join(", "),
        Value::Number(number) => number.as_f64().map_or_else(|| number.to_string(), short),
        other => plain(other),
    }
}

fn seconds(value: &Value) -> String {
    value.as_f64().map_or_else(|| plain(value), |seconds| format!("{seconds:.1}"))
}

fn capitalised(words: &str) -> String {
    let mut letters = words.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}
