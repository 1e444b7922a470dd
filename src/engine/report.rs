//! Report of a run: final table and `report.json`.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Instant, SystemTime};

use schemars::JsonSchema;
use serde::{Serialize, Serializer};

use super::Options;
use super::meter::{Meter, Span};
use crate::job::{Job, JobSettings, JobStage, Simd};
use crate::overview::{Gallery, Gathering, Overview};
use crate::scan_line::{EmissionReference, Frame, InputInfo, ScanLine, TimeScale};
use crate::stage::{Counters, Distribution, Item, RoleName, RunContext};
use wavex_geodesy::time::utc;
use wavex_geodesy::trajectory::Trajectory;
use wavex_signal::fusion::ChannelFusion;
use wavex_signal::sensor_model::SensorModel;

/// Report of a run (`report.json`).
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct RunReport {
    /// Version of wavex.
    pub wavex: String,
    /// The table `[job]` with all defaults.
    pub job: JobSettings,
    /// Stages with their keys and all defaults.
    pub stages: Vec<StageKeys>,
    /// Workers per map.
    pub threads: usize,
    /// SIMD instructions that the kernels used.
    pub simd: Simd,
    /// Duration of the whole run, s.
    pub wall_s: f64,
    /// One entry per input.
    pub inputs: Vec<InputReport>,
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

/// Results of the chain for one input.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct InputReport {
    /// Path of the file; empty for a simulated input.
    #[serde(serialize_with = "path_as_text")]
    #[schemars(with = "String")]
    pub path: PathBuf,
    /// Stem after which its outputs are named.
    pub stem: String,
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
    /// Start of this run, UTC, ISO 8601.
    pub started: String,
    /// End of this run, UTC, ISO 8601.
    pub ended: String,
    /// Duration of this run, s.
    pub wall_s: f64,
    /// Peak memory of all lines in the pipeline, bytes.
    pub peak_in_flight_bytes: usize,
    /// Counters, summed over all lines.
    pub totals: BTreeMap<&'static str, u64>,
    /// Channel fusion, as estimated by or given to `fuse_channels`.
    pub channel_fusion: Option<ChannelFusion>,
    /// Sensor model of `calibrate`.
    pub sensor_model: Option<SensorModel>,
    /// Trajectory of `[job.geometry]`.
    pub trajectory: Option<TrajectoryReport>,
    /// Coordinate system of the points, if georeferenced with a trajectory.
    pub coordinates: Option<String>,
    /// Data of the report page, if the job requests one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub overview: Option<Overview>,
    /// Stages in order.
    pub stages: Vec<StageReport>,
    /// Written files.
    #[serde(serialize_with = "paths_as_text")]
    #[schemars(with = "Vec<String>")]
    pub outputs: Vec<PathBuf>,
}

/// Summary of a trajectory.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct TrajectoryReport {
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
}

impl From<(&Path, &Trajectory)> for TrajectoryReport {
    fn from((path, trajectory): (&Path, &Trajectory)) -> TrajectoryReport {
        TrajectoryReport {
            path: path.to_string_lossy().into_owned(),
            records: trajectory.samples().len(),
            span_s: trajectory.span_s(),
            median_step_s: trajectory.median_step_s(),
            gaps: trajectory.gaps().len(),
        }
    }
}

/// Results of a stage.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct StageReport {
    /// Name in the job.
    pub id: String,
    /// Type of the stage.
    pub r#type: String,
    /// Role of the stage.
    pub role: RoleName,
    /// Number of workers.
    pub workers: usize,
    /// Input scan lines.
    pub lines_in: u64,
    /// Output scan lines.
    pub lines_out: u64,
    /// Input items.
    pub items_in: ItemCounts,
    /// Output items.
    pub items_out: ItemCounts,
    /// Number of rejected items, by `item: reason`.
    pub rejected: BTreeMap<String, u64>,
    /// Entries of `rejected` that lose no data.
    pub set_aside: Vec<String>,
    /// Measured quantities.
    pub observed: BTreeMap<String, Summary>,
    /// Warnings of the stage.
    pub notes: Vec<String>,
    /// Findings that need no action.
    pub findings: Vec<String>,
    /// Working time, s, summed over all workers.
    pub working_s: f64,
    /// Time waiting for input, s, summed over all workers.
    pub waiting_s: f64,
    /// Time waiting for space in the output, s, summed over all workers.
    pub blocked_s: f64,
    /// Working time per scan line, microseconds.
    pub line_us: Summary,
    #[serde(skip)]
    #[schemars(skip)]
    pub(super) spans: Vec<Span>,
}

/// Item counts by type.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, JsonSchema)]
pub struct ItemCounts {
    /// Shots.
    pub shots: u64,
    /// Sample blocks.
    pub blocks: u64,
    /// Returns and points.
    pub returns: u64,
}

