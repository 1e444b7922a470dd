//! Files of a run besides the outputs of its stages: report, page, trace, statistics.

use std::collections::{BTreeMap, BTreeSet};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use serde_json::Value;

use super::ResumeCheck;
use super::ending::{self, EndMessage};
use super::replaced;
use super::resume::{Comparison, EarlierRun};
use super::survey_files::{PageCollector, SurveyFiles};
use crate::archive::shown;
use wavex_engine::engine::{self, Input, InputStatus, InputSummary, Options, RunSummary};
use wavex_engine::job::{Job, JobSettings, named};
use wavex_formats::Error;
use wavex_line::stage::{
    OutputFile, OutputLock, Outputs, Result, RunObservers, StageError, SurveyModels, fixed_folder,
};
use wavex_pages::report::{self, FileState, InputEntry, InputFiles, InputReport, RunReport};

/// Trace that `--profile` writes to the output folder; `*` is the name of the run.
const TRACE: &str = "*_trace.json";

/// Writes the files of a run, and again after each input.
pub(super) struct RunFiles<'j> {
    settings: &'j JobSettings,
    /// Stem of the job file; with a number if a live run has that name.
    name: String,
    output_dir: PathBuf,
    profile: bool,
    /// Data of the pages about the inputs, if the job requests any.
    collected: Option<Arc<PageCollector>>,
    /// Files of the survey, if the job requests its page.
    survey: Option<SurveyFiles>,
    comparison: Comparison,
    /// Files read for each input, before the run, by its stem.
    read: BTreeMap<String, Vec<FileState>>,
    /// Entries of inputs to skip, by their stems.
    skipped: BTreeMap<String, InputEntry>,
    /// Entries of the report, one per input.
    entries: Vec<InputEntry>,
    /// Time from which report and page are written again; `None` if they have all entries.
    due: Option<Instant>,
    /// Time that writing them last took.
    effort: Duration,
}

