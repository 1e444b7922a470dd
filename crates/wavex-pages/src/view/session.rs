//! What is open in a view: a job, its inputs, and the points collected from them.

use std::collections::VecDeque;
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, RwLock, RwLockReadGuard};

use serde_json::Value;

use crate::report::overview::view::{MapAxes, MapProjection, crs_name};
use wavex_engine::engine::{self, Cancel, Input, Options, ProgressWatch};
use wavex_engine::job::{Job, JobStage};
use wavex_line::georef::Loader;
use wavex_line::scan_line::{Content, InputInfo, Kind, ScanLine};
use wavex_line::stage::{Context, Plan, RunContext};
use wavex_stages::process::decompose::Decompose;

use super::layers::RasterLayer;
use super::lines::{InputLines, Learnt, measures_footprints};
use super::point_file::{FilePoint, PointFile};
use super::points::{ViewPoint, ViewPoints};

/// Origins are multiples of this, m, so that positions can be read.
const ORIGIN_STEP_M: f64 = 100.0;

/// Points of a file that are added together.
const POINTS_AT_ONCE: usize = 10_000;

/// Parses a job with overrides; returns the error as text.
pub type ParseWith = dyn Fn(&[String]) -> Result<Job, String> + Send + Sync;

/// Content of a view to open.
pub struct Opened {
    /// Title of the page.
    pub title: String,
    /// `recording`, `points`, `job` or `folder`.
    pub kind: &'static str,
    /// Of a file of points without waveforms: why there are none, and what to open instead.
    ///
    /// The job then consists of a reader of the file.
    pub without_waveforms: Option<String>,
    /// The job; files that it would write are not written.
    pub job: Job,
    /// Parses the job again, with overrides such as `decompose.detection_sigma=6`.
    pub with: Box<ParseWith>,
    /// Folder at which relative input paths start.
    pub input_dir: PathBuf,
    /// Folder with rasters of a survey.
    pub folder: Option<PathBuf>,
    /// Limit of the memory of all points, bytes.
    pub memory_bytes: usize,
}

/// An input of the view.
pub(super) struct ViewedInput {
    pub(super) input: Input,
    pub(super) shots: AtomicU64,
    learnt: Mutex<Option<Learnt>>,
}

/// Lines of an input; `None` until they are open.
type OpenLines = Arc<Mutex<Option<InputLines>>>;

/// A job by which shots are decomposed.
pub(super) struct Chosen {
    /// Overrides of its keys.
    set: Vec<String>,
    pub(super) job: Job,
    /// Keys of its stage `decompose`, with the tables made for them.
    pub(super) decompose: Decompose,
}

/// Number of jobs with other keys that are kept.
const KEPT_JOBS: usize = 8;
/// Number of inputs that are kept open.
const KEPT_INPUTS: usize = 32;

/// Progress of reading.
#[derive(Clone, Debug)]
pub(super) enum SessionState {
    Reading,
    Ready,
    Failed(String),
}

/// How points become positions on the map.
#[derive(Clone, Debug)]
pub(super) struct Placing {
    view: MapProjection,
    /// Metres per unit of the first two coordinates.
    scale: [f64; 2],
    /// Origin of positions, map coordinates times `scale`, m.
    pub(super) origin_m: [f64; 3],
    pub(super) crs: Option<String>,
    /// Unit of east and north, and of heights.
    pub(super) units: [&'static str; 2],
}

impl Placing {
    fn new(input: &InputInfo, point: [f64; 3]) -> Placing {
        let view = MapProjection::of(input, point);
        let north = view.place(point)[1];
        let scale = if view.axes() == MapAxes::Degrees { view.units_m(north) } else { [1.0; 2] };
        let crs = input.crs_wkt.as_deref().map(crs_name);
        // Degrees are shown as metres.
        let unit = if view.axes() == MapAxes::Degrees { "m" } else { view.unit() };
        let vertical = input.crs_wkt.as_deref().and_then(|wkt| wkt.split_once("VERT"));
        let height_unit = match vertical {
            Some((_, vertical)) if vertical.to_ascii_lowercase().contains("foot") => "ft",
            Some(_) => "m",
            None => unit,
        };
        let mut placing = Placing { view, scale, origin_m: [0.0; 3], crs, units: [unit, height_unit] };
        placing.origin_m = placing.on_map(point).map(|m| (m / ORIGIN_STEP_M).floor() * ORIGIN_STEP_M);
        placing
    }

    /// Position of a point on the map, m for all but coordinates in feet.
    pub(super) fn on_map(&self, point: [f64; 3]) -> [f64; 3] {
        let [x, y, z] = self.view.place(point);
        [x * self.scale[0], y * self.scale[1], z]
    }

