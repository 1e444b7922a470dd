//! Models of the beams of a recording in files.

use std::io::Write;
use std::path::PathBuf;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use wavex_footprints::FootprintModel;
use wavex_formats::{Error, read_small_text};
use wavex_line::scan_line::{Blocks, ScanLine};
use wavex_line::stage::{Output, OutputFile, Result, StageError};

use super::learning::outgoing_samples;

/// Version of the format.
const FORMAT: u64 = 1;
/// Size limit of a file, bytes; a model has a few thousand numbers.
const MAX_BYTES: u64 = 1 << 26;
/// Relative tolerance within which sampling intervals are equal.
const SAME_INTERVAL: f64 = 1e-3;
/// Fields that may be missing or null.
const OPTIONAL: [&str; 2] = ["beam", "outgoing_samples"];
/// Remedy for a wrong file.
const REMEDY: &str = "load a file written by `save` of measure_footprints, or learn from the recording";
/// Remedy for a model of another instrument.
const OTHER: &str = "load a model of this instrument and setting, or learn from the recording";

/// Noise and response of the beams of a recording, as `save` of `measure_footprints` writes them.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct FootprintModels {
    /// Version of this format: 1.
    pub format: u64,
    /// Models of the beams, in the order of the recording.
    pub beams: Vec<BeamModel>,
}

/// Model of a beam.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct BeamModel {
    /// Name of the beam; none in a recording without beams.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub beam: Option<String>,
    /// Least and largest number of samples of the outgoing pulses; none if none were recorded.
    ///
    /// The response is then the mean of the narrowest echoes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub outgoing_samples: Option<[u64; 2]>,
    /// Noise and response.
    pub model: FootprintModel,
}

impl Default for FootprintModels {
    fn default() -> FootprintModels {
        FootprintModels { format: FORMAT, beams: Vec::new() }
    }
}

impl FootprintModels {
    /// Adds the model of a beam, unless it has one.
    pub(super) fn add(&mut self, model: BeamModel) {
        if self.of(model.beam.as_deref()).is_none() {
            self.beams.push(model);
        }
    }

    /// The model of a beam.
    fn of(&self, beam: Option<&str>) -> Option<&BeamModel> {
        self.beams.iter().find(|model| model.beam.as_deref() == beam)
    }

    /// Checks the version and all numbers.
    fn check(&self) -> std::result::Result<(), String> {
        self.beams.iter().try_for_each(|of| {
            let check = of.model.check();
            check.map_err(|error| format!("the model of {}: {error}", shown(of.beam.as_deref())))
        })
    }

    /// Writes the models to their file and publishes it.
    pub(super) fn write(&self, mut file: OutputFile, out: &mut Output) -> Result<()> {
        let remedy = "leave out `save`, or learn from another part of the recording";
        self.check().map_err(|problem| Error::unusable(file.path(), problem, remedy))?;
        let text = serde_json::to_string_pretty(self)
            .map_err(|error| StageError::failed(error.to_string(), "please report this bug in wavex"))?;
        file.write_all((text + "\n").as_bytes()).map_err(Error::io(file.path(), "write"))?;
        out.cx.publish(file.finish()?);
        Ok(())
    }

    /// Parses the text of a model file.
    fn parse(text: &str) -> std::result::Result<FootprintModels, String> {
        let not_models = |error: serde_json::Error| format!("not models of footprints: {error}");
        let value: Value = serde_json::from_str(text).map_err(not_models)?;
        if let Some(format) = value.get("format").and_then(Value::as_u64).filter(|format| *format != FORMAT) {
            return Err(format!("`format` is {format}, and this version of wavex reads {FORMAT}"));
        }
        if let Some(field) = null_in(&value) {
            return Err(format!("`{}` is no number", field.trim_start_matches('.')));
        }
        let models: FootprintModels = serde_json::from_str(text).map_err(not_models)?;
        models.check().map(|()| models)
    }
}

/// Path of the first null in place of a number, as which JSON has numbers that are not finite.
fn null_in(value: &Value) -> Option<String> {
    match value {
        Value::Null => Some(String::new()),
        Value::Array(items) => {
            (0..).zip(items).find_map(|(k, item)| Some(format!("[{k}]{}", null_in(item)?)))
        }
        Value::Object(members) => {
            let mut needed = members.iter().filter(|(name, _)| !OPTIONAL.contains(&name.as_str()));
            needed.find_map(|(name, item)| Some(format!(".{name}{}", null_in(item)?)))
        }
        _ => None,
    }
}

fn shown(beam: Option<&str>) -> &str {
    beam.unwrap_or("a recording without beams")
}

/// Models from the file of the key `load`.
pub(super) struct LoadedModels {
    path: PathBuf,
    pub(super) models: FootprintModels,
}

