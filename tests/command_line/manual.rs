//! Schema and manual of a small list of stages.

use serde_json::{Value, json};
use wavex::job::{job_schema, manual, manual_of, summary};
use wavex::registry::STAGES;
use wavex_testkit::job_stages;

/// Schema of one stage.
fn stage<'s>(schema: &'s Value, name: &str) -> &'s Value {
    let stages = schema["properties"]["stage"]["items"]["oneOf"].as_array().unwrap();
    let reference = format!("#/$defs/{name}");
    assert!(stages.contains(&json!({ "$ref": reference })), "{name}");
    let stage = &schema["$defs"][name];
    assert_eq!(stage["properties"]["type"]["const"], name);
    stage
}

#[test]
fn schema_selects_stages_by_type() {
    let schema = job_schema(job_stages::STAGES);
    assert_eq!(schema["$schema"], "https://json-schema.org/draft/2020-12/schema");
    assert_eq!((&schema["required"], &schema["additionalProperties"]), (&json!(["stage"]), &json!(false)));
    let read_las = stage(&schema, "read_las");
    assert_eq!(read_las["required"], json!(["type", "path"]));
    assert_eq!(read_las["additionalProperties"], json!(false));
    let keys: Vec<&String> = read_las["properties"].as_object().unwrap().keys().collect();
    assert_eq!(keys, ["type", "id", "path", "time_s"]);
}

#[test]
fn the_schema_carries_meanings_limits_and_defaults() {
    let schema = job_schema(job_stages::STAGES);
    assert_eq!(
        stage(&schema, "calibrate")["properties"]["waveforms"],
        json!({
            "description": "How many waveforms to learn from.",
            "type": "integer",
            "minimum": 200,
            "default": 100_000,
        })
    );
    assert_eq!(
        schema["properties"]["job"]["properties"]["input_dir"],
        json!({
            "description": "Folder of relative input paths; relative to the job file's folder, which is the default.",
            "type": "string",
            "x-file": "input_folder",
        })
    );
}

/// Stages have the same keys with references resolved as in their own lists.
#[test]
fn keys_of_several_stages_are_in_the_schema_once() {
    let schema = job_schema(STAGES);
    let text = schema.to_string();
    assert_eq!(text.matches("Day on which the recording began").count(), 1);
    assert_eq!(schema["$defs"]["read_las"]["properties"]["gps_date"], json!({ "$ref": "#/$defs/gps_date" }));
    for spec in STAGES {
        for key in spec.keys().iter() {
            let mut found = &schema["$defs"][spec.name]["properties"][key.name];
            if let Some(reference) = found.get("$ref").and_then(Value::as_str) {
                found = schema.pointer(reference.strip_prefix('#').unwrap()).unwrap();
            }
            // Constants have no type in the schema of jobs.
            let [found, key] = [found, key.schema].map(|schema| schema.to_string());
            assert_eq!(found, key.replace("\"type\":\"string\",\"const\"", "\"const\""), "{}", spec.name);
        }
    }
}

#[test]
fn a_schema_without_stages_is_one_that_nothing_fits() {
    assert_eq!(job_schema(&[])["properties"]["stage"]["items"], json!(false));
}

#[test]
fn the_page_of_a_stage_for_the_terminal() {
    let expected = r#"
read_las: A source: makes Shots

Reads waveforms from LAS files. Blocks stay with their shot.

Point formats 4, 5, 9 and 10.

  path (text or a list of texts; required)
      The files to read, one run each.

  time_s (a list of 2 numbers, in s)
      First and last second to read.
"#;
    assert_eq!(manual_of(&job_stages::READ_LAS), expected.trim_start());
    let decompose = manual_of(&job_stages::DECOMPOSE);
    assert!(
        decompose
            .starts_with("decompose: A map: takes Shots, makes Returns; requires `calibrate` before it\n\n"),
        "{decompose}"
    );
    let first_key = "\n  detection_sigma (a number, at least 1 and at most 100; default 4.5)\n      How far";
    assert!(decompose.contains(first_key), "{decompose}");
}

#[test]
fn the_manual_has_a_table_of_stages_and_one_of_keys_for_each() {
    let page = manual(job_stages::STAGES);
    let contains = |part: &str| assert!(page.contains(part), "{part}\nis not in\n{page}");
    contains("| [`read_las`](#read_las) | source | → Shots | Reads waveforms from LAS files. |\n");
    contains("| [`decompose`](#decompose) | map | Shots → Returns | Finds the returns in each waveform. |\n");
    contains(
        "| [`write_lstat`](#write_lstat) | sink | Shots, Returns or Points | Writes a row per line. |\n",
    );
    contains(
        "| `memory_mb` | a whole number, at least 64 and at most 1000000000 | `1024` | MB | Memory limit",
    );
    contains(
        "\n## `calibrate`\n\nA transform: takes Shots and keeps the kind.\n\n\
         Learns the sensor from the first waveforms.\n\n\
         | key | type | default | unit | meaning |\n|---|---|---|---|---|\n\
         | `waveforms` | a whole number, at least 200 | `100000` |  | How many waveforms to learn from. |\n\
         | `background` | \"auto\" or \"per_waveform\" | `\"auto\"` |  | How the background is found. |\n",
    );
    contains("| `path` | text or a list of texts | required |  | The files to read, one run each. |\n");
    contains("| `time_s` | a list of 2 numbers | none | s | First and last second to read. |\n");
    contains("standard deviations \\| of the noise.");
}

#[test]
fn a_summary_is_the_first_sentence() {
    assert_eq!(summary(&job_stages::READ_LAS), "Reads waveforms from LAS files.");
}

/// All tests named in the table of BayesWavEx's errors exist.
#[test]
fn the_table_of_messages_names_tests_that_exist() {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let read = |path: &str| {
        let text = std::fs::read_to_string(root.join(path));
        text.unwrap_or_else(|error| panic!("docs/explanation/testing.md names {path}: {error}"))
    };
    let page = read("docs/explanation/testing.md");
    let mut n = 0;
    for row in page.lines().filter(|line| line.starts_with("| 1.")) {
        let tests = row.trim_end_matches('|').rsplit(" | ").next().unwrap();
        for group in tests.split("; ") {
            // Files of cases have no names of tests.
            let (path, names) = group.split_once(": ").unwrap_or((group, ""));
            let text = read(path.trim_matches([' ', '`']));
            if names.is_empty() {
                assert!(path.trim_matches([' ', '`']).ends_with(".txt"), "{row}");
                n += 1;
                continue;
            }
            for name in names.split(", ").map(|name| name.trim_matches([' ', '`'])) {
                assert!(
                    text.contains(&format!("fn {name}()")),
                    "docs/explanation/testing.md: {path} has no test {name}"
                );
                n += 1;
            }
        }
    }
    assert!(n > 30, "only {n} tests were found in the table");
}
