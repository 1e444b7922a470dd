//! Cuts: shots of an area, of a time window, or of a list.

use std::collections::HashSet;
use std::path::Path;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::extent::{Extent, ExtentKey};
use super::{ReadHdf5, gps_time_s};
use crate::reading::recording::TimeKeys;
use crate::reading::recording::time::Axis;
use wavex_formats::{Error, read_small_text};
use wavex_hdf5::Shot;
use wavex_line::keys::{InvalidKey, at_least};
use wavex_line::scan_line::InputInfo;
use wavex_line::stage::{Context, Reason, Result, RunContext};

/// Maximum size of a file of shot numbers, bytes.
const MOST_BYTES: u64 = 256 << 20;
/// Remedy for a wrong file of shot numbers.
const REMEDY: &str = "write one whole number per line";

/// Shot numbers, or a file of them.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum ShotList {
    /// Shot numbers.
    Numbers(#[schemars(transform = at_least(0.0).at_most(i64::MAX as f64))] Vec<u64>),
    /// A text file with one number per line.
    File(String),
}

impl ShotList {
    /// Reads the numbers.
    ///
    /// # Errors
    /// If the file cannot be read, or a line is no whole number.
    fn numbers(&self, run: &RunContext) -> Result<HashSet<u64>> {
        match self {
            ShotList::Numbers(numbers) => Ok(numbers.iter().copied().collect()),
            ShotList::File(name) => Ok(numbers_in(&run.input_path(Path::new(name)))?),
        }
    }
}

/// Reads a file with one shot number per line; empty lines and lines that begin with `#` are passed over.
fn numbers_in(path: &Path) -> wavex_formats::Result<HashSet<u64>> {
    let text = read_small_text(path, MOST_BYTES, "a list of shots", REMEDY)?;
    let lines = (1..).zip(text.lines().map(str::trim));
    let written = lines.filter(|(_, line)| !line.is_empty() && !line.starts_with('#'));
    let numbers = written.map(|(number, line)| {
        let wrong = |_| Error::unusable(path, format!("line {number}: `{line}` is no shot number"), REMEDY);
        line.parse().map_err(wrong)
    });
    let numbers: HashSet<u64> = numbers.collect::<wavex_formats::Result<_>>()?;
    match numbers.is_empty() {
        true => Err(Error::unusable(path, "it has no shot number", REMEDY)),
        false => Ok(numbers),
    }
}

/// Checks the keys of cuts.
pub(super) fn check(keys: &ReadHdf5) -> std::result::Result<(), InvalidKey> {
    keys.extent_deg.as_ref().map_or(Ok(()), ExtentKey::check)?;
    let has_shots = keys.shots != Some(ShotList::Numbers(Vec::new()));
    InvalidKey::unless(has_shots, "shots", "it must have at least one shot number")
}

/// Conditions that a shot must meet to be read.
pub(super) struct Cut {
    extent: Option<Extent>,
    times: TimeKeys,
    shots: Option<HashSet<u64>>,
    /// Times of the beam that is read, and their window, s; `None` before its first time.
    window: Option<(Axis, [f64; 2])>,
    is_empty: bool,
    /// Ranges of the values that were compared.
    numbers: Option<[u64; 2]>,
    longitudes_deg: Option<[f64; 2]>,
    latitudes_deg: Option<[f64; 2]>,
    times_s: Option<[f64; 2]>,
}

impl Cut {
    /// Creates the cut of a reader; `None` if it has no such key.
    ///
    /// # Errors
    /// If a file of shot numbers or polygons cannot be read.
    pub(super) fn of(keys: &ReadHdf5, run: &RunContext) -> Result<Option<Cut>> {
        if keys.extent_deg.is_none() && keys.shots.is_none() && keys.times.time_s.is_none() {
            return Ok(None);
        }
        Ok(Some(Cut {
            extent: keys.extent_deg.as_ref().map(|extent| Extent::of(extent, run)).transpose()?,
            times: keys.times.clone(),
            shots: keys.shots.as_ref().map(|shots| shots.numbers(run)).transpose()?,
            window: None,
            is_empty: true,
            numbers: None,
            longitudes_deg: None,
            latitudes_deg: None,
            times_s: None,
        }))
    }

