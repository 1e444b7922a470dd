//! Validates the keys of a table against their schema.
//!
//! Reports all errors with their positions, whereas serde stops at the first. Editors with the
//! schema report the same errors.

use std::borrow::Cow;
use std::ops::Range;

use serde_json::Value;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::errors::{BACKSLASHES, MAX_ERRORS};
use super::manual::first_sentence;
use super::{JobError, JobSettings};
use wavex_line::georef::GeometryKeys;
use wavex_line::keys::{Keys, bounds, choices, is_within, takes};

/// Finds errors in the keys of `table`; errors call the table `owner`, such as "`decompose`".
pub(super) fn check(owner: &str, keys: &Keys, table: &Spanned<DeTable>) -> Vec<JobError> {
    check_table(owner, keys.schema(), table.get_ref(), &table.span())
}

/// Returns whether a schema accepts only text.
pub(super) fn only_text(schema: &Value) -> bool {
    choices(schema).is_some() || schema.get("type").is_some_and(|name| name == "string")
}

/// The Boolean value that a word of another language or program means.
pub(super) fn truth_of(word: &str) -> Option<bool> {
    match word.to_lowercase().as_str() {
        "yes" | "on" | "true" => Some(true),
        "no" | "off" | "false" => Some(false),
        _ => None,
    }
}

/// Describes the type of a value.
pub(super) fn kind_of(value: &DeValue) -> String {
    match value {
        DeValue::String(_) => "text".to_owned(),
        DeValue::Integer(number) => format!("the number {number}"),
        DeValue::Float(number) => format!("the number {number}"),
        DeValue::Boolean(value) => format!("`{value}`"),
        DeValue::Datetime(_) => "a date or a time".to_owned(),
        DeValue::Array(_) => "a list".to_owned(),
        DeValue::Table(_) => "a table".to_owned(),
    }
}

fn check_table(owner: &str, schema: &Value, table: &DeTable, header: &Range<usize>) -> Vec<JobError> {
    let Some(properties) = schema.get("properties").and_then(Value::as_object) else {
        return Vec::new();
    };
    let mut errors = Vec::new();
    for (key, value) in table {
        match properties.get(key.get_ref().as_ref()) {
            Some(schema) => {
                errors.extend(CheckedValue { owner, name: &format!("`{key}`"), schema, value }.check());
                if key.get_ref() == "path" || schema.get("x-file").is_some() {
                    errors.extend(control_character(key.get_ref(), value));
                }
            }
            None => errors.push(unknown_key(owner, key, value, properties.keys())),
        }
        if errors.len() > MAX_ERRORS {
            break;
        }
    }
    let required = schema.get("required").and_then(Value::as_array).into_iter().flatten();
    for key in required.filter_map(Value::as_str).filter(|key| !table.contains_key(*key)) {
        let schema = properties.get(key).unwrap_or(&Value::Null);
        errors.push(missing_key(owner, key, schema, header));
    }
    errors
}

/// Error for a path with a control character, which is mostly an escape: `"C:\new"`.
fn control_character(key: &str, value: &Spanned<DeValue>) -> Option<JobError> {
    match value.get_ref() {
        DeValue::String(text) if text.contains(char::is_control) => {
            let problem = format!("the path in `{key}` has a control character: {text:?}");
            Some(JobError::at(value.span(), problem).help(BACKSLASHES))
        }
        DeValue::Array(items) => items.iter().find_map(|item| control_character(key, item)),
        _ => None,
    }
}

fn unknown_key<'k>(
    owner: &str,
    key: &Spanned<Cow<str>>,
    value: &Spanned<DeValue>,
    known: impl Iterator<Item = &'k String>,
) -> JobError {
    let known: Vec<&str> = known.map(String::as_str).collect();
    let error = JobError::at(key.span(), format!("{owner} has no key `{key}`"));
    match known.as_slice() {
        [] => error.help("it has no keys"),
        known => {
            let error = match (crs_key(key.get_ref(), known), code(value.get_ref()), table_of(key.get_ref()))
            {
                (Some(Some(name)), Some(code), _) => error.help(crs_help(name, code)),
                (Some(None), Some(code), _) => {
                    error.help(format!("{} in `[job.geometry]`", crs_help("crs", code)))
                }
                (.., Some((table, name))) if name == **key.get_ref() => {
                    error.help(format!("write it in `{table}`"))
                }
                (.., Some((table, name))) if !known.contains(&name.as_str()) => {
                    error.help(format!("write `{name}` in `{table}`"))
                }
                _ => error.meant_key(key.get_ref(), known),
            };
            error.help(format!("keys: {}", known.join(", ")))
        }
    }
}

