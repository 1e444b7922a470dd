//! The keys of a table of a job, as their types and doc comments tell them: errors, the schema and the manual all
//! read them here.

use schemars::generate::SchemaSettings;
use schemars::transform::transform_subschemas;
use schemars::{Schema, SchemaGenerator};
use serde::Deserialize;
use serde_json::Value;

use super::words;

/// The keys of a stage, or of the table `[job]`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Keys {
    schema: Value,
}

/// One key.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Key<'k> {
    /// As a job writes it.
    pub name: &'k str,
    /// Whether a job must give it.
    pub required: bool,
    /// What its values may be: a JSON Schema (draft 2020-12) without references and without `null`.
    pub schema: &'k Value,
}

impl Keys {
    /// The keys of the type whose schema this function makes.
    pub fn of(schema: fn(&mut SchemaGenerator) -> Schema) -> Keys {
        let settings = SchemaSettings::draft2020_12().with(|settings| settings.inline_subschemas = true);
        let mut schema = schema(&mut settings.into_generator());
        tidy(&mut schema);
        Keys { schema: schema.to_value() }
    }

    /// All of them as one JSON Schema, without references and without `null`.
    pub fn schema(&self) -> &Value {
        &self.schema
    }

    /// The doc comment of the whole: its page in the manual.
    pub fn doc(&self) -> &str {
        text(&self.schema, "description")
    }

    /// The keys in the order of their fields.
    pub fn iter(&self) -> impl Iterator<Item = Key<'_>> {
        keys_in(&self.schema)
    }

    /// The key of this name; `table.key` means a key of a table among them.
    pub fn get(&self, name: &str) -> Option<Key<'_>> {
        let mut path = name.split('.');
        let first = path.next()?;
        let key = self.iter().find(|key| key.name == first)?;
        path.try_fold(key, |key, name| key.inner().find(|inner| inner.name == name))
    }
}

/// The keys of a table that a schema describes.
fn keys_in(table: &Value) -> impl Iterator<Item = Key<'_>> {
    let properties = table.get("properties").and_then(Value::as_object);
    properties.into_iter().flatten().map(|(name, schema)| Key {
        name,
        schema,
        required: required(table).any(|key| key == name),
    })
}

impl<'k> Key<'k> {
    /// The keys of the table that it takes; none where it takes something else.
    pub fn inner(&self) -> impl Iterator<Item = Key<'k>> + use<'k> {
        keys_in(self.schema)
    }

    /// What it does: its doc comment.
    pub fn meaning(&self) -> &'k str {
        text(self.schema, "description")
    }

    /// What counts when a job does not give it; `None` where there is nothing in its place.
    pub fn default(&self) -> Option<&'k Value> {
        self.schema.get("default")
    }

    /// What may be given, in words: `a number, at least 0.5`.
    pub fn takes(&self) -> String {
        words::takes(self.schema)
    }

    /// Which file a text that it takes names, where its declaration says so.
    pub fn file_mark(&self) -> Option<FileMark> {
        FileMark::deserialize(self.schema.get(FILE_MARK)?).ok()
    }

    /// The unit that its name ends in.
    pub fn unit(&self) -> Option<&'static str> {
        UNITS.iter().find(|(suffix, _)| self.name.ends_with(suffix)).map(|(_, unit)| *unit)
    }
}

/// The keyword of a key's schema that says which file a text names: `#[schemars(extend("x-file" = "input"))]`. Keys of stages
/// have none: their [`Config`](super::Config) tells files.
const FILE_MARK: &str = "x-file";

/// Which file the text of a key of `[job]` names.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FileMark {
    /// One that is read, below the folder of inputs; `*` is the input's stem.
    Input,
    /// The same where there is such a file; the name of something else otherwise.
    InputOrName,
    /// A geoid by its name, in the folder of geoids.
    Geoid,
    /// The folder of geoids, below that of inputs.
    GeoidFolder,
    /// The folder of inputs.
    InputFolder,
    /// One that is written, below the folder of outputs; `*` is the input's stem; none where the text is empty.
    Output,
    /// The folder of outputs.
    OutputFolder,
    /// A text of the job itself, which `Job` has read.
    Include,
    /// None.
    None,
}

/// The ends of names that carry a unit; of two that fit, the longer stands first.
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

/// The keys that a schema demands.
fn required(schema: &Value) -> impl Iterator<Item = &str> {
    schema.get("required").and_then(Value::as_array).into_iter().flatten().filter_map(Value::as_str)
}

/// A text in a schema; empty where it has none.
fn text<'v>(schema: &'v Value, keyword: &str) -> &'v str {
    schema.get(keyword).and_then(Value::as_str).unwrap_or_default()
}

/// Takes out what is of no use in a job: Rust's names of number formats, and `null`, which TOML does not have.
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
                // What stands at the key itself wins: its description and its default.
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

/// Takes a keyword out and leaves the others in their order.
fn take(schema: &mut Schema, keyword: &str) {
    if let Some(keywords) = schema.as_object_mut() {
        keywords.shift_remove(keyword);
    }
}

/// Takes out the members of tables that are not set.
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

#[cfg(test)]
mod tests {
    use super::*;
    use schemars::JsonSchema;
    use serde::{Deserialize, Serialize};
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
        assert_eq!(window.default(), None, "nothing stands in its place");
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
        assert_eq!(keys.get("inner").unwrap().default(), None, "an empty table is none");
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
