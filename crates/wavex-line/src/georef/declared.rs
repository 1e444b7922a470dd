//! CRS of a recording as declared by the job (`crs_of_input` of the readers).

use std::path::Path;

use super::Result;
use super::output_crs::{ANYWHERE, CrsRequest, read_wkt};
use wavex_geodesy::crs::{Crs, CrsError, Named, system_of_wkt};
use wavex_geodesy::frames::Vector;

/// Requirement for names of the CRS of a recording.
const MUST_BE: &str = "it must name a projected CRS: `utm:33N`, `EPSG:2154`, or a file with WKT";

/// Checks the value of `crs_of_input`.
///
/// # Errors
/// A name that is not a CRS, or whose CRS depends on the position.
pub fn check(word: &str) -> std::result::Result<(), String> {
    match Named::parse(word) {
        Ok(Some(Named::Utm | Named::Geodetic | Named::Ecef)) => Err(MUST_BE.to_owned()),
        Ok(None) if word.is_empty() => Err(MUST_BE.to_owned()),
        Ok(_) => Ok(()),
        Err(error) => Err(error.to_string()),
    }
}

/// Whether the value is the path of a WKT file.
pub fn is_file(word: &str) -> bool {
    matches!(Named::parse(word), Ok(None))
}

/// WKT of the named CRS; WKT from a file is returned unchanged.
///
/// # Errors
/// An unknown code, a file that cannot be read, or text that is not WKT.
pub fn wkt(word: &str, input_dir: &Path) -> Result<String> {
    let (named, of_file) = match Named::parse(word)? {
        Some(named) => (named, None),
        None => {
            let text = read_wkt(&input_dir.join(word))?;
            (Named::Wkt(text.clone()), Some(text))
        }
    };
    match (Crs::new(&named, ANYWHERE, None, None), of_file) {
        // A valid but unsupported CRS can still be passed on.
        // A pair of systems becomes a compound one.
        (Ok(_), Some(text)) => Ok(system_of_wkt(&text)?.wkt),
        (Err(error), Some(text)) if !matches!(error, CrsError::Wkt(_)) => Ok(text),
        (Ok(crs), None) => Ok(crs.wkt()),
        (Err(error), _) => Err(error.into()),
    }
}

/// Whether a point has different coordinates in two WKT CRSs; `false` if the first is unusable.
pub fn differ(first: &str, second: &str, point: Vector) -> bool {
    let is_usable = Crs::new(&Named::Wkt(first.to_owned()), ANYWHERE, None, None).is_ok();
    is_usable && first != second && !CrsRequest::of(Named::Wkt(second.to_owned())).is_map(first, point)
}
