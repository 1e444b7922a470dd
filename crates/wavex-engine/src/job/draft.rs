//! First parsing pass: the text becomes a table with source positions.
//!
//! Removes `[job]`, and each stage's `type` and `id`, from the table.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::JobError;
use super::errors::{BACKSLASHES, MAX_ERRORS};
use super::limits::MAX_STAGES;
use super::validate::{table_of, truth_of};
use wavex_line::keys::{FileMark, Keys};
use wavex_line::stage::StageSpec;
use wavex_line::stage::{find_in, nearest_of};

/// A job with named stages and unparsed keys.
pub(super) struct JobDraft<'t> {
    /// The keys of `[job]`.
    pub settings: Spanned<DeTable<'t>>,
    /// Stages in order.
    pub stages: Vec<DraftStage<'t>>,
}

/// A stage with unparsed keys.
pub(super) struct DraftStage<'t> {
    /// Position of its `type`, or of its header if it has no `type`.
    pub named_at: Range<usize>,
    /// Name in errors: its type, or a placeholder.
    pub type_name: String,
    /// Entry in the registry, if known.
    pub spec: Option<&'static StageSpec>,
    /// Its `id` or the name derived from its type.
    pub id: String,
    /// Position of its `id`, if given.
    id_at: Option<Range<usize>>,
    /// Its keys, with the span of the header.
    pub keys: Spanned<DeTable<'t>>,
}

/// Parses the text as TOML, or returns its syntax errors.
///
/// Only the first error of each line is reported, because the others are mostly consequences of it.
pub(super) fn syntax(text: &str) -> Result<DeTable<'_>, Vec<JobError>> {
    let (root, problems) = DeTable::parse_recoverable(text);
    if problems.is_empty() {
        return Ok(root.into_inner());
    }
    let mut of_lines: BTreeMap<usize, JobError> = BTreeMap::new();
    let single = single_stage(text);
    // Lines are counted on from the problem before; most problems come in the order of the text.
    let (mut at, mut line) = (0, 0);
    for problem in &problems {
        let span = problem.span().unwrap_or_default();
        if span.start < at {
            (at, line) = (0, 0);
        }
        line += text.get(at..span.start).unwrap_or_default().matches('\n').count();
        at = span.start;
        match &single {
            // Stages below `[stage]` are duplicates of each other.
            Some(header) if problem.message() == "duplicate key" && header.start <= span.start => {
                let line = text.get(..header.start).unwrap_or_default().matches('\n').count();
                of_lines.insert(line, not_a_list(header.clone()));
            }
            _ => {
                of_lines.entry(line).or_insert_with(|| syntax_error(text, span, problem));
            }
        }
        if of_lines.len() > MAX_ERRORS {
            break;
        }
    }
    Err(of_lines.into_values().collect())
}

/// Position of the first `[stage]`.
fn single_stage(text: &str) -> Option<Range<usize>> {
    let mut start = 0;
    for line in text.split_inclusive('\n') {
        let header = line.split('#').next().unwrap_or_default();
        if header.split_whitespace().collect::<String>() == "[stage]" {
            let indent = header.len() - header.trim_start().len();
            return Some(start + indent..start + header.trim_end().len());
        }
        start += line.len();
    }
    None
}

/// Error for stages that are not a list of tables.
fn not_a_list(span: Range<usize>) -> JobError {
    let error = JobError::at(span, "`stage` must be a list of tables");
    error.help("write `[[stage]]`, with two brackets, above the keys of each stage")
}

/// Converts a TOML syntax error of this text.
pub(super) fn syntax_error(text: &str, span: Range<usize>, problem: &toml::de::Error) -> JobError {
    let start = text.get(..span.start).and_then(|before| before.rfind('\n')).map_or(0, |end| end + 1);
    let line = text.get(start..).and_then(|rest| rest.lines().next()).unwrap_or_default();
    let value =
        line.split_once('=').map_or("", |(_, value)| value.split('#').next().unwrap_or_default().trim());
    let error = JobError::at(span, format!("invalid TOML: {}", problem.message()));
    let error = match value_help(value, problem.message()) {
        Some(help) => error.help(help),
        None => error,
    };
    if line.contains('\\') { error.help(BACKSLASHES) } else { error }
}

