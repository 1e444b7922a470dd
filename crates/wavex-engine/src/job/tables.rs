//! Second parsing pass: the remaining tables become settings and stages.

use std::ops::Range;

use serde::Deserialize;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::draft::DraftStage;
use super::page::REPORT_IS_A_NAME;
use super::{JobError, JobSettings, JobStage, validate};
use wavex_line::keys::{InvalidKey, Keys};
use wavex_line::stage::ConfigError;

/// A parsed stage with the positions of its texts.
pub(super) struct ParsedStage {
    /// The stage.
    pub stage: JobStage,
    /// Position of its name.
    pub named_at: Range<usize>,
    /// All texts among its keys, with positions.
    texts: Vec<Spanned<String>>,
}

impl ParsedStage {
    /// Position of a text among its keys, or of the stage's name if the text is a default.
    pub(super) fn place_of(&self, text: &str) -> Range<usize> {
        let same = |found: &&Spanned<String>| found.get_ref() == text;
        self.texts.iter().find(same).map_or(self.named_at.clone(), Spanned::span)
    }
}

/// Parses the settings of `[job]`; `stages` are those of the job.
pub(super) fn settings(
    table: Spanned<DeTable>,
    stages: &[DraftStage],
    errors: &mut Vec<JobError>,
) -> Option<JobSettings> {
    let keys = JobSettings::keys();
    let mut problems = validate::check("`[job]`", &keys, &table);
    if !problems.is_empty() {
        for problem in &mut problems {
            let unknown = table.get_ref().keys().find(|key| Some(key.span()) == problem.span);
            let has_key = |stage: &&DraftStage| {
                let key = unknown.filter(|key| keys.get(key.get_ref()).is_none());
                key.zip(stage.spec).is_some_and(|(key, spec)| spec.keys().get(key.get_ref()).is_some())
            };
            if let Some(stage) = stages.iter().find(has_key) {
                problem.help.insert(0, format!("it is a key of the stage `{}`", stage.id));
            }
        }
        let report = table.get_ref().get("report").filter(|report| report.get_ref().is_bool());
        let place = report.map(Spanned::span);
        errors.extend(problems.into_iter().map(|error| match &place {
            Some(place) if error.span.as_ref() == Some(place) => error.help(REPORT_IS_A_NAME),
            _ => error,
        }));
        return None;
    }
    let places = EntryPositions::of(&table);
    match JobSettings::deserialize(toml::de::Deserializer::from(table)) {
        Ok(settings) => match settings.check() {
            Ok(()) => Some(settings),
            Err(invalid) => {
                errors.push(places.invalid(&keys, &invalid));
                None
            }
        },
        Err(error) => {
            errors.push(places.refused(&keys, &error));
            None
        }
    }
}

/// Parses the keys of a stage.
pub(super) fn stage(draft: DraftStage, errors: &mut Vec<JobError>) -> Option<ParsedStage> {
    let spec = draft.spec?;
    let keys = spec.keys();
    let problems = validate::check(&format!("`{}`", spec.name), &keys, &draft.keys);
    if !problems.is_empty() {
        errors.extend(problems);
        return None;
    }
    let places = EntryPositions::of(&draft.keys);
    let mut texts = Vec::new();
    draft.keys.get_ref().values().for_each(|value| collect_texts(value, &mut texts));
    match (spec.parse)(draft.keys) {
        Ok(planned) => {
            let stage = JobStage { id: draft.id, spec, planned };
            Some(ParsedStage { stage, named_at: draft.named_at, texts })
        }
        Err(ConfigError::Toml(error)) => {
            errors.push(places.refused(&keys, &error));
            None
        }
        Err(ConfigError::Key(invalid)) => {
            errors.push(places.invalid(&keys, &invalid));
            None
        }
    }
}

/// Positions of the entries of a table.
struct EntryPositions {
    header: Range<usize>,
    entries: Vec<(String, Range<usize>)>,
}

impl EntryPositions {
    fn of(table: &Spanned<DeTable>) -> EntryPositions {
        let mut entries = Vec::new();
        collect_entries("", table.get_ref(), &mut entries);
        EntryPositions { header: table.span(), entries }
    }

    /// Error for a value that passes the schema but fails to deserialize.
    fn refused(&self, keys: &Keys, error: &toml::de::Error) -> JobError {
        let span = error.span().unwrap_or(self.header.clone());
        let within =
            |(_, place): &&(String, Range<usize>)| place.start <= span.start && span.end <= place.end;
        let Some(key) = self.entries.iter().find(within).and_then(|(name, _)| keys.get(name)) else {
            return JobError::at(span, error.message());
        };
        // serde's own messages name Rust types; messages of custom deserializers are meaningful.
        let of_types = ["invalid type: ", "invalid value: ", "invalid length "];
        let message = match error.message() {
            message if of_types.iter().any(|words| message.starts_with(words)) => "invalid value",
            message => message,
        };
        let error = JobError::at(span, format!("`{}`: {message}", key.name));
        error.help(format!("`{}` takes {}", key.name, key.takes()))
    }

    /// Error for a value that the stage rejects.
    fn invalid(&self, keys: &Keys, invalid: &InvalidKey) -> JobError {
        let InvalidKey { key, problem } = invalid;
        if let Some((_, place)) = self.entries.iter().find(|(name, _)| name == key) {
            return JobError::at(place.clone(), format!("`{key}`: {problem}"));
        }
        let default = keys.get(key).and_then(|key| key.default().map(|value| format!(", {value},")));
        let error = JobError::at(self.header.clone(), format!("`{key}`: {problem}"));
        error.help(format!(
            "the job does not set `{key}`, and its default{} is not valid here",
            default.unwrap_or_default()
        ))
    }
}

/// Collects the positions of all entries; nested entries come first, with dotted names.
fn collect_entries(path: &str, table: &DeTable, entries: &mut Vec<(String, Range<usize>)>) {
    for (key, value) in table {
        let name = format!("{path}{}", key.get_ref());
        if let DeValue::Table(inner) = value.get_ref() {
            collect_entries(&format!("{name}."), inner, entries);
        }
        entries.push((name, value.span()));
    }
}

/// Collects all texts in a value.
fn collect_texts(value: &Spanned<DeValue>, texts: &mut Vec<Spanned<String>>) {
    match value.get_ref() {
        DeValue::String(text) => texts.push(Spanned::new(value.span(), text.clone().into_owned())),
        DeValue::Array(items) => items.iter().for_each(|item| collect_texts(item, texts)),
        DeValue::Table(table) => table.values().for_each(|value| collect_texts(value, texts)),
        _ => {}
    }
}
