//! Writes the plan of a survey.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use super::estimate::Estimator;
use super::tasks::{LINES, TaskWriter, in_folder};
use super::{
    CalibrationTask, FORMAT, INCLUDED, JOB, MODEL, PLAN, PlannedAlignment, PlannedFile, REMEDY, RESOLVED,
    SurveyPlan, Task,
};
use crate::align::AlignRequest;
use crate::archive::{FilesRead, Resolved, common, plain, way};
use wavex_engine::engine::{self, Input};
use wavex_engine::job::Job;
use wavex_formats::{Error, read_small_text};
use wavex_line::stage::{OutputFile, Result, StageError};

/// Rules of Snakemake.
const SNAKEFILE: &str = include_str!("snakemake/Snakefile");
/// Settings of Snakemake for one machine and for Slurm, by folder.
const PROFILES: [(&str, &str); 2] =
    [("local", include_str!("snakemake/local.yaml")), ("slurm", include_str!("snakemake/slurm.yaml"))];

/// Folders and resources of a plan.
#[derive(Clone, Debug)]
pub struct PlanOptions<'p> {
    /// Folder of the plan.
    pub folder: &'p Path,
    /// Folder at which relative paths of the job start.
    pub job_dir: &'p Path,
    /// Folder of the inputs.
    pub input_dir: &'p Path,
    /// Folder of the outputs.
    pub output_dir: &'p Path,
    /// Archive to make of the whole survey.
    pub archive: Option<&'p Path>,
    /// Alignment to make of the whole survey.
    pub align: Option<&'p AlignRequest<'p>>,
    /// Cores per task.
    pub cores: usize,
    /// Throughput of one core, MB of input per second.
    pub mb_per_s: f64,
}

/// An alignment with paths relative to `root`.
fn planned_alignment(request: &AlignRequest<'_>, folder: &Path, root: &Path) -> Result<PlannedAlignment> {
    let constraints = &request.constraints;
    let from_root = |path: &Path| way(root, &absolute(path)?);
    // A file with WKT is found from any folder.
    let crs_file = constraints.control_crs.as_ref().filter(|crs| Path::new(crs).is_file());
    let control_crs = match crs_file {
        Some(file) => Some(from_root(Path::new(file))?),
        None => constraints.control_crs.clone(),
    };
    Ok(PlannedAlignment {
        folder: from_root(folder)?,
        trajectory: request.trajectory.to_string(),
        control: constraints.control.as_deref().map(from_root).transpose()?,
        control_crs,
        references: constraints.references.clone(),
        estimate: constraints.estimate.iter().map(|parameter| parameter.name().to_owned()).collect(),
    })
}