impl LoadedModels {
    /// Reads a model file.
    ///
    /// # Errors
    /// If the file cannot be read or is wrong.
    pub(super) fn read(path: PathBuf) -> Result<LoadedModels> {
        let text = read_small_text(&path, MAX_BYTES, "models of footprints", REMEDY)?;
        let models = FootprintModels::parse(&text);
        let models = models.map_err(|problem| Error::unusable(&path, problem, REMEDY))?;
        Ok(LoadedModels { path, models })
    }

    /// The model for the beam of a line; `None` if the file has none.
    ///
    /// # Errors
    /// If the line has another sampling interval, or outgoing pulses of another length.
    pub(super) fn of_line(&self, line: &ScanLine) -> Result<Option<&BeamModel>> {
        let beam = line.input.beam.as_deref();
        let Some(found) = self.models.of(beam) else { return Ok(None) };
        let of_model_ns = found.model.sampling_interval_ns;
        let is_same = |interval_ns: f64| (of_model_ns / interval_ns - 1.0).abs() <= SAME_INTERVAL;
        let blocks = line.blocks().into_iter().flat_map(Blocks::iter);
        let mut intervals_ns = blocks.filter(|block| block.channel.is_echo()).map(|block| block.interval_ns);
        let wrong =
            |problem: String| Err(self.unusable(format!("the model of {}: {problem}", shown(beam)), OTHER));
        if let Some(first_ns) = intervals_ns.next()
            && !is_same(first_ns)
            && !intervals_ns.any(is_same)
        {
            return wrong(format!(
                "its `sampling_interval_ns` is {of_model_ns}, but that of the recording is {first_ns}"
            ));
        }
        let recorded = outgoing_samples(std::slice::from_ref(line));
        if let (Some([least, most]), Some([from, to])) = (recorded, found.outgoing_samples)
            && (most < from || to < least)
        {
            return wrong(format!(
                "its `outgoing_samples` are {from} to {to}, but those of the recording {least} to {most}"
            ));
        }
        Ok(Some(found))
    }

    /// Error for a line whose beam has no model.
    pub(super) fn without(&self, line: &ScanLine) -> StageError {
        let names: Vec<&str> = self.models.beams.iter().map(|model| shown(model.beam.as_deref())).collect();
        let beam = shown(line.input.beam.as_deref());
        self.unusable(format!("`beams` has no model of {beam}, only of {}", names.join(", ")), OTHER)
    }

    fn unusable(&self, problem: String, remedy: &str) -> StageError {
        Error::unusable(&self.path, problem, remedy).into()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn wrong_files_are_named_with_field_and_remedy() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("model.json");
        let error = |text: &str| {
            std::fs::write(&path, text).unwrap();
            let error = LoadedModels::read(path.clone()).err().map(|error| error.to_string());
            let error = error.unwrap_or_default();
            let rest = error.strip_prefix(&format!("{}: ", path.display())).unwrap_or(&error);
            rest.strip_suffix(&format!("; {REMEDY}")).unwrap_or(rest).to_owned()
        };
        let valid = json!({"format": 1, "beams": [{"beam": "BEAM0101", "outgoing_samples": [128, 128], "model": {
            "sampling_interval_ns": 1.0, "noise_sd_dn": 2.0, "autocorrelation": vec![1.0; 16],
            "residual_noise": {"samples_per_independent": 2.0, "variance_ratio_per_dn": 0.0},
            "response": vec![1.0; 400], "pulse_fwhm_ns": 15.6, "shots": 1000,
        }}]});
        assert_eq!(error(&valid.to_string()), "");
        let with = |pointer: &str, value: Value| {
            let mut changed = valid.clone();
            *changed.pointer_mut(pointer).unwrap() = value;
            error(&changed.to_string())
        };
        assert_eq!(with("/format", json!(2)), "`format` is 2, and this version of wavex reads 1");
        assert_eq!(with("/beams/0/beam", Value::Null), "");
        assert_eq!(
            with("/beams/0/model/autocorrelation/3", Value::Null),
            "`beams[0].model.autocorrelation[3]` is no number"
        );
        assert_eq!(
            with("/beams/0/model/noise_sd_dn", json!(-1)),
            "the model of BEAM0101: `noise_sd_dn` must be from 0 to 1000000, got -1"
        );
        let begins = |text: String, beginning: &str| assert!(text.starts_with(beginning), "{text}");
        begins(
            with("/beams/0/model/noise_sd_dn", json!("2")),
            "not models of footprints: invalid type: string",
        );
        begins(error(""), "not models of footprints: EOF");
        begins(error("{\"low_power\": {}}"), "not models of footprints: unknown field `low_power`");
        begins(error("{\"format\": 1, \"beams\": [1e999]}"), "not models of footprints: number out of range");
        std::fs::remove_file(&path).unwrap();
        let missing =
            LoadedModels::read(path.clone()).err().map(|error| error.to_string()).unwrap_or_default();
        assert!(missing.contains("model.json"), "{missing}");
    }
}
