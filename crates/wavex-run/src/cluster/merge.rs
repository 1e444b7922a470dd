//! Files of a whole survey, made from the files of its tasks.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde_json::{Value, json};

use super::plan::write_text;
use super::tasks::{ARCHIVE_STAGE, LINES};
use super::{MOST_BYTES, REMEDY, SurveyPlan, Task};
use crate::archive::{self, KnownDigests, Recorder, Seals, check_destination, plain, relative};
use wavex_engine::engine::{InputStatus, InputSummary, Options};
use wavex_engine::job::{Job, named};
use wavex_formats::{Error, path_within, read_small_text};
use wavex_line::stage::{OutputFile, Plan, Result, StageError};
use wavex_pages::report::survey::{StripPaths, write_survey};
use wavex_pages::report::{FileState, InputFiles, RunReport};

/// Digests of all outputs; `*` is the stem of the job.
const DIGESTS: &str = "*_outputs.b3";
/// Scan-line statistics of all inputs, if the job writes them; `*` is the stem of the job.
const ALL_LINES: &str = "*_all_lstat.txt";

/// Result of a task.
pub(super) struct TaskResult {
    pub status: InputStatus,
    /// Why it is not complete.
    pub problem: Option<String>,
    /// Its entry of the report.
    pub entry: Option<Value>,
    /// Its files.
    pub files: InputFiles,
}

/// Folders of a survey.
pub(super) struct Merge<'m> {
    /// Data root, as given.
    root: &'m Path,
    /// Data root, absolute.
    absolute_root: PathBuf,
    /// Folder of the plan, absolute.
    plan_dir: PathBuf,
    /// Folders of the job, as given.
    input_dir: &'m Path,
    output_dir: &'m Path,
    /// The same, absolute.
    absolute_input_dir: PathBuf,
    absolute_output_dir: PathBuf,
    /// Files of each strip, if the job requests them.
    strips: Option<StripPaths>,
}

