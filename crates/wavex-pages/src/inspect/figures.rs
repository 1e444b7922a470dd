//! Figures of a recording: histograms, blocks and angles over time, some waveforms.

use maud::Markup;

use super::histogram_files::{LabelledHistogram, amplitudes, angles, name_of, noise, ranges};
use super::summary::grouped;
use super::{GrowingHistogram, Inspection, ShownBlock, Waveform};
use crate::page::figure;
use crate::plot::{AxisScale, Plot, PlotStyle, Svg, extent};
use wavex_line::scan_line::Channel;

/// Maximum number of waveforms shown.
const WAVEFORMS: usize = 6;
/// Fraction of the values that a histogram may cut off at either end.
const TAIL: f64 = 0.0005;

/// Draws all figures that have data.
pub(super) fn figures(inspection: &Inspection) -> Vec<Markup> {
    let parts = [amplitudes(inspection), ranges(inspection), noise(inspection), angles(inspection)];
    let mut figures: Vec<Markup> = parts.iter().flatten().map(histogram).collect();
    figures.splice(0..0, inspection.plan.figure());
    figures.extend(over_time(&inspection.blocks_over_time_s));
    figures.extend(angles_over_time(inspection));
    figures.extend(inspection.waveforms.items().iter().take(WAVEFORMS).map(waveform));
    figures
}

/// A plot with these axis ranges.
fn plot(x: [f64; 2], y: [f64; 2]) -> Plot {
    let style = PlotStyle { label, below: [22.0, 40.0, 52.0], right_edge: f64::INFINITY, ..PlotStyle::RUN };
    let (x, y) = (AxisScale { from: x, to: [100.0, 546.0] }, AxisScale { from: y, to: [218.0, 12.0] });
    Plot { x, y, style }
}

/// Tick values wanted on each axis.
const TICKS: [f64; 2] = [7.0, 5.0];

fn finish(plot: &Plot, svg: Svg, title: &str, x: &str, y: &str) -> Markup {
    figure(title, plot.finish(svg, title, x, y), "")
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

fn histogram(part: &LabelledHistogram) -> Markup {
    let width = part.histogram.width();
    let shown = bulk(part);
    let inside = |&(centre, _): &(f64, u64)| centre > shown[0] && centre < shown[1];
    let highest = part.bins().filter(inside).map(|(_, count)| count).max().unwrap_or(1).max(1);
    let plot = plot(shown, [0.0, 1.06 * highest as f64]);
    let mut svg = plot.with_grid(TICKS);
    let edges = |centre: f64| [centre - 0.5 * width, centre + 0.5 * width];
    let bins: Vec<([f64; 2], f64)> =
        part.bins().filter(inside).map(|(centre, count)| (edges(centre), count as f64)).collect();
    let feet = extent(bins.iter().flat_map(|(edges, _)| *edges));
    plot.bars(&mut svg, bins, feet);
    finish(&plot, svg, &part.title, part.quantity, "count")
}

/// Range of the bins without the tails (see [`TAIL`]).
fn bulk(part: &LabelledHistogram) -> [f64; 2] {
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

fn over_time(times_s: &GrowingHistogram) -> Option<Markup> {
    let [first, last] = times_s.range()?;
    let width = times_s.width();
    let rate = |(_, count): (f64, u64)| count as f64 / width;
    let highest = times_s.bins().map(rate).fold(1.0, f64::max);
    let until = if last > first { last } else { first + width };
    let plot = plot([first, until], [0.0, 1.06 * highest]);
    let mut svg = plot.with_grid(TICKS);
    let bins = times_s.bins().map(|bin| ([bin.0 - 0.5 * width, bin.0 + 0.5 * width], rate(bin)));
    plot.bars(&mut svg, bins, [first, until]);
    Some(finish(&plot, svg, "echo blocks over time", "time since the first shot, s", "blocks per second"))
}

fn angles_over_time(inspection: &Inspection) -> Option<Markup> {
    let points = inspection.angles_over_time.items();
    let range = |axis: usize| {
        let [low, high] = extent(points.iter().map(|point| point[axis]));
        let room = if high > low { 0.04 * (high - low) } else { 0.5 };
        [low - room, high + room]
    };
    if points.is_empty() {
        return None;
    }
    let plot = plot(range(0), range(1));
    let mut svg = plot.with_grid(TICKS);
    points.iter().for_each(|point| svg.circle("dot", plot.at(*point), 1.1));
    let title = format!("angles of {} shots over time", grouped(points.len() as u64));
    Some(finish(&plot, svg, &title, "time since the first shot, s", "angle, degrees"))
}

/// Draws the blocks of a shot over time.
fn waveform(shown: &Waveform) -> Markup {
    let end_ns = |block: &ShownBlock| block.start_ns + block.samples_dn.len() as f64 * block.interval_ns;
    let first = shown.blocks.iter().map(|block| block.start_ns).fold(f64::INFINITY, f64::min);
    let last = shown.blocks.iter().map(end_ns).fold(first + 1.0, f64::max);
    let samples = shown.blocks.iter().flat_map(|block| &block.samples_dn);
    let highest = f64::from(samples.copied().max().unwrap_or(1).max(10));
    let plot = plot([first - 1.0, last], [-0.02 * highest, 1.08 * highest]);
    let mut svg = plot.with_grid(TICKS);
    for block in &shown.blocks {
        let class = if block.channel == Channel::HighPower { "high" } else { "low" };
        let point =
            |(k, &dn): (usize, &u16)| plot.at([block.start_ns + k as f64 * block.interval_ns, f64::from(dn)]);
        svg.curve(class, block.samples_dn.iter().enumerate().map(point));
        for sample in block.samples_dn.iter().enumerate() {
            svg.circle(&format!("{class} dot"), point(sample), 1.6);
        }
    }
    let mut channels: Vec<&str> = shown.blocks.iter().map(|block| name_of(block.channel)).collect();
    channels.dedup();
    let title = format!("shot {}, {}", shown.shot, channels.join(" and "));
    finish(&plot, svg, &title, "time after the shot's clock, ns", "sample, DN")
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
