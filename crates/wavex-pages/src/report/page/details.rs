//! Tables of a run's page: stages, measured quantities, input, counters, sensor model, job.

use maud::{Markup, html};
use serde_json::Value;

use super::{CHANNELS, list, name, plain, section, table, words};
use crate::numbers::{label, short, with_unit};

/// Lists the keys of the job and of its stages.
pub(super) fn all_keys(report: &Value) -> Markup {
    let keys = |table: &Value| {
        let given = table.as_object().into_iter().flatten().filter(|(_, value)| !value.is_null());
        given.map(|(key, value)| format!("{key} = {value}")).collect::<Vec<String>>().join(", ")
    };
    let stages = list(report, "stages").iter().map(|stage| (name(stage), keys(&stage["keys"])));
    let job = report["job"].is_object().then(|| ("job".to_owned(), keys(&report["job"])));
    section("Keys, defaults included", job.into_iter().chain(stages))
}

/// Table of the stages: items and times.
pub(super) fn stages(input: &Value) -> Markup {
    let heads = ["stage", "workers", "lines", "shots", "returns", "working, s", "waiting, s", "blocked, s"];
    let rows = list(input, "stages").iter().map(|stage| {
        let out = &stage["items_out"];
        let count = |value: &Value| label(value.as_f64().unwrap_or(0.0), 0);
        let seconds = |key: &str| label(stage[key].as_f64().unwrap_or(0.0), 3);
        vec![
            name(stage),
            count(&stage["workers"]),
            count(&stage["lines_out"]),
            count(&out["shots"]),
            count(&out["returns"]),
            seconds("working_s"),
            seconds("waiting_s"),
            seconds("blocked_s"),
        ]
    });
    table("Stages", &heads, rows)
}

/// Table of the quantities that stages measured.
pub(super) fn observed(input: &Value) -> Markup {
    let heads = ["quantity", "stage", "count", "mean", "median", "90 % below", "99 % below", "maximum"];
    let of_stage = |stage: &Value| {
        let stage_name = name(stage);
        let observed = stage["observed"].as_object().into_iter().flatten();
        let row = |(quantity, summary): (&String, &Value)| {
            let number = |key: &str| summary[key].as_f64().map_or_else(|| "unknown".to_owned(), short);
            let mut row = vec![
                titled(quantity),
                stage_name.clone(),
                label(summary["count"].as_f64().unwrap_or(0.0), 0),
            ];
            row.extend(["mean", "p50", "p90", "p99", "max"].map(number));
            row
        };
        observed.map(row).collect::<Vec<_>>()
    };
    table("Measured", &heads, list(input, "stages").iter().flat_map(of_stage))
}

/// Name of a key with its unit.
fn titled(key: &str) -> String {
    match words::of_key(key) {
        (name, "") => name,
        (name, unit) => format!("{name}, {unit}"),
    }
}

/// Row of a key: its name and its value with the unit.
fn row(key: &str, value: &Value) -> (String, String) {
    let (name, unit) = words::of_key(key);
    let text = match value {
        Value::Array(items) => items.iter().map(number).collect::<Vec<String>>().join(", "),
        Value::Number(_) => number(value),
        Value::String(text) => words::of_choice(text),
        other => plain(other),
    };
    (name, with_unit(&text, unit))
}

/// Formats a number: whole numbers and numbers from 1000 on in full, others with three significant digits.
fn number(value: &Value) -> String {
    match value.as_f64() {
        Some(number) if number.fract() == 0.0 => label(number, 0),
        Some(number) if number.abs() >= 1e5 => label(number, 2),
        Some(number) => short(number),
        None => plain(value),
    }
}

/// Shows a table of each channel of a sensor model.
pub(super) fn of_channels(model: &Value) -> Markup {
    let of_channel = |(key, channel): (&str, &str)| {
        let model = &model[key];
        let keys = ["noise_sd_dn", "autocorrelation", "background_dn", "pulse_fwhm_ns", "waveforms"];
        let rows = keys.iter().filter(|_| model.is_object()).map(|key| row(key, &model[*key]));
        section(&format!("Sensor model, {channel}"), rows)
    };
    html! { @for channel in CHANNELS { (of_channel(channel)) } }
}

/// Shows tables of the remaining values.
pub(super) fn tables(input: &Value) -> Markup {
    let facts = ["path", "format", "instrument", "serial", "sampling_interval_ns", "group_velocity_mps"];
    let more = ["time_scale", "frame", "emission_reference", "ranges_count_from", "coordinates"];
    let of_run = ["started", "ended", "wall_s", "peak_in_flight_bytes"];
    let keys = facts.into_iter().chain(more).chain(of_run);
    let known = keys.filter(|key| !input[*key].is_null() && input[*key] != "");
    let counted = words::counters()
        .filter_map(|(key, name)| Some((name.to_owned(), number(input["totals"].get(key)?))));
    let filtered = input["filtered_by_reason"].as_object().into_iter().flatten();
    let filtered = filtered.filter(|(_, n)| n.as_u64() != Some(0));
    let trajectory = input["trajectory"].as_object().into_iter().flatten();
    html! {
        div.sections {
            (section("Input", known.map(|key| row(key, &input[key]))))
            (section("Counters", counted))
            (section("Candidates rejected, by reason", filtered.map(|(reason, n)| (reason.clone(), number(n)))))
            (section("Trajectory", trajectory.map(|(key, value)| row(key, value))))
            (of_channels(&input["sensor_model"]))
            (section("Outputs", list(input, "outputs").iter().map(|file| ("file".to_owned(), plain(file)))))
        }
    }
}
