//! Text trajectories with one record per line.
//!
//! Columns are separated by blanks, tabs, commas or semicolons. Lines before the first record are
//! the header. Empty lines and lines that begin with `#` or `%` are skipped. Longitude and latitude
//! are in degrees, heights in metres.

use std::path::Path;

use super::super::{Error, Result};
use super::axis::Stated;
use super::input::InputFile;
use super::{Angles, Options, Raw, Records, check, sample_of_degrees};
use wavex_geodesy::frames::Attitude;
use wavex_geodesy::trajectory::Sample;

/// Name of the format.
pub(super) const FORMAT: &str = "text";
/// Longest accepted line, bytes.
const LONGEST_LINE: u64 = 1 << 16;
/// Column letters and their quantities.
const LETTERS: [(char, &str); 7] = [
    ('t', "time"),
    ('x', "longitude"),
    ('y', "latitude"),
    ('z', "height"),
    ('w', "roll"),
    ('p', "pitch"),
    ('k', "heading"),
];
/// Index of the only optional column.
const ROLL: usize = 4;
const REMEDY: &str = "check `trajectory_columns`";

/// Returns whether a file with these first bytes is text.
pub(super) fn is_text(head: &[u8]) -> bool {
    let is_control = |byte: &&u8| **byte < 0x20 && !b"\t\r\n\x0c\x1a".contains(byte) || **byte == 0x7f;
    let foreign = head.iter().filter(|byte| **byte >= 0x80).count();
    !head.is_empty() && !head.iter().any(|byte| is_control(&byte)) && foreign * 4 <= head.len()
}

/// Reads all records.
pub(super) fn read(input: &mut InputFile, options: &Options) -> Result<Raw> {
    let path = input.path.clone();
    let Some(letters) = &options.columns else {
        let first = input.line(LONGEST_LINE)?.unwrap_or_default();
        let first: String = first.chars().take(80).collect();
        let problem = format!("it is text, but its columns are not defined; it begins with `{first}`");
        let remedy = "name them, such as `txyzwpk`, by `trajectory_columns` in a job or `--columns` of `wavex \
                      trajectory`: time, longitude, latitude, height, roll, pitch, heading; any other letter skips a \
                      column";
        return Err(Error::unusable(&path, problem, remedy));
    };
    let columns = ColumnIndices::new(letters).map_err(|problem| {
        Error::unusable(
            &path,
            problem,
            "use t for time, x for longitude, y for latitude, z for height, w for roll, p for \
             pitch and k for heading",
        )
    })?;
    let is_radians = options.angles == Some(Angles::Radians);
    let (mut samples, mut number, mut header, mut unreadable) = (Vec::new(), 0u64, None, 0u64);
    loop {
        let offset = input.offset;
        let Some(line) = input.line(LONGEST_LINE)? else { break };
        number += 1;
        let line = line.trim_start_matches('\u{feff}');
        if line.is_empty() || line.starts_with(['#', '%']) {
            continue;
        }
        match columns.row(line) {
            Ok(row) => samples.push(sample(&path, offset, number, row, is_radians)?),
            Err(problem) if samples.is_empty() => {
                unreadable += u64::from(starts_with_number(line));
                header = Some(problem);
            }
            Err(problem) => {
                return Err(Error::malformed(&path, offset, format!("line {number}"), problem, REMEDY));
            }
        }
    }
    if let (true, Some(problem)) = (samples.is_empty(), &header) {
        let problem = format!(
            "none of its {number} lines has numbers in all columns of `{letters}`: in the last, {problem}"
        );
        return Err(Error::unusable(&path, problem, REMEDY));
    }
    let mut notes = notes(&samples, is_radians);
    if let (1.., Some(problem)) = (unreadable, &header) {
        notes.push(format!(
            "{unreadable} lines before the first record begin with a number, but are no records: in the last, \
             {problem}; the trajectory begins after them"
        ));
    }
    if columns.0[ROLL].is_none() {
        notes.push(
            "the trajectory's columns have no roll (`w`): assuming 0; each degree of true roll \
             displaces points by 1.7 % of their range; give a trajectory with roll"
                .to_owned(),
        );
    }
    Ok(Raw {
        format: FORMAT.to_owned(),
        stated: Stated::default(),
        records: Records::Geodetic(samples),
        speeds_mps: Vec::new(),
        notes,
    })
}

