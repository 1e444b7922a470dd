//! Patches of all strips, from the chain of a job.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use super::jobs::JobPlace;
use super::patch_files::{find, of_jobs};
use crate::Failure;
use wavex_align::adjust::AlignSettings;
use wavex_align::patch::{Horizon, Patch, PatchBudget, PatchCounts, PatchSettings};
use wavex_align::scanner::Scanner;
use wavex_engine::engine::{self, Cause, Convert, Input, Next, Options, RunError};
use wavex_engine::job::Job;
use wavex_geodesy::time_axis::Clock;
use wavex_geodesy::trajectory::Trajectory;
use wavex_line::georef::{Geometry, Loader};
use wavex_line::scan_line::ScanLine;
use wavex_line::stage::{Plan, Result};
use wavex_stages::writers::write_patches::{PatchesFile, StripMaker};

/// Interval at which an interruption is looked for.
const TICK: Duration = Duration::from_millis(500);

/// A strip of the survey.
pub(super) struct SurveyStrip {
    /// Stem of the recording.
    pub(super) stem: String,
    /// Stem, after the name of the job if there are several.
    pub(super) name: String,
    /// Index of its job.
    pub(super) installation: usize,
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
    /// Files of trajectories with their jobs: keys of a job change what a file means.
    trajectory_jobs: Vec<usize>,
    /// Start values of each job.
    pub(super) scanners: Vec<Scanner>,
}

