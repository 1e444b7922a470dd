//! Order of the stages, and output files.

use super::check;

#[test]
fn a_chain_without_a_source() {
    check(
        r#"
[[stage]]
type = "calibrate"
"#,
        r#"
error: `calibrate` cannot be the first stage: it has no input
 --> job.toml:2:8
  |
2 | type = "calibrate"
  |        ^^^^^^^^^^^
  |
  = help: start with a source: `read_las` or `simulate`
"#,
    );
}

#[test]
fn a_second_source() {
    check(
        r#"
[[stage]]
type = "read_las"
path = "flight.las"

[[stage]]
type = "simulate"
"#,
        r#"
error: `simulate` is a source, but only the first stage can be a source
 --> job.toml:6:8
  |
6 | type = "simulate"
  |        ^^^^^^^^^^
  |
  = help: list several inputs in the `path` of one source, or write two jobs
"#,
    );
}

#[test]
fn a_chain_that_lacks_several_stages() {
    check(
        r#"
[[stage]]
type = "read_las"
path = "flight.las"

[[stage]]
type = "write_las"
"#,
        r#"
error: `write_las` takes Points, but receives Shots
 --> job.toml:6:8
  |
6 | type = "write_las"
  |        ^^^^^^^^^^^
  |
  = help: insert `calibrate`, `decompose` and `georeference` before it
"#,
    );
}

#[test]
fn a_chain_that_lacks_one_stage() {
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
type = "write_las"
"#,
        r#"
error: `write_las` takes Points, but receives Returns
  --> job.toml:12:8
   |
12 | type = "write_las"
   |        ^^^^^^^^^^^
   |
   = help: insert `georeference` before it
"#,
    );
}

#[test]
fn a_stage_that_stands_too_late() {
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
type = "write_shots"
path="*.arrow"
"#,
        r#"
error: `write_shots` takes Shots, but receives Returns
  --> job.toml:12:8
   |
12 | type = "write_shots"
   |        ^^^^^^^^^^^^^
   |
   = help: move it up, after `calibrate`
"#,
    );
}

#[test]
fn a_stage_that_needs_another_before_it() {
    check(
        r#"
[[stage]]
type = "read_las"
path = "flight.las"

[[stage]]
type = "decompose"
"#,
        r#"
error: `decompose` requires `calibrate` before it
 --> job.toml:6:8
  |
6 | type = "decompose"
  |        ^^^^^^^^^^^
  |
  = help: insert `calibrate` before it
"#,
    );
}

#[test]
fn two_stages_in_the_wrong_order() {
    check(
        r#"
[[stage]]
type = "read_las"
path = "flight.las"

[[stage]]
type = "decompose"

[[stage]]
type = "calibrate"
"#,
        r#"
error: `decompose` requires `calibrate` before it
 --> job.toml:6:8
  |
6 | type = "decompose"
  |        ^^^^^^^^^^^
  |
  = help: move `calibrate` up, before it

error: `calibrate` takes Shots, but receives Returns
 --> job.toml:9:8
  |
9 | type = "calibrate"
  |        ^^^^^^^^^^^
  |
  = help: move it up, after `read_las`
"#,
    );
}

#[test]
fn a_misspelt_type_is_not_missed_by_others() {
    check(
        r#"
[[stage]]
type = "read_las"
path = "flight.las"

[[stage]]
type = "calibrat"

[[stage]]
type = "decompose"
"#,
        r#"
error: unknown stage `calibrat`
 --> job.toml:6:8
  |
6 | type = "calibrat"
  |        ^^^^^^^^^^
  |
  = help: did you mean `calibrate`?
  = help: stages: read_las, simulate, calibrate, decompose, georeference, write_las, write_lstat, write_shots
"#,
    );
}

#[test]
fn two_sinks_of_the_same_pattern() {
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

[[stage]]
type = "write_lstat"
path = "./*.laz"
"#,
        r#"
error: two outputs of this job are the same file, "./*.laz"
  --> job.toml:19:8
   |
19 | path = "./*.laz"
   |        ^^^^^^^^^
   |
   = help: choose another name: `write_las` already writes this file
"#,
    );
}

#[test]
fn two_sinks_of_the_same_default() {
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

[[stage]]
type = "write_las"
"#,
        r#"
error: two outputs of this job are the same file, "*.laz"
  --> job.toml:18:8
   |
18 | type = "write_las"
   |        ^^^^^^^^^^^
   |
   = help: choose another name: `write_las-1` already writes this file
"#,
    );
}

#[test]
fn two_sinks_whose_patterns_mean_the_same_file() {
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

[[stage]]
type = "write_lstat"
path = "flight.laz"
"#,
        r#"
error: two outputs of this job are the same file, "flight.laz"
  --> job.toml:19:8
   |
19 | path = "flight.laz"
   |        ^^^^^^^^^^^^
   |
   = help: choose another name: `write_las` already writes this file
"#,
    );
}

#[test]
fn several_inputs_and_one_output() {
    check(
        r#"
[[stage]]
type = "read_las"
path = ["a.las", "b.las"]

[[stage]]
type = "write_lstat"
path = "out/lines.txt"
"#,
        r#"
error: every input of this job would write the same file, "out/lines.txt"
 --> job.toml:7:8
  |
7 | path = "out/lines.txt"
  |        ^^^^^^^^^^^^^^^
  |
  = help: write `*` in place of the stem of the input, such as "out/*_lines.txt"
"#,
    );
}

#[test]
fn a_pattern_of_inputs_and_one_output() {
    check(
        r#"
[[stage]]
type = "read_las"
path = "in/*.las"

[[stage]]
type = "write_lstat"
path = "lines.txt"
"#,
        r#"
error: every input of this job would write the same file, "lines.txt"
 --> job.toml:7:8
  |
7 | path = "lines.txt"
  |        ^^^^^^^^^^^
  |
  = help: write `*` in place of the stem of the input, such as "*_lines.txt"
"#,
    );
}

#[test]
fn an_output_that_would_replace_its_input() {
    check(
        r#"
[[stage]]
type = "read_las"
path = ["a/f1.las", "a/f2.las"]

[[stage]]
type = "write_lstat"
path = "a/*.las"
"#,
        r#"
error: "a/*.las" would replace the input
 --> job.toml:7:8
  |
7 | path = "a/*.las"
  |        ^^^^^^^^^
  |
  = help: give the output another folder or another name, such as "out/*.laz" or "*_points.laz"
"#,
    );
}
