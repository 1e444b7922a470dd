//! GeoTIFF height rasters: one band, north up.

use std::io::BufReader;
use std::path::Path;

use tiff::decoder::{Decoder, DecodingResult, Limits};
use tiff::tags::Tag;
use tiff::{ColorType, TiffError};

use super::super::geokeys;
use super::super::{Error, Result, regular_file};
use super::{MOST_CELLS, Raster, checked_size};

/// Largest compression ratio (LZW; deflate is lower).
const DENSEST: u64 = 4096;
const REMEDY: &str = "convert it to a north-up GeoTIFF with one band of heights";

/// Reads a raster.
pub(super) fn read(path: &Path) -> Result<Raster> {
    let file = regular_file(path)?;
    let length = file.metadata().map_err(Error::io(path, "open"))?.len();
    let bad = |error: TiffError| Error::unusable(path, format!("cannot read the GeoTIFF: {error}"), REMEDY);
    let mut limits = Limits::default();
    limits.decoding_buffer_size = 8 * MOST_CELLS as usize;
    let mut tiff = Decoder::new(BufReader::new(file)).map_err(bad)?.with_limits(limits);
    let (columns, rows) = tiff.dimensions().map_err(bad)?;
    let held = length.saturating_mul(DENSEST);
    let (columns, rows) = checked_size(path, u64::from(columns), u64::from(rows), held)?;
    if !matches!(tiff.colortype().map_err(bad)?, ColorType::Gray(_)) {
        return Err(Error::unusable(path, "the GeoTIFF has more than one band", REMEDY));
    }
    let mut numbers = |tag: Tag| match tiff.find_tag(tag).map_err(bad)? {
        Some(value) => value.into_f64_vec().map_err(bad),
        None => Ok(Vec::new()),
    };
    let scale = numbers(Tag::ModelPixelScaleTag)?;
    let tie = numbers(Tag::ModelTiepointTag)?;
    let keys: Vec<u8> = match tiff.find_tag(Tag::GeoKeyDirectoryTag).map_err(bad)? {
        Some(value) => value.into_u16_vec().map_err(bad)?.into_iter().flat_map(u16::to_le_bytes).collect(),
        None => Vec::new(),
    };
    let nodata = tiff.find_tag(Tag::GdalNodata).map_err(bad)?.and_then(|value| value.into_string().ok());
    let nodata = nodata.and_then(|text| text.trim_matches(['\0', ' ']).parse::<f64>().ok());
    let &[east_step_m, south_step_m, ..] = scale.as_slice() else {
        return Err(Error::unusable(path, "the GeoTIFF has no cell size (ModelPixelScale)", REMEDY));
    };
    let &[column, row, _, east_m, north_m, ..] = tie.as_slice() else {
        return Err(Error::unusable(path, "the GeoTIFF has no tie point (ModelTiepoint)", REMEDY));
    };
    let is_sound = |step: f64| step > 0.0 && step.is_finite();
    if !(is_sound(east_step_m) && is_sound(south_step_m) && east_m.is_finite() && north_m.is_finite()) {
        return Err(Error::unusable(
            path,
            format!("invalid cell size {east_step_m} by {south_step_m} m"),
            REMEDY,
        ));
    }
    // The tie point is the corner or the centre of its cell.
    let half = if geokeys::is_point_raster(&keys) { 0.0 } else { 0.5 };
    let first_m = [east_m + (half - column) * east_step_m, north_m - (half - row) * south_step_m];
    let heights_m = heights(tiff.read_image().map_err(bad)?, nodata).ok_or_else(|| {
        Error::unusable(path, "the sample type of the GeoTIFF is not supported for heights", REMEDY)
    })?;
    let step_m = [east_step_m, south_step_m];
    Ok(Raster { columns, rows, first_m, step_m, heights_m, epsg: geokeys::epsg(&keys) })
}

/// Converts heights of any sample type to `f32`.
///
/// NaN if missing.
fn heights(image: DecodingResult, nodata: Option<f64>) -> Option<Vec<f32>> {
    fn all<T: Copy + Into<f64>>(values: &[T], nodata: Option<f64>) -> Vec<f32> {
        let height = |&value: &T| {
            let value = value.into();
            if nodata == Some(value) { f32::NAN } else { value as f32 }
        };
        values.iter().map(height).collect()
    }
    // A marker such as -3.4028235e38 has only the digits of an `f32`.
    let nodata_f32 = nodata.map(|nodata| f64::from(nodata as f32));
    Some(match image {
        DecodingResult::U8(values) => all(&values, nodata),
        DecodingResult::I8(values) => all(&values, nodata),
        DecodingResult::U16(values) => all(&values, nodata),
        DecodingResult::I16(values) => all(&values, nodata),
        DecodingResult::U32(values) => all(&values, nodata),
        DecodingResult::I32(values) => all(&values, nodata),
        DecodingResult::F32(values) => all(&values, nodata_f32),
        DecodingResult::F64(values) => all(&values, nodata),
        _ => return None,
    })
}
