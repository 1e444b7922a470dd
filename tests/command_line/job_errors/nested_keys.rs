//! Lists and tables among the keys, and values refused by stages.

use super::check;

#[test]
fn a_list_of_another_length() {
    check(
        r#"
[[stage]]
type = "read_las"
path = "flight.las"
time_s = [1.0]
"#,
        r#"
error: `time_s` must be a list of 2 numbers, got a list of 1
 --> job.toml:4:10
  |
4 | time_s = [1.0]
  |          ^^^^^
"#,
    );
}

#[test]
fn an_item_of_another_type() {
    check(
        r#"
[[stage]]
type = "read_las"
path = "flight.las"
time_s = [
  1.0,
  "2",
]
"#,
        r#"
error: an item of `time_s` must be a number, got text
 --> job.toml:6:3
  |
6 |   "2",
  |   ^^^
  |
  = help: write numbers without quotation marks: 2
"#,
    );
}

#[test]
fn text_where_something_else_is_wanted() {
    check(
        r#"
[[stage]]
type = "read_las"
path = "flight.las"

[[stage]]
type = "calibrate"

[[stage]]
type = "decompose"
split_evidence = "no"
"#,
        r#"
error: `split_evidence` must be `true` or `false` or a number, got text
  --> job.toml:10:18
   |
10 | split_evidence = "no"
   |                  ^^^^
"#,
    );
}

#[test]
fn a_choice_that_does_not_exist_beside_numbers() {
    check(
        r#"
[[stage]]
type = "read_las"
path = "flight.las"

[[stage]]
type = "calibrate"

[[stage]]
type = "decompose"
start = "blok"
"#,
        r#"
error: `start` must be "pulse" or "block" or a number, got "blok"
  --> job.toml:10:9
   |
10 | start = "blok"
   |         ^^^^^^
"#,
    );
}

#[test]
fn an_item_of_a_list_beside_another_choice() {
    check(
        r#"
[[stage]]
type = "read_las"
path = ["a.las", 3]
"#,
        r#"
error: an item of `path` must be text, got the number 3
 --> job.toml:3:18
  |
3 | path = ["a.las", 3]
  |                  ^
  |
  = help: put text in quotation marks: `"text"`
"#,
    );
}

#[test]
fn a_misspelt_key_of_a_table() {
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
mount = { forward_m = 1, rigth_m = 2 }
"#,
        r#"
error: `mount` of `georeference` has no key `rigth_m`
  --> job.toml:13:26
   |
13 | mount = { forward_m = 1, rigth_m = 2 }
   |                          ^^^^^^^
   |
   = help: did you mean `right_m`?
   = help: keys: forward_m, right_m
"#,
    );
}

#[test]
fn a_key_that_a_table_must_give() {
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
[stage.mount]
right_m = 2
"#,
        r#"
error: `mount` of `georeference` requires the key `forward_m`
  --> job.toml:13:1
   |
13 | [stage.mount]
   | ^^^^^^^^^^^^^
   |
   = help: add `forward_m = ...`, a number: To the front.
"#,
    );
}

#[test]
fn a_key_of_a_table_in_a_list() {
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
control = [{ forward_m = 1 }, { forward_m = "x" }]
"#,
        r#"
error: `forward_m` must be a number, got text
  --> job.toml:13:45
   |
13 | control = [{ forward_m = 1 }, { forward_m = "x" }]
   |                                             ^^^
"#,
    );
}

#[test]
fn a_text_that_its_own_type_refuses() {
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
crs = "utm"
"#,
        r#"
error: `crs`: "utm" is no code of a system
  --> job.toml:13:7
   |
13 | crs = "utm"
   |       ^^^^^
   |
   = help: `crs` takes text
"#,
    );
}

#[test]
fn a_value_that_the_stage_refuses() {
    check(
        r#"
[[stage]]
type = "read_las"
path = "flight.las"

[[stage]]
type = "calibrate"

[[stage]]
type = "decompose"
width_ratio = [10, 0.8]
"#,
        r#"
error: `width_ratio`: the first number must be below the second
  --> job.toml:10:15
   |
10 | width_ratio = [10, 0.8]
   |               ^^^^^^^^^
"#,
    );
}

#[test]
fn a_default_that_the_stage_refuses() {
    check(
        r#"
[[stage]]
type = "read_las"
path = "flight.las"

[[stage]]
type = "calibrate"

[[stage]]
type = "decompose"
shortest_ns = 40
"#,
        r#"
error: `longest_ns`: must be above `shortest_ns`
 --> job.toml:8:1
  |
8 | [[stage]]
  | ^^^^^^^^^
  |
  = help: the job does not set `longest_ns`, and its default, 30.0, is not valid here
"#,
    );
}
