//! Patches of all strips, from the chain of a job.

use std::path::PathBuf;
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use crate::Failure;
use wavex_align::adjust::AlignSettings;
use wavex_align::patch::{Horizon, Patch, PatchCounts, PatchMaker, PatchReturn, PatchSettings};
use wavex_align::scanner::{BeamSource, Scanner, ScannerBeam};
use wavex_engine::engine::{self, Cause, Convert, Input, Next, Options, RunError};
use wavex_engine::job::Job;
use wavex_geodesy::ellipsoid::WGS84;
use wavex_geodesy::frames::{Rotation, Vector, inverse, rotate};
use wavex_geodesy::time_axis::Clock;
use wavex_geodesy::trajectory::Trajectory;
use wavex_line::georef::calibration::is_on_low_power_scale;
use wavex_line::georef::{Geometry, Loader};
use wavex_line::scan_line::{Content, ScanLine};
use wavex_line::stage::{Plan, Result, StageError};

/// Interval at which an interruption is looked for.
const TICK: Duration = Duration::from_millis(500);

/// A strip of the survey.
pub(super) struct SurveyStrip {
    /// Stem of the recording.
    pub(super) name: String,
    /// The recording.
    pub(super) path: PathBuf,
    /// Index of its trajectory.
    pub(super) trajectory: usize,
    /// Time scale of its trajectory.
    pub(super) clock: Clock,
    /// First and last shot, s on the axis of the trajectory.
    pub(super) span_s: [f64; 2],
    /// Number of shots with a pose.
    pub(super) n_shots: u64,
    /// Number of its patches.
    pub(super) n_patches: usize,
    /// Cells without a patch.
    pub(super) counts: PatchCounts,
}

/// An input that could not be used.
pub(super) struct FailedStrip {
    pub(super) name: String,
    /// Problem and remedy, with the name of the input.
    pub(super) problem: String,
}

/// Strips of a survey with their patches.
pub(super) struct SurveyStrips {
    pub(super) strips: Vec<SurveyStrip>,
    pub(super) failures: Vec<FailedStrip>,
    pub(super) trajectories: Vec<Trajectory>,
    pub(super) trajectory_files: Vec<PathBuf>,
    pub(super) patches: Vec<Patch>,
    /// `None` if no shot has a pose.
    pub(super) horizon: Option<Horizon>,
    /// Start values.
    pub(super) scanner: Scanner,
}

/// Runs the chain of a job over all its inputs, without its sinks.
///
/// # Errors
/// Inputs that cannot be found, files of the geometry that cannot be read, an interruption, fewer than two usable strips.
pub(super) fn collect(
    job: &Job,
    options: &Options,
    settings: &AlignSettings,
) -> std::result::Result<SurveyStrips, Failure> {
    let failed = |error: &dyn std::fmt::Display| Failure::Run(error.to_string());
    let inputs = engine::inputs(job, &options.input_dir).map_err(|error| failed(&error))?;
    if let [only] = inputs.as_slice() {
        return Err(Failure::Wrong(format!(
            "{}: the job has one input, `{}`, and alignment compares strips; give the reader a pattern such as \
             `path = \"*.las\"`",
            job.name, only.stem
        )));
    }
    let mut job = job.clone();
    job.stages.retain(|stage| !matches!(stage.planned.plan, Plan::Sink(_)));
    job.settings.geometry.corrections = None;
    let mut loader =
        Loader::new(&job.settings.geometry, &options.input_dir).map_err(|error| failed(&error))?;
    // Beams keep the axes of the scanner, and ranges are as measured.
    job.settings.geometry.calibration = None;
    let survey_models = engine::survey_models(&job, options).map_err(|error| failed(&error))?;
    let options = Options { survey: survey_models.map(Arc::new), ..options.clone() };
    let body_from_mount = job.settings.geometry.mount.unwrap_or_default().body_from_scanner();
    let horizon = Arc::new(OnceLock::new());
    let mut survey = SurveyStrips {
        strips: Vec::new(),
        failures: Vec::new(),
        trajectories: Vec::new(),
        trajectory_files: Vec::new(),
        patches: Vec::new(),
        horizon: None,
        scanner: Scanner { body_from_mount, calibration: Default::default() },
    };
    for input in inputs {
        let name = input.stem.clone();
        let index = survey.strips.len();
        let read = strip_of(&job, input, &options, &mut loader, |geometry| {
            let scanner = start(&survey.scanner, &geometry);
            let patches = PatchSettings { cell_m: settings.cell_m, ..PatchSettings::default() };
            let scanner_from_body = inverse(&scanner.body_from_mount);
            let horizon = Arc::clone(&horizon);
            StripMaker { index, geometry, scanner, scanner_from_body, patches, horizon, found: None }
        });
        match read {
            Ok(read) => survey.add(read),
            Err(Failed::Strip(problem)) => survey.failures.push(FailedStrip { name, problem }),
            Err(Failed::All(failure)) => return Err(failure),
        }
    }
    survey.horizon = horizon.get().copied();
    match survey.strips.len() {
        0 | 1 => Err(too_few(&survey)),
        _ => Ok(survey),
    }
}

