//! Expands the paths of a reader into the inputs of the runs.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::DirEntry;
use std::path::{Path, PathBuf};

use super::RunError;
use crate::job::Job;
use wavex_formats::{CompanionIndex, unsupported};
use wavex_line::stage::{Outputs, Paths, RunContext, StageError, fixed_folder};

/// Input of one run.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Input {
    /// The file, or `-` for standard input; empty if the source generates its data.
    pub path: PathBuf,
    /// Stem after which outputs are named.
    pub stem: String,
    /// Part of the file, if each part is an input of its own; the stem ends in its name.
    pub part: Option<String>,
}

impl Input {
    /// The input that is a part of a file; other characters than letters, digits, `-` and `_` become `_` in its stem.
    fn of_part(path: &Path, stem: &str, part: String) -> Input {
        let is_plain = |letter: char| letter.is_ascii_alphanumeric() || matches!(letter, '-' | '_');
        let name: String = part.chars().map(|letter| if is_plain(letter) { letter } else { '_' }).collect();
        Input { path: path.to_owned(), stem: format!("{stem}_{name}"), part: Some(part) }
    }
}

/// Lists the inputs in the order of the job; matches of a pattern are sorted by name.
pub fn expand(paths: Option<&Paths>, stem: &str, input_dir: &Path) -> Result<Vec<Input>, RunError> {
    let (inputs, errors) = find(paths, [stem, ""], input_dir, |_| Vec::new());
    errors.into_iter().next().map_or(Ok(inputs), Err)
}

/// Lists the inputs like [`expand`], and the problems of others.
///
/// `stem` is that of a source without files, `suffix` the end of file names that stems do not have. `parts` lists the parts of a file that are inputs of their own; none: the file is one.
pub(super) fn find(
    paths: Option<&Paths>,
    [stem, suffix]: [&str; 2],
    input_dir: &Path,
    parts: impl Fn(&Path) -> Vec<String>,
) -> (Vec<Input>, Vec<RunError>) {
    let Some(paths) = paths else {
        return (vec![Input { stem: stem.to_string(), ..Input::default() }], Vec::new());
    };
    let (mut inputs, mut errors): (Vec<Input>, _) = (Vec::new(), Vec::new());
    let mut stems: BTreeMap<String, PathBuf> = BTreeMap::new();
    let mut seen: BTreeSet<PathBuf> = BTreeSet::new();
    for pattern in paths.patterns() {
        let found = matches(pattern, input_dir).unwrap_or_else(|error| {
            errors.push(error);
            Vec::new()
        });
        for path in found {
            if let Some(error) = unsupported(&path) {
                errors.push(RunError::of_job(error.into()));
                continue;
            }
            if let Some(error) = control_characters(&path, input_dir) {
                errors.push(error);
                continue;
            }
            if !seen.insert(path.clone()) {
                continue;
            }
            let stem = stem_of(&path);
            let stem = stem.strip_suffix(suffix).filter(|stem| !stem.is_empty()).unwrap_or(&stem).to_owned();
            if let Some(other) = stems.insert(stem.clone(), path.clone()) {
                errors.push(RunError::of_job(StageError::failed(
                    format!(
                        "the outputs of {} and {} would have the same names",
                        other.display(),
                        path.display()
                    ),
                    "run them as two jobs with different output folders",
                )));
            }
            match parts(&path) {
                parts if parts.is_empty() => inputs.push(Input { path, stem, part: None }),
                parts => inputs.extend(parts.into_iter().map(|part| Input::of_part(&path, &stem, part))),
            }
        }
    }
    (inputs, errors)
}

/// Error for a name that would forge lines in reports and logs, or command a terminal.
fn control_characters(path: &Path, input_dir: &Path) -> Option<RunError> {
    // The folder is the user's choice.
    let name = path.strip_prefix(input_dir).unwrap_or(path).to_string_lossy();
    let problem = || format!("{name:?}: the name contains control characters");
    let has_control = name.contains(char::is_control);
    has_control.then(|| RunError::of_job(StageError::failed(problem(), "rename the file")))
}

