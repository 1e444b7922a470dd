//! Parses a classic command line into options with values.

use std::path::Path;
use std::sync::Arc;

use super::options::{Opt, Takes, Version};
use super::problem::{MOST_SHOWN, OptionPlace, OptionText, Problem};
use super::versions::VERSIONS;
use wavex_line::stage::nearest_of;

/// A parsed option.
#[derive(Debug)]
pub struct Given {
    /// Definition of the option.
    pub option: &'static Opt,
    /// Value of the option.
    pub value: Value,
    /// Text as written: `-det 6`, or `wavex.opt.txt: det=6`.
    pub written: String,
    /// Position in its source.
    pub place: OptionPlace,
}

/// Value of an option.
#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    /// On or off.
    Switch(bool),
    /// A number.
    Number(f64),
    /// A whole number.
    Whole(u64),
    /// A single word.
    Text(String),
    /// A list of words.
    Texts(Vec<String>),
}

/// A word with its position.
struct Word {
    text: String,
    place: OptionPlace,
}

/// Joins the words into one command line that starts with `wavex`; quotes words with blanks.
pub fn joined(words: &[String]) -> String {
    let words = words.iter().map(|word| quoted(word));
    std::iter::once("wavex".to_owned()).chain(words).collect::<Vec<_>>().join(" ")
}

/// Quotes a word if it contains blanks; control characters become `?`.
fn quoted(word: &str) -> String {
    let word = word.replace(char::is_control, "?");
    if word.is_empty() || word.contains(' ') { format!("\"{word}\"") } else { word }
}

/// Removes a leading program name, which the user may have copied.
pub fn without_program(words: &[String]) -> &[String] {
    match words.split_first() {
        Some((first, rest)) if !first.starts_with('-') => {
            // Other systems do not treat Windows' separator as one.
            let name = first.rsplit(['/', '\\']).next().unwrap_or_default().to_lowercase();
            if matches!(name.as_str(), "wavex" | "wavex.exe") { rest } else { words }
        }
        _ => words,
    }
}

/// Parses the options of a command line; also returns all errors.
pub fn read_line(version: &Version, words: &[String]) -> (Vec<Given>, Vec<Problem>) {
    let words = placed(words);
    let (mut given, mut problems) = (Vec::new(), Vec::new());
    let mut rest = words.as_slice();
    while let Some((word, behind)) = rest.split_first() {
        let (read, used) = read_option(version, word, behind);
        match read {
            Ok(option) => given.push(option),
            Err(problem) => problems.push(problem),
        }
        // Each further error is most likely a consequence of the errors so far.
        if problems.len() > MOST_SHOWN {
            break;
        }
        rest = behind.get(used..).unwrap_or_default();
    }
    (given, problems)
}

/// The words with their positions in the line.
fn placed(words: &[String]) -> Vec<Word> {
    let source = Arc::new(OptionText { name: None, text: joined(words) });
    let mut start = "wavex ".len();
    let word = |word: &String| {
        let range = start..start + quoted(word).len();
        start = range.end + 1;
        Word { text: word.clone(), place: OptionPlace { source: Arc::clone(&source), range } }
    };
    words.iter().map(word).collect()
}

/// Parses one option; also returns the number of following words it consumed.
fn read_option(version: &Version, word: &Word, behind: &[Word]) -> (Result<Given, Problem>, usize) {
    let Some(body) = word.text.strip_prefix('-').filter(|body| !body.is_empty()) else {
        let problem = Problem::at(&word.place, format!("`{}` does not belong to an option", word.text));
        return (Err(problem.help("put `-i` before an input, and quote text that contains blanks")), 0);
    };
    let (option, attached) = match find(version, body, &word.place) {
        Ok(found) => found,
        // The words that follow are most likely its argument.
        Err(problem) => return (Err(problem), behind.iter().take_while(|next| !is_option(next)).count()),
    };
    let used = if attached.is_some() { 0 } else { arguments(option.takes, behind) };
    let taken = behind.get(..used).unwrap_or_default();
    let texts: Vec<String> =
        attached.map_or_else(|| taken.iter().map(|word| word.text.clone()).collect(), |text| vec![text]);
    let place = taken.first().map_or(&word.place, |word| &word.place);
    let given = value(option, &word.text, &texts, place).map(|value| {
        let words = std::iter::once(word).chain(taken).map(|word| quoted(&word.text));
        let written = words.collect::<Vec<_>>().join(" ");
        Given { option, value, written, place: word.place.clone() }
    });
    (given, used)
}

