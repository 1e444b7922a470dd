//! Alignment of a survey's strips: calibration and corrections of trajectories from their overlaps.

use std::io::Write;
use std::path::{Path, PathBuf};

use rayon::ThreadPoolBuilder;

use crate::Failure;
use crate::run::folders;
use strips::{SurveyStrips, collect};
use wavex_align::adjust::{AlignSettings, Constraints, align_with as adjust};
use wavex_align::estimable::Verdict;
use wavex_align::matching::tile_m;
use wavex_align::observation::Observation;
use wavex_align::parameters::{Global, GlobalPriors};
use wavex_align::result::Alignment;
use wavex_align::survey::{Installation, Strip, Survey};
use wavex_engine::engine::{self, Cancel, Options, ProgressMode};
use wavex_engine::job::Job;
use wavex_formats::Error;
use wavex_geodesy::crs::Unit;
use wavex_line::georef::corrections::{CorrectionsFile, StripCorrections};
use wavex_line::georef::keys::{CalibrationKey, UnitKey};
use wavex_line::stage::{FinishedFile, OutputFile};
use wavex_pages::report::align::{AlignReport, page, write_residuals};

pub use wavex_align::parameters::TrajectoryModel;

pub mod clouds;
mod control;
mod patch_files;
mod report;
mod strips;
mod words;

/// Name of the calibration that an alignment writes.
pub const CALIBRATION_FILE: &str = "calibration.toml";
/// Name of the corrections of trajectories that an alignment writes.
pub const CORRECTIONS_FILE: &str = "corrections.toml";
/// Name of the report of an alignment.
pub const REPORT_FILE: &str = "align.json";
/// Name of the page of an alignment.
pub const PAGE_FILE: &str = "align.html";
/// Name of the differences of all pairs of patches.
pub const RESIDUALS_FILE: &str = "residuals.arrow";

/// SD of the range offset of the low-power receiver if both receivers have patches, m.
const RECEIVER_OFFSET_SD_M: f64 = 0.05;

/// Survey to align.
#[derive(Clone, Debug)]
pub struct AlignRequest<'a> {
    /// The job; its sinks are not run.
    pub job: &'a Job,
    /// Folder of the job file.
    pub folder: &'a Path,
    /// Folder to write.
    pub output: &'a Path,
    /// Form of the corrections of trajectories.
    pub trajectory: TrajectoryModel,
    /// Control points, reference strips, and parameters to estimate.
    pub constraints: AlignConstraints,
    /// Files of `write_patches`, or folders with them; empty: the recordings are read.
    pub patches: &'a [PathBuf],
    /// Progress display.
    pub progress: ProgressMode,
    /// Ends the alignment early when set.
    pub cancel: Cancel,
}

/// What is known or asked besides the job.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AlignConstraints {
    /// File of control points.
    pub control: Option<PathBuf>,
    /// Coordinate reference system of the control points; that of the job if not given.
    pub control_crs: Option<String>,
    /// Names of strips whose trajectories are not corrected.
    pub references: Vec<String>,
    /// Parameters to estimate that are otherwise given.
    pub estimate: Vec<OptionalParameter>,
}

/// Parameter that is estimated only if asked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OptionalParameter {
    /// Range scale.
    E1,
    /// Scan angle scale.
    E2,
    /// Quadratic scan angle correction.
    E3,
    /// Cubic scan angle correction.
    E4,
}

impl OptionalParameter {
    /// The parameter of this name in a calibration.
    pub fn of_name(name: &str) -> Option<OptionalParameter> {
        match name {
            "e1" => Some(OptionalParameter::E1),
            "e2" => Some(OptionalParameter::E2),
            "e3" => Some(OptionalParameter::E3),
            "e4" => Some(OptionalParameter::E4),
            _ => None,
        }
    }

    /// Its name in a calibration.
    pub fn name(self) -> &'static str {
        match self {
            OptionalParameter::E1 => "e1",
            OptionalParameter::E2 => "e2",
            OptionalParameter::E3 => "e3",
            OptionalParameter::E4 => "e4",
        }
    }

    /// The parameter, and the SD of its start value: 0.1 m per km, 30 mdeg at half a radian.
    fn prior(self) -> (Global, f64) {
        match self {
            OptionalParameter::E1 => (Global::E1, 1e-4),
            OptionalParameter::E2 => (Global::E2, 1e-3),
            OptionalParameter::E3 => (Global::E3, 2e-3),
            OptionalParameter::E4 => (Global::E4, 4e-3),
        }
    }
}

