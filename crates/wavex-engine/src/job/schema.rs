//! JSON Schema of a job, for editors that validate and complete TOML.

use serde_json::{Map, Value, json};

use super::JobSettings;
use super::manual::summary;
use wavex_line::stage::StageSpec;

/// Returns the JSON Schema (draft 2020-12) of a job of these stages.
///
/// Editors with taplo support, such as Even Better TOML, validate a job whose first line is
/// `#:schema path/to/job.schema.json`. Stages, and keys that several of them have, are `$defs`.
pub fn job_schema(stages: &[&'static StageSpec]) -> Value {
    let mut settings = JobSettings::keys().schema().clone();
    settings["title"] = json!("[job]");
    let mut definitions: Map<String, Value> =
        stages.iter().map(|spec| (spec.name.to_owned(), stage_schema(spec))).collect();
    let stage: Vec<Value> = definitions.keys().map(|name| reference(name)).collect();
    share_keys(&mut definitions);
    let mut schema = json!({
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
        "$defs": definitions,
    });
    without_types_of_constants(&mut schema);
    schema
}

/// The same as JSON text, indented by tabs; values that fit are on one line.
pub fn job_schema_text(stages: &[&'static StageSpec]) -> String {
    let mut text = String::new();
    write(&job_schema(stages), 0, 0, &mut text);
    text.push('\n');
    text
}

/// Largest width of a line with several values, columns.
const WIDTH: usize = 100;

/// Writes a value of a nesting depth after `used` columns of a line; a tab is two.
fn write(value: &Value, depth: usize, used: usize, text: &mut String) {
    let line = on_one_line(value);
    let entries: Vec<(String, &Value)> = match value {
        _ if used + line.chars().count() <= WIDTH => Vec::new(),
        Value::Object(members) => {
            members.iter().map(|(name, value)| (format!("{}: ", json!(name)), value)).collect()
        }
        Value::Array(items) => items.iter().map(|item| (String::new(), item)).collect(),
        _ => Vec::new(),
    };
    if entries.is_empty() {
        text.push_str(&line);
        return;
    }
    let [open, close] = if value.is_object() { ["{", "}"] } else { ["[", "]"] };
    text.push_str(open);
    for (index, (name, value)) in entries.iter().enumerate() {
        text.push_str(if index > 0 { ",\n" } else { "\n" });
        text.extend(std::iter::repeat_n('\t', depth + 1));
        text.push_str(name);
        write(value, depth + 1, 2 * (depth + 1) + name.len(), text);
    }
    text.push('\n');
    text.extend(std::iter::repeat_n('\t', depth));
    text.push_str(close);
}

fn on_one_line(value: &Value) -> String {
    match value {
        Value::Object(members) => {
            let members =
                members.iter().map(|(name, value)| format!("{}: {}", json!(name), on_one_line(value)));
            format!("{{{}}}", members.collect::<Vec<_>>().join(", "))
        }
        Value::Array(items) => {
            format!("[{}]", items.iter().map(on_one_line).collect::<Vec<_>>().join(", "))
        }
        other => other.to_string(),
    }
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
        "description": summary(spec),
        "type": "object",
        "properties": properties,
        "required": required,
        "additionalProperties": false,
    })
}

/// Schema that refers to a definition.
fn reference(name: &str) -> Value {
    json!({ "$ref": format!("#/$defs/{name}") })
}

/// Moves the schemas of keys that several stages have to definitions of their own.
fn share_keys(definitions: &mut Map<String, Value>) {
    let mut keys: Vec<(String, Value, usize)> = Vec::new();
    for (name, schema) in definitions.values().flat_map(properties) {
        match keys.iter_mut().find(|(other, same, _)| other == name && same == schema) {
            Some((_, _, uses)) => *uses += 1,
            None => keys.push((name.clone(), schema.clone(), 1)),
        }
    }
    // Keys of one name and different schemas stay where they are, except for the first of them.
    let mut shared: Map<String, Value> = Map::new();
    for (name, schema, uses) in keys {
        if uses > 1 && !definitions.contains_key(&name) && !shared.contains_key(&name) {
            shared.insert(name, schema);
        }
    }
    for stage in definitions.values_mut() {
        let Some(Value::Object(properties)) = stage.get_mut("properties") else { continue };
        for (name, schema) in properties {
            if shared.get(name) == Some(schema) {
                *schema = reference(name);
            }
        }
    }
    definitions.extend(shared);
}

/// Keys of a stage with their schemas.
fn properties(stage: &Value) -> impl Iterator<Item = (&String, &Value)> {
    stage.get("properties").and_then(Value::as_object).into_iter().flatten()
}

/// Removes the type from schemas of one text, which has no other.
fn without_types_of_constants(schema: &mut Value) {
    match schema {
        Value::Object(members) => {
            if members.get("const").is_some_and(Value::is_string) {
                members.shift_remove("type");
            }
            members.values_mut().for_each(without_types_of_constants);
        }
        Value::Array(items) => items.iter_mut().for_each(without_types_of_constants),
        _ => {}
    }
}
