//! Columns of a row, by the letters of LAStools.

use std::fmt::Write;

use super::steps::DecimalSteps;
use crate::writers::write_las::attributes::{self, ATTRIBUTES_1_1, RAW_AMP};
use wavex_formats::las::{PointOut, quantise};
use wavex_line::scan_line::Return;

/// A point, and the other sources of its row.
pub(super) struct AsciiRow<'a> {
    pub(super) point: &'a PointOut,
    pub(super) found: &'a Return,
    pub(super) steps: &'a [DecimalSteps; 3],
    pub(super) attribute_steps: &'a [DecimalSteps; ATTRIBUTES.len()],
}

/// Attributes by number: layout 1.1 in order, then the raw amplitude.
pub(super) const ATTRIBUTES: [attributes::ReturnAttribute; 10] = {
    let [a, b, c, d, e, f, g, h, i] = ATTRIBUTES_1_1;
    [a, b, c, d, e, f, g, h, i, RAW_AMP]
};

/// The steps of the extra attributes.
pub(super) fn attribute_steps() -> [DecimalSteps; ATTRIBUTES.len()] {
    ATTRIBUTES.map(|attributes::ReturnAttribute { stored, .. }| {
        DecimalSteps::new(stored.scale.unwrap_or(1.0), stored.offset.unwrap_or(0.0))
    })
}

/// A column.
pub(super) struct AsciiColumn {
    letter: char,
    /// Name in the header line.
    pub(super) name: &'static str,
    cell: CellSource,
}

/// Source of a column's values.
enum CellSource {
    /// Time, s.
    Time,
    /// A coordinate, by axis.
    Coordinate(usize),
    /// A coordinate in steps from its offset, by axis.
    CoordinateSteps(usize),
    /// Scan angle, degrees.
    ScanAngle,
    /// A whole number.
    Whole(fn(&PointOut) -> u16),
    /// An extra attribute, by number.
    Attribute(usize),
}

use CellSource::{Attribute, Coordinate, CoordinateSteps, ScanAngle, Time, Whole};

/// All columns. Flags that waveform points never have (key point, synthetic, overlap) are 0.
static COLUMNS: [AsciiColumn; 31] = [
    column('t', "gps_time", Time),
    column('x', "x", Coordinate(0)),
    column('y', "y", Coordinate(1)),
    column('z', "z", Coordinate(2)),
    column('X', "X", CoordinateSteps(0)),
    column('Y', "Y", CoordinateSteps(1)),
    column('Z', "Z", CoordinateSteps(2)),
    column('i', "intensity", Whole(|point| point.intensity)),
    column('r', "return_number", Whole(|point| point.return_number.min(15).into())),
    column('n', "number_of_returns", Whole(|point| point.number_of_returns.min(15).into())),
    column('c', "classification", Whole(|point| point.classification.into())),
    column('u', "user_data", Whole(|point| point.user_data.into())),
    column('a', "scan_angle", ScanAngle),
    column('e', "edge_of_flight_line", Whole(|point| point.edge_of_flight_line.into())),
    column('d', "scan_direction", Whole(|point| point.scan_direction.into())),
    column('p', "point_source_id", Whole(|point| point.point_source_id)),
    column('h', "withheld", Whole(|point| point.withheld.into())),
    column('k', "key_point", Whole(|_| 0)),
    column('g', "synthetic", Whole(|_| 0)),
    column('o', "overlap", Whole(|_| 0)),
    column('l', "scanner_channel", Whole(|point| point.scanner_channel.min(3).into())),
    attribute('0', 0),
    attribute('1', 1),
    attribute('2', 2),
    attribute('3', 3),
    attribute('4', 4),
    attribute('5', 5),
    attribute('6', 6),
    attribute('7', 7),
    attribute('8', 8),
    attribute('9', 9),
];

const fn column(letter: char, name: &'static str, cell: CellSource) -> AsciiColumn {
    AsciiColumn { letter, name, cell }
}