/// Completed alignment.
#[derive(Debug)]
pub struct Aligned {
    /// Table for people: parameters, differences of the strips, verdict, next command.
    pub text: String,
    /// Problems of strips that were left out or not aligned, and of a doubtful alignment.
    pub warnings: Vec<String>,
    /// Written files.
    pub written: Vec<PathBuf>,
    /// Keys of the job that use them, as `KEY=VALUE`.
    pub settings: Vec<String>,
    /// Why the alignment is bad; `None` if it is usable.
    pub failure: Option<Failure>,
    /// The report, as written.
    pub report: AlignReport,
    /// Differences of all pairs of patches.
    pub observations: Vec<Observation>,
}

/// Estimates calibration and corrections of trajectories from the overlaps of a job's inputs.
///
/// Writes [`CALIBRATION_FILE`], [`REPORT_FILE`], [`PAGE_FILE`], [`RESIDUALS_FILE`] and, unless trajectories are kept,
/// [`CORRECTIONS_FILE`]; of a bad alignment neither calibration nor corrections. Inputs that cannot be read are left out.
///
/// # Errors
/// A job without trajectory or points, fewer than two strips, strips that do not overlap, files that cannot be written.
pub fn align(request: &AlignRequest<'_>) -> Result<Aligned, Failure> {
    let job = request.job;
    let (input_dir, output_dir) = folders(job, request.folder);
    check(request, &input_dir)?;
    let options = Options {
        progress: request.progress,
        cancel: request.cancel.clone(),
        ..Options::of_job(job, &input_dir, output_dir)
    };
    let settings = AlignSettings { trajectory_model: request.trajectory, ..AlignSettings::default() };
    let control = control::read(&request.constraints, &job.settings.geometry, &input_dir)?;
    check_references(request, &options)?;
    let survey = collect(job, &options, &settings, request.patches)?;
    let settings = AlignSettings { tile_m: tile_m(survey.largest_m2(settings.cell_m)), ..settings };
    let references = references(request, &survey)?;
    let points = control.as_ref().map_or(&[][..], |control| &control.points);
    let constraints = Constraints { control: points, references: &references };
    let result =
        adjusted(&survey, &settings, &constraints, &request.constraints.estimate, options.workers())?;
    let warnings = survey.failures.iter().map(|failed| format!("left out: {}", failed.problem));
    let warnings: Vec<String> = warnings.chain(unconnected(&survey, &result)).collect();
    let replaced = job.settings.geometry.corrections.as_ref().map(|file| {
        format!("{file}: the corrections of the job are not applied; those of this alignment replace them")
    });
    let of_control = control.iter().flat_map(|control| control.warnings(&result));
    let mut warnings: Vec<String> = warnings.into_iter().chain(replaced).chain(of_control).collect();
    let report = report::report(request, &input_dir, &survey, &result, &warnings, control.as_ref());
    let written = write(request, &survey, &result, &report)?;
    let mut text = words::summary(&survey, &result, control.as_ref());
    let problem = words::problem(&result);
    let settings = words::settings(request, &input_dir, &written);
    let failure = if result.verdict == Verdict::Bad {
        problem.map(Failure::Run)
    } else {
        warnings.extend(problem);
        text += &words::next_command(request, &settings);
        None
    };
    Ok(Aligned { text, warnings, written, settings, failure, report, observations: result.observations })
}

/// Checks a request before the strips are read: job, control points, and reference strips.
///
/// # Errors
/// Those of [`align`] that job and options alone show.
pub fn check_early(request: &AlignRequest<'_>) -> Result<(), Failure> {
    let (input_dir, output_dir) = folders(request.job, request.folder);
    check(request, &input_dir)?;
    control::read(&request.constraints, &request.job.settings.geometry, &input_dir)?;
    check_references(request, &Options::of_job(request.job, &input_dir, output_dir))
}

