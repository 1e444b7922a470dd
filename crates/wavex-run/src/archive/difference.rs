//! First difference of two files, in terms of their format.
//!
//! `then` is the expected file, `now` the actual one; messages describe `now`.

use std::io::{BufRead, BufReader, Read};
use std::path::Path;

use wavex_formats::extensions::{LAS, LAZ};
use wavex_formats::{Error, Result, regular_file};

mod points;
mod tables;

/// Maximum length of a value in a message, characters.
const LONGEST: usize = 80;

/// Describes the first difference of two versions of an output.
///
/// Messages give the value in `now` instead of that in `then`. The extension of the name determines
/// the format. If the content does not differ in its terms or cannot be read, describes the first
/// differing byte.
pub(super) fn first_difference(then: &Path, now: &Path) -> String {
    let extension = now.extension().unwrap_or_default().to_string_lossy().to_lowercase();
    let compare = || match extension.as_str() {
        LAS | LAZ => points::compare(then, now),
        "parquet" => tables::compare_parquet(then, now),
        "arrow" => tables::compare_arrow(then, now),
        "csv" | "txt" | "json" => compare_texts(then, now, extension == "csv"),
        _ => Ok(None),
    };
    // The Parquet library may panic on a manipulated file.
    match std::panic::catch_unwind(compare).unwrap_or(Ok(None)) {
        Ok(Some(difference)) => difference,
        Ok(None) => compare_bytes(then, now).unwrap_or_else(|error| error.to_string()),
        Err(error) => match compare_bytes(then, now) {
            Ok(byte) => format!("{byte} ({error})"),
            Err(error) => error.to_string(),
        },
    }
}

/// Formats a pair of different values.
fn instead(now: &str, then: &str) -> String {
    format!("{} instead of {}", short(now), short(then))
}

/// Truncates a long value.
fn short(value: &str) -> String {
    match value.char_indices().nth(LONGEST) {
        Some((end, _)) => format!("{}...", &value[..end]),
        None => value.to_owned(),
    }
}

/// Compares texts line by line; in a table with a header, also finds the column.
fn compare_texts(then: &Path, now: &Path, is_table: bool) -> Result<Option<String>> {
    let open = |path: &Path| regular_file(path).map(BufReader::new);
    let mut files = [(open(then)?, then), (open(now)?, now)];
    let mut names = String::new();
    let mut number = 1u64;
    loop {
        let [then, now] = files.each_mut().map(|(file, path)| line(file, path));
        match (then?, now?) {
            (None, None) => return Ok(None),
            (Some(_), None) => return Ok(Some(format!("it ends before line {number}"))),
            (None, Some(_)) => return Ok(Some(format!("it continues with line {number}"))),
            (Some(then), Some(now)) if then != now => {
                let cell = if is_table && number > 1 { cell(&names, &then, &now) } else { None };
                let place = format!("line {number}");
                let place_of_cell = |column: String| format!("row {}, column {column}", number - 2);
                return Ok(Some(match cell {
                    Some((column, then, now)) => {
                        format!("{}: {}", place_of_cell(column), instead(&now, &then))
                    }
                    None => format!("{place}: {}", instead(&format!("{now:?}"), &format!("{then:?}"))),
                }));
            }
            (Some(line), _) if number == 1 => names = line,
            _ => {}
        }
        number += 1;
    }
}

/// Maximum length of a line compared as a whole, bytes.
const LONGEST_LINE: u64 = 1 << 24;

/// Reads the next line without its terminator; a line that is too long is split.
fn line(file: &mut impl BufRead, path: &Path) -> Result<Option<String>> {
    let mut bytes = Vec::new();
    file.take(LONGEST_LINE).read_until(b'\n', &mut bytes).map_err(Error::io(path, "read"))?;
    let text = String::from_utf8_lossy(&bytes);
    Ok((!bytes.is_empty()).then(|| text.strip_suffix('\n').unwrap_or(&text).to_owned()))
}

/// First column in which two rows differ, with both values.
fn cell(names: &str, then: &str, now: &str) -> Option<(String, String, String)> {
    let count = |row: &str| row.split(',').count();
    if count(names) != count(then) || count(then) != count(now) {
        return None;
    }
    let mut cells = names.split(',').zip(then.split(',').zip(now.split(',')));
    let (name, (then, now)) = cells.find(|(_, (then, now))| then != now)?;
    let value = |text: &str| if text.is_empty() { "nothing".to_owned() } else { text.to_owned() };
    Some((name.to_owned(), value(then), value(now)))
}

/// Compares files byte by byte.
fn compare_bytes(then: &Path, now: &Path) -> Result<String> {
    let open = |path: &Path| regular_file(path).map(BufReader::new);
    let (mut a, mut b) = (open(then)?.bytes(), open(now)?.bytes());
    let mut at = 0u64;
    loop {
        let then_byte = a.next().transpose().map_err(Error::io(then, "read"))?;
        let now_byte = b.next().transpose().map_err(Error::io(now, "read"))?;
        match (then_byte, now_byte) {
            (None, None) => return Ok("no byte differs".to_owned()),
            (Some(_), None) => return Ok(format!("it ends before byte {at}")),
            (None, Some(_)) => return Ok(format!("it continues with byte {at}")),
            (Some(x), Some(y)) if x != y => return Ok(format!("byte {at}: {y} instead of {x}")),
            _ => at += 1,
        }
    }
}

#[cfg(test)]
mod tests;
