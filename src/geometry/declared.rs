//! The map that a job says a recording is in (`crs_of_input` of the readers).

use std::path::Path;

use super::target::{ANYWHERE, Wanted, failed, read_wkt};
use crate::geo::crs::{Crs, CrsError, Named};
use crate::geo::frames::Vector;
use crate::stage::Result;

/// What a word must be that names the map of a recording.
const MUST_BE: &str = "it must name one map: `utm:33N`, `EPSG:2154`, or a file with WKT";

/// Checks the value of `crs_of_input`.
///
/// # Errors
/// Words that name no map, or none that is the same everywhere.
pub fn check(word: &str) -> std::result::Result<(), String> {
    match Named::parse(word) {
        Ok(Some(Named::Utm | Named::Geodetic | Named::Ecef)) => Err(MUST_BE.to_owned()),
        Ok(None) if word.is_empty() => Err(MUST_BE.to_owned()),
        Ok(_) => Ok(()),
        Err(error) => Err(error.to_string()),
    }
}

/// Whether the word is the path of a WKT file.
pub fn is_file(word: &str) -> bool {
    matches!(Named::parse(word), Ok(None))
}

/// The WKT of the map that a word names; that of a file is taken as it is.
///
/// # Errors
/// A code that is not in the table, a file that cannot be read, or a text that is not WKT.
pub fn wkt(word: &str, input_dir: &Path) -> Result<String> {
    let (named, of_file) = match Named::parse(word).map_err(|error| failed(&error))? {
        Some(named) => (named, None),
        None => {
            let text = read_wkt(&input_dir.join(word))?;
            (Named::Wkt(text.clone()), Some(text))
        }
    };
    match (Crs::new(&named, ANYWHERE, None, None), of_file) {
        // A system that cannot be computed with can be passed on all the same.
        (Ok(_), Some(text)) => Ok(text),
        (Err(error), Some(text)) if !matches!(error, CrsError::Wkt(_)) => Ok(text),
        (Ok(crs), None) => Ok(crs.wkt()),
        (Err(error), _) => Err(failed(&error)),
    }
}

/// Whether two texts of WKT are maps in which a point of the first lies elsewhere; `false` where the first cannot be used.
pub fn differ(first: &str, second: &str, point: Vector) -> bool {
    let is_usable = Crs::new(&Named::Wkt(first.to_owned()), ANYWHERE, None, None).is_ok();
    is_usable && first != second && !Wanted::of(Named::Wkt(second.to_owned())).is_map(first, point)
}
