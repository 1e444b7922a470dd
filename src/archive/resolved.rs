//! A job as it was run, in a form that runs anywhere: every default spelled out, every path relative.

use std::borrow::Cow;
use std::fs;
use std::path::{Path, PathBuf};

use serde_json::{Map, Value, json};

use super::inputs;
use super::paths::{common, plain, relative};
use crate::engine::{self, Input, Options};
use crate::formats::Error;
use crate::job::{Job, JobStage, Simd};
use crate::stage::{FileMark, Paths, Plan, Result, StageError};

/// A job with its files by their paths below two folders.
#[derive(Debug)]
pub(super) struct Resolved {
    /// `job.resolved.toml`.
    pub text: String,
    /// The folder that holds all inputs.
    pub input_root: PathBuf,
    /// The folder that holds all outputs.
    pub output_root: PathBuf,
    /// Every file that is read.
    pub inputs: Vec<PathBuf>,
    /// Every file that a stage may write, with the stage.
    pub outputs: Vec<(PathBuf, String)>,
}

/// Where the paths of a job start, all absolute.
struct Roots {
    input_dir: PathBuf,
    input_root: PathBuf,
    output_dir: PathBuf,
    output_root: PathBuf,
}

impl Resolved {
    /// The job as these options run it; its own folders are told as seen from `archive`.
    ///
    /// # Errors
    /// An input is missing, or standard input; a path is no Unicode.
    pub(super) fn new(job: &Job, options: &Options, archive: &Path) -> Result<Resolved> {
        let input_dir = absolute(&options.input_dir)?;
        fs::create_dir_all(&options.output_dir).map_err(Error::io(&options.output_dir, "make the folder"))?;
        let output_dir = absolute(&options.output_dir)?;
        let sources = engine::inputs(job, &input_dir).map_err(|error| error.into_stage_error())?;
        if sources.iter().any(|input| input.path == Path::new("-")) {
            let remedy = "save it as a file, and give that to the reader";
            return Err(StageError::failed("standard input cannot be archived", remedy));
        }
        let mut settings = job.settings.clone();
        settings.geometry.spell_out();
        let settings = serde_json::to_value(&settings).unwrap_or(Value::Null);
        let files: Vec<PathBuf> = inputs::of_job(job, &settings, &sources, &input_dir).into_iter().collect();
        let outputs = outputs_of(job, &sources, &output_dir);
        let roots = Roots {
            input_root: root(&input_dir, files.iter().map(PathBuf::as_path)),
            output_root: root(&output_dir, outputs.iter().map(|(path, _)| path.as_path())),
            input_dir,
            output_dir,
        };
        let job_table = roots.settings(settings, options, archive)?;
        let stages: Result<Vec<Value>> =
            job.stages.iter().map(|stage| roots.stage(stage, &sources)).collect();
        let text = toml::to_string_pretty(&without_null(json!({"job": job_table, "stage": stages?})))
            .map_err(|error| defect(&error))?;
        let text = format!(
            "# The job {:?} as wavex {} ran it: every default spelled out that hangs on no data, every path relative.\n\n{text}",
            name_of(&job.name),
            env!("CARGO_PKG_VERSION")
        );
        Job::parse(super::RESOLVED, &text, &[]).map_err(|errors| defect(&errors))?;
        Ok(Resolved {
            text,
            input_root: roots.input_root,
            output_root: roots.output_root,
            inputs: files,
            outputs,
        })
    }
}

/// What a job is called without the folders that are this machine's.
fn name_of(job: &str) -> Cow<'_, str> {
    match Path::new(job) {
        path if path.is_absolute() => path.file_name().unwrap_or_default().to_string_lossy(),
        _ => job.into(),
    }
}

fn defect(error: &dyn std::fmt::Display) -> StageError {
    StageError::failed(format!("the job cannot be archived: {error}"), "report this as a defect of wavex")
}

/// A folder that exists, from the root of the file system.
fn absolute(folder: &Path) -> Result<PathBuf> {
    Ok(folder.canonicalize().map_err(Error::io(folder, "find the folder"))?)
}

/// The job's own folder where all files lie below it, else the deepest that holds them all.
fn root<'p>(own: &Path, files: impl Iterator<Item = &'p Path> + Clone) -> PathBuf {
    if files.clone().all(|file| file.starts_with(own)) {
        return own.to_owned();
    }
    common(files.filter_map(Path::parent)).unwrap_or_else(|| own.to_owned())
}

