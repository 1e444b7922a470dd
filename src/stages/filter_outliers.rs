//! Returns that belong to nothing around them.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::batch::{Batch, Kind};
use crate::stage::{Config, InvalidKey, Output, Result, Site, StageSpec, Transform, TransformConfig};

mod geometry;
mod strip;
#[cfg(test)]
mod tests;

use strip::Strip;

/// The stage's place in the registry.
pub const STAGE: StageSpec = StageSpec::transform::<FilterOutliers>("filter_outliers", &[Kind::Returns]);

/// Marks returns that belong to nothing around them, and rejects waveforms that hold nothing else and jump off their line.
///
/// A return belongs to something where three others can be reached from it in steps of `max_range_m`, or of two and a half
/// times the distance of the shots or of the lines where that is more: in its own line and in the sixteen before and behind. A wire
/// is a chain of returns, and ground and roofs are surfaces; false returns have at most a few of their own kind. Those that
/// belong to nothing are marked as withheld, class 20; they are never removed.
///
/// A waveform is rejected where all of its returns belong to nothing and lie more than `max_height_m` above both neighbours
/// in its line, or below them, in an acute angle.
///
/// Where the vertical is not known (in the scanner's own frame, without a trajectory) lines do not tell of each other: only
/// the line itself counts, heights are taken along the axis that the scanner looks along, and wires across the line are
/// taken for outliers. The report says so. Method and figures stand in `docs/explanation/outliers.md`.
///
/// Holds back sixteen lines; fewer, with a note, where `memory_mb` does not hold them.
///
/// Counts `np_air np_low`, rejected returns included, and `nw_deleted`; what is rejected counts as `np_filtered`.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct FilterOutliers {
    /// Reject waveforms that jump off their line.
    pub waves: bool,
    /// Mark returns that belong to nothing.
    pub points: bool,
    /// The angle between the neighbours, seen from a waveform, from which on it is no jump: from 0 to 180.
    pub min_angle_deg: f64,
    /// How far above or below both neighbours a waveform must lie to be a jump, above 0. Without power lines it may be the
    /// height of the highest trees.
    pub max_height_m: f64,
    /// How far one return is from the next at most, from 0.1 to 1000.
    pub max_range_m: f64,
}

impl Default for FilterOutliers {
    fn default() -> FilterOutliers {
        FilterOutliers { waves: true, points: true, min_angle_deg: 2.0, max_height_m: 50.0, max_range_m: 4.0 }
    }
}

impl Config for FilterOutliers {
    fn check(&self) -> std::result::Result<(), InvalidKey> {
        let unless = InvalidKey::unless;
        unless(
            self.waves || self.points,
            "points",
            "with `waves = false` it must be `true`, or the stage does nothing",
        )?;
        unless(
            (0.0..=180.0).contains(&self.min_angle_deg),
            "min_angle_deg",
            "it must lie between 0 and 180",
        )?;
        let height = self.max_height_m > 0.0 && self.max_height_m <= 100_000.0;
        unless(height, "max_height_m", "it must be above 0 and at most 100000")?;
        unless((0.1..=1000.0).contains(&self.max_range_m), "max_range_m", "it must lie between 0.1 and 1000")
    }
}

impl TransformConfig for FilterOutliers {
    fn make(&self, _site: &Site) -> Result<Box<dyn Transform>> {
        Ok(Box::new(Filter { strip: Strip::new(self.clone()) }))
    }
}

struct Filter {
    strip: Strip,
}

impl Transform for Filter {
    fn process(&mut self, batch: Batch, out: &mut Output) -> Result<()> {
        self.strip.push(batch, out)
    }

    fn finish(&mut self, out: &mut Output) -> Result<()> {
        self.strip.finish(out)
    }
}
