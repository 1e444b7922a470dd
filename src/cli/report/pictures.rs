//! Pictures of a run.

use serde_json::Value;

use crate::cli::svg::{Anchor, Scale, Svg};

const WIDTH: f64 = 560.0;
const LEFT: f64 = 110.0;
const RIGHT: f64 = 546.0;
/// Height of a stage's bar with the room around it.
const ROW: f64 = 26.0;

/// Working, waiting and blocked time of each stage, as bars side by side.
pub(super) fn times(stages: &[Value]) -> String {
    let seconds = |stage: &Value, key: &str| stage[key].as_f64().unwrap_or(0.0).max(0.0);
    let parts = ["working", "waiting", "blocked"];
    let sum = |stage: &Value| parts.iter().map(|part| seconds(stage, &format!("{part}_s"))).sum::<f64>();
    let longest = stages.iter().map(sum).fold(1e-9, f64::max);
    let x = Scale { from: [0.0, longest], to: [LEFT, RIGHT] };
    let mut svg = Svg::new();
    for (row, stage) in stages.iter().enumerate() {
        let top = 8.0 + row as f64 * ROW;
        svg.text("", [LEFT - 7.0, top + 14.0], Anchor::End, stage["id"].as_str().unwrap_or_default());
        let mut from = 0.0;
        for part in parts {
            let until = from + seconds(stage, &format!("{part}_s"));
            svg.rect(part, [x.at(from), top], [x.at(until), top + ROW - 8.0]);
            from = until;
        }
    }
    let bottom = 12.0 + stages.len() as f64 * ROW;
    let (values, digits) = x.ticks(5.0);
    for value in values {
        svg.text("", [x.at(value), bottom + 12.0], Anchor::Middle, &format!("{value:.digits$} s"));
    }
    for (index, part) in parts.iter().enumerate() {
        let left = LEFT + 120.0 * index as f64;
        svg.rect(part, [left, bottom + 24.0], [left + 12.0, bottom + 36.0]);
        svg.text("", [left + 18.0, bottom + 35.0], Anchor::Start, part);
    }
    svg.inline(WIDTH, bottom + 46.0, "time of each stage")
}

/// Values of a response per sample.
const PER_SAMPLE: f64 = 8.0;

/// The response of a receiver at each height that it is known for, and the error of its shape; `None` where there is none.
pub(super) fn response(response: &Value) -> Option<String> {
    let numbers = |list: &Value| -> Option<Vec<f64>> {
        Some(list.as_array()?.iter().filter_map(Value::as_f64).collect())
    };
    let first = response["first_sample"].as_f64()?;
    let nodes: Vec<Vec<f64>> =
        response["nodes"].as_array()?.iter().filter_map(|node| numbers(&node["values"])).collect();
    let length = nodes.iter().map(Vec::len).max().filter(|length| *length > 1)?;
    let (low, high) =
        nodes.iter().flatten().fold((0.0f64, 1.0f64), |(low, high), v| (low.min(*v), high.max(*v)));
    let x = Scale { from: [first, first + (length - 1) as f64 / PER_SAMPLE], to: [LEFT - 50.0, RIGHT] };
    let y = Scale { from: [low, high], to: [220.0, 12.0] };
    let mut svg = Svg::new();
    let (values, digits) = y.ticks(5.0);
    for value in values {
        svg.line("grid", [x.to[0], y.at(value)], [RIGHT, y.at(value)]);
        svg.text("", [x.to[0] - 7.0, y.at(value) + 4.0], Anchor::End, &format!("{value:.digits$}"));
    }
    let (values, digits) = x.ticks(7.0);
    for value in values {
        svg.line("grid", [x.at(value), y.to[1]], [x.at(value), y.to[0]]);
        svg.text("", [x.at(value), 238.0], Anchor::Middle, &format!("{value:.digits$}"));
    }
    for node in &nodes {
        let place = |(index, value): (usize, &f64)| [x.at(first + index as f64 / PER_SAMPLE), y.at(*value)];
        svg.curve("low", node.iter().enumerate().map(place));
    }
    let errors = numbers(&response["template_error"]).unwrap_or_default();
    svg.curve("high", errors.iter().enumerate().map(|(index, e)| [x.at(first + index as f64), y.at(*e)]));
    svg.text(
        "",
        [(x.to[0] + RIGHT) / 2.0, 258.0],
        Anchor::Middle,
        "samples from the peak; error of the shape in orange",
    );
    Some(svg.inline(WIDTH, 268.0, "system response"))
}
