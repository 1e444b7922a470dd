//! Values of the keys of `write_las`.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// LAS version.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
pub enum VersionKey {
    /// Point format 6, or 9 with waveforms.
    #[serde(rename = "1.4")]
    V1_4,
    /// Point format 1, or 4 with waveforms.
    #[serde(rename = "1.3")]
    V1_3,
    /// Point format 1.
    #[serde(rename = "1.2")]
    V1_2,
}

/// Destination of waveforms.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum WavePacketsKey {
    /// Not written.
    None,
    /// In a file of the same name with the extension `.wdp`.
    External,
    /// In the file, after the points.
    Internal,
}

/// Destination of the spatial index.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum IndexKey {
    /// Not written.
    None,
    /// In a file of the same name with the extension `.lax`.
    File,
    /// After the points, LAZ only.
    Appended,
}

/// Layout of the attributes of points.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
pub enum AttributeLayout {
    /// Names, types and units of RIEGL and PDAL, with standard deviations within 0.2 %.
    #[serde(rename = "standard")]
    Standard,
    /// Layout of BayesWavEx 1.1.
    #[serde(rename = "1.1")]
    V1_1,
    /// Layout of BayesWavEx 1.0.
    #[serde(rename = "1.0")]
    V1_0,
}
