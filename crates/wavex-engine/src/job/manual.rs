//! Manual of the stages, generated from the doc comments of their keys.

use std::fmt::Write;

use serde_json::Value;

use super::{JobSettings, SurveyKeys};
use wavex_line::georef::GeometryKeys;
use wavex_line::keys::{Key, Keys, listed};
use wavex_line::stage::{RoleName, StageSpec};

/// Renders the manual of these stages in Markdown (`docs/stages.md`).
pub fn manual(stages: &[&'static StageSpec]) -> String {
    let mut page = String::from(INTRODUCTION);
    for spec in stages {
        let (role, flow, first) = (spec.role, flow(spec), cell(&summary(spec)));
        // Writing to a String cannot fail.
        let _ = writeln!(page, "| [`{0}`](#{0}) | {role} | {flow} | {first} |", spec.name);
    }
    page += "\n## `[job]`\n\n";
    page += JobSettings::keys().doc();
    page += "\n\n";
    page += &key_table(&JobSettings::keys());
    let geometry = GeometryKeys::keys();
    let _ = write!(page, "\n## `[job.geometry]`\n\n{}\n\n{}", geometry.doc(), key_table(&geometry));
    let survey = SurveyKeys::keys();
    let _ = write!(page, "\n## `[job.survey]`\n\n{}\n\n{}", survey.doc(), key_table(&survey));
    for spec in stages {
        let keys = spec.keys();
        let _ = write!(
            page,
            "\n## `{}`\n\n{}.\n\n{}\n\n{}",
            spec.name,
            place(spec),
            keys.doc(),
            key_table(&keys)
        );
    }
    page
}

const INTRODUCTION: &str = "\
# The stages

A job is a list of stages: a source produces scan lines, maps and transforms process them, and sinks write them and pass
them on. This page is generated from the code by `cargo test --test command_line generated`; `wavex stages NAME` prints one section.

There are three kinds of scan lines: Shots (emissions and recorded waveforms), Returns (echoes reported by the
decomposition) and Points (returns with coordinates).

| stage | role | lines | |
|---|---|---|---|
";

/// Renders the manual of one stage for a terminal.
pub fn manual_of(spec: &StageSpec) -> String {
    let keys = spec.keys();
    let mut page = format!("{}: {}\n\n{}\n", spec.name, place(spec), keys.doc());
    for key in keys.iter() {
        let default = match (key.required, key.default()) {
            (true, _) => "; required".to_owned(),
            (false, Some(default)) => format!("; default {}", toml_text(default)),
            (false, None) => String::new(),
        };
        let unit = key.unit().map(|unit| format!(", in {unit}")).unwrap_or_default();
        let _ = write!(page, "\n  {} ({}{unit}{default})\n", key.name, key.takes());
        for line in key.meaning().lines() {
            page += format!("      {line}").trim_end();
            page += "\n";
        }
    }
    page
}

/// First sentence of a stage's documentation.
pub fn summary(spec: &StageSpec) -> String {
    first_sentence(spec.keys().doc())
}

/// First sentence of a text, on one line.
pub(super) fn first_sentence(text: &str) -> String {
    let paragraph = text.split("\n\n").next().unwrap_or_default();
    let line = paragraph.split_whitespace().collect::<Vec<_>>().join(" ");
    match line.split_once(". ") {
        Some((sentence, _)) => format!("{sentence}."),
        None => line,
    }
}

/// Formats a default as TOML.
pub(super) fn toml_text(value: &Value) -> String {
    match value {
        Value::Array(items) => format!("[{}]", items.iter().map(toml_text).collect::<Vec<_>>().join(", ")),
        Value::Object(members) => {
            let entries: Vec<String> =
                members.iter().map(|(key, value)| format!("{key} = {}", toml_text(value))).collect();
            format!("{{ {} }}", entries.join(", "))
        }
        Value::String(text) => toml::Value::String(text.clone()).to_string(),
        other => other.to_string(),
    }
}

/// Input and output kinds of a stage: `Shots → Returns`.
fn flow(spec: &StageSpec) -> String {
    let takes: Vec<String> = spec.accepts.iter().map(ToString::to_string).collect();
    match (takes.as_slice(), spec.makes) {
        ([], Some(makes)) => format!("→ {makes}"),
        (takes, Some(makes)) => format!("{} → {makes}", listed(takes, "or")),
        (takes, None) => listed(takes, "or"),
    }
}

/// Role, input and output of a stage as text.
fn place(spec: &StageSpec) -> String {
    let takes: Vec<String> = spec.accepts.iter().map(ToString::to_string).collect();
    let takes = listed(&takes, "or");
    let flow = match (spec.role, spec.makes) {
        (RoleName::Source, Some(makes)) => format!("makes {makes}"),
        (RoleName::Source, None) => "makes lines".to_owned(),
        (_, Some(makes)) => format!("takes {takes}, makes {makes}"),
        (RoleName::Sink, None) => format!("takes {takes} and passes them on"),
        (_, None) => format!("takes {takes} and keeps the kind"),
    };
    let after: Vec<String> = spec.after.iter().map(|name| format!("`{name}`")).collect();
    let unless = spec.unless.map(|(key, word)| format!(", unless `{key} = \"{word}\"`")).unwrap_or_default();
    let after = match after.is_empty() {
        true => String::new(),
        false => format!("; requires {} before it{unless}", listed(&after, "or")),
    };
    let role = match spec.role {
        RoleName::Source => "A source",
        RoleName::Map => "A map",
        RoleName::Transform => "A transform",
        RoleName::Sink => "A sink",
    };
    format!("{role}: {flow}{after}")
}

/// Renders the keys as a Markdown table.
fn key_table(keys: &Keys) -> String {
    let mut table = String::from("| key | type | default | unit | meaning |\n|---|---|---|---|---|\n");
    for key in keys.iter() {
        let (takes, meaning) = (cell(&key.takes()), cell(key.meaning()));
        let unit = key.unit().unwrap_or_default();
        let _ = writeln!(table, "| `{}` | {takes} | {} | {unit} | {meaning} |", key.name, default_cell(&key));
    }
    if keys.iter().next().is_none() { "It has no keys.\n".to_owned() } else { table }
}

fn default_cell(key: &Key) -> String {
    match (key.required, key.default()) {
        (true, _) => "required".to_owned(),
        (false, Some(default)) => format!("`{}`", cell(&toml_text(default))),
        (false, None) => "none".to_owned(),
    }
}

/// Formats a text as a Markdown table cell: one line, escaped bars.
fn cell(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ").replace('|', "\\|")
}
