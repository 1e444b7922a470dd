//! Terrain models from GeoTIFF or ESRI ASCII grids.

use std::io::Read;
use std::path::Path;

use super::{Error, Result, regular_file};

mod ascii;
mod geotiff;
#[cfg(test)]
mod tests;

/// Largest accepted number of cells (400 MB).
const MOST_CELLS: u64 = 100_000_000;
/// Smallest descent per metre of a traced beam.
const LEAST_FALL: f64 = 0.05;
/// Resolution of a range, m.
const FINE_M: f64 = 0.1;
/// Maximum number of samples along a beam.
///
/// Between the highest and the lowest terrain.
const MOST_STEPS: f64 = 10_000.0;

/// Terrain heights on a north-up raster.
#[derive(Clone, Debug, PartialEq)]
pub struct Terrain {
    columns: usize,
    rows: usize,
    /// Easting and northing of the centre of the north-western cell, m.
    first_m: [f64; 2],
    /// Cell size to the east and to the south, m.
    ///
    /// Above 0.
    step_m: [f64; 2],
    /// Row by row from the north, m; NaN if missing.
    heights_m: Vec<f32>,
    lowest_m: f32,
    highest_m: f32,
    epsg: Option<u16>,
}

/// Raster geometry and heights of a file.
struct Raster {
    columns: usize,
    rows: usize,
    first_m: [f64; 2],
    step_m: [f64; 2],
    heights_m: Vec<f32>,
    epsg: Option<u16>,
}

impl Terrain {
    /// Reads a terrain model; the content determines the format.
    ///
    /// # Errors
    /// The file is not a height raster, is not north up, has over 100 million cells, or has no
    /// heights.
    pub fn open(path: &Path) -> Result<Terrain> {
        let mut magic = Vec::new();
        regular_file(path)?.take(4).read_to_end(&mut magic).map_err(Error::io(path, "read"))?;
        let is_tiff =
            magic.len() == 4 && (magic[..2] == *b"II" || magic[..2] == *b"MM") && magic.contains(&0);
        Terrain::made(path, if is_tiff { geotiff::read(path)? } else { ascii::read(path)? })
    }

    /// Reads a band of a GeoTIFF whose bands are next to each other; the first is 0.
    ///
    /// # Errors
    /// As [`Terrain::open`]; the file has no such band.
    pub fn open_band(path: &Path, band: usize) -> Result<Terrain> {
        Terrain::made(path, geotiff::read_band(path, Some(band))?)
    }

    /// Descriptions of the bands of a GeoTIFF; empty where it has none.
    ///
    /// # Errors
    /// The file is not a TIFF.
    pub fn band_descriptions(path: &Path) -> Result<Vec<String>> {
        geotiff::band_descriptions(path)
    }

    fn made(path: &Path, raster: Raster) -> Result<Terrain> {
        Terrain::new(raster).ok_or_else(|| {
            let remedy = "give the terrain model of this area";
            Error::unusable(path, "the terrain model has no heights", remedy)
        })
    }

    /// Returns the memory used by the heights, bytes.
    pub fn bytes(&self) -> usize {
        self.heights_m.len() * size_of::<f32>()
    }

    fn new(raster: Raster) -> Option<Terrain> {
        let Raster { columns, rows, first_m, step_m, mut heights_m, epsg } = raster;
        let (mut lowest_m, mut highest_m) = (f32::INFINITY, f32::NEG_INFINITY);
        for height in &mut heights_m {
            // No terrain is farther from any vertical datum, m.
            if height.abs() > 20_000.0 {
                *height = f32::NAN;
            }
            // `min` and `max` ignore NaN.
            (lowest_m, highest_m) = (lowest_m.min(*height), highest_m.max(*height));
        }
        let is_whole = columns > 0 && heights_m.len() == columns * rows && lowest_m <= highest_m;
        is_whole.then_some(Terrain { columns, rows, first_m, step_m, heights_m, lowest_m, highest_m, epsg })
    }

    /// Number of columns and rows.
    pub fn size(&self) -> [usize; 2] {
        [self.columns, self.rows]
    }

    /// Corners of the raster with the smallest and largest easting and northing, m.
    pub fn corners_m(&self) -> [[f64; 2]; 2] {
        let [west_m, north_m] =
            [self.first_m[0] - 0.5 * self.step_m[0], self.first_m[1] + 0.5 * self.step_m[1]];
        let (columns, rows) = (self.columns as f64, self.rows as f64);
        [[west_m, north_m - rows * self.step_m[1]], [west_m + columns * self.step_m[0], north_m]]
    }

    /// Values of all cells, row by row from the north; NaN if missing.
    pub fn values(&self) -> &[f32] {
        &self.heights_m
    }

    /// Returns the EPSG code of the horizontal system, if known.
    pub fn epsg(&self) -> Option<u16> {
        self.epsg
    }

