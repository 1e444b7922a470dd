//! `wavex run`: reads and runs a job.

use std::fmt::Write as _;
use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::{Failure, JobArgs, Machine, When, log, terminal};
use crate::archive::{Recorder, check_destination};
use crate::engine::{
    self, Cancel, Cause, FailedRun, InputSummary, Options, ProgressMode, RunError, RunSummary,
};
use crate::georef::check_crs;
use crate::job::{Job, Override};
use crate::report::{self, Overviews, RunReport};
use crate::stage::{
    OutputFile, OutputLock, Outputs, RunObserver, StageError, counted, fixed_folder, release_all,
    remove_unfinished_files,
};
use wavex_formats::Error;

/// Trace that `--profile` writes to the output folder.
const TRACE: &str = "trace.json";

/// Reads and runs the job; `archive` names the archive to make.
pub(super) fn run(
    args: &JobArgs,
    machine: Machine,
    archive: Option<&Path>,
    quiet: bool,
) -> Result<(), Failure> {
    let job = args.read(machine.overrides())?;
    if let Some(archive) = archive {
        check_destination(archive).map_err(|error| Failure::Wrong(error.to_string()))?;
    }
    run_archived(&job, &args.folder(), machine, archive, quiet).map(drop)
}

/// Runs a job whose relative paths start at `folder`.
pub(super) fn run_job(
    job: &Job,
    folder: &Path,
    machine: Machine,
    quiet: bool,
) -> Result<RunSummary, Failure> {
    run_archived(job, folder, machine, None, quiet)
}

fn run_archived(
    job: &Job,
    folder: &Path,
    machine: Machine,
    archive: Option<&Path>,
    quiet: bool,
) -> Result<RunSummary, Failure> {
    for note in &job.notes {
        tracing::warn!("{note}");
    }
    let (input_dir, output_dir) = folders(job, folder);
    check_crs(&job.settings.geometry, &input_dir).map_err(|error| Failure::Wrong(error.to_string()))?;
    let failed = |error: &dyn std::fmt::Display| Failure::Run(error.to_string());
    // Claim the outputs before opening the log, which would truncate the log of another run.
    let own = own_outputs(job, [&input_dir, &output_dir], machine.profile, archive);
    let _lock = OutputLock::acquire(&own).map_err(|error| failed(&error))?;
    if archive.is_some() {
        log::keep();
    }
    if !job.settings.log.is_empty() {
        log::to_file(&output_dir.join(&job.settings.log)).map_err(|error| failed(&error))?;
    }
    tracing::info!("wavex {}: {} ({})", env!("CARGO_PKG_VERSION"), job.name, job.chain());
    for (name, words) in report::geometry_words(&job.settings.geometry) {
        tracing::info!("{name}: {words}");
    }
    let overviews = (!job.settings.report_page.is_empty()).then(|| Arc::new(Overviews::default()));
    let observer = overviews.clone().map(|overviews| overviews as Arc<dyn RunObserver>);
    let options = Options {
        observer,
        profile: machine.profile,
        progress: machine.progress(quiet, std::io::stderr().is_terminal()),
        ..Options::of_job(job, input_dir, &output_dir)
    };
    stop_on_signals(&options.cancel);
    // Open these files early: problems with them should be reported before the run, not after it.
    let begin = |name: &str| match name {
        "" => Ok(None),
        name => OutputFile::create(&output_dir.join(name)).map(Some).map_err(|error| failed(&error)),
    };
    let (report_file, page_file) = (begin(&job.settings.report)?, begin(&job.settings.report_page)?);
    let logged = |error: &dyn std::fmt::Display| {
        log::fatal(error);
        failed(error)
    };
    let recorder = archive.map(|archive| Recorder::begin(job, &options, archive)).transpose();
    let recorder = recorder.map_err(|error| logged(&error))?;
    let archived = recorder.as_ref().map(|recorder| recorder.job(job)).transpose();
    let archived = archived.map_err(|error| logged(&error))?;
    let run = engine::run_or_report(archived.as_ref().unwrap_or(job), &options);
    let mut run = run.map_err(|failed| {
        let FailedRun { error, mut summary, unfinished } = *failed;
        summary.inputs.extend(unfinished);
        if let Some(recorder) = &recorder {
            recorder.strip(&mut summary);
        }
        ended_with(&error, &summary, &output_dir)
    })?;
    if let Some(recorder) = &recorder {
        recorder.strip(&mut run);
    }
    let overviews = overviews.map_or_else(Vec::new, |overviews| overviews.take());
    let report = RunReport::new(&run, &overviews);
    let finish = || {
        let own = write_own(&report, report_file, page_file, machine.profile, &output_dir)?;
        for (note, inputs) in run.repeated_notes() {
            tracing::warn!("{inputs} of {} inputs: {note}", run.inputs.len());
        }
        let mut said = summary(&run, &own, machine.profile);
        if let (Some(recorder), Some(archive)) = (recorder, archive) {
            let text = report.to_json().map_err(std::io::Error::from);
            let text = text.map_err(Error::io(archive, "write the report"))?;
            let seal = recorder.finish(&run, text, &log::kept())?;
            let _ = writeln!(said, "archived in {}; seal {seal}", archive.display());
        }
        Ok(said)
    };
    let said = finish().map_err(|error: StageError| ended_with(&error, &run, &output_dir))?;
    if !quiet {
        terminal::print(&said)?;
    }
    Ok(run)
}