/// Summary of a distribution.
#[derive(Clone, Copy, Debug, Serialize, JsonSchema)]
pub struct Summary {
    /// Number of values.
    pub count: u64,
    /// Mean.
    pub mean: f64,
    /// Median.
    pub p50: f64,
    /// 90th percentile.
    pub p90: f64,
    /// 99th percentile.
    pub p99: f64,
    /// 99.9th percentile.
    pub p999: f64,
    /// Maximum.
    pub max: f64,
}

/// Counters of lines that have left the chain, with data for the page.
#[derive(Clone, Debug, Default)]
pub struct Totals {
    counts: BTreeMap<&'static str, u64>,
    input: Option<Arc<InputInfo>>,
    model: Option<Arc<SensorModel>>,
    fusion: Option<Arc<ChannelFusion>>,
    gathering: Option<Gathering>,
    gallery: Option<Gallery>,
}

impl Totals {
    /// Creates totals, with data for the page if `overview`.
    pub(super) fn new(overview: bool) -> Totals {
        Totals { gathering: overview.then(Gathering::default), ..Totals::default() }
    }

    /// Adds the shots to show.
    pub(super) fn with_gallery(self, gallery: Gallery) -> Totals {
        Totals { gallery: Some(gallery), ..self }
    }

    pub(super) fn add(&mut self, batch: &ScanLine) {
        for (name, count) in batch.stats.counts() {
            *self.counts.entry(name).or_default() += count;
        }
        self.gathering.iter_mut().for_each(|gathering| gathering.add(batch));
        if self.input.as_ref().is_none_or(|input| input.first_shot.is_none()) {
            self.input = Some(Arc::clone(&batch.input));
        }
        if self.model.is_none() {
            self.model.clone_from(&batch.model);
        }
        if self.fusion.is_none() {
            self.fusion.clone_from(&batch.fusion);
        }
    }
}

impl From<[u64; 3]> for ItemCounts {
    fn from([shots, blocks, returns]: [u64; 3]) -> ItemCounts {
        ItemCounts { shots, blocks, returns }
    }
}

impl ItemCounts {
    /// Count of one item type.
    pub fn of(&self, item: Item) -> u64 {
        match item {
            Item::Shots => self.shots,
            Item::Blocks => self.blocks,
            Item::Returns => self.returns,
        }
    }
}

impl From<&Distribution> for Summary {
    fn from(values: &Distribution) -> Summary {
        Summary {
            count: values.count(),
            mean: values.mean(),
            p50: values.percentile(50.0),
            p90: values.percentile(90.0),
            p99: values.percentile(99.0),
            p999: values.percentile(99.9),
            max: values.max(),
        }
    }
}

impl Summary {
    fn of_latency(latency_ns: &hdrhistogram::Histogram<u64>) -> Summary {
        let us = |percent| latency_ns.value_at_percentile(percent) as f64 / 1e3;
        Summary {
            count: latency_ns.len(),
            mean: latency_ns.mean() / 1e3,
            p50: us(50.0),
            p90: us(90.0),
            p99: us(99.0),
            p999: us(99.9),
            max: latency_ns.max() as f64 / 1e3,
        }
    }
}

