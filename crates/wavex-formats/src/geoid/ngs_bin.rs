//! The `.bin` geoid grid of the US NGS.
//!
//! Format of the National Geodetic Survey, "GEOID12B readme". The header holds f64 latitude of the
//! southernmost row, f64 longitude of the westernmost column (0 to 360 to the east), f64 steps to
//! the north and to the east, all in degrees; i32 rows, columns and kind (1: f32 values). Then
//! follow f32 rows from south to north. Files exist in both byte orders; the order is the one in
//! which the kind is 1.

use std::path::Path;

use super::GeoidHeader;
use crate::bytes::Fields;
use crate::{Error, Result};
use wavex_geodesy::geoid::GeoidGrid;

const HEADER: usize = 44;
/// Largest geoid height, m; larger values mark missing data.
///
/// The geoid lies within 110 m of the ellipsoid.
const HIGHEST_M: f32 = 200.0;

/// Parses the bytes of a file.
///
/// # Errors
/// The header is truncated or invalid, its kind is 1 in neither byte order, or the number of values
/// does not match it.
pub(super) fn parse(path: &Path, bytes: &[u8]) -> Result<GeoidGrid> {
    let mut fields = Fields::new(path, 0, bytes);
    let mut number = |field: &str| fields.array::<8>(field);
    let numbers = [
        number("south latitude")?,
        number("west longitude")?,
        number("latitude step")?,
        number("longitude step")?,
    ];
    let mut count = |field: &str| fields.array::<4>(field);
    let counts = [count("rows")?, count("columns")?];
    let kind_at = fields.offset();
    let is_little = match fields.array("kind")? {
        [1, 0, 0, 0] => true,
        [0, 0, 0, 1] => false,
        kind => {
            let problem = format!(
                "{} in little-endian and {} in big-endian order, not 1 in either",
                i32::from_le_bytes(kind),
                i32::from_be_bytes(kind)
            );
            return Err(Error::malformed(
                path,
                kind_at,
                "kind",
                problem,
                "give a geoid's .bin file as NGS publishes it",
            ));
        }
    };
    let number = if is_little { f64::from_le_bytes } else { f64::from_be_bytes };
    let count = if is_little { i32::from_le_bytes } else { i32::from_be_bytes };
    let height = if is_little { f32::from_le_bytes } else { f32::from_be_bytes };
    let [south_deg, west_deg, latitude_step_deg, longitude_step_deg] = numbers.map(number);
    let [rows, columns] = counts.map(count);
    let header = GeoidHeader { south_deg, west_deg, latitude_step_deg, longitude_step_deg, rows, columns };
    header.grid(path, bytes, HEADER, |value| {
        let height_m = height(value);
        if height_m.abs() <= HIGHEST_M { height_m } else { f32::NAN }
    })
}
