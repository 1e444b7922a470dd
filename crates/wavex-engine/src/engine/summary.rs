//! Results of a run as plain data.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Instant, SystemTime};

use schemars::JsonSchema;
use serde::{Serialize, Serializer};

use super::stage_summary::StageSummary;
use super::totals::LineTotals;
use super::{Options, RunError};
use crate::job::{Job, JobSettings, JobStage, Simd};
use wavex_geodesy::time::utc;
use wavex_geodesy::trajectory::Trajectory;
use wavex_line::scan_line::{EmissionReference, Frame, TimeScale};
use wavex_line::stage::{InstrumentModel, RunContext, SurveyModels};
use wavex_signal::fusion::ChannelFusion;
use wavex_signal::sensor_model::SensorModel;

/// Results of a run.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct RunSummary {
    /// Version of wavex.
    pub wavex: String,
    /// Commit from which it was built; empty if unknown.
    pub commit: String,
    /// Absolute folder at which relative input paths of the job start.
    #[serde(serialize_with = "path_as_text")]
    #[schemars(with = "String")]
    pub input_dir: PathBuf,
    /// The table `[job]` with all defaults.
    pub job: JobSettings,
    /// Stages with their keys and all defaults.
    pub stages: Vec<StageKeys>,
    /// Workers per map.
    pub threads: usize,
    /// SIMD instructions that the kernels used.
    pub simd: Simd,
    /// Name of the computer, if known.
    pub host: Option<String>,
    /// Duration of the whole run, s.
    pub wall_s: f64,
    /// Sensor models of the survey, if its inputs share them.
    #[serde(serialize_with = "shared")]
    #[schemars(with = "Option<SurveyModels>")]
    pub survey_models: Option<Arc<SurveyModels>>,
    /// One entry per input.
    #[serde(skip)]
    pub inputs: Vec<InputSummary>,
}

/// A stage of the job with its keys.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct StageKeys {
    /// Name in the job.
    pub id: String,
    /// Type of the stage.
    pub r#type: String,
    /// Its keys with all defaults.
    pub keys: serde_json::Value,
}

/// Status of an input.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum InputStatus {
    /// Its outputs are complete.
    Done,
    /// It failed and has no outputs.
    Failed,
    /// Not started.
    NotRun,
    /// An earlier run has completed its outputs.
    Skipped,
}

impl InputStatus {
    /// Name in texts.
    pub fn words(self) -> &'static str {
        match self {
            InputStatus::Done => "done",
            InputStatus::Failed => "failed",
            InputStatus::NotRun => "not run",
            InputStatus::Skipped => "skipped",
        }
    }
}

/// Results of the chain for one input.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct InputSummary {
    /// Path of the file; empty for a simulated input.
    #[serde(serialize_with = "path_as_text")]
    #[schemars(with = "String")]
    pub path: PathBuf,
    /// Stem after which its outputs are named.
    pub stem: String,
    /// Status: `done`, `failed` or `not_run`.
    pub status: InputStatus,
    /// Error message of a failed input.
    pub failure: Option<String>,
    /// Format, as reported by the reader.
    pub format: Option<String>,
    /// Name of the instrument.
    pub instrument: Option<String>,
    /// Serial number of the instrument.
    pub serial: Option<String>,
    /// Sampling interval, ns.
    pub sampling_interval_ns: Option<f64>,
    /// Group velocity of the pulse in air, m/s.
    pub group_velocity_mps: Option<f64>,
    /// Time scale: `week`, `day`, `adjusted` or `unknown`.
    pub time_scale: Option<String>,
    /// Frame of the beams: `scanner`, `body`, `map` or `earth`.
    pub frame: Option<String>,
    /// Source of the emission time: `outgoing_pulse`, `outgoing_pulse_fraction`, `return_locations`
    /// or `clock`.
    pub emission_reference: Option<String>,
    /// Origin of ranges: `sensor`, or `first_sample` if the recording has no sensor position.
    pub ranges_count_from: Option<String>,
    /// Start of this run, UTC, ISO 8601; empty if it was not run.
    pub started: String,
    /// End of this run, UTC, ISO 8601; empty if it was not run.
    pub ended: String,
    /// Duration of this run, s.
    pub wall_s: f64,
    /// Peak memory of all lines in the pipeline, bytes.
    pub peak_in_flight_bytes: usize,
    /// Counters, summed over all lines.
    pub totals: BTreeMap<&'static str, u64>,
    /// `np_filtered` of `totals`, by reason.
    pub filtered_by_reason: BTreeMap<&'static str, u64>,
    /// Channel fusion, as estimated by or given to `fuse_channels`.
    pub channel_fusion: Option<ChannelFusion>,
    /// Index of the instrument in `survey_models` whose sensor model it has.
    pub survey_instrument: Option<usize>,
    /// Sensor model of `calibrate`, if it is not that of the survey.
    #[serde(serialize_with = "shared")]
    pub sensor_model: Option<Arc<SensorModel>>,
    /// Trajectory of `[job.geometry]`.
    pub trajectory: Option<TrajectorySummary>,
    /// Coordinate system of the points, if georeferenced with a trajectory.
    pub coordinates: Option<String>,
    /// Stages in order.
    #[serde(skip)]
    pub stages: Vec<StageSummary>,
    /// Written files.
    #[serde(skip)]
    pub outputs: Vec<PathBuf>,
}

