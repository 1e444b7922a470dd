//! Panels of a shot's sample blocks: samples and fit above, residuals below.

use super::svg::{Anchor, Scale, Svg};
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
pub(crate) const FAR_SD: f64 = 3.0;
/// Legend of the limit lines.
pub(crate) const FAR_LABEL: &str = "± 3 standard deviations";

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
            let panel = Panel::of(block, [left, right]);
            panel.samples(svg, &Scale { from: heights, to: [self.samples[1], self.samples[0]] }, i == 0);
            let y = Scale { from: [-largest, largest], to: [self.residual[1], self.residual[0]] };
            panel.residual(svg, &y, i == 0);
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
    x: Scale,
}

impl Panel<'_> {
    fn of(block: &FittedBlock, to: [f64; 2]) -> Panel<'_> {
        let begin = block.first_ns - 0.5 * block.samples.interval_ns;
        Panel { block, x: Scale { from: [begin, begin + block.samples.span_ns()], to } }
    }

    /// Horizontal position of a sample index.
    fn at(&self, position_samples: f64) -> f64 {
        self.x.at(self.block.first_ns + position_samples * self.block.samples.interval_ns)
    }

    fn samples(&self, svg: &mut Svg, y: &Scale, is_first: bool) {
        let samples = &self.block.samples;
        self.frame(svg, y, 6.0, is_first, false);
        let level = y.at(samples.background_dn);
        svg.line("level", [self.x.to[0], level], [self.x.to[1], level]);
        let clip = |dn: f64| y.at(dn).clamp(y.to[1], y.to[0]);
        let curve = |values: Vec<f64>, above: f64| {
            let points = values.into_iter().enumerate();
            points
                .map(move |(i, value)| (i as f64 / CURVE_POINTS_PER_SAMPLE as f64, value + above))
                .collect::<Vec<_>>()
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
        self.numbers(svg, y);
    }

    /// Draws each return number above its peak; stacks numbers that are close.
    fn numbers(&self, svg: &mut Svg, y: &Scale) {
        let samples = &self.block.samples;
        let fit = samples.fit_dn();
        let mut taken: Vec<[f64; 2]> = Vec::new();
        for peak in &self.block.peaks {
            let Some(number) = peak.number else { continue };
            let position = peak.position_samples;
            let nearest = (position * CURVE_POINTS_PER_SAMPLE as f64)
                .round()
                .clamp(0.0, fit.len().saturating_sub(1) as f64);
            let top = fit.get(nearest as usize).copied().unwrap_or(0.0).max(samples.background_dn);
            let x = self.at(position).clamp(self.x.to[0] + 4.0, self.x.to[1] - 4.0);
            let mut label = y.at(top).clamp(y.to[1] + 22.0, y.to[0]) - 9.0;
            while taken.iter().any(|other| (other[0] - x).abs() < 15.0 && (other[1] - label).abs() < 14.0) {
                label -= 14.0;
            }
            taken.push([x, label]);
            svg.line("peak", [x, label + 4.0], [x, y.at(samples.background_dn)]);
            svg.text("num", [x, label], Anchor::Middle, &number.to_string());
        }
    }

    fn residual(&self, svg: &mut Svg, y: &Scale, is_first: bool) {
        let [left, right] = self.x.to;
        svg.rect("one", [left, y.at(1.0)], [right, y.at(-1.0)]);
        self.frame(svg, y, 4.0, is_first, true);
        svg.line("zero", [left, y.at(0.0)], [right, y.at(0.0)]);
        for limit in [FAR_SD, -FAR_SD] {
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

    /// Draws frame, grid and axis labels.
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
