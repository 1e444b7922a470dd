//! The keys of a stage.

use super::{FULL, check, check_set, parse};

#[test]
fn a_misspelt_key() {
    check(
        r#"
[[stage]]
type = "read_las"
path = "flight.las"

[[stage]]
type = "calibrate"

[[stage]]
type = "decompose"
detection_sgima = 5
"#,
        r#"
error: `decompose` has no key `detection_sgima`
  --> job.toml:10:1
   |
10 | detection_sgima = 5
   | ^^^^^^^^^^^^^^^
   |
   = help: did you mean `detection_sigma`?
   = help: keys: detection_sigma, width_ratio, longest_ns, shortest_ns, split_evidence, start, refinements
"#,
    );
}

#[test]
fn a_key_that_does_not_exist() {
    check(
        r#"
[[stage]]
type = "read_las"
path = "flight.las"
speed = 5
"#,
        r#"
error: `read_las` has no key `speed`
 --> job.toml:4:1
  |
4 | speed = 5
  | ^^^^^
  |
  = help: keys: path, time_s
"#,
    );
}

#[test]
fn a_misspelt_setting() {
    check(
        r#"
[job]
thread = 2
[[stage]]
type = "read_las"
path = "flight.las"
"#,
        r#"
error: `[job]` has no key `thread`
 --> job.toml:2:1
  |
2 | thread = 2
  | ^^^^^^
  |
  = help: did you mean `threads`?
  = help: keys: include, threads, memory_mb, input_dir, output_dir, channel_capacity, simd, report, report_page, survey_page, stat_log, log, on_error, inputs_at_once, model, survey_model, geometry, survey
"#,
    );
}

#[test]
fn a_key_that_must_be_given() {
    check(
        r#"
[[stage]]
type = "read_las"
"#,
        r#"
error: `read_las` requires the key `path`
 --> job.toml:1:1
  |
1 | [[stage]]
  | ^^^^^^^^^
  |
  = help: add `path = ...`, text or a list of texts: The files to read, one run each.
"#,
    );
}

#[test]
fn a_number_in_quotation_marks() {
    check(
        r#"
[[stage]]
type = "read_las"
path = "flight.las"

[[stage]]
type = "calibrate"

[[stage]]
type = "decompose"
detection_sigma = "4.5"
"#,
        r#"
error: `detection_sigma` must be a number, at least 1 and at most 100, got text
  --> job.toml:10:19
   |
10 | detection_sigma = "4.5"
   |                   ^^^^^
   |
   = help: write numbers without quotation marks: 4.5
"#,
    );
}

#[test]
fn text_that_is_a_number() {
    check(
        r#"
[[stage]]
type = "read_las"
path = "flight.las"

[[stage]]
type = "write_lstat"
path = 4
"#,
        r#"
error: `path` must be text, got the number 4
 --> job.toml:7:8
  |
7 | path = 4
  |        ^
  |
  = help: put text in quotation marks: `"text"`
"#,
    );
}

#[test]
fn text_that_is_a_date() {
    check(
        r#"
[[stage]]
type = "read_las"
path = "flight.las"

[[stage]]
type = "write_lstat"
path = 2018-11-14
"#,
        r#"
error: `path` must be text, got a date or a time
 --> job.toml:7:8
  |
7 | path = 2018-11-14
  |        ^^^^^^^^^^
  |
  = help: put text in quotation marks: `"text"`
"#,
    );
}

#[test]
fn a_whole_number_with_an_exponent() {
    check(
        r#"
[[stage]]
type = "read_las"
path = "flight.las"

[[stage]]
type = "calibrate"
waveforms = 1e5
"#,
        r#"
error: `waveforms` must be a whole number, at least 200, got the number 1e5
 --> job.toml:7:13
  |
7 | waveforms = 1e5
  |             ^^^
  |
  = help: write it without decimal point and exponent
"#,
    );
}

#[test]
fn a_number_that_is_too_small() {
    check(
        r#"
[job]
memory_mb = 8
[[stage]]
type = "read_las"
path = "flight.las"
"#,
        r#"
error: `memory_mb` must be at least 64 and at most 1000000000, got 8
 --> job.toml:2:13
  |
2 | memory_mb = 8
  |             ^
"#,
    );
}

#[test]
fn a_number_that_is_too_large() {
    check(
        r#"
[[stage]]
type = "read_las"
path = "flight.las"

[[stage]]
type = "calibrate"

[[stage]]
type = "decompose"
detection_sigma = 1_000.0
"#,
        r#"
error: `detection_sigma` must be at least 1 and at most 100, got 1000.0
  --> job.toml:10:19
   |
10 | detection_sigma = 1_000.0
   |                   ^^^^^^^
"#,
    );
}

