//! Keys that readers share, as tables that they flatten into their own.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::time::{self, RecordingTime, ScaleKey};
use wavex_line::georef::declared;
use wavex_line::keys::{InvalidKey, above, at_least};
use wavex_line::scan_line::InputInfo;

/// Speed of light in vacuum, m/s.
const LIGHT_MPS: f64 = 299_792_458.0;

/// Times of a recording.
#[derive(Clone, Debug, Default, Deserialize, Serialize, JsonSchema)]
pub struct TimeKeys {
    /// First and last second to read, both included, in the times of the recording or of
    /// `time_scale`. Shots outside are skipped; shots without a time are rejected.
    #[serde(default)]
    #[schemars(transform = at_least(-1e12).at_most(1e12))]
    pub time_s: Option<[f64; 2]>,
    /// Time scale of `time_s`: seconds of the GPS week, or adjusted GPS time (seconds since
    /// 1980-01-06, minus 1e9). Output times keep the time scale of the recording.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub time_scale: Option<ScaleKey>,
    /// Time scale of the recording, if the file gives none or a wrong one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub recording_time: Option<RecordingTime>,
    /// The times of the recording are UTC: adds leap seconds. The day must be known from
    /// the times of the recording, the name of an SDF file, or `gps_date`.
    #[serde(default)]
    pub utc: bool,
    /// Added to the times of the recording, s. `time_s` refers to the sums.
    #[serde(default)]
    #[schemars(range(min = -604800.0, max = 604800.0))]
    pub time_offset_s: f64,
    /// Day on which the recording began, such as 2013-06-21. Needed if neither its times
    /// nor, for SDF, the file name give it. Seconds of the day or week then have a date,
    /// and LAS outputs hold adjusted GPS times.
    #[serde(default)]
    pub gps_date: Option<String>,
}

impl TimeKeys {
    pub(crate) fn check(&self) -> Result<(), InvalidKey> {
        let unless = InvalidKey::unless;
        let ordered = self.time_s.is_none_or(|[from, to]| from <= to);
        unless(ordered, "time_s", "it must be two numbers, the first not above the second")?;
        let is_date = self.gps_date.as_ref().is_none_or(|date| time::noon(date).is_some());
        unless(is_date, "gps_date", "it must be a day from 1980-01-06 on, as in 2013-06-21")
    }

    /// Whether any key needs the time scale of the recording.
    pub(super) fn needs_scale(&self) -> bool {
        self.utc || self.gps_date.is_some() || self.time_scale.is_some()
    }
}

/// Timing of the samples of a block.
#[derive(Clone, Copy, Debug, Default, Deserialize, Serialize, JsonSchema)]
pub struct OddSamples {
    /// Delay of the odd samples of a block, in samples. Some digitisers take odd samples late. Pulses
    /// are fitted at the true sample times; nothing is resampled.
    #[serde(default)]
    #[schemars(transform = above(-0.5).below(0.5))]
    pub odd_sample_shift: f64,
}

/// Range of the samples.
#[derive(Clone, Copy, Debug, Default, Deserialize, Serialize, JsonSchema)]
pub struct FullScale {
    /// Largest value of the digitiser, DN. The default is taken from the file; in LAS samples of 16
    /// bits, and in PulseWaves samples of more than 8 bits, give none, because they may hold fewer.
    /// Samples at this value count as clipped, and a receiver counts as overdriven from 82 % of it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 15))]
    pub full_scale_dn: Option<u16>,
}

/// Sampling properties that a job declares.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Sampling(pub(crate) OddSamples, pub(crate) FullScale);

impl Sampling {
    /// Applies the declared properties to the metadata of a file.
    pub(crate) fn with(self, info: InputInfo) -> InputInfo {
        let Sampling(OddSamples { odd_sample_shift }, given) = self;
        let full_scale_dn = given.full_scale_dn.or(info.full_scale_dn);
        let full_scale_is_set = given.full_scale_dn.is_some();
        InputInfo { odd_sample_shift, full_scale_dn, full_scale_is_set, ..info }
    }
}

/// Speed of the pulse.
#[derive(Clone, Copy, Debug, Default, Deserialize, Serialize, JsonSchema)]
pub struct PulseSpeed {
    /// Refractivity of the air for the pulse (group index minus 1), ppm. Defaults to the pulse
    /// speed of the recording.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.0, max = 1000.0))]
    pub refractive_index_ppm: Option<f64>,
}

impl PulseSpeed {
    /// Group velocity of the pulse in air of this refractivity, m/s; `None`: the recording gives it.
    pub(crate) fn group_velocity_mps(self) -> Option<f64> {
        self.refractive_index_ppm.map(|ppm| LIGHT_MPS / (1.0 + 1e-6 * ppm))
    }
}

/// Coordinate reference system of a recording.
#[derive(Clone, Debug, Default, Deserialize, Serialize, JsonSchema)]
pub struct InputCrs {
    /// Projected coordinate reference system of the recording, if the file names none or a wrong
    /// one: `utm:33N`, `EPSG:2154`, or a file with WKT. Overrides the one in the file. A
    /// geographic one is only for coordinates in degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub crs_of_input: Option<String>,
}

impl InputCrs {
    pub(crate) fn check(&self) -> Result<(), InvalidKey> {
        let checked = self.crs_of_input.as_deref().map_or(Ok(()), declared::check);
        checked.map_err(|problem| InvalidKey::new("crs_of_input", problem))
    }

    /// The file that the key names, if any.
    pub(crate) fn file(&self) -> Vec<&str> {
        self.crs_of_input.as_deref().filter(|word| declared::is_file(word)).into_iter().collect()
    }
}