/// Help for a value that is not TOML.
fn value_help(value: &str, message: &str) -> Option<String> {
    let is_unquoted =
        message.starts_with("string values must be quoted") || message.contains("invalid boolean");
    let number = value.replacen(',', ".", 1);
    match truth_of(value) {
        _ if value.starts_with(TYPOGRAPHIC) => {
            Some("write `\"` for the typographic quotation marks".to_owned())
        }
        _ if number != value && number.parse::<f64>().is_ok() => {
            Some(format!("write numbers with a decimal point: {number}"))
        }
        Some(truth) if is_unquoted => {
            Some(format!("write `{truth}` for a flag, or text in quotation marks: `\"{value}\"`"))
        }
        _ => is_unquoted.then(|| "put text in quotation marks: `\"text\"`".to_owned()),
    }
}

/// Quotation marks of word processors.
const TYPOGRAPHIC: [char; 8] = ['“', '”', '„', '‟', '‘', '’', '‚', '«'];

impl<'t> JobDraft<'t> {
    /// Splits the table into settings and stages; also returns errors.
    pub(super) fn new(mut root: DeTable<'t>, known: &[&'static StageSpec]) -> (JobDraft<'t>, Vec<JobError>) {
        let mut errors = Vec::new();
        let settings = root.remove("job").and_then(|job| table(job, "[job]", &mut errors));
        let settings = settings.unwrap_or_else(|| Spanned::new(0..0, DeTable::new()));
        let stages = root.remove("stage").map_or_else(Vec::new, |value| elements(value, &mut errors));
        if let Some(first) = stages.get(MAX_STAGES) {
            let problem = format!("the job has {} stages, more than {MAX_STAGES}", stages.len());
            let error = JobError::at(first.span(), problem).help("write several jobs");
            return (JobDraft { settings, stages: Vec::new() }, vec![error]);
        }
        let mut stages: Vec<DraftStage> =
            stages.into_iter().map(|keys| DraftStage::new(keys, known, &mut errors)).collect();
        name(&mut stages, &mut errors);
        errors.extend(unknown_keys(&root));
        if stages.is_empty() && errors.is_empty() {
            let help = "`wavex init` writes a starter job; `wavex stages` lists the stages";
            errors.push(JobError::of_job("the job has no stage").help(help));
        }
        (JobDraft { settings, stages }, errors)
    }
}

impl JobDraft<'_> {
    /// Errors for libraries that the text names.
    ///
    /// Jobs pass from hand to hand, and a library runs with all rights of the user.
    pub(super) fn libraries(&self) -> Vec<JobError> {
        let mut errors = Vec::new();
        for stage in &self.stages {
            let Some(spec) = stage.spec else { continue };
            let keys = Keys::of(spec.schema);
            let is_library =
                |name: &str| keys.get(name).is_some_and(|key| key.file_mark() == Some(FileMark::Library));
            for (key, value) in stage.keys.get_ref().iter().filter(|(key, _)| is_library(key.get_ref())) {
                let key = key.get_ref();
                let problem = format!("a job cannot name a library (`{key}`)");
                let help = format!(
                    "name it on the command line, `--set {}.{key}=PATH`, or in the environment variable {}",
                    stage.id,
                    wavex_formats::sdf::library::VARIABLE
                );
                errors.push(JobError::at(value.span(), problem).help(help));
            }
        }
        errors
    }
}

impl<'t> DraftStage<'t> {
    fn new(
        mut keys: Spanned<DeTable<'t>>,
        known: &[&'static StageSpec],
        errors: &mut Vec<JobError>,
    ) -> DraftStage<'t> {
        let (type_name, type_at) = take_text(&mut keys, "type", errors);
        let (id, id_at) = take_text(&mut keys, "id", errors);
        let spec = type_name.as_deref().and_then(|name| find_in(known, name));
        match (&type_name, &type_at) {
            (_, None) => {
                errors.push(JobError::at(keys.span(), "this stage has no `type`").help(names(known)))
            }
            (Some(name), Some(at)) if spec.is_none() => errors.push(unknown_type(name, at, known)),
            _ => {}
        }
        DraftStage {
            named_at: type_at.unwrap_or(keys.span()),
            type_name: type_name.unwrap_or("stage".to_owned()),
            spec,
            // An `id` that is not text is already an error; the stage then uses its type as name.
            id_at: id_at.filter(|_| id.is_some()),
            id: id.unwrap_or_default(),
            keys,
        }
    }
}

/// Removes a text key from the stage; returns its value and position.
fn take_text(
    keys: &mut Spanned<DeTable>,
    key: &str,
    errors: &mut Vec<JobError>,
) -> (Option<String>, Option<Range<usize>>) {
    let Some(value) = keys.get_mut().remove(key) else {
        return (None, None);
    };
    let span = value.span();
    match value.into_inner() {
        DeValue::String(text) => (Some(text.into_owned()), Some(span)),
        other => {
            let problem = format!("`{key}` must be text, got {}", super::validate::kind_of(&other));
            errors.push(JobError::at(span.clone(), problem));
            (None, Some(span))
        }
    }
}

