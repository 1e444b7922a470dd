//! Sensor models of a survey: one per instrument, from all inputs.

use std::collections::BTreeSet;
use std::fmt;
use std::path::Path;
use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use serde_json::Value;

use super::Result;
use crate::scan_line::InputInfo;
use wavex_formats::{Error, read_small_text};
use wavex_signal::fusion::ChannelFusion;
use wavex_signal::sensor_model::{ChannelModel, SensorModel};

/// Version of the format.
const FORMAT: u32 = 1;

/// Largest delay of a receiver, ns.
const MAX_DELAY_NS: f64 = 100.0;

/// Amplitudes between which the range walk is compared, DN.
const WALK_DN: [f64; 2] = [20.0, 100.0];

/// Size limit of a file of survey models, bytes.
const MAX_BYTES: u64 = 1 << 28;

/// Sensor models of a survey.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SurveyModels {
    /// Version of this format: 1.
    pub format: u32,
    /// Version of wavex.
    pub wavex: String,
    /// One model per instrument.
    pub instruments: Vec<InstrumentModel>,
    /// The inputs, in the order of the job.
    pub inputs: Vec<SensorDrift>,
}

/// Properties that identify an instrument and its settings.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Instrument {
    /// Name, if recorded.
    pub name: Option<String>,
    /// Serial number, if recorded.
    pub serial: Option<String>,
    /// Sampling interval, ns.
    pub sampling_interval_ns: f64,
    /// Largest value of the digitiser, DN, if known.
    pub full_scale_dn: Option<u16>,
    /// Delay of odd samples, samples.
    pub odd_sample_shift: f64,
}

/// Model of one instrument.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct InstrumentModel {
    /// The instrument.
    pub instrument: Instrument,
    /// Number of inputs from which the model was made.
    pub inputs: usize,
    /// Gain ratio and delay of the receivers, if `fuse_channels` estimates them.
    pub fusion: Option<ChannelFusion>,
    /// Sensor model, with the range walk that `correct` learnt.
    #[serde(serialize_with = "write_shared", deserialize_with = "read_shared")]
    #[schemars(with = "Option<SensorModel>")]
    pub sensor_model: Option<Arc<SensorModel>>,
    /// Warnings and findings of the calibration.
    pub notes: Vec<String>,
}

/// An input of a survey and what its own waveforms show.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SensorDrift {
    /// Stem of the input.
    pub stem: String,
    /// Index of its instrument; absent if it could not be read or calibrated.
    pub instrument: Option<usize>,
    /// Number of its waveforms that were used.
    pub waveforms: u64,
    /// Why it does not use the model of the survey; absent if it does.
    pub own_model: Option<String>,
    /// Low-power receiver, by this input alone.
    pub low_power: Option<ChannelDrift>,
    /// High-power receiver, by this input alone.
    pub high_power: Option<ChannelDrift>,
    /// Outgoing pulse, by this input alone.
    pub reference: Option<ChannelDrift>,
    /// Gain ratio of the receivers, by this input alone.
    pub gain_ratio: Option<Measured>,
    /// Delay of the high-power receiver, ns, by this input alone.
    pub delay_ns: Option<Measured>,
    /// Range walk of the low-power receiver from 20 to 100 DN, ns, by this input alone.
    pub walk_ns: Option<Measured>,
}

/// Properties of a receiver that may change during a survey.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ChannelDrift {
    /// Mean background, DN.
    pub background_dn: Measured,
    /// Noise of one sample, DN.
    pub noise_sd_dn: Measured,
    /// Width of a pulse from a flat target, ns.
    pub pulse_fwhm_ns: Measured,
}

/// A value and its standard deviation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Measured {
    /// The value.
    pub value: f64,
    /// Standard deviation.
    pub sd: f64,
}

impl Instrument {
    /// Instrument of a recording.
    pub fn of(input: &InputInfo) -> Instrument {
        Instrument {
            name: input.instrument.clone(),
            serial: input.serial.clone(),
            sampling_interval_ns: input.sampling_interval_ns,
            full_scale_dn: input.full_scale_dn,
            odd_sample_shift: input.odd_sample_shift,
        }
    }
}

impl fmt::Display for Instrument {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name.as_deref().unwrap_or("unnamed instrument"))?;
        if let Some(serial) = &self.serial {
            write!(f, ", serial number {serial}")?;
        }
        write!(f, ", sampled every {} ns", self.sampling_interval_ns)
    }
}

