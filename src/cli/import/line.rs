//! A classic line taken apart: from words to options with their values.

use std::path::Path;
use std::sync::Arc;

use super::options::{Opt, Takes, VERSIONS, Version};
use super::problem::{Place, Problem, Source};
use crate::registry::nearest_of;

/// An option as it was given.
#[derive(Debug)]
pub struct Given {
    /// Which.
    pub option: &'static Opt,
    /// Its value.
    pub value: Value,
    /// As it was written: `-det 6`, or `wavex.opt.txt: det=6`.
    pub written: String,
    /// Where.
    pub place: Place,
}

/// The value of an option.
#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    /// On or off.
    Switch(bool),
    /// A number.
    Number(f64),
    /// A whole number.
    Whole(u64),
    /// A word.
    Text(String),
    /// Words.
    Texts(Vec<String>),
}

/// A word, where it stands.
struct Word {
    text: String,
    place: Place,
}

/// The line as one text: words with blanks in quotation marks, behind the name of the program.
pub fn joined(words: &[String]) -> String {
    let words = words.iter().map(|word| quoted(word));
    std::iter::once("wavex".to_owned()).chain(words).collect::<Vec<_>>().join(" ")
}

/// A word as it would be typed, in quotation marks where it has blanks; control characters show as `?`.
fn quoted(word: &str) -> String {
    let word = word.replace(char::is_control, "?");
    if word.is_empty() || word.contains(' ') { format!("\"{word}\"") } else { word }
}

/// The words without the program's name, which one may have copied along.
pub fn without_program(words: &[String]) -> &[String] {
    match words.split_first() {
        Some((first, rest)) if !first.starts_with('-') => {
            // Windows' separator is none on other systems.
            let name = first.rsplit(['/', '\\']).next().unwrap_or_default().to_lowercase();
            if matches!(name.as_str(), "wavex" | "wavex.exe") { rest } else { words }
        }
        _ => words,
    }
}

/// The options of the command line, and everything that is wrong with it.
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
        rest = behind.get(used..).unwrap_or_default();
    }
    (given, problems)
}

/// The words with their places in the line.
fn placed(words: &[String]) -> Vec<Word> {
    let source = Arc::new(Source { name: None, text: joined(words) });
    let mut start = "wavex ".len();
    let word = |word: &String| {
        let range = start..start + quoted(word).len();
        start = range.end + 1;
        Word { text: word.clone(), place: Place { source: Arc::clone(&source), range } }
    };
    words.iter().map(word).collect()
}

/// One option, and how many of the words behind it belong to it.
fn read_option(version: &Version, word: &Word, behind: &[Word]) -> (Result<Given, Problem>, usize) {
    let Some(body) = word.text.strip_prefix('-').filter(|body| !body.is_empty()) else {
        let problem = Problem::at(&word.place, format!("`{}` belongs to no option", word.text));
        return (Err(problem.help("put `-i` before an input, and text with blanks in quotation marks")), 0);
    };
    let (option, attached) = match find(version, body, &word.place) {
        Ok(found) => found,
        // What follows is most likely its argument.
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

/// How many of the words behind an option are its argument.
fn arguments(takes: Takes, behind: &[Word]) -> usize {
    let Some(next) = behind.first() else { return 0 };
    match takes {
        Takes::Switch => usize::from(matches!(next.text.as_str(), "0" | "1")),
        Takes::Number | Takes::Whole(..) => usize::from(!is_option(next) || next.text.parse::<f64>().is_ok()),
        Takes::Text(_) | Takes::Date => usize::from(!is_option(next)),
        Takes::Texts(_) => behind.iter().take_while(|word| !is_option(word)).count(),
    }
}

/// Whether a word looks like an option; `-` alone is standard input.
fn is_option(word: &Word) -> bool {
    word.text.len() > 1 && word.text.starts_with('-')
}

/// The option that a word without its dash names, and the argument in the same word: `det`, `det=6`, `d6`, `o*_abc`.
fn find(version: &Version, body: &str, place: &Place) -> Result<(&'static Opt, Option<String>), Problem> {
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
            let problem = format!("`-{body}` may mean `-{name}` or `-{other}`");
            Err(Problem::at(place, problem).help("write a blank between the option and its argument"))
        }
        [(_, option, value), ..] => Ok((option, Some((*value).to_owned()))),
    }
}

