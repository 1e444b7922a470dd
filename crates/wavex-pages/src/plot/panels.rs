//! Panels of a shot's sample blocks: samples and fit above, residuals below.

use super::frame::{Plot, PlotStyle, Tick};
use super::scale::AxisScale;
use super::svg::{Anchor, Svg};
use wavex_line::stage::{CURVE_POINTS_PER_SAMPLE, FittedBlock, FittedSamples};

/// Layout of the panels in a picture.
pub(crate) struct Panels {
    /// Left and right edge of all panels.
    pub(crate) x: [f64; 2],
    /// Gap between two panels.
    pub(crate) gap: f64,
    /// Top and bottom of the sample panels.
    pub(crate) samples: [f64; 2],
    /// Top and bottom of the residual panels.
    pub(crate) residual: [f64; 2],
}

/// Limit that residuals of pure noise rarely exceed, standard deviations.
const FAR_SD: f64 = 3.0;

impl Panels {
    /// Draws the blocks side by side with a common amplitude axis.
    pub(crate) fn draw(&self, svg: &mut Svg, blocks: &[&FittedBlock]) {
        let total_ns: f64 = blocks.iter().map(|block| block.samples.span_ns()).sum();
        let room = self.x[1] - self.x[0] - self.gap * blocks.len().saturating_sub(1) as f64;
        let heights = heights(blocks);
        let largest = self.largest_deviation(blocks);
        let mut left = self.x[0];
        for (i, block) in blocks.iter().enumerate() {
            let right = left + room * block.samples.span_ns() / total_ns.max(1e-9);
            let panel = |from: [f64; 2], [top, bottom]: [f64; 2]| {
                Panel::of(block, [left, right], AxisScale { from, to: [bottom, top] })
            };
            panel(heights, self.samples).samples(svg, i == 0);
            panel([-largest, largest], self.residual).residual(svg, i == 0);
            left = right + self.gap;
        }
    }

    /// Half range of the residual axis, standard deviations.
    fn largest_deviation(&self, blocks: &[&FittedBlock]) -> f64 {
        let all = blocks.iter().flat_map(|block| &block.samples.residual);
        all.fold(FAR_SD + 1.0, |largest, value| largest.max(1.1 * value.abs()))
    }
}

/// Amplitude range of all samples and fits, DN.
///
/// A fit is clipped at twice the digitiser's full scale, so that it does not flatten the samples.
fn heights(blocks: &[&FittedBlock]) -> [f64; 2] {
    let mut range = [0.0f64, 10.0];
    for block in blocks {
        let limit = 2.0 * block.samples.full_scale_dn;
        let samples = block.samples.samples_dn.iter().map(|&sample| f64::from(sample));
        for value in samples.chain(block.samples.fit_dn()) {
            range = [range[0].min(value), range[1].max(value.min(limit))];
        }
    }
    // Headroom for the return numbers.
    [range[0] - 0.03 * (range[1] - range[0]), range[1] + 0.14 * (range[1] - range[0])]
}

/// Panel of one block.
struct Panel<'a> {
    block: &'a FittedBlock,
    plot: Plot,
}