impl<'m> Merge<'m> {
    pub(super) fn new(
        plan: &SurveyPlan,
        job: &Job,
        root: &'m Path,
        dirs: &'m [PathBuf; 2],
    ) -> Result<Merge<'m>> {
        let [input_dir, output_dir] = dirs;
        fs::create_dir_all(output_dir).map_err(Error::io(output_dir, "create the folder"))?;
        let absolute = |path: &Path| path.canonicalize().map_err(Error::io(path, "find the folder"));
        let absolute_root = absolute(root)?;
        Ok(Merge {
            root,
            plan_dir: plain(&absolute_root.join(&plan.plan_dir)),
            absolute_root,
            input_dir,
            output_dir,
            absolute_input_dir: absolute(input_dir)?,
            absolute_output_dir: absolute(output_dir)?,
            strips: StripPaths::new(&job.settings, output_dir),
        })
    }

    fn absolute(&self, path: &str) -> PathBuf {
        plain(&self.absolute_root.join(path))
    }

    /// Path of a task's input as a run of the whole job shows it.
    pub(super) fn input_path(&self, task: &Task) -> PathBuf {
        let is_input = |path: &&Path| path.file_stem().is_some_and(|stem| *stem == *task.name);
        // The first file is the input, unless that is simulated.
        let first = task.inputs.first().map(|file| Path::new(&file.path));
        let Some(path) = first.filter(is_input) else { return PathBuf::new() };
        self.shown(&self.absolute_root.join(path), &self.absolute_input_dir, self.input_dir)
    }

    /// Path that starts at a folder as given, if it is in it.
    fn shown(&self, path: &Path, absolute: &Path, given: &Path) -> PathBuf {
        match path.strip_prefix(absolute) {
            Ok(rest) if given == Path::new(".") => rest.to_owned(),
            Ok(rest) => given.join(rest),
            Err(_) => path.to_owned(),
        }
    }

    /// Entry of a task in the report of the survey; completes its summary.
    pub(super) fn entry(&self, entry: &Value, input: &mut InputSummary, files: &InputFiles) -> Value {
        let mut entry = entry.clone();
        let path = input.path.to_string_lossy().into_owned();
        // A task starts at another folder: its messages name the input from there.
        if let (Some(of_task), Some(failure)) = (entry["path"].as_str(), entry["failure"].as_str()) {
            let failure = failure.replace(of_task, &path);
            entry["failure"] = json!(failure);
            input.failure = Some(failure);
        }
        entry["path"] = json!(path);
        if input.status == InputStatus::Done {
            let outputs = files.written.iter().map(|file| self.absolute(&file.path));
            let outputs = outputs.filter(|path| !path.starts_with(&self.plan_dir));
            let outputs = outputs.map(|path| self.shown(&path, &self.absolute_output_dir, self.output_dir));
            // Cells and densities are files of the survey.
            let of_strip = |strips: &StripPaths| [strips.cells(&input.stem), strips.density(&input.stem)];
            let of_strip = self.strips.as_ref().map(of_strip).unwrap_or_default();
            input.outputs = outputs.filter(|path| !of_strip.contains(path)).collect();
            let instrument = entry["survey_instrument"].as_u64();
            input.survey_instrument = instrument.and_then(|number| usize::try_from(number).ok());
            input.sensor_model = serde_json::from_value(entry["sensor_model"].clone()).ok().map(Arc::new);
        }
        input.wall_s = entry["wall_s"].as_f64().unwrap_or_default();
        let outputs: Vec<_> = input.outputs.iter().map(|path| path.to_string_lossy()).collect();
        entry["outputs"] = json!(outputs);
        if let Some(stages) = entry["stages"].as_array_mut() {
            stages.retain(|stage| stage["id"] != ARCHIVE_STAGE);
        }
        entry["files"] = json!(self.files(files));
        entry
    }

    /// Files of a task, with paths as in the report of a run of the whole job.
    fn files(&self, files: &InputFiles) -> InputFiles {
        let of = |list: &[FileState], folder: &Path| -> Vec<FileState> {
            let named = list.iter().map(|file| (self.absolute(&file.path), file));
            let state = |(path, file): (PathBuf, &FileState)| {
                let path = path.strip_prefix(folder).unwrap_or(&path).to_string_lossy().into_owned();
                FileState { path, ..file.clone() }
            };
            named.filter(|(path, _)| !path.starts_with(&self.plan_dir)).map(state).collect()
        };
        InputFiles {
            read: of(&files.read, &self.absolute_input_dir),
            written: of(&files.written, &self.absolute_output_dir),
        }
    }

    /// Writes report, page, log, digests and line statistics of the survey.
    pub(super) fn write(
        &self,
        plan: &SurveyPlan,
        job: &Job,
        report: &RunReport,
        results: &[TaskResult],
    ) -> Result<Vec<PathBuf>> {
        let file = |pattern: &str| self.output_dir.join(named(pattern, &job.stem()));
        let mut written = Vec::new();
        let settings = &job.settings;
        if !settings.report.is_empty() {
            let path = file(&settings.report);
            report.write_json(OutputFile::create(&path)?)?;
            written.push(path);
        }
        if !settings.report_page.is_empty() {
            let path = file(&settings.report_page);
            report.write_page(OutputFile::create(&path)?)?;
            written.push(path);
        }
        if !settings.log.is_empty() {
            let path = file(&settings.log);
            write_text(&path, &self.log(plan))?;
            written.push(path);
        }
        if let Some(strips) = self.strips.as_ref().filter(|_| !settings.survey_page.is_empty()) {
            let models = serde_json::to_value(report.run.survey_models.as_deref()).unwrap_or_default();
            let inputs = strips.inputs(report.inputs, &models);
            let survey = write_survey(&inputs, &settings.survey, &file(&settings.survey_page))?;
            survey.not_compared.iter().for_each(|strip| tracing::warn!("{strip}"));
            written.extend(survey.files);
        }
        let mut texts = vec![(DIGESTS, self.digests(results))];
        texts.extend(self.lines(job, report)?.map(|text| (ALL_LINES, text)));
        for (pattern, text) in texts.into_iter().filter(|(_, text)| !text.is_empty()) {
            let path = file(pattern);
            write_text(&path, &text)?;
            written.push(path);
        }
        Ok(written)
    }

    /// Logs of all tasks, in order.
    fn log(&self, plan: &SurveyPlan) -> String {
        let read = |task: &Task| {
            let path = plan.task_file(self.root, &task.log);
            let text = path.and_then(|path| read_small_text(&path, MOST_BYTES, "a log", REMEDY));
            text.unwrap_or_else(|error| {
                if !error.is_missing() {
                    tracing::warn!("{error}");
                }
                String::new()
            })
        };
        plan.tasks.iter().map(read).collect()
    }

    /// Digests of all outputs in the format of `b3sum`.
    fn digests(&self, results: &[TaskResult]) -> String {
        let done = results.iter().filter(|result| result.status == InputStatus::Done);
        let files = done.flat_map(|result| &result.files.written);
        let line = |file: &FileState| {
            let path = self.absolute(&file.path);
            let name =
                relative(&self.absolute_output_dir, &path).filter(|_| !path.starts_with(&self.plan_dir))?;
            Some(format!("{}  {name}\n", file.blake3.as_ref()?))
        };
        files.filter_map(line).collect()
    }

    /// Scan-line statistics of all inputs, if the job writes them.
    fn lines(&self, job: &Job, report: &RunReport) -> Result<Option<String>> {
        let stage = job.stages.iter().find(|stage| stage.spec.name == "write_lstat");
        let Some(Plan::Sink(sink)) = stage.map(|stage| &stage.planned.plan) else { return Ok(None) };
        let Some(pattern) = sink.outputs().first().filter(|pattern| pattern.contains('*')).copied() else {
            return Ok(None);
        };
        let mut all = String::new();
        for input in report.run.inputs.iter().filter(|input| input.status == InputStatus::Done) {
            let path = path_within(self.output_dir, pattern.replace('*', &input.stem))?;
            let text = read_small_text(&path, MOST_BYTES, "line statistics", REMEDY)?;
            all += &format!("# input {}\n{text}", input.stem);
        }
        Ok(Some(all))
    }

    /// Makes the archive of the survey, unless it exists with the same results.
    pub(super) fn archive(
        &self,
        plan: &SurveyPlan,
        job: &Job,
        options: &Options,
        report: &RunReport,
        results: &[TaskResult],
        path: &Path,
    ) -> Result<Seals> {
        let mut known = KnownDigests::new();
        for file in results.iter().flat_map(|result| result.files.read.iter().chain(&result.files.written)) {
            if let Some(blake3) = &file.blake3 {
                known.insert(self.absolute(&file.path), (file.bytes, blake3.clone()));
            }
        }
        if path.symlink_metadata().is_ok() {
            return same_results(path, report, &known, &self.absolute_output_dir);
        }
        let recorder = Recorder::begin_with(job, options, path, known)?;
        for input in report.run.inputs.iter().filter(|input| input.status == InputStatus::Done) {
            let lines = path_within(&self.plan_dir, LINES.replace('*', &input.stem))?;
            recorder.add_lines(&input.stem, &lines)?;
        }
        let text = report.to_json().map_err(std::io::Error::from);
        let text = text.map_err(Error::io(path, "write the report"))?;
        recorder.finish(report.run, text, self.log(plan).as_bytes())
    }
}

