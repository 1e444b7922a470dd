//! Fit of a shot with its samples, for display.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::packed;
use crate::scan_line::{Emission, Returns};

/// Points of a fitted curve per sample.
pub const CURVE_POINTS_PER_SAMPLE: usize = 8;

/// A shot with its fit.
#[derive(Clone, Debug)]
pub struct FittedShot {
    /// The shot, with its fitted emission time.
    pub emission: Emission,
    /// Returns, in time order.
    pub returns: Returns,
    /// Blocks with echoes, in time order.
    pub blocks: Vec<FittedBlock>,
}

/// Samples of a block and their fit; lists are space-separated numbers.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct FittedSamples {
    /// Sampling interval, ns.
    pub interval_ns: f64,
    /// Recorded samples, DN.
    #[serde(serialize_with = "packed::serialize", deserialize_with = "packed::deserialize")]
    #[schemars(with = "String")]
    pub samples_dn: Vec<u16>,
    /// Samples as fitted, DN: with the receiver's tail removed, if the model has one.
    #[serde(serialize_with = "packed::serialize", deserialize_with = "packed::deserialize")]
    #[schemars(with = "String")]
    pub fitted_dn: Vec<f64>,
    /// Sampling times, in samples after the first.
    #[serde(serialize_with = "packed::serialize", deserialize_with = "packed::deserialize")]
    #[schemars(with = "String")]
    pub taken_at: Vec<f64>,
    /// Saturation level, DN.
    pub full_scale_dn: f64,
    /// Whether each sample was used in the fit.
    #[serde(serialize_with = "packed::serialize", deserialize_with = "packed::deserialize")]
    #[schemars(with = "String")]
    pub used: Vec<bool>,
    /// Background, mean over the sample phases, DN.
    pub background_dn: f64,
    /// Pulses above the background, sorted by position, [`CURVE_POINTS_PER_SAMPLE`] points per
    /// sample from the first.
    #[serde(serialize_with = "packed::lists::serialize", deserialize_with = "packed::lists::deserialize")]
    #[schemars(with = "Vec<String>")]
    pub pulses_dn: Vec<Vec<f64>>,
    /// Residuals of the fit, in standard deviations.
    #[serde(serialize_with = "packed::serialize", deserialize_with = "packed::deserialize")]
    #[schemars(with = "String")]
    pub residual: Vec<f64>,
}

/// A block with echoes.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct FittedBlock {
    /// Receiver: `low`, `high` or `joint`.
    pub channel: String,
    /// Time of flight of the first sample, ns.
    pub first_ns: f64,
    /// Residual sum of squares, weighted.
    pub chi_square: f64,
    /// Number of samples minus number of parameters.
    pub degrees_of_freedom: u32,
    /// Peaks of its returns.
    pub peaks: Vec<FittedPeak>,
    /// The samples.
    #[serde(flatten)]
    pub samples: FittedSamples,
}

/// Peak of a return in its block.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct FittedPeak {
    /// Number of the return; absent if it was dropped.
    pub number: Option<u8>,
    /// Position, in samples after the first.
    pub position_samples: f64,
}

impl FittedSamples {
    /// The fit including background, [`CURVE_POINTS_PER_SAMPLE`] points per sample from the first.
    pub fn fit_dn(&self) -> Vec<f64> {
        let points = self
            .pulses_dn
            .first()
            .map_or(self.samples_dn.len().saturating_sub(1) * CURVE_POINTS_PER_SAMPLE + 1, Vec::len);
        let mut fit = vec![self.background_dn; points];
        for pulse in &self.pulses_dn {
            fit.iter_mut().zip(pulse).for_each(|(sum, value)| *sum += value);
        }
        fit
    }

    /// Whether sample `k` is saturated.
    pub fn is_saturated(&self, k: usize) -> bool {
        self.samples_dn.get(k).is_some_and(|&sample| f64::from(sample) >= self.full_scale_dn)
    }

    /// Number of samples not used in the fit.
    pub fn left_out(&self) -> usize {
        self.used.iter().filter(|used| !**used).count()
    }

    /// Duration, ns, including half a sample at both ends.
    pub fn span_ns(&self) -> f64 {
        self.samples_dn.len() as f64 * self.interval_ns
    }
}
