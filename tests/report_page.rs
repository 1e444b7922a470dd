//! `wavex report`: the page of a run.
#![allow(missing_docs, clippy::unwrap_used, clippy::panic, clippy::print_stdout)]

mod support;

use std::process::Command;

use support::{Outcome, Place, outcome};

/// Every element ends, in the order in which they began; gives how often each began.
#[track_caller]
fn elements(page: &str) -> std::collections::BTreeMap<String, usize> {
    let mut open: Vec<&str> = Vec::new();
    let mut count = std::collections::BTreeMap::new();
    let body = page.strip_prefix("<!DOCTYPE html>").unwrap();
    for part in body.split('<').skip(1) {
        let (tag, text) = part.split_once('>').unwrap_or_else(|| panic!("no end: {part}"));
        let inside_style = open.last() == Some(&"style");
        assert!(inside_style || !text.contains('>'), "unescaped: {text}");
        if let Some(name) = tag.strip_prefix('/') {
            assert_eq!(open.pop(), Some(name), "behind {part}");
            continue;
        }
        let name = tag.trim_end_matches('/').split_whitespace().next().unwrap();
        *count.entry(name.to_owned()).or_default() += 1;
        assert_eq!(tag.matches('"').count() % 2, 0, "{tag}");
        if !tag.ends_with('/') {
            open.push(name);
        }
    }
    assert_eq!(open, Vec::<&str>::new());
    count
}

fn report(place: &Place, arguments: &[&str]) -> Outcome {
    let mut command = Command::new(env!("CARGO_BIN_EXE_wavex"));
    outcome(command.args(["--quiet", "report"]).args(arguments).current_dir(place.path("")))
}

const JOB: &str = "[[stage]]\ntype = 'simulate'\nstem = 'a<b&c'\nlines = 8\nshots_per_line = 100\n\
                   [[stage]]\ntype = 'calibrate'\nwaveforms = 600\n[[stage]]\ntype = 'decompose'\n\
                   [[stage]]\ntype = 'georeference'\n[[stage]]\ntype = 'write_lstat'\n";

#[test]
fn the_page_is_whole_and_needs_nothing_else() {
    let place = Place::new();
    let done = Outcome { code: Some(0), err: String::new() };
    assert_eq!(place.run(JOB), done);
    assert!(place.outputs().contains(&"a<b&c_stat.log".to_owned()), "{:?}", place.outputs());
    assert_eq!(report(&place, &["out"]), done);
    let page = place.text("out/report.html");
    let count = elements(&page);
    assert_eq!(count["svg"], 3, "times, and the responses of two receivers");
    assert!(count["rect"] >= 3 * 5 && count["polyline"] >= 3, "{count:?}");
    for forbidden in ["<script", "http", "url(", "src=", "@import", "<link"] {
        assert!(!page.contains(forbidden), "{forbidden}");
    }
    assert!(page.contains("prefers-color-scheme:dark") && page.contains("@media print"));
    assert!(page.contains("<h1>a&lt;b&amp;c</h1>"));
    assert_eq!(report(&place, &["out/report.json", "-o", "other.html"]), done);
    assert_eq!(place.text("other.html"), page);
}

#[test]
fn what_is_no_report_is_said() {
    let place = Place::with(&[("a.json", b"{}"), ("b.json", b"not JSON")]);
    let refused = |path: &str, problem: &str| {
        let Outcome { code, err } = report(&place, &[path]);
        assert!(code == Some(1) && err.starts_with(&format!("error: {problem}")), "{err}");
    };
    refused("a.json", "a.json: no report of a run: it has no `inputs`; give the report.json of a run");
    refused("b.json", "b.json: no report of a run: expected");
    refused("gone.json", "gone.json: cannot open the report: ");
}
