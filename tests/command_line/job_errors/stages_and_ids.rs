//! The `type` and the `id` of a stage.

use super::check;

#[test]
fn a_stage_without_a_type() {
    check(
        r#"
[[stage]]
path = "flight.las"
"#,
        r#"
error: this stage has no `type`
 --> job.toml:1:1
  |
1 | [[stage]]
  | ^^^^^^^^^
  |
  = help: stages: read_las, simulate, calibrate, decompose, georeference, write_las, write_lstat, write_shots
"#,
    );
}

#[test]
fn a_type_that_is_no_text() {
    check(
        r#"
[[stage]]
type = 3
"#,
        r#"
error: `type` must be text, got the number 3
 --> job.toml:2:8
  |
2 | type = 3
  |        ^
"#,
    );
}

#[test]
fn a_misspelt_type() {
    check(
        r#"
[[stage]]
type = "read_las"
path = "flight.las"

[[stage]]
type = "decompos"
"#,
        r#"
error: unknown stage `decompos`
 --> job.toml:6:8
  |
6 | type = "decompos"
  |        ^^^^^^^^^^
  |
  = help: did you mean `decompose`?
  = help: stages: read_las, simulate, calibrate, decompose, georeference, write_las, write_lstat, write_shots
"#,
    );
}

#[test]
fn a_type_that_does_not_exist() {
    check(
        r#"
[[stage]]
type = "read_las"
path = "flight.las"

[[stage]]
type = "fuse_channels"
"#,
        r#"
error: unknown stage `fuse_channels`
 --> job.toml:6:8
  |
6 | type = "fuse_channels"
  |        ^^^^^^^^^^^^^^^
  |
  = help: stages: read_las, simulate, calibrate, decompose, georeference, write_las, write_lstat, write_shots
"#,
    );
}

#[test]
fn an_id_that_is_no_text() {
    check(
        r#"
[[stage]]
type = "read_las"
path = "flight.las"
id = 3
"#,
        r#"
error: `id` must be text, got the number 3
 --> job.toml:4:6
  |
4 | id = 3
  |      ^
"#,
    );
}

#[test]
fn an_id_that_cannot_be_used_in_set() {
    check(
        r#"
[[stage]]
type = "read_las"
path = "flight.las"
id = "a b"
"#,
        r#"
error: invalid stage name `a b`
 --> job.toml:4:6
  |
4 | id = "a b"
  |      ^^^^^
  |
  = help: an `id` consists of letters, digits, `_` and `-`, and is not `job`
"#,
    );
}

#[test]
fn an_id_that_means_the_job() {
    check(
        r#"
[[stage]]
type = "read_las"
path = "flight.las"
id = "job"
"#,
        r#"
error: invalid stage name `job`
 --> job.toml:4:6
  |
4 | id = "job"
  |      ^^^^^
  |
  = help: an `id` consists of letters, digits, `_` and `-`, and is not `job`
"#,
    );
}

#[test]
fn an_id_given_twice() {
    check(
        r#"
[[stage]]
type = "read_las"
path = "flight.las"
id = "one"

[[stage]]
type = "write_lstat"
id = "one"
"#,
        r#"
error: duplicate stage name `one`
 --> job.toml:8:6
  |
8 | id = "one"
  |      ^^^^^
  |
  = help: give one of them a different `id`
"#,
    );
}

#[test]
fn an_id_that_is_the_type_of_another_stage() {
    check(
        r#"
[[stage]]
type = "read_las"
path = "flight.las"
id = "calibrate"

[[stage]]
type = "calibrate"
"#,
        r#"
error: duplicate stage name `calibrate`
 --> job.toml:7:8
  |
7 | type = "calibrate"
  |        ^^^^^^^^^^^
  |
  = help: give one of them a different `id`
"#,
    );
}
