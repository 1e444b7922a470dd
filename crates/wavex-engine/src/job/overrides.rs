//! Values set from outside the job's text: `--set STAGE.KEY=VALUE`.

use std::borrow::Cow;

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::draft::{DraftStage, JobDraft, syntax_error};
use super::sources::JobSources;
use super::validate::{only_text, table_of};
use super::{JobError, JobSettings};
use wavex_line::keys::{Keys, listed};
use wavex_line::stage::StageSpec;

/// A parsed override that is not yet applied: stage, key and value.
pub(super) struct ParsedOverride<'t> {
    stage: Spanned<&'t str>,
    key: OverrideKey<'t>,
    value: Spanned<DeValue<'t>>,
    /// Value as written.
    written: &'t str,
}

type OverrideKey<'t> = Spanned<Cow<'t, str>>;

/// Prepends blanks to `KEY=VALUE` up to its position among all texts of a job.
///
/// The spans of the TOML parser then need no correction. Empty if there is no `KEY=VALUE`.
pub(super) fn pad(start: usize, text: &str) -> String {
    stage_of(text)
        .map_or_else(String::new, |stage| " ".repeat(start + stage.len() + 1) + &text[stage.len() + 1..])
}

/// The STAGE of `STAGE.KEY=VALUE`.
fn stage_of(text: &str) -> Option<&str> {
    let (name, _) = text.split_once('=')?;
    Some(name.split_once('.')?.0)
}

/// Parses the overrides; `padded` are the results of [`pad`], `known` all stages.
pub(super) fn read<'t>(
    sources: &'t JobSources,
    padded: &'t [String],
    known: &[&'static StageSpec],
) -> (Vec<ParsedOverride<'t>>, Vec<JobError>) {
    let (mut changes, mut errors) = (Vec::new(), Vec::new());
    for ((start, text), padded) in sources.overrides().zip(padded) {
        match read_one(start, text, padded, known) {
            Ok(change) => changes.push(change),
            Err(error) => errors.push(error),
        }
    }
    (changes, errors)
}

fn read_one<'t>(
    start: usize,
    text: &'t str,
    padded: &'t str,
    known: &[&'static StageSpec],
) -> Result<ParsedOverride<'t>, JobError> {
    let malformed = || {
        let error = JobError::at(start..start + text.len(), "expected STAGE.KEY=VALUE");
        match with_table(text, known) {
            Some(meant) => error.help(format!("write `--set {meant}`")),
            None => error.help("for example `--set decompose.detection_sigma=5` or `--set job.threads=2`"),
        }
    };
    let stage = stage_of(text).ok_or_else(malformed)?;
    let (key, value) = padded.split_once('=').ok_or_else(malformed)?;
    let written = value.trim();
    if written.is_empty() {
        return Err(JobError::at(start..start + text.len(), "missing value after `=`"));
    }
    let (entries, problems) = DeTable::parse_recoverable(padded);
    let mut entries = entries.into_inner().into_iter();
    let (key, value) = match (entries.next(), entries.next(), problems.first()) {
        (Some(entry), None, None) => entry,
        (_, _, problem) => bare(key, written, padded).ok_or_else(|| match problem {
            Some(problem) => {
                syntax_error(padded, problem.span().unwrap_or(start..start + text.len()), problem)
            }
            None => malformed(),
        })?,
    };
    let stage = Spanned::new(start..start + stage.len(), stage);
    Ok(ParsedOverride { stage, key, value, written })
}