/// Summary of a trajectory.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct TrajectorySummary {
    /// Path of the file.
    pub path: String,
    /// Number of records.
    pub records: usize,
    /// First and last time, s, on a continuous time axis.
    pub span_s: [f64; 2],
    /// Median interval between records, s.
    pub median_step_s: f64,
    /// Number of gaps, including bridged ones.
    pub gaps: usize,
    /// Path of the file of its corrections.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub corrections: Option<String>,
}

impl From<(&Path, &Trajectory)> for TrajectorySummary {
    fn from((path, trajectory): (&Path, &Trajectory)) -> TrajectorySummary {
        TrajectorySummary {
            path: path.to_string_lossy().into_owned(),
            records: trajectory.samples().len(),
            span_s: trajectory.span_s(),
            median_step_s: trajectory.median_step_s(),
            gaps: trajectory.gaps().len(),
            corrections: None,
        }
    }
}

impl InputSummary {
    pub(super) fn new(
        run: &RunContext,
        started: Instant,
        totals: LineTotals,
        stages: Vec<StageSummary>,
        outputs: Vec<PathBuf>,
        peak_in_flight_bytes: usize,
    ) -> InputSummary {
        let input = totals.input.as_deref();
        let survey_instrument = survey_instrument(run, &totals);
        let (now, elapsed) = (SystemTime::now(), started.elapsed());
        InputSummary {
            path: run.input.clone(),
            stem: run.stem.clone(),
            status: InputStatus::Done,
            failure: None,
            format: input.map(|input| input.format.clone()),
            instrument: input.and_then(|input| input.instrument.clone()),
            serial: input.and_then(|input| input.serial.clone()),
            sampling_interval_ns: input.map(|input| input.sampling_interval_ns),
            group_velocity_mps: input.map(|input| input.group_velocity_mps),
            time_scale: input.map(|input| time_scale(input.time_scale).into()),
            frame: input.map(|input| frame(input.frame).into()),
            emission_reference: input.map(|input| emission_reference(input.emission_reference).into()),
            ranges_count_from: input
                .map(|input| if input.origin_is_sensor { "sensor" } else { "first_sample" }.into()),
            started: utc(now - elapsed),
            ended: utc(now),
            wall_s: elapsed.as_secs_f64(),
            peak_in_flight_bytes,
            totals: totals.counts,
            filtered_by_reason: totals.filtered,
            channel_fusion: totals.fusion.as_deref().cloned(),
            survey_instrument,
            sensor_model: totals.model.filter(|_| survey_instrument.is_none()),
            trajectory: run.geometry.trajectory().map(|trajectory| TrajectorySummary {
                corrections: run
                    .geometry
                    .corrections()
                    .map(|corrections| corrections.file().to_string_lossy().into_owned()),
                ..TrajectorySummary::from(trajectory)
            }),
            // An error here would already have ended the run.
            coordinates: input
                .and_then(|input| run.geometry.target(input).ok().flatten())
                .map(|target| target.name().to_owned()),
            stages,
            outputs,
        }
    }

    /// Results of an input that no stage has started.
    pub(super) fn not_run(run: &RunContext) -> InputSummary {
        let nothing =
            InputSummary::new(run, Instant::now(), LineTotals::default(), Vec::new(), Vec::new(), 0);
        let (started, ended) = (String::new(), String::new());
        InputSummary { status: InputStatus::NotRun, started, ended, wall_s: 0.0, ..nothing }
    }

    /// Results of an input that no run has started yet.
    pub fn pending(path: &Path, stem: &str) -> InputSummary {
        InputSummary::not_run(&RunContext { stem: stem.to_owned(), ..RunContext::alone(path) })
    }

