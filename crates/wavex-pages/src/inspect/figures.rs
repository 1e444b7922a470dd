//! Figures of a recording: histograms, blocks and angles over time, some waveforms.

use super::histogram_files::{Part, amplitudes, angles, name_of, noise, ranges};
use super::summary::grouped;
use super::{Histogram, Inspection, ShownBlock, Waveform};
use crate::report::svg::{Anchor, Scale, Svg};
use wavex_line::scan_line::Channel;

/// A picture with its title.
pub(super) struct Figure {
    pub(super) title: String,
    pub(super) svg: String,
}

/// Size of a picture and of the frame in it, SVG units.
const WIDTH: f64 = 560.0;
const HEIGHT: f64 = 270.0;
const LEFT: f64 = 100.0;
const RIGHT: f64 = 546.0;
const TOP: f64 = 12.0;
const BOTTOM: f64 = 218.0;
/// Maximum number of waveforms shown.
const WAVEFORMS: usize = 6;
/// Fraction of the values that a histogram may cut off at either end.
const TAIL: f64 = 0.0005;

/// Draws all figures that have data.
pub(super) fn figures(inspection: &Inspection) -> Vec<Figure> {
    let parts = [amplitudes(inspection), ranges(inspection), noise(inspection), angles(inspection)];
    let mut figures: Vec<Figure> = parts.iter().flatten().map(histogram).collect();
    figures.splice(0..0, inspection.plan.figure());
    figures.extend(over_time(&inspection.blocks_over_time_s));
    figures.extend(angles_over_time(inspection));
    figures.extend(inspection.waveforms.items().iter().take(WAVEFORMS).map(waveform));
    figures
}

/// Horizontal and vertical axis of a picture.
struct Axes {
    x: Scale,
    y: Scale,
}

impl Axes {
    fn new(x: [f64; 2], y: [f64; 2]) -> Axes {
        Axes { x: Scale { from: x, to: [LEFT, RIGHT] }, y: Scale { from: y, to: [BOTTOM, TOP] } }
    }

    fn at(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        [self.x.at(x).clamp(LEFT, RIGHT), self.y.at(y).clamp(TOP, BOTTOM)]
    }

    /// Draws grid lines and tick labels below the data.
    fn grid(&self, svg: &mut Svg) {
        let (values, digits) = self.y.ticks(5.0);
        for value in values {
            svg.line("grid", [LEFT, self.y.at(value)], [RIGHT, self.y.at(value)]);
            svg.text("", [LEFT - 7.0, self.y.at(value) + 4.0], Anchor::End, &label(value, digits));
        }
        let (values, digits) = self.x.ticks(7.0);
        for value in values {
            svg.line("grid", [self.x.at(value), TOP], [self.x.at(value), BOTTOM]);
            svg.text("", [self.x.at(value), BOTTOM + 22.0], Anchor::Middle, &label(value, digits));
        }
    }

    /// Draws frame and axis titles, and finishes the figure.
    fn finish(&self, mut svg: Svg, title: &str, x: &str, y: &str) -> Figure {
        svg.rect("frame", [LEFT, TOP], [RIGHT, BOTTOM]);
        svg.text("", [0.5 * (LEFT + RIGHT), BOTTOM + 40.0], Anchor::Middle, x);
        svg.upright_text("", [17.0, 0.5 * (TOP + BOTTOM)], y);
        Figure { title: title.to_owned(), svg: svg.inline(WIDTH, HEIGHT, title) }
    }
}

/// Tick label, with grouped thousands from 10 000 on.
fn label(value: f64, digits: usize) -> String {
    let value = if value == 0.0 { 0.0 } else { value };
    let is_large_whole = digits == 0 && value.abs() >= 10_000.0;
    match is_large_whole {
        true => format!("{}{}", if value < 0.0 { "-" } else { "" }, grouped(value.abs().round() as u64)),
        false => format!("{value:.digits$}"),
    }
}

fn histogram(part: &Part) -> Figure {
    let width = part.histogram.width();
    let shown = bulk(part);
    let inside = |&(centre, _): &(f64, u64)| centre > shown[0] && centre < shown[1];
    let highest = part.bins().filter(inside).map(|(_, count)| count).max().unwrap_or(1).max(1);
    let axes = Axes::new(shown, [0.0, 1.06 * highest as f64]);
    let mut svg = Svg::new();
    axes.grid(&mut svg);
    let steps = part.bins().filter(inside).flat_map(|(centre, count)| {
        [[centre - 0.5 * width, count as f64], [centre + 0.5 * width, count as f64]]
    });
    let steps: Vec<[f64; 2]> = steps.collect();
    let foot = |corner: Option<&[f64; 2]>| corner.map(|[x, _]| [*x, 0.0]);
    let ends = [foot(steps.first()), foot(steps.last())];
    let corners = ends[0].into_iter().chain(steps.iter().copied()).chain(ends[1]);
    svg.area("bars", corners.map(|corner| axes.at(corner)));
    axes.finish(svg, &part.title, part.quantity, "count")
}