/// Writes the plan of a job and returns it.
///
/// Files of an earlier plan are replaced only if they differ.
///
/// # Errors
/// If the folder belongs to something else, an input is missing, a file cannot be written, or an alignment is to be made of a
/// job without `write_patches`.
pub fn plan(job: &Job, options: &PlanOptions) -> Result<SurveyPlan> {
    if options.align.is_some() && pattern_of_patches(job).is_none() {
        let remedy = "add `[[stage]]` with `type = \"write_patches\"` after `georeference`";
        return Err(StageError::failed(
            "an alignment needs the patches of all strips, but the job writes none",
            remedy,
        ));
    }
    let folder = own_folder(options.folder)?;
    let dirs = [options.input_dir, options.output_dir];
    let resolved = Resolved::new(job, dirs[0], dirs[1], &folder)?;
    let archive = options.archive.map(absolute).transpose()?;
    let align = options.align.map(|request| absolute(request.output)).transpose()?;
    let control = options.align.and_then(|request| request.constraints.control.as_deref());
    let control = control.map(absolute).transpose()?;
    let results = archive.as_deref().and_then(Path::parent);
    let results = results.into_iter().chain(align.as_deref()).chain(control.as_deref());
    let root = root(&folder, &resolved, results)?;
    let from_root = |path: &Path| way(&root, path);
    let write = |name: &str, text: &str| write_if_changed(&folder.join(name), text);
    write(JOB, &job.text)?;
    let included: Vec<String> = (1..)
        .zip(&job.includes)
        .map(|(number, file)| {
            let name = Path::new(&file.name).file_name().unwrap_or_default().to_string_lossy();
            format!("{INCLUDED}/{number}_{name}")
        })
        .collect();
    for (name, file) in included.iter().zip(&job.includes) {
        write(name, &file.text)?;
    }
    write(RESOLVED, &resolved.text(&job.name)?)?;

    let own_files = own_files(job, &resolved)?;
    let of_tasks: BTreeSet<&PathBuf> = own_files.iter().flatten().collect();
    let shared = resolved.inputs.iter().filter(|path| !of_tasks.contains(path));
    let shared_inputs: Vec<PlannedFile> =
        shared.map(|path| planned_file(&root, path)).collect::<Result<_>>()?;
    let plan_dir = from_root(&folder)?;
    let estimator = Estimator {
        cores: options.cores,
        mb_per_s: options.mb_per_s,
        line_memory_mb: job.settings.memory_mb,
        shared_bytes: shared_inputs.iter().map(|file| file.bytes).sum(),
    };
    let calibration = engine::shares_models(job, resolved.sources.len()).then(|| CalibrationTask {
        job: in_folder(&plan_dir, RESOLVED),
        model: in_folder(&plan_dir, MODEL),
        estimate: estimator.calibration(resolved.sources.len()),
    });
    let below_root = Resolved::below(job, dirs, &folder.join("tasks"), Some(&root))?;
    let model = calibration.as_ref().map(|task| task.model.as_str());
    let writer = TaskWriter::new(&below_root, &plan_dir, options.cores, archive.is_some(), model);
    let mut output_patterns = writer.patterns();
    output_patterns.extend(below_root.cells());
    if archive.is_some() {
        output_patterns.push(in_folder(&plan_dir, LINES));
    }
    let mut tasks_of_file: BTreeMap<&PathBuf, u64> = BTreeMap::new();
    for source in &resolved.sources {
        *tasks_of_file.entry(&source.path).or_default() += 1;
    }
    let (mut tasks, mut input_bytes) = (Vec::new(), 0);
    for (number, (source, files)) in (1..).zip(resolved.sources.iter().zip(&own_files)) {
        let name = &source.stem;
        write(&format!("tasks/{name}.toml"), &writer.text(number, source, &root)?)?;
        let inputs: Vec<PlannedFile> =
            files.iter().map(|path| planned_file(&root, path)).collect::<Result<_>>()?;
        let bytes = inputs.iter().map(|file| file.bytes).sum::<u64>() / tasks_of_file[&source.path];
        input_bytes += bytes;
        tasks.push(Task {
            name: name.clone(),
            job: in_folder(&plan_dir, &format!("tasks/{name}.toml")),
            outputs: output_patterns.iter().map(|pattern| pattern.replace('*', name)).collect(),
            report: in_folder(&plan_dir, &format!("reports/{name}_report.json")),
            log: in_folder(&plan_dir, &format!("logs/{name}.log")),
            estimate: estimator.task(bytes),
            inputs,
        });
    }
    let plan = SurveyPlan {
        format: FORMAT,
        wavex: env!("CARGO_PKG_VERSION").to_owned(),
        commit: wavex_engine::build::COMMIT.to_owned(),
        job: Path::new(&job.name).file_name().unwrap_or_default().to_string_lossy().into_owned(),
        job_dir: way(&folder, &absolute(options.job_dir)?)?,
        set: job.overrides.iter().map(|set| set.text.clone()).collect(),
        included: job.includes.iter().map(|file| file.name.clone()).collect(),
        root: way(&folder, &root)?,
        plan_dir,
        archive: archive.as_deref().map(from_root).transpose()?,
        align: options
            .align
            .zip(align)
            .map(|(request, align)| planned_alignment(request, &align, &root))
            .transpose()?,
        shared_inputs,
        output_patterns,
        calibration,
        collect: estimator.collect(
            tasks.len(),
            options.align.is_some(),
            (!job.settings.survey_page.is_empty()).then_some(input_bytes),
        ),
        tasks,
    };
    write("tasks.tsv", &table(&plan))?;
    write("Snakefile", SNAKEFILE)?;
    // Profiles are edited by the user.
    for (name, text) in PROFILES {
        let name = format!("profiles/{name}/config.yaml");
        if !folder.join(&name).exists() {
            write(&name, text)?;
        }
    }
    // The description comes last: a folder with it is a complete plan.
    write(PLAN, &json_text(&json!(plan))?)?;
    Ok(plan)
}

/// Creates the folder of a plan; returns its absolute path.
fn own_folder(folder: &Path) -> Result<PathBuf> {
    let is_other = folder.read_dir().is_ok_and(|mut entries| entries.next().is_some())
        && !folder.join(PLAN).is_file()
        && !folder.join(JOB).is_file();
    if is_other {
        let remedy = "give a new folder, or that of an earlier plan";
        return Err(Error::unusable(folder, "the folder is not empty and has no plan", remedy).into());
    }
    fs::create_dir_all(folder).map_err(Error::io(folder, "create the folder"))?;
    Ok(folder.canonicalize().map_err(Error::io(folder, "find the folder"))?)
}

