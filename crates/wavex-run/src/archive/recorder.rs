//! Makes the archive of a run: digests of the inputs before it, all else after it.

use std::collections::BTreeMap;
use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use super::contents;
use super::digest;
use super::origin::{Machine, Program};
use super::paths::relative;
use super::resolved::Resolved;
use super::{
    ARCHIVE, Archive, ArchivedFiles, DigestedFile, FORMAT, FailedInput, INCLUDED, JOB, LINES, LOG, MODELS,
    REPORT, RESOLVED, RESULTS, SEAL,
};
use wavex_engine::engine::{InputStatus, InputSummary, Options, RunSummary};
use wavex_engine::job::{Include, Job, JobStage};
use wavex_formats::Error;
use wavex_geodesy::time::utc;
use wavex_line::stage::{ConfigError, OutputFile, Result, StageError, Stamp, own_file, partial_path};
use wavex_stages::writers::write_lstat;

/// Id of the stage that writes scan-line statistics for the archive.
const STAGE_ID: &str = "archive";

/// An archive under construction; removed if dropped before [`Recorder::finish`].
pub struct Recorder {
    /// Final path.
    path: PathBuf,
    /// Folder of its files until then.
    gathering: TemporaryFolder,
    made: SystemTime,
    archive: Archive,
    job: String,
    includes: Vec<Include>,
    resolved: Resolved,
    /// `job.resolved.toml`.
    resolved_text: String,
    /// State of the inputs when their digests were taken; `None` if missing.
    stamps: Vec<Option<Stamp>>,
    /// Digests that are already known.
    known: KnownDigests,
    /// Folder that the archive will be, or unpacks to.
    folder: PathBuf,
}

/// Sizes and digests of files by absolute path.
pub type KnownDigests = BTreeMap<PathBuf, (u64, String)>;

/// A completed archive.
#[derive(Clone, Debug)]
pub struct Seals {
    /// BLAKE3 digest of `archive.b3`: unique to this archive.
    pub seal: String,
    /// BLAKE3 digest of `results.b3`: the same for every run with the same results.
    pub results: String,
}

/// A temporary folder, removed on drop.
struct TemporaryFolder(PathBuf);

impl Drop for TemporaryFolder {
    fn drop(&mut self) {
        // A folder that cannot be removed is recognisable by its name.
        let _ = fs::remove_dir_all(&self.0);
    }
}

/// Checks that an archive can be created under this name.
///
/// # Errors
/// If the path exists, has no file name, or has the extension of another archive format.
pub fn check_destination(path: &Path) -> Result<()> {
    if path.file_name().is_none() {
        return Err(Error::unusable(
            path,
            "not a valid name for an archive",
            "give a new folder, or a name that ends in .tar.zst",
        )
        .into());
    }
    if let Some(kind) = contents::other_kind(path) {
        let problem = format!("wavex cannot make {kind} archives");
        let remedy = "give a name that ends in .tar.zst, or the name of a new folder";
        return Err(Error::unusable(path, problem, remedy).into());
    }
    if path.symlink_metadata().is_ok() {
        let remedy = "choose another name: an archive is never replaced";
        return Err(Error::unusable(path, "it already exists", remedy).into());
    }
    Ok(())
}

impl Recorder {
    /// Starts the archive of a run: resolves the job and computes the digests of all inputs.
    ///
    /// Omits missing inputs: the run fails or does without them.
    ///
    /// # Errors
    /// If the archive exists already or an input cannot be read.
    pub fn begin(job: &Job, options: &Options, path: &Path) -> Result<Recorder> {
        Recorder::begin_with(job, options, path, KnownDigests::new())
    }

