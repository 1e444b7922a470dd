//! ESRI ASCII grids.
//!
//! A header of keywords and numbers, then heights row by row from the north.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::Path;

use super::super::{Error, Result, make_room, regular_file};
use super::{Raster, checked_size};

/// Longest accepted word, bytes.
const LONGEST_WORD: usize = 64;
const REMEDY: &str = "give a GeoTIFF or an ESRI ASCII grid";

/// Reads a grid.
pub(super) fn read(path: &Path) -> Result<Raster> {
    let file = regular_file(path)?;
    let length = file.metadata().map_err(Error::io(path, "open"))?.len();
    let mut words = Words { path, reader: BufReader::new(file), offset: 0, word: String::new() };
    let header = GridHeader::read(&mut words)?;
    let (columns, rows) = (header.whole("ncols", path)?, header.whole("nrows", path)?);
    // A height needs at least a digit and a space.
    let (columns, rows) = checked_size(path, columns, rows, length / 2 + 1)?;
    let step_m = header.steps(path)?;
    let corner = |axis: usize, corner: &str, center: &str| match header.0.get(center) {
        Some(&middle) => Ok(middle),
        None => header.number(corner, path).map(|corner| corner + 0.5 * step_m[axis]),
    };
    let west_m = corner(0, "xllcorner", "xllcenter")?;
    let south_m = corner(1, "yllcorner", "yllcenter")?;
    let nodata = header.0.get("nodata_value").copied();
    let mut heights_m = Vec::new();
    make_room(&mut heights_m, columns * rows).map_err(Error::io(path, "read"))?;
    for index in 0..columns * rows {
        // The header ends at the first height, which is already read.
        if index > 0 && !words.next()? {
            return Err(Error::malformed(
                path,
                words.offset,
                "heights",
                format!("the file ends after {index} of {} heights", columns * rows),
                "the file is cut off: copy it again from its source",
            ));
        }
        let height = words.number("heights")?;
        heights_m.push(if Some(height) == nodata { f32::NAN } else { height as f32 });
    }
    let first_m = [west_m, south_m + (rows - 1) as f64 * step_m[1]];
    Ok(Raster { columns, rows, first_m, step_m, heights_m, epsg: None })
}

/// Header values by lower-case keyword.
struct GridHeader(BTreeMap<String, f64>);

impl GridHeader {
    /// Reads keywords and numbers.
    ///
    /// Leaves the first height as the current word.
    fn read(words: &mut Words) -> Result<GridHeader> {
        let mut header = BTreeMap::new();
        while words.next()? {
            if words.word.parse::<f64>().is_ok() {
                return Ok(GridHeader(header));
            }
            let name = words.word.to_ascii_lowercase();
            let known = [
                "ncols",
                "nrows",
                "xllcorner",
                "yllcorner",
                "xllcenter",
                "yllcenter",
                "cellsize",
                "dx",
                "dy",
                "nodata_value",
            ];
            if !known.contains(&name.as_str()) {
                let problem = format!("`{}` is not a header keyword of an ASCII grid", words.word);
                return Err(Error::malformed(words.path, words.start(), "header", problem, REMEDY));
            }
            if !words.next()? {
                break;
            }
            let number = words.number(&name)?;
            header.insert(name, number);
        }
        Err(Error::malformed(
            words.path,
            words.offset,
            "header",
            "the file ends before the first height",
            REMEDY,
        ))
    }

    fn number(&self, name: &str, path: &Path) -> Result<f64> {
        self.0.get(name).copied().ok_or_else(|| {
            Error::unusable(path, format!("the header of the ASCII grid has no `{name}`"), REMEDY)
        })
    }

    fn whole(&self, name: &str, path: &Path) -> Result<u64> {
        let number = self.number(name, path)?;
        // A float converts to the nearest integer in range.
        Ok(if number.fract() == 0.0 && number > 0.0 { number as u64 } else { 0 })
    }

    /// Returns the cell sizes, from `cellsize`, or `dx` and `dy`.
    fn steps(&self, path: &Path) -> Result<[f64; 2]> {
        let step = |name: &str| self.0.get(name).copied().map_or_else(|| self.number("cellsize", path), Ok);
        let steps = [step("dx")?, step("dy")?];
        if steps.iter().all(|&step| step > 0.0 && step.is_finite()) {
            return Ok(steps);
        }
        Err(Error::unusable(path, format!("invalid cell size {} by {} m", steps[0], steps[1]), REMEDY))
    }
}

/// Iterator over the words of a file.
struct Words<'a> {
    path: &'a Path,
    reader: BufReader<File>,
    /// Offset of the first byte after the current word.
    offset: u64,
    word: String,
}

impl Words<'_> {
    /// Reads the next word.
    ///
    /// `false` at the end of the file.
    fn next(&mut self) -> Result<bool> {
        self.word.clear();
        loop {
            let bytes = self.reader.fill_buf().map_err(Error::io(self.path, "read"))?;
            let mut used = 0;
            let mut ended = bytes.is_empty();
            for &byte in bytes {
                used += 1;
                if !byte.is_ascii_whitespace() {
                    self.word.push(char::from(byte));
                }
                ended = byte.is_ascii_whitespace() && !self.word.is_empty();
                if ended || self.word.len() > LONGEST_WORD {
                    break;
                }
            }
            self.reader.consume(used);
            self.offset += used as u64;
            if self.word.len() > LONGEST_WORD {
                let problem = format!("a word longer than {LONGEST_WORD} bytes");
                return Err(Error::malformed(self.path, self.start(), "text", problem, REMEDY));
            }
            if ended {
                return Ok(!self.word.is_empty());
            }
        }
    }

    /// Returns the approximate offset of the current word.
    fn start(&self) -> u64 {
        self.offset.saturating_sub(self.word.len() as u64 + 1)
    }

    fn number(&self, field: &str) -> Result<f64> {
        let number = self.word.parse::<f64>().ok();
        number.filter(|number| number.is_finite()).ok_or_else(|| {
            let problem = format!("`{}` is not a number", self.word);
            Error::malformed(self.path, self.start(), field, problem, REMEDY)
        })
    }
}