/// Converts a row to a sample.
///
/// Its fields are in the order of the letters.
fn sample(path: &Path, offset: u64, line: u64, row: [f64; 7], is_radians: bool) -> Result<Sample> {
    let [time_s, longitude, latitude, height_m, angles @ ..] = row;
    for (field, value, most) in [("latitude", latitude, 90.0), ("longitude", longitude, 360.0)] {
        if value.abs() > most {
            let problem = format!("{value} degrees is out of range");
            let remedy = "give geodetic positions, and check `trajectory_columns`";
            return Err(Error::malformed(path, offset, format!("{field} of line {line}"), problem, remedy));
        }
    }
    let [roll_rad, pitch_rad, heading_rad] = if is_radians { angles } else { angles.map(f64::to_radians) };
    let attitude = Attitude { roll_rad, pitch_rad, heading_rad };
    let sample = sample_of_degrees(time_s, [longitude, latitude, height_m], attitude);
    check(path, offset, line, &sample)?;
    Ok(sample)
}

/// Whether a line that is no record looks like one.
fn starts_with_number(line: &str) -> bool {
    line.split([' ', '\t', ',', ';']).next().is_some_and(|cell| cell.parse::<f64>().is_ok())
}

fn notes(samples: &[Sample], is_radians: bool) -> Vec<String> {
    let is_small = |sample: &Sample| {
        sample.place.latitude_rad.to_degrees().abs() < 1.6
            && sample.place.longitude_rad.to_degrees().abs() < 3.2
    };
    if is_radians && !samples.is_empty() && samples.iter().all(is_small) {
        return vec!["longitude and latitude are read as degrees, but they may be radians".to_owned()];
    }
    Vec::new()
}

/// Column index of each quantity, from 0.
///
/// In the order of the letters; roll may be missing.
struct ColumnIndices([Option<usize>; 7]);

impl ColumnIndices {
    fn new(letters: &str) -> std::result::Result<ColumnIndices, String> {
        let mut places = [None; 7];
        for (number, (letter, name)) in LETTERS.into_iter().enumerate() {
            let mut found = letters.chars().enumerate().filter(|(_, other)| *other == letter);
            match (found.next(), found.next()) {
                (Some((at, _)), None) => places[number] = Some(at),
                (None, _) if number == ROLL => {}
                (None, _) => {
                    return Err(format!(
                        "`trajectory_columns` is `{letters}`, which lacks the {name} ({letter})"
                    ));
                }
                _ => {
                    return Err(format!(
                        "`trajectory_columns` is `{letters}`, which has two columns for {name} ({letter})"
                    ));
                }
            }
        }
        Ok(ColumnIndices(places))
    }

    /// Parses the numbers of a line, or describes the problem.
    fn row(&self, line: &str) -> std::result::Result<[f64; 7], String> {
        let cells: Vec<&str> = match line {
            // Commas are then decimal commas.
            _ if line.contains(';') => line.split(';').map(str::trim).collect(),
            _ if line.contains(',') => line.split(',').map(str::trim).collect(),
            _ => line.split_whitespace().collect(),
        };
        let mut row = [0.0; 7];
        for ((value, at), (_, name)) in row.iter_mut().zip(self.0).zip(LETTERS) {
            let Some(at) = at else { continue };
            let Some(cell) = cells.get(at) else {
                return Err(format!("there are {} columns, but {name} is column {}", cells.len(), at + 1));
            };
            match cell.replacen(',', ".", 1).parse::<f64>() {
                Ok(number) if number.is_finite() => *value = number,
                _ => {
                    let cell: String = cell.chars().take(40).collect();
                    return Err(format!("the {name} (column {}) is `{cell}`", at + 1));
                }
            }
        }
        Ok(row)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blanks_tabs_and_commas_part_columns() {
        let columns = ColumnIndices::new("tsyxzwpk").unwrap();
        let expected = Ok([1.0, 11.0, 48.0, 500.0, 0.5, -0.25, 90.0]);
        for line in [
            "1 skipped 48 11 500 0.5 -0.25 90 further",
            "1\tskipped\t48\t11\t500\t0.5\t-0.25\t90",
            "1, , 48,11,500,.5,-0.25,+9e1,",
            "1;;48;11;500;0.5;-0.25;90",
            "1,0;; 48;11,0;500;0,5;-0,25;90",
        ] {
            assert_eq!(columns.row(line), expected, "{line}");
        }
    }

    #[test]
    fn text_is_distinguished_from_binary_files() {
        assert!(is_text(b"time lon lat\r\n1\t2\t3\n") && is_text("Länge, Breite in °\n".as_bytes()));
        assert!(!is_text(b"") && !is_text(b"a\0") && !is_text(&[0xff; 20]) && !is_text(b"a\x7f"));
    }
}