/// Table of the job, outside of stages, that has a key, and the key's name, which may lack its unit in `key`.
pub(super) fn table_of(key: &str) -> Option<(String, String)> {
    let geometry = GeometryKeys::keys();
    let own = |table: &str| Some((table.to_owned(), key.to_owned()));
    match () {
        () if geometry.get(key).is_some() => own("[job.geometry]"),
        () if JobSettings::keys().get(key).is_some() => own("[job]"),
        () => geometry.iter().find_map(|outer| {
            let is_meant = |name: &&String| {
                name.strip_prefix(key).is_some_and(|unit| unit.is_empty() || unit.starts_with('_'))
            };
            let branches = outer.schema.get("anyOf").and_then(Value::as_array).into_iter().flatten();
            let tables = branches.chain([outer.schema]).filter_map(|schema| schema["properties"].as_object());
            let inner = tables.flat_map(|table| table.keys()).find(is_meant)?;
            Some((format!("[job.geometry.{}]", outer.name), inner.clone()))
        }),
    }
}

/// Keys for coordinate reference systems.
const CRS_KEYS: [&str; 2] = ["crs", "crs_of_input"];
/// Names that such keys do not have.
const CRS_SYNONYMS: [&str; 5] = ["epsg", "epsg_code", "srs", "srid", "crs"];

/// Key of this table that was meant by a name of a coordinate reference system; `None` for other names.
fn crs_key<'k>(name: &str, known: &[&'k str]) -> Option<Option<&'k str>> {
    let is_synonym = CRS_SYNONYMS.contains(&name.to_lowercase().as_str());
    is_synonym.then(|| known.iter().find(|key| CRS_KEYS.contains(key)).copied())
}

/// EPSG code of a value.
fn code<'v>(value: &'v DeValue) -> Option<&'v str> {
    let text = match value {
        DeValue::Integer(number) => number.as_str(),
        DeValue::String(text) => text.rsplit(':').next()?,
        _ => return None,
    };
    ((4..=6).contains(&text.len()) && text.bytes().all(|byte| byte.is_ascii_digit())).then_some(text)
}

fn crs_help(key: &str, code: &str) -> String {
    format!("write `{key} = \"EPSG:{code}\"`")
}

fn missing_key(owner: &str, key: &str, schema: &Value, header: &Range<usize>) -> JobError {
    let meaning = first_sentence(schema.get("description").and_then(Value::as_str).unwrap_or_default());
    let error = JobError::at(header.clone(), format!("{owner} requires the key `{key}`"));
    error.help(format!("add `{key} = ...`, {}: {meaning}", takes(schema)))
}

/// A value of a job with its schema.
#[derive(Clone, Copy)]
struct CheckedValue<'g> {
    /// Name of its table in errors.
    owner: &'g str,
    /// Name of the value in errors.
    name: &'g str,
    schema: &'g Value,
    value: &'g Spanned<DeValue<'g>>,
}