    /// The same for an input that failed.
    pub(super) fn failed(self, error: &RunError) -> InputSummary {
        InputSummary { status: InputStatus::Failed, failure: Some(error.to_string()), ..self }
    }

    /// Returns the stage with the busiest workers.
    pub fn bottleneck(&self) -> Option<&StageSummary> {
        self.stages.iter().max_by(|a, b| a.load(self.wall_s).total_cmp(&b.load(self.wall_s)))
    }
}

impl RunSummary {
    /// Results of a job before its first input.
    pub fn new(job: &Job, options: &Options) -> RunSummary {
        let keys = |stage: &JobStage| StageKeys {
            id: stage.id.clone(),
            r#type: stage.spec.name.to_string(),
            keys: stage.planned.resolved.clone(),
        };
        RunSummary {
            wavex: crate::build::VERSION.to_string(),
            commit: crate::build::COMMIT.to_string(),
            input_dir: std::path::absolute(&options.input_dir).unwrap_or_else(|_| options.input_dir.clone()),
            job: job.settings.clone(),
            stages: job.stages.iter().map(keys).collect(),
            threads: options.workers(),
            simd: options.simd.into(),
            host: host(),
            wall_s: 0.0,
            survey_models: options.survey.clone(),
            inputs: Vec::new(),
        }
    }

    /// Sensor model of an input: its own or the survey's.
    pub fn sensor_model<'a>(&'a self, input: &'a InputSummary) -> Option<&'a SensorModel> {
        let of_survey = || {
            let instruments = &self.survey_models.as_ref()?.instruments;
            instruments.get(input.survey_instrument?)?.sensor_model.as_deref()
        };
        input.sensor_model.as_deref().or_else(of_survey)
    }

    /// Notes that several inputs share, with the names of these.
    ///
    /// Each note is logged for the first input only.
    pub fn repeated_notes(&self) -> BTreeMap<&str, Vec<&str>> {
        let mut inputs_of: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
        for input in &self.inputs {
            let notes = input.stages.iter().flat_map(|stage| &stage.notes);
            let notes: BTreeSet<&str> = notes.map(String::as_str).collect();
            notes.into_iter().for_each(|note| inputs_of.entry(note).or_default().push(&input.stem));
        }
        inputs_of.retain(|_, inputs| inputs.len() > 1);
        inputs_of
    }
}

/// Name of the computer, if known.
pub fn host() -> Option<String> {
    let read = std::fs::read_to_string("/proc/sys/kernel/hostname").ok().map(|text| text.trim().to_owned());
    let by_variable = || ["HOSTNAME", "COMPUTERNAME"].into_iter().find_map(|name| std::env::var(name).ok());
    read.or_else(by_variable)
}

/// Index of the instrument in the survey whose model the input has.
fn survey_instrument(run: &RunContext, totals: &LineTotals) -> Option<usize> {
    let model = totals.model.as_ref()?;
    let is_same = |of: &InstrumentModel| of.sensor_model.as_ref().is_some_and(|of| Arc::ptr_eq(of, model));
    run.survey.as_ref()?.instruments.iter().position(is_same)
}

/// Serialises what an `Arc` holds.
fn shared<T: Serialize, S: Serializer>(held: &Option<Arc<T>>, to: S) -> Result<S::Ok, S::Error> {
    held.as_deref().serialize(to)
}

/// Serialises a path as text; replaces invalid Unicode.
fn path_as_text<S: Serializer>(path: &Path, to: S) -> Result<S::Ok, S::Error> {
    to.serialize_str(&path.to_string_lossy())
}

fn time_scale(scale: TimeScale) -> &'static str {
    match scale {
        TimeScale::Week => "week",
        TimeScale::Day => "day",
        TimeScale::Adjusted => "adjusted",
        TimeScale::Unknown => "unknown",
    }
}

fn frame(frame: Frame) -> &'static str {
    match frame {
        Frame::Scanner => "scanner",
        Frame::Body => "body",
        Frame::Map => "map",
        Frame::Earth => "earth",
    }
}

fn emission_reference(reference: EmissionReference) -> &'static str {
    match reference {
        EmissionReference::OutgoingPulse => "outgoing_pulse",
        EmissionReference::OutgoingPulseFraction => "outgoing_pulse_fraction",
        EmissionReference::ReturnLocations => "return_locations",
        EmissionReference::Clock => "clock",
    }
}
