//! Control points in the report of an alignment.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Control points and their differences.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct ControlReport {
    /// Path of the file.
    pub file: String,
    /// Coordinate reference system.
    pub crs: String,
    /// Reference of the heights: ellipsoidal, or the geoid.
    pub heights: String,
    /// Factor by which the SDs of the differences were enlarged; above 2: the points contradict the trajectories.
    pub scale: f64,
    /// Points in the order of the file.
    pub points: Vec<ControlPointReport>,
}

/// A control point.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct ControlPointReport {
    /// Name.
    pub name: String,
    /// Use.
    pub used: ControlUse,
    /// Why it is not used.
    pub reason: Option<String>,
    /// Strips with a smooth surface there.
    pub strips: Vec<ControlStrip>,
}

/// Use of a control point.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum ControlUse {
    /// By one strip at least.
    Used,
    /// All its differences are blunders.
    Rejected,
    /// No strip has a smooth surface there.
    Unused,
}

/// Difference of a strip from a control point along the normal of the surface, strip minus point.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct ControlStrip {
    /// Name of the strip.
    pub strip: String,
    /// With the start values, m; `null` without a smooth surface there.
    pub before_m: Option<f64>,
    /// With the results, m.
    pub after_m: f64,
    /// SD of the difference from point and surface, m.
    pub sd_m: f64,
    /// Whether it was used.
    pub is_used: bool,
}
