//! HTML page of a run; needs no network or scripts.

use std::fmt::Write;

use serde_json::Value;

use super::overview::Overview;
use super::style::{RUN_STYLE, STYLE};
use super::svg::escaped;
use plot::{label, short};

mod plot;
mod results;
mod stages_and_sensor;
mod waveforms;

/// Content security policy: only styles and pictures embedded in the page.
const POLICY: &str = "default-src 'none'; style-src 'unsafe-inline'; img-src data:";

/// Renders a report as HTML; omits what the report lacks.
///
/// # Errors
/// If the overview of an input is invalid: names the input and the reason.
pub(super) fn page(report: &Value) -> Result<String, String> {
    let inputs = list(report, "inputs");
    let names: Vec<String> = inputs.iter().map(|input| plain(&input["stem"])).collect();
    let title = escaped(&format!("wavex report: {}", names.join(", ")));
    let mut page = format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\"/>\n\
         <meta http-equiv=\"Content-Security-Policy\" content=\"{POLICY}\"/>\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\"/>\n<title>{title}</title>\n\
         <style>\n{STYLE}{RUN_STYLE}</style>\n</head>\n<body>\n<h1>Report of a run</h1>\n\
         <p class=\"about\">wavex {}, {} threads, {} s</p>\n",
        text(&report["wavex"]),
        text(&report["threads"]),
        seconds(&report["wall_s"]),
    );
    let chain: Vec<String> = list(report, "stages").iter().map(name).collect();
    let _ = writeln!(page, "<p class=\"chain\">{}</p>", escaped(&chain.join(" → ")));
    for (number, input) in inputs.iter().enumerate() {
        of_input(&mut page, input, number)?;
    }
    what_was_run(&mut page, report);
    page.push_str("</body>\n</html>\n");
    Ok(page)
}

/// Lists the keys of the job and of its stages.
fn what_was_run(page: &mut String, report: &Value) {
    let keys = |table: &Value| {
        let given = table.as_object().into_iter().flatten().filter(|(_, value)| !value.is_null());
        given.map(|(key, value)| format!("{key} = {value}")).collect::<Vec<String>>().join(", ")
    };
    page.push_str("<div class=\"job\">\n");
    let stages = list(report, "stages").iter().map(|stage| (name(stage), keys(&stage["keys"])));
    let job = report["job"].is_object().then(|| ("job".to_owned(), keys(&report["job"])));
    section(page, "Job with all keys", job.into_iter().chain(stages));
    page.push_str("</div>\n");
}

fn of_input(page: &mut String, input: &Value, number: usize) -> Result<(), String> {
    let stem = plain(&input["stem"]);
    let overview: Option<Overview> = match &input["overview"] {
        Value::Null => None,
        value => Some(
            serde_json::from_value(value.clone())
                .map_err(|error| format!("the overview of {stem:?} is invalid: {error}"))?,
        ),
    };
    let _ = writeln!(page, "<h1 class=\"input\">{}</h1>", escaped(&stem));
    key_figures(page, input);
    notes(page, input);
    if let Some(overview) = &overview {
        from_above(page, overview, input, number);
        of_returns(page, overview);
        of_zones(page, overview);
        of_waveforms(page, overview);
    }
    of_run(page, input);
    of_sensor(page, &input["sensor_model"]);
    tables(page, input);
    Ok(())
}

/// Shows the key figures of an input.
fn key_figures(page: &mut String, input: &Value) {
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
    page.push_str("<div class=\"tiles\">\n");
    for (what, value) in figures {
        if let Some(value) = value {
            let _ = writeln!(page, "<div><b>{}</b><span>{what}</span></div>", escaped(&value));
        }
    }
    page.push_str("</div>\n");
}

/// Working time per worker of a stage.
fn load(stage: &Value) -> f64 {
    stage["working_s"].as_f64().unwrap_or(0.0) / stage["workers"].as_f64().unwrap_or(1.0).max(1.0)
}