/// Writes the files of the run as a whole and the statistics of each input.
///
/// Returns the paths.
fn write_own(
    report: &RunReport,
    report_file: Option<OutputFile>,
    page_file: Option<OutputFile>,
    profile: bool,
    output_dir: &Path,
) -> Result<Vec<PathBuf>, StageError> {
    let (run, mut own) = (report.run, Vec::new());
    if let Some(file) = report_file {
        own.push(file.path().to_owned());
        report.write_json(file)?;
    }
    if let Some(file) = page_file {
        own.push(file.path().to_owned());
        report.write_page(file)?;
    }
    if profile {
        own.push(output_dir.join(TRACE));
        write_trace(run, &output_dir.join(TRACE))?;
    }
    if !run.job.log.is_empty() {
        own.push(output_dir.join(&run.job.log));
    }
    let mut stat_logs = Vec::new();
    for input in run.inputs.iter().filter(|_| !run.job.stat_log.is_empty()) {
        stat_logs.push(report::write_stat_log(
            &stat_log_path(run, input, output_dir),
            run,
            input,
            &own,
            None,
        )?);
    }
    own.extend(stat_logs);
    Ok(own)
}

/// Files that a run writes besides the outputs of its stages.
///
/// The engine claims the outputs of the stages.
fn own_outputs(
    job: &Job,
    [input_dir, output_dir]: [&Path; 2],
    profile: bool,
    archive: Option<&Path>,
) -> Outputs {
    let settings = &job.settings;
    // The engine reports inputs that cannot be found.
    let inputs = engine::inputs(job, input_dir).unwrap_or_default();
    let stat_logs = inputs.iter().map(|input| settings.stat_log.replace('*', &input.stem));
    let of_run = [&settings.log, &settings.report, &settings.report_page];
    let others = of_run.into_iter().cloned().chain(stat_logs);
    let names = others.chain(profile.then(|| TRACE.to_owned())).filter(|name| !name.is_empty());
    let mut outputs = Outputs::new();
    for name in names {
        outputs.entry(fixed_folder(output_dir, &name)).or_default().insert(output_dir.join(name));
    }
    if let Some(archive) = archive {
        let folder = fixed_folder(Path::new(""), &archive.to_string_lossy());
        let path = folder.join(archive.file_name().unwrap_or_default());
        outputs.entry(folder).or_default().insert(path);
    }
    outputs
}

/// Ends the run in order on Ctrl-C or a termination request.
///
/// Every stage completes its current line first. A second signal ends the process at once.
pub(super) fn stop_on_signals(cancel: &Cancel) {
    let cancel = cancel.clone();
    let handler = move || {
        if cancel.is_cancelled() {
            remove_unfinished_files();
            release_all();
            let error = RunError { stage: None, input: None, cause: Cause::Interrupted };
            let interrupted = Failure::Run(error.to_string());
            terminal::print_error(&interrupted.message(terminal::colour()));
            std::process::exit(interrupted.exit_code().into());
        }
        cancel.cancel();
    };
    if let Err(error) = ctrlc::set_handler(handler) {
        tracing::debug!("cannot install the signal handler: {error}");
    }
}

/// Path of the statistics of an input.
fn stat_log_path(run: &RunSummary, input: &InputSummary, output_dir: &Path) -> PathBuf {
    output_dir.join(run.job.stat_log.replace('*', &input.stem))
}

