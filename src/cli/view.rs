//! `wavex view`: serves the page of a recording, a job, a run or a file of points.

use std::path::{Path, PathBuf};
use std::time::Duration;

use serde_json::{Map, Value};

use super::init::of_recording;
use super::place::{check_viewable, instead_of_points, only_report};
use super::run::stop_on_signals;
use super::{Failure, JobArgs, ViewArgs, terminal};
use wavex_engine::engine::Cancel;
use wavex_engine::job::{Include, Job, Override};
use wavex_formats::extensions::has_extension;
use wavex_formats::is_only_points;
use wavex_line::georef::check_crs;
use wavex_pages::report::read_report;
use wavex_pages::view::{self, Opened};
use wavex_run::run::folders;
use wavex_stages::registry::STAGES;

/// Interval at which the end is looked for.
const TICK: Duration = Duration::from_millis(100);

/// Serves the page until a signal ends it.
pub(super) fn view(args: &ViewArgs, quiet: bool) -> Result<(), Failure> {
    let opened = opened(args)?;
    if let Some(instead) = &opened.without_waveforms {
        tracing::warn!("{instead}");
    }
    check_crs(&opened.job.settings.geometry, &opened.input_dir)
        .map_err(|error| Failure::Wrong(error.to_string()))?;
    let cancel = Cancel::default();
    // Nothing is written, so nothing is lost.
    stop_on_signals(&cancel, || std::process::exit(0));
    let view = match view::open(opened, args.port, cancel.clone()) {
        Err(_) if cancel.is_cancelled() => return Ok(()),
        opened => opened.map_err(Failure::Run)?,
    };
    terminal::print(&format!("{}\n", view.address))?;
    if !quiet {
        terminal::print("Ctrl-C ends it.\n")?;
    }
    if !args.no_open
        && let Err(error) = open::that_detached(&view.address)
    {
        tracing::warn!("no browser could be started ({error}); open the address above in one");
    }
    let mut is_reported = false;
    while !cancel.is_cancelled() {
        if let Some(ended) = view.ended().filter(|_| !is_reported) {
            is_reported = true;
            match ended {
                Ok(points) if !quiet => {
                    terminal::print(&format!("{points} point{}\n", if points == 1 { "" } else { "s" }))?
                }
                Ok(_) => {}
                Err(problem) => tracing::error!("{problem}"),
            }
        }
        std::thread::sleep(TICK);
    }
    Ok(())
}

/// Recognises what the place is.
fn opened(args: &ViewArgs) -> Result<Opened, Failure> {
    let place = &args.place;
    check_viewable(place)?;
    let title =
        place.file_name().map_or_else(|| place.display().to_string(), |name| name.to_string_lossy().into());
    let memory_bytes = usize::try_from(args.memory_mb).unwrap_or(usize::MAX).saturating_mul(1_000_000);
    let kind = match () {
        () if place.is_dir() || has_extension(place, "json") => "folder",
        () if has_extension(place, "toml") => "job",
        () if is_only_points(place) => "points",
        () => "recording",
    };
    let (source, folder) = match kind {
        "folder" if place.is_dir() => JobText::of_report(&only_report(place)?)?,
        "folder" => JobText::of_report(place)?,
        "job" => {
            let job = JobArgs { job: place.clone(), set: Vec::new() };
            let folder = job.folder();
            (JobText::of_job(&job.read(None)?), folder)
        }
        "points" => {
            let mut path = Map::new();
            path.insert("path".into(), place.display().to_string().into());
            let reader = toml::to_string(&path).unwrap_or_default();
            let text = format!("[[stage]]\ntype = \"read_las\"\n{reader}");
            (JobText { name: place.display().to_string(), text, includes: Vec::new() }, PathBuf::new())
        }
        _ => {
            let (name, text) = (format!("the job for {}", place.display()), of_recording(place, None)?);
            // Paths in messages stay as they are given.
            (JobText { name, text, includes: Vec::new() }, PathBuf::new())
        }
    };
    let set = args.set.clone();
    let job = source.parse(&set)?;
    let (input_dir, output_dir) = folders(&job, &folder);
    let layers = match kind {
        "folder" if place.is_dir() => place.clone(),
        "folder" => place.parent().map_or_else(PathBuf::new, Path::to_path_buf),
        "points" => place.parent().filter(|folder| *folder != Path::new("")).unwrap_or(Path::new(".")).into(),
        _ => output_dir,
    };
    let with = move |more: &[String]| {
        let all: Vec<String> = set.iter().chain(more).cloned().collect();
        source.parse(&all).map_err(|failure| failure.text())
    };
    let folder = (kind != "recording").then_some(layers);
    let without_waveforms = (kind == "points").then(|| instead_of_points(place));
    Ok(Opened { title, kind, without_waveforms, job, with: Box::new(with), input_dir, folder, memory_bytes })
}

/// Text of a job.
struct JobText {
    name: String,
    text: String,
    includes: Vec<Include>,
}

impl JobText {
    fn of_job(job: &Job) -> JobText {
        JobText { name: job.name.clone(), text: job.text.clone(), includes: job.includes.clone() }
    }

    /// Job of the run with this report, and the folder of its inputs.
    fn of_report(path: &Path) -> Result<(JobText, PathBuf), Failure> {
        let name = path.display().to_string();
        let wrong = |problem: &str| {
            Failure::Wrong(format!("{name}: {problem}; give the job or the recording instead of the folder"))
        };
        let report = read_report(path).map_err(|error| Failure::Wrong(error.to_string()))?;
        let Some(input_dir) = report["input_dir"].as_str() else {
            return Err(wrong("the report does not name the folder of the inputs"));
        };
        let inputs = report["inputs"].as_array().map_or(&[][..], Vec::as_slice);
        if !inputs.is_empty() && inputs.iter().all(|input| input["status"] == "failed") {
            tracing::warn!(
                "{name}: the last run of this job failed, and its keys are used here; give the job instead of the folder \
                 to see outputs of an earlier run: wavex view JOB.toml"
            );
        }
        let mut settings = report["job"].as_object().cloned().unwrap_or_default();
        settings.retain(|key, _| !matches!(key.as_str(), "include" | "output_dir"));
        settings.insert("input_dir".into(), input_dir.into());
        let stages = report["stages"].as_array().map_or(&[][..], Vec::as_slice);
        let tables: Vec<Value> = stages.iter().filter_map(stage_table).collect();
        let mut job = Map::new();
        job.insert("job".into(), settings.into());
        job.insert("stage".into(), tables.into());
        let mut job = Value::Object(job);
        without_null(&mut job);
        let text = toml::to_string(&job).map_err(|error| wrong(&format!("its job is damaged: {error}")))?;
        Ok((JobText { name, text, includes: Vec::new() }, PathBuf::from(input_dir)))
    }

    fn parse(&self, set: &[String]) -> Result<Job, Failure> {
        let overrides: Vec<Override> = set.iter().map(Override::new).collect();
        Ok(Job::parse_with(STAGES, &self.name, &self.text, &self.includes, &overrides)?)
    }
}

/// Table of a stage of a report.
fn stage_table(stage: &Value) -> Option<Value> {
    let mut table = Map::new();
    table.insert("type".into(), stage["type"].as_str()?.into());
    table.extend(stage["keys"].as_object()?.clone());
    Some(table.into())
}

/// Removes keys without value, which TOML cannot have.
fn without_null(value: &mut Value) {
    match value {
        Value::Object(map) => {
            map.retain(|_, value| !value.is_null());
            map.values_mut().for_each(without_null);
        }
        Value::Array(list) => list.iter_mut().for_each(without_null),
        _ => {}
    }
}
