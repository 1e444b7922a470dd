//! A job under construction: keys with their source, and its TOML text.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use wavex_engine::job::JobSettings;
use wavex_line::georef::GeometryKeys;
use wavex_line::keys::Keys;
use wavex_stages::registry::STAGES;

/// Stages and keys that the translation may use.
#[derive(Debug)]
pub enum Known {
    /// Any stage and key.
    Everything,
    /// These stages, `job` and `geometry`, with their keys.
    Program(BTreeMap<&'static str, Keys>),
}

/// A job under construction.
#[derive(Debug, Default)]
pub struct Draft {
    sections: Vec<DraftSection>,
}

/// Keys of `[job]`, of `[job.geometry]`, or of one stage.
#[derive(Debug)]
struct DraftSection {
    name: String,
    entries: Vec<DraftEntry>,
}

/// A key with its value.
#[derive(Debug)]
struct DraftEntry {
    key: &'static str,
    toml: String,
    /// Source of the key: an option or a default.
    why: String,
    /// Additional remark for the user.
    remark: &'static str,
    /// Reason why the key must be commented out, or empty.
    obstacle: String,
    /// Whether the command line requests it.
    ///
    /// A build that does not support a requested key must not run the job.
    is_asked: bool,
}

/// Result of writing a draft.
#[derive(Debug, Default, PartialEq)]
pub struct DraftText {
    /// The job.
    pub toml: String,
    /// Requests that this build does not support.
    pub missing: Vec<String>,
    /// Requests that cannot be met, each with the reason.
    pub obstacles: Vec<String>,
    /// First line in `toml`, from 0, of each key and header, with its source; empty for a header.
    pub sources: Vec<(usize, String)>,
}

impl Known {
    /// Stages and keys of this program.
    pub fn this_build() -> Known {
        let tables = [("job", JobSettings::keys()), ("geometry", GeometryKeys::keys())];
        let stages = STAGES.iter().map(|spec| (spec.name, spec.keys()));
        Known::Program(tables.into_iter().chain(stages).collect())
    }

    /// Returns whether the stage exists.
    pub fn has_stage(&self, name: &str) -> bool {
        matches!(self, Known::Everything) || self.keys_of(name).is_some()
    }

    /// Returns whether the key exists; `job` and `geometry` are tables, other sections are stages.
    pub fn has_key(&self, section: &str, key: &str) -> bool {
        matches!(self, Known::Everything) || self.keys_of(section).is_some_and(|keys| keys.get(key).is_some())
    }

    /// Keys of a section, if they are known.
    pub fn keys_of(&self, section: &str) -> Option<&Keys> {
        match self {
            Known::Everything => None,
            Known::Program(sections) => sections.get(section),
        }
    }
}

impl Draft {
    /// Sets a key; replaces an earlier value together with its source.
    pub fn set(&mut self, section: &str, key: &'static str, toml: String, why: &str, is_asked: bool) {
        let section = self.section(section);
        let entry =
            DraftEntry { key, toml, why: why.to_owned(), remark: "", obstacle: String::new(), is_asked };
        match section.entries.iter_mut().find(|entry| entry.key == key) {
            Some(old) => *old = entry,
            None => section.entries.push(entry),
        }
    }

    /// Value and source of a key that the command line requests.
    pub fn asked(&self, section: &str, key: &str) -> Option<(&str, &str)> {
        let entry = self.entries(section).iter().find(|entry| entry.key == key && entry.is_asked)?;
        Some((&entry.toml, &entry.why))
    }

    /// Adds a remark to a key.
    pub fn remark(&mut self, section: &str, key: &str, remark: &'static str) {
        if let Some(entry) = self.section(section).entries.iter_mut().find(|entry| entry.key == key) {
            entry.remark = remark;
        }
    }

    /// Comments a key out because its value cannot be used.
    pub fn obstruct(&mut self, section: &str, key: &str, obstacle: String) {
        if let Some(entry) = self.section(section).entries.iter_mut().find(|entry| entry.key == key) {
            entry.obstacle = obstacle;
        }
    }

