//! Figures of a run and its sensor model, from the values of the report.

use serde_json::Value;

use super::plot::{Plot, WIDTH, middle_of_label, ticks};
use crate::report::svg::{Anchor, Scale, Svg};

const LEFT: f64 = 150.0;
const RIGHT: f64 = 546.0;
/// Height of a stage's row, SVG units.
const ROW: f64 = 26.0;

/// Draws working, waiting and blocked time of each stage as stacked bars.
///
/// `None` if no stage worked.
pub(super) fn times(stages: &[Value]) -> Option<String> {
    let seconds = |stage: &Value, key: &str| stage[key].as_f64().unwrap_or(0.0).max(0.0);
    let parts = ["working", "waiting", "blocked"];
    let sum = |stage: &Value| parts.iter().map(|part| seconds(stage, &format!("{part}_s"))).sum::<f64>();
    let longest = stages.iter().map(sum).reduce(f64::max).filter(|longest| *longest > 1e-6)?;
    let x = Scale { from: [0.0, longest], to: [LEFT, RIGHT] };
    let mut svg = Svg::new();
    for (index, part) in parts.iter().enumerate() {
        let left = LEFT + 120.0 * index as f64;
        svg.rect(part, [left, 6.0], [left + 12.0, 18.0]);
        svg.text("", [left + 18.0, 16.0], Anchor::Start, part);
    }
    let top_of = |row: usize| 32.0 + row as f64 * ROW;
    let bottom = top_of(stages.len());
    for (value, text) in ticks(&x, 5.0) {
        svg.line("grid", [x.at(value), 28.0], [x.at(value), bottom]);
        let text = format!("{text} s");
        svg.text("", [middle_of_label(x.at(value), &text), bottom + 15.0], Anchor::Middle, &text);
    }
    for (row, stage) in stages.iter().enumerate() {
        let top = top_of(row);
        svg.text("", [LEFT - 7.0, top + 14.0], Anchor::End, stage["id"].as_str().unwrap_or_default());
        let mut from = 0.0;
        for part in parts {
            let until = from + seconds(stage, &format!("{part}_s"));
            svg.rect(part, [x.at(from), top], [x.at(until), top + ROW - 8.0]);
            from = until;
        }
    }
    Some(svg.inline(WIDTH, bottom + 26.0, "time per stage"))
}

/// A response is drawn as far as it exceeds this fraction of its peak.
const TAIL: f64 = 0.004;
/// Tabulated values of a response per sample.
const PER_SAMPLE: f64 = 8.0;

fn numbers(list: &Value) -> Vec<f64> {
    list.as_array().into_iter().flatten().filter_map(Value::as_f64).collect()
}

/// Draws the system response at each calibrated amplitude, with its shape error.
///
/// `None` if there is no response.
pub(super) fn response(response: &Value) -> Option<String> {
    let first = response["first_sample"].as_f64()?;
    let nodes: Vec<Vec<f64>> =
        response["nodes"].as_array()?.iter().map(|node| numbers(&node["values"])).collect();
    let stands_out = |node: &Vec<f64>| node.iter().rposition(|value| value.abs() > TAIL);
    let last = nodes.iter().filter_map(stands_out).max()? as f64 / PER_SAMPLE;
    let (low, high) =
        nodes.iter().flatten().fold((0.0f64, 1.0f64), |(low, high), v| (low.min(*v), high.max(*v)));
    let plot = Plot::new([first, first + (1.1 * last).max(1.0)], [low, 1.05 * high]);
    let mut svg = Svg::new();
    plot.grid(&mut svg);
    for node in &nodes {
        let points = node.iter().enumerate().map(|(i, value)| [first + i as f64 / PER_SAMPLE, *value]);
        svg.curve("returns", plot.inside(points));
    }
    let errors = numbers(&response["template_error"]);
    let points = errors.iter().enumerate().map(|(i, error)| [first + i as f64, *error]);
    svg.curve("found", plot.inside(points));
    svg.curve("returns", [[380.0, 28.0], [402.0, 28.0]].into_iter());
    svg.text("", [408.0, 32.0], Anchor::Start, "response");
    svg.curve("found", [[380.0, 48.0], [402.0, 48.0]].into_iter());
    svg.text("", [408.0, 52.0], Anchor::Start, "shape error");
    Some(plot.finish(svg, "system response", "samples from the peak", "fraction of the peak"))
}

/// Draws the noise autocorrelation with bars of two standard deviations.
///
/// `None` if the autocorrelation was not measured.
pub(super) fn noise(channel: &Value) -> Option<String> {
    let measured = numbers(&channel["autocorrelation"]);
    let errors = numbers(&channel["uncertainty"]["autocorrelation"]);
    let lags = 1 + measured.len();
    if measured.is_empty() {
        return None;
    }
    let least = measured.iter().copied().fold(0.0, f64::min);
    let plot = Plot::new([-0.5, lags as f64 - 0.5], [(1.2 * least).min(-0.1), 1.08]);
    let mut svg = Svg::new();
    plot.grid_y(&mut svg, ticks(&plot.y, 5.0));
    let every = lags.div_ceil(12);
    plot.grid_x(&mut svg, (0..lags).step_by(every).map(|lag| (lag as f64, lag.to_string())).collect());
    let [_, zero] = plot.at([0.0, 0.0]);
    svg.line("zero", [plot.x.to[0], zero], [plot.x.to[1], zero]);
    for (lag, value) in [1.0].iter().chain(&measured).enumerate() {
        let [x, y] = plot.at([lag as f64, *value]);
        svg.line("rod", [x, zero], [x, y]);
        if let Some(error) = lag.checked_sub(1).and_then(|lag| errors.get(lag)) {
            let [low, high] = [-2.0, 2.0].map(|times| plot.at([lag as f64, value + times * error]));
            svg.line("span", low, high);
        }
        svg.circle("dot", [x, y], 3.0);
    }
    Some(plot.finish(svg, "noise autocorrelation", "lag, samples", "correlation"))
}