/// Lists warnings and rejections, then findings that need no action.
fn notes(page: &mut String, input: &Value) {
    let (mut warnings, mut findings) = (String::new(), String::new());
    let add = |items: &mut String, stage: &Value, said: &str| {
        let _ = writeln!(items, "<li><b>{}</b>: {}</li>", escaped(&name(stage)), escaped(said));
    };
    for stage in list(input, "stages") {
        list(stage, "notes").iter().for_each(|note| add(&mut warnings, stage, &plain(note)));
        list(stage, "findings").iter().for_each(|finding| add(&mut findings, stage, &plain(finding)));
        for (what, n) in entries(&stage["rejected"]) {
            match list(stage, "set_aside").iter().any(|other| *other == what) {
                true => add(&mut findings, stage, &format!("set aside {n} {what}")),
                false => add(&mut warnings, stage, &format!("rejected {n} {what}")),
            }
        }
    }
    let body = match warnings.as_str() {
        "" => "<p>None: no warnings and no rejected items.</p>\n".to_owned(),
        items => format!("<ul class=\"notes\">\n{items}</ul>\n"),
    };
    let _ = write!(page, "<section>\n<h2>Warnings</h2>\n{body}</section>\n");
    if !findings.is_empty() {
        let body = format!("<ul class=\"notes\">\n{findings}</ul>\n");
        let _ = write!(page, "<section>\n<h2>Findings</h2>\n{body}</section>\n");
    }
}

fn from_above(page: &mut String, overview: &Overview, input: &Value, number: usize) {
    let mut figures = Vec::new();
    let mut about = String::new();
    if let Some(map) = &overview.map {
        let name = format!("intensities-{number}");
        let axes = results::axes(map, input["frame"].as_str());
        figures.push(figure(
            "Points by height",
            &results::heights(map, &axes, &format!("heights-{number}")),
            "",
        ));
        figures.push(figure("Points by intensity", &results::intensities(map, &axes, &name), ""));
        let zones = results::zones(map, &axes, &format!("zones-{number}"));
        figures.extend(zones.map(|svg| figure("Points by MTA zone", &svg, "")));
        let words = "some scan lines; dot: middle of the first line";
        figures.extend(
            results::swath(map, &axes, &name).map(|svg| figure("Swath on the map grid", &svg, words)),
        );
        about = results::about(map, input["coordinates"].as_str());
    }
    let along = results::along(&overview.lines);
    let words = match overview.lines.lines_per_group {
        0 | 1 => String::new(),
        lines => format!("means over {lines} lines"),
    };
    figures.extend(along.map(|svg| figure("Waveforms and returns along the flight", &svg, &words)));
    group(page, "Map views", &about, &figures);
}

fn of_returns(page: &mut String, overview: &Overview) {
    let drawn = overview.histograms.iter().filter_map(|histogram| {
        let (svg, words) = results::histogram(histogram)?;
        Some(figure(&capitalised(&histogram.quantity), &svg, &words))
    });
    group(page, "Returns", "", &drawn.collect::<Vec<String>>());
}

/// Shows the share of each MTA zone, and the recording computed with each zone.
fn of_zones(page: &mut String, overview: &Overview) {
    let Some(zones) = &overview.zones else { return };
    let all: u64 = zones.shares.iter().map(|share| share.returns).sum();
    let percent = |part: u64, of: u64| format!("{:.2}", 100.0 * part as f64 / of.max(1) as f64);
    let rows = zones.shares.iter().map(|share| {
        let zone = if share.zone < 0 { "unresolved".to_owned() } else { share.zone.to_string() };
        let [returns, uncertain] = [share.returns, share.uncertain].map(|count| label(count as f64, 0));
        vec![zone, returns, percent(share.returns, all), uncertain, percent(share.uncertain, share.returns)]
    });
    if let Some(clouds) = &zones.clouds {
        let words = format!(
            "range (m) against shot: the middle of scan line {}, with all echoes in one zone. Above each plot: median difference of \
             neighbouring ranges, which is smallest for the correct zone if pulse intervals vary",
            clouds.line
        );
        let drawn = figure("Range with each MTA zone", &results::clouds(clouds), &words);
        group(page, "Multiple time around", "", &[drawn]);
    }
    let heads = ["zone", "returns", "% of all", "uncertain", "% of the zone"];
    table(page, "Returns by MTA zone", &heads, rows);
}

fn of_waveforms(page: &mut String, overview: &Overview) {
    let figures: Vec<String> = overview.waveforms.iter().map(waveforms::figure).collect();
    if !figures.is_empty() {
        group(page, "Waveforms and their fits", "", &[waveforms::legend(), figures.concat()]);
    }
}

fn of_run(page: &mut String, input: &Value) {
    let words = "sum over all workers of a stage; waiting: for input lines; blocked: by the next stage";
    let times = figure("Time per stage", &stages_and_sensor::times(list(input, "stages")), words);
    group(page, "Run", "", &[times]);
    stages(page, input);
    observed(page, input);
}

/// Channels of a sensor model that are shown, with their names.
const CHANNELS: [(&str, &str); 3] =
    [("low_power", "low power"), ("high_power", "high power"), ("reference", "outgoing pulse")];

