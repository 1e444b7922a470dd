//! Decomposes one shot of a recording.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use serde::de::DeserializeOwned;

use crate::{Failure, job_file, run};
use wavex_engine::engine::{Cancel, Input, Options, Phase, ProgressMode, observe};
use wavex_engine::job::{Job, JobStage, Override};
use wavex_engine::recording::{Excerpt, LineIndex, Recording};
use wavex_formats::container::ContainerReader;
use wavex_formats::format::{reader_of, small_footprint_reader_of};
use wavex_line::scan_line::{Emission, InputInfo, Returns, ScanLine};
use wavex_line::stage::{Context, FittedBlock, Plan, RunContext, SourcePlan};
use wavex_pages::explain::{ExplainError, ExplainedFootprint, ExplainedShot};
use wavex_signal::sensor_model::SensorModel;
use wavex_stages::process::calibrate::Calibrate;
use wavex_stages::process::decompose::Decompose;
use wavex_stages::process::measure_footprints::SeenFootprint;
use wavex_stages::process::resolve_mta::LINES_AROUND;
use wavex_stages::registry::STAGES;

mod footprint;

pub use footprint::FootprintChain;

/// A shot with its fit, for programs; see [`explain_shot`].
#[derive(Debug)]
pub struct Explanation {
    /// The shot, with its fitted emission time.
    pub emission: Emission,
    /// Its returns, in order of time.
    pub returns: Returns,
    /// Its echo blocks with their fits, in order of time.
    pub blocks: Vec<FittedBlock>,
    /// Metadata of the recording.
    pub input: Arc<InputInfo>,
    /// The table that `wavex explain` prints.
    pub text: String,
    /// The picture that `wavex explain` writes, SVG.
    pub svg: String,
}

/// Decomposes one shot of a recording like `wavex explain`, but writes and prints nothing.
///
/// `set` are overrides of the keys of `calibrate` and `decompose`; `model` replaces the calibration.
/// `cancel` ends the search for the shot.
///
/// # Errors
/// If the recording cannot be read, the keys are invalid, or the recording has no such shot or no
/// echoes of it.
pub fn explain_shot(
    file: &Path,
    shot: u64,
    set: &[String],
    model: Option<Arc<SensorModel>>,
    cancel: Cancel,
) -> Result<Explanation, Failure> {
    let request = ExplainRequest { set, ..ExplainRequest::of(file) };
    if request.has_large_footprints()? {
        if model.is_some() {
            return Err(footprint::with_sensor_model(file));
        }
        return Ok(of_footprint(FootprintChain::of(&request)?.explain(shot)?));
    }
    let mut chain = Chain::of(&request)?;
    chain.options.cancel = cancel;
    if let Some(model) = model {
        let calibrate: Calibrate = keys_of(&chain.job, "calibrate")?;
        if let Some(stage) = chain.job.stages.iter_mut().find(|stage| stage.spec.name == "calibrate") {
            stage.planned.plan = calibrate.with_model(model);
        }
    }
    let explained = Arc::new(chain).explain(shot)?;
    let (text, svg) = (explained.table(), explained.picture());
    let blocks = explained.blocks.into_iter().map(|block| block.shown).collect();
    let ExplainedShot { emission, returns, input, .. } = explained;
    Ok(Explanation { emission, returns, blocks, input, text, svg })
}

/// A footprint for programs; its samples are in the picture only.
fn of_footprint(explained: ExplainedFootprint) -> Explanation {
    let (text, svg) = (explained.table_within(None), explained.picture());
    let SeenFootprint { emission, input, footprint, modes, .. } = explained.seen;
    let emission = Emission { shot: footprint.shot_number, ..emission };
    Explanation { emission, returns: modes, blocks: Vec::new(), input, text, svg }
}

/// A recording, and the job whose stages are applied to it.
pub struct ExplainRequest<'a> {
    /// Recording.
    pub file: &'a Path,
    /// Job file; `None`: stages with default keys.
    pub job: Option<&'a Path>,
    /// Overrides of keys, such as `decompose.mode=slow`.
    pub set: &'a [String],
    /// Sensor model to use instead of calibrating.
    pub model: Option<&'a Path>,
    /// Progress display.
    pub progress: ProgressMode,
}

