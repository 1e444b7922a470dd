//! A small list of stages for the tests of jobs: keys of every shape, and stages that do nothing.
//!
//! Tests compare the schema and the manual made from these doc comments.
#![allow(missing_docs, reason = "a doc comment becomes a text of the schema")]

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use wavex::scan_line::{Kind, ScanLine};
use wavex::stage::{
    Config, Context, Map, MapConfig, Output, Paths, Result, RunContext, Sink, SinkConfig, Source,
    SourceConfig, StageSpec, Transform, TransformConfig,
};
use wavex_signal::decompose::DecomposeSettings;

pub const STAGES: &[&StageSpec] =
    &[&READ_LAS, &SIMULATE, &CALIBRATE, &DECOMPOSE, &GEOREFERENCE, &WRITE_LAS, &WRITE_LSTAT, &WRITE_SHOTS];

pub static READ_LAS: StageSpec = StageSpec::source::<ReadLas>("read_las", Kind::Shots);
pub static SIMULATE: StageSpec = StageSpec::source::<Simulate>("simulate", Kind::Shots);
pub static CALIBRATE: StageSpec = StageSpec::transform::<Calibrate>("calibrate", &[Kind::Shots]);
pub static DECOMPOSE: StageSpec =
    StageSpec::map::<Decompose>("decompose", &[Kind::Shots], Some(Kind::Returns)).after(&["calibrate"]);
pub static GEOREFERENCE: StageSpec =
    StageSpec::map::<Georeference>("georeference", &[Kind::Returns], Some(Kind::Points));
pub static WRITE_LAS: StageSpec = StageSpec::sink::<WriteLas>("write_las", &[Kind::Points]);
pub static WRITE_LSTAT: StageSpec =
    StageSpec::sink::<WriteLstat>("write_lstat", &[Kind::Shots, Kind::Returns, Kind::Points]);
pub static WRITE_SHOTS: StageSpec = StageSpec::sink::<WriteShots>("write_shots", &[Kind::Shots]);

/// Reads waveforms from LAS files. Blocks stay with their shot.
///
/// Point formats 4, 5, 9 and 10.
#[derive(Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ReadLas {
    /// The files to read, one run each.
    pub path: Paths,
    /// First and last second to read.
    #[serde(default)]
    pub time_s: Option<[f64; 2]>,
}

/// Makes waveforms of a known scene.
#[derive(Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Simulate {
    /// How many lines.
    pub lines: u32,
}

/// Learns the sensor from the first waveforms.
#[derive(Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Calibrate {
    /// How many waveforms to learn from.
    #[schemars(range(min = 200))]
    pub waveforms: u32,
    /// How the background is found.
    pub background: Background,
}

/// How the background is found.
#[derive(Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Background {
    /// Fixed where it can be.
    Auto,
    /// From each waveform.
    PerWaveform,
}

/// Finds the returns in each waveform.
#[derive(Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Decompose {
    /// How far above the noise an echo must rise, in standard deviations | of the noise.
    #[schemars(range(min = 1, max = 100.0))]
    pub detection_sigma: f64,
    /// What it takes to split a pulse; `false`: nothing is split.
    pub split_evidence: SplitEvidence,
    /// Where to begin.
    pub start: Start,
}

/// What it takes to split a pulse.
#[derive(Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum SplitEvidence {
    Never(bool),
    At(f64),
}

/// A word or a number.
#[derive(Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Start {
    Word(StartWord),
    Ns(f64),
}

/// The words.
#[derive(Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum StartWord {
    Pulse,
    Block,
}

/// Computes coordinates.
#[derive(Serialize, Deserialize, JsonSchema, Default)]
#[serde(default, deny_unknown_fields)]
pub struct Georeference {
    /// The coordinate system.
    pub crs: Crs,
    /// Where the scanner sits.
    pub mount: Option<Mount>,
    /// Further places.
    pub control: Vec<Mount>,
}

/// Where something sits.
#[derive(Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Mount {
    /// To the front.
    pub forward_m: f64,
    /// To the right.
    #[serde(default)]
    pub right_m: f64,
}

/// A coordinate system by its code.
#[derive(Serialize, Deserialize, JsonSchema, Clone)]
#[serde(try_from = "String", into = "String")]
pub struct Crs(String);

impl Default for Crs {
    fn default() -> Crs {
        Crs("EPSG:2154".into())
    }
}

impl TryFrom<String> for Crs {
    type Error = String;
    fn try_from(text: String) -> std::result::Result<Crs, String> {
        if text.starts_with("EPSG:") {
            Ok(Crs(text))
        } else {
            Err(format!("{text:?} is no code of a system"))
        }
    }
}

