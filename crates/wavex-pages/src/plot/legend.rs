//! Legends: a mark and its text.

use super::svg::{Anchor, Svg};

/// Kind of a mark, with its class in the style sheet.
#[derive(Clone, Copy)]
pub(crate) enum Mark<'c> {
    /// A part of a curve.
    Curve(&'c str),
    /// A straight line.
    Line(&'c str),
    /// A filled area.
    Band(&'c str),
    /// A dot.
    Dot(&'c str),
}

/// Size of a legend's entries, SVG units.
pub(crate) struct Legend {
    /// Width of a mark.
    width: f64,
    /// Gap between a mark and its text.
    gap: f64,
    /// Radius of a dot.
    radius: f64,
}

impl Legend {
    /// Legend of the curves of a figure.
    pub(crate) const CURVES: Legend = Legend { width: 22.0, gap: 6.0, radius: 3.0 };
    /// Legend of stacked bars.
    pub(crate) const BARS: Legend = Legend { width: 12.0, ..Legend::CURVES };
    /// Legend of a picture in a file of its own.
    pub(crate) const FILE: Legend = Legend { width: 24.0, gap: 10.0, radius: 3.0 };
    /// Marks in a picture of 32 by 16 units.
    const PICTURES: Legend = Legend { width: 28.0, gap: 0.0, radius: 3.4 };

    /// Draws a mark, whose left end is at this position, and its text.
    pub(crate) fn entry(&self, svg: &mut Svg, mark: Mark, [left, y]: [f64; 2], text: &str) {
        self.mark(svg, mark, [left, y]);
        svg.text("", [left + self.width + self.gap, y + 4.0], Anchor::Start, text);
    }

    fn mark(&self, svg: &mut Svg, mark: Mark, [left, y]: [f64; 2]) {
        let right = left + self.width;
        match mark {
            Mark::Curve(class) => svg.curve(class, [[left, y], [right, y]].into_iter()),
            Mark::Line(class) => svg.line(class, [left, y], [right, y]),
            Mark::Band(class) => svg.rect(class, [left, y - 6.0], [right, y + 6.0]),
            Mark::Dot(class) => svg.circle(class, [0.5 * (left + right), y], self.radius),
        }
    }
}

impl Mark<'_> {
    /// The mark as a picture of its own.
    pub(crate) fn picture(self, text: &str) -> String {
        let mut svg = Svg::new();
        Legend::PICTURES.mark(&mut svg, self, [2.0, 8.0]);
        svg.inline(32.0, 16.0, text)
    }
}

/// Marks of a fitted waveform, with their texts: four lines, a band, three dots.
///
/// `pulse`: text of the pulse of a return.
pub(crate) fn fit_marks(pulse: &str) -> [(Mark<'_>, &str); 8] {
    [
        (Mark::Line("fit"), "fit"),
        (Mark::Line("pulse"), pulse),
        (Mark::Line("level"), "background"),
        (Mark::Line("limit"), "± 3 standard deviations"),
        (Mark::Band("one"), "± 1 standard deviation"),
        (Mark::Dot("sample"), "sample"),
        (Mark::Dot("sat"), "saturated sample"),
        (Mark::Dot("left"), "sample not used"),
    ]
}
