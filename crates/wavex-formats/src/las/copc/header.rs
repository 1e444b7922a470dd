//! COPC header, VLRs and EVLRs.

use std::path::Path;

use laz::LazVlr;

use super::cube::{self, CELL_LEVELS, Cube};
use super::{COPC, Extent, Reshape, encoding, into_io, is_left_out};
use crate::las::header::{HEADER_1_4, Header};
use crate::las::vlr::{EVLR_HEADER, PROJECTION, VLR_HEADER, Vlr, WKT};
use crate::las::writer::{evlr, text, vlr};
use crate::{Error, Result};

/// Length of the record `copc`/1, bytes: COPC 1.0, "info VLR".
const INFO_BYTES: usize = 160;
/// Record IDs of the info and of the octree.
const INFO: u16 = 1;
const HIERARCHY: u16 = 1000;

/// Octree node as stored in the file.
///
/// COPC 1.0, "hierarchy VLR".
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Entry {
    pub(super) level: u32,
    pub(super) prefix: u64,
    /// Offset of its chunk in the file.
    pub(super) at: u64,
    pub(super) bytes: i32,
    pub(super) points: i32,
}

/// Encoded octree record, and offset of its entries in the file.
pub(super) struct Hierarchy {
    pub(super) record: Vec<u8>,
    at: u64,
    bytes: u64,
}

/// Encodes the octree as an extended record at byte `at`.
///
/// All nodes are on one page.
pub(super) fn hierarchy(at: u64, entries: &[Entry]) -> Hierarchy {
    let mut data = Vec::with_capacity(entries.len() * 32);
    for entry in entries {
        data.extend((entry.level as i32).to_le_bytes());
        cube::numbers(entry.prefix).iter().for_each(|number| data.extend(number.to_le_bytes()));
        data.extend(entry.at.to_le_bytes());
        data.extend(entry.bytes.to_le_bytes());
        data.extend(entry.points.to_le_bytes());
    }
    let record = evlr(COPC, HIERARCHY, "EPT hierarchy", &data);
    Hierarchy { record, at: at + EVLR_HEADER, bytes: data.len() as u64 }
}

/// Header and records known from the source alone.
pub(super) struct Start {
    /// Header, without fields that are known only at the end.
    header: Vec<u8>,
    /// VLRs after the COPC record.
    vlrs: Vec<u8>,
    /// EVLRs after the octree.
    pub(super) evlrs: Vec<u8>,
    n_evlrs: u32,
    times: [f64; 2],
}

impl Start {
    /// Copies header and records that are valid for COPC.
    ///
    /// # Errors
    /// A record cannot be copied, or there are too many.
    pub(super) fn new(
        source: &Path,
        header: &Header,
        records: (&[Vlr], &Reshape),
        extent: &Extent,
    ) -> Result<Start> {
        let (vlrs, reshape) = records;
        let kept: Vec<&Vlr> = vlrs.iter().filter(|vlr| !is_left_out(vlr)).collect();
        let mut start = Start {
            header: Vec::new(),
            vlrs: Vec::new(),
            evlrs: Vec::new(),
            n_evlrs: 1,
            times: extent.times,
        };
        let mut n_vlrs = 2;
        start.vlrs.extend(laz_record(source, reshape)?);
        for record in &kept {
            if record.length != record.data.len() as u64 {
                let (id, bytes) = (record.record_id, record.length);
                let problem =
                    format!("its record {}/{id} has {bytes} bytes, which is too long", record.user_id);
                return Err(Error::unusable(source, problem, "remove that record from the file"));
            }
            if record.offset < header.offset_to_points.into() {
                let bytes =
                    vlr(source, &record.user_id, record.record_id, &record.description, &record.data)?;
                start.vlrs.extend(bytes);
                n_vlrs += 1;
            } else {
                start.evlrs.extend(evlr(
                    &record.user_id,
                    record.record_id,
                    &record.description,
                    &record.data,
                ));
                start.n_evlrs += 1;
            }
        }
        let offset_to_points = usize::from(HEADER_1_4) + VLR_HEADER as usize + INFO_BYTES + start.vlrs.len();
        let has_wkt = kept.iter().any(|record| record.is(PROJECTION, WKT));
        start.header = public_header(header, extent, reshape, has_wkt);
        let mut put = |at: usize, bytes: &[u8]| put(&mut start.header, at, bytes);
        put(96, &(offset_to_points as u32).to_le_bytes());
        put(100, &u32::to_le_bytes(n_vlrs));
        Ok(start)
    }