/// Logs the error of a failed run and writes the statistics of its inputs.
///
/// Statistics are written if their folder exists. Errors in writing them are only logged, because
/// the run already has an error.
fn ended_with(error: &dyn std::fmt::Display, run: &RunSummary, output_dir: &Path) -> Failure {
    let failure = error.to_string();
    log::fatal(&failure);
    let job = &run.job;
    let log = Some(&job.log).filter(|log| !log.is_empty()).map(|log| output_dir.join(log));
    for input in run.inputs.iter().filter(|_| !job.stat_log.is_empty()) {
        let path = stat_log_path(run, input, output_dir);
        if !path.parent().is_some_and(Path::is_dir) {
            continue;
        }
        let written = report::write_stat_log(&path, run, input, log.as_slice(), Some(&failure));
        if let Err(error) = written {
            tracing::warn!("cannot write the statistics of the failed run: {error}");
        }
    }
    Failure::Run(failure)
}

fn write_trace(run: &RunSummary, path: &Path) -> Result<(), StageError> {
    let mut file = OutputFile::create(path)?;
    engine::write_trace(run, &mut file).map_err(Error::io(path, "write the trace"))?;
    file.finish()?.publish()?;
    Ok(())
}

/// Summary for the user: times, rejections and outputs of each input.
///
/// `own` are the files of the run as a whole.
fn summary(run: &RunSummary, own: &[PathBuf], profile: bool) -> String {
    let mut text = String::new();
    for input in &run.inputs {
        let totals = |name: &str| input.totals.get(name).copied().unwrap_or(0);
        let (waveforms, returns) = (totals("nw"), totals("np"));
        let _ =
            writeln!(text, "{}: {waveforms} waveforms, {returns} returns, {:.1} s", input.stem, input.wall_s);
        text.push_str(&report::stage_table(input));
        if profile {
            text.push_str(&report::latency_table(input));
        }
        for stage in &input.stages {
            for (what, n) in &stage.rejected {
                let _ = writeln!(text, "{}: rejected {}", stage.id, counted(*n, what));
            }
        }
        wrote(&mut text, &input.outputs);
    }
    wrote(&mut text, own);
    text
}

fn wrote(text: &mut String, paths: &[PathBuf]) {
    for path in paths {
        let path = terminal::shown(path);
        tracing::info!("wrote {}", path.display());
        let _ = writeln!(text, "wrote {}", path.display());
    }
}

/// Input and output folders of a job stored in `folder`.
pub(super) fn folders(job: &Job, folder: &Path) -> (PathBuf, PathBuf) {
    let from = |dir: &Option<String>| dir.as_ref().map_or(folder.to_path_buf(), |dir| folder.join(dir));
    (from(&job.settings.input_dir), from(&job.settings.output_dir))
}

impl Machine {
    /// Job keys set by these arguments.
    pub(super) fn overrides(self) -> Option<Override> {
        self.threads.map(|threads| Override::new(format!("job.threads={threads}")))
    }

    fn progress(self, quiet: bool, on_terminal: bool) -> ProgressMode {
        self.progress.mode(quiet, on_terminal)
    }
}

impl When {
    /// Progress display for this setting.
    pub(super) fn mode(self, quiet: bool, on_terminal: bool) -> ProgressMode {
        match self {
            _ if quiet => ProgressMode::Hidden,
            When::Never => ProgressMode::Hidden,
            When::Always => ProgressMode::Bar,
            When::Auto if on_terminal => ProgressMode::Bar,
            When::Auto => ProgressMode::Lines,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::job::JobSettings;

    #[test]
    fn folders_start_at_the_job() {
        let dirs = |input: Option<&str>, output: Option<&str>| {
            let settings = JobSettings {
                input_dir: input.map(str::to_owned),
                output_dir: output.map(str::to_owned),
                ..JobSettings::default()
            };
            folders(&Job { settings, ..Job::default() }, Path::new("jobs"))
        };
        assert_eq!(dirs(None, None), ("jobs".into(), "jobs".into()));
        assert_eq!(dirs(Some("in"), Some("/data/out")), ("jobs/in".into(), "/data/out".into()));
    }

    #[test]
    fn a_bar_is_for_terminals() {
        let shown = |progress, quiet, on_terminal| {
            Machine { threads: None, profile: false, progress }.progress(quiet, on_terminal)
        };
        assert_eq!(shown(When::Auto, false, true), ProgressMode::Bar);
        assert_eq!(shown(When::Auto, false, false), ProgressMode::Lines);
        assert_eq!(shown(When::Always, false, false), ProgressMode::Bar);
        assert_eq!(shown(When::Never, false, true), ProgressMode::Hidden);
        assert_eq!(shown(When::Always, true, true), ProgressMode::Hidden);
    }

    #[test]
    fn threads_of_the_command_line_are_the_jobs() {
        let machine = Machine { threads: Some(3), profile: false, progress: When::Auto };
        assert_eq!(machine.overrides(), Some(Override::new("job.threads=3")));
    }
}