    /// Starts the archive like [`Recorder::begin`]; does not read files whose digests are known.
    ///
    /// # Errors
    /// See [`Recorder::begin`].
    pub fn begin_with(job: &Job, options: &Options, path: &Path, known: KnownDigests) -> Result<Recorder> {
        check_destination(path)?;
        let made = SystemTime::now();
        let parent = path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
        fs::create_dir_all(parent).map_err(Error::io(parent, "create the folder"))?;
        let folder = contents::folder_of(path)?;
        let resolved =
            Resolved::new(job, &options.input_dir, &options.output_dir, &folder)?.run_with(options);
        let resolved_text = resolved.text(&job.name)?;
        let gathering = TemporaryFolder(partial_path(path, std::process::id()));
        // Remove remains of a dead process with the same id.
        drop(TemporaryFolder(gathering.0.clone()));
        fs::create_dir_all(gathering.0.join(LINES)).map_err(Error::io(&gathering.0, "create the folder"))?;
        let stamps: Vec<Option<Stamp>> = resolved.inputs.iter().map(|path| Stamp::of(path)).collect();
        let unknown = resolved.inputs.iter().zip(&stamps).filter(|(_, stamp)| stamp.is_none());
        unknown.map(|(path, _)| path).try_for_each(|path| is_missing(path))?;
        let existing = resolved.inputs.iter().zip(&stamps).filter(|(_, stamp)| stamp.is_some());
        let digested = |(path, _): (&PathBuf, _)| digested(&resolved.input_root, path, None, &known);
        let inputs: Result<Vec<DigestedFile>> = existing.map(digested).collect();
        let archive = Archive {
            format: FORMAT,
            made: utc(made),
            job: job.name.clone(),
            set: job.overrides.iter().map(|set| set.text.clone()).collect(),
            program: Program::this(),
            machine: Machine::this(),
            inputs: files(&folder, &resolved.input_root, inputs?),
            outputs: files(&folder, &resolved.output_root, Vec::new()),
            failed: Vec::new(),
        };
        let path = path.to_owned();
        let (job, includes) = (job.text.clone(), job.includes.clone());
        Ok(Recorder {
            path,
            gathering,
            made,
            archive,
            job,
            includes,
            resolved,
            resolved_text,
            stamps,
            known,
            folder,
        })
    }

    /// The job to run: with an additional stage that writes scan-line statistics for the archive.
    ///
    /// # Errors
    /// If the name of a folder is not valid Unicode.
    pub fn job(&self, job: &Job) -> Result<Job> {
        let folder = std::path::absolute(&self.gathering.0).map_err(Error::io(&self.gathering.0, "find"))?;
        let pattern = folder.join(LINES).join("*_lstat.txt");
        let Some(pattern) = pattern.to_str().filter(|pattern| pattern.matches('*').count() == 1) else {
            let problem = format!("{}: not a valid name for an archive", self.path.display());
            return Err(StageError::failed(problem, "choose a Unicode name without `*`"));
        };
        let keys = format!("path = {}", toml::Value::String(pattern.to_owned()));
        let keys = toml::de::DeTable::parse(&keys).map_err(|error| defect(&error))?;
        let planned = (write_lstat::STAGE.parse)(keys).map_err(|error| match error {
            ConfigError::Toml(error) => defect(&error),
            ConfigError::Key(invalid) => defect(&invalid.problem),
        })?;
        let mut job = job.clone();
        job.stages.push(JobStage { id: STAGE_ID.to_owned(), spec: &write_lstat::STAGE, planned });
        Ok(job)
    }

    /// Removes the archive's own stage from the results of an input.
    pub fn strip(&self, input: &mut InputSummary) {
        let own = std::path::absolute(&self.gathering.0).unwrap_or_default();
        input.stages.pop();
        input.outputs.retain(|output| !output.starts_with(&own));
    }

    /// Adds the scan-line statistics of an input whose run did not use [`Recorder::job`].
    ///
    /// # Errors
    /// If they cannot be written.
    pub fn add_lines(&self, stem: &str, lines: &Path) -> Result<()> {
        let path = self.gathering.0.join(LINES).join(format!("{stem}_lstat.txt"));
        fs::copy(lines, &path).map(drop).map_err(Error::io(lines, "copy"))?;
        Ok(())
    }