    /// Returns the smallest and largest height, m.
    pub fn heights_m(&self) -> [f32; 2] {
        [self.lowest_m, self.highest_m]
    }

    /// Interpolates the height at a position bilinearly between cell centres, m.
    ///
    /// NaN outside the raster and next to cells without a height.
    pub fn height_m(&self, easting_m: f64, northing_m: f64) -> f64 {
        let column = (easting_m - self.first_m[0]) / self.step_m[0];
        let row = (self.first_m[1] - northing_m) / self.step_m[1];
        let (last_column, last_row) = ((self.columns - 1) as f64, (self.rows - 1) as f64);
        // The outer half of an edge cell has the height of its centre.
        let is_inside =
            (-0.5..=last_column + 0.5).contains(&column) && (-0.5..=last_row + 0.5).contains(&row);
        if !is_inside {
            return f64::NAN;
        }
        let (column, row) = (column.clamp(0.0, last_column), row.clamp(0.0, last_row));
        let (left, top) = (column.floor(), row.floor());
        let (along, down) = (column - left, row - top);
        let (left, top) = (left as usize, top as usize);
        let (right, bottom) = ((left + 1).min(self.columns - 1), (top + 1).min(self.rows - 1));
        let at = |row: usize, column: usize| f64::from(self.heights_m[row * self.columns + column]);
        let upper = between(at(top, left), at(top, right), along);
        let lower = between(at(bottom, left), at(bottom, right), along);
        between(upper, lower, down)
    }

    /// Returns the range where a beam hits the terrain, m.
    ///
    /// NaN if the beam leaves the model, does not descend, or hits nothing within `range_m`. `beam`
    /// is the change of easting, northing and height per metre of range.
    pub fn range_m(&self, origin_m: [f64; 3], beam: [f64; 3], range_m: [f64; 2]) -> f64 {
        if beam[2].is_nan() || beam[2] > -LEAST_FALL {
            return f64::NAN;
        }
        let range_at = |height_m: f32| (f64::from(height_m) - origin_m[2]) / beam[2];
        let (from_m, to_m) =
            (range_at(self.highest_m).max(range_m[0]), (range_at(self.lowest_m) + 1.0).min(range_m[1]));
        let above_m = |range_m: f64| {
            let [east, north, up]: [f64; 3] =
                std::array::from_fn(|axis| origin_m[axis] + range_m * beam[axis]);
            up - self.height_m(east, north)
        };
        // Four samples per crossed cell: a ridge is at least one cell wide.
        let cells = (beam[0] / self.step_m[0]).abs().max((beam[1] / self.step_m[1]).abs()) * (to_m - from_m);
        let looks = (4.0 * cells).ceil().clamp(1.0, MOST_STEPS);
        if to_m < from_m || above_m(from_m) < 0.0 {
            return f64::NAN;
        }
        let mut before_m = from_m;
        for look in 1..=looks as u32 {
            let here_m = from_m + (to_m - from_m) * f64::from(look) / looks;
            let above = above_m(here_m);
            if above.is_nan() {
                return f64::NAN;
            }
            if above <= 0.0 {
                return crossing(before_m, here_m, above_m);
            }
            before_m = here_m;
        }
        f64::NAN
    }
}

/// Interpolates linearly.
///
/// With a weight of 0, the second value may be NaN.
fn between(from: f64, to: f64, part: f64) -> f64 {
    if part == 0.0 { from } else { from + part * (to - from) }
}

/// Finds by bisection where a beam passes below the ground.
fn crossing(mut above_m: f64, mut below_m: f64, height_above_m: impl Fn(f64) -> f64) -> f64 {
    while below_m - above_m > FINE_M {
        let middle_m = 0.5 * (above_m + below_m);
        if height_above_m(middle_m) > 0.0 { above_m = middle_m } else { below_m = middle_m }
    }
    0.5 * (above_m + below_m)
}

/// Checks the size of a raster.
///
/// `held` is the largest number of cells in a file of this length.
fn checked_size(path: &Path, columns: u64, rows: u64, held: u64) -> Result<(usize, usize)> {
    let cells = columns.checked_mul(rows).filter(|&cells| cells > 0 && cells <= MOST_CELLS);
    let size = cells.and_then(|_| Some((usize::try_from(columns).ok()?, usize::try_from(rows).ok()?)));
    let Some(size) = size else {
        return Err(Error::unusable(
            path,
            format!(
                "the terrain model has {columns} by {rows} cells, but only 1 to {MOST_CELLS} \
                     are supported"
            ),
            "crop it to the area of the recording, or resample it to a coarser grid",
        ));
    };
    if cells.is_some_and(|cells| cells > held) {
        return Err(Error::unusable(
            path,
            format!("the file is too short for {columns} by {rows} cells"),
            "the file is cut off: copy it again from its source",
        ));
    }
    Ok(size)
}
