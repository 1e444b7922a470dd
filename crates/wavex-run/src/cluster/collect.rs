//! Checks the results of all tasks and merges them.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde_json::{Value, json};

use super::merge::{Merge, TaskResult};
use super::plan::pattern_of_patches;
use super::{INCLUDED, JOB, MOST_BYTES, PLAN, PlannedAlignment, REMEDY, SurveyPlan, Task};
use crate::Failure;
use crate::align::{AlignConstraints, AlignJob, AlignRequest, Aligned, OptionalParameter, align};
use crate::archive::{Seals, digest_of, plain};
use wavex_engine::engine::{self, Cancel, InputStatus, InputSummary, Options, ProgressMode, RunSummary};
use wavex_engine::job::{Include, Job, JobStage, Override};
use wavex_formats::{Error, path_within, read_small_text};
use wavex_line::stage::{Plan, Result, StageError, SurveyModels};
use wavex_pages::report::{self, FileState, InputEntry, InputFiles, InputReport, RunReport};
use wavex_stages::registry::STAGES;

/// Results of a survey.
#[derive(Debug)]
pub struct Collected {
    /// Table of all tasks.
    pub table: String,
    /// Files written.
    pub written: Vec<PathBuf>,
    /// The archive with its seals.
    pub archive: Option<(PathBuf, Seals)>,
    /// The alignment, or its error.
    pub aligned: Option<std::result::Result<Aligned, Failure>>,
    /// Tasks that are not complete: name and reason.
    pub problems: Vec<(String, String)>,
    /// Number of tasks.
    pub tasks: usize,
}

/// Checks the files of all tasks, and merges reports, line statistics, digests and archive.
///
/// Compares sizes; with `by_digest`, and for an archive, contents. Makes archive and alignment if `archives`, and only if
/// every task has ended.
///
/// # Errors
/// If the plan cannot be read or a file cannot be written.
pub fn collect(folder: &Path, by_digest: bool, archives: bool) -> Result<Collected> {
    let plan = SurveyPlan::read(folder)?;
    let place = plain(&folder.join(&plan.root));
    let root = place_or_here(&place);
    let own_folder = [folder, &root.join(&plan.plan_dir)].map(Path::canonicalize);
    if !matches!(own_folder, [Ok(ref own), Ok(ref planned)] if own == planned) {
        return Err(Error::unusable(folder, "the plan is of another folder", REMEDY).into());
    }
    let job = job(&plan, folder)?;
    let job_dir = place_or_here(&plain(&folder.join(&plan.job_dir))).to_owned();
    let from = |dir: &Option<String>| dir.as_ref().map_or(job_dir.clone(), |dir| job_dir.join(dir));
    let dirs = [from(&job.settings.input_dir), from(&job.settings.output_dir)];
    check_inputs(&plan, &job, &dirs[0])?;
    let mut options = Options::of_job(&job, &dirs[0], &dirs[1]);
    if let Some(task) = plan.tasks.first() {
        options.threads = task.estimate.cores;
    }
    options.survey = survey(&plan, root, &job, &options)?;
    let mut run = RunSummary::new(&job, &options);
    let merge = Merge::new(&plan, &job, root, &dirs)?;
    // An archive states what files contain.
    let by_digest = by_digest || (archives && plan.archive.is_some());
    let checker = Checker::new(&plan, root, &job, &options, by_digest);
    let results: Vec<TaskResult> =
        (1..).zip(&plan.tasks).map(|(number, task)| checker.check(number, task)).collect();
    let mut entries = Vec::new();
    let mut problems = Vec::new();
    for (task, result) in plan.tasks.iter().zip(&results) {
        let mut input = InputSummary::pending(&merge.input_path(task), &task.name);
        input.failure = result.problem.clone();
        input.status = result.status;
        entries.push(match &result.entry {
            Some(entry) => {
                let entry = merge.entry(entry, &mut input, &result.files);
                run.wall_s += input.wall_s;
                InputEntry::from(&entry)
            }
            None => InputEntry::new(InputReport::new(&input, None, InputFiles::default()))?,
        });
        problems.extend(input.failure.clone().map(|problem| (task.name.clone(), problem)));
        run.inputs.push(input);
    }
    let report = RunReport { run: &run, inputs: &entries };
    let mut written = merge.write(&plan, &job, &report, &results)?;
    written.sort();
    let has_ended = run.inputs.iter().all(|input| input.status != InputStatus::NotRun);
    let is_done = |input: &InputSummary| input.status == InputStatus::Done;
    let archive = plan.archive.as_ref().filter(|_| archives && has_ended && run.inputs.iter().any(is_done));
    let archive = archive.map(|path| {
        let path = root.join(path);
        let seals = merge.archive(&plan, &job, &options, &report, &results, &path)?;
        Ok::<_, StageError>((path, seals))
    });
    let archive = archive.transpose()?;
    let aligned = plan.align.as_ref().filter(|_| archives && has_ended).zip(pattern_of_patches(&job));
    let aligned = aligned.map(|(planned, pattern)| {
        let done = run.inputs.iter().filter(|input| is_done(input));
        let patches: Vec<PathBuf> =
            done.map(|input| dirs[1].join(pattern.replace('*', &input.stem))).collect();
        let name = plain(&job_dir.join(&plan.job)).display().to_string();
        let wrong =
            |problem: String| Failure::Run(format!("{PLAN}: the alignment is invalid: {problem}; {REMEDY}"));
        let job = Job { name, ..job.clone() };
        align(&AlignRequest {
            jobs: &[AlignJob { job: &job, folder: &job_dir }],
            output: &plain(&root.join(&planned.folder)),
            trajectory: planned.trajectory.parse().map_err(wrong)?,
            constraints: constraints(planned, root).map_err(wrong)?,
            patches: &patches,
            progress: ProgressMode::Hidden,
            cancel: Cancel::default(),
        })
    });
    let (table, tasks) = (report::input_table(&report), plan.tasks.len());
    Ok(Collected { table, written, archive, aligned, problems, tasks })
}