/// Item and reason of a rejection.
fn dropped((item, reason): &(Item, &'static str)) -> String {
    format!("{}: {reason}", item.name())
}

impl StageReport {
    pub(super) fn new(stage: &JobStage, workers: usize, meter: Meter, counters: Counters) -> StageReport {
        StageReport {
            id: stage.id.clone(),
            r#type: stage.spec.name.to_string(),
            role: stage.spec.role,
            workers,
            lines_in: meter.lines_in,
            lines_out: meter.lines_out,
            items_in: meter.items_in.into(),
            items_out: meter.items_out.into(),
            rejected: counters.rejected.iter().map(|(what, n)| (dropped(what), *n)).collect(),
            set_aside: counters.set_aside.iter().map(dropped).collect(),
            observed: counters.observed.iter().map(|(name, d)| (name.to_string(), d.into())).collect(),
            notes: counters.notes,
            findings: counters.findings,
            working_s: meter.working.as_secs_f64(),
            waiting_s: meter.waiting.as_secs_f64(),
            blocked_s: meter.blocked.as_secs_f64(),
            line_us: Summary::of_latency(&meter.latency_ns),
            spans: meter.spans,
        }
    }

    /// Number of rejected items of this type, for all reasons.
    pub fn rejected_of(&self, item: Item) -> u64 {
        let prefix = format!("{}: ", item.name());
        self.rejected.iter().filter(|(what, _)| what.starts_with(&prefix)).map(|(_, n)| n).sum()
    }

    /// Mean fraction of the run during which each worker was busy.
    fn load(&self, wall_s: f64) -> f64 {
        self.working_s / (self.workers as f64 * wall_s).max(1e-9)
    }
}

impl InputReport {
    pub(super) fn new(
        site: &RunContext,
        started: Instant,
        totals: Totals,
        stages: Vec<StageReport>,
        outputs: Vec<PathBuf>,
        peak_in_flight_bytes: usize,
    ) -> InputReport {
        let input = totals.input.as_deref();
        let (now, elapsed) = (SystemTime::now(), started.elapsed());
        InputReport {
            path: site.input.clone(),
            stem: site.stem.clone(),
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
            channel_fusion: totals.fusion.as_deref().cloned(),
            sensor_model: totals.model.as_deref().cloned(),
            overview: totals.gathering.map(|gathering| gathering.finish(totals.gallery)),
            trajectory: site.geometry.trajectory().map(TrajectoryReport::from),
            // An error here would already have ended the run.
            coordinates: totals
                .input
                .as_deref()
                .and_then(|input| site.geometry.target(input).ok().flatten())
                .map(|target| target.name().to_owned()),
            stages,
            outputs,
        }
    }

    /// Report of an input that no stage has started.
    pub(super) fn not_begun(site: &RunContext, started: Instant) -> InputReport {
        InputReport::new(site, started, Totals::new(false), Vec::new(), Vec::new(), 0)
    }

    /// Returns the stage with the busiest workers.
    pub fn bottleneck(&self) -> Option<&StageReport> {
        self.stages.iter().max_by(|a, b| a.load(self.wall_s).total_cmp(&b.load(self.wall_s)))
    }

    /// Table of the stages: items and times.
    pub fn table(&self) -> String {
        let mut text = String::new();
        let width = self.stages.iter().map(|stage| stage.id.len()).max().unwrap_or(0).max(5);
        let _ = writeln!(
            text,
            "{:width$} {:>7} {:>9} {:>11} {:>11} {:>9} {:>9} {:>9} {:>9} {:>6}",
            "stage",
            "workers",
            "lines",
            "shots",
            "returns",
            "rejected",
            "working s",
            "waiting s",
            "blocked s",
            "busy"
        );
        for stage in &self.stages {
            let rejected: u64 = stage.rejected.values().sum();
            let mark = if self.bottleneck().is_some_and(|slowest| slowest.id == stage.id) {
                " <- bottleneck"
            } else {
                ""
            };
            let _ = writeln!(
                text,
                "{:width$} {:>7} {:>9} {:>11} {:>11} {:>9} {:>9.3} {:>9.3} {:>9.3} {:>5.0}%{mark}",
                stage.id,
                stage.workers,
                stage.lines_out,
                stage.items_out.shots,
                stage.items_out.returns,
                rejected,
                stage.working_s,
                stage.waiting_s,
                stage.blocked_s,
                100.0 * stage.load(self.wall_s),
            );
        }
        text
    }

    /// Table of working times per scan line, in percentiles.
    pub fn latency_table(&self) -> String {
        let mut text = String::new();
        let width = self.stages.iter().map(|stage| stage.id.len()).max().unwrap_or(0).max(5);
        let _ = writeln!(
            text,
            "{:width$} {:>11} {:>11} {:>11} {:>11} {:>11} {:>11}",
            "us per line", "mean", "p50", "p90", "p99", "p99.9", "max"
        );
        for stage in &self.stages {
            let us = &stage.line_us;
            let _ = writeln!(
                text,
                "{:width$} {:>11.1} {:>11.1} {:>11.1} {:>11.1} {:>11.1} {:>11.1}",
                stage.id, us.mean, us.p50, us.p90, us.p99, us.p999, us.max
            );
        }
        text
    }
}

impl RunReport {
    pub(super) fn new(job: &Job, options: &Options) -> RunReport {
        let keys = |stage: &JobStage| StageKeys {
            id: stage.id.clone(),
            r#type: stage.spec.name.to_string(),
            keys: stage.planned.resolved.clone(),
        };
        RunReport {
            wavex: env!("CARGO_PKG_VERSION").to_string(),
            job: job.settings.clone(),
            stages: job.stages.iter().map(keys).collect(),
            threads: options.workers(),
            simd: options.simd.into(),
            wall_s: 0.0,
            inputs: Vec::new(),
        }
    }

    pub(super) fn add(&mut self, input: InputReport) {
        self.inputs.push(input);
    }

    /// Notes that several inputs share, with the number of inputs.
    ///
    /// Each note is logged for the first input only.
    pub fn repeated_notes(&self) -> BTreeMap<&str, usize> {
        let mut inputs_of: BTreeMap<&str, usize> = BTreeMap::new();
        for input in &self.inputs {
            let notes = input.stages.iter().flat_map(|stage| &stage.notes);
            let notes: BTreeSet<&str> = notes.map(String::as_str).collect();
            notes.into_iter().for_each(|note| *inputs_of.entry(note).or_default() += 1);
        }
        inputs_of.retain(|_, inputs| *inputs > 1);
        inputs_of
    }
}

/// Serialises a path as text; replaces invalid Unicode.
fn path_as_text<S: Serializer>(path: &Path, to: S) -> Result<S::Ok, S::Error> {
    to.serialize_str(&path.to_string_lossy())
}

fn paths_as_text<S: Serializer>(paths: &[PathBuf], to: S) -> Result<S::Ok, S::Error> {
    to.collect_seq(paths.iter().map(|path| path.to_string_lossy()))
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
