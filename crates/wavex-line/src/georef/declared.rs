//! CRS of a recording as declared by the job (`crs_of_input` of the readers).

use std::path::Path;

use super::Result;
use super::output_crs::{ANYWHERE, CrsRequest, read_wkt};
use crate::plausibility::Check;
use wavex_geodesy::crs::{Crs, CrsError, Named, system_of_wkt};
use wavex_geodesy::frames::Vector;

/// Requirement for names of the CRS of a recording.
const MUST_BE: &str = "it must name a projected CRS: `utm:33N`, `EPSG:2154`, or a file with WKT";
/// Largest longitude and latitude, degrees.
const MOST_DEG: [f64; 2] = [360.0, 90.0];

/// Checks the value of `crs_of_input`, except a file.
///
/// # Errors
/// A name that is not a CRS, or whose CRS depends on the position or is geocentric.
pub fn check(word: &str) -> std::result::Result<(), String> {
    match Named::parse(word) {
        Ok(Some(Named::Utm | Named::Geodetic | Named::Ecef)) => Err(MUST_BE.to_owned()),
        Ok(None) if word.is_empty() => Err(MUST_BE.to_owned()),
        Ok(None) => Ok(()),
        Ok(Some(named)) => match Crs::new(&named, ANYWHERE, None, None) {
            Ok(crs) if crs.is_ecef() => Err(MUST_BE.to_owned()),
            Ok(_) => Ok(()),
            Err(error) => Err(error.to_string()),
        },
        Err(error) => Err(error.to_string()),
    }
}

/// Words of the message.
const IN_DEGREES: &str = "is in degrees, but the recording begins at";

/// The check of coordinates in a geographic CRS.
pub fn degrees_check() -> Check {
    Check::error(
        "first coordinates and a geographic CRS: that of the job, or of the file, which is then not used (warning)",
        format!("at most {} and {} degrees", MOST_DEG[0], MOST_DEG[1]),
        "longitude and latitude",
        IN_DEGREES,
    )
    .with_key("crs_of_input")
}

/// Why a recording with this point cannot be in a CRS: its coordinates are no degrees.
///
/// `None` for projected and unreadable CRSs.
pub fn not_in_degrees(wkt: &str, point: Vector) -> Option<String> {
    let crs = Crs::horizontal_of_wkt(wkt).filter(Crs::is_geodetic)?;
    let are_degrees = point.iter().zip(MOST_DEG).all(|(value, most)| value.abs() <= most);
    let [x, y, _] = point;
    (!are_degrees)
        .then(|| format!("{} {IN_DEGREES} {x:.1}, {y:.1}: its beams are in metres or feet", crs.name()))
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