impl<'a> ExplainRequest<'a> {
    /// A recording with the default keys of all stages.
    pub fn of(file: &'a Path) -> ExplainRequest<'a> {
        ExplainRequest { file, job: None, set: &[], model: None, progress: ProgressMode::Hidden }
    }

    /// Whether the recording has large footprints, which [`FootprintChain`] measures: by its format, or by its job.
    ///
    /// # Errors
    /// If the job is invalid.
    pub fn has_large_footprints(&self) -> Result<bool, Failure> {
        let file = self.file.display().to_string();
        match reader_of(&file) {
            Ok(FOOTPRINTS) if small_footprint_reader_of(&file).is_err() => return Ok(true),
            Ok(CONTAINER) if self.job.is_none() && has_fractions(self.file) => return Ok(true),
            _ => {}
        }
        let Some(path) = self.job else { return Ok(false) };
        let job = job_file::read(path, self.set.iter().map(Override::new).collect())?;
        Ok(job.stages.iter().any(|stage| stage.spec.name == MEASURE))
    }
}

/// Explains shots of a recording with footprints of its size.
pub enum Explainer {
    /// Decomposes them.
    Small(Arc<Chain>),
    /// Measures their ground and heights.
    Large(Box<FootprintChain>),
}

/// Selects a shot.
#[derive(Clone, Copy, Debug)]
pub enum ShotChoice {
    /// By its number in outputs: of large footprints that of their mission, or else the running number.
    Number(u64),
    /// The nearest to a time, s.
    Time(f64),
}

/// An explained shot as it is printed and drawn.
pub struct ShownExplanation {
    /// Its number in outputs.
    pub shot: u64,
    /// Its time less the wanted one, s; 0 without a wanted one.
    pub later_s: f64,
    /// Table in lines of at most the wanted number of characters.
    pub table: String,
    /// Picture, SVG.
    pub picture: String,
}

impl Explainer {
    /// Explainer of a request.
    ///
    /// # Errors
    /// If the format is unknown or the job invalid.
    pub fn of(request: &ExplainRequest) -> Result<Explainer, Failure> {
        match request.has_large_footprints()? {
            true => Ok(Explainer::Large(Box::new(FootprintChain::of(request)?))),
            false => Chain::of(request).map(|chain| Explainer::Small(Arc::new(chain))),
        }
    }

    /// Explains a shot; the table has lines of at most `columns` characters, if it is given.
    ///
    /// # Errors
    /// If the recording cannot be read, has no such shot, or nothing of it can be explained.
    pub fn explain(&self, choice: ShotChoice, columns: Option<usize>) -> Result<ShownExplanation, Failure> {
        match self {
            Explainer::Small(chain) => {
                let (shot, later_s) = match choice {
                    ShotChoice::Number(shot) => (shot, 0.0),
                    ShotChoice::Time(time_s) => {
                        let (shot, found_s) = chain.nearest(time_s)?;
                        (shot, found_s - time_s)
                    }
                };
                let explained = chain.explain(shot)?;
                let (table, picture) = (explained.table_within(columns), explained.picture());
                Ok(ShownExplanation { shot, later_s, table, picture })
            }
            Explainer::Large(chain) => {
                let (explained, later_s) = match choice {
                    ShotChoice::Number(shot) => (chain.explain(shot)?, 0.0),
                    ShotChoice::Time(time_s) => {
                        let (running, found_s) = chain.nearest(time_s)?;
                        (chain.explain_running(running)?, found_s - time_s)
                    }
                };
                let (table, picture) = (explained.table_within(columns), explained.picture());
                let shot = explained.seen.footprint.shot_number;
                Ok(ShownExplanation { shot, later_s, table, picture })
            }
        }
    }
}

/// Whether a container has samples that only `measure_footprints` accepts.
fn has_fractions(file: &Path) -> bool {
    ContainerReader::open(file).is_ok_and(|reader| reader.header().has_fractions)
}

/// Reader of recordings with large footprints.
const FOOTPRINTS: &str = "read_hdf5";
/// Reader of containers, whose samples are fractions of a digitiser step for large footprints only.
const CONTAINER: &str = "read_arrow";
/// Stage that measures them.
const MEASURE: &str = "measure_footprints";
/// Stages after the reader of recordings with small footprints.
const SMALL: [&str; 2] = ["calibrate", "decompose"];

/// Path of the command line, which starts at the current folder; paths in a job start at its input folder.
fn absolute(path: &Path) -> PathBuf {
    std::path::absolute(path).unwrap_or_else(|_| path.to_owned())
}

/// A recording and the stages of a job that apply to it.
pub struct Chain {
    /// The reader of the recording and the stages before `decompose`, without sinks.
    job: Job,
    options: Options,
    file: PathBuf,
    /// Stem of the recording.
    stem: String,
    decompose: Decompose,
}

impl Chain {
    /// Chain of a request.
    ///
    /// # Errors
    /// If the format is unknown or the job invalid.
    pub fn of(request: &ExplainRequest) -> Result<Chain, Failure> {
        let file = request.file.display().to_string();
        let reader = small_footprint_reader_of(&file).map_err(Failure::Wrong)?;
        let default_job =
            default_job(reader, &SMALL, &file, if request.job.is_some() { &[] } else { request.set })?;
        let (mut job, folder) = match request.job {
            None => (default_job.clone(), PathBuf::from(".")),
            Some(path) => {
                let overrides = request.set.iter().map(Override::new).collect();
                (job_file::read(path, overrides)?, job_file::folder(path))
            }
        };
        let mut calibrate: Calibrate = keys_of(&job, "calibrate")?;
        let decompose = keys_of(&job, "decompose")?;
        calibrate.save = None;
        if let Some(model) = request.model {
            calibrate.load = Some(absolute(model));
        }
        let mut stages = job.stages.iter_mut();
        match (stages.next(), default_job.stages.into_iter().next()) {
            (Some(first), Some(default)) if first.spec.name != reader => {
                tracing::warn!(
                    "{}: its first stage `{}` does not read {file}: it is read by `{reader}` with default keys",
                    job.name,
                    first.id
                );
                *first = default;
            }
            _ => {}
        }
        if let Some(stage) = stages.find(|stage| stage.spec.name == "calibrate") {
            stage.planned.plan = Plan::Transform(Arc::new(calibrate));
        }
        let until_decompose = job.stages.iter().position(|stage| stage.spec.name == "decompose");
        job.stages.truncate(until_decompose.unwrap_or_default());
        job.stages.retain(|stage| !matches!(stage.planned.plan, Plan::Sink(_)));
        let (input_dir, output_dir) = run::folders(&job, &folder);
        let progress = request.progress;
        let options = Options { progress, ..Options::of_job(&job, input_dir, output_dir) };
        let stem = request.file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        Ok(Chain { job, options, file: request.file.to_owned(), stem, decompose })
    }

