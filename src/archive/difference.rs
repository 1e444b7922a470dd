//! Where two files differ first, in their own terms.
//!
//! One is what should be (`then`), the other what is (`now`): it is the second that is described.

use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;

use crate::formats::{Error, Result};

mod points;
mod tables;

/// The longest value that is told, characters.
const LONGEST: usize = 80;

/// Where the file `now` differs first from what it should be, `then`: both are the same output, and what is told is the value in
/// `now` instead of that in `then`. The format is told by the name; where the content does not differ in its terms, or cannot be
/// read, it is the byte that is told.
pub(super) fn first_difference(then: &Path, now: &Path) -> String {
    let extension = now.extension().unwrap_or_default().to_string_lossy().to_lowercase();
    let compare = || match extension.as_str() {
        "las" | "laz" => points::compare(then, now),
        "parquet" => tables::compare_parquet(then, now),
        "arrow" => tables::compare_arrow(then, now),
        "csv" | "txt" | "json" => compare_texts(then, now, extension == "csv"),
        _ => Ok(None),
    };
    // Parquet's own reader may panic on a file that was tampered with.
    match std::panic::catch_unwind(compare).unwrap_or(Ok(None)) {
        Ok(Some(difference)) => difference,
        Ok(None) => compare_bytes(then, now).unwrap_or_else(|error| error.to_string()),
        Err(error) => match compare_bytes(then, now) {
            Ok(byte) => format!("{byte} ({error})"),
            Err(error) => error.to_string(),
        },
    }
}

/// A value that is another one.
fn instead(now: &str, then: &str) -> String {
    format!("{} instead of {}", short(now), short(then))
}

/// A value, cut off where it is long.
fn short(value: &str) -> String {
    match value.char_indices().nth(LONGEST) {
        Some((end, _)) => format!("{}...", &value[..end]),
        None => value.to_owned(),
    }
}

/// The first line that differs; in a table with a line of names, the column too.
fn compare_texts(then: &Path, now: &Path, is_table: bool) -> Result<Option<String>> {
    let open = |path: &Path| File::open(path).map(BufReader::new).map_err(Error::io(path, "open"));
    let mut files = [(open(then)?, then), (open(now)?, now)];
    let mut names = String::new();
    let mut number = 1u64;
    loop {
        let [then, now] = files.each_mut().map(|(file, path)| line(file, path));
        match (then?, now?) {
            (None, None) => return Ok(None),
            (Some(_), None) => return Ok(Some(format!("it ends before line {number}"))),
            (None, Some(_)) => return Ok(Some(format!("it goes on with line {number}"))),
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

/// The longest line that is compared as a whole, bytes.
const LONGEST_LINE: u64 = 1 << 24;

/// The next line without its end; one that is too long comes in pieces.
fn line(file: &mut impl BufRead, path: &Path) -> Result<Option<String>> {
    let mut bytes = Vec::new();
    file.take(LONGEST_LINE).read_until(b'\n', &mut bytes).map_err(Error::io(path, "read"))?;
    let text = String::from_utf8_lossy(&bytes);
    Ok((!bytes.is_empty()).then(|| text.strip_suffix('\n').unwrap_or(&text).to_owned()))
}

/// The first column in which two rows differ, with both values.
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

/// The first byte that differs.
fn compare_bytes(then: &Path, now: &Path) -> Result<String> {
    let open = |path: &Path| File::open(path).map(BufReader::new).map_err(Error::io(path, "open"));
    let (mut a, mut b) = (open(then)?.bytes(), open(now)?.bytes());
    let mut at = 0u64;
    loop {
        let then_byte = a.next().transpose().map_err(Error::io(then, "read"))?;
        let now_byte = b.next().transpose().map_err(Error::io(now, "read"))?;
        match (then_byte, now_byte) {
            (None, None) => return Ok("no byte differs".to_owned()),
            (Some(_), None) => return Ok(format!("it ends before byte {at}")),
            (None, Some(_)) => return Ok(format!("it goes on with byte {at}")),
            (Some(x), Some(y)) if x != y => return Ok(format!("byte {at}: {y} instead of {x}")),
            _ => at += 1,
        }
    }
}

#[cfg(test)]
mod tests;