/// Patches of all inputs of the jobs: from files, or by their chains without their sinks.
///
/// # Errors
/// Inputs that cannot be found, files of the geometry that cannot be read, an interruption, fewer than two usable strips, a
/// job without usable strips.
pub(super) fn collect(
    places: &[JobPlace<'_>],
    settings: &AlignSettings,
    files: &[PathBuf],
) -> std::result::Result<SurveyStrips, Failure> {
    let mut survey = SurveyStrips {
        strips: Vec::new(),
        failures: Vec::new(),
        trajectories: Vec::new(),
        trajectory_files: Vec::new(),
        patches: Vec::new(),
        horizon: None,
        trajectory_jobs: Vec::new(),
        scanners: Vec::new(),
    };
    let mut budget = PatchBudget::default();
    let files = of_jobs(places, files, settings.cell_m)?;
    for (place, files) in places.iter().zip(files) {
        survey.take_job(place, settings, files.as_deref(), &mut budget)?;
    }
    survey.keep(budget);
    if survey.strips.len() < 2 {
        return Err(too_few(&survey));
    }
    for (installation, place) in places.iter().enumerate() {
        if !survey.strips.iter().any(|strip| strip.installation == installation) {
            return Err(Failure::Run(format!(
                "{}: no strip can be used; correct the problems, or leave the job out:{}",
                place.job.name,
                problems(&survey)
            )));
        }
    }
    Ok(survey)
}

/// Error if fewer than two strips are usable.
fn too_few(survey: &SurveyStrips) -> Failure {
    let usable = match survey.strips.first() {
        Some(only) => format!("only `{}` can be used", only.name),
        None => "no strip can be used".to_owned(),
    };
    let problems = problems(survey);
    Failure::Run(format!(
        "alignment needs two strips, but {usable}; correct the problems of the others:{problems}"
    ))
}

fn problems(survey: &SurveyStrips) -> String {
    survey.failures.iter().map(|failed| format!("\n  {}", failed.problem)).collect()
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

impl ReadStrip {
    /// The strip of these patches.
    ///
    /// # Errors
    /// Without patches.
    fn new(
        patches: PatchesFile,
        recording: &Path,
        geometry: Arc<Geometry>,
    ) -> std::result::Result<ReadStrip, Failed> {
        let PatchesFile { stem, clock, span_s, n_shots, counts, patches, .. } = patches;
        if patches.is_empty() {
            return Err(Failed::Strip(format!(
                "{stem}: no smooth surface: of its cells, {} have too few returns, {} have several returns per shot, {} are \
                 rough; alignment needs ground or roofs with at least one return per m²",
                counts.sparse, counts.multiple, counts.rough
            )));
        }
        let (path, n_patches) = (recording.to_owned(), patches.len());
        let name = stem.clone();
        let strip = SurveyStrip {
            stem,
            name,
            installation: 0,
            path,
            trajectory: 0,
            clock,
            span_s,
            n_shots,
            n_patches,
            counts,
        };
        Ok(ReadStrip { strip, patches, geometry })
    }
}

impl SurveyStrips {
    /// Area of the patches of the largest strip, m².
    pub(super) fn largest_m2(&self, cell_m: f64) -> f64 {
        let cells = self.strips.iter().map(|strip| strip.n_patches as u64 + strip.counts.thinned).max();
        cells.unwrap_or(0) as f64 * cell_m * cell_m
    }

    /// Adds the strips of a job; `files`: its files of patches.
    fn take_job(
        &mut self,
        place: &JobPlace<'_>,
        settings: &AlignSettings,
        files: Option<&[PathBuf]>,
        budget: &mut PatchBudget,
    ) -> std::result::Result<(), Failure> {
        let failed = |error: &dyn std::fmt::Display| Failure::Run(error.to_string());
        let (options, mut job) = (&place.options, place.job.clone());
        let inputs = engine::inputs(&job, place.input_dir());
        job.stages.retain(|stage| !matches!(stage.planned.plan, Plan::Sink(_)));
        job.settings.geometry.corrections = None;
        let mut loader =
            Loader::new(&job.settings.geometry, place.input_dir()).map_err(|error| failed(&error))?;
        let body_from_mount = job.settings.geometry.mount.unwrap_or_default().body_from_scanner();
        self.scanners.push(Scanner { body_from_mount, calibration: Default::default() });
        let Some(files) = files else {
            let inputs = inputs.map_err(|error| failed(&error))?;
            if let ([only], None) = (inputs.as_slice(), &place.name) {
                return Err(Failure::Wrong(format!(
                    "{}: the job has one input, `{}`, and alignment compares strips; give the reader a pattern such as \
                     `path = \"*.las\"`",
                    job.name, only.stem
                )));
            }
            let survey_models = engine::survey_models(&job, options).map_err(|error| failed(&error))?;
            let options = Options { survey: survey_models.map(Arc::new), ..options.clone() };
            let patches = PatchSettings { cell_m: settings.cell_m, ..PatchSettings::default() };
            for input in inputs {
                let name = input.stem.clone();
                self.take(place, name, strip_of(&job, input, &options, &mut loader, patches), budget)?;
            }
            return Ok(());
        };
        // Recordings need not be there, but they give the order of the strips.
        let mut used = BTreeMap::new();
        for found in find(files, &inputs.unwrap_or_default())? {
            let name = found.name.clone();
            let opened = found.open(&mut used, &mut loader, settings.cell_m).map_err(Failed::Strip);
            let read = opened.and_then(|(patches, path, geometry)| ReadStrip::new(patches, &path, geometry));
            self.take(place, name, read, budget)?;
        }
        Ok(())
    }

    /// Adds a strip, or its failure.
    fn take(
        &mut self,
        place: &JobPlace<'_>,
        name: String,
        read: std::result::Result<ReadStrip, Failed>,
        budget: &mut PatchBudget,
    ) -> std::result::Result<(), Failure> {
        match read {
            Ok(read) => self.add(place, read, budget),
            Err(Failed::Strip(problem)) => {
                let problem = match &place.name {
                    Some(_) => format!("{}: {problem}", place.job.name),
                    None => problem,
                };
                self.failures.push(FailedStrip { name: place.label(&name), problem });
            }
            Err(Failed::All(failure)) => return Err(failure),
        }
        Ok(())
    }

    /// Takes the patches that the limit keeps.
    fn keep(&mut self, budget: PatchBudget) {
        let (patches, counts) = budget.finish();
        for (strip, n_patches) in self.strips.iter_mut().zip(counts) {
            strip.counts.thinned += (strip.n_patches - n_patches) as u64;
            strip.n_patches = n_patches;
        }
        self.patches = patches;
    }

    fn add(&mut self, place: &JobPlace<'_>, read: ReadStrip, budget: &mut PatchBudget) {
        let ReadStrip { mut strip, patches, geometry } = read;
        let Some((file, trajectory)) = geometry.trajectory() else { return };
        strip.name = place.label(&strip.stem);
        strip.installation = self.scanners.len().saturating_sub(1);
        let mut known = self.trajectory_files.iter().zip(&self.trajectory_jobs);
        let known = known.position(|(known, job)| known == file && *job == strip.installation);
        strip.trajectory = match known {
            Some(known) => known,
            None => {
                self.trajectory_files.push(file.to_owned());
                self.trajectory_jobs.push(strip.installation);
                self.trajectories.push(trajectory.clone());
                self.trajectories.len() - 1
            }
        };
        if let Some(scanner) = self.scanners.last_mut() {
            *scanner = start(scanner, &geometry);
        }
        if self.horizon.is_none() {
            let first = trajectory.samples().iter().find(|sample| sample.time_s >= strip.span_s[0]);
            self.horizon = first.map(|sample| Horizon::at(sample.place));
        }
        budget.add(patches);
        self.strips.push(strip);
    }
}

/// Reads a strip.
fn strip_of(
    job: &Job,
    input: Input,
    options: &Options,
    loader: &mut Loader,
    patches: PatchSettings,
) -> std::result::Result<ReadStrip, Failed> {
    let (name, path) = (input.stem.clone(), input.path.clone());
    let of_strip = |problem: &dyn std::fmt::Display| Failed::Strip(format!("{name}: {problem}"));
    let geometry = loader.load(&input.stem, || false).map_err(|error| of_strip(&error))?;
    let geometry = Arc::new(geometry);
    let start = StripMaker::new(Arc::clone(&geometry), patches);
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
    let Some(strip) = made.and_then(StripMaker::finish) else {
        return Err(of_strip(&"no shot has a pose; check the trajectory"));
    };
    ReadStrip::new(PatchesFile::new(name, &path, strip), &path, geometry)
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
