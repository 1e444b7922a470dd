//! A job that starts from the returns files of an earlier run, without decomposing again.

use std::path::{Path, PathBuf};

use crate::Failure;
use crate::run::folders;
use wavex_engine::engine;
use wavex_engine::job::{Job, JobStage};
use wavex_line::stage::{ChainStage, Plan};
use wavex_stages::registry::STAGES;
use wavex_stages::returns_file::Identity;

/// Name of the stage that writes returns files.
const WRITER: &str = "write_returns";

/// Whether a job writes returns files.
pub fn writes_returns(job: &Job) -> bool {
    job.stages.iter().any(|stage| stage.spec.name == WRITER)
}

/// The job with `read_returns` instead of all stages up to `write_returns`; `folder` is that of the job file.
///
/// It reads the files that `write_returns` has written for the inputs of the job.
///
/// # Errors
/// The job has no `write_returns`, or a sink that needs waveforms or lines before it. A file is missing, damaged, or was made
/// from another recording, by other stages or another version of wavex.
pub fn from_returns(job: &Job, folder: &Path) -> Result<Job, Failure> {
    let wrong = |problem: String| Failure::Wrong(format!("{}: {problem}", job.name));
    let Some(at) = job.stages.iter().position(|stage| stage.spec.name == WRITER) else {
        return Err(wrong(
            "the job has no stage `write_returns`, whose files could be read; add it after `decompose`, and run the job once"
                .to_owned(),
        ));
    };
    let (before, after) = (&job.stages[..at], &job.stages[at + 1..]);
    if let Some(stage) = before.iter().find(|stage| matches!(stage.planned.plan, Plan::Sink(_))) {
        return Err(wrong(format!(
            "`{}` is before `write_returns` and would not be written again; move it after `write_returns`, remove it, or run \
             the job without `--from-returns`",
            stage.id
        )));
    }
    if let Some(stage) = after.iter().find(|stage| stage.planned.plan.needs_waveforms()) {
        return Err(wrong(format!(
            "`{}` writes waveforms, which returns files do not have; set `wave_packets = \"none\"`, or run the job without \
             `--from-returns`",
            stage.id
        )));
    }
    let files = files(job, folder, &job.stages[at])?;
    let path = toml::Value::Array(files.into_iter().map(toml::Value::String).collect());
    let text = format!("[[stage]]\ntype = \"read_returns\"\npath = {path}\n");
    let reader =
        Job::parse(STAGES, &job.name, &text, &[]).map_err(|errors| Failure::Wrong(errors.to_string()))?;
    let stages: Vec<JobStage> = reader.stages.into_iter().chain(after.iter().cloned()).collect();
    Ok(Job { stages, ..job.clone() })
}

/// Absolute paths of the returns files of all inputs, after they were compared with the job.
fn files(job: &Job, folder: &Path, writer: &JobStage) -> Result<Vec<String>, Failure> {
    let failed = |error: &dyn std::fmt::Display| Failure::Run(error.to_string());
    let (input_dir, output_dir) = folders(job, folder);
    let output_dir = std::path::absolute(&output_dir).map_err(|error| failed(&error))?;
    let inputs = engine::inputs(job, &input_dir).map_err(|error| failed(&error))?;
    let chain: Vec<ChainStage> =
        job.stages.iter().map(|stage| stage.planned.in_chain(stage.spec.name)).collect();
    let pattern = writer.planned.plan.outputs().first().copied().unwrap_or_default().to_owned();
    let paths = inputs.iter().map(|input| output_dir.join(pattern.replace('*', &input.stem)));
    let paths: Vec<PathBuf> = paths.collect();
    let missing: Vec<String> =
        paths.iter().filter(|path| !path.is_file()).map(|path| path.display().to_string()).collect();
    if let Some(first) = missing.first() {
        let more = if missing.len() > 1 { format!(" and {} more", missing.len() - 1) } else { String::new() };
        return Err(Failure::Run(format!(
            "{first}{more}: no such returns file; run the job without `--from-returns` first (`--resume` skips complete inputs)"
        )));
    }
    let settings = Identity::of(&chain, Path::new(""), &input_dir).map_err(|error| failed(&error))?;
    for (input, path) in inputs.iter().zip(&paths) {
        let then = Identity::read(path).map_err(|error| failed(&error))?;
        let recording = match input.path.is_file() {
            true => Some(
                wavex_stages::returns_file::recording_digest(&input.path).map_err(|error| failed(&error))?,
            ),
            false => None,
        };
        if let Some(difference) = then.difference(&Identity { recording, ..settings.clone() }) {
            return Err(Failure::Run(format!(
                "{}: cannot be used for this job: {difference}; run the job without `--from-returns`",
                path.display()
            )));
        }
    }
    let text = |path: PathBuf| path.into_os_string().into_string();
    let texts: Result<Vec<String>, _> = paths.into_iter().map(text).collect();
    texts.map_err(|path| {
        Failure::Run(format!("{}: the name is not Unicode; rename the folder", path.display()))
    })
}