    /// Begins another beam, whose times begin anew.
    pub(super) fn begin_beam(&mut self) {
        self.window = None;
    }

    /// Returns why a shot is not read, from its number, time and first position.
    ///
    /// # Errors
    /// If the times of the recording and of the window cannot be compared.
    pub(super) fn reason(&mut self, shot: &Shot, info: &InputInfo) -> Result<Option<Reason>> {
        if let Some(shots) = &self.shots {
            extend(&mut self.numbers, shot.shot_number);
            if !shots.contains(&shot.shot_number) {
                return Ok(Some(Reason::NotInShots));
            }
        }
        if let Some(extent) = &self.extent {
            if !shot.first_bin.is_known() {
                return Ok(Some(Reason::ShotWithoutPosition));
            }
            let [longitude_deg, latitude_deg] =
                [shot.first_bin.longitude_rad, shot.first_bin.latitude_rad].map(f64::to_degrees);
            extend(&mut self.longitudes_deg, longitude_deg);
            extend(&mut self.latitudes_deg, latitude_deg);
            if !extent.includes(longitude_deg, latitude_deg) {
                return Ok(Some(Reason::OutsideExtent));
            }
        }
        if let Some(asked_s) = self.times.time_s {
            let time_s = gps_time_s(shot, info);
            if time_s.is_nan() {
                return Ok(Some(Reason::WithoutTime));
            }
            let (axis, [from_s, to_s]) = match &mut self.window {
                Some(window) => window,
                None => {
                    let times = self.times.interpret(info, Some(time_s))?;
                    let window_s = self.times.window_s(&times, &info.path)?;
                    self.window.insert((times.axis(), window_s.unwrap_or(asked_s)))
                }
            };
            let time_s = axis.next(time_s);
            extend(&mut self.times_s, time_s);
            if !(*from_s..=*to_s).contains(&time_s) {
                return Ok(Some(Reason::OutsideTimes));
            }
        }
        self.is_empty = false;
        Ok(None)
    }

    /// Warns if no shot is left.
    pub(super) fn report(&self, cx: &mut Context) {
        if !self.is_empty {
            return;
        }
        let numbers = self.numbers.map(|[first, last]| format!("`shots`: numbers are {first} to {last}"));
        let extent = self.longitudes_deg.zip(self.latitudes_deg).map(|(longitudes_deg, latitudes_deg)| {
            let ([west, east], [south, north]) = (longitudes_deg, latitudes_deg);
            let is_swapped =
                self.extent.as_ref().is_some_and(|extent| extent.is_swapped(longitudes_deg, latitudes_deg));
            let order = if is_swapped { ", and longitude comes first in each point" } else { "" };
            format!(
                "`extent_deg`: longitudes are {west:.4} to {east:.4}, latitudes {south:.4} to {north:.4} degrees{order}"
            )
        });
        let times = self
            .times_s
            .map(|[first_s, last_s]| format!("`time_s`: times are {first_s:.3} to {last_s:.3} s"));
        let found: Vec<String> = [numbers, extent, times].into_iter().flatten().collect();
        if !found.is_empty() {
            cx.warn(format!(
                "no shot is left by the cuts ({}); correct or remove the keys",
                found.join("; ")
            ));
        }
    }
}

fn extend<T: Copy + PartialOrd>(span: &mut Option<[T; 2]>, value: T) {
    let [least, largest] = span.get_or_insert([value; 2]);
    if value < *least {
        *least = value;
    }
    if value > *largest {
        *largest = value;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_of_shots_have_a_number_per_line() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("shots.txt");
        std::fs::write(&path, "# of plot 7\n66660300200081527\r\n\n 12 \n").unwrap();
        assert_eq!(numbers_in(&path).unwrap(), HashSet::from([12, 66_660_300_200_081_527]));
        let error = |text: &str| {
            std::fs::write(&path, text).unwrap();
            numbers_in(&path).unwrap_err().to_string()
        };
        let wrong = error("1\n2.5\n");
        assert!(
            wrong.ends_with("line 2: `2.5` is no shot number; write one whole number per line"),
            "{wrong}"
        );
        assert!(error("\n").ends_with("it has no shot number; write one whole number per line"));
    }
}
