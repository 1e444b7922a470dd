//! Frame of a map view, with grid and colour scale.

use super::frame::{Plot, PlotStyle, WIDTH};
use super::picture::{Picture, Ramp, css};
use super::scale::AxisScale;
use super::svg::{Anchor, Svg};

/// Maximum size of a map, SVG units.
const MAP: [f64; 2] = [440.0, 420.0];
const LEFT: f64 = 104.0;
const TOP: f64 = 10.0;
/// Margin right of a map, SVG units.
const MARGIN: f64 = 16.0;
/// Minimum width of a map view: room for its colour scale.
const LEAST_WIDTH: f64 = 334.0;
/// Length of a colour scale, SVG units.
const COLOURS: f64 = 130.0;
const STYLE: PlotStyle = PlotStyle { below: [22.0, 40.0, 46.0], ..PlotStyle::RUN };

/// Frame of a map view.
pub(crate) struct MapFrame {
    pub(crate) plot: Plot,
    axes: [String; 2],
}

impl MapFrame {
    /// A map of this extent; `slimmer`: length of a unit of x relative to a unit of y.
    pub(crate) fn new(x: [f64; 2], y: [f64; 2], slimmer: f64, axes: [String; 2]) -> MapFrame {
        let (width, height) = (slimmer * (x[1] - x[0]).max(1e-12), (y[1] - y[0]).max(1e-12));
        let size = (MAP[0] / width).min(MAP[1] / height);
        let (right, bottom) = (LEFT + (width * size).max(40.0), TOP + (height * size).max(40.0));
        let (x, y) = (AxisScale { from: x, to: [LEFT, right] }, AxisScale { from: y, to: [bottom, TOP] });
        MapFrame { plot: Plot { x, y, style: STYLE }, axes }
    }

    /// Width of the picture, SVG units.
    pub(crate) fn width(&self) -> f64 {
        (self.plot.x.to[1] + MARGIN).clamp(LEAST_WIDTH, WIDTH)
    }

    /// Draws an image that fills the map.
    pub(crate) fn image(&self, svg: &mut Svg, id: &str, picture: &Picture) {
        let ([left, right], [bottom, top]) = (self.plot.x.to, self.plot.y.to);
        svg.image(id, &picture.data_url(), [left, top], [right, bottom]);
    }

    /// Draws the grid of the coordinates.
    pub(crate) fn grid(&self, svg: &mut Svg) {
        let ([left, right], [bottom, top]) = (self.plot.x.to, self.plot.y.to);
        let (width, height) = (right - left, bottom - top);
        self.plot.grid_y(svg, self.plot.ticks_y((height / 60.0).max(1.0)));
        // The last label must not exceed the picture, nor the first one the axis title.
        let room = |(value, text): &(f64, String)| {
            let half = 4.5 * text.chars().count() as f64;
            (half..self.width() - half).contains(&self.plot.x.at(*value))
        };
        self.plot.grid_x(svg, self.plot.ticks_x((width / 110.0).max(1.0)).into_iter().filter(room));
    }

    /// Draws frame and axis titles, and returns the figure.
    pub(crate) fn finish(&self, mut svg: Svg, title: &str) -> String {
        let below = self.frame(&mut svg);
        svg.inline(self.width(), below, title)
    }

    /// Draws frame and axis titles; returns the lower edge of the titles.
    fn frame(&self, svg: &mut Svg) -> f64 {
        self.plot.frame(svg, &self.axes);
        self.plot.y.to[0] + STYLE.below[2]
    }

    /// Draws grid, frame, axis titles and the colours between two values, and returns the figure.
    pub(crate) fn finish_coloured(
        &self,
        mut svg: Svg,
        title: &str,
        colours: &Ramp,
        [low, high]: [String; 2],
    ) -> String {
        self.grid(&mut svg);
        let top = self.frame(&mut svg) + 8.0;
        let each = COLOURS / colours.len() as f64;
        for (i, colour) in css(colours).iter().enumerate() {
            let left = LEFT + each * i as f64;
            svg.swatch(colour, [left, top], [left + each, top + 12.0]);
        }
        svg.text("", [LEFT - 7.0, top + 10.5], Anchor::End, &low);
        svg.text("", [LEFT + COLOURS + 5.0, top + 10.5], Anchor::Start, &high);
        svg.inline(self.width(), top + 20.0, title)
    }
}
