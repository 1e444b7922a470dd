//! Errors in jobs with the displayed text and position: one test per message.

use wavex::job::{Include, Job, JobErrors, Override};
use wavex_testkit::job_stages;

mod chain;
mod geometry;
mod includes;
mod keys;
mod nested_keys;
mod never_panics;
mod overrides;
mod stage_keys;
mod stages_and_ids;
mod syntax;

/// A valid job.
const FULL: &str = "\
[[stage]]
type = \"read_las\"
path = \"flight.las\"

[[stage]]
type = \"calibrate\"

[[stage]]
type = \"decompose\"

[[stage]]
type = \"georeference\"

[[stage]]
type = \"write_las\"
";

fn parse(text: &str, overrides: &[&str]) -> Result<Job, JobErrors> {
    let overrides: Vec<Override> = overrides.iter().copied().map(Override::new).collect();
    Job::parse_with(job_stages::STAGES, "job.toml", text, &[], &overrides)
}

/// Asserts the errors of a job that includes `base.toml` with this content.
fn check_included(included: &str, expected: &str) {
    let text = format!("[job]\ninclude = \"base.toml\"\n{FULL}");
    let included =
        Include { name: "base.toml".into(), text: included.strip_prefix('\n').unwrap_or(included).into() };
    match Job::parse_with(job_stages::STAGES, "job.toml", &text, &[included], &[]) {
        Ok(job) => panic!("no error: {}", job.chain()),
        Err(errors) => assert_eq!(errors.to_string(), expected.strip_prefix('\n').unwrap_or(expected)),
    }
}

/// Asserts the errors of a job; it starts after the first line feed of `text`.
fn check(text: &str, expected: &str) {
    check_set(text, &[], expected);
}

/// Asserts the errors of a job with overrides.
fn check_set(text: &str, overrides: &[&str], expected: &str) {
    let text = text.strip_prefix('\n').unwrap_or(text);
    match parse(text, overrides) {
        Ok(job) => panic!("no error: {}", job.chain()),
        Err(errors) => assert_eq!(errors.to_string(), expected.strip_prefix('\n').unwrap_or(expected)),
    }
}