/// What is known or asked besides the job.
fn constraints(planned: &PlannedAlignment, root: &Path) -> std::result::Result<AlignConstraints, String> {
    let crs = planned.control_crs.as_ref().map(|crs| {
        let file = root.join(crs);
        if file.is_file() { plain(&file).display().to_string() } else { crs.clone() }
    });
    let estimate = planned
        .estimate
        .iter()
        .map(|name| OptionalParameter::of_name(name).ok_or_else(|| format!("unknown parameter `{name}`")));
    Ok(AlignConstraints {
        control: planned.control.as_ref().map(|file| plain(&root.join(file))),
        control_crs: crs,
        references: planned.references.clone(),
        estimate: estimate.collect::<std::result::Result<_, _>>()?,
    })
}

/// The folder, or the current one if the path is empty.
fn place_or_here(folder: &Path) -> &Path {
    if folder.as_os_str().is_empty() { Path::new(".") } else { folder }
}

/// The job of the plan, as written.
fn job(plan: &SurveyPlan, folder: &Path) -> Result<Job> {
    let read = |name: &str| read_small_text(&path_within(folder, name)?, MOST_BYTES, "a plan", REMEDY);
    let include = |(number, name): (usize, &String)| -> Result<Include> {
        let file = Path::new(name).file_name().unwrap_or_default().to_string_lossy();
        Ok(Include { name: name.clone(), text: read(&format!("{INCLUDED}/{number}_{file}"))? })
    };
    let includes: Vec<Include> = (1..).zip(&plan.included).map(include).collect::<Result<_>>()?;
    let set: Vec<Override> = plan.set.iter().map(Override::new).collect();
    Job::parse_with(STAGES, &plan.job, &read(JOB)?, &includes, &set)
        .map_err(|errors| Error::unusable(&folder.join(JOB), errors.to_string().trim_end(), REMEDY).into())
}

/// Checks that the job has the inputs of the plan.
fn check_inputs(plan: &SurveyPlan, job: &Job, input_dir: &Path) -> Result<()> {
    let found = engine::inputs(job, input_dir).map_err(|error| error.into_stage_error())?;
    let is_same = found.iter().map(|input| &input.stem).eq(plan.tasks.iter().map(|task| &task.name));
    if is_same {
        return Ok(());
    }
    let problem = format!("the job now has {} inputs, the plan {}", found.len(), plan.tasks.len());
    Err(StageError::failed(problem, "run `wavex plan` again, and then the new tasks"))
}

/// Sensor models of the survey; none if there are none, or not yet.
fn survey(plan: &SurveyPlan, root: &Path, job: &Job, options: &Options) -> Result<Option<Arc<SurveyModels>>> {
    let models = match &plan.calibration {
        None => engine::survey_models(job, options).map_err(|error| error.into_stage_error())?,
        Some(task) => match plan.task_file(root, &task.model) {
            Err(error) if error.is_missing() => None,
            path => Some(SurveyModels::read(&path?)?),
        },
    };
    Ok(models.map(Arc::new))
}

