//! Paths of a classic command line, as the job writes them.

use super::line::{Given, Value};
use super::options::{Becomes, Form, Part};

/// Folders of a command line.
#[derive(Debug, Default, PartialEq)]
pub struct Paths {
    /// `-I`.
    input: Option<String>,
    /// `-O`.
    output: Option<String>,
    /// Folder at which relative paths of the line start, if the job is in another folder.
    base: Option<String>,
    /// Whether some input files contain a folder; `-I` then prefixes each of the others.
    has_own_folders: bool,
}

impl Paths {
    /// Folders given by these options.
    pub fn of(given: &[Given], base: Option<&str>) -> Paths {
        let folder =
            |part| given.iter().find(|given| given.option.becomes == Becomes::Part(part)).and_then(text);
        let files = given.iter().flat_map(files);
        Paths {
            input: folder(Part::InputDir),
            output: folder(Part::OutputDir),
            base: base.map(str::to_owned),
            has_own_folders: files.into_iter().any(|file| has_folder(&file)),
        }
    }

    /// Path of an input file in the job.
    pub fn input(&self, file: &str) -> String {
        match &self.input {
            Some(folder) if self.has_own_folders && !has_folder(file) => joined(folder, file),
            _ => file.to_owned(),
        }
    }

    /// Path of an input of the job, relative to the current folder.
    ///
    /// `file` is a result of [`Paths::input`].
    pub fn here(&self, file: &str) -> String {
        match &self.input {
            Some(folder) if !self.has_own_folders => joined(folder, file),
            _ => file.to_owned(),
        }
    }

    /// Path of an output, relative to the current folder.
    pub fn output(&self, file: &str) -> String {
        self.output.as_ref().map_or(file.to_owned(), |folder| joined(folder, file))
    }

    /// `input_dir` of the job.
    pub fn input_dir(&self) -> Option<String> {
        self.below_base(self.input.as_deref().filter(|_| !self.has_own_folders))
    }

    /// `output_dir` of the job.
    pub fn output_dir(&self) -> Option<String> {
        self.below_base(self.output.as_deref())
    }

    /// Returns whether `-I` prefixes individual files.
    pub fn is_prefixed(&self) -> bool {
        self.input.is_some() && self.has_own_folders
    }

    fn below_base(&self, folder: Option<&str>) -> Option<String> {
        match (&self.base, folder) {
            (Some(base), Some(folder)) => Some(joined(base, folder)),
            (Some(base), None) => Some(base.clone()),
            (None, folder) => folder.map(str::to_owned),
        }
    }
}

/// Joins a folder and a path.
fn joined(folder: &str, path: &str) -> String {
    if is_absolute(path) || folder.is_empty() {
        return path.to_owned();
    }
    let separator = if folder.ends_with(['/', '\\']) { "" } else { "/" };
    format!("{folder}{separator}{path}")
}

/// Returns whether a path is absolute on Unix or Windows.
fn is_absolute(path: &str) -> bool {
    path.starts_with(['/', '\\']) || path.get(1..2) == Some(":")
}

/// Returns whether a path contains a folder.
fn has_folder(file: &str) -> bool {
    file.contains(['/', '\\'])
}

/// Input files named by an option.
fn files(given: &Given) -> Vec<String> {
    match (given.option.becomes, &given.value) {
        (Becomes::Part(Part::Input), Value::Texts(files)) => files.clone(),
        (Becomes::Key(_, _, Form::File | Form::Angles), Value::Text(file)) => vec![file.clone()],
        _ => Vec::new(),
    }
}

fn text(given: &Given) -> Option<String> {
    match &given.value {
        Value::Text(text) => Some(text.clone()),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::line::read_line;
    use crate::versions;

    fn paths(line: &str, base: Option<&str>) -> Paths {
        let words: Vec<String> = line.split(' ').map(str::to_owned).collect();
        let (given, problems) = read_line(versions::find("1.1").unwrap(), &words);
        assert!(problems.is_empty(), "{problems:?}");
        Paths::of(&given, base)
    }

    #[test]
    fn plain_names_lie_in_the_folder_of_inputs() {
        let paths = paths("-i a.sdf -po b.pof -I in -O out", None);
        assert_eq!((paths.input_dir().as_deref(), paths.output_dir().as_deref()), (Some("in"), Some("out")));
        assert_eq!((paths.input("a.sdf"), paths.here("a.sdf")), ("a.sdf".into(), "in/a.sdf".into()));
        assert_eq!(paths.output("po.txt"), "out/po.txt");
        assert!(!paths.is_prefixed());
    }

    #[test]
    fn a_file_with_a_folder_does_not_lie_there() {
        let paths = paths("-i a.sdf -po po/b.pof -I in", None);
        assert_eq!(paths.input_dir(), None);
        assert_eq!((paths.input("a.sdf"), paths.input("po/b.pof")), ("in/a.sdf".into(), "po/b.pof".into()));
        assert_eq!(paths.here("in/a.sdf"), "in/a.sdf");
        assert!(paths.is_prefixed());
    }

    #[test]
    fn a_job_elsewhere_says_where_the_line_was_typed() {
        let paths = paths("-i a.sdf -O F:\\out", Some("/jobs"));
        assert_eq!(paths.input_dir().as_deref(), Some("/jobs"));
        assert_eq!(paths.output_dir().as_deref(), Some("F:\\out"), "absolute on its own system");
        assert_eq!(joined("in/", "a"), "in/a");
        assert_eq!(joined("in", "/a"), "/a");
    }
}
