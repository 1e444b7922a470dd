//! Error messages of wrong jobs.
//!
//! The cases are the text files in the folders of `job_errors`; its README explains their form.

use std::path::Path;

use wavex::job::{Include, Job, JobErrors, Override, included};
use wavex::registry::STAGES;
use wavex_testkit::cases::{self, Case};
use wavex_testkit::job_stages;

mod never_panics;

/// A valid job of [`job_stages`].
const FULL: &str = "[[stage]]\ntype = \"read_las\"\npath = \"flight.las\"\n\n[[stage]]\ntype = \"calibrate\"\n\n\
                    [[stage]]\ntype = \"decompose\"\n\n[[stage]]\ntype = \"georeference\"\n\n[[stage]]\ntype = \"write_las\"\n";

/// Parses a job of [`job_stages`].
fn parse(text: &str, overrides: &[&str]) -> Result<Job, JobErrors> {
    let overrides: Vec<Override> = overrides.iter().copied().map(Override::new).collect();
    Job::parse_with(job_stages::STAGES, "job.toml", text, &[], &overrides)
}

/// Error messages of the job of a case.
fn errors(case: &Case) -> Result<String, String> {
    let text = case.one("job.toml")?;
    let names = included(text);
    case.only(|name| ["job.toml", "--set"].contains(&name) || names.iter().any(|included| included == name))?;
    let read = |name: &String| Ok(Include { name: name.clone(), text: case.one(name)?.to_owned() });
    let includes: Vec<Include> = names.iter().map(read).collect::<Result<_, String>>()?;
    let set = case.all("--set").into_iter().map(|text| Override::new(text.trim_end_matches('\n')));
    match Job::parse_with(STAGES, "job.toml", text, &includes, &set.collect::<Vec<_>>()) {
        Ok(job) => Err(format!("the job is accepted: {}", job.chain())),
        Err(errors) => Ok(errors.to_string()),
    }
}

#[test]
fn wrong_jobs_get_the_expected_messages() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/command_line/job_errors");
    cases::check(&folder, errors);
}

/// Whether a job is valid, no case of errors.
#[test]
fn a_valid_job_is_refused_as_a_case() {
    let case = |text: &str| Case { sections: vec![("job.toml".to_owned(), text.to_owned())] };
    let accepted = errors(&case("[[stage]]\ntype = \"simulate\"\n"));
    assert_eq!(accepted, Err("the job is accepted: simulate -> Shots".to_owned()));
    assert!(errors(&case("[job]\ninclude = \"base.toml\"\n")).unwrap_err().contains("`base.toml`"));
}

/// No registered stage has such keys.
#[test]
fn tables_of_stages_and_texts_of_special_types() {
    let chain = FULL.split("\n[[stage]]\ntype = \"write_las\"").next().unwrap();
    let missing = "error: `mount` of `georeference` requires the key `forward_m`\n  --> job.toml:13:1\n   |\n\
                   13 | [stage.mount]\n   | ^^^^^^^^^^^^^\n   |\n   \
                   = help: add `forward_m = ...`, a number: To the front.\n";
    let item = "error: `forward_m` must be a number, got text\n  --> job.toml:13:45\n   |\n\
                13 | control = [{ forward_m = 1 }, { forward_m = \"x\" }]\n   |                                             ^^^\n";
    let text = "error: `crs`: \"utm\" is no code of a system\n  --> job.toml:13:7\n   |\n13 | crs = \"utm\"\n   \
                |       ^^^^^\n   |\n   = help: `crs` takes text\n";
    for (keys, expected) in [
        ("[stage.mount]\nright_m = 2\n", missing),
        ("control = [{ forward_m = 1 }, { forward_m = \"x\" }]\n", item),
        ("crs = \"utm\"\n", text),
    ] {
        assert_eq!(parse(&format!("{chain}{keys}"), &[]).unwrap_err().to_string(), expected);
    }
}

#[test]
fn colours_change_nothing_but_the_colour() {
    let errors = parse("[[stage]]\ntype = \"read_las\"\npath = 3\n", &[]).unwrap_err();
    let mut plain = errors.render(true);
    assert!(plain.starts_with("\x1b[1m\x1b[91merror\x1b[0m\x1b[1m: `path` must be"), "{plain:?}");
    for code in ["\x1b[1m", "\x1b[91m", "\x1b[94m", "\x1b[0m"] {
        plain = plain.replace(code, "");
    }
    assert_eq!(plain, errors.to_string());
}

/// A file of cases cannot hold these characters visibly.
#[test]
fn line_ends_of_windows_and_control_characters() {
    let windows = parse("[[stage]]\r\ntype = 3\r\n", &[]).unwrap_err().to_string();
    assert!(windows.ends_with("\n2 | type = 3\n  |        ^\n"), "{windows:?}");
    let errors = parse("[[stage]]\ntype = \"simulate\"\n\"\\u001b[2J\" = 1 # \u{9b}2J\n", &[]).unwrap_err();
    let expected = "error: `simulate` has no key `\u{fffd}[2J`\n --> job.toml:3:1\n  |\n3 | \"\\u001b[2J\" = 1 # \u{fffd}2J\n  \
                    | ^^^^^^^^^^^\n  |\n  = help: keys: lines\n";
    assert_eq!(errors.to_string(), expected);
}