    /// Completes the archive, gives it its name, and returns its seals.
    ///
    /// `report` is the text of `report.json`.
    ///
    /// # Errors
    /// If an input was changed during the run, or the archive cannot be written.
    pub fn finish(mut self, run: &RunSummary, report: String, log: &[u8]) -> Result<Seals> {
        self.check_inputs()?;
        self.archive.outputs.files = self.outputs(run)?;
        let failed = |input: &InputSummary| {
            let reason = input.failure.clone()?;
            Some(FailedInput { stem: input.stem.clone(), reason })
        };
        self.archive.failed = run.inputs.iter().filter_map(failed).collect();
        let mut files = self.texts(run, report, log)?;
        self.remove_locks()?;
        files.extend(contents::read_files(&self.gathering.0)?);
        let of_results = self.results(&files)?;
        let results = digest::of_bytes(of_results.as_bytes());
        files.insert(RESULTS.to_owned(), of_results.into_bytes());
        files.insert(SEAL.to_owned(), contents::seal(&files).into_bytes());
        let seal = files.get(SEAL).map(|text| digest::of_bytes(text)).unwrap_or_default();
        check_destination(&self.path)?;
        if contents::is_packed(&self.path) {
            self.pack(&files)?;
        } else {
            contents::write_folder(&self.gathering.0, &files)?;
            fs::rename(&self.gathering.0, &self.path)
                .map_err(Error::io(&self.path, "rename to the final name"))?;
            let parent = self.path.parent().unwrap_or(Path::new("."));
            own_file::sync_folder(parent).map_err(Error::io(parent, "write the folder"))?;
        }
        Ok(Seals { seal, results })
    }

    /// Removes what could not be removed when the statistics were complete.
    fn remove_locks(&self) -> Result<()> {
        let lines = self.gathering.0.join(LINES);
        for entry in lines.read_dir().map_err(Error::io(&lines, "list"))? {
            let entry = entry.map_err(Error::io(&lines, "list"))?;
            if entry.file_name().to_string_lossy().starts_with('.') {
                fs::remove_file(entry.path()).map_err(Error::io(&lines, "remove a lock in"))?;
            }
        }
        Ok(())
    }

    fn pack(&self, files: &BTreeMap<String, Vec<u8>>) -> Result<()> {
        // The temporary folder has the same name as the temporary file.
        fs::remove_dir_all(&self.gathering.0)
            .map_err(Error::io(&self.path, "remove the temporary folder of"))?;
        let mut file = OutputFile::create(&self.path)?;
        let name = self.folder.file_name().unwrap_or_default().to_string_lossy();
        let seconds = self.made.duration_since(SystemTime::UNIX_EPOCH).unwrap_or(Duration::ZERO).as_secs();
        contents::pack(&name, files, seconds, &mut file).map_err(Error::io(&self.path, "write"))?;
        file.finish()?.publish()?;
        Ok(())
    }

    fn check_inputs(&self) -> Result<()> {
        for (path, stamp) in self.resolved.inputs.iter().zip(&self.stamps) {
            if Stamp::of(path) != *stamp {
                let problem = "it was changed during the run: no archive was made";
                return Err(Error::unusable(path, problem, "run the job again").into());
            }
        }
        Ok(())
    }

    /// Digests of all files written by stages, sorted by path.
    fn outputs(&self, run: &RunSummary) -> Result<Vec<DigestedFile>> {
        let mut files = Vec::new();
        for output in run.inputs.iter().flat_map(|input| &input.outputs) {
            let path = super::paths::plain(&absolute(output)?);
            let stage = self.resolved.outputs.get(&path).cloned();
            files.push(digested(&self.resolved.output_root, &path, stage, &self.known)?);
        }
        files.sort_by(|a, b| a.path.cmp(&b.path));
        Ok(files)
    }

