//! A job in the making: its keys, each with what it comes from, and its text in TOML.

use std::fmt::Write as _;

use serde_json::Value;

use crate::job::job_schema;
use crate::registry::STAGES;

/// What a build can do: its stages and keys.
#[derive(Debug)]
pub enum Known {
    /// Every stage and every key that there may ever be.
    Everything,
    /// Those of this schema of jobs.
    Schema(Value),
}

/// A job in the making.
#[derive(Debug, Default)]
pub struct Draft {
    sections: Vec<Section>,
}

/// The keys of `[job]`, of `[job.geometry]`, or of a stage.
#[derive(Debug)]
struct Section {
    name: String,
    entries: Vec<Entry>,
}

/// A key with its value.
#[derive(Debug)]
struct Entry {
    key: &'static str,
    toml: String,
    /// What it comes from.
    why: String,
    /// What one must know of it besides.
    remark: &'static str,
    /// What keeps it from being a key of the job; empty: nothing.
    obstacle: String,
    /// Whether the line asks for it, so that a build that cannot do it must not run the job.
    is_asked: bool,
}

/// What became of a draft.
#[derive(Debug, Default, PartialEq)]
pub struct Text {
    /// The job.
    pub toml: String,
    /// What the line asks for and this build cannot do.
    pub missing: Vec<String>,
    /// What the line asks for in a way that cannot be used, and why.
    pub obstacles: Vec<String>,
}

impl Known {
    /// What this program can do.
    pub fn this_build() -> Known {
        Known::Schema(job_schema(STAGES))
    }

    /// Whether there is such a stage.
    pub fn has_stage(&self, name: &str) -> bool {
        matches!(self, Known::Everything) || self.keys_of(name).is_some()
    }

    /// Whether there is such a key; the sections `job` and `geometry` are tables, all others stages.
    pub fn has_key(&self, section: &str, key: &str) -> bool {
        matches!(self, Known::Everything) || self.keys_of(section).is_some_and(|keys| keys.get(key).is_some())
    }

    /// The schema of a key.
    pub fn key(&self, section: &str, key: &str) -> Option<&Value> {
        self.keys_of(section)?.get(key)
    }

    /// The keys of a section in the schema.
    fn keys_of(&self, section: &str) -> Option<&Value> {
        let Known::Schema(schema) = self else { return None };
        let job = schema.pointer("/properties/job/properties");
        let is_it =
            |stage: &&Value| stage.pointer("/properties/type/const").and_then(Value::as_str) == Some(section);
        match section {
            "job" => job,
            "geometry" => job?.pointer("/geometry/properties"),
            _ => {
                let stages = schema.pointer("/properties/stage/items/oneOf")?.as_array()?;
                stages.iter().find(is_it)?.get("properties")
            }
        }
    }
}

impl Draft {
    /// Sets a key; one that is there already gets another value, and what it comes from is told with it.
    pub fn set(&mut self, section: &str, key: &'static str, toml: String, why: &str, is_asked: bool) {
        let section = self.section(section);
        let entry = Entry { key, toml, why: why.to_owned(), remark: "", obstacle: String::new(), is_asked };
        match section.entries.iter_mut().find(|entry| entry.key == key) {
            Some(old) => *old = entry,
            None => section.entries.push(entry),
        }
    }

    /// What the line has set a key to, and by what.
    pub fn asked(&self, section: &str, key: &str) -> Option<(&str, &str)> {
        let entry = self.entries(section).iter().find(|entry| entry.key == key && entry.is_asked)?;
        Some((&entry.toml, &entry.why))
    }

    /// Says of a key what one must know besides.
    pub fn remark(&mut self, section: &str, key: &str, remark: &'static str) {
        if let Some(entry) = self.section(section).entries.iter_mut().find(|entry| entry.key == key) {
            entry.remark = remark;
        }
    }

    /// Makes a key a comment, because its value cannot be used.
    pub fn obstruct(&mut self, section: &str, key: &str, obstacle: String) {
        if let Some(entry) = self.section(section).entries.iter_mut().find(|entry| entry.key == key) {
            entry.obstacle = obstacle;
        }
    }