/// Range of the bins without the tails (see [`TAIL`]).
fn bulk(part: &Part) -> [f64; 2] {
    let width = part.histogram.width();
    let most = (TAIL * part.histogram.total() as f64) as u64;
    let mut bins: Vec<(f64, u64)> = part.bins().collect();
    let first_beyond_tail = |bins: &[(f64, u64)]| {
        let mut sum = 0;
        let mut is_beyond = |(_, count): &&(f64, u64)| {
            sum += count;
            sum > most
        };
        bins.iter().find(|bin| is_beyond(bin)).map_or(0.0, |(centre, _)| *centre)
    };
    let low = first_beyond_tail(&bins);
    bins.reverse();
    let high = first_beyond_tail(&bins);
    // Show at least five bins: a single value would fill the frame.
    let few = (2.0 * width - 0.5 * (high - low)).max(0.0);
    [low - 0.5 * width - few, high + 0.5 * width + few]
}

fn over_time(times_s: &Histogram) -> Option<Figure> {
    let [first, last] = times_s.range()?;
    let width = times_s.width();
    let rate = |(_, count): (f64, u64)| count as f64 / width;
    let highest = times_s.bins().map(rate).fold(1.0, f64::max);
    let until = if last > first { last } else { first + width };
    let axes = Axes::new([first, until], [0.0, 1.06 * highest]);
    let mut svg = Svg::new();
    axes.grid(&mut svg);
    let steps =
        times_s.bins().flat_map(|bin| [[bin.0 - 0.5 * width, rate(bin)], [bin.0 + 0.5 * width, rate(bin)]]);
    let corners = [[first, 0.0]].into_iter().chain(steps).chain([[until, 0.0]]);
    svg.area("bars", corners.map(|corner| axes.at(corner)));
    Some(axes.finish(svg, "echo blocks over time", "time since the first shot, s", "blocks per second"))
}

fn angles_over_time(inspection: &Inspection) -> Option<Figure> {
    let points = inspection.angles_over_time.items();
    let range = |axis: usize| {
        let values = points.iter().map(move |point| point[axis]);
        let low = values.clone().fold(f64::INFINITY, f64::min);
        let high = values.fold(f64::NEG_INFINITY, f64::max);
        let room = if high > low { 0.04 * (high - low) } else { 0.5 };
        [low - room, high + room]
    };
    if points.is_empty() {
        return None;
    }
    let axes = Axes::new(range(0), range(1));
    let mut svg = Svg::new();
    axes.grid(&mut svg);
    points.iter().for_each(|point| svg.circle("dot", axes.at(*point), 1.1));
    let title = format!("angles of {} shots over time", grouped(points.len() as u64));
    Some(axes.finish(svg, &title, "time since the first shot, s", "angle, degrees"))
}

/// Draws the blocks of a shot over time.
fn waveform(shown: &Waveform) -> Figure {
    let end_ns = |block: &ShownBlock| block.start_ns + block.samples_dn.len() as f64 * block.interval_ns;
    let first = shown.blocks.iter().map(|block| block.start_ns).fold(f64::INFINITY, f64::min);
    let last = shown.blocks.iter().map(end_ns).fold(first + 1.0, f64::max);
    let samples = shown.blocks.iter().flat_map(|block| &block.samples_dn);
    let highest = f64::from(samples.copied().max().unwrap_or(1).max(10));
    let axes = Axes::new([first - 1.0, last], [-0.02 * highest, 1.08 * highest]);
    let mut svg = Svg::new();
    axes.grid(&mut svg);
    for block in &shown.blocks {
        let class = if block.channel == Channel::HighPower { "high" } else { "low" };
        let point =
            |(k, &dn): (usize, &u16)| axes.at([block.start_ns + k as f64 * block.interval_ns, f64::from(dn)]);
        svg.curve(class, block.samples_dn.iter().enumerate().map(point));
        for sample in block.samples_dn.iter().enumerate() {
            svg.circle(&format!("{class} dot"), point(sample), 1.6);
        }
    }
    let mut channels: Vec<&str> = shown.blocks.iter().map(|block| name_of(block.channel)).collect();
    channels.dedup();
    let title = format!("shot {}, {}", shown.shot, channels.join(" and "));
    axes.finish(svg, &title, "time after the shot's clock, ns", "sample, DN")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_at_axes_are_easy_to_read() {
        assert_eq!([label(-0.0, 0), label(9000.0, 0), label(0.25, 2)], ["0", "9000", "0.25"]);
        assert_eq!([label(1.5e6, 0), label(-20_000.0, 0)], ["1 500 000", "-20 000"]);
    }
}
