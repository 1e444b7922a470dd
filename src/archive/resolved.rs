//! The job as run, in portable form: all defaults written out, all paths relative.

use std::borrow::Cow;
use std::fs;
use std::path::{Path, PathBuf};

use serde_json::{Map, Value, json};

use super::inputs;
use super::paths::{common, plain, relative};
use crate::engine::{self, Input, Options};
use crate::job::{Job, JobStage, Simd};
use crate::keys::FileMark;
use crate::stage::{Paths, Plan, Result, StageError};
use wavex_formats::Error;

/// A portable job with its files.
#[derive(Debug)]
pub(super) struct Resolved {
    /// `job.resolved.toml`.
    pub text: String,
    /// Folder that contains all inputs.
    pub input_root: PathBuf,
    /// Folder that contains all outputs.
    pub output_root: PathBuf,
    /// All files that are read.
    pub inputs: Vec<PathBuf>,
    /// All files that stages may write, with the id of the stage.
    pub outputs: Vec<(PathBuf, String)>,
}

/// Absolute folders at which the paths of a job start.
struct Roots {
    input_dir: PathBuf,
    input_root: PathBuf,
    output_dir: PathBuf,
    output_root: PathBuf,
}

impl Resolved {
    /// Resolves the job as these options run it; its folders are relative to `archive`.
    ///
    /// # Errors
    /// If an input is missing or standard input, or a path is not valid Unicode.
    pub(super) fn new(job: &Job, options: &Options, archive: &Path) -> Result<Resolved> {
        let input_dir = absolute(&options.input_dir)?;
        fs::create_dir_all(&options.output_dir)
            .map_err(Error::io(&options.output_dir, "create the folder"))?;
        let output_dir = absolute(&options.output_dir)?;
        let sources = engine::inputs(job, &input_dir).map_err(|error| error.into_stage_error())?;
        if sources.iter().any(|input| input.path == Path::new("-")) {
            let remedy = "save it to a file and read that file";
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
            "# Job {:?} as run by wavex {}: all data-independent defaults written out, all paths relative.\n\n{text}",
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

/// Name of a job without folders of this machine.
fn name_of(job: &str) -> Cow<'_, str> {
    match Path::new(job) {
        path if path.is_absolute() => path.file_name().unwrap_or_default().to_string_lossy(),
        _ => job.into(),
    }
}

fn defect(error: &dyn std::fmt::Display) -> StageError {
    StageError::failed(format!("the job cannot be archived: {error}"), "please report this bug in wavex")
}

/// Absolute path of an existing folder.
fn absolute(folder: &Path) -> Result<PathBuf> {
    Ok(folder.canonicalize().map_err(Error::io(folder, "find the folder"))?)
}

/// The job's own folder if it contains all files, else their deepest common folder.
fn root<'p>(own: &Path, files: impl Iterator<Item = &'p Path> + Clone) -> PathBuf {
    if files.clone().all(|file| file.starts_with(own)) {
        return own.to_owned();
    }
    common(files.filter_map(Path::parent)).unwrap_or_else(|| own.to_owned())
}

/// All files that stages may write, with the id of the stage.
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
    /// Path of an input, relative to the folder of all inputs.
    fn input(&self, text: &str) -> Result<String> {
        way(&self.input_root, &plain(&self.input_dir.join(text)))
    }

    /// Path of an output, relative to the folder of all outputs.
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
        // Without a folder of their own, geoids are in the input folder.
        inputs::place_geoid(&mut settings, |folder| self.input(folder))?;
        for pointer in inputs::marked(FileMark::Output) {
            if let Some(Value::String(text)) = settings.pointer_mut(&pointer)
                && !text.is_empty()
            {
                *text = self.output(text)?;
            }
        }
        if let Some(table) = settings.as_object_mut() {
            // The contents of included files are now part of the job.
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
            // Replace patterns: they could match other files later.
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

/// Path from a folder to a file.
fn way(from: &Path, to: &Path) -> Result<String> {
    relative(from, to).ok_or_else(|| {
        let problem = format!("{}: no relative path from {}", to.display(), from.display());
        StageError::failed(problem, "put both on one drive and use Unicode names")
    })
}

/// Replaces a text in all values of a table.
fn replace(table: &mut Map<String, Value>, from: &str, to: &str) {
    for value in table.values_mut() {
        match value {
            Value::String(text) if text == from => to.clone_into(text),
            Value::Object(inner) => replace(inner, from, to),
            _ => {}
        }
    }
}

/// Removes nulls, which TOML does not support; a null key is omitted.
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