/// Number of following words that are the argument of an option.
fn arguments(takes: Takes, behind: &[Word]) -> usize {
    let Some(next) = behind.first() else { return 0 };
    match takes {
        Takes::Switch => usize::from(matches!(next.text.as_str(), "0" | "1")),
        Takes::Number | Takes::Whole(..) => usize::from(!is_option(next) || next.text.parse::<f64>().is_ok()),
        Takes::Text(_) | Takes::Date => usize::from(!is_option(next)),
        Takes::Texts(_) => behind.iter().take_while(|word| !is_option(word)).count(),
    }
}

/// Returns whether a word looks like an option; a single `-` is standard input.
fn is_option(word: &Word) -> bool {
    word.text.len() > 1 && word.text.starts_with('-')
}

/// Finds the option that a word names, with an argument attached to it.
///
/// `body` is the word without its dash: `det`, `det=6`, `d6`, `o*_abc`.
fn find(
    version: &Version,
    body: &str,
    place: &OptionPlace,
) -> Result<(&'static Opt, Option<String>), Problem> {
    if let Some(option) = version.option(body) {
        return Ok((option, None));
    }
    let name = body.split_once('=').map_or(body, |(name, _)| name);
    if let Some((option, (_, value))) = version.option(name).zip(body.split_once('=')) {
        return Ok((option, Some(value.to_owned())));
    }
    match attached(version, body).as_slice() {
        [] => Err(unknown(version, name, place)),
        // `-awc10` is 10 for `-awc`, or 0 for `-awc1`.
        [(name, option, _), (other, ..), ..] if !is_text(option.takes) => {
            let problem = format!("`-{body}` is ambiguous: `-{name}` or `-{other}`");
            Err(Problem::at(place, problem).help("write a blank between the option and its argument"))
        }
        [(_, option, value), ..] => Ok((option, Some((*value).to_owned()))),
    }
}

/// Options with an attached argument that match a word, longest name first.
///
/// A text argument counts only after the short name, and only if it contains a character that no
/// option name has.
fn attached<'b>(version: &Version, body: &'b str) -> Vec<(&'static str, &'static Opt, &'b str)> {
    let mut found = Vec::new();
    for option in version.options {
        for name in option.names {
            let Some(rest) = body.strip_prefix(name) else { continue };
            let fits = match option.takes {
                Takes::Switch => matches!(rest, "0" | "1"),
                Takes::Number | Takes::Whole(..) => rest.parse::<f64>().is_ok_and(f64::is_finite),
                Takes::Date => rest.starts_with(|first: char| first.is_ascii_digit()),
                Takes::Text(_) | Takes::Texts(_) => {
                    let is_short = *name == option.name();
                    let stands_apart = name.starts_with(|first: char| first.is_ascii_uppercase());
                    is_short && (stands_apart || rest.contains(['*', '.', '/', '\\', ':']))
                }
            };
            if fits {
                found.push((*name, option, rest));
            }
        }
    }
    found.sort_by_key(|(name, ..)| std::cmp::Reverse(name.len()));
    // A number after a longer name takes precedence over a file after a shorter one.
    let numbers: Vec<_> = found.iter().filter(|(_, option, _)| !is_text(option.takes)).copied().collect();
    if numbers.is_empty() { found } else { numbers }
}

fn is_text(takes: Takes) -> bool {
    matches!(takes, Takes::Text(_) | Takes::Texts(_))
}

/// Maximum number of similar options listed.
const MOST_ALIKE: usize = 5;

/// Error for an unknown option, with the most likely intended one.
fn unknown(version: &Version, name: &str, place: &OptionPlace) -> Problem {
    let problem = Problem::at(place, format!("version {} has no option `-{name}`", version.name));
    if let Some(other) = VERSIONS.iter().find(|other| other.option(name).is_some()) {
        return problem.help(format!("version {0} has this option; use `--classic {0}`", other.name));
    }
    // Suggesting a one-letter option is useless: any other letter is one edit away.
    let nearest = || nearest_of(name, version.names()).filter(|_| name.chars().count() > 2);
    let same_letters = version.names().find(|other| other.eq_ignore_ascii_case(name));
    if let Some(meant) = same_letters.or_else(nearest) {
        return problem.help(format!("did you mean `-{meant}`?"));
    }
    let short =
        version.options.iter().filter(|option| is_text(option.takes) && name.starts_with(option.name()));
    match short.max_by_key(|option| option.name().len()) {
        Some(option) => {
            let rest = name.get(option.name().len()..).unwrap_or_default();
            problem.help(format!("if you mean `-{} {rest}`, write the blank", option.name()))
        }
        None => problem.help(format!("{}docs/import.md lists all options", alike(version, name))),
    }
}

