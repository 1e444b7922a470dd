//! Geoid grids: `.bin` of NGS (USA) and `.gtx` of NOAA's VDatum.

mod gtx;
mod ngs_bin;

use std::fs;
use std::path::{Path, PathBuf};

use super::{Error, Result, make_room, read_small};
use wavex_geodesy::geoid::{Geoid, GeoidGrid};

/// Largest accepted number of grid values.
///
/// EGM2008 at 1 arc-minute has 233 million.
const MOST_VALUES: u64 = 1 << 28;
/// Maximum number of file names listed in a message.
const NAMES_SHOWN: usize = 20;

/// Finds and reads the geoid `name` of a folder.
///
/// The file is `name`, `name.bin` or `name.gtx`, in any case.
///
/// # Errors
/// The folder cannot be read, the file is damaged, or the name matches no file or more than one.
/// The error lists the available grids.
pub fn find(folder: &Path, name: &str) -> Result<Geoid> {
    let grids = grids_in(folder)?;
    let wanted = name.to_lowercase();
    let is_wanted =
        |path: &&PathBuf| [file_name(path), stem(path)].iter().any(|text| text.to_lowercase() == wanted);
    let found: Vec<&PathBuf> = grids.iter().filter(is_wanted).collect();
    match found.as_slice() {
        [path] => read(path),
        [] if name.contains(['/', '\\']) => {
            let problem = format!("a geoid is given by its name, not by a path such as `{name}`");
            let path = Path::new(name);
            let remedy = match path.parent().filter(|_| path.is_file()) {
                Some(parent) => {
                    format!("write `geoid = {:?}` and `geoid_dir = {:?}`", stem(path), parent.display())
                }
                None => "write the folder of the grid in `geoid_dir`".to_owned(),
            };
            Err(Error::unusable(folder, problem, remedy))
        }
        [] => {
            let problem =
                format!("there is no geoid `{name}` in this folder, which holds {}", listed(&grids));
            Err(Error::unusable(
                folder,
                problem,
                "check `geoid` and `geoid_dir`, or put the grid's .bin or .gtx file there",
            ))
        }
        several => {
            let names: Vec<String> = several.iter().map(|path| file_name(path)).collect();
            let problem = format!("the geoid `{name}` matches more than one file: {}", names.join(", "));
            Err(Error::unusable(
                folder,
                problem,
                "give the name with its extension, or keep only one of them",
            ))
        }
    }
}

/// Reads a grid in the format given by its extension.
///
/// # Errors
/// The file cannot be read, its extension is neither `bin` nor `gtx`, or it is damaged.
pub fn read(path: &Path) -> Result<Geoid> {
    let extension = extension(path);
    let parse = match extension.as_str() {
        "bin" => ngs_bin::parse,
        "gtx" => gtx::parse,
        _ => {
            let problem = format!("the extension `{extension}` is not a geoid format");
            return Err(Error::unusable(path, problem, "give a .bin file of NGS or a .gtx file"));
        }
    };
    let bytes = read_small(path, 4 * MOST_VALUES + 64, "a geoid", "give a geoid file")?;
    let grid = parse(path, &bytes)?;
    Geoid::new(&stem(path), grid).ok_or_else(|| {
        let problem = "its rows, columns or steps are invalid";
        Error::unusable(path, problem, "copy the file again from its source")
    })
}

/// Lists the grids of a folder, sorted by name.
fn grids_in(folder: &Path) -> Result<Vec<PathBuf>> {
    let io = Error::io(folder, "list the geoids of");
    let mut grids = Vec::new();
    for entry in fs::read_dir(folder).map_err(&io)? {
        let path = entry.map_err(&io)?.path();
        if matches!(extension(&path).as_str(), "bin" | "gtx") {
            grids.push(path);
        }
    }
    grids.sort();
    Ok(grids)
}

fn listed(grids: &[PathBuf]) -> String {
    if grids.is_empty() {
        return "no .bin or .gtx file".into();
    }
    let shown: Vec<String> = grids.iter().take(NAMES_SHOWN).map(|path| file_name(path)).collect();
    match grids.len() - shown.len() {
        0 => shown.join(", "),
        more => format!("{} and {more} more", shown.join(", ")),
    }
}

fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

fn stem(path: &Path) -> String {
    path.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

fn extension(path: &Path) -> String {
    path.extension().unwrap_or_default().to_string_lossy().to_lowercase()
}

/// Header fields that both formats share.
struct GeoidHeader {
    south_deg: f64,
    west_deg: f64,
    latitude_step_deg: f64,
    longitude_step_deg: f64,
    rows: i32,
    columns: i32,
}

impl GeoidHeader {
    /// Builds the grid from the values after the header.
    ///
    /// The header has `header_length` bytes.
    ///
    /// # Errors
    /// Invalid counts or steps, or a number of bytes that does not match them.
    fn grid(
        &self,
        path: &Path,
        bytes: &[u8],
        header_length: usize,
        value: impl Fn([u8; 4]) -> f32,
    ) -> Result<GeoidGrid> {
        let (rows, columns) = (self.rows.max(0) as usize, self.columns.max(0) as usize);
        let bad = |problem| {
            Error::unusable(path, problem, "copy the file again from its source, or check its format")
        };
        let steps = [self.latitude_step_deg, self.longitude_step_deg];
        let places = [self.south_deg, self.west_deg];
        let sound = steps.iter().all(|step| *step > 0.0 && *step <= 90.0)
            && places.iter().all(|place| place.abs() <= 720.0);
        if rows < 2 || columns < 2 || !sound {
            return Err(bad(format!(
                "its header says {} rows and {} columns from latitude {}, longitude {} in steps of \
                 {} and {} degrees, which is not a valid grid",
                self.rows,
                self.columns,
                self.south_deg,
                self.west_deg,
                self.latitude_step_deg,
                self.longitude_step_deg
            )));
        }
        let values = bytes.get(header_length..).unwrap_or_default();
        if rows as u64 * columns as u64 * 4 != values.len() as u64 {
            return Err(bad(format!(
                "its header says {rows} rows of {columns} values, {} bytes, but {} bytes follow it",
                rows as u64 * columns as u64 * 4,
                values.len()
            )));
        }
        let values = values.as_chunks().0;
        let mut heights_m = Vec::new();
        make_room(&mut heights_m, values.len()).map_err(Error::io(path, "read"))?;
        heights_m.extend(values.iter().map(|bytes| value(*bytes)));
        Ok(GeoidGrid {
            south_deg: self.south_deg,
            west_deg: self.west_deg,
            latitude_step_deg: self.latitude_step_deg,
            longitude_step_deg: self.longitude_step_deg,
            rows,
            columns,
            heights_m,
        })
    }
}

#[cfg(test)]
mod tests;
