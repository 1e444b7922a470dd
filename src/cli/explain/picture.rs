//! The picture of a shot: its samples with their fit, what the fit leaves, and the outgoing pulse.

use super::seen::{Explained, PER_SAMPLE, SeenBlock, SeenPulse, SeenSamples};
use super::table;
use crate::cli::svg::{Anchor, Scale, Svg};

/// Places in the picture, in its own units.
const LEFT: f64 = 66.0;
const RIGHT: f64 = 26.0;
const GAP: f64 = 26.0;
const SAMPLES: [f64; 2] = [84.0, 374.0];
const RESIDUAL: [f64; 2] = [398.0, 528.0];
const BOTTOM: [f64; 2] = [622.0, 772.0];
const HEIGHT: f64 = 824.0;
const OUTGOING_WIDTH: f64 = 300.0;
/// Width of all echo panels together: as 60 ns want it, within limits.
const WIDTHS: [f64; 2] = [900.0, 1700.0];
const PER_NS: f64 = 12.0;

/// The picture as SVG.
pub(super) fn draw(explained: &Explained) -> String {
    let mut svg = Svg::new();
    let total_ns: f64 = explained.blocks.iter().map(|block| span_ns(&block.samples)).sum();
    let room = (total_ns * PER_NS).clamp(WIDTHS[0], WIDTHS[1]);
    let gaps = GAP * explained.blocks.len().saturating_sub(1) as f64;
    let width = LEFT + room + gaps + RIGHT;
    header(&mut svg, explained);
    let heights = heights(explained);
    let deviations = deviations(explained);
    let mut left = LEFT;
    for (i, block) in explained.blocks.iter().enumerate() {
        let right = left + room * span_ns(&block.samples) / total_ns.max(1e-9);
        let panel = Panel::of(explained, block, [left, right]);
        panel.samples(&mut svg, heights, i == 0);
        panel.residual(&mut svg, deviations, i == 0);
        left = right + GAP;
    }
    svg.text("", [LEFT + 0.5 * (room + gaps), RESIDUAL[1] + 38.0], Anchor::Middle, "time of flight, ns");
    svg.upright_text("", [16.0, 0.5 * (SAMPLES[0] + SAMPLES[1])], "digitiser steps, DN");
    svg.upright_text("", [16.0, 0.5 * (RESIDUAL[0] + RESIDUAL[1])], "residual, std. dev.");
    if let Some(pulse) = &explained.outgoing {
        outgoing(&mut svg, pulse);
    }
    let beside = if explained.outgoing.is_some() { LEFT + OUTGOING_WIDTH + 40.0 } else { LEFT };
    legend(&mut svg, explained, beside);
    returns(&mut svg, explained, beside + 204.0);
    svg.finish(width.round(), HEIGHT, &table::title(explained, &name(explained)))
}

fn header(svg: &mut Svg, explained: &Explained) {
    svg.text("title", [LEFT, 32.0], Anchor::Start, &table::title(explained, &name(explained)));
    let fit = |block: &SeenBlock| {
        let fit = &block.fit;
        format!(
            "{} power: chi-square {:.1} with {} degrees of freedom",
            fit.channel.name(),
            fit.chi_square,
            fit.degrees_of_freedom
        )
    };
    let fits: Vec<String> = explained.blocks.iter().map(fit).collect();
    svg.text("note", [LEFT, 54.0], Anchor::Start, &fits.join(" · "));
}

/// The recording's name, without its folder.
fn name(explained: &Explained) -> String {
    let path = std::path::Path::new(&explained.file);
    path.file_name().map_or_else(|| explained.file.clone(), |name| name.to_string_lossy().into_owned())
}

/// How long a block lasts, with half a sample before and behind it.
fn span_ns(samples: &SeenSamples) -> f64 {
    samples.samples_dn.len() as f64 * samples.interval_ns
}

/// The heights that all samples and fits need, DN; a fit far beyond the digitiser's range does not press them flat.
fn heights(explained: &Explained) -> [f64; 2] {
    let mut range = [0.0f64, 10.0];
    for block in &explained.blocks {
        let limit = 2.0 * block.samples.full_scale_dn;
        let samples = block.samples.samples_dn.iter().map(|&sample| f64::from(sample));
        for value in samples.chain(block.samples.fit_dn()) {
            range = [range[0].min(value), range[1].max(value.min(limit))];
        }
    }
    // Room for the numbers of the returns.
    [range[0] - 0.03 * (range[1] - range[0]), range[1] + 0.14 * (range[1] - range[0])]
}

/// The largest deviation to be shown, standard deviations.
fn deviations(explained: &Explained) -> f64 {
    let all = explained.blocks.iter().flat_map(|block| &block.samples.residual);
    all.fold(explained.threshold + 1.0, |largest, value| largest.max(1.1 * value.abs()))
}

/// The part of the picture that one block has.
struct Panel<'a> {
    explained: &'a Explained,
    block: &'a SeenBlock,
    x: Scale,
}

