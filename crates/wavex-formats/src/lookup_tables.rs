//! Lookup tables of the low- and high-power receivers.
//!
//! Files are text columns or JSON. Tables are indexed by digitiser steps. Columns are separated by
//! commas, semicolons or blanks: digitiser steps, value of the low-power receiver, and optionally
//! value of the high-power receiver. A first line of names and lines that begin with `#` are
//! skipped.
//!
//! JSON has an object `{"low": [[steps, value], ...], "high": [...]}`, of which one part may be
//! missing. A pair may have a third number, the weight of the value in a fit.

use std::path::Path;

use serde::Deserialize;

use super::{Error, Result, read_small_text};

/// Largest accepted file, bytes.
///
/// Real tables have a few hundred rows.
const MAX_BYTES: u64 = 1 << 24;
const REMEDY: &str = "give columns of digitiser steps and values, or JSON with \"low\" and \"high\"";

/// One row of a table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LookupRow {
    /// Background plus amplitude of a peak, digitiser steps.
    pub steps_dn: f64,
    /// Value of the table, in its own unit.
    pub value: f64,
    /// Weight of the value in a fit, above 0.
    pub weight: f64,
}

/// Lookup tables of a file.
///
/// A receiver without a table has no rows.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LookupTables {
    /// Table of the low-power receiver.
    pub low: Vec<LookupRow>,
    /// Table of the high-power receiver.
    pub high: Vec<LookupRow>,
}

/// JSON form of the tables.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Json {
    #[serde(default)]
    low: Vec<Vec<f64>>,
    #[serde(default)]
    high: Vec<Vec<f64>>,
}

impl LookupTables {
    /// Reads a table file.
    ///
    /// # Errors
    /// The file cannot be read, is larger than 16 MiB, or is not a valid table.
    pub fn open(path: &Path) -> Result<LookupTables> {
        let text = read_small_text(path, MAX_BYTES, "a table", REMEDY)?;
        let tables =
            if text.trim_start().starts_with('{') { of_json(path, &text) } else { of_columns(path, &text) }?;
        for rows in [&tables.low, &tables.high] {
            if rows.len() == 1 {
                return Err(Error::unusable(path, "a table needs at least two rows", REMEDY));
            }
        }
        match tables.low.is_empty() && tables.high.is_empty() {
            true => Err(Error::unusable(path, "it has no row of numbers", REMEDY)),
            false => Ok(tables),
        }
    }
}

fn of_json(path: &Path, text: &str) -> Result<LookupTables> {
    let json: Json = serde_json::from_str(text)
        .map_err(|error| Error::unusable(path, format!("invalid tables: {error}"), REMEDY))?;
    let rows = |name: &str, pairs: Vec<Vec<f64>>| {
        let row = |pair: Vec<f64>| match pair[..] {
            [steps_dn, value] => Ok(LookupRow { steps_dn, value, weight: 1.0 }),
            [steps_dn, value, weight] if weight > 0.0 => Ok(LookupRow { steps_dn, value, weight }),
            [_, _, weight] => {
                Err(Error::unusable(path, format!("{name}: invalid weight {weight}"), "give one above 0"))
            }
            _ => Err(Error::unusable(
                path,
                format!("{name}: expected 2 or 3 numbers per row, found {}", pair.len()),
                REMEDY,
            )),
        };
        pairs.into_iter().map(row).collect::<Result<Vec<LookupRow>>>()
    };
    Ok(LookupTables { low: rows("low", json.low)?, high: rows("high", json.high)? })
}