impl CheckedValue<'_> {
    fn check(&self) -> Vec<JobError> {
        if let Some(choices) = choices(self.schema) {
            return self.check_choice(&choices).into_iter().collect();
        }
        let branches = self.schema.get("anyOf").or_else(|| self.schema.get("oneOf"));
        if let Some(branches) = branches.and_then(Value::as_array) {
            return self.check_branches(branches);
        }
        if !self.is_of_type() {
            return vec![self.wrong_type()];
        }
        match self.value.get_ref() {
            DeValue::Integer(_) | DeValue::Float(_) => self.check_number().into_iter().collect(),
            DeValue::Table(table) => {
                let owner = format!("{} of {}", self.name, self.owner);
                check_table(&owner, self.schema, table, &self.value.span())
            }
            DeValue::Array(items) => {
                let name = &format!("an item of {}", self.name);
                let schema = self.schema.get("items").unwrap_or(&Value::Null);
                let of_items = items
                    .iter()
                    .flat_map(|value| CheckedValue { name, schema, value, ..*self }.check())
                    .take(MAX_ERRORS + 1);
                self.check_length(items.len()).into_iter().chain(of_items).collect()
            }
            _ => Vec::new(),
        }
    }

    /// Checks alternatives: if none is valid, reports the errors of the closest one.
    fn check_branches(&self, branches: &[Value]) -> Vec<JobError> {
        let each =
            branches.iter().map(|schema| CheckedValue { schema, ..*self }).filter(CheckedValue::is_of_type);
        let closest = each.map(|given| given.check()).min_by_key(Vec::len);
        match (closest, self.value.get_ref()) {
            (Some(errors), _) if errors.is_empty() => errors,
            // No text is closer than another: name all accepted texts.
            (Some(_), DeValue::String(text)) => vec![self.wrong_text(text)],
            (Some(errors), _) => errors,
            (None, _) => vec![self.wrong_type()],
        }
    }

    /// Returns whether the value has the type of the schema.
    fn is_of_type(&self) -> bool {
        let fits = |name: &Value| {
            if let (Some("boolean"), DeValue::Boolean(given)) = (name.as_str(), self.value.get_ref()) {
                return self.schema.get("const").is_none_or(|only| only == given);
            }
            matches!(
                (name.as_str(), self.value.get_ref()),
                (Some("string"), DeValue::String(_))
                    | (Some("integer"), DeValue::Integer(_))
                    | (Some("number"), DeValue::Integer(_) | DeValue::Float(_))
                    | (Some("array"), DeValue::Array(_))
                    | (Some("object"), DeValue::Table(_))
            )
        };
        match self.schema.get("type") {
            Some(Value::Array(names)) => names.iter().any(fits),
            Some(name) => fits(name),
            // A fixed set of texts without `type`.
            None => choices(self.schema).is_none() || matches!(self.value.get_ref(), DeValue::String(_)),
        }
    }

    fn wrong_type(&self) -> JobError {
        let error = self.must_be(&takes(self.schema), &kind_of(self.value.get_ref()));
        let wanted = self.schema.get("type").and_then(Value::as_str);
        let name = self.name.trim_matches('`');
        let code = code(self.value.get_ref()).filter(|_| CRS_KEYS.contains(&name));
        if let (DeValue::Integer(_), Some(code)) = (self.value.get_ref(), code) {
            return error.help(crs_help(name, code));
        }
        match (self.value.get_ref(), wanted) {
            (DeValue::String(text), Some("number" | "integer")) => {
                let number = text.replace(',', ".");
                let with = if number == **text { "" } else { "with a decimal point and " };
                match number.parse::<f64>() {
                    Ok(_) => error.help(format!("write numbers {with}without quotation marks: {number}")),
                    Err(_) => error,
                }
            }
            (DeValue::String(text), Some("boolean")) => match truth_of(text) {
                Some(value) => error.help(format!("write `{value}`, without quotation marks")),
                None => error,
            },
            (DeValue::String(text), _) if takes(self.schema).starts_with("a list of texts") => {
                error.help(format!("write a list: `{name} = [{text:?}]`"))
            }
            (DeValue::Float(_), Some("integer")) => error.help("write it without decimal point and exponent"),
            (DeValue::Integer(_) | DeValue::Float(_) | DeValue::Datetime(_), _) if only_text(self.schema) => {
                error.help("put text in quotation marks: `\"text\"`")
            }
            _ => error,
        }
    }

    fn check_choice(&self, choices: &[&str]) -> Option<JobError> {
        match self.value.get_ref() {
            DeValue::String(text) if choices.contains(&text.as_ref()) => None,
            DeValue::String(text) => Some(self.wrong_text(text).meant(text, choices.iter().copied())),
            _ => Some(self.wrong_type()),
        }
    }

    fn wrong_text(&self, text: &str) -> JobError {
        self.must_be(&takes(self.schema), &format!("{text:?}"))
    }

    fn check_number(&self) -> Option<JobError> {
        let (given, written) = match self.value.get_ref() {
            DeValue::Integer(number) => {
                let given = i64::from_str_radix(number.as_str(), number.radix());
                (given.map_or(f64::INFINITY, |given| given as f64), number.to_string())
            }
            DeValue::Float(number) => (number.as_str().parse().unwrap_or(f64::NAN), number.to_string()),
            _ => return None,
        };
        if !given.is_finite() {
            let problem = if given.is_nan() { "not a number" } else { "too large" };
            return Some(self.must_be(&takes(self.schema), &format!("{written}, which is {problem}")));
        }
        let bounds = bounds(self.schema).filter(|_| !is_within(self.schema, given))?;
        Some(self.must_be(&bounds, &written))
    }

    fn check_length(&self, n: usize) -> Option<JobError> {
        let limit = |keyword: &str| self.schema.get(keyword).and_then(Value::as_u64);
        let n = n as u64;
        let holds =
            limit("minItems").is_none_or(|min| n >= min) && limit("maxItems").is_none_or(|max| n <= max);
        (!holds).then(|| self.must_be(&takes(self.schema), &format!("a list of {n}")))
    }

    fn must_be(&self, wanted: &str, given: &str) -> JobError {
        JobError::at(self.value.span(), format!("{} must be {wanted}, got {given}", self.name))
    }
}