    fn input(&self) -> Input {
        Input { path: self.file.clone(), stem: self.stem.clone(), part: None }
    }

    /// The reader of the recording, and its keys.
    fn reader(&self) -> Result<(Arc<dyn SourcePlan>, serde_json::Value), Failure> {
        match self.job.stages.first().map(|stage| (&stage.planned.plan, &stage.planned.resolved)) {
            Some((Plan::Source(reader), keys)) => Ok((Arc::clone(reader), keys.clone())),
            _ => Err(Failure::Wrong(format!("{}: the job has no reader; add one", self.job.name))),
        }
    }

    /// Opens the recording for random access.
    fn recording(&self) -> Result<Recording, Failure> {
        let (reader, keys) = self.reader()?;
        let input_dir = self.options.input_dir.clone();
        let run = RunContext { stem: self.stem.clone(), input_dir, ..RunContext::alone(&self.file) };
        Recording::of_reader(reader, &keys, run).map_err(|error| failed(&error))
    }

    /// Number of lines before and after a shot's line on which its blocks depend.
    fn margin(&self) -> usize {
        let resolves = self.job.stages.iter().any(|stage| stage.spec.name == "resolve_mta");
        if resolves { LINES_AROUND } else { 2 }
    }

    /// Decomposes a shot of the recording.
    ///
    /// Reads the lines from which the stages learn, then those around the shot.
    ///
    /// # Errors
    /// If the recording cannot be read, or has no such shot or no echoes of it.
    pub fn explain(self: &Arc<Self>, shot: u64) -> Result<ExplainedShot, Failure> {
        let chain = Arc::clone(self);
        let may_skip = Arc::<AtomicBool>::default();
        let have_learnt = Arc::clone(&may_skip);
        let look = move |(seen, explained): &mut (ShotNumbers, _), line: &ScanLine| {
            have_learnt.store(true, Ordering::Relaxed);
            line.emissions.iter().for_each(|emission| seen.add(emission.shot));
            if !line.emissions.iter().any(|emission| emission.shot == shot) {
                return ControlFlow::Continue(());
            }
            *explained = Some(chain.explain_in(line, shot));
            ControlFlow::Break(())
        };
        let (reader, keys) = self.reader()?;
        let mut job = self.job.clone();
        let excerpt = Excerpt { reader, keys, shot, margin: self.margin(), may_skip };
        if let Some(first) = job.stages.first_mut() {
            first.planned.plan = Plan::Source(Arc::new(excerpt));
        }
        let observed = observe(
            &job,
            self.input(),
            &self.options,
            Context::of_run(),
            (ShotNumbers::default(), None),
            look,
        );
        match observed.map_err(|error| failed(&error))? {
            (_, Some(explained)) => explained,
            (seen, None) => {
                // Only parts of the recording may have been read.
                let index = self.recording()?.index(&mut |_| Ok(()));
                let numbers = index.map_or(seen, |index| ShotNumbers::of(&index));
                Err(Failure::Wrong(numbers.without(shot, &self.file)))
            }
        }
    }