/// Lists options with the same first letter, as a prefix of a help text; empty if there are none.
fn alike(version: &Version, name: &str) -> String {
    let Some(first) = name.chars().next() else { return String::new() };
    let begins =
        |option: &&str| option.chars().next().is_some_and(|letter| letter.eq_ignore_ascii_case(&first));
    let names: Vec<String> =
        version.names().filter(begins).take(MOST_ALIKE).map(|name| format!("`-{name}`")).collect();
    if names.is_empty() { String::new() } else { format!("similar options: {}; ", names.join(", ")) }
}

/// Converts the argument of an option to its value.
fn value(
    option: &'static Opt,
    written: &str,
    texts: &[String],
    place: &OptionPlace,
) -> Result<Value, Problem> {
    let wrong = |text: &str| {
        let name = written.split_once('=').map_or(written, |(name, _)| name);
        let expected = option.takes.words();
        Problem::at(place, format!("`{name}` expects {expected}, got `{text}`"))
    };
    let first = texts.first().filter(|text| !text.is_empty());
    let Some(text) = first else {
        if option.takes == Takes::Switch && texts.is_empty() {
            return Ok(Value::Switch(true));
        }
        let expected = option.takes.words();
        return Err(Problem::at(place, format!("`{written}` lacks its argument: {expected}")));
    };
    match option.takes {
        Takes::Switch => match text.as_str() {
            "0" => Ok(Value::Switch(false)),
            "1" => Ok(Value::Switch(true)),
            _ => Err(wrong(text)),
        },
        Takes::Number => {
            let number = text.parse().ok().filter(|number: &f64| number.is_finite());
            number.map(Value::Number).ok_or_else(|| wrong(text))
        }
        Takes::Whole(least, most) => {
            let number = text.parse().ok().filter(|number| (least..=most).contains(number));
            number.map(Value::Whole).ok_or_else(|| wrong(text))
        }
        Takes::Date if text != "0" && !is_day(text) => Err(wrong(text)),
        Takes::Date | Takes::Text(_) => Ok(Value::Text(text.clone())),
        Takes::Texts(_) => Ok(Value::Texts(texts.to_vec())),
    }
}

/// Returns whether a text has the form `2018-11-14`.
fn is_day(text: &str) -> bool {
    let parts: Vec<&str> = text.split('-').collect();
    let digits = |part: &&str| part.bytes().all(|byte| byte.is_ascii_digit());
    parts.iter().map(|part| part.len()).eq([4, 2, 2]) && parts.iter().all(digits)
}

/// Parses a file of persistent options.
///
/// One `name=argument` per line; lines that start with `#` are comments.
pub fn read_file(version: &Version, path: &Path, text: &str) -> (Vec<Given>, Vec<Problem>) {
    let (mut given, mut problems) = (Vec::new(), Vec::new());
    for (number, line) in (1..).zip(text.trim_start_matches('\u{feff}').lines()) {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let source =
            OptionText { name: Some(format!("{}:{number}", path.display())), text: quoted_line(line) };
        let place = OptionPlace { range: 0..source.text.len(), source: Arc::new(source) };
        match read_file_line(version, line, &place) {
            Ok(mut option) => {
                option.written = format!("{}: {}", path.display(), option.written);
                given.push(option);
            }
            Err(problem) => problems.push(problem),
        }
        if problems.len() > MOST_SHOWN {
            break;
        }
    }
    (given, problems)
}

fn quoted_line(line: &str) -> String {
    line.replace(char::is_control, "?")
}

fn read_file_line(version: &Version, line: &str, place: &OptionPlace) -> Result<Given, Problem> {
    let Some((name, argument)) = line.split_once('=') else {
        let problem = Problem::at(place, format!("`{line}` is not `name=argument`"));
        return Err(problem.help("an options file has one option per line, such as `det=5`"));
    };
    let (name, argument) = (name.trim(), argument.trim());
    let option = version.option(name).ok_or_else(|| unknown(version, name, place))?;
    let argument = argument.strip_prefix('"').and_then(|text| text.strip_suffix('"')).unwrap_or(argument);
    let value = value(option, name, &[argument.to_owned()], place)?;
    Ok(Given { option, value, written: quoted_line(line), place: place.clone() })
}