fn stem_of(path: &Path) -> String {
    match path.to_str() {
        Some("-") => "stdin".into(),
        _ => path.file_stem().map_or(String::new(), |stem| stem.to_string_lossy().into_owned()),
    }
}

fn matches(pattern: &str, input_dir: &Path) -> Result<Vec<PathBuf>, RunError> {
    if pattern == "-" {
        return Ok(vec![PathBuf::from("-")]);
    }
    let path = input_dir.join(pattern);
    if !pattern.contains(['*', '?', '[']) || path.exists() {
        return Ok(vec![path]);
    }
    let fail = |problem: String, remedy: &str| RunError::of_job(StageError::failed(problem, remedy));
    // Escape the folder: only the text in the job is a pattern.
    let folder = glob::Pattern::escape(&input_dir.to_string_lossy());
    let is_whole = folder.is_empty() || Path::new(pattern).is_absolute();
    let whole = if is_whole { pattern.into() } else { format!("{folder}/{pattern}") };
    let found = glob::glob(&whole)
        .map_err(|e| fail(format!("invalid pattern `{pattern}`: {e}"), "write it as in `lines/*.pls`"))?;
    let mut paths = Vec::new();
    for entry in found {
        paths.push(entry.map_err(|e| fail(e.to_string(), "check the folder's permissions"))?);
    }
    if let Some(path) = not_unicode(&whole) {
        return Err(fail(format!("{}: the name is not Unicode", path.display()), "rename the file"));
    }
    if paths.is_empty() {
        return Err(fail(
            format!("no file matches `{}`", path.display()),
            "check `path` of the reader and `input_dir` of the job",
        ));
    }
    paths.sort();
    Ok(paths)
}

/// A file that would match a pattern if its name were Unicode; `glob` passes over it.
fn not_unicode(pattern: &str) -> Option<PathBuf> {
    let (folder, name) = match pattern.rsplit_once('/') {
        None => (".", pattern),
        Some(("", name)) => ("/", name),
        Some(parts) => parts,
    };
    let name = glob::Pattern::new(name).ok()?;
    let has_match = |entry: &DirEntry| {
        entry.file_name().to_str().is_none() && name.matches(&entry.file_name().to_string_lossy())
    };
    let folders = glob::glob(folder).ok()?.flatten();
    let mut entries = folders.filter_map(|folder| folder.read_dir().ok()).flatten().flatten();
    entries.find(has_match).map(|entry| entry.path())
}

/// Size of an input with its companion files, bytes; at least 1.
pub fn size(input: &Path) -> u64 {
    sizes([input]).sum()
}

/// Sizes of inputs as [`size`] gives them; lists each folder once.
pub fn sizes<'p>(inputs: impl IntoIterator<Item = &'p Path>) -> impl Iterator<Item = u64> {
    let mut index = CompanionIndex::default();
    inputs.into_iter().map(move |input| {
        let files = index.of(input).unwrap_or_default().into_iter().chain([input.to_owned()]);
        files.filter_map(|path| path.metadata().ok()).map(|about| about.len()).sum::<u64>().max(1)
    })
}

/// Output files of all runs, by the folder in which they are claimed.
pub(super) fn outputs(job: &Job, runs: &[RunContext]) -> Outputs {
    let mut outputs = Outputs::new();
    for run in runs {
        for pattern in job.stages.iter().flat_map(|stage| stage.planned.plan.outputs()) {
            let folder = fixed_folder(&run.output_dir, pattern);
            outputs.entry(folder).or_default().insert(run.output_path(pattern));
        }
    }
    outputs
}