/// The options that a word may begin with, with the argument that then follows in it; the longest name first. Arguments that
/// are text count only behind the short name, and only where they have a character that no option has.
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
    // A number behind a longer name is no file behind a shorter one.
    let numbers: Vec<_> = found.iter().filter(|(_, option, _)| !is_text(option.takes)).copied().collect();
    if numbers.is_empty() { found } else { numbers }
}

fn is_text(takes: Takes) -> bool {
    matches!(takes, Takes::Text(_) | Takes::Texts(_))
}

/// So many options that begin alike are named.
const MOST_ALIKE: usize = 5;

/// A name that the version does not have, with the one that was meant.
fn unknown(version: &Version, name: &str, place: &Place) -> Problem {
    let problem = Problem::at(place, format!("version {} has no option `-{name}`", version.name));
    if let Some(other) = VERSIONS.iter().find(|other| other.option(name).is_some()) {
        return problem.help(format!("version {0} has one: `--classic {0}`", other.name));
    }
    // Any letter is one slip away from any other.
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
            problem.help(format!("if you mean `-{} {rest}`, write it with the blank", option.name()))
        }
        None => problem.help(format!("{}docs/import.md lists them all", alike(version, name))),
    }
}

/// The options that begin with the same letter, in words that go before others; empty where there is none.
fn alike(version: &Version, name: &str) -> String {
    let Some(first) = name.chars().next() else { return String::new() };
    let begins =
        |option: &&str| option.chars().next().is_some_and(|letter| letter.eq_ignore_ascii_case(&first));
    let names: Vec<String> =
        version.names().filter(begins).take(MOST_ALIKE).map(|name| format!("`-{name}`")).collect();
    if names.is_empty() { String::new() } else { format!("some begin alike: {}; ", names.join(", ")) }
}

/// The value that words give an option.
fn value(option: &'static Opt, written: &str, texts: &[String], place: &Place) -> Result<Value, Problem> {
    let wrong = |text: &str| {
        let name = written.split_once('=').map_or(written, |(name, _)| name);
        let expected = option.takes.words();
        Problem::at(place, format!("`{name}` takes {expected}; this is `{text}`"))
    };
    let first = texts.first().filter(|text| !text.is_empty());
    let Some(text) = first else {
        if option.takes == Takes::Switch && texts.is_empty() {
            return Ok(Value::Switch(true));
        }
        let expected = option.takes.words();
        return Err(Problem::at(place, format!("behind `{written}` its argument is missing: {expected}")));
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

/// Whether a text looks like `2018-11-14`.
fn is_day(text: &str) -> bool {
    let parts: Vec<&str> = text.split('-').collect();
    let digits = |part: &&str| part.bytes().all(|byte| byte.is_ascii_digit());
    parts.iter().map(|part| part.len()).eq([4, 2, 2]) && parts.iter().all(digits)
}

/// The options of a file of persistent options, one `name=argument` per line; lines that begin with `#` are passed over.
pub fn read_file(version: &Version, path: &Path, text: &str) -> (Vec<Given>, Vec<Problem>) {
    let (mut given, mut problems) = (Vec::new(), Vec::new());
    for (number, line) in (1..).zip(text.trim_start_matches('\u{feff}').lines()) {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let source = Source { name: Some(format!("{}:{number}", path.display())), text: quoted_line(line) };
        let place = Place { range: 0..source.text.len(), source: Arc::new(source) };
        match read_file_line(version, line, &place) {
            Ok(mut option) => {
                option.written = format!("{}: {}", path.display(), option.written);
                given.push(option);
            }
            Err(problem) => problems.push(problem),
        }
    }
    (given, problems)
}

fn quoted_line(line: &str) -> String {
    line.replace(char::is_control, "?")
}

fn read_file_line(version: &Version, line: &str, place: &Place) -> Result<Given, Problem> {
    let Some((name, argument)) = line.split_once('=') else {
        let problem = Problem::at(place, format!("`{line}` is not `name=argument`"));
        return Err(problem.help("a file of options has one per line, as in `det=5`"));
    };
    let (name, argument) = (name.trim(), argument.trim());
    let option = version.option(name).ok_or_else(|| unknown(version, name, place))?;
    let argument = argument.strip_prefix('"').and_then(|text| text.strip_suffix('"')).unwrap_or(argument);
    let value = value(option, name, &[argument.to_owned()], place)?;
    Ok(Given { option, value, written: quoted_line(line), place: place.clone() })
}
