//! The samples of a block with their fit, as pictures show them.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::packed;

/// Points of a curve to a sample.
pub const PER_SAMPLE: usize = 8;

/// The samples of a block and their fit; lists are numbers separated by blanks.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct Samples {
    /// Time from sample to sample, ns.
    pub interval_ns: f64,
    /// As they were recorded, DN.
    #[serde(serialize_with = "packed::serialize", deserialize_with = "packed::deserialize")]
    #[schemars(with = "String")]
    pub samples_dn: Vec<u16>,
    /// As they were fitted, DN: less the receiver's tail, where the model has one.
    #[serde(serialize_with = "packed::serialize", deserialize_with = "packed::deserialize")]
    #[schemars(with = "String")]
    pub fitted_dn: Vec<f64>,
    /// When each was taken, samples after the first.
    #[serde(serialize_with = "packed::serialize", deserialize_with = "packed::deserialize")]
    #[schemars(with = "String")]
    pub taken_at: Vec<f64>,
    /// Samples at or above this are saturated, DN.
    pub full_scale_dn: f64,
    /// Which samples took part in the fit.
    #[serde(serialize_with = "packed::serialize", deserialize_with = "packed::deserialize")]
    #[schemars(with = "String")]
    pub used: Vec<bool>,
    /// The level without a pulse, the mean over sample phases, DN.
    pub background_dn: f64,
    /// The pulses above the background, by position, [`PER_SAMPLE`] points to a sample from the first.
    #[serde(serialize_with = "packed::lists::serialize", deserialize_with = "packed::lists::deserialize")]
    #[schemars(with = "Vec<String>")]
    pub pulses_dn: Vec<Vec<f64>>,
    /// What the fit leaves, standard deviations.
    #[serde(serialize_with = "packed::serialize", deserialize_with = "packed::deserialize")]
    #[schemars(with = "String")]
    pub residual: Vec<f64>,
}

/// A block of echoes.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct ShownBlock {
    /// The receiver: `low`, `high` or `joint`.
    pub channel: String,
    /// Time of flight of the first sample, ns.
    pub first_ns: f64,
    /// What the fit leaves, as a sum of squares.
    pub chi_square: f64,
    /// Samples less parameters.
    pub degrees_of_freedom: u32,
    /// Where its returns peak.
    pub peaks: Vec<Peak>,
    /// The samples.
    #[serde(flatten)]
    pub samples: Samples,
}

/// Where a return peaks in its block.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct Peak {
    /// The return's number; absent where it was dropped.
    pub number: Option<u8>,
    /// Its place, samples after the first.
    pub position_samples: f64,
}

impl Samples {
    /// The fit, background and all, [`PER_SAMPLE`] points to a sample, from sample `first` on.
    pub fn fit_dn(&self) -> Vec<f64> {
        let points =
            self.pulses_dn.first().map_or(self.samples_dn.len().saturating_sub(1) * PER_SAMPLE + 1, Vec::len);
        let mut fit = vec![self.background_dn; points];
        for pulse in &self.pulses_dn {
            fit.iter_mut().zip(pulse).for_each(|(sum, value)| *sum += value);
        }
        fit
    }

    /// Whether sample `k` is at the end of the digitiser's scale.
    pub fn is_saturated(&self, k: usize) -> bool {
        self.samples_dn.get(k).is_some_and(|&sample| f64::from(sample) >= self.full_scale_dn)
    }

    /// How many samples took no part in the fit.
    pub fn left_out(&self) -> usize {
        self.used.iter().filter(|used| !**used).count()
    }

    /// How long they last, ns, with half a sample before and behind.
    pub fn span_ns(&self) -> f64 {
        self.samples_dn.len() as f64 * self.interval_ns
    }
}