impl From<&ChannelModel> for ChannelDrift {
    fn from(model: &ChannelModel) -> ChannelDrift {
        let sd = &model.uncertainty;
        let background_dn = model.background_dn.iter().sum::<f64>() / 4.0;
        ChannelDrift {
            background_dn: Measured { value: background_dn, sd: sd.background_dn },
            noise_sd_dn: Measured { value: model.noise_sd_dn, sd: sd.noise_sd_dn },
            pulse_fwhm_ns: Measured { value: model.pulse_fwhm_ns, sd: sd.pulse_fwhm_ns },
        }
    }
}

impl SensorDrift {
    /// Adds what the input alone shows.
    ///
    /// `of_survey` is the sensor model of the survey, if `alone` has it with a range walk of its own.
    pub fn measured(&mut self, alone: &InstrumentModel, of_survey: Option<&SensorModel>) {
        if let Some(fusion) = &alone.fusion {
            self.gain_ratio = Some(Measured { value: fusion.gain_ratio, sd: fusion.gain_ratio_sd });
            self.delay_ns = Some(Measured { value: fusion.delay_ns, sd: fusion.delay_sd_ns });
        }
        let Some(model) = &alone.sensor_model else { return };
        if of_survey.is_none() {
            self.low_power = model.low_power.as_ref().map(ChannelDrift::from);
            self.high_power = model.high_power.as_ref().map(ChannelDrift::from);
            self.reference = model.reference.as_ref().map(ChannelDrift::from);
        }
        self.walk_ns = model.low_power_range_walk.as_ref().map(|walk| {
            let [(from_ns, from_sd_ns), (to_ns, to_sd_ns)] = WALK_DN.map(|dn| walk.late_ns(dn));
            Measured { value: to_ns - from_ns, sd: from_sd_ns.hypot(to_sd_ns) }
        });
    }

    /// Its channels, with their names.
    pub fn channels(&self) -> [(&'static str, Option<ChannelDrift>); 3] {
        [("low power", self.low_power), ("high power", self.high_power), ("outgoing pulse", self.reference)]
    }
}

impl SurveyModels {
    /// The models with only these inputs.
    pub fn only(mut self, stems: &BTreeSet<&str>) -> SurveyModels {
        self.inputs.retain(|input| stems.contains(input.stem.as_str()));
        self
    }

    /// An empty survey of this version.
    pub fn new() -> SurveyModels {
        SurveyModels {
            format: FORMAT,
            wavex: env!("CARGO_PKG_VERSION").to_owned(),
            ..SurveyModels::default()
        }
    }

    /// Model for a recording; `None` if it must have its own.
    ///
    /// A recording that is not among the inputs of the survey has the model of its instrument.
    pub fn of_recording(&self, stem: &str, input: &InputInfo) -> Option<&InstrumentModel> {
        if self.inputs.iter().any(|input| input.stem == stem && input.own_model.is_some()) {
            return None;
        }
        let instrument = Instrument::of(input);
        self.instruments.iter().find(|model| model.instrument == instrument)
    }

    /// Whether the models were made with the input of this stem.
    pub fn has_input(&self, stem: &str) -> bool {
        self.inputs.iter().any(|input| input.stem == stem)
    }

    /// Formats the models as indented JSON; ends with a line feed.
    ///
    /// # Errors
    /// If a value cannot be represented as JSON.
    pub fn to_json(&self) -> serde_json::Result<String> {
        Ok(serde_json::to_string_pretty(self)? + "\n")
    }

    /// Reads a file written by `wavex calibrate` or by a run.
    ///
    /// # Errors
    /// If it cannot be read or is invalid.
    pub fn read(path: &Path) -> Result<SurveyModels> {
        const REMEDY: &str = "give a file written by `wavex calibrate JOB.toml -o FILE.json`";
        let text = read_small_text(path, MAX_BYTES, "the models of a survey", REMEDY)?;
        let models: SurveyModels = serde_json::from_str(&text)
            .map_err(|error| Error::unusable(path, format!("not the models of a survey: {error}"), REMEDY))?;
        models.check().map_err(|problem| Error::unusable(path, problem, REMEDY))?;
        Ok(models)
    }

    /// Sensor models in the report of a run, if it has valid ones.
    pub fn of_report(report: &Value) -> Option<SurveyModels> {
        let models: SurveyModels = serde_json::from_value(report["survey_models"].clone()).ok()?;
        models.check().is_ok().then_some(models)
    }

