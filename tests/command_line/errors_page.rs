//! The page of errors: its messages are in the code, and the messages of jobs are on it.

use std::fs;
use std::path::{Path, PathBuf};

/// Messages of the library that parses arguments.
const OF_CLAP: [&str; 2] = ["unrecognized subcommand", "unexpected argument"];
/// Files of the job's messages that no job file causes.
const WITHOUT_JOB: [&str; 1] = ["insert.rs"];

/// A row: the messages, and whether it is in the section on jobs.
struct Row {
    messages: Vec<String>,
    is_of_job: bool,
}

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn page() -> String {
    fs::read_to_string(root().join("docs/reference/errors.md")).unwrap().replace("\r\n", "\n")
}

fn rows(page: &str) -> Vec<Row> {
    let mut rows = Vec::new();
    let mut is_of_job = false;
    for line in page.lines() {
        if let Some(title) = line.strip_prefix("## ") {
            is_of_job = title == "Job";
        }
        let Some(cells) = line.strip_prefix("| ").filter(|line| !line.starts_with("message | ")) else {
            continue;
        };
        let messages = code_spans(cells.split(" | ").next().unwrap());
        assert!(!messages.is_empty(), "no message in {line}");
        rows.push(Row { messages, is_of_job });
    }
    rows
}

/// Code spans of a text in Markdown, each delimited by a number of backticks.
fn code_spans(text: &str) -> Vec<String> {
    let mut spans = Vec::new();
    let mut rest = text;
    while let Some(start) = rest.find('`') {
        let ticks = rest[start..].bytes().take_while(|byte| *byte == b'`').count();
        let fence = "`".repeat(ticks);
        let inner = &rest[start + ticks..];
        let end = inner.find(&fence).unwrap_or_else(|| panic!("a code span is not closed: {text}"));
        spans.push(inner[..end].trim().to_owned());
        rest = inner[end + ticks..].trim_start_matches('`');
    }
    spans
}

/// Parts of a message between the varying ones.
fn parts<'m>(message: &'m str, varying: &str) -> Vec<&'m str> {
    message.split(varying).map(str::trim).filter(|part| !part.is_empty()).collect()
}

/// Whether a line is this message.
fn is_message(line: &str, message: &str) -> bool {
    let starts =
        parts(message, "…").first().is_some_and(|first| message.starts_with('…') || line.starts_with(first));
    let mut rest = line;
    let follows = |part: &str| {
        let found = rest.find(part)?;
        rest = &rest[found + part.len()..];
        Some(())
    };
    let are_in_order = parts(message, "…").into_iter().map(follows).all(|found| found.is_some());
    starts && are_in_order
}

/// Files below a folder with this extension.
fn files(folder: &Path, extension: &str) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(files(&path, extension));
        } else if path.extension().is_some_and(|own| own == extension) {
            found.push(path);
        }
    }
    found
}

/// Source text of the program without tests; texts that continue on the next line are joined.
fn source(path: &Path) -> String {
    let text = fs::read_to_string(path).unwrap().replace("\r\n", "\n");
    let code = text.split("#[cfg(test)]\nmod tests {").next().unwrap();
    let mut joined = String::new();
    for (at, line) in code.split("\\\n").enumerate() {
        joined += if at == 0 { line } else { line.trim_start() };
    }
    joined.replace("\\\"", "\"").replace("\\n", "\n")
}

#[test]
fn every_message_of_the_page_is_in_the_code() {
    let mut code = String::new();
    for path in files(&root().join("src"), "rs").into_iter().chain(files(&root().join("crates"), "rs")) {
        if !path.components().any(|part| part.as_os_str() == "tests" || part.as_os_str() == "testkit") {
            code += &source(&path);
        }
    }
    let mut count = 0;
    for message in rows(&page()).into_iter().flat_map(|row| row.messages) {
        if OF_CLAP.iter().any(|words| message.starts_with(words)) {
            continue;
        }
        for part in parts(&message, "…") {
            assert!(code.contains(part), "no message has {part:?}, of {message:?}");
        }
        count += 1;
    }
    assert!(count > 80, "only {count} messages");
}

#[test]
fn every_message_of_the_cases_of_jobs_is_on_the_page() {
    let rows = rows(&page());
    let mut count = 0;
    for path in files(&root().join("tests/command_line/job_errors"), "txt") {
        for line in fs::read_to_string(&path).unwrap().lines().filter_map(|line| line.strip_prefix("error: "))
        {
            let mut known = rows.iter().filter(|row| row.is_of_job).flat_map(|row| &row.messages);
            assert!(known.any(|message| is_message(line, message)), "{}: {line}", path.display());
            count += 1;
        }
    }
    assert!(count > 80, "only {count} messages");
}

#[test]
fn every_message_of_jobs_and_misplaced_files_is_on_the_page() {
    let page = page();
    let rows = rows(&page);
    let job = files(&root().join("crates/wavex-engine/src/job"), "rs");
    let formats =
        ["misplaced.rs", "unsupported.rs"].map(|name| root().join("crates/wavex-formats/src").join(name));
    let mut count = 0;
    for path in job.into_iter().chain(formats) {
        let is_unreachable = WITHOUT_JOB.iter().any(|name| path.ends_with(name));
        let text = source(&path);
        let places = [
            "JobError::at(",
            "JobError::of_job(",
            "let problem = ",
            "(problem, remedy) = ",
            "_owned(), remedy)",
        ];
        for place in places.iter().flat_map(|marker| text.match_indices(marker)).filter(|_| !is_unreachable) {
            let statement = text[place.0 + place.1.len()..].split(';').next().unwrap();
            let Some(literal) = statement.split('"').nth(1) else { continue };
            // Names in braces vary.
            let line = literal.split(['{', '}']).step_by(2).collect::<Vec<_>>().join("x");
            let is_known = page.contains(&line)
                || rows.iter().flat_map(|row| &row.messages).any(|message| is_message(&line, message));
            assert!(
                is_known || line.len() < 16,
                "{}: {literal:?} is not in docs/reference/errors.md",
                path.display()
            );
            count += 1;
        }
    }
    assert!(count > 30, "only {count} messages");
}

#[test]
fn code_spans_may_contain_backticks() {
    assert_eq!(code_spans("`a`, ``b `c` ``"), ["a", "b `c`"]);
    assert_eq!(code_spans("``` `…` must ```"), ["`…` must"]);
    assert!(is_message("`x` has no key `y`", "… has no key …") && !is_message("x has no key", "has no key"));
}
