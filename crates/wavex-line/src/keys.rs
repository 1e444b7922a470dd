//! Keys of a job table, derived from types and doc comments.
//!
//! Error messages, schema and manual use them.

use schemars::generate::SchemaSettings;
use schemars::transform::transform_subschemas;
use schemars::{Schema, SchemaGenerator};
use serde::{Deserialize, Serialize};
use serde_json::Value;

mod bounds;
mod schema_prose;

pub use bounds::{Bounds, above, at_least, is_within};
pub use schema_prose::{bounds, choices, listed, takes};

/// The keys of a stage, or of the table `[job]`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Keys {
    schema: Value,
}

/// One key.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Key<'k> {
    /// Name in a job.
    pub name: &'k str,
    /// Whether a job must set it.
    pub required: bool,
    /// Accepted values: a JSON Schema (draft 2020-12) without references and `null`.
    pub schema: &'k Value,
}

impl Keys {
    /// Keys of the type whose schema this function generates.
    pub fn of(schema: fn(&mut SchemaGenerator) -> Schema) -> Keys {
        let settings = SchemaSettings::draft2020_12().with(|settings| settings.inline_subschemas = true);
        let mut schema = schema(&mut settings.into_generator());
        tidy(&mut schema);
        Keys { schema: schema.to_value() }
    }

    /// JSON Schema of all keys, without references and `null`.
    pub fn schema(&self) -> &Value {
        &self.schema
    }

    /// Doc comment of the type: its section of the manual.
    pub fn doc(&self) -> &str {
        text(&self.schema, "description")
    }

    /// Keys in the order of their fields.
    pub fn iter(&self) -> impl Iterator<Item = Key<'_>> {
        keys_in(&self.schema)
    }

    /// Describes the first number of a table that is outside the bounds of its key, if any.
    ///
    /// For tables in files of their own: the tables of a job are checked with their positions.
    pub fn violation(&self, table: &impl Serialize) -> Option<String> {
        bounds::violation(&self.schema, &serde_json::to_value(table).ok()?)
    }

    /// Returns a key by name; `table.key` is a key of a nested table.
    pub fn get(&self, name: &str) -> Option<Key<'_>> {
        let mut path = name.split('.');
        let first = path.next()?;
        let key = self.iter().find(|key| key.name == first)?;
        path.try_fold(key, |key, name| key.inner().find(|inner| inner.name == name))
    }
}

/// Keys of the table that a schema describes.
fn keys_in(table: &Value) -> impl Iterator<Item = Key<'_>> {
    let properties = table.get("properties").and_then(Value::as_object);
    properties.into_iter().flatten().map(|(name, schema)| Key {
        name,
        schema,
        required: required(table).any(|key| key == name),
    })
}

impl<'k> Key<'k> {
    /// Keys of the table that this key accepts; none for other types.
    pub fn inner(&self) -> impl Iterator<Item = Key<'k>> + use<'k> {
        keys_in(self.schema)
    }

    /// Documentation of the key: its doc comment.
    pub fn meaning(&self) -> &'k str {
        text(self.schema, "description")
    }

    /// Default; `None` if an omitted key has no value.
    pub fn default(&self) -> Option<&'k Value> {
        self.schema.get("default")
    }

    /// Description of accepted values: `a number, at least 0.5`.
    pub fn takes(&self) -> String {
        schema_prose::takes(self.schema)
    }

    /// File that the key's text names, if declared.
    pub fn file_mark(&self) -> Option<FileMark> {
        FileMark::deserialize(self.schema.get(FILE_MARK)?).ok()
    }

    /// Unit given by the suffix of the name.
    pub fn unit(&self) -> Option<&'static str> {
        UNITS.iter().find(|(suffix, _)| self.name.ends_with(suffix)).map(|(_, unit)| *unit)
    }
}

/// Schema keyword that declares which file a text names.
///
/// Usage: `#[schemars(extend("x-file" = "input"))]`. Keys of stages need it for libraries only,
/// because their [`Config`](crate::stage::Config) lists the files.
const FILE_MARK: &str = "x-file";

/// File that the text of a key of `[job]` names.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FileMark {
    /// An input file, relative to the input folder; `*` is replaced by the stem of the input.
    Input,
    /// Like `Input` if such a file exists; otherwise another name.
    InputOrName,
    /// A geoid by name, in the geoid folder.
    Geoid,
    /// The geoid folder, relative to the input folder.
    GeoidFolder,
    /// The input folder.
    InputFolder,
    /// An output file, relative to the output folder; `*` is replaced by the stem of the input;
    /// empty: none.
    Output,
    /// The output folder.
    OutputFolder,
    /// A library of native code: a key that a job cannot set, only `--set`.
    Library,
    /// An included part of the job, which `Job` has parsed.
    Include,
    /// No file.
    None,
}

/// Suffixes of names with their units; longer suffixes come first.
const UNITS: &[(&str, &str)] = &[
    ("_db_per_km", "dB/km"),
    ("_samples", "samples"),
    ("_mps", "m/s"),
    ("_deg", "°"),
    ("_khz", "kHz"),
    ("_ppm", "ppm"),
    ("_db", "dB"),
    ("_dn", "digitiser steps"),
    ("_hz", "Hz"),
    ("_km", "km"),
    ("_mb", "MB"),
    ("_ms", "ms"),
    ("_ns", "ns"),
    ("_ps", "ps"),
    ("_m", "m"),
    ("_s", "s"),
];

/// Required keys of a schema.
fn required(schema: &Value) -> impl Iterator<Item = &str> {
    schema.get("required").and_then(Value::as_array).into_iter().flatten().filter_map(Value::as_str)
}

/// Text of a schema keyword; empty if missing.
fn text<'v>(schema: &'v Value, keyword: &str) -> &'v str {
    schema.get(keyword).and_then(Value::as_str).unwrap_or_default()
}