    /// Removes a section.
    pub fn remove(&mut self, section: &str) {
        self.sections.retain(|other| other.name != section);
    }

    /// Requested keys outside of these sections: section and source (such as `-o12`).
    pub fn asked_outside_of(&self, sections: &[&str]) -> Vec<(String, String)> {
        let outside = self.sections.iter().filter(|section| !sections.contains(&section.name.as_str()));
        let asked = |section: &DraftSection| {
            let entries = section.entries.iter().filter(|entry| entry.is_asked);
            entries.map(|entry| (section.name.clone(), entry.why.clone())).collect::<Vec<_>>()
        };
        outside.flat_map(asked).collect()
    }

    /// Writes the job of these stages; unsupported parts become comments.
    pub fn text(&self, stages: &[&str], known: &Known) -> DraftText {
        let mut text = DraftText::default();
        if !self.entries("job").is_empty() {
            text.toml += "\n[job]\n";
            text.sources.push((text.toml.lines().count() - 1, String::new()));
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

    fn write_section(&self, name: &str, header: &str, is_known: bool, known: &Known, text: &mut DraftText) {
        if is_known {
            // An error at the header is of no key.
            text.sources.push((text.toml.lines().count() + 1, String::new()));
            let _ = writeln!(text.toml, "\n{header}");
            self.write_entries(name, known, text);
            return;
        }
        let mut inner = DraftText { toml: format!("{header}\n"), ..DraftText::default() };
        self.write_entries(name, &Known::Everything, &mut inner);
        let _ = writeln!(text.toml, "\n# Not supported by this build:");
        for line in inner.toml.lines() {
            let _ = writeln!(text.toml, "#{line}");
        }
        let asked = self.entries(name).iter().filter(|entry| entry.is_asked);
        text.missing.extend(asked.map(|entry| format!("{} (`{name}`)", entry.why)));
    }

    fn write_entries(&self, section: &str, known: &Known, text: &mut DraftText) {
        let mut lines: Vec<(String, String, &str)> = Vec::new();
        for entry in self.entries(section) {
            let line = format!("{} = {}", entry.key, entry.toml);
            let remark = if entry.remark.is_empty() { "" } else { ": " };
            let why = format!("{}{remark}{}", entry.why, entry.remark);
            if known.has_key(section, entry.key) && entry.obstacle.is_empty() {
                lines.push((line, why, &entry.why));
                continue;
            }
            let is_usable = entry.obstacle.is_empty();
            let obstacle = if is_usable { "not supported by this build" } else { &entry.obstacle };
            let noted = format!("{why}: {obstacle}");
            match (entry.is_asked, is_usable) {
                (true, true) => text.missing.push(format!("{} (`{}` of `{section}`)", entry.why, entry.key)),
                (true, false) => text.obstacles.push(noted.clone()),
                (false, _) => {}
            }
            lines.push((format!("#{line}"), noted, &entry.why));
        }
        let width = lines.iter().map(|(line, ..)| line.chars().count()).max().unwrap_or(0).min(44);
        let mut number = text.toml.lines().count();
        for (line, why, source) in lines {
            text.sources.push((number, source.to_owned()));
            number += line.matches('\n').count() + 1;
            let _ = match why.as_str() {
                "" => writeln!(text.toml, "{line}"),
                why => writeln!(text.toml, "{line:width$}  # {why}"),
            };
        }
    }

    fn entries(&self, name: &str) -> &[DraftEntry] {
        let found = self.sections.iter().find(|section| section.name == name);
        found.map_or(&[], |section| &section.entries)
    }

    fn section(&mut self, name: &str) -> &mut DraftSection {
        let at = self.sections.iter().position(|section| section.name == name);
        let at = at.unwrap_or_else(|| {
            self.sections.push(DraftSection { name: name.to_owned(), entries: Vec::new() });
            self.sections.len() - 1
        });
        &mut self.sections[at]
    }
}

/// A TOML string.
pub fn toml_text(text: &str) -> String {
    toml::Value::String(text.to_owned()).to_string()
}

/// A TOML number.
pub fn toml_number(number: f64) -> String {
    format!("{number:?}")
}
