//! What a run did: the table at its end, and `report.json`.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Instant, SystemTime};

use schemars::JsonSchema;
use serde::{Serialize, Serializer};

use super::Options;
use super::meter::{Meter, Span};
use crate::batch::{Batch, EmissionReference, Frame, InputInfo, TimeScale};
use crate::geo::time::utc;
use crate::geo::trajectory::Trajectory;
use crate::job::{Job, JobSettings, JobStage, Simd};
use crate::kernels::fusion::ChannelFusion;
use crate::kernels::sensor_model::SensorModel;
use crate::overview::{Gallery, Gathering, Overview};
use crate::stage::{Counters, Distribution, Item, RoleName, Site};

/// What a run did (`report.json`).
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct RunReport {
    /// The version of wavex.
    pub wavex: String,
    /// The table `[job]`, every default spelled out.
    pub job: JobSettings,
    /// The stages with their keys, every default spelled out.
    pub stages: Vec<StageKeys>,
    /// Workers per map.
    pub threads: usize,
    /// The instructions that kernels used.
    pub simd: Simd,
    /// Duration of the whole run, s.
    pub wall_s: f64,
    /// One entry per input.
    pub inputs: Vec<InputReport>,
}

/// A stage as the job has it.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct StageKeys {
    /// What the job calls it.
    pub id: String,
    /// Its type.
    pub r#type: String,
    /// Its keys, every default spelled out.
    pub keys: serde_json::Value,
}

/// What the chain did with one input.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct InputReport {
    /// The file; empty for a simulated input.
    #[serde(serialize_with = "path_as_text")]
    #[schemars(with = "String")]
    pub path: PathBuf,
    /// What its outputs are named after.
    pub stem: String,
    /// The format, as the reader told it.
    pub format: Option<String>,
    /// The instrument.
    pub instrument: Option<String>,
    /// Its serial number.
    pub serial: Option<String>,
    /// Time between samples, ns.
    pub sampling_interval_ns: Option<f64>,
    /// Speed of the pulse in air, m/s.
    pub group_velocity_mps: Option<f64>,
    /// `week`, `day`, `adjusted` or `unknown`.
    pub time_scale: Option<String>,
    /// `scanner`, `body` or `map`.
    pub frame: Option<String>,
    /// How the moment of emission is known: `outgoing_pulse`, `outgoing_pulse_fraction`, `return_locations` or
    /// `clock`.
    pub emission_reference: Option<String>,
    /// Where ranges count from: `sensor`, or `first_sample` where the recording does not give the sensor's position.
    pub ranges_count_from: Option<String>,
    /// When this run began, UTC, as ISO 8601.
    pub started: String,
    /// When it ended.
    pub ended: String,
    /// Duration of this run, s.
    pub wall_s: f64,
    /// The most memory that lines under way took at once, bytes.
    pub peak_in_flight_bytes: usize,
    /// The counters of all lines together.
    pub totals: BTreeMap<&'static str, u64>,
    /// What `fuse_channels` found, or was given.
    pub channel_fusion: Option<ChannelFusion>,
    /// What `calibrate` found.
    pub sensor_model: Option<SensorModel>,
    /// The trajectory of `[job.geometry]`.
    pub trajectory: Option<TrajectoryReport>,
    /// The coordinates of the points, where a trajectory brought them there.
    pub coordinates: Option<String>,
    /// What was made, to be looked at, where the job wants a page.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub overview: Option<Overview>,
    /// The stages, in order.
    pub stages: Vec<StageReport>,
    /// The files written.
    #[serde(serialize_with = "paths_as_text")]
    #[schemars(with = "Vec<String>")]
    pub outputs: Vec<PathBuf>,
}

/// A trajectory in a few numbers.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct TrajectoryReport {
    /// The file.
    pub path: String,
    /// How many records it has.
    pub records: usize,
    /// First and last time, s, on an axis without jumps.
    pub span_s: [f64; 2],
    /// The usual time from record to record, s.
    pub median_step_s: f64,
    /// How many gaps there are, bridged ones included.
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