impl Panel<'_> {
    fn of(block: &FittedBlock, to: [f64; 2], y: AxisScale) -> Panel<'_> {
        let begin = block.first_ns - 0.5 * block.samples.interval_ns;
        let x = AxisScale { from: [begin, begin + block.samples.span_ns()], to };
        Panel { block, plot: Plot { x, y, style: PlotStyle::FILE } }
    }

    /// Horizontal position of a sample index.
    fn at(&self, position_samples: f64) -> f64 {
        self.plot.x.at(self.block.first_ns + position_samples * self.block.samples.interval_ns)
    }

    fn samples(&self, svg: &mut Svg, is_first: bool) {
        let (samples, y) = (&self.block.samples, &self.plot.y);
        self.frame(svg, 6.0, is_first, false);
        self.plot.line_y(svg, "level", samples.background_dn);
        let clip = |dn: f64| y.at(dn).clamp(y.to[1], y.to[0]);
        let point = |(i, dn): (usize, f64)| [self.at(i as f64 / CURVE_POINTS_PER_SAMPLE as f64), clip(dn)];
        for pulse in &samples.pulses_dn {
            let visible = visible(pulse);
            let part = pulse.iter().enumerate().skip(visible.start).take(visible.len());
            svg.curve("pulse", part.map(|(i, dn)| point((i, dn + samples.background_dn))));
        }
        svg.curve("fit", samples.fit_dn().into_iter().enumerate().map(point));
        dots(svg, samples, 0, |k| self.at(k), clip);
        self.numbers(svg);
    }

    /// Draws each return number above its peak; stacks numbers that are close.
    fn numbers(&self, svg: &mut Svg) {
        let (samples, Plot { x: across, y, .. }) = (&self.block.samples, &self.plot);
        let fit = samples.fit_dn();
        let mut taken: Vec<[f64; 2]> = Vec::new();
        for peak in &self.block.peaks {
            let Some(number) = peak.number else { continue };
            let position = peak.position_samples;
            let nearest = (position * CURVE_POINTS_PER_SAMPLE as f64)
                .round()
                .clamp(0.0, fit.len().saturating_sub(1) as f64);
            let top = fit.get(nearest as usize).copied().unwrap_or(0.0).max(samples.background_dn);
            let x = self.at(position).clamp(across.to[0] + 4.0, across.to[1] - 4.0);
            let mut label = y.at(top).clamp(y.to[1] + 22.0, y.to[0]) - 9.0;
            while taken.iter().any(|other| (other[0] - x).abs() < 15.0 && (other[1] - label).abs() < 14.0) {
                label -= 14.0;
            }
            taken.push([x, label]);
            svg.line("peak", [x, label + 4.0], [x, y.at(samples.background_dn)]);
            svg.text("num", [x, label], Anchor::Middle, &number.to_string());
        }
    }

    fn residual(&self, svg: &mut Svg, is_first: bool) {
        let (y, [left, right]) = (&self.plot.y, self.plot.x.to);
        svg.rect("one", [left, y.at(1.0)], [right, y.at(-1.0)]);
        self.frame(svg, 4.0, is_first, true);
        self.plot.line_y(svg, "zero", 0.0);
        for limit in [FAR_SD, -FAR_SD] {
            self.plot.line_y(svg, "limit", limit);
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

    /// Draws grid and frame; labels of the amplitudes and of the times are optional.
    fn frame(&self, svg: &mut Svg, wanted: f64, with_heights: bool, with_times: bool) {
        let [left, right] = self.plot.x.to;
        let labelled = |is_labelled: bool| {
            move |(value, text): Tick| (value, if is_labelled { text } else { String::new() })
        };
        self.plot.grid_y(svg, self.plot.ticks_y(wanted).into_iter().map(labelled(with_heights)));
        let times = self.plot.ticks_x(((right - left) / 75.0).max(2.0));
        self.plot.grid_x(svg, times.into_iter().map(labelled(with_times)));
        self.plot.border(svg);
    }
}

/// Index range in which a pulse exceeds 1 % of its peak.
fn visible(pulse: &[f64]) -> std::ops::Range<usize> {
    let least = 0.01 * pulse.iter().fold(0.0f64, |peak, value| peak.max(*value));
    let stands_out = |value: &f64| *value > least;
    let first = pulse.iter().position(stands_out).unwrap_or(0);
    first..pulse.iter().rposition(stands_out).map_or(first, |last| last + 1)
}

/// Draws the samples of a block as dots; `window` is the sample index of `used[0]`.
pub(crate) fn dots(
    svg: &mut Svg,
    samples: &FittedSamples,
    window: usize,
    x: impl Fn(f64) -> f64,
    y: impl Fn(f64) -> f64,
) {
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
