//! A framed area with axes, and the data drawn in it.

use super::scale::AxisScale;
use super::svg::{Anchor, Svg};
use crate::numbers::label;

/// Width of a figure, SVG units.
pub(crate) const WIDTH: f64 = 560.0;

/// Half of the width of a digit in the largest text of a figure, on narrow screens and in print.
const HALF_DIGIT: f64 = 4.6;

/// Format and position of the texts around a plot, SVG units.
#[derive(Clone, Copy)]
pub struct PlotStyle {
    /// Formats a tick value with a number of decimal places.
    pub label: fn(f64, usize) -> String,
    /// Distances below the frame: tick labels, axis title, lower edge of the picture.
    pub below: [f64; 3],
    /// Horizontal position of the title of the vertical axis.
    pub title_x: f64,
    /// Right edge of the picture, which tick labels must not exceed.
    pub right_edge: f64,
}

impl PlotStyle {
    /// Figures of a run or a survey.
    pub(crate) const RUN: PlotStyle =
        PlotStyle { label, below: [22.0, 40.0, 50.0], title_x: 17.0, right_edge: WIDTH };
    /// Pictures in files of their own.
    pub const FILE: PlotStyle =
        PlotStyle { label: plain, below: [17.0, 38.0, 0.0], title_x: 16.0, right_edge: f64::INFINITY };
}

fn plain(value: f64, digits: usize) -> String {
    format!("{value:.digits$}")
}

/// A framed area with its scales; logarithmic scales are in decades.
pub struct Plot {
    /// Horizontal axis.
    pub x: AxisScale,
    /// Vertical axis, from bottom to top.
    pub y: AxisScale,
    /// Texts around the frame.
    pub style: PlotStyle,
}

/// Axis position and its label; an empty label is not drawn.
pub type Tick = (f64, String);

impl Plot {
    /// Creates a plot of a run's page with these axis ranges.
    pub(crate) fn new(x: [f64; 2], y: [f64; 2]) -> Plot {
        let (x, y) = (AxisScale { from: x, to: [92.0, 546.0] }, AxisScale { from: y, to: [214.0, 14.0] });
        Plot { x, y, style: PlotStyle::RUN }
    }

    /// Position of a point; points outside the frame are moved to its edge.
    pub fn at(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let within = |value: f64, [a, b]: [f64; 2]| value.clamp(a.min(b), a.max(b));
        [within(self.x.at(x), self.x.to), within(self.y.at(y), self.y.to)]
    }

    /// Round values of the horizontal axis, about `wanted`.
    pub fn ticks_x(&self, wanted: f64) -> Vec<Tick> {
        self.ticks(&self.x, wanted)
    }

    /// Round values of the vertical axis, about `wanted`.
    pub fn ticks_y(&self, wanted: f64) -> Vec<Tick> {
        self.ticks(&self.y, wanted)
    }

    fn ticks(&self, scale: &AxisScale, wanted: f64) -> Vec<Tick> {
        let (values, digits) = scale.ticks(wanted);
        values.into_iter().map(|value| (value, (self.style.label)(value, digits))).collect()
    }

    /// Draws grid lines and labels of the horizontal axis.
    pub fn grid_x(&self, svg: &mut Svg, ticks: impl IntoIterator<Item = Tick>) {
        let [bottom, top] = self.y.to;
        for (value, text) in ticks {
            let x = self.x.at(value);
            svg.line("grid", [x, top], [x, bottom]);
            if !text.is_empty() {
                // The last label stays within the picture.
                let middle = x.min(self.style.right_edge - HALF_DIGIT * text.chars().count() as f64);
                svg.text("", [middle, bottom + self.style.below[0]], Anchor::Middle, &text);
            }
        }
    }

    /// Draws grid lines and labels of the vertical axis.
    pub fn grid_y(&self, svg: &mut Svg, ticks: impl IntoIterator<Item = Tick>) {
        let [left, right] = self.x.to;
        for (value, text) in ticks {
            let y = self.y.at(value);
            svg.line("grid", [left, y], [right, y]);
            if !text.is_empty() {
                svg.text("", [left - 7.0, y + 4.0], Anchor::End, &text);
            }
        }
    }

    /// Draws grid lines at about `x` and `y` round values of the axes.
    pub fn grid(&self, svg: &mut Svg, [x, y]: [f64; 2]) {
        self.grid_y(svg, self.ticks_y(y));
        self.grid_x(svg, self.ticks_x(x));
    }

    /// A picture with the grid of [`Plot::grid`].
    pub(crate) fn with_grid(&self, wanted: [f64; 2]) -> Svg {
        let mut svg = Svg::new();
        self.grid(&mut svg, wanted);
        svg
    }

