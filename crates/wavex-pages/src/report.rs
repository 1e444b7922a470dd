//! Reports of a run: `*_report.json`, the page, and the statistics of each input.

use std::borrow::Cow;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize, Serializer};
use serde_json::Value;

use wavex_engine::engine::{InputSummary, RunSummary, StageSummary};
use wavex_formats::{Error, Result, read_small_text};
use wavex_line::stage::{self, OutputFile, StageError};
use wavex_signal::sensor_model::SensorModel;

pub mod align;
mod earlier;
pub(crate) mod overview;
mod page;
mod stat_log;
pub mod survey;
mod tables;

pub use earlier::difference;
pub(crate) use overview::view::crs_name;
pub use overview::{
    Densities, Density, Flight, GroundSummary, LineGroups, MapAxes, MapLine, MapPicture, Overview, Overviews,
    Picture, PointSummary, QuantityHistogram, ShownKind, ShownReturn, ShownShot, TimeCoverage, ZoneCloud,
    ZoneClouds, ZoneShare, Zones,
};
pub use stat_log::{geometry_words, sensor_model_words, stat_log};
pub use tables::{input_table, latency_table, stage_table, survey_table};

/// Report of a run (`*_report.json`).
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct RunReport<'r> {
    /// Results of the run as a whole.
    #[serde(flatten)]
    pub run: &'r RunSummary,
    /// One entry per input: an [`InputReport`].
    #[schemars(with = "Vec<InputReport>")]
    pub inputs: &'r [InputEntry],
}

/// An [`InputReport`] as JSON text.
///
/// Text takes a tenth of the memory of the values; it is kept until the report is written.
#[derive(Clone, Debug)]
pub struct InputEntry {
    /// JSON without the sensor model.
    text: Box<str>,
    /// Inputs can share it.
    sensor_model: Option<Arc<SensorModel>>,
}

/// Results of the chain for one input.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct InputReport<'r> {
    /// Facts about the input and its run.
    #[serde(flatten)]
    pub input: &'r InputSummary,
    /// Data of the report page, if the job requests one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub overview: Option<&'r Overview>,
    /// Stages in order.
    pub stages: &'r [StageSummary],
    /// Written files.
    #[serde(serialize_with = "paths_as_text")]
    #[schemars(with = "Vec<String>")]
    pub outputs: &'r [PathBuf],
    /// State of its files, for `--resume`.
    pub files: InputFiles,
}

/// Files of an input and their states.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct InputFiles {
    /// Files read, before the run.
    pub read: Vec<FileState>,
    /// Files written.
    pub written: Vec<FileState>,
}

/// State of a file, to recognise changes.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct FileState {
    /// Path, relative to the folder of the inputs or outputs if it is in it.
    pub path: String,
    /// Size, bytes.
    pub bytes: u64,
    /// Modification time, s since 1970.
    pub modified_s: f64,
    /// BLAKE3 digest, 64 hexadecimal digits; only with `--resume=digest`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub blake3: Option<String>,
}

impl InputEntry {
    /// Entry of an input that has ended or was not run.
    ///
    /// # Errors
    /// If a value cannot be represented as JSON, which is a defect.
    pub fn new(report: InputReport) -> stage::Result<InputEntry> {
        let sensor_model = report.input.sensor_model.clone();
        let input = &InputSummary { sensor_model: None, ..report.input.clone() };
        // By values, which have numbers of double precision.
        let values = serde_json::to_value(InputReport { input, ..report }).map_err(|error| {
            StageError::failed(format!("cannot write the report: {error}"), "please report this bug in wavex")
        })?;
        Ok(InputEntry { text: values.to_string().into(), sensor_model })
    }

    /// Values of the entry without its sensor model.
    ///
    /// # Errors
    /// If the text is not JSON, which is a defect.
    pub fn without_model(&self) -> serde_json::Result<Value> {
        serde_json::from_str(&self.text)
    }

    /// Values of the entry.
    ///
    /// # Errors
    /// If the sensor model cannot be represented as JSON.
    pub fn values(&self) -> serde_json::Result<Value> {
        let mut values = self.without_model()?;
        if let Some(model) = &self.sensor_model {
            values["sensor_model"] = serde_json::to_value(model.as_ref())?;
        }
        Ok(values)
    }
}

/// From an entry of a stored report.
impl From<&Value> for InputEntry {
    fn from(stored: &Value) -> InputEntry {
        InputEntry { text: stored.to_string().into(), sensor_model: None }
    }
}

impl Serialize for InputEntry {
    fn serialize<S: Serializer>(&self, to: S) -> std::result::Result<S::Ok, S::Error> {
        self.values().map_err(serde::ser::Error::custom)?.serialize(to)
    }
}

