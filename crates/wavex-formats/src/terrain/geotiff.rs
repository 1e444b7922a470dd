//! GeoTIFF height rasters: one band, or a chosen one, north up.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use tiff::decoder::{Decoder, DecodingResult, Limits};
use tiff::tags::Tag;
use tiff::{ColorType, TiffError};

use super::super::geokeys;
use super::super::{Error, Result, regular_file};
use super::{Raster, checked_size};

/// Largest compression ratio (LZW; deflate is lower).
const DENSEST: u64 = 4096;
/// Largest strip or tile, bytes once decoded; in a longer file it may have the length of the file.
///
/// Uncompressed files often have a single strip.
const LARGEST_CHUNK: u64 = 1 << 26;
/// Smallest growth of the heights, as a fraction of their final number.
const GROWTH: usize = 16;
const GDAL_METADATA: Tag = Tag::Unknown(42112);
const REMEDY: &str = "convert it to a north-up GeoTIFF with one band of heights";

/// Reads a raster of one band.
pub(super) fn read(path: &Path) -> Result<Raster> {
    read_band(path, None)
}

/// Descriptions of the bands, as GDAL and `wavex` store them; those without are empty.
pub(super) fn band_descriptions(path: &Path) -> Result<Vec<String>> {
    let bad = |error: TiffError| Error::unusable(path, format!("cannot read the GeoTIFF: {error}"), REMEDY);
    let mut tiff = Decoder::new(BufReader::new(regular_file(path)?)).map_err(bad)?;
    let bands = tiff.colortype().map_err(bad)?.num_samples();
    let mut descriptions = vec![String::new(); usize::from(bands)];
    let metadata = tiff.find_tag(GDAL_METADATA).map_err(bad)?.and_then(|value| value.into_string().ok());
    for item in metadata.unwrap_or_default().split("<Item ").skip(1) {
        let Some((attributes, rest)) = item.split_once('>') else { continue };
        let sample = attributes.split_once("sample=\"").and_then(|(_, rest)| rest.split('"').next());
        let band = sample.and_then(|sample| sample.parse::<usize>().ok());
        if let Some(description) = band.and_then(|band| descriptions.get_mut(band))
            && attributes.contains("role=\"description\"")
        {
            rest.split('<').next().unwrap_or_default().clone_into(description);
        }
    }
    Ok(descriptions)
}

/// Reads a band from 0, or the only one.
pub(super) fn read_band(path: &Path, band: Option<usize>) -> Result<Raster> {
    let file = regular_file(path)?;
    let length = file.metadata().map_err(Error::io(path, "open"))?.len();
    let bad = |error: TiffError| Error::unusable(path, format!("cannot read the GeoTIFF: {error}"), REMEDY);
    let mut limits = Limits::default();
    let largest_chunk = LARGEST_CHUNK.max(length);
    limits.decoding_buffer_size = usize::try_from(largest_chunk).unwrap_or(usize::MAX);
    let mut tiff = Decoder::new(BufReader::new(file)).map_err(bad)?.with_limits(limits);
    let (columns, rows) = tiff.dimensions().map_err(bad)?;
    let held = length.saturating_mul(DENSEST);
    let (columns, rows) = checked_size(path, u64::from(columns), u64::from(rows), held)?;
    let colours = tiff.colortype().map_err(bad)?;
    let bands = usize::from(colours.num_samples());
    match band {
        None if !matches!(colours, ColorType::Gray(_)) => {
            return Err(Error::unusable(path, "the GeoTIFF has more than one band", REMEDY));
        }
        Some(band) if band >= bands => {
            return Err(Error::unusable(path, format!("the GeoTIFF has no band {}", band + 1), REMEDY));
        }
        _ => {}
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
    let heights_m =
        read_heights(&mut tiff, [columns, rows], [band.unwrap_or(0), bands], nodata).map_err(|failure| {
            match failure {
                HeightsError::SampleType => Error::unusable(
                    path,
                    "the sample type of the GeoTIFF is not supported for heights",
                    REMEDY,
                ),
                HeightsError::Tiff(TiffError::LimitsExceeded) => Error::unusable(
                    path,
                    format!("a strip or tile of the GeoTIFF has over {largest_chunk} bytes"),
                    "write it with tiles",
                ),
                HeightsError::Tiff(error) => bad(error),
            }
        })?;
    let step_m = [east_step_m, south_step_m];
    Ok(Raster { columns, rows, first_m, step_m, heights_m, epsg: geokeys::epsg(&keys) })
}

/// Failure to read the heights.
enum HeightsError {
    Tiff(TiffError),
    /// The samples are no numbers of up to 32 bits, or `f64`.
    SampleType,
}

/// Reads the heights strip by strip or tile by tile: one of the bands, whose values follow each other in a cell.
///
/// Their memory grows with the data read, so that a short file with a wrong size takes little.
fn read_heights(
    tiff: &mut Decoder<BufReader<File>>,
    [columns, rows]: [usize; 2],
    [first, bands]: [usize; 2],
    nodata: Option<f64>,
) -> std::result::Result<Vec<f32>, HeightsError> {
    let mut heights_m: Vec<f32> = Vec::new();
    let (width, height) = tiff.chunk_dimensions();
    let (width, height) = (width.max(1) as usize, height.max(1) as usize);
    let per_band = columns.div_ceil(width);
    for band in 0..rows.div_ceil(height) {
        let (first_row, end_row) = (band * height, ((band + 1) * height).min(rows));
        if heights_m.capacity() < end_row * columns {
            let growth = (columns * rows / GROWTH).max(end_row * columns - heights_m.len());
            heights_m.reserve_exact(growth.min(columns * rows - heights_m.len()));
        }
        heights_m.resize(end_row * columns, f32::NAN);
        for number in 0..per_band {
            let index = u32::try_from(band * per_band + number).unwrap_or(u32::MAX);
            let chunk = tiff.read_chunk(index).map_err(HeightsError::Tiff)?;
            let chunk = heights(chunk, nodata).ok_or(HeightsError::SampleType)?;
            let chunk: Vec<f32> = chunk.into_iter().skip(first).step_by(bands.max(1)).collect();
            let first_column = number * width;
            let width = width.min(columns - first_column);
            for (row, from) in (first_row..end_row).zip(chunk.chunks_exact(width)) {
                let start = row * columns + first_column;
                if let Some(to) = heights_m.get_mut(start..start + width) {
                    to.copy_from_slice(from);
                }
            }
        }
    }
    Ok(heights_m)
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
