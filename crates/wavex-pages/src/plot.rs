//! Drawing of all figures: SVG elements, axes, curves, bars, maps, legends, fitted waveforms.

mod frame;
mod legend;
mod map_frame;
mod panels;
mod picture;
mod scale;
mod svg;

pub use frame::{Plot, PlotStyle, Tick};
pub(crate) use frame::{WIDTH, decades};
pub(crate) use legend::{Legend, Mark, fit_marks};
pub(crate) use map_frame::MapFrame;
pub(crate) use panels::{Panels, dots};
pub use picture::Picture;
pub(crate) use picture::{HEIGHTS, INTENSITIES, Ramp};
pub use scale::{AxisScale, extent};
pub use svg::{Anchor, Svg};