const fn attribute(letter: char, number: usize) -> AsciiColumn {
    AsciiColumn { letter, name: ATTRIBUTES[number].stored.name, cell: Attribute(number) }
}

/// Returns the columns named by letters.
///
/// # Errors
/// No letters, or an unknown letter: names it, its position and the valid letters.
pub(super) fn columns(letters: &str) -> Result<Vec<&'static AsciiColumn>, String> {
    if letters.is_empty() {
        return Err(format!("no columns are given; {}", choices()));
    }
    let found = letters.chars().enumerate().map(|(index, letter)| {
        let unknown = || format!("`{letter}`, the {}, is not a column; {}", place(index), choices());
        COLUMNS.iter().find(|column| column.letter == letter).ok_or_else(unknown)
    });
    found.collect()
}

/// Formats a position, such as `3rd letter`.
fn place(index: usize) -> String {
    let number = index + 1;
    let ending = match (number % 10, number % 100) {
        (_, 11..=13) => "th",
        (1, _) => "st",
        (2, _) => "nd",
        (3, _) => "rd",
        _ => "th",
    };
    format!("{number}{ending} letter")
}

/// Lists the valid letters.
fn choices() -> String {
    let names: Vec<String> =
        COLUMNS.iter().map(|column| format!("{} {}", column.letter, column.name)).collect();
    format!("valid letters are {}", names.join(", "))
}

impl AsciiColumn {
    /// Appends the column's value in a row. (Writing into a string cannot fail.)
    pub(super) fn write(&self, row: &AsciiRow, text: &mut String) {
        match self.cell {
            Time => {
                let _ = write!(text, "{}", row.point.gps_time);
            }
            Coordinate(axis) => row.steps[axis].write(steps(row, axis), text),
            CoordinateSteps(axis) => {
                // Adding 0 turns -0 into 0.
                let _ = write!(text, "{}", steps(row, axis) + 0.0);
            }
            ScanAngle => {
                let _ = write!(text, "{:.3}", row.point.stored_scan_angle_deg());
            }
            Whole(of) => {
                let _ = write!(text, "{}", of(row.point));
            }
            Attribute(number) => {
                let attribute = &ATTRIBUTES[number];
                let count = quantise(attribute.value(row.found), &attribute.stored);
                row.attribute_steps[number].write(count as f64, text);
            }
        }
    }
}

fn steps(row: &AsciiRow, axis: usize) -> f64 {
    row.steps[axis].count([row.point.x, row.point.y, row.point.z][axis])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_letter_stands_once_and_every_attribute_has_its_number() {
        let mut letters: Vec<char> = COLUMNS.iter().map(|column| column.letter).collect();
        letters.sort_unstable();
        letters.dedup();
        assert_eq!(letters.len(), COLUMNS.len());
        let numbered: Vec<&str> =
            COLUMNS.iter().filter(|c| c.letter.is_ascii_digit()).map(|c| c.name).collect();
        assert_eq!(numbered, ATTRIBUTES.map(|attribute| attribute.stored.name));
    }

    #[test]
    fn what_names_no_column_is_said_with_its_place() {
        let problem = columns("txR").err().unwrap();
        assert!(
            problem.starts_with("`R`, the 3rd letter, is not a column; valid letters are t gps_time, x x"),
            "{problem}"
        );
        assert!(problem.ends_with("9 RawAmp"), "{problem}");
        assert!(columns("").err().unwrap().starts_with("no columns are given; valid letters are t"));
        let places: Vec<String> = [0, 1, 3, 10, 11, 12, 20, 21, 22, 110].map(place).to_vec();
        let endings: Vec<&str> = places.iter().map(|p| p.trim_end_matches(" letter")).collect();
        assert_eq!(endings, ["1st", "2nd", "4th", "11th", "12th", "13th", "21st", "22nd", "23rd", "111th"]);
    }
}
