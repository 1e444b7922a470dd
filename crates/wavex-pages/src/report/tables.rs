//! Tables of the stages of one input, as text.

use std::fmt::Write;

use serde_json::Value;

use super::RunReport;
use wavex_engine::engine::{InputStatus, InputSummary};
use wavex_line::stage::{Measured, SurveyModels};

/// Table of the inputs of a run: status, points, time, reason of a failure.
pub fn input_table(report: &RunReport) -> String {
    let inputs = &report.run.inputs;
    let width = inputs.iter().map(|input| input.stem.chars().count()).max().unwrap_or(0).max(5);
    let mut text = format!("{:width$} {:7} {:>11} {:>9} reason\n", "input", "status", "points", "time s");
    for (number, input) in inputs.iter().enumerate() {
        let entry =
            report.inputs.get(number).and_then(|entry| entry.without_model().ok()).unwrap_or_default();
        let (points, time) = match input.status {
            InputStatus::NotRun => (String::new(), String::new()),
            _ => (points(&entry).to_string(), format!("{:.1}", entry["wall_s"].as_f64().unwrap_or(0.0))),
        };
        let reason = input.failure.as_deref().unwrap_or_default();
        let status = input.status.words();
        let row = format!("{:width$} {status:7} {points:>11} {time:>9} {reason}", input.stem);
        let _ = writeln!(text, "{}", row.trim_end());
    }
    text
}

/// Table of a survey's sensor models: each receiver by each input alone, and which model it has.
pub fn survey_table(models: &SurveyModels) -> String {
    let mut text = String::new();
    for (number, instrument) in models.instruments.iter().enumerate() {
        let _ = writeln!(text, "{}: model from {} inputs", instrument.instrument, instrument.inputs);
        let rows = || models.inputs.iter().filter(|input| input.instrument == Some(number));
        let width = rows().map(|input| input.stem.chars().count()).max().unwrap_or(0).max(5);
        let _ = writeln!(
            text,
            "  {:width$} {:14} {:>16} {:>14} {:>16} model",
            "input", "receiver", "background DN", "noise DN", "pulse width ns"
        );
        for input in rows() {
            let model = match &input.own_model {
                Some(reason) => format!("its own: {reason}"),
                None => "of the survey".to_owned(),
            };
            let known = input.channels().into_iter().filter_map(|(name, found)| Some((name, found?)));
            for (name, found) in known {
                let words = |measured: Measured, digits| {
                    format!("{:.digits$} ± {:.digits$}", measured.value, measured.sd)
                };
                let _ = writeln!(
                    text,
                    "  {:width$} {name:14} {:>16} {:>14} {:>16} {model}",
                    input.stem,
                    words(found.background_dn, 3),
                    words(found.noise_sd_dn, 3),
                    words(found.pulse_fwhm_ns, 3)
                );
            }
        }
        for note in &instrument.notes {
            let _ = writeln!(text, "  {note}");
        }
    }
    for input in models.inputs.iter().filter(|input| input.instrument.is_none()) {
        let _ = writeln!(text, "{}: could not be read", input.stem);
    }
    text
}

/// Number of returns or points of an input that left the chain.
pub(super) fn points(entry: &Value) -> u64 {
    let last = entry["stages"].as_array().and_then(|stages| stages.last());
    last.and_then(|stage| stage["items_out"]["returns"].as_u64()).unwrap_or(0)
}

/// Table of the stages: items and times.
pub fn stage_table(input: &InputSummary) -> String {
    let mut text = String::new();
    let width = input.stages.iter().map(|stage| stage.id.len()).max().unwrap_or(0).max(5);
    let _ = writeln!(
        text,
        "{:width$} {:>7} {:>9} {:>11} {:>11} {:>9} {:>9} {:>9} {:>9} {:>6}",
        "stage",
        "workers",
        "lines",
        "shots",
        "returns",
        "rejected",
        "working s",
        "waiting s",
        "blocked s",
        "busy"
    );
    for stage in &input.stages {
        let rejected: u64 = stage.rejected.values().sum();
        let mark = if input.bottleneck().is_some_and(|slowest| slowest.id == stage.id) {
            " <- bottleneck"
        } else {
            ""
        };
        let _ = writeln!(
            text,
            "{:width$} {:>7} {:>9} {:>11} {:>11} {:>9} {:>9.3} {:>9.3} {:>9.3} {:>5.0}%{mark}",
            stage.id,
            stage.workers,
            stage.lines_out,
            stage.items_out.shots,
            stage.items_out.returns,
            rejected,
            stage.working_s,
            stage.waiting_s,
            stage.blocked_s,
            100.0 * stage.load(input.wall_s),
        );
    }
    text
}

/// Table of working times per scan line, in percentiles.
pub fn latency_table(input: &InputSummary) -> String {
    let mut text = String::new();
    let width = input.stages.iter().map(|stage| stage.id.len()).max().unwrap_or(0).max(5);
    let _ = writeln!(
        text,
        "{:width$} {:>11} {:>11} {:>11} {:>11} {:>11} {:>11}",
        "us per line", "mean", "p50", "p90", "p99", "p99.9", "max"
    );
    for stage in &input.stages {
        let us = &stage.line_us;
        let _ = writeln!(
            text,
            "{:width$} {:>11.1} {:>11.1} {:>11.1} {:>11.1} {:>11.1} {:>11.1}",
            stage.id, us.mean, us.p50, us.p90, us.p99, us.p999, us.max
        );
    }
    text
}