    /// First problem of models from a file.
    fn check(&self) -> std::result::Result<(), String> {
        if self.format != FORMAT {
            return Err(format!("format {} is not {FORMAT}, that of this version", self.format));
        }
        for model in self.instruments.iter().filter_map(|instrument| instrument.sensor_model.as_deref()) {
            check_model(model)?;
        }
        if !self.instruments.iter().filter_map(|instrument| instrument.fusion.as_ref()).all(is_valid_fusion) {
            return Err("gain ratio or delay has invalid numbers".to_owned());
        }
        let instruments = self.instruments.len();
        if self.inputs.iter().any(|input| input.instrument.is_some_and(|index| index >= instruments)) {
            return Err("an input has an instrument that is missing".to_owned());
        }
        Ok(())
    }
}

fn write_shared<S: Serializer>(
    model: &Option<Arc<SensorModel>>,
    to: S,
) -> std::result::Result<S::Ok, S::Error> {
    model.as_deref().serialize(to)
}

fn read_shared<'de, D: Deserializer<'de>>(
    from: D,
) -> std::result::Result<Option<Arc<SensorModel>>, D::Error> {
    Option::<SensorModel>::deserialize(from).map(|model| model.map(Arc::new))
}

/// Whether gain and delay are possible, and the delays are in the order of their heights.
pub fn is_valid_fusion(fusion: &ChannelFusion) -> bool {
    let is_sd = |sd: f64| sd.is_finite() && sd >= 0.0;
    let is_delay = |delay_ns: f64| delay_ns.abs() <= MAX_DELAY_NS;
    fusion.gain_ratio > 0.0
        && fusion.gain_ratio.is_finite()
        && is_delay(fusion.delay_ns)
        && is_sd(fusion.gain_ratio_sd)
        && is_sd(fusion.delay_sd_ns)
        && fusion.walk.iter().all(|node| is_delay(node.delay_ns) && is_sd(node.delay_sd_ns))
        && fusion.walk.is_sorted_by(|a, b| a.low_power_dn < b.low_power_dn)
}

/// Checks the numbers of a sensor model from a file.
///
/// # Errors
/// The problem, in words.
pub fn check_model(model: &SensorModel) -> std::result::Result<(), String> {
    let channels = [&model.low_power, &model.high_power, &model.saturation, &model.reference];
    for channel in channels.into_iter().flatten() {
        channel.check().map_err(|error| error.to_string())?;
    }
    let mut walks = [&model.low_power_range_walk, &model.high_power_range_walk].into_iter().flatten();
    if walks.any(|walk| !walk.is_valid()) {
        return Err("its range walk has invalid numbers".to_owned());
    }
    match (&model.low_power, &model.high_power) {
        (None, None) => Err("the sensor model has no echo receiver".to_owned()),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_input_with_its_own_model_has_none_of_the_survey() {
        let info = InputInfo::default();
        let instrument = Instrument::of(&info);
        let input = |stem: &str, own_model: Option<&str>| SensorDrift {
            stem: stem.into(),
            own_model: own_model.map(str::to_owned),
            ..SensorDrift::default()
        };
        let models = SurveyModels {
            instruments: vec![InstrumentModel { instrument, ..InstrumentModel::default() }],
            inputs: vec![input("a", None), input("b", Some("noise"))],
            ..SurveyModels::new()
        };
        let fusion = |gain_ratio: f64, delay_ns: f64| ChannelFusion {
            pairs: 30,
            gain_ratio,
            gain_ratio_sd: 0.01,
            delay_ns,
            delay_sd_ns: 0.01,
            walk: Vec::new(),
            walk_is_known: false,
        };
        let valid = [(5.0, 0.2), (0.0, 0.2), (f64::NAN, 0.2), (5.0, 1e6)]
            .map(|(g, d)| is_valid_fusion(&fusion(g, d)));
        assert_eq!(valid, [true, false, false, false]);
        let found = |stem, info: &InputInfo| models.of_recording(stem, info).is_some();
        assert!(found("a", &info) && found("new", &info) && !found("b", &info));
        assert!(!found("a", &InputInfo { sampling_interval_ns: 2.0, ..info }));
        let again: SurveyModels = serde_json::from_str(&models.to_json().unwrap()).unwrap();
        assert_eq!(again, models);
    }
}