/// Names stages without an `id` after their type, numbered if several share it.
///
/// Reports duplicate names and names that `--set` cannot use.
fn name(stages: &mut [DraftStage], errors: &mut Vec<JobError>) {
    let mut of_type: BTreeMap<String, (usize, usize)> = BTreeMap::new();
    for stage in stages.iter().filter(|stage| stage.id_at.is_none()) {
        of_type.entry(stage.type_name.clone()).or_default().0 += 1;
    }
    for stage in stages.iter_mut() {
        if let (None, Some((n, number))) = (&stage.id_at, of_type.get_mut(&stage.type_name)) {
            *number += 1;
            let numbered = format!("{}-{number}", stage.type_name);
            stage.id = if *n > 1 { numbered } else { stage.type_name.clone() };
        }
    }
    let mut seen: BTreeSet<&str> = BTreeSet::new();
    for stage in stages.iter() {
        let at = stage.id_at.clone().unwrap_or(stage.named_at.clone());
        if seen.contains(stage.id.as_str()) {
            let error = JobError::at(at, format!("duplicate stage name `{}`", stage.id));
            errors.push(error.help("give one of them a different `id`"));
        } else if stage.id_at.is_some() && !usable(&stage.id) {
            let error = JobError::at(at, format!("invalid stage name `{}`", stage.id));
            errors.push(error.help("an `id` consists of letters, digits, `_` and `-`, and is not `job`"));
        }
        seen.insert(&stage.id);
    }
}

/// Returns whether `--set` can use this name.
fn usable(id: &str) -> bool {
    let plain = |character: char| character.is_ascii_alphanumeric() || matches!(character, '_' | '-');
    !id.is_empty() && id.chars().all(plain) && id != "job"
}

/// Converts a value that must be a table.
fn table<'t>(
    value: Spanned<DeValue<'t>>,
    header: &str,
    errors: &mut Vec<JobError>,
) -> Option<Spanned<DeTable<'t>>> {
    let span = value.span();
    match value.into_inner() {
        DeValue::Table(table) => Some(Spanned::new(span, table)),
        _ => {
            let name = header.trim_matches(['[', ']']);
            let error = JobError::at(span, format!("`{name}` must be a table"));
            errors.push(error.help(format!("write `{header}` above its keys")));
            None
        }
    }
}

/// Converts a value that must be a list of tables.
fn elements<'t>(value: Spanned<DeValue<'t>>, errors: &mut Vec<JobError>) -> Vec<Spanned<DeTable<'t>>> {
    let span = value.span();
    match value.into_inner() {
        DeValue::Array(items) => {
            items.into_iter().filter_map(|item| table(item, "[[stage]]", errors)).collect()
        }
        _ => {
            errors.push(not_a_list(span));
            Vec::new()
        }
    }
}

/// Errors for the first top-level keys other than `job` and `stage`.
fn unknown_keys(root: &DeTable) -> Vec<JobError> {
    let mut keys: Vec<_> = root.keys().collect();
    keys.sort_by_key(|key| key.span().start);
    keys.into_iter().take(MAX_ERRORS + 1).map(unknown).collect()
}

/// Error for a top-level key other than `job` and `stage`.
fn unknown(key: &Spanned<std::borrow::Cow<str>>) -> JobError {
    let name = key.get_ref();
    let help = if let Some((table, meant)) = table_of(name) {
        match meant == **name {
            true => format!("move `{name}` to `{table}`"),
            false => format!("write `{meant}` in `{table}`"),
        }
    } else {
        match nearest_of(name, ["job", "stage"]) {
            Some("job") => "did you mean `[job]`?".to_owned(),
            Some(_) => "did you mean `[[stage]]`?".to_owned(),
            None => "a job has one table `[job]` and one `[[stage]]` per stage".to_owned(),
        }
    };
    JobError::at(key.span(), format!("unknown top-level key `{name}`")).help(help)
}

fn unknown_type(name: &str, at: &Range<usize>, known: &[&'static StageSpec]) -> JobError {
    let error = JobError::at(at.clone(), format!("unknown stage `{name}`"));
    error.meant(name, known.iter().map(|spec| spec.name)).help(names(known))
}

/// Lists all known stages.
fn names(known: &[&'static StageSpec]) -> String {
    let names: Vec<&str> = known.iter().map(|spec| spec.name).collect();
    if names.is_empty() { "there are no stages".to_owned() } else { format!("stages: {}", names.join(", ")) }
}