impl Panel<'_> {
    fn of<'a>(explained: &'a Explained, block: &'a SeenBlock, to: [f64; 2]) -> Panel<'a> {
        let samples = &block.samples;
        let begin = explained.time_of_flight_ns(samples.start_ns - 0.5 * samples.interval_ns);
        Panel { explained, block, x: Scale { from: [begin, begin + span_ns(samples)], to } }
    }

    /// Where a place in the block stands.
    fn at(&self, position_samples: f64) -> f64 {
        let samples = &self.block.samples;
        let time_ns = samples.start_ns + position_samples * samples.interval_ns;
        self.x.at(self.explained.time_of_flight_ns(time_ns))
    }

    fn samples(&self, svg: &mut Svg, heights: [f64; 2], is_first: bool) {
        let samples = &self.block.samples;
        let y = Scale { from: heights, to: [SAMPLES[1], SAMPLES[0]] };
        self.frame(svg, &y, 6.0, is_first, false);
        let level = y.at(samples.background_dn);
        svg.line("level", [self.x.to[0], level], [self.x.to[1], level]);
        let clip = |dn: f64| y.at(dn).clamp(SAMPLES[0], SAMPLES[1]);
        let curve = |values: Vec<f64>, above: f64| {
            let points = values.into_iter().enumerate();
            points.map(move |(i, value)| (i as f64 / PER_SAMPLE as f64, value + above)).collect::<Vec<_>>()
        };
        for pulse in &samples.pulses_dn {
            let visible = visible(pulse);
            let seen = curve(pulse.clone(), samples.background_dn);
            let part = seen.into_iter().skip(visible.start).take(visible.len());
            svg.curve("pulse", part.map(|(at, dn)| [self.at(at), clip(dn)]));
        }
        let fit = curve(samples.fit_dn(), 0.0);
        svg.curve("fit", fit.iter().map(|&(at, dn)| [self.at(at), clip(dn)]));
        dots(svg, samples, 0, |k| self.at(k), clip);
        self.numbers(svg, &y);
    }

    /// The number of each return above its peak, one above the other where they are close.
    fn numbers(&self, svg: &mut Svg, y: &Scale) {
        let samples = &self.block.samples;
        let fit = samples.fit_dn();
        let mut taken: Vec<[f64; 2]> = Vec::new();
        for &peak_ns in &self.block.peaks_ns {
            let Some(found) = self.explained.number_at(peak_ns) else { continue };
            let position = (peak_ns - samples.start_ns) / samples.interval_ns;
            let nearest =
                (position * PER_SAMPLE as f64).round().clamp(0.0, fit.len().saturating_sub(1) as f64);
            let top = fit.get(nearest as usize).copied().unwrap_or(0.0).max(samples.background_dn);
            let x = self.at(position).clamp(self.x.to[0] + 4.0, self.x.to[1] - 4.0);
            let mut label = y.at(top).clamp(SAMPLES[0] + 22.0, SAMPLES[1]) - 9.0;
            while taken.iter().any(|other| (other[0] - x).abs() < 15.0 && (other[1] - label).abs() < 14.0) {
                label -= 14.0;
            }
            taken.push([x, label]);
            svg.line("peak", [x, label + 4.0], [x, y.at(samples.background_dn)]);
            svg.text("num", [x, label], Anchor::Middle, &found.return_number.to_string());
        }
    }

    fn residual(&self, svg: &mut Svg, largest: f64, is_first: bool) {
        let y = Scale { from: [-largest, largest], to: [RESIDUAL[1], RESIDUAL[0]] };
        let [left, right] = self.x.to;
        svg.rect("one", [left, y.at(1.0)], [right, y.at(-1.0)]);
        self.frame(svg, &y, 4.0, is_first, true);
        svg.line("zero", [left, y.at(0.0)], [right, y.at(0.0)]);
        for limit in [self.explained.threshold, -self.explained.threshold] {
            svg.line("limit", [left, y.at(limit)], [right, y.at(limit)]);
        }
        let samples = &self.block.samples;
        let residual = samples.residual.iter().zip(&samples.used);
        for ((&value, &used), &taken_at) in residual.zip(&samples.taken_at) {
            let x = self.at(taken_at);
            if used {
                svg.line("stem", [x, y.at(0.0)], [x, y.at(value)]);
                svg.circle("sample", [x, y.at(value)], 2.2);
            } else {
                svg.circle("left", [x, y.at(0.0)], 2.2);
            }
        }
    }

    /// Frame, grid and the numbers at the axes.
    fn frame(&self, svg: &mut Svg, y: &Scale, wanted: f64, is_first: bool, with_times: bool) {
        let ([left, right], [bottom, top]) = (self.x.to, y.to);
        let (values, digits) = y.ticks(wanted);
        for value in values {
            svg.line("grid", [left, y.at(value)], [right, y.at(value)]);
            if is_first {
                svg.text("", [left - 7.0, y.at(value) + 4.0], Anchor::End, &format!("{value:.digits$}"));
            }
        }
        let (times, digits) = self.x.ticks(((right - left) / 75.0).max(2.0));
        for time in times {
            svg.line("grid", [self.x.at(time), top], [self.x.at(time), bottom]);
            if with_times {
                svg.text("", [self.x.at(time), bottom + 17.0], Anchor::Middle, &format!("{time:.digits$}"));
            }
        }
        svg.rect("frame", [left, top], [right, bottom]);
    }
}

