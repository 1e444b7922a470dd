//! Text descriptions of the values that a key accepts.

use serde_json::Value;

/// Describes accepted values: `a number, at least 0.5`, `"fast" or "slow"`,
/// `text or a list of texts`.
pub fn takes(schema: &Value) -> String {
    if let Some(choices) = choices(schema) {
        return listed(&choices.iter().map(|choice| format!("{choice:?}")).collect::<Vec<_>>(), "or");
    }
    if let Some(branches) = branches(schema) {
        let mut words: Vec<String> = branches.iter().map(takes).collect();
        words.dedup();
        // A comma separates alternatives that have commas themselves.
        let last = if words.iter().any(|word| word.contains(", ")) { ", or" } else { " or" };
        return joined(&words, last);
    }
    let base = match schema.get("type").and_then(Value::as_str) {
        Some("integer") => "a whole number".to_owned(),
        Some("number") => "a number".to_owned(),
        Some("string") => "text".to_owned(),
        Some("boolean") => match schema.get("const") {
            Some(only) => format!("`{only}`"),
            None => "`true` or `false`".to_owned(),
        },
        Some("array") => list(schema),
        Some("object") => "a table".to_owned(),
        _ => "any value".to_owned(),
    };
    match bounds(schema) {
        Some(bounds) => format!("{base}, {bounds}"),
        None => base,
    }
}

/// Texts that a schema accepts, if it accepts only a fixed set.
pub fn choices(schema: &Value) -> Option<Vec<&str>> {
    if let Some(only) = schema.get("const") {
        return Some(vec![only.as_str()?]);
    }
    if let Some(values) = schema.get("enum") {
        return values.as_array()?.iter().map(Value::as_str).collect();
    }
    let of_each: Option<Vec<Vec<&str>>> = branches(schema)?.iter().map(choices).collect();
    of_each.map(|choices| choices.concat())
}

/// Describes the bounds of a number: `at least 64`, `above 0 and at most 1`; `None` without bounds.
///
/// The largest integer of TOML is not worth a word.
pub fn bounds(schema: &Value) -> Option<String> {
    let bound = |keyword: &str, words: &str| {
        let limit = schema.get(keyword).filter(|limit| limit.as_i64() != Some(i64::MAX));
        limit.and_then(number).map(|limit| format!("{words} {limit}"))
    };
    let lower = bound("minimum", "at least").or_else(|| bound("exclusiveMinimum", "above"));
    let upper = bound("maximum", "at most").or_else(|| bound("exclusiveMaximum", "below"));
    match (lower, upper) {
        (Some(lower), Some(upper)) => Some(format!("{lower} and {upper}")),
        (lower, upper) => lower.or(upper),
    }
}

/// Joins names: `a`, `a or b`, `a, b or c`.
pub fn listed(names: &[impl AsRef<str>], last: &str) -> String {
    joined(names, &format!(" {last}"))
}

/// Joins names; `last` precedes the last one.
fn joined(names: &[impl AsRef<str>], last: &str) -> String {
    match names {
        [] => String::new(),
        [only] => only.as_ref().to_owned(),
        [most @ .., end] => {
            let most: Vec<&str> = most.iter().map(AsRef::as_ref).collect();
            format!("{}{last} {}", most.join(", "), end.as_ref())
        }
    }
}

/// Alternative schemas.
fn branches(schema: &Value) -> Option<&Vec<Value>> {
    schema.get("anyOf").or_else(|| schema.get("oneOf")).and_then(Value::as_array)
}

/// `a list of 2 numbers`, `a list of texts`.
fn list(schema: &Value) -> String {
    let length = |keyword: &str| schema.get(keyword).and_then(Value::as_u64);
    let n = match (length("minItems"), length("maxItems")) {
        (Some(min), Some(max)) if min == max => format!("{min} "),
        (Some(min), None) => format!("at least {min} "),
        (None, Some(max)) => format!("at most {max} "),
        (Some(min), Some(max)) => format!("{min} to {max} "),
        (None, None) => String::new(),
    };
    let item = schema.get("items").map_or("any value".to_owned(), takes);
    let items = match item.as_str() {
        "text" => "texts".to_owned(),
        "a number" => "numbers".to_owned(),
        "a whole number" => "whole numbers".to_owned(),
        "a table" => "tables".to_owned(),
        "any value" => "values".to_owned(),
        _ => format!("values, each {item}"),
    };
    format!("a list of {n}{items}")
}

/// Formats a number without a trailing `.0`: 9.0 is `9`.
fn number(value: &Value) -> Option<String> {
    match value {
        Value::Number(number) if number.is_f64() => number.as_f64().map(|number| number.to_string()),
        Value::Number(number) => Some(number.to_string()),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn what_a_key_takes_is_said_in_words() {
        let two = |item: Value| json!({"type": "array", "items": item, "minItems": 2, "maxItems": 2});
        let cases = [
            (json!({"type": "string"}), "text"),
            (json!({"type": "boolean"}), "`true` or `false`"),
            (json!({"type": "integer", "minimum": 64}), "a whole number, at least 64"),
            (
                json!({"type": "number", "minimum": 0.5, "maximum": 9.0}),
                "a number, at least 0.5 and at most 9",
            ),
            (json!({"type": "number", "exclusiveMinimum": 0}), "a number, above 0"),
            (json!({"type": "string", "enum": ["a", "b", "c"]}), r#""a", "b" or "c""#),
            (json!({"oneOf": [{"const": "a"}, {"const": "b"}]}), r#""a" or "b""#),
            (two(json!({"type": "number"})), "a list of 2 numbers"),
            (two(json!({"type": "number", "minimum": 0})), "a list of 2 values, each a number, at least 0"),
            (json!({"type": "array", "items": {"type": "integer"}}), "a list of whole numbers"),
            (
                json!({"type": "array", "items": {"type": "object"}, "minItems": 1}),
                "a list of at least 1 tables",
            ),
            (
                json!({"type": "array", "items": two(json!({"type": "number"}))}),
                "a list of values, each a list of 2 numbers",
            ),
            (json!({"type": "array", "items": {"enum": ["a", "b"]}}), r#"a list of values, each "a" or "b""#),
            (
                json!({"anyOf": [{"type": "string"}, {"type": "array", "items": {"type": "string"}}]}),
                "text or a list of texts",
            ),
            (json!({"anyOf": [{"const": "auto"}, {"type": "number"}]}), "\"auto\" or a number"),
            (
                json!({"anyOf": [{"type": "number", "minimum": 4}, {"type": "boolean", "const": false}]}),
                "a number, at least 4, or `false`",
            ),
            (json!({"type": "integer", "minimum": 0, "maximum": i64::MAX}), "a whole number, at least 0"),
            (json!({}), "any value"),
        ];
        for (schema, expected) in cases {
            assert_eq!(takes(&schema), expected, "{schema}");
        }
    }

    #[test]
    fn choices_are_only_those_of_texts() {
        assert_eq!(choices(&json!({"enum": ["a", "b"]})), Some(vec!["a", "b"]));
        assert_eq!(choices(&json!({"anyOf": [{"const": "auto"}, {"type": "number"}]})), None);
        assert_eq!(choices(&json!({"type": "string"})), None);
    }
}