/// Absolute path of a file or folder that need not exist.
fn absolute(path: &Path) -> Result<PathBuf> {
    let path = plain(&std::path::absolute(path).map_err(Error::io(path, "find"))?);
    let existing = path.ancestors().find_map(|folder| Some((folder, folder.canonicalize().ok()?)));
    let Some((folder, canonical)) = existing else { return Ok(path) };
    Ok(path.strip_prefix(folder).map_or_else(
        |_| path.clone(),
        |rest| match rest.as_os_str().is_empty() {
            true => canonical.clone(),
            false => canonical.join(rest),
        },
    ))
}

/// Pattern of the patches that a job writes.
pub(super) fn pattern_of_patches(job: &Job) -> Option<&str> {
    let stage = job.stages.iter().find(|stage| stage.spec.name == "write_patches")?;
    stage.planned.plan.outputs().first().copied()
}

/// Deepest folder that contains plan, inputs, outputs and the folders of other results.
fn root<'f>(
    folder: &'f Path,
    resolved: &'f Resolved,
    results: impl Iterator<Item = &'f Path>,
) -> Result<PathBuf> {
    let parents = resolved.inputs.iter().filter_map(|path| path.parent());
    let folders = [folder, &resolved.output_root].into_iter();
    let folders = folders.chain(results).chain(parents);
    common(folders).ok_or_else(|| {
        let problem = "plan, inputs and outputs have no common folder";
        StageError::failed(problem, "put them on one drive")
    })
}

/// The input of each task, with files that only this task reads.
///
/// # Errors
/// If a folder of inputs cannot be listed.
fn own_files(job: &Job, resolved: &Resolved) -> Result<Vec<Vec<PathBuf>>> {
    let mut files = FilesRead::new(job, &resolved.job_input_dir);
    let of_source = |source: &Input| -> Result<Vec<PathBuf>> {
        Ok(files.of(std::slice::from_ref(source))?.into_iter().collect())
    };
    let mut all: Vec<Vec<PathBuf>> = resolved.sources.iter().map(of_source).collect::<Result<_>>()?;
    if let [_, _, ..] = all.as_slice() {
        let mut seen: BTreeMap<PathBuf, usize> = BTreeMap::new();
        for path in all.iter().flatten() {
            *seen.entry(path.clone()).or_default() += 1;
        }
        // A file with several parts is the input of several tasks.
        let sources: BTreeSet<&PathBuf> = resolved.sources.iter().map(|source| &source.path).collect();
        for files in &mut all {
            files.retain(|path| seen.get(path) == Some(&1) || sources.contains(path));
        }
    }
    for (source, files) in resolved.sources.iter().zip(&mut all) {
        // The input is the first of its files.
        files.sort_by_key(|path| *path != source.path);
    }
    Ok(all)
}

fn planned_file(root: &Path, path: &Path) -> Result<PlannedFile> {
    let about = path.metadata().map_err(Error::io(path, "find the input"))?;
    Ok(PlannedFile { path: way(root, path)?, bytes: about.len() })
}

/// The tasks as a table with tabs.
fn table(plan: &SurveyPlan) -> String {
    let mut text = "task\tjob\tcores\tmemory_mb\tminutes\n".to_owned();
    for Task { name, job, estimate, .. } in &plan.tasks {
        text += &format!("{name}\t{job}\t{}\t{}\t{}\n", estimate.cores, estimate.memory_mb, estimate.minutes);
    }
    text
}

pub(super) fn json_text(value: &Value) -> Result<String> {
    let text = serde_json::to_string_pretty(value).map_err(|error| {
        StageError::failed(format!("cannot write the plan: {error}"), "please report this bug in wavex")
    })?;
    Ok(text + "\n")
}

/// Writes a text, unless the file already has it: its time shows when it changed.
fn write_if_changed(path: &Path, text: &str) -> Result<()> {
    if read_small_text(path, text.len() as u64, "a plan", REMEDY).is_ok_and(|found| found == text) {
        return Ok(());
    }
    let mut file = OutputFile::create(path)?;
    file.write_all(text.as_bytes()).map_err(Error::io(path, "write"))?;
    file.finish_without_sync()?.publish()?;
    Ok(())
}

/// Writes a text file.
pub(super) fn write_text(path: &Path, text: &str) -> Result<()> {
    let mut file = OutputFile::create(path)?;
    file.write_all(text.as_bytes()).map_err(Error::io(path, "write"))?;
    file.finish()?.publish()?;
    Ok(())
}