/// Checks what the job alone shows.
fn check(request: &AlignRequest<'_>, input_dir: &Path) -> Result<(), Failure> {
    let AlignRequest { job, output, .. } = request;
    let keys = &job.settings.geometry;
    let wrong = |problem: &str| Err(Failure::Wrong(format!("{}: {problem}", job.name)));
    if !job.stages.iter().any(|stage| stage.spec.name == "georeference") {
        return wrong("the job has no stage `georeference`; add one after `decompose`");
    }
    if keys.trajectory.is_none() {
        return wrong("the job has no trajectory; set `trajectory` in `[job.geometry]`");
    }
    if request.trajectory == TrajectoryModel::None && keys.corrections.is_some() {
        return wrong(
            "`--trajectory none` keeps the trajectory as recorded, but the job corrects it; remove `corrections` from \
             `[job.geometry]`, or choose another `--trajectory`",
        );
    }
    let calibration = match &keys.calibration {
        Some(CalibrationKey::File(file)) => Some(file),
        _ => None,
    };
    for (file, name) in [(calibration, CALIBRATION_FILE), (keys.corrections.as_ref(), CORRECTIONS_FILE)] {
        let Some(file) = file else { continue };
        let (read, written) = (input_dir.join(file).canonicalize(), output.join(name).canonicalize());
        if let (Ok(read), Ok(written)) = (read, written)
            && read == written
        {
            let problem =
                format!("{}: the job reads this file; write to another folder", output.join(name).display());
            return Err(Failure::Wrong(problem));
        }
    }
    Ok(())
}

/// Checks that reference strips are inputs, before they are read.
fn check_references(request: &AlignRequest<'_>, options: &Options) -> Result<(), Failure> {
    let references = &request.constraints.references;
    if references.is_empty() {
        return Ok(());
    }
    if request.trajectory == TrajectoryModel::None {
        let problem = "`--reference` has no effect with `--trajectory none`, which corrects no trajectory; leave one out";
        return Err(Failure::Wrong(format!("{}: {problem}", request.job.name)));
    }
    // Recordings need not be there if their patches are given.
    if !request.patches.is_empty() {
        return Ok(());
    }
    let inputs = engine::inputs(request.job, &options.input_dir);
    let inputs = inputs.map_err(|error| Failure::Run(error.to_string()))?;
    let names: Vec<String> = inputs.into_iter().map(|input| input.stem).collect();
    match references.iter().find(|name| !names.contains(name)) {
        Some(unknown) => {
            Err(Failure::Wrong(unknown_reference(request, unknown, names.iter().map(String::as_str))))
        }
        None => Ok(()),
    }
}

fn unknown_reference<'a>(
    request: &AlignRequest<'_>,
    unknown: &str,
    names: impl Iterator<Item = &'a str>,
) -> String {
    let names: Vec<&str> = names.collect();
    let job = &request.job.name;
    format!("{job}: there is no strip `{unknown}` for `--reference`; the strips are {}", names.join(", "))
}

/// Indices of the reference strips.
fn references(request: &AlignRequest<'_>, survey: &SurveyStrips) -> Result<Vec<usize>, Failure> {
    let index = |name: &String| {
        let found = survey.strips.iter().position(|strip| strip.name == *name);
        let failed = survey.failures.iter().find(|failed| failed.name == *name);
        found.ok_or_else(|| match failed {
            Some(failed) => Failure::Run(format!("the reference strip cannot be used: {}", failed.problem)),
            None => Failure::Wrong(unknown_reference(
                request,
                name,
                survey.strips.iter().map(|strip| &*strip.name),
            )),
        })
    };
    request.constraints.references.iter().map(index).collect()
}

/// Unit of a job's key.
fn unit_of(key: UnitKey) -> Unit {
    match key {
        UnitKey::M => Unit::metre(),
        UnitKey::UsFt => Unit::us_survey_foot(),
        UnitKey::Ft => Unit::foot(),
    }
}

/// Runs the adjustment on this number of threads.
fn adjusted(
    survey: &SurveyStrips,
    settings: &AlignSettings,
    constraints: &Constraints<'_>,
    estimate: &[OptionalParameter],
    threads: usize,
) -> Result<Alignment, Failure> {
    let failed = |problem: String| Failure::Run(problem);
    let Some(horizon) = survey.horizon else {
        return Err(failed("no strip has a pose: check the trajectory".into()));
    };
    let mut priors = GlobalPriors::default();
    let is_low = |low: bool| survey.patches.iter().any(|patch| patch.source.on_low_power_scale == low);
    if is_low(true) && is_low(false) {
        priors.0[Global::E7 as usize] = RECEIVER_OFFSET_SD_M;
    }
    for (parameter, sd) in estimate.iter().map(|parameter| parameter.prior()) {
        priors.0[parameter as usize] = sd;
    }
    let scanner = survey.scanner;
    let strips: Vec<Strip> =
        survey.strips.iter().map(|strip| Strip { trajectory: strip.trajectory, installation: 0 }).collect();
    let given = Survey {
        trajectories: &survey.trajectories,
        installations: &[Installation { scanner, priors }],
        strips: &strips,
        patches: &survey.patches,
        horizon,
    };
    let pool = ThreadPoolBuilder::new().num_threads(threads).build();
    let pool =
        pool.map_err(|error| failed(format!("cannot start threads: {error}; set fewer `--threads`")))?;
    pool.install(|| adjust(&given, settings, constraints)).map_err(|error| failed(error.to_string()))
}

