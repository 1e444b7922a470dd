//! Keys that several jobs share, in files of their own: `[job] include`.
//!
//! An included file gives keys where the job gives none: its `[job]` those of `[job]`, and a table named after a stage those of
//! every stage of that type.

use std::borrow::Cow;

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::JobError;
use super::draft::{self, Draft};
use crate::registry::{find_in, nearest_of};
use crate::stage::StageSpec;

/// A file that a job includes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Include {
    /// What errors call it.
    pub name: String,
    /// What is in it.
    pub text: String,
}

/// The files that a job's text includes, in order, as it names them; none where it is no job, which comes to light when it is
/// read.
pub fn included(text: &str) -> Vec<String> {
    let (root, _) = DeTable::parse_recoverable(text);
    let job = root.get_ref().get("job").and_then(|job| job.get_ref().as_table());
    match job.and_then(|job| job.get(KEY)).map(Spanned::get_ref) {
        Some(DeValue::String(name)) => vec![name.to_string()],
        Some(DeValue::Array(names)) => {
            names.iter().filter_map(|name| Some(name.get_ref().as_str()?.to_owned())).collect()
        }
        _ => Vec::new(),
    }
}

/// The key of `[job]`.
pub(super) const KEY: &str = "include";

/// The text with blanks before it up to its place among the texts of a job, so that the spans that TOML's parser gives are
/// already the right ones.
pub(super) fn pad(start: usize, text: &str) -> String {
    // A mark of the byte order would stand amid the text.
    let marked = text.strip_prefix('\u{feff}');
    " ".repeat(start + text.len() - marked.unwrap_or(text).len()) + marked.unwrap_or(text)
}

/// Gives the keys of the included files to a job that does not have them; what cannot be given is told. Of two files the later
/// one counts.
pub(super) fn apply<'t>(
    padded: &'t [String],
    draft: &mut Draft<'t>,
    known: &[&'static StageSpec],
) -> Vec<JobError> {
    let mut errors = Vec::new();
    for text in padded.iter().rev() {
        match draft::syntax(text) {
            Ok(root) => {
                root.into_iter().for_each(|(name, value)| give(name, value, draft, known, &mut errors))
            }
            Err(syntax) => errors.extend(syntax),
        }
    }
    errors
}

/// What is wrong where the job names another number of files than were read: an override has changed it, or whoever reads the
/// job did not read them.
pub(super) fn check(draft: &Draft, n_read: usize) -> Option<JobError> {
    let value = draft.settings.get_ref().get(KEY)?;
    let n_named = match value.get_ref() {
        DeValue::Array(names) => names.len(),
        DeValue::String(_) => 1,
        // What is no name is told with the other keys.
        _ => return None,
    };
    let error = || JobError::at(value.span(), "the files that `include` names have not been read");
    (n_named != n_read).then(|| error().help("`include` counts where it stands in the job's own text"))
}

/// Gives the keys of one table.
fn give<'t>(
    name: Spanned<Cow<'t, str>>,
    value: Spanned<DeValue<'t>>,
    draft: &mut Draft<'t>,
    known: &[&'static StageSpec],
    errors: &mut Vec<JobError>,
) {
    let is_job = name.get_ref() == "job";
    if !is_job && find_in(known, name.get_ref()).is_none() {
        errors.push(unknown(&name, known));
        return;
    }
    let DeValue::Table(table) = value.get_ref() else {
        let error = JobError::at(value.span(), format!("`{}` must be a table", name.get_ref()));
        errors.push(error.help(format!("write `[{}]` above its keys", name.get_ref())));
        return;
    };
    let own: &[&str] = if is_job { &[KEY] } else { &["type", "id"] };
    if let Some((key, _)) = table.iter().find(|(key, _)| own.contains(&key.get_ref().as_ref())) {
        errors
            .push(JobError::at(key.span(), format!("`{}` cannot stand in an included file", key.get_ref())));
        return;
    }
    if is_job {
        fill(draft.settings.get_mut(), table);
    }
    for stage in draft.stages.iter_mut().filter(|stage| stage.type_name == *name.get_ref()) {
        fill(stage.keys.get_mut(), table);
    }
}

fn unknown(name: &Spanned<Cow<str>>, known: &[&'static StageSpec]) -> JobError {
    if name.get_ref() == "stage" {
        let error = JobError::at(name.span(), "an included file has no stages of its own");
        return error.help("name a table after a stage: `[decompose]` is for every stage of that type");
    }
    let error = JobError::at(name.span(), format!("`{}` is neither `job` nor a stage", name.get_ref()));
    match nearest_of(name.get_ref(), known.iter().map(|spec| spec.name).chain(["job"])) {
        Some(meant) => error.help(format!("did you mean `[{meant}]`?")),
        None => error.help("name a table after a stage, or `[job]`"),
    }
}

/// Adds what a table does not have; tables in it are filled likewise.
fn fill<'t>(table: &mut DeTable<'t>, from: &DeTable<'t>) {
    for (key, value) in from {
        match (table.get_mut(key.get_ref().as_ref()).map(Spanned::get_mut), value.get_ref()) {
            (Some(DeValue::Table(inner)), DeValue::Table(from)) => fill(inner, from),
            (Some(_), _) => {}
            (None, _) => drop(table.insert(key.clone(), value.clone())),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_found_before_anything_is_read() {
        assert_eq!(included("[job]\ninclude = 'a.toml'\n"), ["a.toml"]);
        assert_eq!(included("job.include = ['a.toml', 'b.toml']\n[[stage]]\n"), ["a.toml", "b.toml"]);
        assert_eq!(included("[job]\nthreads = 2\n"), Vec::<String>::new());
        assert_eq!(included("[job]\ninclude = [1]\n= = ="), Vec::<String>::new());
        assert_eq!(included("job = 3"), Vec::<String>::new());
    }

    #[test]
    fn a_text_keeps_its_length_behind_the_blanks() {
        assert_eq!(pad(3, "a"), "   a");
        assert_eq!(pad(1, "\u{feff}a"), "    a");
    }
}
