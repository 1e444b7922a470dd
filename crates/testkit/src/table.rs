//! Text tables with a header line.

use std::collections::BTreeMap;

/// Cells of a row by column name.
pub type Row = BTreeMap<String, String>;

/// Rows of a comma-separated table.
pub fn rows(text: &str) -> Vec<Row> {
    let mut lines = text.lines().map(|line| line.split(',').map(str::to_owned));
    let names: Vec<String> = lines.next().unwrap().collect();
    lines.map(|cells| names.iter().cloned().zip(cells).collect()).collect()
}

/// A number of a row.
#[track_caller]
pub fn number(row: &Row, column: &str) -> f64 {
    row[column].parse().unwrap()
}
