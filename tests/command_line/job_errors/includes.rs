//! Keys of an included file.

use super::{FULL, check, check_included, check_set};

#[test]
fn a_wrong_key_is_shown_in_the_file_that_it_stands_in() {
    check_included(
        "
[job]
threads = 2

[calibrate]
waveform = 500
",
        r#"
error: `calibrate` has no key `waveform`
 --> base.toml:5:1
  |
5 | waveform = 500
  | ^^^^^^^^
  |
  = help: did you mean `waveforms`?
  = help: keys: waveforms, background
"#,
    );
}

#[test]
fn an_included_file_that_is_not_toml() {
    check_included(
        "
[job]
threads = many
",
        r#"
error: invalid TOML: string values must be quoted, expected literal string
 --> base.toml:2:11
  |
2 | threads = many
  |           ^^^^
  |
  = help: put text in quotation marks: `"text"`
"#,
    );
}

#[test]
fn a_stage_of_its_own() {
    check_included(
        "
[[stage]]
type = 'calibrate'
",
        r#"
error: an included file cannot contain stages
 --> base.toml:1:3
  |
1 | [[stage]]
  |   ^^^^^
  |
  = help: name a table after a stage type: `[decompose]` applies to every stage of that type
"#,
    );
}

#[test]
fn a_table_that_is_no_stage() {
    check_included(
        "[decompos]\nmode = 'fast'\n",
        r#"
error: `decompos` is neither `job` nor a stage type
 --> base.toml:1:2
  |
1 | [decompos]
  |  ^^^^^^^^
  |
  = help: did you mean `[decompose]`?
"#,
    );
    check_included(
        "mem = 4096\n",
        r#"
error: `mem` is neither `job` nor a stage type
 --> base.toml:1:1
  |
1 | mem = 4096
  | ^^^
  |
  = help: name a table after a stage type, or `[job]`
"#,
    );
}

#[test]
fn a_stage_that_is_no_table() {
    check_included(
        "decompose = 5\n",
        r#"
error: `decompose` must be a table
 --> base.toml:1:13
  |
1 | decompose = 5
  |             ^
  |
  = help: write `[decompose]` above its keys
"#,
    );
}

#[test]
fn what_only_the_job_itself_can_say() {
    check_included(
        "[job]\ninclude = 'other.toml'\n",
        r#"
error: `include` is not allowed in an included file
 --> base.toml:2:1
  |
2 | include = 'other.toml'
  | ^^^^^^^
"#,
    );
    check_included(
        "[calibrate]\nid = 'c'\n",
        r#"
error: `id` is not allowed in an included file
 --> base.toml:2:1
  |
2 | id = 'c'
  | ^^
"#,
    );
}

#[test]
fn files_that_were_not_read() {
    check_set(
        FULL,
        &["job.include=base.toml"],
        r#"
error: the files named by `include` have not been read
 --> --set:1:13
  |
1 | job.include=base.toml
  |             ^^^^^^^^^
  |
  = help: `include` must be set in the text of the job itself
"#,
    );
}

#[test]
fn a_value_that_is_no_name() {
    check(
        &format!("[job]\ninclude = 5\n{FULL}"),
        r#"
error: `include` must be text or a list of texts, got the number 5
 --> job.toml:2:11
  |
2 | include = 5
  |           ^
"#,
    );
}