fn of_sensor(page: &mut String, model: &Value) {
    let mut figures = Vec::new();
    for (key, channel) in CHANNELS {
        let response = stages_and_sensor::response(&model[key]["response"]);
        figures.extend(
            response.map(|svg| {
                figure(&format!("System response, {channel}"), &svg, "at each calibrated amplitude")
            }),
        );
        let noise = stages_and_sensor::noise(&model[key]);
        let sd = model[key]["noise_sd_dn"].as_f64().unwrap_or(0.0);
        let words = format!("noise SD {} DN; bars: two standard deviations", short(sd));
        figures.extend(noise.map(|svg| figure(&format!("Noise, {channel}"), &svg, &words)));
    }
    group(page, "Sensor model", "", &figures);
}

/// Shows tables of the remaining values.
fn tables(page: &mut String, input: &Value) {
    page.push_str("<div class=\"sections\">\n");
    let facts = ["path", "format", "instrument", "serial", "sampling_interval_ns", "time_scale", "frame"];
    let more = ["emission_reference", "ranges_count_from", "coordinates", "wall_s", "peak_in_flight_bytes"];
    let known = facts.iter().chain(&more).filter(|key| !input[**key].is_null());
    section(page, "Input", known.map(|key| (key.replace('_', " "), plain(&input[*key]))));
    section(page, "Totals", entries(&input["totals"]));
    section(page, "Trajectory", entries(&input["trajectory"]));
    for (key, channel) in CHANNELS {
        let model = &input["sensor_model"][key];
        let told = ["noise_sd_dn", "autocorrelation", "background_dn", "pulse_fwhm_ns", "waveforms"];
        let rows = told.iter().filter(|_| model.is_object());
        let title = format!("Sensor model, {channel}");
        section(page, &title, rows.map(|key| (key.replace('_', " "), rounded(&model[*key]))));
    }
    section(page, "Outputs", list(input, "outputs").iter().map(|file| ("file".to_owned(), plain(file))));
    page.push_str("</div>\n");
}

/// Writes a titled group of figures; nothing if there are none.
fn group(page: &mut String, title: &str, about: &str, figures: &[String]) {
    if figures.is_empty() {
        return;
    }
    let _ = writeln!(page, "<h2 class=\"group\">{}</h2>", escaped(title));
    if !about.is_empty() {
        let _ = writeln!(page, "<p class=\"about\">{}</p>", escaped(about));
    }
    let _ = write!(page, "<div class=\"figures\">\n{}</div>\n", figures.concat());
}

/// Formats a figure with title and caption.
fn figure(title: &str, svg: &str, words: &str) -> String {
    let words = match words {
        "" => String::new(),
        words => format!("<figcaption>{}</figcaption>\n", escaped(words)),
    };
    format!("<figure>\n<h3>{}</h3>\n{svg}{words}</figure>\n", escaped(title))
}

/// Writes a titled table of names and values; nothing if it is empty.
fn section(page: &mut String, title: &str, rows: impl Iterator<Item = (String, String)>) {
    let rows: Vec<String> = rows
        .map(|(name, value)| format!("<tr><td>{}</td><td>{}</td></tr>\n", escaped(&name), escaped(&value)))
        .collect();
    if !rows.is_empty() {
        let (title, rows) = (escaped(title), rows.concat());
        let _ = write!(page, "<section>\n<h2>{title}</h2>\n<table>\n{rows}</table>\n</section>\n");
    }
}

fn stages(page: &mut String, input: &Value) {
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
    table(page, "Stages", &heads, rows);
}

fn observed(page: &mut String, input: &Value) {
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
    table(page, "Measured", &heads, list(input, "stages").iter().flat_map(of_stage));
}

/// Writes a titled table with header; nothing if it has no rows.
fn table(page: &mut String, title: &str, heads: &[&str], rows: impl Iterator<Item = Vec<String>>) {
    let row = |cells: Vec<String>| {
        let cells: String = cells.iter().map(|cell| format!("<td>{}</td>", escaped(cell))).collect();
        format!("<tr>{cells}</tr>\n")
    };
    let rows: String = rows.map(row).collect();
    if !rows.is_empty() {
        let heads: String = heads.iter().map(|head| format!("<th>{head}</th>")).collect();
        let _ = write!(
            page,
            "<section>\n<h2>{title}</h2>\n<table class=\"wide\">\n<tr>{heads}</tr>\n{rows}</table>\n</section>\n"
        );
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

/// Formats a value as escaped HTML.
fn text(value: &Value) -> String {
    escaped(&plain(value))
}
