//! Figures of a run and its sensor model, from the values of the report.

use serde_json::Value;

use crate::plot::{Anchor, AxisScale, Legend, Mark, Plot, PlotStyle, Svg, WIDTH};

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
    let mut svg = Svg::new();
    for (index, part) in parts.iter().enumerate() {
        Legend::BARS.entry(&mut svg, Mark::Band(part), [LEFT + 120.0 * index as f64, 12.0], part);
    }
    let top_of = |row: usize| 32.0 + row as f64 * ROW;
    let bottom = top_of(stages.len());
    let plot = Plot {
        x: AxisScale { from: [0.0, longest], to: [LEFT, RIGHT] },
        y: AxisScale { from: [0.0, 1.0], to: [bottom, 28.0] },
        style: PlotStyle { below: [15.0, 0.0, 26.0], ..PlotStyle::RUN },
    };
    plot.grid_x(&mut svg, plot.ticks_x(5.0).into_iter().map(|(value, text)| (value, format!("{text} s"))));
    for (row, stage) in stages.iter().enumerate() {
        let top = top_of(row);
        svg.text("", [LEFT - 7.0, top + 14.0], Anchor::End, stage["id"].as_str().unwrap_or_default());
        let mut from = 0.0;
        for part in parts {
            let until = from + seconds(stage, &format!("{part}_s"));
            svg.rect(part, [plot.x.at(from), top], [plot.x.at(until), top + ROW - 8.0]);
            from = until;
        }
    }
    Some(svg.inline(WIDTH, bottom + plot.style.below[2], "time per stage"))
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
    let is_inside = |[x, _]: &[f64; 2]| (plot.x.from[0]..=plot.x.from[1]).contains(x);
    let mut svg = plot.with_grid([6.0, 5.0]);
    for node in &nodes {
        let points = node.iter().enumerate().map(|(i, value)| [first + i as f64 / PER_SAMPLE, *value]);
        plot.curve(&mut svg, "returns", points.filter(is_inside));
    }
    let errors = numbers(&response["template_error"]);
    let points = errors.iter().enumerate().map(|(i, error)| [first + i as f64, *error]);
    plot.curve(&mut svg, "found", points.filter(is_inside));
    Legend::CURVES.entry(&mut svg, Mark::Curve("returns"), [380.0, 28.0], "response");
    Legend::CURVES.entry(&mut svg, Mark::Curve("found"), [380.0, 48.0], "shape error");
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
    plot.grid_y(&mut svg, plot.ticks_y(5.0));
    let every = lags.div_ceil(12);
    plot.grid_x(&mut svg, (0..lags).step_by(every).map(|lag| (lag as f64, lag.to_string())));
    plot.line_y(&mut svg, "zero", 0.0);
    for (lag, value) in [1.0].iter().chain(&measured).enumerate() {
        let at = [lag as f64, *value];
        svg.line("rod", plot.at([at[0], 0.0]), plot.at(at));
        if let Some(error) = lag.checked_sub(1).and_then(|lag| errors.get(lag)) {
            plot.error_bar(&mut svg, at, *error);
        }
        svg.circle("dot", plot.at(at), 3.0);
    }
    Some(plot.finish(svg, "noise autocorrelation", "lag, samples", "correlation"))
}