impl<'r> InputReport<'r> {
    /// Results of an input, with the data of the page and its files.
    pub fn new(
        input: &'r InputSummary,
        overview: Option<&'r Overview>,
        files: InputFiles,
    ) -> InputReport<'r> {
        InputReport { input, overview, stages: &input.stages, outputs: &input.outputs, files }
    }
}

/// Serialises paths as text; replaces invalid Unicode.
fn paths_as_text<S: Serializer>(paths: &[PathBuf], to: S) -> std::result::Result<S::Ok, S::Error> {
    to.collect_seq(paths.iter().map(|path| path.to_string_lossy()))
}

/// Maximum size of a report, bytes.
const MOST_REPORT_BYTES: u64 = 2_000_000_000;

impl RunReport<'_> {
    /// Formats the report as indented JSON; ends with a line feed.
    ///
    /// # Errors
    /// If a value cannot be represented as JSON.
    pub fn to_json(&self) -> serde_json::Result<String> {
        Ok(serde_json::to_string_pretty(self)? + "\n")
    }

    /// Writes `*_report.json`.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn write_json(&self, mut file: OutputFile) -> Result<()> {
        let mut to = BufWriter::new(&mut file);
        let written = serde_json::to_writer_pretty(&mut to, self).map_err(std::io::Error::from);
        let written = written.and_then(|()| to.write_all(b"\n")).and_then(|()| to.flush());
        drop(to);
        written.map_err(|error| Error::io(file.path(), "write the report")(error))?;
        file.finish()?.publish().map(drop)
    }

    /// Writes the page.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn write_page(&self, file: OutputFile) -> Result<()> {
        let defect =
            |problem: String| Error::unusable(file.path(), problem, "please report this bug in wavex");
        let run = serde_json::to_value(self.run).map_err(|error| defect(error.to_string()))?;
        let inputs = self.inputs.iter().map(|entry| Ok(Cow::Owned(entry.values()?)));
        let page = page::page(&run, inputs, usize::MAX).map_err(|error| defect(error.to_string()))?;
        write(file, &page, "write the page").map(drop)
    }
}

/// Writes the statistics of an input of a run and returns the path; see [`stat_log()`].
///
/// # Errors
/// If the file cannot be written.
pub fn write_stat_log(
    path: &Path,
    run: &RunSummary,
    input: &InputSummary,
    own: &[PathBuf],
    failure: Option<&str>,
) -> Result<PathBuf> {
    write(OutputFile::create(path)?, &stat_log(run, input, own, failure), "write the statistics")
}

/// Writes the page of the report `stored` in the file `report`.
///
/// # Errors
/// If the report is invalid, or the page cannot be written.
pub fn write_page_of(report: &Path, stored: &Value, page: &Path) -> Result<()> {
    // A page has a few times the size of its report; a hostile report could have a thousand times.
    let bytes = std::fs::metadata(report).map_or(0, |about| about.len());
    let limit =
        PAGE_BYTES + usize::try_from(bytes).unwrap_or(usize::MAX / 16).saturating_mul(PAGE_PER_REPORT);
    let inputs = stored["inputs"].as_array().into_iter().flatten().map(|input| Ok(Cow::Borrowed(input)));
    let html = page::page(stored, inputs, limit).map_err(|error| {
        Error::unusable(report, error.to_string(), "run the job again to make a new report")
    })?;
    write(OutputFile::create(page)?, &html, "write the page").map(drop)
}

/// Maximum size of the page of a small stored report, bytes.
const PAGE_BYTES: usize = 32_000_000;
/// Further bytes of a page per byte of its report.
const PAGE_PER_REPORT: usize = 10;

/// Reads a stored report.
///
/// # Errors
/// If it cannot be read or is invalid.
pub fn read_report(path: &Path) -> Result<Value> {
    let text = read_small_text(path, MOST_REPORT_BYTES, "a report", "give the report of a run")?;
    let remedy = "give the report of a run or the folder that contains it";
    let report: Value = serde_json::from_str(&text)
        .map_err(|error| Error::unusable(path, format!("not a report of a run: {error}"), remedy))?;
    match report["inputs"].is_array() {
        true => Ok(report),
        false => Err(Error::unusable(path, "not a report of a run: no `inputs`", remedy)),
    }
}

fn write(mut file: OutputFile, text: &str, action: &'static str) -> Result<PathBuf> {
    let written = file.write_all(text.as_bytes());
    written.map_err(|error| Error::io(file.path(), action)(error))?;
    file.finish()?.publish()
}