    /// Text of `results.b3`: digests of everything that does not depend on time and machine.
    fn results(&self, files: &BTreeMap<String, Vec<u8>>) -> Result<String> {
        let mut lines: Vec<String> = Vec::new();
        for (kind, of_kind) in [("inputs", &self.archive.inputs), ("outputs", &self.archive.outputs)] {
            let line = |file: &DigestedFile| format!("{}  {kind}/{}\n", file.blake3, file.path);
            lines.extend(of_kind.files.iter().map(line));
        }
        let is_result = |name: &str| name.starts_with(MODELS) || name.starts_with(LINES);
        let of_archive = files.iter().filter(|(name, _)| is_result(name));
        lines.extend(of_archive.map(|(name, bytes)| format!("{}  {name}\n", digest::of_bytes(bytes))));
        lines.push(format!("{}  job\n", digest::of_bytes(self.resolved.essence()?.as_bytes())));
        Ok(lines.concat())
    }

    /// Files generated here, by path.
    fn texts(&self, run: &RunSummary, report: String, log: &[u8]) -> Result<BTreeMap<String, Vec<u8>>> {
        let mut files = BTreeMap::from([
            (ARCHIVE.to_owned(), json(&self.archive)?),
            (JOB.to_owned(), self.job.clone().into_bytes()),
            (RESOLVED.to_owned(), self.resolved_text.clone().into_bytes()),
            (REPORT.to_owned(), report.into_bytes()),
            (LOG.to_owned(), log.to_vec()),
        ]);
        for (number, include) in (1..).zip(&self.includes) {
            let name = Path::new(&include.name).file_name().unwrap_or_default().to_string_lossy();
            files.insert(format!("{INCLUDED}/{number}_{name}"), include.text.clone().into_bytes());
        }
        for input in run.inputs.iter().filter(|input| input.status == InputStatus::Done) {
            if let Some(model) = run.sensor_model(input) {
                files.insert(format!("{MODELS}/{}.json", input.stem), json(model)?);
            }
        }
        Ok(files)
    }
}

/// Checks that an input without a state is missing.
fn is_missing(path: &Path) -> Result<()> {
    match fs::metadata(path) {
        Err(error) if error.kind() != ErrorKind::NotFound => Err(Error::io(path, "open")(error).into()),
        _ => Ok(()),
    }
}

fn defect(error: &dyn std::fmt::Display) -> StageError {
    StageError::failed(format!("the run cannot be archived: {error}"), "please report this bug in wavex")
}

/// Formats a value as indented JSON.
fn json(value: &impl serde::Serialize) -> Result<Vec<u8>> {
    let mut text = serde_json::to_vec_pretty(value).map_err(|error| defect(&error))?;
    text.push(b'\n');
    Ok(text)
}

/// Absolute path of an existing file; its file name is not resolved.
fn absolute(path: &Path) -> Result<PathBuf> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let folder = folder.canonicalize().map_err(Error::io(folder, "find the folder"))?;
    Ok(folder.join(path.file_name().unwrap_or_default()))
}

fn digested(root: &Path, path: &Path, stage: Option<String>, known: &KnownDigests) -> Result<DigestedFile> {
    let (bytes, blake3) = known.get(path).map_or_else(|| digest::of_file(path), |known| Ok(known.clone()))?;
    let name = relative(root, path).ok_or_else(|| {
        StageError::failed(format!("{}: the name is not valid Unicode", path.display()), "rename it")
    })?;
    Ok(DigestedFile { path: name, bytes, blake3, stage })
}

/// Describes files below a folder for the archive in `archive`.
fn files(archive: &Path, root: &Path, files: Vec<DigestedFile>) -> ArchivedFiles {
    let folder_was = root.display().to_string();
    ArchivedFiles { folder: relative(archive, root).unwrap_or_else(|| folder_was.clone()), folder_was, files }
}
