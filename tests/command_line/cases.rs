//! The runner of text cases fails where it must.

use std::fs;
use std::path::Path;

use wavex_testkit::TestFolder;
use wavex_testkit::cases::{Case, problems};

/// A folder with one file of cases.
fn folder(text: &str) -> TestFolder {
    TestFolder::with(&[("inner/case.txt", text.as_bytes())])
}

/// Doubles the section `input`; refuses the input `2`.
fn double(case: &Case) -> Result<String, String> {
    case.only(|name| name == "input")?;
    match case.one("input")?.trim_end() {
        "2" => Err("2 is refused".to_owned()),
        text => Ok(format!("a\n{text}{text}\nz\n")),
    }
}

/// Problems of a file of cases.
fn of(text: &str, update: bool) -> Vec<String> {
    problems(&folder(text).path(""), update, double)
}

/// Text of a file of cases after an update.
fn updated(text: &str) -> String {
    let place = folder(text);
    assert_eq!(problems(&place.path(""), true, double), Vec::<String>::new());
    place.text("inner/case.txt")
}

const RIGHT: &str = "A comment.\n\n==== input\nx\n==== expected\na\nxx\nz\n";

#[test]
fn expected_results_are_accepted() {
    assert_eq!(of(RIGHT, false), Vec::<String>::new());
    assert_eq!(of(&RIGHT.replace('\n', "\r\n"), false), Vec::<String>::new());
    assert_eq!(updated(RIGHT), RIGHT);
}

#[test]
fn a_different_result_is_shown_by_lines() {
    let wrong = format!("{RIGHT}\n==== input\ny\n==== expected\na\nxy\nz\n");
    let name = Path::new("inner").join("case.txt");
    let expected = format!(
        "{}:10: the result differs from the expected one (-)\n    a\n  - xy\n  + yy\n    z\n",
        name.display()
    );
    assert_eq!(of(&wrong, false), [expected]);
    assert_eq!(updated(&wrong), wrong.replace("xy", "yy"));
}

#[test]
fn a_case_without_expected_result_fails() {
    for text in ["", "x\n", "==== input\nx\n", "==== expected\na\nxx\nz\n==== input\nx\n"] {
        for update in [false, true] {
            let problems = of(text, update);
            assert!(
                problems.iter().any(|problem| problem.contains("`==== expected`")),
                "{text:?} {problems:?}"
            );
        }
    }
    for empty in
        ["==== input\nx\n==== expected", "==== input\nx\n==== expected\n\n==== input\ny\n==== expected\n"]
    {
        assert!(of(empty, false)[0].contains("+ xx"), "{empty:?}");
    }
    let two = "==== input\nx\n==== expected\n\n==== input\ny\n==== expected\n";
    assert_eq!(
        updated(two),
        "==== input\nx\n==== expected\na\nxx\nz\n\n==== input\ny\n==== expected\na\nyy\nz\n"
    );
}

#[test]
fn a_refused_case_fails_also_in_an_update() {
    let text = RIGHT.replace("\nx\n", "\n2\n");
    for update in [false, true] {
        assert!(of(&text, update)[0].ends_with("case.txt:1: 2 is refused"));
    }
    assert!(of(&RIGHT.replace("==== input", "==== inptu"), false)[0].contains("`inptu`"));
    assert!(of(&format!("==== input\ny\n{RIGHT}"), false)[0].contains("2 sections `input`"));
}

#[test]
fn a_folder_without_cases_fails() {
    let place = TestFolder::with(&[("README.md", b""), ("mod.rs", b"")]);
    assert!(problems(&place.path(""), false, double)[0].ends_with(": no cases"));
    fs::write(place.path("case.toml"), RIGHT).unwrap();
    assert!(problems(&place.path(""), false, double)[0].ends_with("case.toml: a file of cases ends in .txt"));
}
