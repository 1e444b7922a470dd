//! The page of a run: one file without scripts that needs no network.

use std::fmt::Write;

use serde_json::Value;

use super::pictures::{response, times};
use crate::cli::scan::page::STYLE;
use crate::cli::svg::escaped;

/// What the page of a run has besides the looks of a recording's.
const MORE_STYLE: &str = "\
.wide th,.wide td{text-align:right;padding:3px 8px;border-top:1px solid var(--rule);width:auto}
.wide th:first-child,.wide td:first-child{text-align:left}.wide{margin-bottom:14px}
.working{fill:var(--low)}.waiting{fill:var(--grid);stroke:var(--frame)}.blocked{fill:var(--high)}
.notes li{margin:4px 0}
";

/// The page of a report, as HTML. What a report lacks is left out.
pub(super) fn page(report: &Value) -> String {
    let mut page = format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\"/>\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\"/>\n<title>wavex report</title>\n\
         <style>\n{STYLE}{MORE_STYLE}</style>\n</head>\n<body>\n<h1>Report of a run</h1>\n\
         <p class=\"about\">wavex {}, {} threads, {} s</p>\n",
        text(&report["wavex"]),
        text(&report["threads"]),
        text(&report["wall_s"])
    );
    let keys = list(report, "stages").iter().map(|stage| (name(stage), stage["keys"].to_string()));
    section(&mut page, "What was run", keys);
    for input in list(report, "inputs") {
        of_input(&mut page, input);
    }
    page.push_str("</body>\n</html>\n");
    page
}

fn of_input(page: &mut String, input: &Value) {
    let _ = writeln!(page, "<h1>{}</h1>", text(&input["stem"]));
    page.push_str("<div class=\"sections\">\n");
    let facts = ["path", "format", "instrument", "serial", "sampling_interval_ns", "time_scale", "frame"];
    let more = ["emission_reference", "coordinates", "wall_s", "peak_in_flight_bytes"];
    let known = facts.iter().chain(&more).filter(|key| !input[**key].is_null());
    section(page, "Input", known.map(|key| (key.replace('_', " "), plain(&input[*key]))));
    section(page, "Counts of all lines", entries(&input["totals"]));
    section(page, "Trajectory", entries(&input["trajectory"]));
    for channel in CHANNELS {
        let model = &input["sensor_model"][channel];
        let told = ["noise_sd_dn", "autocorrelation", "background_dn", "pulse_fwhm_ns", "waveforms"];
        let rows = told.iter().filter(|_| model.is_object());
        let title = format!("Sensor model, {}", channel.replace('_', " "));
        section(page, &title, rows.map(|key| (key.replace('_', " "), plain(&model[*key]))));
    }
    section(page, "Written", list(input, "outputs").iter().map(|file| ("file".to_owned(), plain(file))));
    page.push_str("</div>\n");
    notes(page, input);
    stages(page, input);
    observed(page, input);
    page.push_str("<div class=\"figures\">\n");
    figure(page, "Time of each stage, all workers together", Some(times(list(input, "stages"))));
    for channel in CHANNELS {
        let title = format!("System response and its error, {}", channel.replace('_', " "));
        figure(page, &title, response(&input["sensor_model"][channel]["response"]));
    }
    page.push_str("</div>\n");
}

/// The receivers of a sensor model that have a picture.
const CHANNELS: [&str; 3] = ["low_power", "high_power", "reference"];

/// A titled table of names and values, where there are any.
fn section(page: &mut String, title: &str, rows: impl Iterator<Item = (String, String)>) {
    let rows: Vec<String> = rows
        .map(|(name, value)| format!("<tr><td>{}</td><td>{}</td></tr>\n", escaped(&name), escaped(&value)))
        .collect();
    if !rows.is_empty() {
        let (title, rows) = (escaped(title), rows.concat());
        let _ = write!(page, "<section>\n<h2>{title}</h2>\n<table>\n{rows}</table>\n</section>\n");
    }
}

fn figure(page: &mut String, title: &str, svg: Option<String>) {
    if let Some(svg) = svg {
        let _ = write!(page, "<figure>\n<h3>{}</h3>\n{svg}</figure>\n", escaped(title));
    }
}

/// What stages had to say, and what they rejected.
fn notes(page: &mut String, input: &Value) {
    let mut lines = Vec::new();
    for stage in list(input, "stages") {
        lines.extend(list(stage, "notes").iter().map(|note| format!("{}: {}", name(stage), plain(note))));
        let rejected = entries(&stage["rejected"]);
        lines.extend(rejected.map(|(what, n)| format!("{}: rejected {n} {what}", name(stage))));
    }
    if !lines.is_empty() {
        let items: String = lines.iter().map(|line| format!("<li>{}</li>\n", escaped(line))).collect();
        let _ =
            write!(page, "<section>\n<h2>Warnings</h2>\n<ul class=\"notes\">\n{items}</ul>\n</section>\n");
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
    let heads = ["quantity", "count", "mean", "half below", "90 % below", "99 % below", "largest"];
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

/// A table of rows of numbers behind a name, where there are any.
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

/// The entries of an object; none of anything else.
fn entries(value: &Value) -> impl Iterator<Item = (String, String)> + '_ {
    value.as_object().into_iter().flatten().map(|(key, value)| (key.clone(), plain(value)))
}

fn name(stage: &Value) -> String {
    plain(&stage["id"])
}

/// A value as one writes it.
fn plain(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
        Value::Null => "not known".into(),
        other => other.to_string(),
    }
}

/// The same as HTML holds it.
fn text(value: &Value) -> String {
    escaped(&plain(value))
}
