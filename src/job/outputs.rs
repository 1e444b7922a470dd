//! The files that a job writes, as far as their patterns tell: no two may meet, and none may meet the input.

use std::path::{Component, Path, PathBuf};

use super::tables::Stage;
use super::{JobError, JobSettings};
use crate::stage::{Paths, Plan};

/// What is wrong with the output patterns of the sinks. Stages that could not be read are `None`.
pub(super) fn check(stages: &[Option<Stage>], settings: Option<&JobSettings>) -> Vec<JobError> {
    let Some(source) = stages.iter().flatten().find_map(Input::of) else {
        return Vec::new();
    };
    let same_folder = settings.is_some_and(|settings| settings.input_dir == settings.output_dir);
    let mut errors = Vec::new();
    let mut seen: Vec<(PathBuf, &str)> = Vec::new();
    for (stage, pattern) in stages.iter().flatten().flat_map(patterns) {
        let at = stage.place_of(pattern);
        let file = source.file(pattern);
        if source.several && !pattern.contains('*') {
            let problem = format!("every input of this job would write the same file, {pattern:?}");
            errors.push(JobError::at(at, problem).help(with_star(pattern)));
        } else if let Some((_, other)) = seen.iter().find(|(other, _)| *other == file) {
            let problem = format!("two outputs of this job are the same file, {pattern:?}");
            let help = format!("give this one a name of its own: `{other}` writes it already");
            errors.push(JobError::at(at, problem).help(help));
        } else if same_folder && source.meets(pattern) {
            let problem = format!("{pattern:?} would replace the input");
            let help =
                "give the output another folder or another name, as in \"out/*.laz\" or \"*_points.laz\"";
            errors.push(JobError::at(at, problem).help(help));
        }
        seen.push((file, &stage.stage.id));
    }
    errors.extend(settings.filter(|_| source.several).and_then(shared_stat_log));
    errors
}

/// The statistics of one input would replace those of another.
fn shared_stat_log(settings: &JobSettings) -> Option<JobError> {
    let pattern = Some(&settings.stat_log).filter(|name| !name.is_empty() && !name.contains('*'))?;
    let problem = format!("`stat_log`: every input of this job would write the same file, {pattern:?}");
    Some(JobError::of_job(problem).help(with_star(pattern)))
}

/// What the source tells of its files.
struct Input {
    /// Whether a run may have several.
    several: bool,
    /// The files and the patterns of files.
    files: Vec<PathBuf>,
    /// What `*` means, where it means one thing only.
    stem: Option<String>,
}

impl Input {
    fn of(stage: &Stage) -> Option<Input> {
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
        Some(Input { several, files, stem })
    }

    /// The file that a pattern means, as far as that can be said.
    fn file(&self, pattern: &str) -> PathBuf {
        match &self.stem {
            Some(stem) => plain(&pattern.replace('*', stem)),
            None => plain(pattern),
        }
    }

    /// Whether the pattern means an input where it is named after that.
    fn meets(&self, pattern: &str) -> bool {
        self.files.iter().any(|file| plain(&pattern.replace('*', &stem_of(file))) == *file)
    }
}

/// The patterns that a stage writes.
fn patterns(stage: &Stage) -> Vec<(&Stage, &str)> {
    stage.stage.planned.plan.outputs().into_iter().map(|pattern| (stage, pattern)).collect()
}

/// A path without the steps that lead nowhere: `./a/./b` is `a/b`.
fn plain(path: &str) -> PathBuf {
    Path::new(path).components().filter(|step| *step != Component::CurDir).collect()
}

/// What outputs are named after.
fn stem_of(file: &Path) -> String {
    file.file_stem().map_or_else(String::new, |stem| stem.to_string_lossy().into_owned())
}

/// A remedy: the same pattern with the input's name in it.
fn with_star(pattern: &str) -> String {
    let (folder, name) = pattern.split_at(pattern.rfind('/').map_or(0, |slash| slash + 1));
    format!("write `*` where the input's name belongs, as in \"{folder}*_{name}\"")
}
