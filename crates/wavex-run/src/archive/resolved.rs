//! The job as run, in portable form: all defaults written out, all paths relative.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use serde_json::{Map, Value, json};

use super::inputs;
use super::paths::{common, plain, relative};
use wavex_engine::engine::{self, Input, Options};
use wavex_engine::job::{Job, JobStage, Simd};
use wavex_formats::Error;
use wavex_line::keys::FileMark;
use wavex_line::stage::{Paths, Plan, Result, StageError};
use wavex_stages::registry::STAGES;

/// Keys of `[job]` that do not affect results, and its folders.
const WITHOUT_EFFECT: [&str; 11] = [
    "channel_capacity",
    "input_dir",
    "inputs_at_once",
    "log",
    "on_error",
    "output_dir",
    "report",
    "report_page",
    "simd",
    "stat_log",
    "threads",
];

/// A portable job with its files.
#[derive(Debug)]
pub(crate) struct Resolved {
    /// The job as tables `job` and `stage`.
    pub table: Value,
    /// Key of the reader that lists the inputs; none for a simulated input.
    pub path_key: Option<String>,
    /// Key of the reader that lists the parts of a file, if each is an input of its own.
    pub part_key: Option<&'static str>,
    /// Folder that contains all inputs.
    pub input_root: PathBuf,
    /// Folder that contains all outputs.
    pub output_root: PathBuf,
    /// Inputs in order, with absolute paths.
    pub sources: Vec<Input>,
    /// Folder at which relative input paths of the job start.
    pub job_input_dir: PathBuf,
    /// Patterns of the files that stages write, relative to their folder.
    pub patterns: Vec<String>,
    /// All files that are read.
    pub inputs: Vec<PathBuf>,
    /// All files that stages may write, with the id of the stage.
    pub outputs: BTreeMap<PathBuf, String>,
}

/// Absolute folders at which the paths of a job start.
struct Roots {
    input_dir: PathBuf,
    input_root: PathBuf,
    output_dir: PathBuf,
    output_root: PathBuf,
}

impl Resolved {
    /// Resolves a job with these folders; in the table they are relative to `base`.
    ///
    /// # Errors
    /// If an input is missing or standard input, or a path is not valid Unicode.
    pub(crate) fn new(job: &Job, input_dir: &Path, output_dir: &Path, base: &Path) -> Result<Resolved> {
        Resolved::below(job, [input_dir, output_dir], base, None)
    }

    /// Resolves a job like [`Resolved::new`], with `root` as folder of all its files, if given.
    ///
    /// # Errors
    /// See [`Resolved::new`].
    pub(crate) fn below(
        job: &Job,
        [input_dir, output_dir]: [&Path; 2],
        base: &Path,
        root: Option<&Path>,
    ) -> Result<Resolved> {
        let input_dir = absolute(input_dir)?;
        fs::create_dir_all(output_dir).map_err(Error::io(output_dir, "create the folder"))?;
        let output_dir = absolute(output_dir)?;
        let sources = engine::inputs(job, &input_dir).map_err(|error| error.into_stage_error())?;
        if sources.iter().any(|input| input.path == Path::new("-")) {
            let remedy = "save it to a file and read that file";
            return Err(StageError::failed("standard input cannot be archived", remedy));
        }
        let mut settings = job.settings.clone();
        settings.geometry.spell_out();
        settings.survey.cells = settings.cells().unwrap_or_default().to_owned();
        let settings = serde_json::to_value(&settings).unwrap_or(Value::Null);
        let files = inputs::of_job(job, &settings, &sources, &input_dir)?;
        let files: Vec<PathBuf> = files.into_iter().collect();
        let outputs = outputs_of(job, &sources, &output_dir);
        let roots = Roots {
            input_root: root.map_or_else(|| root_of(&input_dir, &files), Path::to_owned),
            output_root: root.map_or_else(|| root_of(&output_dir, outputs.keys()), Path::to_owned),
            input_dir,
            output_dir,
        };
        let job_table = roots.settings(settings, base)?;
        let mut path_key = None;
        let stages: Result<Vec<Value>> =
            job.stages.iter().map(|stage| roots.stage(stage, &sources, &mut path_key)).collect();
        let of_source = |input: Input| Input { path: plain(&roots.input_dir.join(&input.path)), ..input };
        let part_key = job.stages.first().and_then(|stage| match &stage.planned.plan {
            Plan::Source(source) => source.part_key(),
            _ => None,
        });
        let patterns = job.stages.iter().flat_map(|stage| stage.planned.plan.outputs());
        Ok(Resolved {
            patterns: patterns.map(|pattern| roots.output(pattern)).collect::<Result<_>>()?,
            job_input_dir: roots.input_dir.clone(),
            table: json!({"job": job_table, "stage": stages?}),
            path_key,
            part_key,
            sources: sources.into_iter().map(of_source).collect(),
            input_root: roots.input_root,
            output_root: roots.output_root,
            inputs: files,
            outputs,
        })
    }

