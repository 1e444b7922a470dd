//! Alignment of a survey's strips: calibration and corrections of trajectories from their overlaps.

use std::io::Write;
use std::path::{Path, PathBuf};

use rayon::ThreadPoolBuilder;

use crate::Failure;
use control::Control;
use jobs::JobPlace;
use strips::{SurveyStrips, collect};
use wavex_align::adjust::{AlignSettings, Constraints, align_with as adjust};
use wavex_align::estimable::Verdict;
use wavex_align::matching::tile_m;
use wavex_align::observation::Observation;
use wavex_align::parameters::{Global, GlobalPriors};
use wavex_align::patch::Patch;
use wavex_align::result::Alignment;
use wavex_align::scanner::Scanner;
use wavex_align::survey::{Installation, Strip, Survey};
use wavex_engine::engine::{self, Cancel, ProgressMode};
use wavex_formats::Error;
use wavex_geodesy::crs::Unit;
use wavex_line::georef::corrections::{CorrectionsFile, StripCorrections};
use wavex_line::georef::keys::{CalibrationKey, UnitKey};
use wavex_line::stage::{FinishedFile, OutputFile};
use wavex_pages::report::align::{AlignReport, page, write_residuals};

pub use jobs::AlignJob;
pub use wavex_align::parameters::TrajectoryModel;

pub mod clouds;
mod control;
mod installations;
mod jobs;
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
    /// The jobs, one for each installation of a scanner.
    pub jobs: &'a [AlignJob<'a>],
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
    /// Keys of each job that use them, as `KEY=VALUE`.
    pub settings: Vec<Vec<String>>,
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
/// Of several jobs, calibration and corrections are in a folder with the name of the job, and strips are named `JOB/STRIP`.
///
/// # Errors
/// A job without trajectory or points, jobs that do not fit together, fewer than two strips, strips that do not overlap,
/// files that cannot be written.
pub fn align(request: &AlignRequest<'_>) -> Result<Aligned, Failure> {
    let (places, control) = prepare(request)?;
    let Some(first) = places.first() else { return Err(Failure::Wrong("there is no job to align".into())) };
    let settings = AlignSettings { trajectory_model: request.trajectory, ..AlignSettings::default() };
    let survey = collect(&places, &settings, request.patches)?;
    let settings = AlignSettings { tile_m: tile_m(survey.largest_m2(settings.cell_m)), ..settings };
    let references = references(&places, request, &survey)?;
    let points = control.as_ref().map_or(&[][..], |control| &control.points);
    let constraints = Constraints { control: points, references: &references };
    let result =
        adjusted(&survey, &settings, &constraints, &request.constraints.estimate, first.options.workers())?;
    let result = match installations::misplaced(&survey, &result) {
        Some(_) => Alignment { verdict: result.verdict.max(Verdict::Doubtful), ..result },
        None => result,
    };
    let warnings = survey.failures.iter().map(|failed| format!("left out: {}", failed.problem));
    let warnings: Vec<String> = warnings.chain(unconnected(&survey, &result)).collect();
    let warnings = warnings.into_iter().chain(installations::unconnected_jobs(&places, &survey, &result));
    let replaced = places.iter().filter_map(|place| place.job.settings.geometry.corrections.as_ref());
    let replaced = replaced.map(|file| {
        format!("{file}: the corrections of the job are not applied; those of this alignment replace them")
    });
    let of_control = control.iter().flat_map(|control| control.warnings(&result));
    let mut warnings: Vec<String> = warnings.chain(replaced).chain(of_control).collect();
    let report = report::report(request, &places, &survey, &result, &warnings, control.as_ref());
    let written = write(request, &places, &survey, &result, &report)?;
    let mut text = words::summary(&places, &survey, &result, control.as_ref());
    let problem = words::problem(&places, &survey, &result);
    let settings: Vec<Vec<String>> = places.iter().map(|place| words::settings(place, &written)).collect();
    let failure = if result.verdict == Verdict::Bad {
        problem.map(Failure::Run)
    } else {
        warnings.extend(problem);
        text += &words::next_commands(&places, &settings);
        None
    };
    Ok(Aligned { text, warnings, written, settings, failure, report, observations: result.observations })
}

/// Checks a request before the strips are read: jobs, control points, and reference strips.
///
/// # Errors
/// Those of [`align`] that jobs and options alone show.
pub fn check_early(request: &AlignRequest<'_>) -> Result<(), Failure> {
    prepare(request).map(drop)
}

/// Places of the jobs and control points, checked before strips are read.
fn prepare<'a>(request: &AlignRequest<'a>) -> Result<(Vec<JobPlace<'a>>, Option<Control>), Failure> {
    let places = jobs::places(request)?;
    let Some(first) = places.first() else { return Err(Failure::Wrong("there is no job to align".into())) };
    places.iter().try_for_each(|place| check(request, place))?;
    let control = control::read(&request.constraints, &first.job.settings.geometry, first.input_dir())?;
    check_references(request, &places)?;
    jobs::check_inputs(&places)?;
    Ok((places, control))
}