/// Checks that no output replaces an input or a companion file of one.
///
/// `job` compares patterns; this compares actual files.
pub(super) fn keep_from_outputs(job: &Job, runs: &[RunContext]) -> Result<(), RunError> {
    let mut index = CompanionIndex::default();
    let mut inputs = BTreeSet::new();
    for run in runs {
        let companions = index.of(&run.input).map_err(|error| RunError::of_job(error.into()))?;
        let files = companions.into_iter().chain([run.input.clone()]);
        inputs.extend(files.filter_map(|path| path.canonicalize().ok()));
    }
    let patterns = || job.stages.iter().flat_map(|stage| stage.planned.plan.outputs());
    let mut outputs = runs.iter().flat_map(|run| patterns().map(|pattern| run.output_path(pattern)));
    // An output that does not exist cannot be an input.
    match outputs.find(|path| path.canonicalize().is_ok_and(|path| inputs.contains(&path))) {
        None => Ok(()),
        Some(path) => Err(RunError::of_job(StageError::failed(
            format!("the output {} would replace an input", path.display()),
            "give the output another folder or another name",
        ))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    #[test]
    fn patterns_give_files_in_order_each_once() {
        let folder = tempfile::tempdir().unwrap();
        let dir = folder.path().join("with [brackets]");
        fs::create_dir(&dir).unwrap();
        for name in ["b.pls", "a.pls", "c.las"] {
            fs::write(dir.join(name), b"").unwrap();
        }
        let paths = Paths::Many(vec!["c.las".into(), "*.pls".into(), "a.pls".into()]);
        let inputs = expand(Some(&paths), "", &dir).unwrap();
        let stems: Vec<&str> = inputs.iter().map(|input| input.stem.as_str()).collect();
        assert_eq!(stems, ["c", "a", "b"]);
    }

    #[test]
    fn parts_of_files_are_inputs() {
        let paths = Paths::Many(vec!["a.h5".into(), "b.h5".into()]);
        let parts = |path: &Path| match path.ends_with("a.h5") {
            true => vec!["B1".to_owned(), "../2".to_owned()],
            false => Vec::new(),
        };
        let (inputs, errors) = find(Some(&paths), ["", ""], Path::new("in"), parts);
        let found: Vec<_> = inputs.iter().map(|input| (input.stem.as_str(), input.part.as_deref())).collect();
        assert_eq!(found, [("a_B1", Some("B1")), ("a____2", Some("../2")), ("b", None)]);
        assert!(errors.is_empty() && inputs.iter().take(2).all(|input| input.path == Path::new("in/a.h5")));
    }

    #[test]
    fn a_pattern_without_files_is_an_error() {
        let folder = tempfile::tempdir().unwrap();
        let error = expand(Some(&Paths::One("*.sdf".into())), "", folder.path()).unwrap_err();
        let expected = format!(
            "no file matches `{}`; check `path` of the reader and `input_dir` of the job",
            folder.path().join("*.sdf").display()
        );
        assert_eq!(error.to_string(), expected);
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn names_that_are_not_unicode_are_errors() {
        use std::os::unix::ffi::OsStrExt;
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("a.pls"), b"").unwrap();
        fs::write(folder.path().join(std::ffi::OsStr::from_bytes(b"b\xff.pls")), b"").unwrap();
        let expand = |pattern: &str| expand(Some(&Paths::One(pattern.into())), "", folder.path());
        let error = expand("*.pls").unwrap_err().to_string();
        assert!(error.ends_with("b\u{fffd}.pls: the name is not Unicode; rename the file"), "{error}");
        assert_eq!(expand("a*.pls").unwrap().len(), 1, "other files do not matter");
    }

    #[cfg(unix)]
    #[test]
    fn a_name_with_control_characters_is_refused_and_shown_escaped() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("a\n\u{1b}[2J.pls"), b"").unwrap();
        let error = expand(Some(&Paths::One("*.pls".into())), "", folder.path()).unwrap_err();
        let expected = r#""a\n\u{1b}[2J.pls": the name contains control characters; rename the file"#;
        assert_eq!(error.to_string(), expected);
    }

    #[test]
    fn inputs_of_one_name_are_refused() {
        let paths = Paths::Many(vec!["a/x.pls".into(), "b/x.pls".into()]);
        let error = expand(Some(&paths), "", Path::new("in")).unwrap_err();
        assert_eq!(
            error.to_string(),
            "the outputs of in/a/x.pls and in/b/x.pls would have the same names; \
             run them as two jobs with different output folders"
        );
    }
}
