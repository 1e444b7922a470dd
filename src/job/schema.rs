//! JSON Schema of a job, for editors that validate and complete TOML.

use serde_json::{Map, Value, json};

use super::JobSettings;
use crate::stage::StageSpec;

/// Returns the JSON Schema (draft 2020-12) of a job of these stages.
///
/// Editors with taplo support, such as Even Better TOML, validate a job whose first line is
/// `#:schema path/to/job.schema.json`.
pub fn job_schema(stages: &[&'static StageSpec]) -> Value {
    let stage: Vec<Value> = stages.iter().map(|spec| stage_schema(spec)).collect();
    let mut settings = JobSettings::keys().schema().clone();
    settings["title"] = json!("[job]");
    json!({
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "A wavex job",
        "description": "The stages that process the data, in order, and the settings of the run.",
        "type": "object",
        "properties": {
            "job": settings,
            "stage": {
                "description": "Stages in order: one source, then the stages that process its lines.",
                "type": "array",
                "minItems": 1,
                // An empty `oneOf` is not a valid schema; without stages nothing is valid.
                "items": if stage.is_empty() { json!(false) } else { json!({ "oneOf": stage }) },
            },
        },
        "required": ["stage"],
        "additionalProperties": false,
    })
}

/// Schema of one stage: `type`, `id`, and its own keys.
fn stage_schema(spec: &StageSpec) -> Value {
    let keys = spec.keys();
    let name_of_stage = json!({
        "description": "Name of the stage if its type is ambiguous: letters, digits, `_` and `-`.",
        "type": "string",
        "pattern": "^[A-Za-z0-9_-]+$",
    });
    let mut properties = Map::new();
    properties.insert("type".to_owned(), json!({ "description": keys.doc(), "const": spec.name }));
    properties.insert("id".to_owned(), name_of_stage);
    properties.extend(keys.iter().map(|key| (key.name.to_owned(), key.schema.clone())));
    let own = keys.iter().filter(|key| key.required).map(|key| key.name.to_owned());
    let required: Vec<String> = std::iter::once("type".to_owned()).chain(own).collect();
    json!({
        "title": spec.name,
        "description": keys.doc(),
        "type": "object",
        "properties": properties,
        "required": required,
        "additionalProperties": false,
    })
}
