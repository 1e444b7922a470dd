//! Sensor models of instrument types, for recordings too short to calibrate from.
//!
//! Each was written by `save` for a recording of one instrument; its numbers are rounded to five
//! digits.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use wavex_line::stage::{Result, StageError};
use wavex_signal::sensor_model::SensorModel;

/// Instrument type.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Preset {
    /// RIEGL LMS-Q680i: low-power receiver and outgoing pulse, 8 bits, 1 ns; from 608 waveforms at
    /// 400 kHz.
    RieglLmsQ680i,
    /// RIEGL LMS-Q680: low-power receiver and outgoing pulse, 8 bits, 1 ns; from 16 486 waveforms.
    RieglLmsQ680,
}

impl Preset {
    /// Returns the model of this type.
    pub(super) fn model(self) -> Result<SensorModel> {
        let text = match self {
            Preset::RieglLmsQ680i => include_str!("presets/riegl_lms_q680i.json"),
            Preset::RieglLmsQ680 => include_str!("presets/riegl_lms_q680.json"),
        };
        serde_json::from_str(text)
            .map_err(|error| StageError::failed(error.to_string(), "please report this bug in wavex"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn presets_are_models() {
        for (preset, name, fwhm_ns) in
            [(Preset::RieglLmsQ680i, "riegl_lms_q680i", 4.41), (Preset::RieglLmsQ680, "riegl_lms_q680", 4.1)]
        {
            assert_eq!(serde_json::to_value(preset).unwrap(), name);
            let model = preset.model().unwrap();
            let [low, reference] = [model.low_power.unwrap(), model.reference.unwrap()];
            assert!(low.check().is_ok() && reference.check().is_ok());
            assert!((low.pulse_fwhm_ns - fwhm_ns).abs() < 0.05, "{}", low.pulse_fwhm_ns);
            assert!(low.response.is_some() && reference.response.is_some());
        }
    }
}
