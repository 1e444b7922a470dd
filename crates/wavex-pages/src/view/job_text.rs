//! The job of a view with other keys, as text.

use std::collections::BTreeMap;

use super::session::Session;
use wavex_engine::job::Job;
use wavex_stages::registry::STAGES;

/// The job with these keys of `decompose`, as text.
///
/// # Errors
/// If a key or value is invalid.
pub(super) fn job(session: &Session, set: &[String]) -> Result<String, String> {
    session.with(set)?;
    let opened = &session.opened;
    let given = opened.job.overrides.iter().map(|given| given.text.clone());
    let set: Vec<String> = given.chain(set.iter().cloned()).collect();
    let text = format!("{}\n", opened.job.text.trim_end());
    if set.is_empty() {
        return Ok(text);
    }
    let (edited, left) = with_keys(&text, &set);
    // Such as a value on several lines, or a library, which no text may name.
    let is_valid = match opened.job.includes.is_empty() {
        true => Job::parse(STAGES, &opened.job.name, &edited, &[]).is_ok(),
        false => toml::from_str::<toml::Table>(&edited).is_ok(),
    };
    let (text, left) = if is_valid { (edited, left) } else { (text, set.clone()) };
    let list = |set: &[String]| -> String {
        set.iter()
            .map(|set| format!("#   {}\n", set.replacen('=', " = ", 1).replace(['\n', '\r'], " ")))
            .collect()
    };
    let mut head = format!("# Keys changed in `wavex view`:\n{}", list(&set));
    if !left.is_empty() {
        head += &format!("# Of these, not in the text below; give them with --set:\n{}", list(&left));
    }
    if opened.kind == "job" {
        let arguments: Vec<String> = set.iter().map(|set| format!("--set {}", shell_word(set))).collect();
        let name = shell_word(&opened.job.name.replace(['\n', '\r'], " "));
        head += &format!(
            "# On the command line: wavex run {name} {}\n",
            arguments.join(" ").replace(['\n', '\r'], " ")
        );
    }
    Ok(format!("{head}\n{text}"))
}

/// Text of a job with these keys in its tables, and the keys whose tables it does not have.
fn with_keys(text: &str, set: &[String]) -> (String, Vec<String>) {
    let key_of = |line: &str| line.split_once('=').map(|(key, _)| key.trim().to_owned());
    let tables: Vec<(Names, Vec<&str>)> =
        tables(text).into_iter().map(|lines| (Names::of(&lines), lines)).collect();
    let is_id = |name: &str| tables.iter().any(|(names, _)| names.id.as_deref() == Some(name));
    let mut left = set.to_vec();
    let mut edited = String::new();
    for (names, lines) in &tables {
        let is_own = |set: &String| {
            let name = set.split_once('.').map(|(name, _)| name);
            name.is_some()
                && name == if name.is_some_and(is_id) { names.id.as_deref() } else { names.kind.as_deref() }
        };
        let (own, others): (Vec<String>, Vec<String>) = left.into_iter().partition(is_own);
        left = others;
        // The last of several values holds.
        let keys: BTreeMap<&str, &str> = own
            .iter()
            .filter_map(|set| set.split_once('.').and_then(|(_, key)| key.split_once('=')))
            .map(|(key, value)| (key.trim(), value.trim()))
            .collect();
        let place = lines.iter().position(|line| key_of(line).as_deref() == Some("type")).unwrap_or(0);
        for (at, line) in lines.iter().enumerate() {
            let is_replaced = key_of(line).is_some_and(|key| keys.contains_key(key.as_str()));
            if !is_replaced {
                edited += line;
                edited.push('\n');
            }
            if at == place {
                edited.extend(keys.iter().map(|(key, value)| format!("{key} = {}\n", toml_value(value))));
            }
        }
    }
    (edited, left)
}

/// Names by which `--set` addresses a table.
#[derive(Default)]
struct Names {
    /// `job`, or the type of a stage.
    kind: Option<String>,
    id: Option<String>,
}

impl Names {
    fn of(lines: &[&str]) -> Names {
        let Ok(table) = toml::from_str::<toml::Table>(&lines.join("\n")) else { return Names::default() };
        if table.contains_key("job") {
            return Names { kind: Some("job".into()), id: None };
        }
        let stage = table.get("stage").and_then(|stages| stages.as_array()?.first());
        let text = |key: &str| stage.and_then(|stage| Some(stage.get(key)?.as_str()?.to_owned()));
        Names { kind: text("type"), id: text("id") }
    }
}

/// Lines of each table of a job, with its header.
fn tables(text: &str) -> Vec<Vec<&str>> {
    let mut tables = vec![Vec::new()];
    for line in text.lines() {
        if line.starts_with('[') {
            tables.push(Vec::new());
        }
        if let Some(table) = tables.last_mut() {
            table.push(line);
        }
    }
    tables
}

/// A value as TOML: text gets quotation marks.
fn toml_value(value: &str) -> String {
    match toml::from_str::<toml::Table>(&format!("key = {value}")) {
        Ok(_) => value.to_owned(),
        Err(_) => toml::Value::String(value.to_owned()).to_string(),
    }
}

/// A word for a shell.
fn shell_word(text: &str) -> String {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_./=,:".contains(c);
    if text.chars().all(is_plain) { text.to_owned() } else { format!("'{}'", text.replace('\'', "'\\''")) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_are_written_into_their_stage() {
        let text = "[[stage]]\ntype = \"read_las\"\nmode = 1\n\n[[stage]]\ntype = 'decompose'\n\
                    detection_sigma = 4.5\n# why\n\n[[stage]]\ntype = \"write_las\"\n";
        let set = ["decompose.detection_sigma=6".to_owned(), "decompose.mode=slow".to_owned()];
        assert_eq!(
            with_keys(text, &set).0,
            "[[stage]]\ntype = \"read_las\"\nmode = 1\n\n[[stage]]\ntype = 'decompose'\n\
             detection_sigma = 6\nmode = \"slow\"\n# why\n\n[[stage]]\ntype = \"write_las\"\n"
        );
    }

    #[test]
    fn keys_without_a_table_are_left() {
        let set = ["job.threads=2".to_owned(), "fit.mode=slow".to_owned(), "georeference.crs=utm".to_owned()];
        let text = "[job]\nname = 'a'\n[[stage]]\ntype = 'decompose' # why\nid = 'fit'\n";
        let (edited, left) = with_keys(text, &set);
        assert_eq!(
            edited,
            "[job]\nthreads = 2\nname = 'a'\n[[stage]]\ntype = 'decompose' # why\nmode = \"slow\"\nid = 'fit'\n"
        );
        assert_eq!(left, ["georeference.crs=utm"]);
    }

    #[test]
    fn words_for_a_shell_are_quoted() {
        assert_eq!(shell_word("decompose.mode=slow"), "decompose.mode=slow");
        assert_eq!(shell_word("a b'c"), "'a b'\\''c'");
    }
}