    /// Position relative to the origin, m.
    fn relative(&self, point: [f64; 3]) -> [f32; 3] {
        let on_map = self.on_map(point);
        std::array::from_fn(|i| (on_map[i] - self.origin_m[i]) as f32)
    }
}

/// A view: its data and the progress of reading.
pub(super) struct Session {
    pub(super) opened: Opened,
    pub(super) inputs: Vec<ViewedInput>,
    /// Inputs whose lines were read last, by number.
    open: Mutex<VecDeque<(usize, OpenLines)>>,
    loader: Mutex<Loader>,
    /// Jobs by which shots were decomposed last.
    chosen: Mutex<VecDeque<Arc<Chosen>>>,
    /// Description of the points of a generation.
    described: Mutex<(u32, Value)>,
    /// Rasters of the survey.
    pub(super) layers: Vec<RasterLayer>,
    points: RwLock<ViewPoints>,
    placing: RwLock<Option<Placing>>,
    state: Mutex<(SessionState, Vec<String>)>,
    watch: ProgressWatch,
    /// Number of inputs that have been read.
    read: AtomicU64,
    pub(super) cancel: Cancel,
}

/// Messages of the errors of a job, without their places in the text, which the page does not show.
fn messages(errors: &str) -> String {
    let messages: Vec<&str> = errors.lines().filter_map(|line| line.strip_prefix("error: ")).collect();
    if messages.is_empty() { errors.to_owned() } else { messages.join("; ") }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Session {
    /// Lists the inputs of the job; reads nothing yet.
    ///
    /// # Errors
    /// If the job has no input, none can be found, or a file of its geometry cannot be read.
    pub(super) fn new(opened: Opened, cancel: Cancel) -> Result<Session, String> {
        let inputs = engine::inputs(&opened.job, &opened.input_dir).map_err(|error| error.to_string())?;
        if let Some(stream) = inputs.iter().find(|input| input.path.as_os_str() == "-") {
            return Err(format!("{}: standard input cannot be read twice; give a file", stream.stem));
        }
        let viewed = |input| ViewedInput { input, shots: AtomicU64::new(0), learnt: Mutex::default() };
        let loader = Loader::new(&opened.job.settings.geometry, &opened.input_dir);
        let loader = loader.map_err(|error| error.to_string())?;
        let (layers, warnings) = opened.folder.as_deref().map(RasterLayer::of_folder).unwrap_or_default();
        Ok(Session {
            layers,
            described: Mutex::default(),
            open: Mutex::default(),
            loader: Mutex::new(loader),
            chosen: Mutex::default(),
            points: RwLock::new(ViewPoints::within(opened.memory_bytes)),
            inputs: inputs.into_iter().take(usize::from(u16::MAX)).map(viewed).collect(),
            opened,
            placing: RwLock::default(),
            state: Mutex::new((SessionState::Reading, warnings)),
            watch: ProgressWatch::default(),
            read: AtomicU64::new(0),
            cancel,
        })
    }

    /// Runs the chain over all inputs and collects their points.
    ///
    /// `prepare` is called with the first input and shot, once points are there.
    pub(super) fn read(self: &Arc<Session>, prepare: impl FnOnce(&Session, usize, u64)) {
        let is_read = match self.opened.without_waveforms {
            None => self.read_all(),
            Some(_) => self.read_points(),
        };
        if let Err(problem) = is_read {
            lock(&self.state).0 = SessionState::Failed(problem);
            return;
        }
        self.build();
        let state = match self.points().len() {
            0 => SessionState::Failed(self.without_points()),
            _ => SessionState::Ready,
        };
        if self.opened.without_waveforms.is_some() {
            lock(&self.state).0 = state;
            return;
        }
        // The index of the first inputs is ready when the first point is selected.
        for number in 0..self.inputs.len().min(KEPT_INPUTS) {
            if let Err(problem) = self.with_lines(number, |_| Ok(())) {
                self.warn(problem);
            }
        }
        // So are the tables of its sensor. A shot without echoes has no fit, but they are made.
        let first = self.points().in_tree().first().map(|point| (usize::from(point.input), point.shot));
        if let Some((input, shot)) = first {
            prepare(self, input, shot);
        }
        lock(&self.state).0 = state;
    }

    /// Why there are no points.
    fn without_points(&self) -> String {
        if self.opened.without_waveforms.is_some() {
            return "the file has no points".into();
        }
        let gives_points = |stage: &JobStage| stage.spec.gives(Some(Kind::Returns)) == Some(Kind::Points);
        let has = |name: &str| self.opened.job.stages.iter().any(|stage| stage.spec.name == name);
        match self.opened.job.stages.iter().any(gives_points) {
            true if has("decompose") => {
                "no returns: lower `detection_sigma` of `decompose`, or see the warnings".into()
            }
            true => "no points: see the warnings".into(),
            false => format!("{}: the job has no stage `georeference`; add one", self.opened.job.name),
        }
    }

    fn read_all(self: &Arc<Session>) -> Result<(), String> {
        let mut job = self.opened.job.clone();
        job.stages.retain(|stage| !matches!(stage.planned.plan, Plan::Sink(_)));
        let mut options = Options::of_job(&job, &self.opened.input_dir, ".");
        options.cancel = self.cancel.clone();
        options.watch = Some(self.watch.clone());
        let survey = engine::survey_models(&job, &options).map_err(|error| error.to_string())?;
        options.survey = survey.map(Arc::new);
        for number in 0..self.inputs.len() {
            let input = self.inputs[number].input.clone();
            let session = Arc::clone(self);
            let look = move |(): &mut (), line: &ScanLine| {
                session.add(number, line);
                ControlFlow::Continue(())
            };
            let observed = engine::observe_all(&job, input, &options, Context::of_run(), (), look);
            let ((), summary) = observed.map_err(|error| error.to_string())?;
            summary.stages.iter().flat_map(|stage| stage.warnings()).for_each(|warning| self.warn(warning));
            if self.cancel.is_cancelled() {
                return Err("interrupted".into());
            }
            self.read.fetch_add(1, Ordering::Relaxed);
        }
        Ok(())
    }

    /// Reads files of points without waveforms.
    fn read_points(&self) -> Result<(), String> {
        for viewed in &self.inputs {
            let mut file = PointFile::open(&viewed.input.path).map_err(|error| error.to_string())?;
            let (input, count) = (file.input(), file.count().max(1));
            input.crs_problems.iter().for_each(|problem| self.warn(problem.clone()));
            let (mut number, mut is_whole) = (0, false);
            while !is_whole {
                let mut together = Vec::with_capacity(POINTS_AT_ONCE);
                while together.len() < POINTS_AT_ONCE && !is_whole {
                    match file.next().map_err(|error| error.to_string())? {
                        Some(FilePoint { found, position, strip }) => {
                            let relative_m = self.placing_at(&input, position).relative(position);
                            together.push(ViewPoint::of(&found, number, strip, relative_m));
                            number += 1;
                        }
                        None => is_whole = true,
                    }
                }
                self.add_points(together);
                self.watch.set(Some(number as f64 / count as f64), number);
                if self.cancel.is_cancelled() {
                    return Err("interrupted".into());
                }
            }
            viewed.shots.fetch_add(number, Ordering::Relaxed);
            self.read.fetch_add(1, Ordering::Relaxed);
        }
        Ok(())
    }

    /// Adds the points of a line.
    fn add(&self, number: usize, line: &ScanLine) {
        let viewed = &self.inputs[number];
        viewed.shots.fetch_add(line.emissions.len() as u64, Ordering::Relaxed);
        lock(&viewed.learnt).get_or_insert_with(|| Learnt::of(line));
        let Content::Points(returns, positions) = &line.content else { return };
        let Some(first) = positions.iter().find(|point| point.iter().all(|value| value.is_finite())) else {
            return;
        };
        let placing = self.placing_at(&line.input, *first);
        self.add_points(returns.iter().zip(positions).filter_map(|(found, position)| {
            let shot = line.emissions.get(found.emission as usize)?.shot;
            Some(ViewPoint::of(found, shot, number as u16, placing.relative(*position)))
        }));
    }

    /// How points are placed; by this input and point if they are the first.
    fn placing_at(&self, input: &InputInfo, point: [f64; 3]) -> Placing {
        self.placing().unwrap_or_else(|| {
            let placing = Placing::new(input, point);
            *self.placing.write().unwrap_or_else(PoisonError::into_inner) = Some(placing.clone());
            placing
        })
    }

    /// Adds points with a place, and builds a new tree if there are many more.
    fn add_points(&self, new: impl IntoIterator<Item = ViewPoint>) {
        let mut points = self.points.write().unwrap_or_else(PoisonError::into_inner);
        for point in new {
            if point.position_m.iter().all(|value| value.is_finite()) {
                points.add(point);
            }
        }
        if points.has_outgrown_its_tree() {
            points.build();
        }
    }

    fn build(&self) {
        self.points.write().unwrap_or_else(PoisonError::into_inner).build();
    }

    pub(super) fn points(&self) -> RwLockReadGuard<'_, ViewPoints> {
        self.points.read().unwrap_or_else(PoisonError::into_inner)
    }

    /// Description of the points of a generation, made by `describe` once.
    pub(super) fn described(&self, generation: u32, describe: impl FnOnce() -> Value) -> Value {
        let mut described = lock(&self.described);
        if described.0 != generation {
            *described = (generation, describe());
        }
        described.1.clone()
    }

    pub(super) fn placing(&self) -> Option<Placing> {
        self.placing.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Adds a warning for the page, once.
    fn warn(&self, warning: String) {
        let warnings = &mut lock(&self.state).1;
        if !warnings.contains(&warning) {
            warnings.push(warning);
        }
    }

    /// State and warnings.
    pub(super) fn state(&self) -> (SessionState, Vec<String>) {
        lock(&self.state).clone()
    }

    /// Part of all inputs that has been read, 0 to 1.
    pub(super) fn progress(&self) -> f64 {
        let read = self.read.load(Ordering::Relaxed) as f64;
        let all = self.inputs.len().max(1) as f64;
        let part = if read < all { self.watch.get().0 } else { 0.0 };
        ((read + part) / all).min(1.0)
    }

    /// The job by which lines are processed again.
    ///
    /// # Errors
    /// As [`Session::with`].
    pub(super) fn job(&self) -> Result<Job, String> {
        match measures_footprints(&self.opened.job) {
            Ok(Some(_)) => Ok(self.opened.job.clone()),
            _ => self.with(&[]).map(|chosen| chosen.job.clone()),
        }
    }

    /// The job with other keys of `decompose`.
    ///
    /// # Errors
    /// If a key is of another stage or invalid, or the job has no stage `decompose`.
    pub(super) fn with(&self, set: &[String]) -> Result<Arc<Chosen>, String> {
        if let Some(foreign) = set.iter().find(|text| !text.starts_with("decompose.")) {
            return Err(format!("{foreign}: only keys of `decompose` can be changed here"));
        }
        let mut kept = lock(&self.chosen);
        if let Some(known) = kept.iter().find(|chosen| chosen.set == set) {
            return Ok(Arc::clone(known));
        }
        let mut job = match set {
            [] => self.opened.job.clone(),
            _ => (self.opened.with)(set).map_err(|errors| messages(&errors))?,
        };
        let stage = job.stages.iter_mut().find(|stage| stage.spec.name == "decompose");
        let stage = stage.ok_or("the job has no stage `decompose`; add one")?;
        let decompose: Decompose = serde_json::from_value(stage.planned.resolved.clone())
            .map_err(|error| format!("`decompose`: {error}; please report this bug in wavex"))?;
        let decompose = match kept.front() {
            Some(other) => decompose.sharing_tables(&other.decompose),
            None => decompose,
        };
        stage.planned.plan = Plan::Map(Arc::new(decompose.clone()));
        let chosen = Arc::new(Chosen { set: set.to_owned(), job, decompose });
        kept.push_front(Arc::clone(&chosen));
        kept.truncate(KEPT_JOBS);
        Ok(chosen)
    }

    /// Calls `body` with the lines of an input, which are opened on first use.
    ///
    /// # Errors
    /// If the recording cannot be read in any order, or nothing has been read of it yet.
    pub(super) fn with_lines<T>(
        &self,
        number: usize,
        body: impl FnOnce(&mut InputLines) -> Result<T, String>,
    ) -> Result<T, String> {
        let viewed = self.inputs.get(number).ok_or("the view has no such input; reload the page")?;
        let slot = self.slot(number);
        let mut lines = lock(&slot);
        if lines.is_none() {
            let Some(learnt) = lock(&viewed.learnt).clone() else {
                return Err(format!("{}: not yet read; wait", viewed.input.stem));
            };
            let is_placed =
                || engine::is_placed(&self.opened.job, &viewed.input.path, &self.opened.input_dir);
            let geometry = lock(&self.loader).load(&viewed.input.stem, is_placed);
            let geometry = geometry.map_err(|error| error.to_string())?;
            let run = RunContext {
                stem: viewed.input.stem.clone(),
                input_dir: self.opened.input_dir.clone(),
                simd: self.opened.job.settings.simd.path(),
                cancelled: self.cancel.flag(),
                geometry: Arc::new(geometry),
                survey: Some(Arc::new(learnt.models(&viewed.input.stem))),
                has_outputs: false,
                ..RunContext::alone(&viewed.input.path)
            };
            // The tables of `decompose` are shared with the answers.
            let base = self.with(&[]);
            let job = base.map_or_else(|_| self.opened.job.clone(), |chosen| chosen.job.clone());
            *lines = Some(InputLines::open(job, run).map_err(|error| error.to_string())?);
        }
        match lines.as_mut() {
            Some(lines) => body(lines),
            None => Err("the recording is not open".into()),
        }
    }

    /// Place of the lines of an input; the input that was used longest ago is closed.
    fn slot(&self, number: usize) -> OpenLines {
        let mut open = lock(&self.open);
        let known = open.iter().position(|(of, _)| *of == number).and_then(|at| open.remove(at));
        let (number, lines) = known.unwrap_or_else(|| (number, OpenLines::default()));
        open.push_front((number, Arc::clone(&lines)));
        open.truncate(KEPT_INPUTS);
        lines
    }
}
