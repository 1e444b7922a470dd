//! `wavex import`: lines of the classic program as jobs.
#![allow(missing_docs, clippy::unwrap_used, clippy::panic)]

mod documents;
mod examples;
mod lines;
mod refused;
mod runs;
#[path = "../support/mod.rs"]
mod support;
mod table;
mod truth;

use wavex::cli::import::draft::Known;
use wavex::cli::import::{Import, Place, import};
use wavex::job::Job;

/// The words of a line without blanks inside them.
fn words(line: &str) -> Vec<String> {
    line.split_whitespace().map(str::to_owned).collect()
}

/// Files beside the line: mounting angles.
fn files(path: &str) -> Option<String> {
    (path == "mnt.txt").then(|| "0.5 -0.25 90\n".to_owned())
}

/// A line in the version that its input tells, with these files beside it.
fn read_with(line: &str, known: &Known, read: &dyn Fn(&str) -> Option<String>) -> Result<Import, String> {
    in_version(None, &words(line), known, read)
}

/// Words in a version. Trajectories whose names begin with `s` begin in the south; those that begin with `u` cannot be read.
fn in_version(
    classic: Option<&str>,
    words: &[String],
    known: &Known,
    read: &dyn Fn(&str) -> Option<String>,
) -> Result<Import, String> {
    let latitude = |file: &str, _: Option<&str>| match file {
        file if file.starts_with('s') => Some(-33.0),
        file if file.starts_with('u') => None,
        _ => Some(47.0),
    };
    import(words, classic, &Place { known, base: None, read, latitude: &latitude })
}

/// What a line becomes where every stage and every key is there.
#[track_caller]
fn complete(line: &str) -> Import {
    read_with(line, &Known::Everything, &files).unwrap_or_else(|problem| panic!("{problem}"))
}

/// What a line becomes in this build; its job must fit.
#[track_caller]
fn here(line: &str) -> Import {
    let import = read_with(line, &Known::this_build(), &files).unwrap_or_else(|problem| panic!("{problem}"));
    if import.has_job {
        let job = Job::parse("job", &import.text, &[]);
        assert!(job.is_ok(), "{}\n{}", job.unwrap_err(), import.text);
    }
    import
}

/// The job without its comments: every key as `section.key = value`.
fn keys(text: &str) -> Vec<String> {
    let table: toml::Table = toml::from_str(text).unwrap_or_else(|error| panic!("{error}\n{text}"));
    let mut keys = Vec::new();
    let job = table.get("job").and_then(toml::Value::as_table);
    for (key, value) in job.into_iter().flatten() {
        match value.as_table() {
            Some(inner) => keys.extend(inner.iter().map(|(key, value)| format!("geometry.{key} = {value}"))),
            None => keys.push(format!("job.{key} = {value}")),
        }
    }
    for stage in table.get("stage").and_then(toml::Value::as_array).into_iter().flatten() {
        let stage = stage.as_table().unwrap();
        let name = stage["type"].as_str().unwrap();
        let own = stage.iter().filter(|(key, _)| *key != "type");
        keys.extend(own.map(|(key, value)| format!("{name}.{key} = {value}")));
    }
    keys
}

/// The stages of a job, in order.
fn stages(text: &str) -> Vec<String> {
    let table: toml::Table = toml::from_str(text).unwrap();
    let stages = table["stage"].as_array().unwrap().iter();
    stages.map(|stage| stage["type"].as_str().unwrap().to_owned()).collect()
}