    /// Draws straight lines from point to point.
    pub fn curve(&self, svg: &mut Svg, class: &str, points: impl Iterator<Item = [f64; 2]>) {
        svg.curve(class, points.map(|point| self.at(point)));
    }

    /// Draws a histogram as one area: edges and height of each bin; `feet`: its ends on the axis.
    pub(crate) fn bars(
        &self,
        svg: &mut Svg,
        bins: impl IntoIterator<Item = ([f64; 2], f64)>,
        feet: [f64; 2],
    ) {
        let steps = bins.into_iter().flat_map(|([low, high], height)| [[low, height], [high, height]]);
        let corners = [[feet[0], 0.0]].into_iter().chain(steps).chain([[feet[1], 0.0]]);
        svg.area("bars", corners.map(|corner| self.at(corner)));
    }

    /// Draws a bar of two standard deviations up and down.
    pub(crate) fn error_bar(&self, svg: &mut Svg, [x, y]: [f64; 2], sd: f64) {
        let [low, high] = [-2.0, 2.0].map(|times| self.at([x, y + times * sd]));
        svg.line("span", low, high);
    }

    /// Draws a line across the frame at a value of the horizontal axis.
    pub(crate) fn line_x(&self, svg: &mut Svg, class: &str, value: f64) {
        let (x, [bottom, top]) = (self.x.at(value), self.y.to);
        svg.line(class, [x, top], [x, bottom]);
    }

    /// Draws a line across the frame at a value of the vertical axis.
    pub(crate) fn line_y(&self, svg: &mut Svg, class: &str, value: f64) {
        let (y, [left, right]) = (self.y.at(value), self.x.to);
        svg.line(class, [left, y], [right, y]);
    }

    /// Draws the frame.
    pub(crate) fn border(&self, svg: &mut Svg) {
        let ([left, right], [bottom, top]) = (self.x.to, self.y.to);
        svg.rect("frame", [left, top], [right, bottom]);
    }

    /// Draws the titles of the horizontal and the vertical axis.
    pub(crate) fn titles(&self, svg: &mut Svg, [x, y]: &[impl AsRef<str>; 2]) {
        let ([left, right], [bottom, top]) = (self.x.to, self.y.to);
        let middle = [0.5 * (left + right), bottom + self.style.below[1]];
        svg.text("", middle, Anchor::Middle, x.as_ref());
        svg.upright_text("", [self.style.title_x, 0.5 * (top + bottom)], y.as_ref());
    }

    /// Draws the frame and the axis titles.
    pub fn frame(&self, svg: &mut Svg, titles: &[impl AsRef<str>; 2]) {
        self.border(svg);
        self.titles(svg, titles);
    }

    /// Draws frame and axis titles and returns the figure.
    pub(crate) fn finish(&self, mut svg: Svg, title: &str, x: &str, y: &str) -> String {
        self.frame(&mut svg, &[x, y]);
        svg.inline(WIDTH, self.y.to[0] + self.style.below[2], title)
    }
}

/// Powers of ten within these decades.
///
/// Short ranges also get 2 and 5 times each power.
pub(crate) fn decades([low, high]: [f64; 2]) -> Vec<Tick> {
    let steps: &[f64] = if high - low > 2.5 { &[1.0] } else { &[1.0, 2.0, 5.0] };
    let powers = (low.floor().max(-300.0) as i32)..=(high.ceil().min(300.0) as i32);
    let all = powers
        .take(100)
        .flat_map(|power| steps.iter().map(move |step| (f64::from(power) + step.log10(), power, *step)));
    let within = all.filter(|(at, ..)| (low..=high).contains(at));
    let text = |(at, power, step): (f64, i32, f64)| {
        let digits = usize::try_from(-power).unwrap_or(0);
        (at, label(step * 10f64.powi(power), digits))
    };
    within.map(text).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_label_stays_within_the_picture() {
        let mut svg = Svg::new();
        let plot = Plot::new([0.0, 1.0], [0.0, 1.0]);
        plot.grid_x(&mut svg, [(0.5, "0.5".into()), (1.0, "−4.500".into())]);
        let picture = svg.inline(WIDTH, 100.0, "");
        assert!(picture.contains("x=\"319.0\"") && picture.contains("x=\"532.4\""), "{picture}");
    }

    #[test]
    fn decades_have_their_powers_and_more_where_there_are_few() {
        let texts = |range| decades(range).into_iter().map(|(_, text)| text).collect::<Vec<_>>().join(" ");
        assert_eq!(texts([-2.0, 1.0]), "0.01 0.1 1 10");
        assert_eq!(texts([0.0, 1.0]), "1 2 5 10");
        assert!(decades([f64::NEG_INFINITY, f64::INFINITY]).len() <= 300, "never endless");
    }
}
