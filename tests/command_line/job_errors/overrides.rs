//! Overrides.

use super::{FULL, check_set};

#[test]
fn an_override_without_a_value() {
    check_set(
        FULL,
        &["decompose.detection_sigma"],
        r#"
error: expected STAGE.KEY=VALUE
 --> --set:1:1
  |
1 | decompose.detection_sigma
  | ^^^^^^^^^^^^^^^^^^^^^^^^^
  |
  = help: for example `--set decompose.detection_sigma=5` or `--set job.threads=2`
"#,
    );
}

#[test]
fn an_override_without_a_stage() {
    check_set(
        FULL,
        &["threads=3"],
        r#"
error: expected STAGE.KEY=VALUE
 --> --set:1:1
  |
1 | threads=3
  | ^^^^^^^^^
  |
  = help: for example `--set decompose.detection_sigma=5` or `--set job.threads=2`
"#,
    );
}

#[test]
fn an_override_with_an_empty_value() {
    check_set(
        FULL,
        &["job.threads="],
        r#"
error: missing value after `=`
 --> --set:1:1
  |
1 | job.threads=
  | ^^^^^^^^^^^^
"#,
    );
}

#[test]
fn an_override_that_is_not_toml() {
    check_set(
        FULL,
        &["read_las.path=[\"a.las\", b]"],
        r#"
error: invalid TOML: string values must be quoted, expected literal string
 --> --set:1:25
  |
1 | read_las.path=["a.las", b]
  |                         ^
  |
  = help: put text in quotation marks: `"text"`
"#,
    );
}

#[test]
fn an_override_of_a_misspelt_stage() {
    check_set(
        FULL,
        &["decompse.detection_sigma=5"],
        r#"
error: the job has no stage `decompse`
 --> --set:1:1
  |
1 | decompse.detection_sigma=5
  | ^^^^^^^^
  |
  = help: did you mean `decompose`?
  = help: stages: read_las, calibrate, decompose, georeference, write_las
"#,
    );
}

#[test]
fn an_override_of_several_stages() {
    check_set(
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
path="x_*.laz"
"#,
        &["write_las.version=\"1.2\""],
        r#"
error: the job has several stages `write_las`
 --> --set:1:1
  |
1 | write_las.version="1.2"
  | ^^^^^^^^^
  |
  = help: select one by its `id`: write_las-1 or write_las-2
"#,
    );
}

#[test]
fn an_override_of_the_type() {
    check_set(
        FULL,
        &["write_las.type=\"write_lstat\""],
        r#"
error: `type` cannot be overridden
 --> --set:1:11
  |
1 | write_las.type="write_lstat"
  |           ^^^^
"#,
    );
}

#[test]
fn an_override_of_a_misspelt_key() {
    check_set(
        FULL,
        &["decompose.detection_sgima=5"],
        r#"
error: `decompose` has no key `detection_sgima`
 --> --set:1:11
  |
1 | decompose.detection_sgima=5
  |           ^^^^^^^^^^^^^^^
  |
  = help: did you mean `detection_sigma`?
  = help: keys: detection_sigma, width_ratio, longest_ns, shortest_ns, split_evidence, start, refinements
"#,
    );
}

#[test]
fn an_override_of_the_wrong_type() {
    check_set(
        FULL,
        &["decompose.detection_sigma=high"],
        r#"
error: `detection_sigma` must be a number, at least 1 and at most 100, got text
 --> --set:1:27
  |
1 | decompose.detection_sigma=high
  |                           ^^^^
"#,
    );
}

#[test]
fn the_second_of_two_overrides() {
    check_set(
        FULL,
        &["job.threads=2", "job.memory_mb=8"],
        r#"
error: `memory_mb` must be at least 64 and at most 1000000000, got 8
 --> --set:1:15
  |
1 | job.memory_mb=8
  |               ^
"#,
    );
}

#[test]
fn an_override_hides_what_the_file_says() {
    check_set(
        r#"
[[stage]]
type = "read_las"
path = "flight.las"

[[stage]]
type = "calibrate"

[[stage]]
type = "decompose"
detection_sigma = 0

[[stage]]
type = "georeference"

[[stage]]
type = "write_las"
"#,
        &["decompose.detection_sigma=0.5"],
        r#"
error: `detection_sigma` must be at least 1 and at most 100, got 0.5
 --> --set:1:27
  |
1 | decompose.detection_sigma=0.5
  |                           ^^^
"#,
    );
}

#[test]
fn an_override_of_two_lines() {
    check_set(
        FULL,
        &["job.threads=4\nmemory_mb=100"],
        r#"
error: `threads` must be a whole number, at least 0, got text
 --> --set:1:13
  |
1 | job.threads=4
  |             ^
"#,
    );
}
