//! `filter_outliers`: marks isolated returns.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use wavex_line::keys::{InvalidKey, above};
use wavex_line::scan_line::{Kind, ScanLine};
use wavex_line::stage::{Config, Output, Result, RunContext, StageSpec, Transform, TransformConfig};

mod geometry;
mod line_window;
mod model;
#[cfg(test)]
mod tests;

use line_window::OutlierWindow;
use model::ModelFilter;

/// Registry entry of the stage.
pub const STAGE: StageSpec = StageSpec::transform::<FilterOutliers>("filter_outliers", &[Kind::Returns]);

/// Marks isolated returns; rejects waveforms that deviate from their line.
///
/// A return is supported if at least three others can be reached from it in steps of at most
/// `max_range_m`, or of 2.5 times the shot or line spacing if that is larger. The search covers the
/// return's own line and sixteen lines on each side. Wires form chains of returns, and ground and
/// roofs form surfaces; false returns have at most a few neighbours of their kind. Unsupported
/// returns are marked as withheld, class 7 (below their neighbours) or 18; they are never removed.
///
/// A waveform is rejected if all of its returns are unsupported and lie more than `max_height_m`
/// above both neighbours in its line, or below both, at an acute angle.
///
/// Without a trajectory (scanner frame), the sensor is assumed to move straight on by half a shot
/// spacing per line, and heights are taken along the main viewing axis of the scanner. Nearly the
/// same returns are marked as with a trajectory. The report says so.
/// `docs/explanation/outliers.md` gives the method and measurements.
///
/// **`method = "model"`** marks returns that contradict other beams: returns below the surface that other
/// beams have met, and objects in the air, of any size, through whose place other beams have passed. It rejects no
/// waveforms. Lines are held back in blocks of 250 m along the flight, with 100 m before and after. If `memory_mb` cannot
/// hold them, blocks are shorter, and the report says so. `docs/explanation/ground.md` compares both methods.
///
/// `method = "neighbours"` holds back sixteen lines. If `memory_mb` cannot hold them, it holds back fewer, and the report
/// says so.
///
/// Counts `np_air np_low`, including rejected returns, and `nw_deleted`; rejected returns count as
/// `np_filtered`.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct FilterOutliers {
    /// Method: neighbours within steps (`neighbours`), or free space along beams (`model`).
    pub method: OutlierMethod,
    /// Reject waveforms that deviate from their line.
    pub waves: bool,
    /// Mark isolated returns.
    pub points: bool,
    /// Angle between the two neighbours as seen from a waveform, degrees, above which it is not a
    /// jump.
    #[schemars(range(min = 0.0, max = 180.0))]
    pub min_angle_deg: f64,
    /// Height above or below both neighbours that makes a waveform a jump, m. Without
    /// power lines, the height of the highest trees is suitable.
    #[schemars(transform = above(0.0).at_most(100_000.0))]
    pub max_height_m: f64,
    /// Largest distance from one return to the next, m.
    #[schemars(range(min = 0.1, max = 1000.0))]
    pub max_range_m: f64,
}

/// Method to recognise outliers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum OutlierMethod {
    /// Returns that few others can be reached from.
    Neighbours,
    /// Returns that contradict other beams.
    Model,
}

impl Default for FilterOutliers {
    fn default() -> FilterOutliers {
        FilterOutliers {
            method: OutlierMethod::Neighbours,
            waves: true,
            points: true,
            min_angle_deg: 2.0,
            max_height_m: 50.0,
            max_range_m: 4.0,
        }
    }
}

impl Config for FilterOutliers {
    fn check(&self) -> std::result::Result<(), InvalidKey> {
        InvalidKey::unless(
            self.waves || self.points,
            "points",
            "with `waves = false` it must be `true`; otherwise the stage does nothing",
        )?;
        InvalidKey::unless(
            self.points || self.method == OutlierMethod::Neighbours,
            "points",
            "with `method = \"model\"` it must be `true`; this method marks points only",
        )
    }
}

impl TransformConfig for FilterOutliers {
    fn make(&self, run: &RunContext) -> Result<Box<dyn Transform>> {
        if self.method == OutlierMethod::Model {
            return Ok(Box::new(ModelFilter::new(self.max_range_m, run)));
        }
        Ok(Box::new(OutlierFilter { strip: OutlierWindow::new(self.clone()) }))
    }
}

struct OutlierFilter {
    strip: OutlierWindow,
}

impl Transform for OutlierFilter {
    fn process(&mut self, line: ScanLine, out: &mut Output) -> Result<()> {
        self.strip.push(line, out)
    }

    fn finish(&mut self, out: &mut Output) -> Result<()> {
        self.strip.finish(out)
    }
}
