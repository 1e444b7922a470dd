//! The JSON Schema of a whole job, for editors that check and complete TOML.

use serde_json::{Map, Value, json};

use super::JobSettings;
use crate::stage::StageSpec;

/// The JSON Schema (draft 2020-12) of a job of these stages. A job whose first line is
/// `#:schema path/to/job.schema.json` is checked by editors that know taplo, such as those with Even Better TOML.
pub fn job_schema(stages: &[&'static StageSpec]) -> Value {
    let stage: Vec<Value> = stages.iter().map(|spec| stage_schema(spec)).collect();
    let mut settings = JobSettings::keys().schema().clone();
    settings["title"] = json!("[job]");
    json!({
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "A job of wavex",
        "description": "The stages that the data passes, in order, and what concerns the run as a whole.",
        "type": "object",
        "properties": {
            "job": settings,
            "stage": {
                "description": "The stages in order: one source, then what takes its lines.",
                "type": "array",
                "minItems": 1,
                // A choice of none is no schema: without stages nothing fits.
                "items": if stage.is_empty() { json!(false) } else { json!({ "oneOf": stage }) },
            },
        },
        "required": ["stage"],
        "additionalProperties": false,
    })
}

/// The schema of one stage: its `type`, its `id`, and its own keys.
fn stage_schema(spec: &StageSpec) -> Value {
    let keys = spec.keys();
    let name_of_stage = json!({
        "description": "What the job calls the stage, where its type is not enough: letters, digits, `_` and `-`.",
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
