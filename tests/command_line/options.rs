//! `docs/reference/options.md`: every classic option with the tests of its effect.
//!
//! A test that finds the page outdated rewrites it and fails, so that the new one is reviewed and
//! committed.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};

use wavex::classic::becomes;
use wavex::classic::versions::VERSIONS;

mod shown;

use shown::{FEATURES, OPTIONS};

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

/// Names of all test functions in a folder, recursively.
fn tests_in(folder: &Path, names: &mut BTreeSet<String>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            tests_in(&path, names);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            let text = fs::read_to_string(&path).unwrap();
            for after in text.split("#[test]").skip(1) {
                let name = after.split_once("fn ").and_then(|(_, name)| name.split_once('('));
                names.extend(name.map(|(name, _)| name.to_owned()));
            }
        }
    }
}

/// Lines that `import` translates: text of each file of cases, by name.
fn lines() -> BTreeMap<String, String> {
    let files = fs::read_dir(root().join("tests/command_line/import/lines")).unwrap();
    let files =
        files.map(|entry| entry.unwrap().path()).filter(|path| path.extension().is_some_and(|e| e == "txt"));
    let name = |path: &Path| format!("lines/{}", path.file_stem().unwrap().display());
    files.map(|path| (name(&path), fs::read_to_string(&path).unwrap())).collect()
}

fn tests() -> BTreeSet<String> {
    let mut names = BTreeSet::new();
    ["tests", "src", "crates"].iter().for_each(|folder| tests_in(&root().join(folder), &mut names));
    names.extend(lines().into_keys());
    names
}

#[test]
fn every_test_that_the_page_names_exists() {
    let tests = tests();
    assert!(tests.len() > 1000, "{} tests", tests.len());
    let of_options = OPTIONS.iter().flat_map(|(names, tests)| tests.iter().map(move |test| (names, test)));
    let of_features = FEATURES.iter().flat_map(|(name, _, tests)| tests.iter().map(move |test| (name, test)));
    let missing: Vec<_> = of_options.chain(of_features).filter(|(_, test)| !tests.contains(**test)).collect();
    assert!(missing.is_empty(), "no such tests: {missing:?}");
}

#[test]
fn files_of_lines_contain_the_options_that_they_show() {
    let lines = lines();
    for (options, tests) in OPTIONS {
        let has = |text: &String| {
            let mut words = text.split_whitespace().filter_map(|word| word.strip_prefix('-'));
            let mut names = options.split(' ').map(|name| name.rsplit(':').next().unwrap());
            words.any(|word| names.clone().any(|name| word.trim_start_matches('-').starts_with(name)))
                && names.next().is_some()
        };
        for text in tests.iter().filter_map(|test| lines.get(*test)) {
            assert!(has(text), "{options}: {tests:?}");
        }
    }
}

/// Tests that show the effect of an option.
fn tests_of(version: &str, name: &str) -> &'static [&'static str] {
    let of = |wanted: &str| OPTIONS.iter().find(|(names, _)| names.split(' ').any(|name| name == wanted));
    let found = of(&format!("{version}:{name}")).or_else(|| of(name));
    found.map_or(&[], |(_, tests)| tests)
}

#[test]
fn every_option_has_a_test() {
    let all =
        || VERSIONS.iter().flat_map(|version| version.options.iter().map(move |option| (version, option)));
    let without: Vec<_> = all()
        .filter(|(version, option)| tests_of(version.name, option.name()).is_empty())
        .map(|(version, option)| format!("{}:{}", version.name, option.name()))
        .collect();
    assert!(without.is_empty(), "without a test: {without:?}");
    let is_option = |name: &str| {
        let (version, name) = name.split_once(':').unwrap_or(("", name));
        all().any(|(of, option)| option.name() == name && (version.is_empty() || of.name == version))
    };
    let unknown: Vec<_> =
        OPTIONS.iter().flat_map(|(names, _)| names.split(' ')).filter(|name| !is_option(name)).collect();
    assert!(unknown.is_empty(), "no such options: {unknown:?}");
}

fn named(tests: &[&str]) -> String {
    tests.iter().map(|test| format!("`{test}`")).collect::<Vec<_>>().join(", ")
}

fn page() -> String {
    let mut page = "\
# Options, keys and tests

Every option of BayesWavEx 1.0 and 1.1, the key of a job that it becomes, and the tests that show its effect. Below them are
features that have no option there. [import.md](../import.md) lists arguments and defaults.

Made from the tables of `wavex import` and from `tests/command_line/options/shown.rs` by `cargo test --test command_line options`.
"
    .to_owned();
    for version in VERSIONS {
        let _ =
            write!(page, "\n## Version {}\n\n| option | becomes | shown by |\n|---|---|---|\n", version.name);
        for option in version.options {
            let names: Vec<String> = option.names.iter().map(|name| format!("`-{name}`")).collect();
            let tests = named(tests_of(version.name, option.name()));
            let _ = writeln!(page, "| {} | {} | {tests} |", names.join(", "), becomes(option));
        }
    }
    page += "\n## Features without an option\n\n| feature | key or command | shown by |\n|---|---|---|\n";
    for (feature, key, tests) in FEATURES {
        let _ = writeln!(page, "| {feature} | {key} | {} |", named(tests));
    }
    page
}

#[test]
fn the_page_on_options_is_up_to_date() {
    let path = root().join("docs/reference/options.md");
    let found = fs::read_to_string(&path).unwrap_or_default().replace("\r\n", "\n");
    let expected = page();
    if found != expected {
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(&path, expected).unwrap();
        panic!("docs/reference/options.md was outdated and has been rewritten: review and commit it");
    }
}
