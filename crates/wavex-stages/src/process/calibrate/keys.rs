//! Keys of `calibrate`.

use std::path::PathBuf;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Preset, SharedModel};
use wavex_line::keys::{InvalidKey, above};
use wavex_line::stage::{Config, LookAhead};

/// Estimates the sensor model for `decompose` from the first waveforms.
///
/// For each receiver it estimates the background (per sample index modulo 4, or per waveform if no
/// sample is free of signal), the noise and its correlation, and the system response: the shape of
/// a pulse from a flat target with its after-pulse and tail, from single echoes. It also estimates
/// the error of the response, and the factor by which errors on a pulse exceed those expected from
/// the noise. Signal is separated from noise by fitted pulses, never by a threshold on samples. At
/// most 20 000 evenly chosen waveforms of an echo receiver and 2000 of the outgoing pulse are used.
///
/// Where the recorded outgoing pulse explains the echoes clearly better than their own response, it
/// is used instead: over vegetation under a large footprint few echoes are single and narrow. The
/// level at which a receiver clips, the height from which it is overdriven, and whether it recovers
/// from clipping at once are measured where enough strong echoes exist. The report has the residuals
/// with both responses, the source of the noise, and these limits.
///
/// Holds back the first lines until it has enough waveforms, then lets everything through. The
/// model travels with every line and is included in the report. A receiver with fewer than 200
/// waveforms, or an outgoing pulse recorded fewer than 20 times, is left out, and the report says
/// so. If no echo receiver has enough waveforms, the run fails.
///
/// A job over several inputs calibrates once for all inputs of an instrument, before the first of them
/// (`[job] model`).
///
/// The model is compared with the first waveforms before a line leaves: noise and its correlation,
/// background, width and shape of clear single echoes, template error, clipping level, waveforms without
/// echo. Each significant difference is a warning with measured and expected value; fewer than 200
/// waveforms are not compared. Changes of noise and background along the recording are warnings as well.
/// Blocks whose samples are all equal although the receiver has noise, or flat and far from the background,
/// are removed and counted: they have no echoes. `docs/explanation/sabotage.md` lists what is noticed.
///
/// A saved model (`save` writes to `output_dir`, `load` reads from `input_dir`) is used in another run or
/// on another recording, even for a single waveform. It is unchanged unless the comparison contradicts
/// it: then the measured noise replaces its noise, each waveform gets its own background, and a pulse shape
/// that does not fit raises the standard deviations. It may lack channels, which
/// are then not used, and may be written by hand; `schemas/sensor_model.schema.json` describes its
/// format. A `preset` is the model of another instrument of the same type, for recordings too short
/// to calibrate from. No preset was tested on an instrument other than the measured one.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Calibrate {
    /// Number of waveforms to calibrate from. Fewer are used if the input has fewer, or if
    /// `memory_mb` cannot hold them.
    #[schemars(range(min = 200, max = i64::MAX))]
    pub waveforms: u64,
    /// Background of a waveform: common to the receiver (`fixed`), fitted per waveform
    /// (`per_waveform`), or decided from the data (`auto`).
    pub background: BackgroundKey,
    /// Pulse shape: the system response estimated from single echoes (`auto`), or a Gaussian of the
    /// measured width (`gaussian`).
    pub response: ResponseKey,
    /// Area of the exponential tail of an echo relative to the echo. With `"auto"` the tail is part of
    /// the response, which extends to the end of the block.
    #[schemars(transform = above(-0.9).below(0.9))]
    pub decay_amplitude: AutoOrNumber,
    /// Time constant of that tail, ns; `"auto"` as for `decay_amplitude`. Give both or neither.
    #[schemars(transform = above(0.0).at_most(1e6))]
    pub decay_time_ns: AutoOrNumber,
    /// File to save the model to, as JSON, for runs that must reproduce this one exactly.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub save: Option<String>,
    /// Model file written by `save`. Its model is used, and nothing is calibrated.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub load: Option<PathBuf>,
    /// Model of an instrument type, measured on one instrument. Nothing is calibrated. Excludes
    /// `load`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub preset: Option<Preset>,
    #[serde(skip)]
    pub(super) shared: SharedModel,
}

/// A number, or `auto`.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum AutoOrNumber {
    /// The given number.
    Number(f64),
    /// Estimated from the recording.
    Auto(Auto),
}

/// The keyword `auto`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Auto {
    /// Estimated from the recording.
    Auto,
}

impl AutoOrNumber {
    pub(crate) const AUTO: AutoOrNumber = AutoOrNumber::Auto(Auto::Auto);

    pub(crate) fn number(self) -> Option<f64> {
        match self {
            AutoOrNumber::Number(number) => Some(number),
            AutoOrNumber::Auto(_) => None,
        }
    }
}

/// Pulse shape.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ResponseKey {
    /// The system response, if there are 150 usable single echoes; otherwise that of the other
    /// receiver, or else a Gaussian. The report says which.
    Auto,
    /// A Gaussian of the measured width.
    Gaussian,
}

/// Source of the background.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum BackgroundKey {
    /// Fixed if samples are free of signal, otherwise per waveform.
    Auto,
    /// Common to the receiver, per sample index modulo 4.
    Fixed,
    /// A free parameter of each waveform.
    PerWaveform,
}

impl Default for Calibrate {
    fn default() -> Calibrate {
        Calibrate {
            waveforms: LookAhead::WAVEFORMS,
            background: BackgroundKey::Auto,
            response: ResponseKey::Auto,
            decay_amplitude: AutoOrNumber::AUTO,
            decay_time_ns: AutoOrNumber::AUTO,
            save: None,
            load: None,
            preset: None,
            shared: SharedModel::default(),
        }
    }
}

impl Config for Calibrate {
    fn check(&self) -> std::result::Result<(), InvalidKey> {
        InvalidKey::unless(
            self.load.is_none() || self.preset.is_none(),
            "preset",
            "`preset` and `load` both give a model: remove one of them",
        )?;
        let (amplitude, time_ns) = (self.decay_amplitude.number(), self.decay_time_ns.number());
        let (given, missing) = match amplitude {
            Some(_) => ("decay_amplitude", "it also needs decay_time_ns"),
            None => ("decay_time_ns", "it also needs decay_amplitude"),
        };
        InvalidKey::unless(amplitude.is_some() == time_ns.is_some(), given, missing)
    }

    fn inputs(&self) -> Vec<&str> {
        self.load.iter().filter_map(|path| path.to_str()).collect()
    }
}