impl<'j> RunFiles<'j> {
    /// Files that the job requests in this folder.
    pub(super) fn new(
        job: &'j Job,
        [input_dir, output_dir]: [&Path; 2],
        profile: bool,
        check: Option<ResumeCheck>,
    ) -> RunFiles<'j> {
        let output_dir = output_dir.to_owned();
        let (settings, name) = (&job.settings, job.stem());
        let comparison = Comparison::new(check, input_dir, &output_dir);
        RunFiles {
            settings,
            name,
            profile,
            collected: PageCollector::new(settings).map(Arc::new),
            survey: SurveyFiles::new(settings, &output_dir),
            output_dir,
            comparison,
            read: BTreeMap::new(),
            skipped: BTreeMap::new(),
            entries: Vec::new(),
            due: None,
            effort: Duration::ZERO,
        }
    }

    /// Claims the files; the engine claims the outputs of the stages.
    ///
    /// Runs of one job over different inputs do not conflict: each gets its own name.
    ///
    /// # Errors
    /// If another run writes statistics of one of the inputs or the archive, or a folder is not
    /// writable.
    pub(super) fn claim(
        &mut self,
        job: &Job,
        input_dir: &Path,
        archive: Option<&Path>,
    ) -> Result<[OutputLock; 2]> {
        // The engine reports inputs that cannot be found.
        let inputs = engine::inputs(job, input_dir).unwrap_or_default();
        let stat_logs = inputs.iter().filter_map(|input| self.stat_log(&input.stem));
        let of_strip = |input: &Input| Some(self.survey.as_ref()?.of_input(&input.stem));
        let of_strips = inputs.iter().filter_map(of_strip).flatten();
        let mut of_inputs = self.outputs(stat_logs.chain(of_strips));
        if let Some(archive) = archive {
            let folder = fixed_folder(Path::new(""), &archive.to_string_lossy());
            let path = folder.join(archive.file_name().unwrap_or_default());
            of_inputs.entry(folder).or_default().insert(path);
        }
        let of_inputs = OutputLock::acquire(&of_inputs)?;
        for number in 2.. {
            let of_run = self.outputs(self.of_run().into_iter());
            match OutputLock::acquire(&of_run) {
                Err(StageError::InUse { .. }) if self.has_own_names() => {
                    self.name = format!("{}-{number}", job.stem());
                }
                of_run => return Ok([of_inputs, of_run?]),
            }
        }
        Ok([of_inputs, OutputLock::default()])
    }

    /// Whether all files of the run have its name.
    fn has_own_names(&self) -> bool {
        let settings = self.settings;
        let names = [&settings.report, &settings.report_page, &settings.survey_page, &settings.log];
        names.into_iter().all(|name| name.is_empty() || name.contains('*'))
    }

    /// Files by the folder in which they are claimed.
    fn outputs(&self, paths: impl Iterator<Item = PathBuf>) -> Outputs {
        let mut outputs = Outputs::new();
        for path in paths {
            let name = path.strip_prefix(&self.output_dir).unwrap_or(&path).to_string_lossy();
            let folder = fixed_folder(&self.output_dir, &name);
            outputs.entry(folder).or_default().insert(path);
        }
        outputs
    }

    /// Observers that collect the data of the pages.
    pub(super) fn observers(&self) -> Option<Arc<dyn RunObservers>> {
        self.collected.clone().map(|collected| collected as Arc<dyn RunObservers>)
    }

    /// Takes the state of all inputs and returns those to skip, with messages about each.
    ///
    /// Skips none unless `resume`.
    pub(super) fn plan(
        &mut self,
        job: &Job,
        input_dir: &Path,
        next: &RunSummary,
        resume: bool,
    ) -> (BTreeSet<String>, Vec<String>) {
        // The engine reports inputs that cannot be found.
        let inputs = engine::inputs(job, input_dir).unwrap_or_default();
        self.read = self.comparison.read(job, &inputs);
        let mut messages = Vec::new();
        if resume {
            let earlier = EarlierRun::new(self.earlier_report(), job, next);
            for (number, input) in inputs.iter().enumerate() {
                let read = self.read.get(&input.stem).map_or(&[][..], Vec::as_slice);
                let planned = self.planned(job, &input.stem);
                messages.push(match earlier.results(input, read, &planned, number, &self.comparison) {
                    Ok(results) => {
                        self.skipped.insert(input.stem.clone(), results.into());
                        format!("{}: skipped, its outputs are complete", input.stem)
                    }
                    Err(reason) => format!("{}: not skipped: {reason}", input.stem),
                });
            }
        }
        (self.skipped.keys().cloned().collect(), messages)
    }

    /// Warnings about outputs of other jobs that the run of the inputs not skipped replaces.
    pub(super) fn replaced(&self, job: &Job, input_dir: &Path) -> Vec<String> {
        let inputs = engine::inputs(job, input_dir).unwrap_or_default();
        let to_run = inputs.iter().filter(|input| !self.skipped.contains_key(&input.stem));
        let planned: Vec<PathBuf> = to_run.flat_map(|input| self.planned(job, &input.stem)).collect();
        let own_report = self.of_name(&self.settings.report);
        replaced::warnings(&self.output_dir, own_report.as_deref(), &self.comparison.written(&planned))
    }

    /// Report of the earlier run, or why it cannot be read; `None` without a report.
    fn earlier_report(&self) -> Option<std::result::Result<Value, String>> {
        let path = self.of_name(&self.settings.report).filter(|path| path.exists())?;
        Some(report::read_report(&path).map_err(|error| error.to_string()))
    }

    /// Sensor models of the earlier run, if it was of the same job.
    ///
    /// Models learnt again would differ if an input was damaged, repaired or added: all inputs would be run again.
    pub(super) fn earlier_models(&self, job: &Job, options: &Options) -> Option<Arc<SurveyModels>> {
        if !engine::shares_models(job, usize::MAX) {
            return None;
        }
        let report = self.earlier_report()?.ok()?;
        let models = Arc::new(SurveyModels::of_report(&report)?);
        let next = RunSummary::new(job, &Options { survey: Some(Arc::clone(&models)), ..options.clone() });
        report::difference(&report, job, &next, &[]).is_none().then_some(models)
    }

    /// Outputs that the run of an input writes.
    fn planned(&self, job: &Job, stem: &str) -> Vec<PathBuf> {
        let patterns = job.stages.iter().flat_map(|stage| stage.planned.plan.outputs());
        let of_stages = patterns.map(|pattern| self.output_dir.join(pattern.replace('*', stem)));
        let cells = self.survey.as_ref().map(|survey| survey.of_input(stem));
        of_stages.chain(cells.map(|[cells, _]| cells)).collect()
    }

    /// Checks that report and pages can be created.
    ///
    /// Problems with them should be reported before the run, not after its first input.
    pub(super) fn check(&self) -> Result<()> {
        for path in [&self.settings.report, &self.settings.report_page, &self.settings.survey_page] {
            self.of_name(path).map_or(Ok(()), |path| OutputFile::create(&path).map(drop))?;
        }
        Ok(())
    }

    /// Files of the run as a whole.
    pub(super) fn of_run(&self) -> Vec<PathBuf> {
        let trace = if self.profile { TRACE } else { "" };
        let names = [&self.settings.report, &self.settings.report_page, trace, &self.settings.log];
        let survey = self.survey_page().into_iter().flat_map(|page| SurveyFiles::of_page(&page));
        names.into_iter().filter_map(|name| self.of_name(name)).chain(survey).collect()
    }

    /// Statistics of an input, if the job requests them.
    pub(super) fn stat_log(&self, stem: &str) -> Option<PathBuf> {
        self.path(&self.settings.stat_log.replace('*', stem))
    }

    /// Log of the run, if the job requests one.
    pub(super) fn log(&self) -> Option<PathBuf> {
        self.of_name(&self.settings.log)
    }

    /// Page of the survey, if the job requests one.
    fn survey_page(&self) -> Option<PathBuf> {
        self.of_name(&self.settings.survey_page)
    }

    /// File of the run with this pattern.
    fn of_name(&self, pattern: &str) -> Option<PathBuf> {
        self.path(&named(pattern, &self.name))
    }

    fn path(&self, name: &str) -> Option<PathBuf> {
        (!name.is_empty()).then(|| self.output_dir.join(name))
    }

    /// Writes the statistics of an input that has just ended, and updates report and page.
    ///
    /// These grow with each input: they are written again after twenty times as long as that takes.
    /// After a failure, writes only to folders that exist.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub(super) fn update(&mut self, run: &RunSummary, number: usize) -> Result<()> {
        let Some(input) = run.inputs.get(number) else { return Ok(()) };
        let is_done = input.status == InputStatus::Done;
        let collected = self.collected.as_ref();
        let overview = collected.and_then(|collected| collected.overview(&input.stem)).filter(|_| is_done);
        let strip = collected.and_then(|collected| collected.strip(&input.stem)).filter(|_| is_done);
        let of_strip = self.survey.as_ref().zip(strip).map(|(survey, strip)| survey.write_strip(&strip));
        let of_strip = of_strip.transpose()?.unwrap_or_default();
        let written = self.comparison.written(input.outputs.iter().chain(&of_strip));
        let read = self.read.get(&input.stem).cloned().unwrap_or_default();
        self.fill_entries(run)?;
        let entry = InputReport::new(input, overview.as_ref(), InputFiles { read, written });
        self.entries[number] = InputEntry::new(entry)?;
        if let Some(path) = self.stat_log(&input.stem).filter(|path| is_done || is_in_folder(path)) {
            report::write_stat_log(&path, run, input, &self.of_run(), input.failure.as_deref())?;
        }
        if Instant::now() >= *self.due.get_or_insert_with(Instant::now) {
            self.write_report(run, is_done)?;
            self.due = Some(Instant::now() + 20 * self.effort);
        }
        Ok(())
    }

    /// Writes report and page of a run that has ended.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub(super) fn complete(&mut self, run: &RunSummary) -> Result<()> {
        self.fill_entries(run)?;
        if self.due.take().is_some() {
            self.write_report(run, false)?;
        }
        Ok(())
    }

    /// Writes the page of the survey.
    ///
    /// # Errors
    /// If it cannot be made.
    pub(super) fn write_survey(&mut self, run: &RunSummary) -> Result<Vec<String>> {
        let was_run = run.inputs.iter().any(|input| input.status != InputStatus::NotRun);
        let page = self.survey_page().filter(|path| was_run && is_in_folder(path));
        if let Some((survey, page)) = self.survey.as_mut().zip(page) {
            return survey.write(self.settings, &self.entries, run.survey_models.as_deref(), &page);
        }
        Ok(Vec::new())
    }

    /// Adds entries for inputs without one: skipped or not run.
    fn fill_entries(&mut self, run: &RunSummary) -> Result<()> {
        for input in run.inputs.iter().skip(self.entries.len()) {
            self.entries.push(match self.skipped.get(&input.stem) {
                Some(earlier) => earlier.clone(),
                None => InputEntry::new(InputReport::new(input, None, InputFiles::default()))?,
            });
        }
        Ok(())
    }

    fn write_report(&mut self, run: &RunSummary, makes_folders: bool) -> Result<()> {
        let started = Instant::now();
        let file = |path: Option<PathBuf>| path.filter(|path| makes_folders || is_in_folder(path));
        let report = self.report(run);
        if let Some(path) = file(self.of_name(&self.settings.report)) {
            report.write_json(OutputFile::create(&path)?)?;
        }
        if let Some(path) = file(self.of_name(&self.settings.report_page)) {
            report.write_page(OutputFile::create(&path)?)?;
        }
        self.effort = started.elapsed();
        Ok(())
    }

    /// Writes the statistics of a run that failed before its first input.
    ///
    /// Only to folders that exist. Errors are only logged, because the run already has an error.
    pub(super) fn not_begun(&self, run: &RunSummary, failure: &str) {
        let log = self.log();
        for input in &run.inputs {
            let path = self.stat_log(&input.stem);
            let Some(path) = path.filter(|path| is_in_folder(path)) else { continue };
            if let Err(error) = report::write_stat_log(&path, run, input, log.as_slice(), Some(failure)) {
                tracing::warn!("cannot write the statistics of the failed run: {error}");
            }
        }
    }

    /// Writes the trace of a profiled run.
    ///
    /// # Errors
    /// If it cannot be written.
    pub(super) fn write_trace(&self, run: &RunSummary) -> Result<()> {
        if let Some(path) = self.of_name(TRACE).filter(|_| self.profile) {
            let mut file = OutputFile::create(&path)?;
            engine::write_trace(run, &mut file).map_err(Error::io(&path, "write the trace"))?;
            file.finish()?.publish()?;
        }
        Ok(())
    }

    /// Report of the run so far.
    pub(super) fn report<'r>(&'r self, run: &'r RunSummary) -> RunReport<'r> {
        RunReport { run, inputs: &self.entries }
    }

    /// Files written for the run, and for its inputs.
    pub(super) fn written(&self, run: &RunSummary) -> [Vec<PathBuf>; 2] {
        let was_run = |input: &&InputSummary| matches!(input.status, InputStatus::Done | InputStatus::Failed);
        let inputs: Vec<&InputSummary> = run.inputs.iter().filter(was_run).collect();
        let mut of_run = if inputs.is_empty() { Vec::from_iter(self.log()) } else { self.of_run() };
        if let Some(survey) = &self.survey {
            let requested = self.survey_page().map(|page| SurveyFiles::of_page(&page)).unwrap_or_default();
            of_run.retain(|path| !requested.contains(path));
            of_run.extend_from_slice(survey.written());
        }
        let is_done = |input: &&&InputSummary| input.status == InputStatus::Done;
        let of_strip = |input: &&InputSummary| Some(self.survey.as_ref()?.of_input(&input.stem));
        let of_strips = inputs.iter().filter(is_done).filter_map(of_strip).flatten();
        let stat_logs = inputs.iter().filter_map(|input| self.stat_log(&input.stem));
        // A strip without cells has no raster.
        [of_run, stat_logs.chain(of_strips.filter(|path| path.exists())).collect()]
    }

    /// Entries of the report.
    pub(super) fn into_entries(self) -> Vec<InputEntry> {
        self.entries
    }

    /// The file that describes a failed run: its report, or its log if no input was begun.
    pub(super) fn of_failed(&self, run: &RunSummary) -> Option<EndMessage> {
        let [of_run, _] = self.written(run);
        let report = self.of_name(&self.settings.report).filter(|report| of_run.contains(report));
        let found = [("report", report), ("log", self.log())].into_iter();
        let (what, path) =
            found.filter_map(|(what, path)| Some((what, path?))).find(|(_, path)| path.exists())?;
        Some(EndMessage::File(format!("{what} of the failed run: {}", shown(&path).display())))
    }

    /// The next command for the user.
    pub(super) fn next(&self, job: &Job) -> Option<EndMessage> {
        ending::next(job, &self.output_dir, self.of_name(&self.settings.report).as_deref())
    }
}

/// Whether the folder of a file exists, or cannot be inspected: writing the file then shows why.
fn is_in_folder(path: &Path) -> bool {
    let about = path.parent().map(std::fs::metadata);
    about.is_some_and(|about| {
        about.map_or_else(|error| error.kind() != ErrorKind::NotFound, |about| about.is_dir())
    })
}