/// Seals of an existing archive.
///
/// # Errors
/// If it describes other results.
fn same_results(path: &Path, report: &RunReport, known: &KnownDigests, output_dir: &Path) -> Result<Seals> {
    let (archive, seals) = archive::existing(path)?;
    let failed = |input: &&InputSummary| input.status == InputStatus::Failed;
    let now_failed = report.run.inputs.iter().filter(failed).map(|input| &input.stem);
    let then: BTreeMap<&str, &str> =
        archive.outputs.files.iter().map(|file| (file.path.as_str(), file.blake3.as_str())).collect();
    let outputs = report.run.inputs.iter().flat_map(|input| &input.outputs);
    let now: Option<BTreeMap<String, &str>> = outputs
        .map(|output| {
            let folder = output.parent()?.canonicalize().ok()?;
            let output = plain(&folder.join(output.file_name()?));
            let (_, blake3) = known.get(&output)?;
            Some((relative(output_dir, &output)?, blake3.as_str()))
        })
        .collect();
    let is_same = now.is_some_and(|now| {
        now.len() == then.len() && now.iter().all(|(path, blake3)| then.get(path.as_str()) == Some(blake3))
    });
    if is_same && archive.failed.iter().map(|failed| &failed.stem).eq(now_failed) {
        return Ok(seals);
    }
    check_destination(path).and_then(|()| {
        let problem = format!("{}: the archive has other results", path.display());
        Err(StageError::failed(problem, "move it away and collect again"))
    })
}