/// Checks the results of tasks.
struct Checker<'c> {
    plan: &'c SurveyPlan,
    root: &'c Path,
    job: &'c Job,
    /// The run that the tasks are parts of, without sensor models of the survey.
    next: RunSummary,
    /// Paths in the keys of its stages.
    paths: BTreeSet<String>,
    /// Sensor models of the survey, without inputs.
    models: Option<Value>,
    /// Inputs of the survey by stem.
    inputs: BTreeMap<&'c str, Value>,
    by_digest: bool,
}

impl<'c> Checker<'c> {
    fn new(
        plan: &'c SurveyPlan,
        root: &'c Path,
        job: &'c Job,
        options: &'c Options,
        by_digest: bool,
    ) -> Checker<'c> {
        let of_stage = |stage: &JobStage| -> Vec<String> {
            let outputs = stage.planned.plan.outputs().into_iter().map(str::to_owned);
            outputs.chain(stage.planned.inputs.iter().map(ToString::to_string)).collect()
        };
        let value = |value: &dyn Fn() -> serde_json::Result<Value>| value().unwrap_or_default();
        let models = options.survey.as_deref();
        let inputs = models.into_iter().flat_map(|models| &models.inputs);
        Checker {
            plan,
            root,
            job,
            next: RunSummary::new(job, &Options { survey: None, ..options.clone() }),
            paths: job.stages.iter().flat_map(of_stage).collect(),
            models: models.map(|models| {
                let without = models.clone().only(&BTreeSet::new());
                value(&|| serde_json::to_value(&without))
            }),
            inputs: inputs
                .map(|input| (input.stem.as_str(), value(&|| serde_json::to_value(input))))
                .collect(),
            by_digest,
        }
    }

    /// Key of the reader that lists the parts of a file, if each is an input of its own.
    fn part_key(&self) -> Option<&'static str> {
        match &self.job.stages.first()?.planned.plan {
            Plan::Source(source) => source.part_key(),
            _ => None,
        }
    }

    /// Sensor models of the survey as in the report of a task.
    fn models_of(&self, task: &Task) -> Value {
        let Some(mut models) = self.models.clone() else { return Value::Null };
        let inputs: Vec<&Value> = self.inputs.get(task.name.as_str()).into_iter().collect();
        models["inputs"] = serde_json::to_value(inputs).unwrap_or_default();
        models
    }

    /// Result of a task; `number` counts the inputs of the survey from 1.
    fn check(&self, number: usize, task: &Task) -> TaskResult {
        let missing = |problem: String| TaskResult {
            status: InputStatus::NotRun,
            problem: Some(problem),
            entry: None,
            files: InputFiles::default(),
        };
        let path = self.plan.task_file(self.root, &task.report);
        let report = match path.and_then(|path| report::read_report(&path)) {
            Ok(report) => report,
            Err(error) if error.is_missing() => return missing("not run: it has no report".to_owned()),
            Err(error) => return missing(error.to_string()),
        };
        if let Some(difference) = self.difference(&report, number, task) {
            return missing(format!("out of date: {difference}"));
        }
        let entry = report["inputs"].get(0).cloned().unwrap_or_default();
        let files: InputFiles = serde_json::from_value(entry["files"].clone()).unwrap_or_default();
        match (entry["status"].as_str(), entry["failure"].as_str()) {
            (Some("done"), _) => match self.other_files(task, &files).or_else(|| self.changed(&files)) {
                Some(problem) => missing(problem),
                None => TaskResult { status: InputStatus::Done, problem: None, entry: Some(entry), files },
            },
            (Some("failed"), reason) => {
                let problem = Some(reason.unwrap_or("failed without a reason").to_owned());
                TaskResult { status: InputStatus::Failed, problem, entry: Some(entry), files }
            }
            _ => missing("not run: its report has no result".to_owned()),
        }
    }

    /// First difference between the job of a task and the plan.
    fn difference(&self, report: &Value, number: usize, task: &Task) -> Option<String> {
        let mut report = report.clone();
        if report["survey_models"] != self.models_of(task) {
            return Some("the sensor models of the survey were different".to_owned());
        }
        report["survey_models"] = Value::Null;
        // The task has further stages for the archive.
        // Paths of a task start at another folder.
        if let Some(stages) = report["stages"].as_array_mut() {
            stages.retain(|stage| stage["id"] != super::tasks::ARCHIVE_STAGE);
            for (stage, planned) in stages.iter_mut().zip(&self.next.stages) {
                if let Some(keys) = stage.get_mut("keys") {
                    same_paths(keys, &planned.keys, &self.paths);
                    // A task reads one part of its file.
                    if let Some(key) = self.part_key() {
                        same_key(keys, &planned.keys, key);
                    }
                    // A task has one input, so its job numbers the flight line.
                    if planned.keys["point_source_id"] == "line" && keys["point_source_id"] == number {
                        keys["point_source_id"] = json!("line");
                    }
                }
            }
        }
        if let Some(found) = report.pointer_mut("/job/geometry") {
            let planned = &self.next.job.geometry;
            // The job of a task has all defaults.
            let mut spelled_out = planned.clone();
            spelled_out.spell_out();
            let spelled_out = serde_json::to_value(&spelled_out).unwrap_or_default();
            same_paths(found, &spelled_out, &texts(&spelled_out));
            if *found == spelled_out {
                *found = serde_json::to_value(planned).unwrap_or_default();
            }
        }
        // The cells are compared as outputs.
        if let Some(cells) = report.pointer_mut("/job/survey/cells") {
            *cells = json!(self.job.settings.survey.cells);
        }
        let free = ["input_dir", "output_dir", "report", "report_page", "stat_log", "survey_page"];
        report::difference(&report, self.job, &self.next, &free)
    }

    /// First planned file that the task has not read or written.
    fn other_files(&self, task: &Task, files: &InputFiles) -> Option<String> {
        let has = |among: &[FileState], path: &str| among.iter().any(|file| file.path == path);
        let input = task.inputs.iter().find(|file| !has(&files.read, &file.path));
        let output = task.outputs.iter().find(|path| !has(&files.written, path));
        let input = input.map(|file| format!("out of date: it has not read {}", file.path));
        input.or_else(|| output.map(|path| format!("out of date: it has not written {path}")))
    }

    /// First file that differs from the report of its task.
    fn changed(&self, files: &InputFiles) -> Option<String> {
        if files.written.is_empty()
            && !self.job.stages.iter().all(|stage| stage.planned.plan.outputs().is_empty())
        {
            return Some("its report names no outputs".to_owned());
        }
        files.read.iter().chain(&files.written).find_map(|file| self.file_changed(file))
    }

    fn file_changed(&self, file: &FileState) -> Option<String> {
        let path = self.root.join(&file.path);
        let Ok(about) = path.metadata() else { return Some(format!("{} is missing", file.path)) };
        if about.len() != file.bytes {
            return Some(format!("{} has {} bytes instead of {}", file.path, about.len(), file.bytes));
        }
        let noted = file.blake3.as_ref().filter(|_| self.by_digest)?;
        match digest_of(&path) {
            Ok(now) if now == *noted => None,
            Ok(_) => Some(format!("{} was changed: its digest is different", file.path)),
            Err(error) => Some(error.to_string()),
        }
    }
}