    /// Takes a section out.
    pub fn remove(&mut self, section: &str) {
        self.sections.retain(|other| other.name != section);
    }

    /// What the line asks for in sections that are not among these: `-o12`.
    pub fn asked_outside_of(&self, sections: &[&str]) -> Vec<(String, String)> {
        let outside = self.sections.iter().filter(|section| !sections.contains(&section.name.as_str()));
        let asked = |section: &Section| {
            let entries = section.entries.iter().filter(|entry| entry.is_asked);
            entries.map(|entry| (section.name.clone(), entry.why.clone())).collect::<Vec<_>>()
        };
        outside.flat_map(asked).collect()
    }

    /// The job of these stages. What the build does not know stands there as a comment.
    pub fn text(&self, stages: &[&str], known: &Known) -> Text {
        let mut text = Text::default();
        if !self.entries("job").is_empty() {
            text.toml += "\n[job]\n";
            self.write_entries("job", known, &mut text);
        }
        if !self.entries("geometry").is_empty() {
            let is_known = known.has_key("job", "geometry") || known.has_key("geometry", "trajectory");
            self.write_section("geometry", "[job.geometry]", is_known, known, &mut text);
        }
        for stage in stages {
            let header = format!("[[stage]]\ntype = \"{stage}\"");
            self.write_section(stage, &header, known.has_stage(stage), known, &mut text);
        }
        text
    }

    fn write_section(&self, name: &str, header: &str, is_known: bool, known: &Known, text: &mut Text) {
        if is_known {
            let _ = writeln!(text.toml, "\n{header}");
            self.write_entries(name, known, text);
            return;
        }
        let mut inner = Text { toml: format!("{header}\n"), ..Text::default() };
        self.write_entries(name, &Known::Everything, &mut inner);
        let _ = writeln!(text.toml, "\n# This build cannot do this yet:");
        for line in inner.toml.lines() {
            let _ = writeln!(text.toml, "#{line}");
        }
        let asked = self.entries(name).iter().filter(|entry| entry.is_asked);
        text.missing.extend(asked.map(|entry| format!("{} (`{name}`)", entry.why)));
    }

    fn write_entries(&self, section: &str, known: &Known, text: &mut Text) {
        let mut lines: Vec<(String, String)> = Vec::new();
        for entry in self.entries(section) {
            let line = format!("{} = {}", entry.key, entry.toml);
            let remark = if entry.remark.is_empty() { "" } else { ": " };
            let why = format!("{}{remark}{}", entry.why, entry.remark);
            if known.has_key(section, entry.key) && entry.obstacle.is_empty() {
                lines.push((line, why));
                continue;
            }
            let is_usable = entry.obstacle.is_empty();
            let obstacle = if is_usable { "this build cannot do this yet" } else { &entry.obstacle };
            let told = format!("{why}: {obstacle}");
            match (entry.is_asked, is_usable) {
                (true, true) => text.missing.push(format!("{} (`{}` of `{section}`)", entry.why, entry.key)),
                (true, false) => text.obstacles.push(told.clone()),
                (false, _) => {}
            }
            lines.push((format!("#{line}"), told));
        }
        let width = lines.iter().map(|(line, _)| line.chars().count()).max().unwrap_or(0).min(44);
        for (line, why) in lines {
            let _ = match why.as_str() {
                "" => writeln!(text.toml, "{line}"),
                why => writeln!(text.toml, "{line:width$}  # {why}"),
            };
        }
    }

    fn entries(&self, name: &str) -> &[Entry] {
        let found = self.sections.iter().find(|section| section.name == name);
        found.map_or(&[], |section| &section.entries)
    }

    fn section(&mut self, name: &str) -> &mut Section {
        let at = self.sections.iter().position(|section| section.name == name);
        let at = at.unwrap_or_else(|| {
            self.sections.push(Section { name: name.to_owned(), entries: Vec::new() });
            self.sections.len() - 1
        });
        &mut self.sections[at]
    }
}

/// A text in TOML.
pub fn toml_text(text: &str) -> String {
    toml::Value::String(text.to_owned()).to_string()
}

/// A number in TOML.
pub fn toml_number(number: f64) -> String {
    format!("{number:?}")
}
