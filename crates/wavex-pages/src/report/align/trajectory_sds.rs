//! SDs of trajectories in the report of an alignment.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Factors of the SDs of the trajectories, as the strips show them.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct TrajectorySds {
    /// Of positions.
    pub position: SdFactor,
    /// Of roll, pitch and heading.
    pub attitude: SdFactor,
}

/// Factor of given SDs.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct SdFactor {
    /// Estimated factor.
    pub factor: f64,
    /// Number of independent offsets that determine it; below 3 it is not used.
    pub offsets: f64,
    /// Whether the SDs were multiplied by it; otherwise it is too uncertain, or differs from 1 by chance.
    pub is_used: bool,
}