/// Every file that a stage may write, with the stage.
fn outputs_of(job: &Job, sources: &[Input], output_dir: &Path) -> Vec<(PathBuf, String)> {
    let of_stage = |stage: &JobStage| -> Vec<(PathBuf, String)> {
        let patterns = stage.planned.plan.outputs();
        let file = |input: &Input, pattern: &str| plain(&output_dir.join(pattern.replace('*', &input.stem)));
        let of_input = |input| patterns.iter().map(move |pattern| (file(input, pattern), stage.id.clone()));
        sources.iter().flat_map(of_input).collect()
    };
    job.stages.iter().flat_map(of_stage).collect()
}

impl Roots {
    /// A text of the job that names inputs, as seen from the folder of all inputs.
    fn input(&self, text: &str) -> Result<String> {
        way(&self.input_root, &plain(&self.input_dir.join(text)))
    }

    /// The same for outputs.
    fn output(&self, text: &str) -> Result<String> {
        way(&self.output_root, &plain(&self.output_dir.join(text)))
    }

    /// The table `[job]`.
    fn settings(&self, mut settings: Value, options: &Options, archive: &Path) -> Result<Value> {
        for pointer in inputs::pointers(&settings, &self.input_dir) {
            if let Some(Value::String(text)) = settings.pointer_mut(&pointer) {
                *text = self.input(text)?;
            }
        }
        // Without a folder of their own, geoids lie in that of the inputs.
        inputs::place_geoid(&mut settings, |folder| self.input(folder))?;
        for pointer in inputs::marked(FileMark::Output) {
            if let Some(Value::String(text)) = settings.pointer_mut(&pointer)
                && !text.is_empty()
            {
                *text = self.output(text)?;
            }
        }
        if let Some(table) = settings.as_object_mut() {
            // What the files say stands in the job itself now.
            table.retain(|key, _| key != "include");
        }
        settings["input_dir"] = json!(way(archive, &self.input_root)?);
        settings["output_dir"] = json!(way(archive, &self.output_root)?);
        settings["threads"] = json!(options.workers());
        settings["simd"] = json!(Simd::from(options.simd));
        Ok(settings)
    }

    /// A table `[[stage]]`.
    fn stage(&self, stage: &JobStage, sources: &[Input]) -> Result<Value> {
        let mut table = Map::new();
        table.insert("type".to_owned(), json!(stage.spec.name));
        table.insert("id".to_owned(), json!(stage.id));
        let keys = stage.planned.resolved.as_object().into_iter().flatten();
        table.extend(keys.map(|(key, value)| (key.clone(), value.clone())));
        stage.planned.local_keys.iter().for_each(|key| {
            table.remove(*key);
        });
        for text in &stage.planned.inputs {
            replace(&mut table, text, &self.input(text)?);
        }
        for text in stage.planned.plan.outputs() {
            replace(&mut table, text, &self.output(text)?);
        }
        if let Plan::Source(source) = &stage.planned.plan
            && let Some(paths) = source.paths()
        {
            let files: Result<Vec<String>> =
                sources.iter().map(|input| self.input_file(&input.path)).collect();
            // A pattern would find other files another day.
            if let Some((_, value)) = table.iter_mut().find(|(_, value)| **value == json!(paths)) {
                *value = match (paths, files?.as_slice()) {
                    (Paths::One(_), [only]) => json!(only),
                    (_, files) => json!(files),
                };
            }
        }
        Ok(Value::Object(table))
    }

    fn input_file(&self, path: &Path) -> Result<String> {
        way(&self.input_root, &plain(&self.input_dir.join(path)))
    }
}

/// The way from a folder to a path.
fn way(from: &Path, to: &Path) -> Result<String> {
    relative(from, to).ok_or_else(|| {
        let problem = format!("{}: there is no relative path to this from {}", to.display(), from.display());
        StageError::failed(problem, "put both on one drive, under names in Unicode")
    })
}

/// Replaces a text wherever it stands as a value.
fn replace(table: &mut Map<String, Value>, from: &str, to: &str) {
    for value in table.values_mut() {
        match value {
            Value::String(text) if text == from => to.clone_into(text),
            Value::Object(inner) => replace(inner, from, to),
            _ => {}
        }
    }
}

/// The same without nulls, which TOML does not have: what is null is not given.
fn without_null(value: Value) -> Value {
    match value {
        Value::Object(table) => {
            let given = table.into_iter().filter(|(_, value)| !value.is_null());
            Value::Object(given.map(|(key, value)| (key, without_null(value))).collect())
        }
        Value::Array(items) => Value::Array(items.into_iter().map(without_null).collect()),
        other => other,
    }
}