/// Error if fewer than two strips are usable.
fn too_few(survey: &SurveyStrips) -> Failure {
    let usable = match survey.strips.first() {
        Some(only) => format!("only `{}` can be used", only.name),
        None => "no strip can be used".to_owned(),
    };
    let problems: String = survey.failures.iter().map(|failed| format!("\n  {}", failed.problem)).collect();
    Failure::Run(format!(
        "alignment needs two strips, but {usable}; correct the problems of the others:{problems}"
    ))
}

/// Scanner with the calibration of the job.
fn start(scanner: &Scanner, geometry: &Geometry) -> Scanner {
    Scanner { calibration: *geometry.installation().calibration(), ..*scanner }
}

/// Scope of a failure.
enum Failed {
    Strip(String),
    All(Failure),
}

/// A strip with its patches.
struct ReadStrip {
    strip: SurveyStrip,
    patches: Vec<Patch>,
    geometry: Arc<Geometry>,
}

impl SurveyStrips {
    fn add(&mut self, read: ReadStrip) {
        let ReadStrip { mut strip, patches, geometry } = read;
        let Some((file, trajectory)) = geometry.trajectory() else { return };
        strip.trajectory = match self.trajectory_files.iter().position(|known| known == file) {
            Some(known) => known,
            None => {
                self.trajectory_files.push(file.to_owned());
                self.trajectories.push(trajectory.clone());
                self.trajectories.len() - 1
            }
        };
        self.scanner = start(&self.scanner, &geometry);
        self.patches.extend(patches);
        self.strips.push(strip);
    }
}

/// Reads a strip.
fn strip_of(
    job: &Job,
    input: Input,
    options: &Options,
    loader: &mut Loader,
    maker: impl FnOnce(Arc<Geometry>) -> StripMaker,
) -> std::result::Result<ReadStrip, Failed> {
    let (name, path) = (input.stem.clone(), input.path.clone());
    let of_strip = |problem: &dyn std::fmt::Display| Failed::Strip(format!("{name}: {problem}"));
    let geometry = loader.load(&input.stem, || false).map_err(|error| of_strip(&error))?;
    let geometry = Arc::new(geometry);
    let start = maker(Arc::clone(&geometry));
    let failed = |error: RunError| match &error.cause {
        Cause::Stage(_) if !options.cancel.is_cancelled() => Failed::Strip(error.to_string()),
        _ => Failed::All(Failure::Run(error.to_string())),
    };
    let mut made = None;
    let mut stream = engine::stream(job, input, options, 1, InOrder(Some(start))).map_err(failed)?;
    loop {
        match stream.next_within(TICK).map_err(failed)? {
            Next::Item(maker) => made = Some(maker),
            Next::Waiting => {}
            Next::End => break,
        }
    }
    if options.cancel.is_cancelled() {
        let interrupted = RunError { stage: None, input: None, cause: Cause::Interrupted };
        return Err(Failed::All(Failure::Run(interrupted.to_string())));
    }
    let Some(found) = made.and_then(|made| made.found) else {
        return Err(of_strip(&"no shot has a pose; check the trajectory"));
    };
    let (patches, counts) = found.maker.finish();
    if patches.is_empty() {
        return Err(of_strip(&format!(
            "no smooth surface: of its cells, {} have too few returns, {} have several returns per shot, {} are rough; \
                 alignment needs ground or roofs with at least one return per m²",
            counts.sparse, counts.multiple, counts.rough
        )));
    }
    let strip = SurveyStrip {
        name,
        path,
        trajectory: 0,
        clock: found.clock,
        span_s: found.span_s,
        n_shots: found.n_shots,
        n_patches: patches.len(),
        counts,
    };
    Ok(ReadStrip { strip, patches, geometry })
}