impl From<Crs> for String {
    fn from(crs: Crs) -> String {
        crs.0
    }
}

/// Writes points.
#[derive(Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct WriteLas {
    /// The file to write.
    pub path: String,
    /// The version of the format.
    pub version: Version,
}

/// The version of the format.
#[derive(Serialize, Deserialize, JsonSchema)]
pub enum Version {
    #[serde(rename = "1.2")]
    V12,
    #[serde(rename = "1.4")]
    V14,
}

/// Writes a row per line.
#[derive(Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct WriteLstat {
    /// The file to write.
    pub path: String,
}

/// Writes waveforms.
#[derive(Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct WriteShots {
    /// The file to write.
    pub path: String,
}

impl Default for Simulate {
    fn default() -> Simulate {
        Simulate { lines: 10 }
    }
}

impl Default for Calibrate {
    fn default() -> Calibrate {
        Calibrate { waveforms: 100_000, background: Background::Auto }
    }
}

impl Default for Decompose {
    fn default() -> Decompose {
        let kernels = DecomposeSettings::default();
        Decompose {
            detection_sigma: kernels.detection_sigma,
            split_evidence: kernels.split_evidence.map_or(SplitEvidence::Never(false), SplitEvidence::At),
            start: Start::Word(StartWord::Pulse),
        }
    }
}

impl Default for WriteLas {
    fn default() -> WriteLas {
        WriteLas { path: "*.laz".into(), version: Version::V14 }
    }
}

impl Default for WriteLstat {
    fn default() -> WriteLstat {
        WriteLstat { path: "*_lstat.txt".into() }
    }
}

impl Config for ReadLas {}
impl Config for Simulate {}
impl Config for Calibrate {}
impl Config for Georeference {}
impl Config for WriteLas {}
impl Config for WriteLstat {}
impl Config for WriteShots {}
impl Config for Decompose {}

/// A stage that does nothing.
pub struct Nothing;

impl Source for Nothing {
    fn next(&mut self, _: &mut Context) -> Result<Option<ScanLine>> {
        Ok(None)
    }
}

impl Map for Nothing {
    fn map(&mut self, line: ScanLine, _: &mut Context) -> Result<ScanLine> {
        Ok(line)
    }
}

impl Transform for Nothing {
    fn process(&mut self, line: ScanLine, out: &mut Output) -> Result<()> {
        out.emit(line)
    }
    fn finish(&mut self, _: &mut Output) -> Result<()> {
        Ok(())
    }
}

impl Sink for Nothing {
    fn write(&mut self, _: &ScanLine, _: &mut Context) -> Result<()> {
        Ok(())
    }
    fn finish(self: Box<Self>, _: &mut Context) -> Result<()> {
        Ok(())
    }
}

impl SourceConfig for ReadLas {
    fn paths(&self) -> Option<&Paths> {
        Some(&self.path)
    }
    fn make(&self, _: &RunContext) -> Result<Box<dyn Source>> {
        Ok(Box::new(Nothing))
    }
}

impl SourceConfig for Simulate {
    fn paths(&self) -> Option<&Paths> {
        None
    }
    fn stem(&self) -> &str {
        "scene"
    }
    fn make(&self, _: &RunContext) -> Result<Box<dyn Source>> {
        Ok(Box::new(Nothing))
    }
}

impl TransformConfig for Calibrate {
    fn make(&self, _: &RunContext) -> Result<Box<dyn Transform>> {
        Ok(Box::new(Nothing))
    }
}

impl MapConfig for Decompose {
    fn make(&self, _: &RunContext) -> Result<Box<dyn Map>> {
        Ok(Box::new(Nothing))
    }
}

impl MapConfig for Georeference {
    fn make(&self, _: &RunContext) -> Result<Box<dyn Map>> {
        Ok(Box::new(Nothing))
    }
}

impl SinkConfig for WriteLas {
    fn outputs(&self) -> Vec<&str> {
        vec![&self.path]
    }
    fn make(&self, _: &RunContext) -> Result<Box<dyn Sink>> {
        Ok(Box::new(Nothing))
    }
}

impl SinkConfig for WriteLstat {
    fn outputs(&self) -> Vec<&str> {
        vec![&self.path]
    }
    fn make(&self, _: &RunContext) -> Result<Box<dyn Sink>> {
        Ok(Box::new(Nothing))
    }
}

impl SinkConfig for WriteShots {
    fn outputs(&self) -> Vec<&str> {
        vec![&self.path]
    }
    fn make(&self, _: &RunContext) -> Result<Box<dyn Sink>> {
        Ok(Box::new(Nothing))
    }
}