    /// Decomposes a shot of a line that has passed the stages before `decompose`.
    fn explain_in(&self, line: &ScanLine, shot: u64) -> Result<ExplainedShot, Failure> {
        let file = self.file.display().to_string();
        ExplainedShot::of(line, shot, &self.decompose, self.options.simd, &file).map_err(
            |error| match error {
                ExplainError::Without(problem) => Failure::Wrong(problem),
                ExplainError::Stage(error) => failed(&error),
            },
        )
    }

    /// Returns the number of the shot nearest to a time, and its time, s.
    ///
    /// # Errors
    /// If the recording cannot be read, its shots have no times, or the time is outside of theirs.
    pub fn nearest(&self, time_s: f64) -> Result<(u64, f64), Failure> {
        nearest(self.recording()?, &self.file, self.options.progress, time_s)
    }
}

/// Returns the number of the shot of a recording nearest to a time, and its time, s.
fn nearest(
    mut recording: Recording,
    file: &Path,
    progress: ProgressMode,
    time_s: f64,
) -> Result<(u64, f64), Failure> {
    let mut phase = Phase::new("index", "reading shot times", progress, 1);
    let stem = file.file_stem().unwrap_or_default().to_string_lossy();
    let index = recording.index(&mut |part| {
        phase.show(&stem, 0, part);
        Ok(())
    });
    drop(phase);
    let index = index.map_err(|error| failed(&error))?;
    let file = file.display();
    let without_times = || Failure::Wrong(format!("{file}: its shots have no times; select one with --shot"));
    let [first_s, last_s] = index.time_range_s().ok_or_else(without_times)?;
    if !(first_s - NEAR_S..=last_s + NEAR_S).contains(&time_s) {
        let input = recording.input();
        let week = input.gps_week.map_or(String::new(), |week| format!(", GPS week {week}"));
        let scale = input.time_scale.words().unwrap_or("on a time scale that the file does not state");
        return Err(Failure::Wrong(format!(
            "{file}: no shot at {time_s} s; its times are from {first_s:.6} to {last_s:.6} s, {scale}{week}"
        )));
    }
    recording.nearest_shot(time_s).map_err(|error| failed(&error))?.ok_or_else(without_times)
}

/// Largest distance of a shot from the time that selects it, s; larger ones are reported.
///
/// Tables and other programs round times to a millisecond or less.
pub const NEAR_S: f64 = 1e-3;

/// Count and range of the shot numbers of a recording.
#[derive(Default)]
struct ShotNumbers {
    count: u64,
    range: Option<(u64, u64)>,
}

impl ShotNumbers {
    fn of(index: &LineIndex) -> ShotNumbers {
        ShotNumbers { count: index.shots(), range: index.shot_range().map(Into::into) }
    }

    fn add(&mut self, shot: u64) {
        self.count += 1;
        let (first, last) = self.range.unwrap_or((shot, shot));
        self.range = Some((first.min(shot), last.max(shot)));
    }

    /// Error message for a missing shot number.
    fn without(&self, shot: u64, file: &Path) -> String {
        let file = file.display();
        match self.range {
            None => format!("{file}: no shot {shot}: the recording has no shots; choose another file"),
            Some((first, last)) => {
                let count = self.count;
                format!("{file}: no shot {shot}; the {count} shots are numbered {first} to {last}")
            }
        }
    }
}

/// A job with the default keys of these stages.
fn default_job(reader: &str, stages: &[&str], file: &str, set: &[String]) -> Result<Job, Failure> {
    let path = toml::Value::String(file.to_owned());
    let stage = |name: &&str| format!("\n[[stage]]\ntype = \"{name}\"\n");
    let stages: String = stages.iter().map(stage).collect();
    let text = format!("[[stage]]\ntype = \"{reader}\"\npath = {path}\n{stages}");
    let overrides: Vec<Override> = set.iter().map(Override::new).collect();
    Ok(Job::parse(STAGES, "the job of `wavex explain`", &text, &overrides)?)
}

/// Keys of the first stage of this type in a job.
fn keys_of<C: DeserializeOwned>(job: &Job, stage: &str) -> Result<C, Failure> {
    let is_it = |candidate: &&JobStage| candidate.spec.name == stage;
    let Some(found) = job.stages.iter().find(is_it) else {
        return Err(Failure::Wrong(format!("{}: the job has no stage `{stage}`; add one", job.name)));
    };
    serde_json::from_value(found.planned.resolved.clone())
        .map_err(|error| Failure::Run(format!("`{stage}`: {error}; please report this bug in wavex")))
}

fn failed(error: &dyn std::fmt::Display) -> Failure {
    Failure::Run(error.to_string())
}