/// `KEY=VALUE` with the table that has the key.
fn with_table(text: &str, known: &[&'static StageSpec]) -> Option<String> {
    let (key, value) = text.split_once('=')?;
    Some(format!("{}={}", key_with_table(key.trim(), known)?, value.trim()))
}

/// A key as `--set` takes it: with the table of the job, or else the first stage, that has it.
pub fn key_with_table(key: &str, known: &[&'static StageSpec]) -> Option<String> {
    let of_stage = || known.iter().find(|spec| spec.keys().get(key).is_some());
    let (table, name) =
        table_of(key).or_else(|| of_stage().map(|spec| (spec.name.to_owned(), key.to_owned())))?;
    Some(format!("{}.{name}", table.trim_matches(['[', ']'])))
}

/// A key with a text value without quotation marks; `None` if it looks like TOML.
fn bare<'t>(key: &'t str, written: &'t str, padded: &str) -> Option<(OverrideKey<'t>, Spanned<DeValue<'t>>)> {
    let path = key.trim();
    let plain = |character: char| character.is_ascii_alphanumeric() || matches!(character, '_' | '-');
    let is_name = |name: &str| !name.is_empty() && name.chars().all(plain);
    if !path.split('.').all(is_name) || written.starts_with(['"', '\'', '[', '{']) {
        return None;
    }
    let value_end = padded.trim_end().len();
    let value = DeValue::String(Cow::Borrowed(written));
    let value = Spanned::new(value_end - written.len()..value_end, value);
    let mut at = key.trim_end().len() - path.len();
    let spanned = path.split('.').map(|name| {
        let start = at;
        at += name.len() + 1;
        Spanned::new(start..start + name.len(), Cow::Borrowed(name))
    });
    let mut names: Vec<OverrideKey> = spanned.collect();
    // A dotted path names nested tables.
    let inner = names.split_off(1);
    let value = inner.into_iter().rfold(value, |value, name| {
        Spanned::new(name.span().start..value_end, DeValue::Table(DeTable::from_iter([(name, value)])))
    });
    names.pop().map(|name| (name, value))
}

/// Applies the changes; returns errors.
pub(super) fn apply<'t>(changes: Vec<ParsedOverride<'t>>, draft: &mut JobDraft<'t>) -> Vec<JobError> {
    let mut errors = Vec::new();
    for change in changes {
        let keys = if *change.stage.get_ref() == "job" {
            Ok((draft.settings.get_mut(), JobSettings::keys()))
        } else {
            target(&change, &mut draft.stages)
        };
        match keys {
            Ok((table, keys)) => {
                let value = change.value_for(&keys);
                set(table, change.key, value);
            }
            Err(error) => errors.push(error),
        }
    }
    errors
}

impl<'t> ParsedOverride<'t> {
    /// The value, converted to text if the key accepts only text.
    fn value_for(&self, keys: &Keys) -> Spanned<DeValue<'t>> {
        let compound =
            matches!(self.value.get_ref(), DeValue::String(_) | DeValue::Array(_) | DeValue::Table(_));
        let text_wanted = keys.get(self.key.get_ref()).is_some_and(|key| only_text(key.schema));
        if compound || !text_wanted {
            return self.value.clone();
        }
        Spanned::new(self.value.span(), DeValue::String(Cow::Borrowed(self.written)))
    }
}

/// The table that an override changes, with its key definitions.
fn target<'d, 't>(
    change: &ParsedOverride,
    stages: &'d mut [DraftStage<'t>],
) -> Result<(&'d mut DeTable<'t>, Keys), JobError> {
    let (name, name_at) = (*change.stage.get_ref(), change.stage.span());
    if let "type" | "id" = change.key.get_ref().as_ref() {
        return Err(JobError::at(change.key.span(), format!("`{}` cannot be overridden", change.key)));
    }
    let by_id = stages.iter().any(|stage| stage.id == name);
    let is_meant = |stage: &&mut DraftStage| if by_id { stage.id == name } else { stage.type_name == name };
    let ids: Vec<String> = stages.iter().map(|stage| stage.id.clone()).collect();
    let mut meant: Vec<&mut DraftStage> = stages.iter_mut().filter(is_meant).collect();
    match (meant.pop(), meant.as_slice()) {
        (Some(stage), []) => {
            let keys = stage.spec.map_or_else(Keys::default, StageSpec::keys);
            Ok((stage.keys.get_mut(), keys))
        }
        (Some(last), others) => {
            let ids: Vec<&str> = others.iter().map(|stage| &*stage.id).chain([&*last.id]).collect();
            let error = JobError::at(name_at, format!("the job has several stages `{name}`"));
            Err(error.help(format!("select one by its `id`: {}", listed(&ids, "or"))))
        }
        (None, _) => {
            let names = ids.iter().map(String::as_str).chain(["job"]);
            let error = JobError::at(name_at, format!("the job has no stage `{name}`"));
            if let Some((table, _)) = table_of(name) {
                return Err(error.help(format!(
                    "for the table of the job: {}.{name}.{}=…",
                    table.trim_matches(['[', ']']),
                    change.key
                )));
            }
            Err(error.meant(name, names).help(format!("stages: {}", ids.join(", "))))
        }
    }
}

/// Sets a key; a table is merged, so keys not named by the override keep their values.
fn set<'t>(table: &mut DeTable<'t>, key: OverrideKey<'t>, value: Spanned<DeValue<'t>>) {
    let span = value.span();
    match (table.get_mut(key.get_ref().as_ref()).map(Spanned::get_mut), value.into_inner()) {
        (Some(DeValue::Table(old)), DeValue::Table(new)) => {
            for (key, value) in new {
                set(old, key, value);
            }
        }
        (_, value) => {
            // Otherwise the table would keep the old key with its old position.
            table.remove(key.get_ref().as_ref());
            table.insert(key, Spanned::new(span, value));
        }
    }
}
