//! Picture of a shot: samples with fit, residuals, and the outgoing pulse.

use super::ExplainedShot;
use crate::plot::{Anchor, AxisScale, Legend, Panels, Plot, PlotStyle, Svg, dots, fit_marks};
use wavex_line::stage::{CURVE_POINTS_PER_SAMPLE, FittedBlock};
use wavex_stages::process::decompose::SeenPulse;

/// Layout in SVG units.
const LEFT: f64 = 66.0;
const RIGHT: f64 = 26.0;
const GAP: f64 = 26.0;
const SAMPLES: [f64; 2] = [84.0, 374.0];
const RESIDUAL: [f64; 2] = [398.0, 528.0];
const BOTTOM: [f64; 2] = [622.0, 772.0];
const HEIGHT: f64 = 824.0;
const OUTGOING_WIDTH: f64 = 300.0;
/// Limits of the width of all echo panels together; [`PER_NS`] sets it in between.
const WIDTHS: [f64; 2] = [900.0, 1700.0];
const PER_NS: f64 = 12.0;

/// Draws the picture as SVG.
pub(super) fn draw(explained: &ExplainedShot) -> String {
    let mut svg = Svg::new();
    let blocks: Vec<&FittedBlock> = explained.blocks.iter().map(|block| &block.shown).collect();
    let total_ns: f64 = blocks.iter().map(|block| block.samples.span_ns()).sum();
    let gaps = GAP * blocks.len().saturating_sub(1) as f64;
    let right = LEFT + (total_ns * PER_NS).clamp(WIDTHS[0], WIDTHS[1]) + gaps;
    header(&mut svg, explained);
    let panels = Panels { x: [LEFT, right], gap: GAP, samples: SAMPLES, residual: RESIDUAL };
    panels.draw(&mut svg, &blocks);
    svg.text("", [0.5 * (LEFT + right), RESIDUAL[1] + 38.0], Anchor::Middle, "time of flight, ns");
    svg.upright_text("", [16.0, 0.5 * (SAMPLES[0] + SAMPLES[1])], "digitiser steps, DN");
    svg.upright_text("", [16.0, 0.5 * (RESIDUAL[0] + RESIDUAL[1])], "residual, std. dev.");
    if let Some(pulse) = &explained.outgoing {
        outgoing(&mut svg, pulse);
    }
    let beside = if explained.outgoing.is_some() { LEFT + OUTGOING_WIDTH + 40.0 } else { LEFT };
    legend(&mut svg, beside);
    returns(&mut svg, explained, beside + 204.0);
    svg.finish((right + RIGHT).round(), HEIGHT, &explained.title())
}

fn header(svg: &mut Svg, explained: &ExplainedShot) {
    svg.text("title", [LEFT, 32.0], Anchor::Start, &explained.title());
    let fit = |block: &FittedBlock| {
        format!(
            "{} power: chi-square {:.1} with {} degrees of freedom",
            block.channel, block.chi_square, block.degrees_of_freedom
        )
    };
    let fits: Vec<String> = explained.blocks.iter().map(|block| fit(&block.shown)).collect();
    svg.text("note", [LEFT, 54.0], Anchor::Start, &fits.join(" · "));
}

/// Draws the panel of the outgoing pulse.
fn outgoing(svg: &mut Svg, pulse: &SeenPulse) {
    let samples = &pulse.samples;
    let peak_ns = pulse.start_ns + pulse.pulse.position_samples * samples.interval_ns;
    let time = |k: f64| pulse.start_ns + k * samples.interval_ns - peak_ns;
    let x = AxisScale {
        from: [time(-0.5), time(samples.samples_dn.len() as f64 - 0.5)],
        to: [LEFT, LEFT + OUTGOING_WIDTH],
    };
    let fit = samples.fit_dn();
    let highest = samples
        .samples_dn
        .iter()
        .map(|&sample| f64::from(sample))
        .chain(fit.iter().copied())
        .fold(1.0, f64::max);
    let y = AxisScale { from: [-0.03 * highest, 1.08 * highest], to: [BOTTOM[1], BOTTOM[0]] };
    let plot = Plot { x, y, style: PlotStyle::FILE };
    svg.text("num", [LEFT, BOTTOM[0] - 12.0], Anchor::Start, "outgoing pulse");
    plot.grid(svg, [5.0, 5.0]);
    plot.border(svg);
    let position = |i: usize| time(pulse.window as f64 + i as f64 / CURVE_POINTS_PER_SAMPLE as f64);
    plot.curve(svg, "fit", fit.iter().enumerate().map(|(i, &dn)| [position(i), dn]));
    dots(svg, samples, pulse.window, |k| plot.x.at(time(k)), |dn| plot.y.at(dn));
    plot.titles(svg, &["time from its fitted peak, ns", "DN"]);
}

fn legend(svg: &mut Svg, left: f64) {
    for (i, (mark, text)) in fit_marks("one return's pulse").into_iter().enumerate() {
        Legend::FILE.entry(svg, mark, [left, BOTTOM[0] + 4.0 + 21.0 * i as f64], text);
    }
}

/// Draws a short table of the first returns; the printed table has all of them.
fn returns(svg: &mut Svg, explained: &ExplainedShot, left: f64) {
    const SHOWN: usize = 7;
    let columns = [12.0, 136.0, 246.0, 346.0];
    let heads = ["", "range, m", "amplitude, DN", "width ratio"];
    let mut y = BOTTOM[0] + 4.0;
    for (head, at) in heads.iter().zip(columns) {
        svg.text("note", [left + at, y], Anchor::End, head);
    }
    for found in explained.returns.iter().take(SHOWN) {
        y += 20.0;
        let cells = [
            found.return_number.to_string(),
            format!("{:.3} ± {:.3}", found.range_m, found.range_sd_m),
            format!("{:.1} ± {:.1}", found.amplitude_dn, found.amplitude_sd_dn),
            format!("{:.2} ± {:.2}", found.width_ratio, found.width_ratio_sd),
        ];
        for (i, (cell, at)) in cells.iter().zip(columns).enumerate() {
            svg.text(if i == 0 { "num" } else { "" }, [left + at, y], Anchor::End, cell);
        }
    }
    if explained.returns.len() > SHOWN {
        let more = explained.returns.len() - SHOWN;
        svg.text("note", [left + columns[1], y + 20.0], Anchor::End, &format!("and {more} more"));
    }
}