    /// Encodes header and VLRs.
    ///
    /// Fields known only at the end are zero without `end`.
    ///
    /// # Errors
    /// A record is too long.
    pub(super) fn before_points(&self, path: &Path, end: Option<(&Cube, &Hierarchy)>) -> Result<Vec<u8>> {
        let mut bytes = self.header.clone();
        let mut info = vec![0; INFO_BYTES];
        if let Some((cube, hierarchy)) = end {
            put(&mut bytes, 235, &(hierarchy.at - EVLR_HEADER).to_le_bytes());
            put(&mut bytes, 243, &self.n_evlrs.to_le_bytes());
            let spacing = 2.0 * cube.half / f64::from(1u32 << CELL_LEVELS);
            let [x, y, z] = cube.centre;
            let numbers = [x, y, z, cube.half, spacing];
            numbers.iter().enumerate().for_each(|(n, number)| put(&mut info, 8 * n, &number.to_le_bytes()));
            put(&mut info, 40, &hierarchy.at.to_le_bytes());
            put(&mut info, 48, &hierarchy.bytes.to_le_bytes());
            put(&mut info, 56, &self.times[0].to_le_bytes());
            put(&mut info, 64, &self.times[1].to_le_bytes());
        }
        bytes.extend(vlr(path, COPC, INFO, "COPC info VLR", &info)?);
        bytes.extend(&self.vlrs);
        Ok(bytes)
    }
}

fn laz_record(source: &Path, reshape: &Reshape) -> Result<Vec<u8>> {
    let failed = Error::io(source, "prepare the compression of");
    let mut data = Vec::new();
    let laz = reshape.laz().map_err(into_io).and_then(|laz| laz.write_to(&mut data));
    laz.map_err(failed)?;
    vlr(source, LazVlr::USER_ID, LazVlr::RECORD_ID, LazVlr::DESCRIPTION, &data)
}

/// Encodes the public header block of LAS 1.4.
///
/// Valid fields of the source are kept.
fn public_header(source: &Header, extent: &Extent, reshape: &Reshape, has_wkt: bool) -> Vec<u8> {
    let kept = encoding::ADJUSTED_TIME | encoding::SYNTHETIC_RETURNS | encoding::WKT;
    let encoding = source.global_encoding & kept | if has_wkt { encoding::WKT } else { 0 };
    let mut header = Vec::with_capacity(HEADER_1_4.into());
    header.extend(b"LASF");
    header.extend(source.file_source_id.to_le_bytes());
    header.extend(encoding.to_le_bytes());
    header.extend(source.guid);
    header.extend([1, 4]);
    header.extend(text::<32>(&source.system_identifier));
    header.extend(text::<32>(concat!("wavex ", env!("CARGO_PKG_VERSION"))));
    header.extend(source.creation_day.to_le_bytes());
    header.extend(source.creation_year.to_le_bytes());
    header.extend(HEADER_1_4.to_le_bytes());
    header.extend([0; 8]); // offset to point data, number of VLRs
    header.push(reshape.format | 0x80);
    header.extend((reshape.length() as u16).to_le_bytes());
    header.extend([0; 24]); // legacy counts
    source.scale.iter().chain(&source.offset).for_each(|value| header.extend(value.to_le_bytes()));
    let [min, max] = extent.bounds(source);
    for axis in 0..3 {
        header.extend(max[axis].to_le_bytes());
        header.extend(min[axis].to_le_bytes());
    }
    header.extend([0; 20]); // waveforms, EVLRs
    header.extend(extent.n_points.to_le_bytes());
    extent.by_return.iter().for_each(|count| header.extend(count.to_le_bytes()));
    header
}

/// Replaces bytes; ignores bytes beyond the end.
fn put(bytes: &mut [u8], at: usize, value: &[u8]) {
    bytes.iter_mut().skip(at).zip(value).for_each(|(to, from)| *to = *from);
}