/// The part of a pulse's curve from where it first leaves the background to where it is back: a hundredth of its peak.
fn visible(pulse: &[f64]) -> std::ops::Range<usize> {
    let least = 0.01 * pulse.iter().fold(0.0f64, |peak, value| peak.max(*value));
    let stands_out = |value: &f64| *value > least;
    let first = pulse.iter().position(stands_out).unwrap_or(0);
    first..pulse.iter().rposition(stands_out).map_or(first, |last| last + 1)
}

/// The samples of a block as dots; `window` is the sample to which the first of `used` belongs.
fn dots(svg: &mut Svg, samples: &SeenSamples, window: usize, x: impl Fn(f64) -> f64, y: impl Fn(f64) -> f64) {
    for (k, (&fitted_dn, &taken_at)) in samples.fitted_dn.iter().zip(&samples.taken_at).enumerate() {
        let used = k.checked_sub(window).and_then(|k| samples.used.get(k)).copied().unwrap_or(false);
        let class = match (samples.is_saturated(k), used) {
            (true, _) => "sat",
            (false, true) => "sample",
            (false, false) => "left",
        };
        svg.circle(class, [x(taken_at), y(fitted_dn)], 2.6);
    }
}

/// The panel of the outgoing pulse.
fn outgoing(svg: &mut Svg, pulse: &SeenPulse) {
    let samples = &pulse.samples;
    let peak_ns = samples.start_ns + pulse.pulse.position_samples * samples.interval_ns;
    let time = |k: f64| samples.start_ns + k * samples.interval_ns - peak_ns;
    let x = Scale {
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
    let y = Scale { from: [-0.03 * highest, 1.08 * highest], to: [BOTTOM[1], BOTTOM[0]] };
    svg.text("num", [LEFT, BOTTOM[0] - 12.0], Anchor::Start, "outgoing pulse");
    frame_of(svg, &x, &y);
    let points = fit.iter().enumerate().map(|(i, &dn)| {
        [x.at(time(pulse.window as f64 + i as f64 / PER_SAMPLE as f64)), y.at(dn).clamp(BOTTOM[0], BOTTOM[1])]
    });
    svg.curve("fit", points);
    dots(svg, samples, pulse.window, |k| x.at(time(k)), |dn| y.at(dn));
    svg.text(
        "",
        [LEFT + 0.5 * OUTGOING_WIDTH, BOTTOM[1] + 38.0],
        Anchor::Middle,
        "time from its fitted peak, ns",
    );
    svg.upright_text("", [16.0, 0.5 * (BOTTOM[0] + BOTTOM[1])], "DN");
}

fn frame_of(svg: &mut Svg, x: &Scale, y: &Scale) {
    let ([left, right], [bottom, top]) = (x.to, y.to);
    let (values, digits) = y.ticks(5.0);
    for value in values {
        svg.line("grid", [left, y.at(value)], [right, y.at(value)]);
        svg.text("", [left - 7.0, y.at(value) + 4.0], Anchor::End, &format!("{value:.digits$}"));
    }
    let (times, digits) = x.ticks(5.0);
    for time in times {
        svg.line("grid", [x.at(time), top], [x.at(time), bottom]);
        svg.text("", [x.at(time), bottom + 17.0], Anchor::Middle, &format!("{time:.digits$}"));
    }
    svg.rect("frame", [left, top], [right, bottom]);
}

/// What each mark means.
fn legend(svg: &mut Svg, explained: &Explained, left: f64) {
    let threshold = format!("threshold, ± {}", explained.threshold);
    let lines =
        [("fit", "fit"), ("pulse", "one return's pulse"), ("level", "background"), ("limit", &threshold)];
    let dots = [("sample", "sample"), ("sat", "saturated sample"), ("left", "sample not used")];
    let mut y = BOTTOM[0] + 4.0;
    for (class, text) in lines {
        svg.line(class, [left, y], [left + 24.0, y]);
        svg.text("", [left + 34.0, y + 4.0], Anchor::Start, text);
        y += 21.0;
    }
    svg.rect("one", [left, y - 6.0], [left + 24.0, y + 6.0]);
    svg.text("", [left + 34.0, y + 4.0], Anchor::Start, "± 1 standard deviation");
    for (class, text) in dots {
        y += 21.0;
        svg.circle(class, [left + 12.0, y], 3.0);
        svg.text("", [left + 34.0, y + 4.0], Anchor::Start, text);
    }
}

/// The returns in short; the table has them all.
fn returns(svg: &mut Svg, explained: &Explained, left: f64) {
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
