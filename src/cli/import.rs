//! `wavex import`: translates command lines of BayesWavEx into jobs.

use std::path::Path;

use clap::Parser;

use super::{Cli, Failure, ImportArgs, MachineArgs, When, dispatch, run, terminal};
use wavex_classic::draft::Known;
use wavex_classic::options::Flag;
use wavex_classic::{Import, Place, THE_JOB, import};
use wavex_engine::job::Job;
use wavex_formats::read_small_text;
use wavex_formats::trajectory::{self, Records};
use wavex_run::run::RunRequest;
use wavex_stages::registry::STAGES;

/// Maximum size of a file that a command line reads: options, mounting angles; bytes.
const LARGEST_FILE: u64 = 1_000_000;

/// Translates a line and prints, writes or runs the result.
pub(super) fn run_import(args: &ImportArgs, quiet: bool) -> Result<(), Failure> {
    let folder =
        args.output.as_deref().and_then(Path::parent).filter(|folder| !folder.as_os_str().is_empty());
    let base = match folder {
        None => None,
        Some(_) => {
            let here = std::env::current_dir();
            let here = here
                .map_err(|error| Failure::Wrong(format!("cannot determine the current folder: {error}")))?;
            Some(here.display().to_string())
        }
    };
    let classic = args.classic.map(super::Classic::name);
    let known = Known::this_build();
    let place = Place { known: &known, base: base.as_deref(), read: &read, latitude: &latitude };
    let import = import(&args.line, classic, &place).map_err(Failure::Wrong)?;
    let job = match import.has_job {
        true => Some(Job::parse(STAGES, THE_JOB, &import.text, &[])?),
        false => None,
    };
    match &args.output {
        Some(_) if job.is_none() => {
            return Err(Failure::Wrong(format!(
                "this command line makes no job, so `-o` has nothing to write:\n{}",
                import.text
            )));
        }
        Some(file) => super::init::write_new(file, &import.text)?,
        None if !args.run => terminal::print(&import.text)?,
        None => {}
    }
    for what in &import.missing {
        tracing::warn!("not supported by this build: {what}");
    }
    for what in &import.obstacles {
        tracing::warn!("{what}");
    }
    if args.run { run_all(&import, job, folder, quiet) } else { Ok(()) }
}

/// Content of a small file; `None` if it cannot be read or is larger than [`LARGEST_FILE`].
fn read(path: &str) -> Option<String> {
    read_small_text(Path::new(path), LARGEST_FILE, "options", "").ok()
}

/// Latitude of the first trajectory record, degrees.
///
/// `None` if the trajectory cannot be read or has map coordinates.
fn latitude(file: &str, columns: Option<&str>) -> Option<f64> {
    let options = trajectory::Options { columns: columns.map(str::to_owned), ..Default::default() };
    match trajectory::read(Path::new(file), &options).ok()?.records {
        Records::Geodetic(samples) => samples.first().map(|sample| sample.place.latitude_rad.to_degrees()),
        Records::Projected(_) => None,
    }
}

/// Runs the job and the commands, or reports what prevents it.
fn run_all(import: &Import, job: Option<Job>, folder: Option<&Path>, quiet: bool) -> Result<(), Failure> {
    if !import.obstacles.is_empty() {
        let what = import.obstacles.join("; ");
        return Err(Failure::Wrong(format!("not run: {what}")));
    }
    if !import.missing.is_empty() {
        let what = import.missing.join(", ");
        return Err(Failure::Wrong(format!(
            "not run: this build does not support {what}; omit these options, or write the job with `-o` \
             and edit it"
        )));
    }
    if job.is_none() && import.commands.is_empty() {
        return terminal::print(&import.text);
    }
    let quiet = quiet || import.flags.contains(&Flag::Quiet);
    let progress = if import.flags.contains(&Flag::NoProgress) { When::Never } else { When::Auto };
    if let Some(job) = job {
        let machine = MachineArgs { threads: None, profile: false, progress };
        run::run_job(RunRequest::quiet(&job, folder.unwrap_or(Path::new("."))), machine, quiet)?;
    }
    super::do_all(import.commands.iter().map(|words| command(words, quiet)))
}

/// Runs a `wavex` command line in this process.
fn command(words: &[String], quiet: bool) -> Result<(), Failure> {
    let words = words.iter().map(String::as_str).chain(quiet.then_some("--quiet"));
    match Cli::try_parse_from(words) {
        Ok(cli) => dispatch(cli),
        Err(answer) if !answer.use_stderr() => terminal::print(&answer.render().to_string()),
        Err(problem) => Err(Failure::Wrong(problem.render().to_string())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_of_translated_lines_are_those_of_this_program() {
        let known = Known::this_build();
        let place = Place { known: &known, base: None, read: &|_| None, latitude: &|_, _| None };
        for line in ["-i a.sdf b.sdf -osdfstat -name s", "-sdfscanfast -i a.sdf", "-i a.sdf -po a.pof -ostat"]
        {
            let words: Vec<String> = line.split(' ').map(str::to_owned).collect();
            let import = import(&words, Some("1.1"), &place).unwrap();
            assert!(!import.commands.is_empty(), "{line}");
            for words in import.commands {
                if let Err(answer) = Cli::try_parse_from(&words) {
                    assert!(!answer.use_stderr(), "{words:?}: {answer}");
                }
            }
        }
    }
}