/// Removes schema parts that do not apply to jobs: Rust number formats and `null`.
fn tidy(schema: &mut Schema) {
    transform_subschemas(&mut tidy, schema);
    take(schema, "format");
    if let Some(Value::Array(types)) = schema.get_mut("type") {
        types.retain(|name| name != "null");
        if let [only] = types.as_slice() {
            let only = only.clone();
            schema.insert("type".to_owned(), only);
        }
    }
    if let Some(Value::Array(values)) = schema.get_mut("enum") {
        values.retain(|value| !value.is_null());
    }
    if let Some(Value::Array(branches)) = schema.get_mut("anyOf") {
        branches.retain(|branch| branch.get("type").is_none_or(|name| name != "null"));
        if let [Value::Object(only)] = branches.as_slice() {
            let only = only.clone();
            take(schema, "anyOf");
            for (keyword, value) in only {
                // Keywords of the key itself take precedence: its description and its default.
                if schema.get(&keyword).is_none() {
                    schema.insert(keyword, value);
                }
            }
        }
    }
    if let Some(default) = schema.get_mut("default") {
        without_null(default);
        if default.is_null() || default.as_object().is_some_and(serde_json::Map::is_empty) {
            take(schema, "default");
        }
    }
}

/// Removes a keyword and keeps the order of the others.
fn take(schema: &mut Schema, keyword: &str) {
    if let Some(keywords) = schema.as_object_mut() {
        keywords.shift_remove(keyword);
    }
}

/// Removes null members from tables, recursively.
fn without_null(value: &mut Value) {
    match value {
        Value::Object(members) => {
            members.retain(|_, member| !member.is_null());
            members.values_mut().for_each(without_null);
        }
        Value::Array(items) => items.iter_mut().for_each(without_null),
        _ => {}
    }
}

/// A key with an invalid value.
#[derive(Debug, PartialEq)]
pub struct InvalidKey {
    /// Name of the key.
    pub key: &'static str,
    /// The problem with its value.
    pub problem: String,
}

impl InvalidKey {
    /// Creates an error for a key.
    pub fn new(key: &'static str, problem: impl Into<String>) -> InvalidKey {
        InvalidKey { key, problem: problem.into() }
    }

    /// Returns an error unless `holds`.
    pub fn unless(holds: bool, key: &'static str, problem: &str) -> std::result::Result<(), InvalidKey> {
        if holds { Ok(()) } else { Err(InvalidKey::new(key, problem)) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use schemars::JsonSchema;
    use serde_json::json;

    #[derive(Serialize, Deserialize, JsonSchema, Default)]
    #[serde(rename_all = "snake_case")]
    enum Mode {
        /// Goes on.
        #[default]
        Fast,
        /// Waits.
        Slow,
    }

    /// A stage.
    ///
    /// Of two paragraphs.
    #[derive(Serialize, Deserialize, JsonSchema)]
    #[serde(deny_unknown_fields)]
    struct Example {
        /// The file.
        path: String,
        /// How long.
        #[serde(default)]
        #[schemars(range(min = 0.5))]
        window_ns: Option<f64>,
        /// How.
        #[serde(default)]
        mode: Option<Mode>,
    }

    #[test]
    fn keys_carry_their_meaning_their_limits_and_their_unit() {
        let keys = Keys::of(Example::json_schema);
        assert_eq!(keys.doc(), "A stage.\n\nOf two paragraphs.");
        let names: Vec<(&str, bool)> = keys.iter().map(|key| (key.name, key.required)).collect();
        assert_eq!(names, [("path", true), ("window_ns", false), ("mode", false)]);
        let window = keys.get("window_ns").unwrap();
        assert_eq!(window.meaning(), "How long.");
        assert_eq!(window.unit(), Some("ns"));
        assert_eq!(window.takes(), "a number, at least 0.5");
        assert_eq!(window.default(), None, "no default");
        assert_eq!(keys.get("path").unwrap().unit(), None);
        assert_eq!(keys.schema()["additionalProperties"], json!(false));
    }

    #[test]
    fn an_optional_key_takes_what_the_key_itself_takes() {
        let keys = Keys::of(Example::json_schema);
        assert_eq!(keys.get("mode").unwrap().takes(), "\"fast\" or \"slow\"");
        assert_eq!(keys.get("mode").unwrap().meaning(), "How.");
        assert_eq!(keys.get("window_ns").unwrap().schema["type"], json!("number"));
        assert!(!keys.schema().to_string().contains("null"), "{}", keys.schema());
    }

    #[test]
    fn a_key_of_a_table_is_found_by_its_path() {
        /// A stage with a table.
        #[derive(Serialize, Deserialize, JsonSchema)]
        struct Outer {
            /// The table.
            #[serde(default)]
            inner: Inner,
        }
        /// A table.
        #[derive(Serialize, Deserialize, JsonSchema, Default)]
        struct Inner {
            /// How long.
            length_m: Option<f64>,
        }
        let keys = Keys::of(Outer::json_schema);
        assert_eq!(keys.get("inner.length_m").unwrap().meaning(), "How long.");
        assert_eq!(keys.get("inner").unwrap().default(), None, "an empty table is no default");
        assert_eq!((keys.get("inner.width_m"), keys.get("length_m")), (None, None));
    }

    #[test]
    fn the_longer_unit_wins() {
        let schema = json!({});
        let unit = |name| Key { name, required: false, schema: &schema }.unit();
        let units = ["reach_m", "length_mm", "speed_mps", "loss_db_per_km", "rate_hz", "m"].map(unit);
        assert_eq!(units, [Some("m"), None, Some("m/s"), Some("dB/km"), Some("Hz"), None]);
    }
}