    /// Pattern of the cells of strips, if the job requests them.
    pub(crate) fn cells(&self) -> Option<String> {
        let cells = self.table["job"]["survey"]["cells"].as_str()?;
        (!cells.is_empty()).then(|| cells.to_owned())
    }

    /// The job as these options run it.
    pub(super) fn run_with(mut self, options: &Options) -> Resolved {
        self.table["job"]["threads"] = json!(options.workers());
        self.table["job"]["simd"] = json!(Simd::from(options.simd));
        self
    }

    /// Formats the job as `job.resolved.toml`.
    ///
    /// # Errors
    /// If the text is not a valid job, which is a bug.
    pub(crate) fn text(&self, name: &str) -> Result<String> {
        let text = job_text(&self.table)?;
        let text = format!(
            "# Job {:?} as run by wavex {}: all data-independent defaults written out, all paths relative.\n\n{text}",
            name_of(name),
            env!("CARGO_PKG_VERSION")
        );
        Job::parse(STAGES, super::RESOLVED, &text, &[]).map_err(|errors| defect(&errors))?;
        Ok(text)
    }

    /// The job without keys that do not affect its results, and without its folders.
    pub(super) fn essence(&self) -> Result<String> {
        let mut table = self.table.clone();
        if let Some(job) = table["job"].as_object_mut() {
            job.retain(|key, _| !WITHOUT_EFFECT.contains(&key.as_str()));
        }
        job_text(&table)
    }
}

/// Formats the tables of a job as TOML; null keys are omitted.
///
/// # Errors
/// If a value cannot be written as TOML, which is a bug.
pub(crate) fn job_text(table: &Value) -> Result<String> {
    toml::to_string_pretty(&without_null(table.clone())).map_err(|error| defect(&error))
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
fn root_of<'p>(own: &Path, files: impl IntoIterator<Item = &'p PathBuf> + Clone) -> PathBuf {
    if files.clone().into_iter().all(|file| file.starts_with(own)) {
        return own.to_owned();
    }
    common(files.into_iter().filter_map(|file| file.parent())).unwrap_or_else(|| own.to_owned())
}

/// All files that stages may write, with the id of the stage.
pub(super) fn outputs_of(job: &Job, sources: &[Input], output_dir: &Path) -> BTreeMap<PathBuf, String> {
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
    fn settings(&self, mut settings: Value, base: &Path) -> Result<Value> {
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
        settings["input_dir"] = json!(way(base, &self.input_root)?);
        settings["output_dir"] = json!(way(base, &self.output_root)?);
        Ok(settings)
    }

    /// A table `[[stage]]`; also returns the key that lists the inputs.
    fn stage(&self, stage: &JobStage, sources: &[Input], path_key: &mut Option<String>) -> Result<Value> {
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
            let mut files: Vec<String> =
                sources.iter().map(|input| self.input_file(&input.path)).collect::<Result<_>>()?;
            // Parts of a file follow each other.
            files.dedup();
            // Replace patterns: they could match other files later.
            if let Some((key, value)) = table.iter_mut().find(|(_, value)| **value == json!(paths)) {
                *path_key = Some(key.clone());
                *value = match (paths, files.as_slice()) {
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
pub(crate) fn way(from: &Path, to: &Path) -> Result<String> {
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