/// Gives a key of a table the value that it has in another one; none if it has none there.
fn same_key(keys: &mut Value, planned: &Value, key: &str) {
    let Some(keys) = keys.as_object_mut() else { return };
    match planned.get(key) {
        Some(value) => keys.insert(key.to_owned(), value.clone()),
        None => keys.remove(key),
    };
}

/// All texts in a table.
fn texts(table: &Value) -> BTreeSet<String> {
    match table {
        Value::String(text) => BTreeSet::from([text.clone()]),
        Value::Object(keys) => keys.values().flat_map(texts).collect(),
        Value::Array(items) => items.iter().flat_map(texts).collect(),
        _ => BTreeSet::new(),
    }
}

/// Replaces the paths of files in a table by the paths of the job, if the files have the same names.
fn same_paths(keys: &mut Value, planned: &Value, paths: &BTreeSet<String>) {
    match (keys, planned) {
        (Value::Object(keys), Value::Object(planned)) => {
            for (key, value) in keys {
                same_paths(value, planned.get(key).unwrap_or(&Value::Null), paths);
            }
        }
        (Value::String(found), Value::String(path))
            if paths.contains(path) && Path::new(found).file_name() == Path::new(path).file_name() =>
        {
            found.clone_from(path);
        }
        _ => {}
    }
}
