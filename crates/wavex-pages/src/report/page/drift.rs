//! Sensor model of a survey: the receivers by each input alone, along the survey.

use maud::{Markup, html};
use serde_json::Value;

use super::details::of_channels;
use super::{figure, figures, list, of_sensor, plain, table};
use crate::numbers::short;
use crate::plot::{Plot, Svg, extent};

/// A measured quantity: path in the entry of an input, title, unit.
const QUANTITIES: [(&str, &str, &str); 12] = [
    ("/low_power/background_dn", "Background, low power", "DN"),
    ("/low_power/noise_sd_dn", "Noise, low power", "DN"),
    ("/low_power/pulse_fwhm_ns", "Pulse width, low power", "ns"),
    ("/high_power/background_dn", "Background, high power", "DN"),
    ("/high_power/noise_sd_dn", "Noise, high power", "DN"),
    ("/high_power/pulse_fwhm_ns", "Pulse width, high power", "ns"),
    ("/reference/background_dn", "Background, outgoing pulse", "DN"),
    ("/reference/noise_sd_dn", "Noise, outgoing pulse", "DN"),
    ("/reference/pulse_fwhm_ns", "Width of the outgoing pulse", "ns"),
    ("/gain_ratio", "Gain ratio of the receivers", ""),
    ("/delay_ns", "Delay of the high-power receiver", "ns"),
    ("/walk_ns", "Range walk from 20 to 100 DN", "ns"),
];

/// Shows how the sensor model changes along a survey; empty without a model of the survey.
pub(in crate::report) fn of_survey(survey: &Value) -> Markup {
    let inputs = list(survey, "inputs");
    let drawn: Vec<Markup> = QUANTITIES
        .iter()
        .filter_map(|(path, title, unit)| {
            let svg = along(inputs, path, title, unit)?;
            Some(figure(title, svg, "each input alone; bars: two standard deviations; orange: own model"))
        })
        .collect();
    let instruments = list(survey, "instruments");
    let name = |input: &Value| {
        let instrument = input["instrument"].as_u64().and_then(|index| instruments.get(index as usize));
        let instrument = instrument.map(|model| &model["instrument"]);
        instrument.map_or(String::new(), |instrument| {
            let known = ["name", "serial"].into_iter().filter_map(|key| instrument[key].as_str());
            known.collect::<Vec<&str>>().join(", ")
        })
    };
    let rows = inputs.iter().map(|input| {
        let model = match (&input["own_model"], input["instrument"].is_null()) {
            (Value::String(reason), _) => format!("its own: {reason}"),
            (_, true) => "not calibrated".to_owned(),
            _ => "of the survey".to_owned(),
        };
        let measured = |path: &str| {
            let of = |key: &str| input.pointer(path)?[key].as_f64();
            of("value")
                .zip(of("sd"))
                .map_or(String::new(), |(value, sd)| format!("{} ± {}", short(value), short(sd)))
        };
        let low_power = ["background_dn", "noise_sd_dn", "pulse_fwhm_ns"];
        let mut row = vec![plain(&input["stem"]), name(input), plain(&input["waveforms"])];
        row.extend(low_power.iter().map(|key| measured(&format!("/low_power/{key}"))));
        row.push(model);
        row
    });
    let heads = [
        "input",
        "instrument",
        "waveforms",
        "background, DN",
        "noise, DN",
        "pulse width, ns",
        "sensor model",
    ];
    html! {
        @for instrument in instruments {
            h2.group { "Sensor model of the survey" }
            (of_sensor(&instrument["sensor_model"]).body)
            div.sections { (of_channels(&instrument["sensor_model"])) }
        }
        @if !drawn.is_empty() { h2.group { "Drift of the sensor" } (figures(&drawn)) }
        (table("Sensor model by input (low-power receiver)", &heads, rows))
    }
}

/// Draws a quantity along the survey; `None` if fewer than two inputs have it.
fn along(inputs: &[Value], path: &str, title: &str, unit: &str) -> Option<String> {
    let found: Vec<(f64, f64, f64, bool)> = inputs
        .iter()
        .enumerate()
        .filter_map(|(number, input)| {
            let measured = input.pointer(path)?;
            let (value, sd) = (measured["value"].as_f64()?, measured["sd"].as_f64()?);
            Some((1.0 + number as f64, value, sd, !input["own_model"].is_null()))
        })
        .collect();
    if found.len() < 2 {
        return None;
    }
    let ends = extent(found.iter().flat_map(|(_, value, sd, _)| [value - 2.0 * sd, value + 2.0 * sd]));
    let margin = (0.05 * (ends[1] - ends[0])).max(1e-3 * ends[1].abs()).max(1e-9);
    let plot = Plot::new([0.5, inputs.len() as f64 + 0.5], [ends[0] - margin, ends[1] + margin]);
    let mut svg = Svg::new();
    plot.grid_y(&mut svg, plot.ticks_y(5.0));
    let every = inputs.len().div_ceil(12);
    plot.grid_x(&mut svg, (1..=inputs.len()).step_by(every).map(|n| (n as f64, n.to_string())));
    for (number, value, sd, has_own) in found {
        plot.error_bar(&mut svg, [number, value], sd);
        svg.circle(if has_own { "high dot" } else { "dot" }, plot.at([number, value]), 3.0);
    }
    let axis = if unit.is_empty() { title.to_owned() } else { unit.to_owned() };
    Some(plot.finish(svg, title, "input", &axis))
}
