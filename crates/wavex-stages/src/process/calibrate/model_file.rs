//! Sensor models in files: writing, loading, and comparison with the recording.

use std::io::Write;
use std::path::Path;

use super::{Calibrate, Calibrator, name};
use wavex_formats::{Error, read_small_text};
use wavex_line::scan_line::{Channel, ScanLine};
use wavex_line::stage::{Output, OutputFile, Result, StageError, check_model};
use wavex_signal::sensor_model::SensorModel;

/// Size limit of a sensor model file, bytes; a model has a few thousand numbers.
const MAX_MODEL_BYTES: u64 = 1 << 26;

/// Relative tolerance within which sampling intervals are equal.
const SAME_INTERVAL: f64 = 1e-3;

impl Calibrator {
    /// Compares a loaded model with a line.
    ///
    /// A different sampling interval is an error; other differences are noted.
    pub(super) fn compare(&self, model: &SensorModel, scan_line: &ScanLine, out: &mut Output) -> Result<()> {
        if self.config.load.is_none() && self.config.preset.is_none() {
            return Ok(());
        }
        if let Some(preset) = self.config.preset {
            let named = scan_line.input.instrument.as_deref().filter(|name| !preset.is_of(name));
            if let Some(named) = named {
                out.cx.warn(format!(
                    "the sensor model is a preset of the {}, but the recording names the instrument {named}: background, \
                     noise and pulse shape are those of another type; `load` a model of this instrument, or calibrate \
                     from another part of the recording",
                    preset.instrument()
                ));
            } else {
                out.cx.warn("the sensor model is a preset, measured on another instrument of this type: background, noise and pulse shape may differ; calibrate if the recording has 200 waveforms");
            }
        }
        let input = &scan_line.input;
        let channels = [
            (Channel::LowPower, &model.low_power),
            (Channel::HighPower, &model.high_power),
            (Channel::Reference, &model.reference),
        ];
        for (channel, known) in channels {
            let Some(known) = known else {
                if channel == Channel::LowPower
                    && scan_line
                        .blocks()
                        .is_some_and(|blocks| blocks.iter().any(|block| block.channel == channel))
                {
                    out.cx.warn(format!(
                        "the loaded model lacks {}: its waveforms are not decomposed; recalibrate",
                        name(channel)
                    ));
                }
                continue;
            };
            let (of_model_ns, interval_ns) = (known.sampling_interval_ns, input.sampling_interval_ns);
            if (of_model_ns / interval_ns - 1.0).abs() > SAME_INTERVAL {
                return Err(StageError::failed(
                    format!(
                        "the loaded model has a sampling interval of {of_model_ns} ns ({}), but that of the recording is {interval_ns} ns",
                        name(channel)
                    ),
                    "load a model of this instrument and setting, or recalibrate",
                ));
            }
            if known.digitiser != self.digitiser(channel, input) {
                out.cx.warn("the loaded model was calibrated with an odd_sample_shift, decay_amplitude or decay_time_ns that differs from this job: the values of the model are used");
            }
            let is_other_scale = input.full_scale_dn.is_some_and(|dn| f64::from(dn) != known.full_scale_dn);
            if is_other_scale && !known.limits.full_scale_is_measured {
                out.cx.warn("the loaded model was calibrated with a full scale that differs from the recording: the value of the model is used");
            }
        }
        let (config, default) = (&self.config, Calibrate::default());
        let is_asked = config.waveforms != default.waveforms
            || config.background != default.background
            || config.response != default.response;
        if is_asked {
            out.cx.warn("`waveforms`, `background` and `response` of calibrate have no effect with `load` or `preset`: remove them, or recalibrate");
        }
        Ok(())
    }
}

/// Text of a model file.
///
/// # Errors
/// If a value cannot be written as JSON.
pub fn model_json(model: &SensorModel) -> Result<String> {
    let text = serde_json::to_string_pretty(model);
    let text = text.map_err(|error| StageError::failed(error.to_string(), "please report this bug in wavex"));
    Ok(text? + "\n")
}

/// Writes a model to its file and publishes it.
pub(crate) fn write_model(model: &SensorModel, mut file: OutputFile, out: &mut Output) -> Result<()> {
    file.write_all(model_json(model)?.as_bytes()).map_err(Error::io(file.path(), "write"))?;
    out.cx.publish(file.finish()?);
    Ok(())
}

const REMEDY: &str = "load a file written by `save` of calibrate, or recalibrate";

/// Loads a saved model.
///
/// # Errors
/// If the file cannot be read or is not a sensor model.
pub fn load_model(path: &Path) -> Result<SensorModel> {
    let text = read_small_text(path, MAX_MODEL_BYTES, "a sensor model", REMEDY)?;
    parse_model(&text, path)
}

/// Parses the text of a model file; errors name it `path`.
///
/// # Errors
/// If the text is not a sensor model.
pub fn parse_model(text: &str, path: &Path) -> Result<SensorModel> {
    let model: SensorModel = serde_json::from_str(text)
        .map_err(|error| Error::unusable(path, format!("not a sensor model: {error}"), REMEDY))?;
    check_model(&model).map_err(|problem| Error::unusable(path, problem, REMEDY))?;
    Ok(model)
}