#[test]
fn a_number_that_is_none() {
    check(
        r#"
[[stage]]
type = "read_las"
path = "flight.las"

[[stage]]
type = "calibrate"

[[stage]]
type = "decompose"
shortest_ns = nan
"#,
        r#"
error: `shortest_ns` must be a number, got nan, which is not a number
  --> job.toml:10:15
   |
10 | shortest_ns = nan
   |               ^^^
"#,
    );
}

#[test]
fn a_number_beyond_all_whole_numbers() {
    check(
        r#"
[[stage]]
type = "read_las"
path = "flight.las"

[[stage]]
type = "calibrate"
waveforms = 99999999999999999999
"#,
        r#"
error: `waveforms` must be a whole number, at least 200, got 99999999999999999999, which is too large
 --> job.toml:7:13
  |
7 | waveforms = 99999999999999999999
  |             ^^^^^^^^^^^^^^^^^^^^
"#,
    );
}

#[test]
fn a_number_beyond_the_type_of_its_key() {
    check(
        r#"
[[stage]]
type = "read_las"
path = "flight.las"

[[stage]]
type = "calibrate"
waveforms = 5_000_000_000
"#,
        r#"
error: `waveforms`: invalid value
 --> job.toml:7:13
  |
7 | waveforms = 5_000_000_000
  |             ^^^^^^^^^^^^^
  |
  = help: `waveforms` takes a whole number, at least 200
"#,
    );
}

#[test]
fn a_misspelt_choice() {
    check(
        r#"
[[stage]]
type = "read_las"
path = "flight.las"

[[stage]]
type = "calibrate"
background = "perwaveform"
"#,
        r#"
error: `background` must be "auto" or "per_waveform", got "perwaveform"
 --> job.toml:7:14
  |
7 | background = "perwaveform"
  |              ^^^^^^^^^^^^^
  |
  = help: did you mean `per_waveform`?
"#,
    );
}

#[test]
fn a_choice_that_does_not_exist() {
    check(
        r#"
[[stage]]
type = "read_las"
path = "flight.las"

[[stage]]
type = "calibrate"
background = "fixed"
"#,
        r#"
error: `background` must be "auto" or "per_waveform", got "fixed"
 --> job.toml:7:14
  |
7 | background = "fixed"
  |              ^^^^^^^
"#,
    );
}

#[test]
fn a_choice_without_quotation_marks() {
    check(
        r#"
[[stage]]
type = "read_las"
path = "flight.las"

[[stage]]
type = "calibrate"

[[stage]]
type = "decompose"

[[stage]]
type = "georeference"

[[stage]]
type = "write_las"
version = 1.4
"#,
        r#"
error: `version` must be "1.2" or "1.4", got the number 1.4
  --> job.toml:16:11
   |
16 | version = 1.4
   |           ^^^
   |
   = help: put text in quotation marks: `"text"`
"#,
    );
}

const REPORT_IS_A_NAME: &str = "it is the name of the JSON report, or \"\" for none; to get the report as a page, set `report_page = true`";

#[test]
fn a_report_that_is_a_truth_value() {
    for value in ["true", "false"] {
        let marks = "^".repeat(value.len());
        check(
            &format!("[job]\nreport = {value}\n{FULL}"),
            &format!(
                "error: `report` must be text, got `{value}`\n --> job.toml:2:10\n  |\n2 | report = {value}\n  |          {marks}\n  |\n  \
                 = help: {REPORT_IS_A_NAME}\n"
            ),
        );
    }
}

/// In overrides, text needs no quotation marks.
#[test]
fn a_report_that_is_set_to_a_truth_value() {
    for value in ["true", "false"] {
        let marks = "^".repeat(value.len());
        check_set(
            FULL,
            &[&format!("job.report={value}")],
            &format!(
                "error: `report`: {REPORT_IS_A_NAME}\n --> --set:1:12\n  |\n1 | job.report={value}\n  |            {marks}\n"
            ),
        );
    }
}

#[test]
fn a_page_is_asked_for_by_its_name_or_by_a_truth_value() {
    let page =
        |text: &str, set: &[&str]| parse(&format!("{text}\n{FULL}"), set).unwrap().settings.report_page;
    assert_eq!(page("", &[]), "");
    for (value, expected) in [("true", "*_report.html"), ("false", ""), ("'a.html'", "a.html"), ("''", "")] {
        assert_eq!(page(&format!("[job]\nreport_page = {value}"), &[]), expected);
        assert_eq!(page("", &[&format!("job.report_page={value}")]), expected);
    }
    assert_eq!(page("", &["job.report_page=a.html"]), "a.html");
}

#[test]
fn a_page_that_is_a_number() {
    check(
        &format!("[job]\nreport_page = 1\n{FULL}"),
        r#"
error: `report_page` must be `true` or `false` or text, got the number 1
 --> job.toml:2:15
  |
2 | report_page = 1
  |               ^
"#,
    );
}