/// Makes patches from the lines of a strip.
struct StripMaker {
    index: usize,
    geometry: Arc<Geometry>,
    /// Start values, which place the cells.
    scanner: Scanner,
    scanner_from_body: Rotation,
    patches: PatchSettings,
    /// Horizon of the survey, at its first shot.
    horizon: Arc<OnceLock<Horizon>>,
    found: Option<Found>,
}

/// Receives the lines of a strip in their order, which patches depend on.
struct InOrder(Option<StripMaker>);

impl Convert for InOrder {
    type Item = StripMaker;

    fn line(&mut self, line: &ScanLine) -> Result<Option<StripMaker>> {
        self.0.as_mut().map_or(Ok(()), |maker| maker.add(line)).map(|()| None)
    }

    fn finish(&mut self) -> Result<Option<StripMaker>> {
        Ok(self.0.take())
    }
}

/// Content of a strip so far.
struct Found {
    maker: PatchMaker,
    clock: Clock,
    span_s: [f64; 2],
    n_shots: u64,
}

impl StripMaker {
    fn add(&mut self, line: &ScanLine) -> Result<()> {
        let (Some(first), Some((_, trajectory))) = (line.emissions.first(), self.geometry.trajectory())
        else {
            return Ok(());
        };
        let Some(alignment) = line.input.first_shot.and_then(|shot| shot.alignment) else {
            return Err(StageError::failed(
                "the recording is already georeferenced: its beams are not in the frame of the scanner",
                "give the recording of the instrument",
            ));
        };
        let mut poses = trajectory.poses();
        let first_s = alignment.on_trajectory(first.gps_time_s);
        if self.found.is_none() {
            let Some(pose) = poses.at(first_s) else { return Ok(()) };
            let horizon = self.horizon.get_or_init(|| Horizon::at(WGS84.geodetic_of(pose.origin_in_ecef_m)));
            let index = u32::try_from(self.index).unwrap_or(u32::MAX);
            self.found = Some(Found {
                maker: PatchMaker::new(index, *horizon, self.patches),
                clock: alignment.trajectory.clock,
                span_s: [first_s; 2],
                n_shots: 0,
            });
        }
        let Some(found) = &mut self.found else { return Ok(()) };
        for emission in &line.emissions {
            let time_s = alignment.on_trajectory(emission.gps_time_s);
            found.span_s = [found.span_s[0].min(time_s), found.span_s[1].max(time_s)];
        }
        found.n_shots += line.emissions.len() as u64;
        let Content::Points(returns, _) = &line.content else { return Ok(()) };
        for given in returns.iter().filter(|given| !given.withheld) {
            let Some(emission) = line.emissions.get(given.emission as usize) else { continue };
            let time_s = alignment.on_trajectory(emission.gps_time_s);
            let Some(pose) = poses.at(time_s) else { continue };
            let from_nav_m: Vector = std::array::from_fn(|axis| {
                emission.origin_m[axis] + given.range_m * emission.direction[axis]
                    - pose.origin_in_ecef_m[axis]
            });
            // Counted from the origin of the scanner, whatever the recording counts from.
            let in_body_m = rotate(&inverse(&pose.ecef_from_body), from_nav_m);
            let Some((direction, range_m)) = split(rotate(&self.scanner_from_body, in_body_m)) else {
                continue;
            };
            let beam = ScannerBeam { time_s, direction, range_m };
            let on_low_power_scale = is_on_low_power_scale(given.channel, line.fusion.is_some());
            let source = BeamSource { origin_m: [0.0; 3], on_low_power_scale };
            let Some(point_in_ecef_m) = self.scanner.locate(&source, &beam, &mut poses, None) else {
                continue;
            };
            let from_nav_m = std::array::from_fn(|axis| point_in_ecef_m[axis] - pose.origin_in_ecef_m[axis]);
            let Some((direction_in_ecef, _)) = split(from_nav_m) else { continue };
            found.maker.add(&PatchReturn {
                beam,
                source,
                range_sd_m: given.range_sd_m,
                n_returns: given.number_of_returns,
                point_in_ecef_m,
                direction_in_ecef,
            });
        }
        Ok(())
    }
}

/// Direction and length of a vector; `None` for zero.
fn split(vector: Vector) -> Option<(Vector, f64)> {
    let length = vector.iter().map(|part| part * part).sum::<f64>().sqrt();
    (length > 0.0).then(|| (vector.map(|part| part / length), length))
}
