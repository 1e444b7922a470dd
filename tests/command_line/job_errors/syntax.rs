//! TOML syntax, tables, and display of errors.

use super::{check, parse};

#[test]
fn an_empty_job() {
    check(
        r#"
"#,
        r#"
error: the job has no stage
--> job.toml
 = help: `wavex init` writes a starter job; `wavex stages` lists the stages
"#,
    );
}

#[test]
fn text_without_quotation_marks() {
    check(
        r#"
[[stage]]
type = read_las
"#,
        r#"
error: invalid TOML: string values must be quoted, expected literal string
 --> job.toml:2:8
  |
2 | type = read_las
  |        ^^^^^^^^
  |
  = help: put text in quotation marks: `"text"`
"#,
    );
}

#[test]
fn a_header_that_does_not_end() {
    check(
        r#"
[[stage]
type = read_las
path = 
"#,
        r#"
error: invalid TOML: unclosed array table, expected `]`
 --> job.toml:1:9
  |
1 | [[stage]
  |         ^
"#,
    );
}

#[test]
fn several_lines_that_are_not_toml() {
    check(
        r#"
[[stage]]
type = read_las

[[stage]]
type = calibrate
"#,
        r#"
error: invalid TOML: string values must be quoted, expected literal string
 --> job.toml:2:8
  |
2 | type = read_las
  |        ^^^^^^^^
  |
  = help: put text in quotation marks: `"text"`

error: invalid TOML: string values must be quoted, expected literal string
 --> job.toml:5:8
  |
5 | type = calibrate
  |        ^^^^^^^^^
  |
  = help: put text in quotation marks: `"text"`
"#,
    );
}

#[test]
fn a_key_given_twice() {
    check(
        r#"
[[stage]]
type = "read_las"
path = "flight.las"
path = "other.las"
"#,
        r#"
error: invalid TOML: duplicate key
 --> job.toml:4:1
  |
4 | path = "other.las"
  | ^^^^
"#,
    );
}

#[test]
fn a_table_that_is_no_part_of_a_job() {
    check(
        r#"
[engine]
threads = 2

[[stage]]
type = "read_las"
path = "flight.las"
"#,
        r#"
error: unknown top-level key `engine`
 --> job.toml:1:2
  |
1 | [engine]
  |  ^^^^^^
  |
  = help: a job has one table `[job]` and one `[[stage]]` per stage
"#,
    );
}

#[test]
fn a_misspelt_stage_header() {
    check(
        r#"
[[stages]]
type = "read_las"
"#,
        r#"
error: unknown top-level key `stages`
 --> job.toml:1:3
  |
1 | [[stages]]
  |   ^^^^^^
  |
  = help: did you mean `[[stage]]`?
"#,
    );
}

#[test]
fn a_misspelt_job_header() {
    check(
        r#"
[jobs]
[[stage]]
type = "read_las"
path = "flight.las"
"#,
        r#"
error: unknown top-level key `jobs`
 --> job.toml:1:2
  |
1 | [jobs]
  |  ^^^^
  |
  = help: did you mean `[job]`?
"#,
    );
}

#[test]
fn a_setting_outside_of_its_table() {
    check(
        r#"
threads = 2
[[stage]]
type = "read_las"
path = "flight.las"
"#,
        r#"
error: unknown top-level key `threads`
 --> job.toml:1:1
  |
1 | threads = 2
  | ^^^^^^^
  |
  = help: move `threads` to `[job]`
"#,
    );
}

#[test]
fn job_that_is_no_table() {
    check(
        r#"
job = 3
[[stage]]
type = "read_las"
path = "flight.las"
"#,
        r#"
error: `job` must be a table
 --> job.toml:1:7
  |
1 | job = 3
  |       ^
  |
  = help: write `[job]` above its keys
"#,
    );
}

#[test]
fn a_stage_header_with_single_brackets() {
    check(
        r#"
[stage]
type = "read_las"
"#,
        r#"
error: `stage` must be a list of tables
 --> job.toml:1:1
  |
1 | [stage]
  | ^^^^^^^
  |
  = help: write `[[stage]]`, with two brackets, above the keys of each stage
"#,
    );
}

#[test]
fn a_stage_that_is_no_table() {
    check(
        r#"
stage = [3]
"#,
        r#"
error: `stage` must be a table
 --> job.toml:1:10
  |
1 | stage = [3]
  |          ^
  |
  = help: write `[[stage]]` above its keys
"#,
    );
}

#[test]
fn everything_at_once() {
    check(
        r#"
[job]
memory = 8
threads = "all"

[[stage]]
type = "read_las"
time = 3

[[stage]]
type = "decompose"
detection_sigma = 0
width_ratio = 3
refinements = -1

[[stage]]
type = "write_las"
"#,
        r#"
error: `[job]` has no key `memory`
 --> job.toml:2:1
  |
2 | memory = 8
  | ^^^^^^
  |
  = help: keys: include, threads, memory_mb, input_dir, output_dir, channel_capacity, simd, report, report_page, survey_page, stat_log, log, on_error, inputs_at_once, model, survey_model, geometry, survey

error: `threads` must be a whole number, at least 0, got text
 --> job.toml:3:11
  |
3 | threads = "all"
  |           ^^^^^

error: `read_las` requires the key `path`
 --> job.toml:5:1
  |
5 | [[stage]]
  | ^^^^^^^^^
  |
  = help: add `path = ...`, text or a list of texts: The files to read, one run each.

error: `read_las` has no key `time`
 --> job.toml:7:1
  |
7 | time = 3
  | ^^^^
  |
  = help: keys: path, time_s

error: `decompose` requires `calibrate` before it
  --> job.toml:10:8
   |
10 | type = "decompose"
   |        ^^^^^^^^^^^
   |
   = help: insert `calibrate` before it

error: `detection_sigma` must be at least 1 and at most 100, got 0
  --> job.toml:11:19
   |
11 | detection_sigma = 0
   |                   ^

error: `width_ratio` must be a list of 2 numbers, got the number 3
  --> job.toml:12:15
   |
12 | width_ratio = 3
   |               ^

error: `refinements` must be at least 0 and at most 65535, got -1
  --> job.toml:13:15
   |
13 | refinements = -1
   |               ^^

error: `write_las` takes Points, but receives Returns
  --> job.toml:16:8
   |
16 | type = "write_las"
   |        ^^^^^^^^^^^
   |
   = help: insert `georeference` before it
"#,
    );
}

#[test]
fn a_tab_and_a_wide_character_keep_the_caret_in_place() {
    check(
        "\n[[stage]]\ntype = \"read_las\"\npath = \"é.las\"\n\tspeed\t= 5\n",
        r#"
error: `read_las` has no key `speed`
 --> job.toml:4:2
  |
4 |  speed = 5
  |  ^^^^^
  |
  = help: keys: path, time_s
"#,
    );
}

#[test]
fn lines_may_end_as_on_windows() {
    check(
        "[[stage]]\r\ntype = \"read_lsa\"\r\n",
        r#"
error: unknown stage `read_lsa`
 --> job.toml:2:8
  |
2 | type = "read_lsa"
  |        ^^^^^^^^^^
  |
  = help: did you mean `read_las`?
  = help: stages: read_las, simulate, calibrate, decompose, georeference, write_las, write_lstat, write_shots
"#,
    );
}

#[test]
fn colours_change_nothing_but_the_colour() {
    let errors = parse("[[stage]]\ntype = \"read_las\"\npath = 3\n", &[]).unwrap_err();
    let coloured = errors.render(true);
    assert!(coloured.starts_with("\x1b[1m\x1b[91merror\x1b[0m\x1b[1m: `path` must be"), "{coloured:?}");
    let mut plain = coloured;
    for code in ["\x1b[1m", "\x1b[91m", "\x1b[94m", "\x1b[0m"] {
        plain = plain.replace(code, "");
    }
    assert_eq!(plain, errors.to_string());
}

#[test]
fn what_would_command_a_terminal_is_not_shown() {
    check(
        "[[stage]]\ntype = \"simulate\"\n\"\\u001b[2J\" = 1 # \u{9b}2J\n",
        r#"
error: `simulate` has no key `�[2J`
 --> job.toml:3:1
  |
3 | "\u001b[2J" = 1 # �2J
  | ^^^^^^^^^^^
  |
  = help: keys: lines
"#,
    );
}