/// What a stage did.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct StageReport {
    /// What the job calls it.
    pub id: String,
    /// Its type.
    pub r#type: String,
    /// Its role.
    pub role: RoleName,
    /// How many workers it had.
    pub workers: usize,
    /// Scan lines in.
    pub lines_in: u64,
    /// Scan lines out.
    pub lines_out: u64,
    /// Items in.
    pub items_in: ItemCounts,
    /// Items out.
    pub items_out: ItemCounts,
    /// Items dropped: `what: why` and how many.
    pub rejected: BTreeMap<String, u64>,
    /// Of these, the names of what nothing is lost with.
    pub set_aside: Vec<String>,
    /// Quantities measured.
    pub observed: BTreeMap<String, Summary>,
    /// What the stage had to say.
    pub notes: Vec<String>,
    /// What came out, which is no reason to act.
    pub findings: Vec<String>,
    /// Time spent working, s, all workers together.
    pub working_s: f64,
    /// Time spent waiting for input, s, all workers together.
    pub waiting_s: f64,
    /// Time spent waiting for room in the output, s, all workers together.
    pub blocked_s: f64,
    /// Working time per scan line, microseconds.
    pub line_us: Summary,
    #[serde(skip)]
    #[schemars(skip)]
    pub(super) spans: Vec<Span>,
}

/// How many items of each sort.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, JsonSchema)]
pub struct ItemCounts {
    /// Emissions.
    pub shots: u64,
    /// Sample blocks.
    pub blocks: u64,
    /// Returns and points.
    pub returns: u64,
}

/// A distribution in a few numbers.
#[derive(Clone, Copy, Debug, Serialize, JsonSchema)]
pub struct Summary {
    /// How many values.
    pub count: u64,
    /// Their mean.
    pub mean: f64,
    /// Half of the values lie below.
    pub p50: f64,
    /// 90 % lie below.
    pub p90: f64,
    /// 99 % lie below.
    pub p99: f64,
    /// 99.9 % lie below.
    pub p999: f64,
    /// The largest.
    pub max: f64,
}

/// What the lines of a run had counted when they left the chain.
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
    /// With what a page shows, or without.
    pub(super) fn new(overview: bool) -> Totals {
        Totals { gathering: overview.then(Gathering::default), ..Totals::default() }
    }

    /// The same, with the shots to be shown.
    pub(super) fn with_gallery(self, gallery: Gallery) -> Totals {
        Totals { gallery: Some(gallery), ..self }
    }

    pub(super) fn add(&mut self, batch: &Batch) {
        for (name, count) in batch.stats.counts() {
            *self.counts.entry(name).or_default() += count;
        }
        self.gathering.iter_mut().for_each(|gathering| gathering.add(batch));
        self.input.get_or_insert_with(|| Arc::clone(&batch.input));
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
    /// How many of one sort.
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

/// What was dropped, and why.
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

    /// How many of `item` were rejected, whatever the reason.
    pub fn rejected_of(&self, item: Item) -> u64 {
        let prefix = format!("{}: ", item.name());
        self.rejected.iter().filter(|(what, _)| what.starts_with(&prefix)).map(|(_, n)| n).sum()
    }

    /// The part of the run during which each worker was busy, on average.
    fn load(&self, wall_s: f64) -> f64 {
        self.working_s / (self.workers as f64 * wall_s).max(1e-9)
    }
}

impl InputReport {
    pub(super) fn new(
        site: &Site,
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
            // An error here has ended the run before.
            coordinates: site.geometry.target().ok().flatten().map(|target| target.name().to_owned()),
            stages,
            outputs,
        }
    }

    /// The report of an input that no stage has begun with.
    pub(super) fn not_begun(site: &Site, started: Instant) -> InputReport {
        InputReport::new(site, started, Totals::new(false), Vec::new(), Vec::new(), 0)
    }

    /// The stage whose workers were busiest: where the time goes.
    pub fn bottleneck(&self) -> Option<&StageReport> {
        self.stages.iter().max_by(|a, b| a.load(self.wall_s).total_cmp(&b.load(self.wall_s)))
    }

    /// The table of the stages: items, and where the time went.
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

    /// Working time per scan line of each stage, in percentiles.
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

    /// What stages noted of several inputs, with the number of inputs; each note is logged for the first one only.
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

/// A path as JSON can hold it: what is not Unicode is replaced.
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