fn of_columns(path: &Path, text: &str) -> Result<LookupTables> {
    let mut tables = LookupTables::default();
    let mut offset = 0;
    let mut is_first = true;
    for line in text.split_inclusive('\n') {
        let at = offset;
        offset += line.len() as u64;
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let may_be_names = std::mem::take(&mut is_first);
        let cells =
            line.split(|c: char| matches!(c, ',' | ';') || c.is_whitespace()).filter(|cell| !cell.is_empty());
        let finite = |cell: &str| cell.parse().ok().filter(|number: &f64| number.is_finite());
        let numbers: Option<Vec<f64>> = cells.map(finite).collect();
        let row = |steps_dn, value| LookupRow { steps_dn, value, weight: 1.0 };
        match numbers.as_deref() {
            Some(&[steps_dn, low]) => tables.low.push(row(steps_dn, low)),
            Some(&[steps_dn, low, high]) => {
                tables.low.push(row(steps_dn, low));
                tables.high.push(row(steps_dn, high));
            }
            Some(other) => {
                let problem = format!("expected 2 or 3 numbers, found {}", other.len());
                return Err(Error::malformed(path, at, "row", problem, REMEDY));
            }
            None if may_be_names => {}
            None => {
                let problem = "not all of its columns are finite numbers";
                return Err(Error::malformed(path, at, "row", problem, REMEDY));
            }
        }
    }
    Ok(tables)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> std::result::Result<LookupTables, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("table.txt");
        std::fs::write(&path, text).unwrap();
        let without_folder =
            |error: Error| error.to_string().replace(&format!("{}", path.display()), "table.txt");
        LookupTables::open(&path).map_err(without_folder)
    }

    fn row(steps_dn: f64, value: f64) -> LookupRow {
        LookupRow { steps_dn, value, weight: 1.0 }
    }

    #[test]
    fn columns_are_read_with_and_without_names() {
        let both = LookupTables {
            low: vec![row(0.0, -2e37), row(9.0, 0.0)],
            high: vec![row(0.0, 1.5), row(9.0, 2.5)],
        };
        assert_eq!(read("sample,low,high\n0,-2e+37,1.5\r\n9, 0, 2.5\n"), Ok(both.clone()));
        assert_eq!(read("# made by hand\n\n0 -2e37 1.5\n9;0;2.5"), Ok(both.clone()));
        assert_eq!(read("0\t-2e37\n9\t0"), Ok(LookupTables { high: Vec::new(), ..both }));
    }

    #[test]
    fn json_is_read_with_weights() {
        let weighted = LookupRow { weight: 0.5, ..row(2.0, 3.0) };
        let tables = LookupTables { low: Vec::new(), high: vec![row(1.0, 2.0), weighted] };
        assert_eq!(read(r#"{"high": [[1, 2], [2, 3, 0.5]]}"#), Ok(tables));
    }

    #[test]
    fn what_is_no_table_says_why() {
        let remedy = "; give columns of digitiser steps and values, or JSON with \"low\" and \"high\"";
        let cases = [
            ("", format!("table.txt: it has no row of numbers{remedy}")),
            ("1 2", format!("table.txt: a table needs at least two rows{remedy}")),
            ("1 2\n3", format!("table.txt: byte 4: row: expected 2 or 3 numbers, found 1{remedy}")),
            (
                "1 2\na b",
                format!("table.txt: byte 4: row: not all of its columns are finite numbers{remedy}"),
            ),
            (
                "1 2\n3 1e999",
                format!("table.txt: byte 4: row: not all of its columns are finite numbers{remedy}"),
            ),
            (
                r#"{"low": [[1]]}"#,
                format!("table.txt: low: expected 2 or 3 numbers per row, found 1{remedy}"),
            ),
            (r#"{"low": [[1, 2, 0]]}"#, "table.txt: low: invalid weight 0; give one above 0".to_owned()),
        ];
        for (text, expected) in cases {
            assert_eq!(read(text), Err(expected), "{text:?}");
        }
        let error = read(r#"{"mid": []}"#).unwrap_err();
        assert!(error.starts_with("table.txt: invalid tables: unknown field `mid`"), "{error}");
    }

    #[test]
    fn a_file_too_large_is_not_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("table.txt");
        std::fs::File::create(&path).unwrap().set_len(MAX_BYTES + 1).unwrap();
        let error = LookupTables::open(&path).unwrap_err().to_string();
        assert!(error.contains("16777217 bytes is too large for a table"), "{error}");
    }
}
