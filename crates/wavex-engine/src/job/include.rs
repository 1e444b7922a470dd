//! Included files with shared keys: `[job] include`.
//!
//! An included file provides defaults: its table `[job]` for `[job]`, and a table named after a
//! stage type for every stage of that type.

use std::borrow::Cow;

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::JobError;
use super::draft::{self, JobDraft};
use wavex_line::stage::StageSpec;
use wavex_line::stage::{find_in, nearest_of};

/// Names of the files that a job's text includes, in order.
///
/// Returns none if the text is invalid; parsing the job reports the errors.
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

/// Prepends blanks up to the position of the text among all texts of a job.
///
/// The spans of the TOML parser then need no correction.
pub(super) fn pad(start: usize, text: &str) -> String {
    // A byte order mark would end up in the middle of the text.
    let marked = text.strip_prefix('\u{feff}');
    " ".repeat(start + text.len() - marked.unwrap_or(text).len()) + marked.unwrap_or(text)
}

/// Adds keys of the included files that the job does not set; returns errors.
///
/// Later files override earlier ones.
pub(super) fn apply<'t>(
    padded: &'t [String],
    draft: &mut JobDraft<'t>,
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

/// Error if the job names a different number of files than were read.
///
/// This happens if an override changes `include`, or if the caller did not read the files.
pub(super) fn check(draft: &JobDraft, n_read: usize) -> Option<JobError> {
    let value = draft.settings.get_ref().get(KEY)?;
    let n_named = match value.get_ref() {
        DeValue::Array(names) => names.len(),
        DeValue::String(_) => 1,
        // Values of other types are reported with the other keys.
        _ => return None,
    };
    let error = || JobError::at(value.span(), "the files named by `include` have not been read");
    (n_named != n_read).then(|| error().help("`include` must be set in the text of the job itself"))
}

/// Adds the keys of one table.
fn give<'t>(
    name: Spanned<Cow<'t, str>>,
    value: Spanned<DeValue<'t>>,
    draft: &mut JobDraft<'t>,
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
        errors.push(JobError::at(
            key.span(),
            format!("`{}` is not allowed in an included file", key.get_ref()),
        ));
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
        let error = JobError::at(name.span(), "an included file cannot contain stages");
        return error
            .help("name a table after a stage type: `[decompose]` applies to every stage of that type");
    }
    let error = JobError::at(name.span(), format!("`{}` is neither `job` nor a stage type", name.get_ref()));
    match nearest_of(name.get_ref(), known.iter().map(|spec| spec.name).chain(["job"])) {
        Some(meant) => error.help(format!("did you mean `[{meant}]`?")),
        None => error.help("name a table after a stage type, or `[job]`"),
    }
}

/// Adds missing entries to a table, recursively.
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
