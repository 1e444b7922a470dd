//! The `.gtx` grid of NOAA's VDatum (VDatum manual, "GTX format").
//!
//! All values are big-endian: f64 latitude and longitude of the south-west corner, f64 steps to the
//! north and to the east, all in degrees; i32 rows and columns; then f32 rows from south to north.
//! -88.8888 marks a missing value.

use std::path::Path;

use super::GeoidHeader;
use crate::Result;
use crate::bytes::Fields;
use wavex_geodesy::geoid::GeoidGrid;

const HEADER: usize = 40;
const NO_VALUE: f32 = -88.8888;

/// Parses the bytes of a file.
///
/// # Errors
/// The header is truncated or invalid, or the number of values does not match it.
pub(super) fn parse(path: &Path, bytes: &[u8]) -> Result<GeoidGrid> {
    let mut fields = Fields::new(path, 0, bytes);
    let mut number = |field: &str| fields.array(field).map(f64::from_be_bytes);
    let [south_deg, west_deg, latitude_step_deg, longitude_step_deg] = [
        number("south latitude")?,
        number("west longitude")?,
        number("latitude step")?,
        number("longitude step")?,
    ];
    let mut count = |field: &str| fields.array(field).map(i32::from_be_bytes);
    let (rows, columns) = (count("rows")?, count("columns")?);
    let header = GeoidHeader { south_deg, west_deg, latitude_step_deg, longitude_step_deg, rows, columns };
    header.grid(path, bytes, HEADER, |value| {
        let height_m = f32::from_be_bytes(value);
        if (height_m - NO_VALUE).abs() < 1e-4 { f32::NAN } else { height_m }
    })
}
