//! Checks that output files differ from each other and from the input.
//!
//! Only their patterns are compared.

use std::path::{Component, Path, PathBuf};

use super::tables::ParsedStage;
use super::{JobError, JobSettings};
use wavex_line::stage::{Paths, Plan};

/// Finds errors in the output patterns of the sinks; unparsed stages are `None`.
pub(super) fn check(stages: &[Option<ParsedStage>], settings: Option<&JobSettings>) -> Vec<JobError> {
    let Some(source) = stages.iter().flatten().find_map(SourceFiles::of) else {
        return Vec::new();
    };
    let same_folder = settings.is_some_and(|settings| settings.input_dir == settings.output_dir);
    let mut errors = Vec::new();
    let mut seen: Vec<(PathBuf, &str)> = Vec::new();
    for (stage, pattern) in stages.iter().flatten().flat_map(patterns) {
        let at = stage.place_of(pattern);
        let file = source.file(pattern);
        if pattern.contains(char::is_control) {
            let problem = format!("the name of an output contains control characters: {pattern:?}");
            errors.push(JobError::at(at, problem).help("write a name of visible characters"));
        } else if source.several && !pattern.contains('*') {
            let problem = format!("every input of this job would write the same file, {pattern:?}");
            errors.push(JobError::at(at, problem).help(with_star(pattern)));
        } else if let Some((_, other)) = seen.iter().find(|(other, _)| *other == file) {
            let problem = format!("two outputs of this job are the same file, {pattern:?}");
            let help = format!("choose another name: `{other}` already writes this file");
            errors.push(JobError::at(at, problem).help(help));
        } else if same_folder && source.meets(pattern) {
            let problem = format!("{pattern:?} would replace the input");
            let help =
                "give the output another folder or another name, such as \"out/*.laz\" or \"*_points.laz\"";
            errors.push(JobError::at(at, problem).help(help));
        }
        seen.push((file, &stage.stage.id));
    }
    errors.extend(settings.filter(|_| source.several).and_then(shared_stat_log));
    errors
}

/// Error if the statistics of all inputs have the same name.
fn shared_stat_log(settings: &JobSettings) -> Option<JobError> {
    let pattern = Some(&settings.stat_log).filter(|name| !name.is_empty() && !name.contains('*'))?;
    let problem = format!("`stat_log`: every input of this job would write the same file, {pattern:?}");
    Some(JobError::of_job(problem).help(with_star(pattern)))
}

/// Input files as described by the source.
struct SourceFiles {
    /// Whether a run may have several inputs.
    several: bool,
    /// Files and file patterns.
    files: Vec<PathBuf>,
    /// Replacement of `*`, if it is unique.
    stem: Option<String>,
}

impl SourceFiles {
    fn of(stage: &ParsedStage) -> Option<SourceFiles> {
        let Plan::Source(source) = &stage.stage.planned.plan else {
            return None;
        };
        let patterns = source.paths().map_or(&[][..], Paths::patterns);
        let several = patterns.len() > 1 || patterns.iter().any(|path| path.contains(['*', '?', '[']));
        let files: Vec<PathBuf> = patterns.iter().map(|path| plain(path)).collect();
        let stem = match files.as_slice() {
            _ if several => None,
            [file] => Some(stem_of(file)),
            _ => Some(source.stem().to_owned()),
        };
        Some(SourceFiles { several, files, stem })
    }

    /// File of an output pattern, as far as known.
    fn file(&self, pattern: &str) -> PathBuf {
        match &self.stem {
            Some(stem) => plain(&pattern.replace('*', stem)),
            None => plain(pattern),
        }
    }

    /// Returns whether the output pattern, applied to an input, is that input.
    fn meets(&self, pattern: &str) -> bool {
        self.files.iter().any(|file| plain(&pattern.replace('*', &stem_of(file))) == *file)
    }
}

/// Output patterns of a stage.
fn patterns(stage: &ParsedStage) -> Vec<(&ParsedStage, &str)> {
    stage.stage.planned.plan.outputs().into_iter().map(|pattern| (stage, pattern)).collect()
}

/// Removes `.` components from a path: `./a/./b` becomes `a/b`.
fn plain(path: &str) -> PathBuf {
    Path::new(path).components().filter(|step| *step != Component::CurDir).collect()
}

/// Stem after which outputs are named.
fn stem_of(file: &Path) -> String {
    file.file_stem().map_or_else(String::new, |stem| stem.to_string_lossy().into_owned())
}

/// Remedy: the same pattern with the stem of the input.
fn with_star(pattern: &str) -> String {
    let (folder, name) = pattern.split_at(pattern.rfind('/').map_or(0, |slash| slash + 1));
    format!("write `*` in place of the stem of the input, such as \"{folder}*_{name}\"")
}
