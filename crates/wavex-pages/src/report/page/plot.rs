//! Axes and frame common to the figures of a run.

use crate::report::numbers::label;
use crate::report::svg::{Anchor, Scale, Svg};

/// Width of a figure, SVG units.
pub(crate) const WIDTH: f64 = 560.0;

/// Half of the width of a digit in the largest text of a figure, on narrow screens and in print.
const HALF_DIGIT: f64 = 4.6;

/// A framed area with its scales; logarithmic scales are in decades.
pub(crate) struct Plot {
    pub(crate) x: Scale,
    pub(crate) y: Scale,
}

/// Middle of a label at this horizontal position: the last one stays within the picture.
pub(crate) fn middle_of_label(x: f64, text: &str) -> f64 {
    x.min(WIDTH - HALF_DIGIT * text.chars().count() as f64)
}

/// Axis position and its label.
pub(crate) type Tick = (f64, String);

impl Plot {
    /// Creates a plot of the usual size with these axis ranges.
    pub(crate) fn new(x: [f64; 2], y: [f64; 2]) -> Plot {
        Plot { x: Scale { from: x, to: [92.0, 546.0] }, y: Scale { from: y, to: [214.0, 14.0] } }
    }

    pub(crate) fn at(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let within = |value: f64, [a, b]: [f64; 2]| value.clamp(a.min(b), a.max(b));
        [within(self.x.at(x), self.x.to), within(self.y.at(y), self.y.to)]
    }

    /// Keeps points within the horizontal axis range and scales them.
    pub(crate) fn inside(&self, points: impl Iterator<Item = [f64; 2]>) -> impl Iterator<Item = [f64; 2]> {
        let [low, high] = self.x.from;
        points.filter(move |[x, _]| (low..=high).contains(x)).map(|point| self.at(point))
    }

    /// Draws grid lines and labels of the horizontal axis.
    pub(crate) fn grid_x(&self, svg: &mut Svg, ticks: Vec<Tick>) {
        let [bottom, top] = self.y.to;
        for (value, text) in ticks {
            let x = self.x.at(value);
            svg.line("grid", [x, top], [x, bottom]);
            svg.text("", [middle_of_label(x, &text), bottom + 22.0], Anchor::Middle, &text);
        }
    }

    /// Draws grid lines and labels of the vertical axis.
    pub(crate) fn grid_y(&self, svg: &mut Svg, ticks: Vec<Tick>) {
        let [left, right] = self.x.to;
        for (value, text) in ticks {
            let y = self.y.at(value);
            svg.line("grid", [left, y], [right, y]);
            svg.text("", [left - 7.0, y + 4.0], Anchor::End, &text);
        }
    }

    /// Draws grid lines at round values of both axes.
    pub(crate) fn grid(&self, svg: &mut Svg) {
        self.grid_y(svg, ticks(&self.y, 5.0));
        self.grid_x(svg, ticks(&self.x, 6.0));
    }

    /// Draws the frame and the axis titles.
    pub(crate) fn frame(&self, svg: &mut Svg, x: &str, y: &str) {
        let ([left, right], [bottom, top]) = (self.x.to, self.y.to);
        svg.rect("frame", [left, top], [right, bottom]);
        svg.text("", [0.5 * (left + right), bottom + 40.0], Anchor::Middle, x);
        svg.upright_text("", [17.0, 0.5 * (top + bottom)], y);
    }

    /// Draws the frame and returns the figure.
    pub(crate) fn finish(&self, mut svg: Svg, title: &str, x: &str, y: &str) -> String {
        self.frame(&mut svg, x, y);
        svg.inline(WIDTH, self.y.to[0] + 50.0, title)
    }
}

/// Round values on a scale, about `wanted`.
pub(crate) fn ticks(scale: &Scale, wanted: f64) -> Vec<Tick> {
    let (values, digits) = scale.ticks(wanted);
    values.into_iter().map(|value| (value, label(value, digits))).collect()
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
        plot.grid_x(&mut svg, vec![(0.5, "0.5".into()), (1.0, "−4.500".into())]);
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
