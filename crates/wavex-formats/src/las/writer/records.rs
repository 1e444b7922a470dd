//! VLRs of a written file.

use std::path::Path;

use laz::{LazItemType, LazVlr, LazVlrBuilder};

use super::CHUNK;
use super::chunk::into_io;
use super::options::{WavePlace, WriterOptions};
use crate::las::descriptor::{DESCRIPTOR_BYTES, FIRST_DESCRIPTOR, PacketDescriptor};
use crate::las::extra_bytes::ExtraAttribute;
use crate::las::packet_writer::MOST_KINDS;
use crate::las::vlr::{
    EXTRA_BYTES, GEO_ASCII, GEO_DOUBLES, GEO_KEYS, PROJECTION, SPEC, VLR_HEADER, Vlr, WKT, too_much,
};
use crate::{Error, Result, geokeys};

/// Creates the LASzip record for the options.
pub(super) fn laz_vlr(path: &Path, options: &WriterOptions) -> Result<LazVlr> {
    let extra = u16::try_from(options.extra_bytes()).map_err(|_| too_much(path, "the extra attributes"))?;
    let builder = LazVlrBuilder::default().with_point_format(options.point_format(), extra);
    let laz =
        builder.and_then(|builder| as_laszip_has_it(builder.with_fixed_chunk_size(CHUNK as u32).build()));
    laz.map_err(into_io).map_err(Error::io(path, "prepare the compression"))
}

/// Corrects the item versions of legacy waveform formats for LASzip.
///
/// LASzip knows only version 1 of the waveform item of legacy formats, but the `laz` crate labels
/// its identical output version 2. The other items must be version 2, because the crate's version 1
/// of extra bytes differs from LASzip's.
fn as_laszip_has_it(laz: LazVlr) -> laz::Result<LazVlr> {
    let Some(waves) = laz.items().iter().position(|item| item.item_type() == LazItemType::WavePacket13)
    else {
        return Ok(laz);
    };
    let mut data = Vec::new();
    laz.write_to(&mut data)?;
    // Items are at the end, 6 bytes each; the last two are the version.
    let version_at = data.len() - 6 * (laz.items().len() - waves) + 4;
    data[version_at..version_at + 2].copy_from_slice(&1u16.to_le_bytes());
    LazVlr::from_buffer(&data)
}

/// Encodes the LASzip record.
pub(in crate::las) fn laz_record(path: &Path, laz: &LazVlr) -> Result<Vec<u8>> {
    let mut data = Vec::new();
    laz.write_to(&mut data).map_err(Error::io(path, "prepare the compression"))?;
    Vlr::new(LazVlr::USER_ID, LazVlr::RECORD_ID, LazVlr::DESCRIPTION, data).write(path)
}

/// Encoded VLRs, and offsets in them that are patched later.
pub(super) struct EncodedVlrs {
    /// VLRs with their headers, then space for the waveform descriptors.
    pub(super) bytes: Vec<u8>,
    /// Number of VLRs so far.
    pub(super) count: u32,
    /// Offset of the space for waveform descriptors.
    pub(super) descriptors_at: usize,
    /// Offset of the special EVLR fields in the LASzip record.
    pub(super) special_evlrs_at: usize,
}

/// Length of the LASzip record before its special EVLR fields, bytes.
const BEFORE_SPECIAL_EVLRS: usize = 16;

impl EncodedVlrs {
    pub(super) fn new(path: &Path, options: &WriterOptions, laz: Option<&LazVlr>) -> Result<EncodedVlrs> {
        let mut records = EncodedVlrs { bytes: Vec::new(), count: 0, descriptors_at: 0, special_evlrs_at: 0 };
        if let Some(wkt) = options.wkt {
            for record in coordinate_system(path, options, wkt)? {
                records.add(record);
            }
        }
        if !options.extra_attributes.is_empty() {
            let data: Vec<u8> =
                options.extra_attributes.iter().flat_map(ExtraAttribute::descriptor).collect();
            records.add(Vlr::new(SPEC, EXTRA_BYTES, "Extra bytes", data).write(path)?);
        }
        if let Some(laz) = laz {
            records.special_evlrs_at = records.bytes.len() + VLR_HEADER as usize + BEFORE_SPECIAL_EVLRS;
            records.add(laz_record(path, laz)?);
        }
        records.descriptors_at = records.bytes.len();
        if options.waveforms != WavePlace::None {
            let room = MOST_KINDS * (VLR_HEADER as usize + DESCRIPTOR_BYTES);
            records.bytes.resize(records.bytes.len() + room, 0);
        }
        Ok(records)
    }

    fn add(&mut self, record: Vec<u8>) {
        self.bytes.extend(record);
        self.count += 1;
    }
}

/// Encodes the descriptor records of the packet kinds.
pub(super) fn descriptors(path: &Path, kinds: &[PacketDescriptor]) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    for (id, kind) in (FIRST_DESCRIPTOR..).zip(kinds.iter().take(MOST_KINDS)) {
        let data = kind.encode().to_vec();
        bytes.extend(Vlr::new(SPEC, id, "Waveform packet descriptor", data).write(path)?);
    }
    Ok(bytes)
}

/// Encodes the coordinate system.
///
/// WKT, or GeoTIFF keys before LAS 1.4. WKT is also written before LAS 1.4 if no EPSG code defines
/// the whole system.
fn coordinate_system(path: &Path, options: &WriterOptions, wkt: &str) -> Result<Vec<Vec<u8>>> {
    let keys = options.version.is_legacy().then(|| geokeys::from_wkt(wkt)).flatten();
    let has_code = keys.as_ref().is_some_and(|keys| geokeys::epsg(&keys.directory).is_some());
    let mut records = Vec::new();
    if let Some(keys) = keys {
        let of_keys = [
            (GEO_KEYS, "GeoTIFF keys", keys.directory),
            (GEO_DOUBLES, "GeoTIFF double parameters", keys.doubles),
            (GEO_ASCII, "GeoTIFF ASCII parameters", keys.ascii),
        ];
        for (id, description, data) in of_keys.into_iter().filter(|(_, _, data)| !data.is_empty()) {
            records.push(Vlr::new(PROJECTION, id, description, data).write(path)?);
        }
    }
    if !has_code {
        let data = [wkt.as_bytes(), &[0]].concat();
        records.push(Vlr::new(PROJECTION, WKT, "OGC coordinate system WKT", data).write(path)?);
    }
    Ok(records)
}
