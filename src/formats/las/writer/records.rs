//! The records between the header and the points.

use std::path::Path;

use laz::{LazVlr, LazVlrBuilder};

use super::options::WriterOptions;
use super::{CHUNK, into_io};
use crate::formats::las::ExtraAttribute;
use crate::formats::las::extra_bytes::DESCRIPTOR;
use crate::formats::las::vlr::{EVLR_HEADER, EXTRA_BYTES, GEO_KEYS, PROJECTION, SPEC, VLR_HEADER, WKT};
use crate::formats::{Error, Result, geokeys};

/// How LASzip is to compress the points.
pub(super) fn laz_vlr(path: &Path, options: &WriterOptions) -> Result<LazVlr> {
    let extra = u16::try_from(options.extra_bytes()).map_err(|_| too_much(path, "the extra attributes"))?;
    let builder = LazVlrBuilder::default().with_point_format(options.version.point_format(), extra);
    let builder = builder.map_err(into_io).map_err(Error::io(path, "prepare the compression"))?;
    Ok(builder.with_fixed_chunk_size(CHUNK as u32).build())
}

/// Where the LASzip record, the last before the points, says how many special extended records follow them and where the
/// first is.
pub(super) fn special_evlrs_at(laz: &LazVlr, offset_to_points: usize) -> u64 {
    // 16 bytes before them; behind them the number of items, and 6 bytes for each.
    (offset_to_points - (16 + 2 + 6 * laz.items().len())) as u64
}

/// The records, each with its header.
pub(super) fn vlrs(path: &Path, options: &WriterOptions, laz: Option<&LazVlr>) -> Result<Vec<Vec<u8>>> {
    let mut vlrs = Vec::new();
    if let Some(wkt) = options.wkt {
        vlrs.push(coordinate_system(path, options, wkt)?);
    }
    if !options.extra_attributes.is_empty() {
        let mut data = Vec::with_capacity(options.extra_attributes.len() * DESCRIPTOR);
        options
            .extra_attributes
            .iter()
            .for_each(|attribute: &ExtraAttribute| data.extend(attribute.descriptor()));
        vlrs.push(vlr(path, SPEC, EXTRA_BYTES, "Extra bytes", &data)?);
    }
    if let Some(laz) = laz {
        let mut data = Vec::new();
        laz.write_to(&mut data).map_err(Error::io(path, "prepare the compression"))?;
        vlrs.push(vlr(path, LazVlr::USER_ID, LazVlr::RECORD_ID, LazVlr::DESCRIPTION, &data)?);
    }
    Ok(vlrs)
}

fn coordinate_system(path: &Path, options: &WriterOptions, wkt: &str) -> Result<Vec<u8>> {
    let keys = options.version.is_legacy().then(|| geokeys::directory_of_wkt(wkt)).flatten();
    match keys {
        Some(keys) => vlr(path, PROJECTION, GEO_KEYS, "GeoTIFF keys", &keys),
        None => {
            let data = [wkt.as_bytes(), &[0]].concat();
            vlr(path, PROJECTION, WKT, "OGC coordinate system WKT", &data)
        }
    }
}

fn vlr(path: &Path, user_id: &str, record_id: u16, description: &str, data: &[u8]) -> Result<Vec<u8>> {
    let length = u16::try_from(data.len()).map_err(|_| too_much(path, description))?;
    let mut bytes = Vec::with_capacity(VLR_HEADER as usize + data.len());
    bytes.extend([0; 2]);
    bytes.extend(text::<16>(user_id));
    bytes.extend(record_id.to_le_bytes());
    bytes.extend(length.to_le_bytes());
    bytes.extend(text::<32>(description));
    bytes.extend(data);
    Ok(bytes)
}

fn too_much(path: &Path, what: &str) -> Error {
    let problem = format!("{what}: more than the 65535 bytes that a LAS record may have");
    Error::unusable(path, problem, "give a shorter WKT, or fewer extra attributes")
}

/// An extended record with its header.
pub(super) fn evlr(user_id: &str, record_id: u16, description: &str, data: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(EVLR_HEADER as usize + data.len());
    bytes.extend([0; 2]);
    bytes.extend(text::<16>(user_id));
    bytes.extend(record_id.to_le_bytes());
    bytes.extend((data.len() as u64).to_le_bytes());
    bytes.extend(text::<32>(description));
    bytes.extend(data);
    bytes
}

/// Text of a fixed length, cut or filled with zeros.
pub(super) fn text<const N: usize>(text: &str) -> [u8; N] {
    let mut bytes = [0; N];
    bytes.iter_mut().zip(text.bytes()).for_each(|(place, byte)| *place = byte);
    bytes
}