/// Checks what a job alone shows.
fn check(request: &AlignRequest<'_>, place: &JobPlace<'_>) -> Result<(), Failure> {
    let JobPlace { job, output, .. } = place;
    let input_dir = place.input_dir();
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
fn check_references(request: &AlignRequest<'_>, places: &[JobPlace<'_>]) -> Result<(), Failure> {
    let references = &request.constraints.references;
    if references.is_empty() {
        return Ok(());
    }
    if request.trajectory == TrajectoryModel::None {
        let problem = "`--reference` has no effect with `--trajectory none`, which corrects no trajectory; leave one out";
        return Err(Failure::Wrong(format!("{}: {problem}", job_names(places))));
    }
    // Recordings need not be there if their patches are given.
    if !request.patches.is_empty() {
        return Ok(());
    }
    let mut names: Vec<String> = Vec::new();
    for place in places {
        let inputs = engine::inputs(place.job, place.input_dir());
        let inputs = inputs.map_err(|error| Failure::Run(error.to_string()))?;
        names.extend(inputs.into_iter().map(|input| place.label(&input.stem)));
    }
    match references.iter().find(|name| !names.contains(name)) {
        Some(unknown) => {
            Err(Failure::Wrong(unknown_reference(places, unknown, names.iter().map(String::as_str))))
        }
        None => Ok(()),
    }
}

/// Names of the jobs, for messages.
fn job_names(places: &[JobPlace<'_>]) -> String {
    places.iter().map(|place| place.job.name.as_str()).collect::<Vec<_>>().join(", ")
}

fn unknown_reference<'a>(
    places: &[JobPlace<'_>],
    unknown: &str,
    names: impl Iterator<Item = &'a str>,
) -> String {
    let names: Vec<&str> = names.collect();
    let jobs = job_names(places);
    format!("{jobs}: there is no strip `{unknown}` for `--reference`; the strips are {}", names.join(", "))
}

/// Indices of the reference strips.
fn references(
    places: &[JobPlace<'_>],
    request: &AlignRequest<'_>,
    survey: &SurveyStrips,
) -> Result<Vec<usize>, Failure> {
    let index = |name: &String| {
        let found = survey.strips.iter().position(|strip| strip.name == *name);
        let failed = survey.failures.iter().find(|failed| failed.name == *name);
        found.ok_or_else(|| match failed {
            Some(failed) => Failure::Run(format!("the reference strip cannot be used: {}", failed.problem)),
            None => Failure::Wrong(unknown_reference(
                places,
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
    let installation = |(index, scanner): (usize, &Scanner)| {
        let mut priors = GlobalPriors::default();
        let own = || {
            let is_own = |patch: &&Patch| survey.strips[patch.strip as usize].installation == index;
            survey.patches.iter().filter(is_own)
        };
        let is_low = |low: bool| own().any(|patch| patch.source.on_low_power_scale == low);
        if is_low(true) && is_low(false) {
            priors.0[Global::E7 as usize] = RECEIVER_OFFSET_SD_M;
        }
        for (parameter, sd) in estimate.iter().map(|parameter| parameter.prior()) {
            priors.0[parameter as usize] = sd;
        }
        Installation { scanner: *scanner, priors }
    };
    let installations: Vec<Installation> = survey.scanners.iter().enumerate().map(installation).collect();
    let strips = survey.strips.iter();
    let strips: Vec<Strip> = strips
        .map(|strip| Strip { trajectory: strip.trajectory, installation: strip.installation })
        .collect();
    let given = Survey {
        trajectories: &survey.trajectories,
        installations: &installations,
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
    places: &[JobPlace<'_>],
    survey: &SurveyStrips,
    result: &Alignment,
    report: &AlignReport,
) -> Result<Vec<PathBuf>, Failure> {
    let path = |name: &str| request.output.join(name);
    let mut finished = Vec::new();
    // Files of an earlier alignment would look like those of this one.
    let mut stale = Vec::new();
    let is_bad = result.verdict == Verdict::Bad;
    if places.len() > 1 {
        stale.extend([path(CALIBRATION_FILE), path(CORRECTIONS_FILE)]);
    }
    for (index, (place, scanner)) in places.iter().zip(&result.state.scanners).enumerate() {
        let [calibration, corrections] =
            [CALIBRATION_FILE, CORRECTIONS_FILE].map(|name| place.output.join(name));
        if is_bad || places.len() > 1 && !installations::is_aligned(survey, result, index) {
            stale.extend([calibration, corrections]);
            continue;
        }
        let text = words::calibration_text(&scanner.calibration);
        finished.push(self::finished(&calibration, &text)?.replacing([corrections.clone()]));
        if let Some(text) = corrections_text(survey, result, index)? {
            finished.push(self::finished(&corrections, &text)?);
        }
    }
    let names: Vec<&str> = survey.strips.iter().map(|strip| strip.name.as_str()).collect();
    let residuals = OutputFile::create(&path(RESIDUALS_FILE))
        .and_then(|file| write_residuals(&result.observations, &names, file));
    finished.push(residuals.map_err(|error| Failure::Run(error.to_string()))?);
    finished.push(self::finished(&path(PAGE_FILE), &page(report, &result.observations))?);
    let report = serde_json::to_string_pretty(report).map_err(|error| Failure::Run(error.to_string()))?;
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

/// Text of the corrections of an installation's trajectories; `None` without corrections.
fn corrections_text(
    survey: &SurveyStrips,
    result: &Alignment,
    installation: usize,
) -> Result<Option<String>, Failure> {
    let mut strips = Vec::new();
    let own = || survey.strips.iter().filter(|strip| strip.installation == installation);
    for (strip, found) in survey.strips.iter().zip(&result.strips) {
        if strip.installation != installation {
            continue;
        }
        if let Some(corrections) = found.corrections.as_ref().filter(|_| found.n_pairs > 0) {
            strips.push(StripCorrections::new(&strip.stem, strip.span_s, corrections));
        }
    }
    let Some(first) = own().next().filter(|_| !strips.is_empty()) else { return Ok(None) };
    if let Some(other) = own().find(|strip| strip.clock != first.clock) {
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