/// Strips that share no surface with others.
fn unconnected<'a>(survey: &'a SurveyStrips, result: &'a Alignment) -> impl Iterator<Item = String> + 'a {
    let pairs = survey.strips.iter().zip(&result.strips);
    pairs.filter(|(_, found)| found.n_pairs == 0).map(|(strip, _)| {
        format!(
            "{}: the strip shares no smooth surface with another one and is not aligned; check its trajectory and area, or \
             remove it from the job",
            strip.name
        )
    })
}

/// Writes the files; returns their paths.
fn write(
    request: &AlignRequest<'_>,
    survey: &SurveyStrips,
    result: &Alignment,
    report: &AlignReport,
) -> Result<Vec<PathBuf>, Failure> {
    let path = |name: &str| request.output.join(name);
    let (calibration, corrections) = (path(CALIBRATION_FILE), path(CORRECTIONS_FILE));
    let Some(scanner) = result.state.scanners.first() else { return Ok(Vec::new()) };
    let mut finished = Vec::new();
    let is_bad = result.verdict == Verdict::Bad;
    if !is_bad {
        let text = words::calibration_text(&scanner.calibration);
        finished.push(self::finished(&calibration, &text)?.replacing([corrections.clone()]));
        if let Some(text) = corrections_text(survey, result)? {
            finished.push(self::finished(&corrections, &text)?);
        }
    }
    let names: Vec<&str> = survey.strips.iter().map(|strip| strip.name.as_str()).collect();
    let residuals = OutputFile::create(&path(RESIDUALS_FILE))
        .and_then(|file| write_residuals(&result.observations, &names, file));
    finished.push(residuals.map_err(|error| Failure::Run(error.to_string()))?);
    finished.push(self::finished(&path(PAGE_FILE), &page(report, &result.observations))?);
    let report = serde_json::to_string_pretty(report).map_err(|error| Failure::Run(error.to_string()))?;
    // Files of an earlier alignment would look like those of this one.
    let stale = if is_bad { vec![calibration, corrections] } else { Vec::new() };
    finished.push(self::finished(&path(REPORT_FILE), &(report + "\n"))?.replacing(stale));
    let published = finished.into_iter().map(FinishedFile::publish);
    published.collect::<Result<_, _>>().map_err(|error| Failure::Run(error.to_string()))
}

pub(crate) fn finished(path: &Path, text: &str) -> Result<FinishedFile, Failure> {
    let failed = |error: Error| Failure::Run(error.to_string());
    let mut file = OutputFile::create(path).map_err(failed)?;
    file.write_all(text.as_bytes()).map_err(|error| failed(Error::io(path, "write")(error)))?;
    file.finish().map_err(failed)
}

/// Text of the corrections of trajectories; `None` without corrections.
fn corrections_text(survey: &SurveyStrips, result: &Alignment) -> Result<Option<String>, Failure> {
    let mut strips = Vec::new();
    for (strip, found) in survey.strips.iter().zip(&result.strips) {
        if let Some(corrections) = found.corrections.as_ref().filter(|_| found.n_pairs > 0) {
            strips.push(StripCorrections::new(&strip.name, strip.span_s, corrections));
        }
    }
    let Some(first) = survey.strips.first().filter(|_| !strips.is_empty()) else { return Ok(None) };
    if let Some(other) = survey.strips.iter().find(|strip| strip.clock != first.clock) {
        return Err(Failure::Run(format!(
            "the trajectories of {} and {} have different time scales, and a correction file has one; convert one of them, or \
             align with `--trajectory none`",
            first.name, other.name
        )));
    }
    let file = CorrectionsFile::new(first.clock.into(), strips);
    file.to_text().map(Some).map_err(|problem| {
        Failure::Run(format!(
            "the corrections are implausible: {problem}; check mount, trajectory and calibration"
        ))
    })
}
