//! Tests whose cases are text files with an input and the expected result.
//!
//! A case consists of sections. A line `==== NAME` begins a section, and the section `expected` ends
//! the case. A file has one case or several. Text above its first section is a comment.
//!
//! ```text
//! Text needs quotation marks.
//!
//! ==== job.toml
//! [[stage]]
//! type = simulate
//! ==== expected
//! error: invalid TOML: string values must be quoted, expected literal string
//! ```
//!
//! Blank lines at the end of a result do not count. [`UPDATE`] rewrites the sections `expected`.

use std::fs;
use std::path::{Path, PathBuf};

/// Environment variable that rewrites the expected results, if it is `1`.
pub const UPDATE: &str = "UPDATE_EXPECTED";

/// Beginning of the line above a section.
const MARK: &str = "==== ";
/// Name of the last section of a case.
const EXPECTED: &str = "expected";

/// A case: its sections except the expected result.
pub struct Case {
    /// Name and text of each section, in order.
    pub sections: Vec<(String, String)>,
}

impl Case {
    /// Text of the only section of this name.
    ///
    /// # Errors
    /// If there is none, or several.
    pub fn one(&self, name: &str) -> Result<&str, String> {
        match self.all(name).as_slice() {
            [text] => Ok(text),
            texts => Err(format!("the case has {} sections `{name}` instead of one", texts.len())),
        }
    }

    /// Texts of all sections of this name.
    pub fn all(&self, name: &str) -> Vec<&str> {
        self.sections.iter().filter(|(found, _)| found == name).map(|(_, text)| text.as_str()).collect()
    }

    /// Fails if the case has a section that `is_known` does not know.
    ///
    /// # Errors
    /// Names the first unknown section.
    pub fn only(&self, is_known: impl Fn(&str) -> bool) -> Result<(), String> {
        match self.sections.iter().find(|(name, _)| !is_known(name)) {
            Some((name, _)) => Err(format!("nothing uses the section `{name}`")),
            None => Ok(()),
        }
    }
}

/// Compares the result of every case below a folder with the expected one.
///
/// # Panics
/// If a result differs, with all differences; see [`problems`].
pub fn check(folder: &Path, run: impl Fn(&Case) -> Result<String, String>) {
    let update = std::env::var_os(UPDATE).is_some_and(|value| value == "1");
    let problems = problems(folder, update, run);
    let n = problems.len();
    assert!(n == 0, "{}\n{n} wrong cases; {UPDATE}=1 rewrites expected results", problems.join("\n"));
}

/// Runs every case in the `.txt` files below a folder; returns one text per problem.
///
/// A problem is a folder without cases, a case without an expected result, a case that `run` refuses,
/// a difference (unless `update`), and a file that cannot be read as cases.
pub fn problems(folder: &Path, update: bool, run: impl Fn(&Case) -> Result<String, String>) -> Vec<String> {
    let (mut files, mut problems) = (Vec::new(), Vec::new());
    collect(folder, &mut files, &mut problems);
    if files.is_empty() {
        problems.push(format!("{}: no cases", folder.display()));
    }
    for file in files {
        let name = file.strip_prefix(folder).unwrap_or(&file).display().to_string();
        let text = fs::read_to_string(&file).unwrap().replace("\r\n", "\n").trim_end().to_owned() + "\n";
        let mut new = String::new();
        for (line, case) in split(&text) {
            match check_case(case, update, &run) {
                Ok(text) => new += &text,
                Err(problem) => {
                    problems.push(format!("{name}:{line}: {problem}"));
                    new += case;
                }
            }
        }
        if update && new != text {
            fs::write(&file, new).unwrap();
        }
    }
    problems
}

/// Collects the `.txt` files below a folder in the order of their names.
///
/// Any other file except a README and Rust code is a problem: it could be a case that never runs.
fn collect(folder: &Path, files: &mut Vec<PathBuf>, problems: &mut Vec<String>) {
    let mut entries: Vec<PathBuf> =
        fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    entries.sort();
    for path in entries {
        let extension = path.extension().unwrap_or_default();
        if path.is_dir() {
            collect(&path, files, problems);
        } else if extension == "txt" {
            files.push(path);
        } else if extension != "rs" && !path.ends_with("README.md") {
            problems.push(format!("{}: a file of cases ends in .txt", path.display()));
        }
    }
}

/// Splits the text of a file into cases, each with the number of its first line.
///
/// The section after `expected` begins the next case.
fn split(text: &str) -> Vec<(usize, &str)> {
    let mut cases = Vec::new();
    let (mut start, mut first_line, mut in_expected, mut at) = (0, 1, false, 0);
    for (index, line) in text.split_inclusive('\n').enumerate() {
        if let Some(name) = line.strip_prefix(MARK) {
            if in_expected {
                cases.push((first_line, &text[start..at]));
                (start, first_line) = (at, index + 1);
            }
            in_expected = name.trim_end() == EXPECTED;
        }
        at += line.len();
    }
    cases.push((first_line, &text[start..]));
    cases
}

/// Checks the text of a case; returns it with the actual result if `update`.
fn check_case(
    text: &str,
    update: bool,
    run: impl Fn(&Case) -> Result<String, String>,
) -> Result<String, String> {
    let mut sections = sections(text);
    let Some((_, expected)) = sections.pop().filter(|(name, _)| name == EXPECTED) else {
        return Err(format!("the case does not end with a section `{MARK}{EXPECTED}`"));
    };
    let result = run(&Case { sections })?;
    let (expected, result) = (expected.trim_end(), result.trim_end());
    if expected == result {
        return Ok(text.to_owned());
    }
    if result.is_empty() {
        return Err("the result is empty".to_owned());
    }
    if !update {
        return Err(format!(
            "the result differs from the expected one (-)\n{}",
            difference(expected, result)
        ));
    }
    let header = text.rfind(&format!("\n{MARK}")).map_or(0, |at| at + 1);
    let start = header + text[header..].find('\n').map_or(text.len() - header, |at| at + 1);
    let (head, body) = text.split_at(start);
    let blank_lines =
        if expected.is_empty() { format!("\n{body}") } else { body[body.trim_end().len()..].to_owned() };
    Ok(format!("{head}{result}{blank_lines}"))
}

/// Name and text of each section.
fn sections(text: &str) -> Vec<(String, String)> {
    let mut sections: Vec<(String, String)> = Vec::new();
    for line in text.split_inclusive('\n') {
        match (line.strip_prefix(MARK), sections.last_mut()) {
            (Some(name), _) => sections.push((name.trim_end().to_owned(), String::new())),
            (None, Some((_, text))) => text.push_str(line),
            (None, None) => {}
        }
    }
    sections
}

/// Lines of both texts: `-` expected, `+` actual, others common.
fn difference(expected: &str, actual: &str) -> String {
    let (old, new): (Vec<&str>, Vec<&str>) = (expected.lines().collect(), actual.lines().collect());
    let same = |(a, b): &(&&str, &&str)| a == b;
    let before = old.iter().zip(&new).take_while(same).count();
    let after = old[before..].iter().rev().zip(new[before..].iter().rev()).take_while(same).count();
    let marked = |mark: &str, lines: &[&str]| -> String {
        lines.iter().map(|line| format!("  {mark} {line}\n")).collect()
    };
    marked(" ", &old[..before])
        + &marked("-", &old[before..old.len() - after])
        + &marked("+", &new[before..new.len() - after])
        + &marked(" ", &old[old.len() - after..])
}
