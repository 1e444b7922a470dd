//! COPC header, VLRs and EVLRs.

use std::path::Path;

use super::cube::{self, CELL_LEVELS, Cube};
use super::{COPC, PointSums, Reshape, into_io, is_left_out};
use crate::las::encoding;
use crate::las::header::{LasHeader, header_bytes};
use crate::las::vlr::{EVLR_HEADER, PROJECTION, VLR_HEADER, Vlr, WKT, recorded_crs};
use crate::las::writer::laz_record;
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
pub(super) struct HierarchyEntry {
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
pub(super) fn hierarchy(at: u64, entries: &[HierarchyEntry]) -> Hierarchy {
    let mut data = Vec::with_capacity(entries.len() * 32);
    for entry in entries {
        data.extend((entry.level as i32).to_le_bytes());
        cube::numbers(entry.prefix).iter().for_each(|number| data.extend(number.to_le_bytes()));
        data.extend(entry.at.to_le_bytes());
        data.extend(entry.bytes.to_le_bytes());
        data.extend(entry.points.to_le_bytes());
    }
    let record = Vlr::new(COPC, HIERARCHY, "EPT hierarchy", data);
    Hierarchy { record: record.write_extended(), at: at + EVLR_HEADER, bytes: record.length }
}

/// Header and records known from the source alone.
pub(super) struct Metadata {
    /// Header, without fields that are known only at the end.
    header: LasHeader,
    /// VLRs after the COPC record.
    vlrs: Vec<u8>,
    /// EVLRs after the octree.
    pub(super) evlrs: Vec<u8>,
    n_evlrs: u32,
    times: [f64; 2],
    /// Problems of the records of the coordinate reference system.
    pub(super) crs_problems: Vec<String>,
}

impl Metadata {
    /// Copies header and records that are valid for COPC.
    ///
    /// # Errors
    /// A record cannot be copied, or there are too many.
    pub(super) fn new(
        source: &Path,
        header: &LasHeader,
        records: (&[Vlr], &Reshape),
        extent: &PointSums,
    ) -> Result<Metadata> {
        let (of_source, reshape) = records;
        let crs = recorded_crs(header, of_source.iter());
        // Point formats 6 to 8 allow no GeoTIFF keys.
        let is_replaced = |vlr: &Vlr| crs.is_of_keys && vlr.user_id == PROJECTION;
        let kept: Vec<&Vlr> = of_source.iter().filter(|vlr| !is_left_out(vlr) && !is_replaced(vlr)).collect();
        let laz = reshape.laz().map_err(into_io).map_err(Error::io(source, "prepare the compression"))?;
        let (mut vlrs, mut n_vlrs) = (laz_record(source, &laz)?, 2);
        let (mut evlrs, mut n_evlrs) = (Vec::new(), 1);
        for record in &kept {
            if record.length != record.data.len() as u64 {
                let (id, bytes) = (record.record_id, record.length);
                let problem =
                    format!("its record {}/{id} has {bytes} bytes, which is too long", record.user_id);
                return Err(Error::unusable(source, problem, "remove that record from the file"));
            }
            if record.offset < header.offset_to_points.into() {
                vlrs.extend(record.write(source)?);
                n_vlrs += 1;
            } else {
                evlrs.extend(record.write_extended());
                n_evlrs += 1;
            }
        }
        if let Some(wkt) = crs.wkt.as_ref().filter(|_| crs.is_of_keys) {
            let data = [wkt.as_bytes(), &[0]].concat();
            vlrs.extend(Vlr::new(PROJECTION, WKT, "OGC coordinate system WKT", data).write(source)?);
            n_vlrs += 1;
        }
        let has_wkt = crs.wkt.is_some();
        let mut header = public_header(header, extent, reshape, has_wkt);
        let vlr_bytes = VLR_HEADER as usize + INFO_BYTES + vlrs.len();
        header.offset_to_points = u32::from(header.header_size) + vlr_bytes as u32;
        header.n_vlrs = n_vlrs;
        Ok(Metadata { header, vlrs, evlrs, n_evlrs, times: extent.times, crs_problems: crs.problems })
    }

    /// Encodes header and VLRs.
    ///
    /// Fields known only at the end are zero without `end`.
    ///
    /// # Errors
    /// A record is too long.
    pub(super) fn before_points(&self, path: &Path, end: Option<(&Cube, &Hierarchy)>) -> Result<Vec<u8>> {
        let mut header = self.header.clone();
        let mut info = Vec::with_capacity(INFO_BYTES);
        if let Some((cube, hierarchy)) = end {
            header.start_of_evlrs = hierarchy.at - EVLR_HEADER;
            header.n_evlrs = self.n_evlrs;
            let spacing = 2.0 * cube.half / f64::from(1u32 << CELL_LEVELS);
            let [x, y, z] = cube.centre;
            [x, y, z, cube.half, spacing].iter().for_each(|number| info.extend(number.to_le_bytes()));
            info.extend(hierarchy.at.to_le_bytes());
            info.extend(hierarchy.bytes.to_le_bytes());
            self.times.iter().for_each(|time| info.extend(time.to_le_bytes()));
        }
        info.resize(INFO_BYTES, 0);
        let info = Vlr::new(COPC, INFO, "COPC info VLR", info).write(path)?;
        Ok([header.write(), info, self.vlrs.clone()].concat())
    }
}

/// Creates the public header block of LAS 1.4.
///
/// Valid fields of the source are kept.
fn public_header(source: &LasHeader, extent: &PointSums, reshape: &Reshape, has_wkt: bool) -> LasHeader {
    let kept = encoding::ADJUSTED_TIME | encoding::SYNTHETIC_RETURNS | encoding::WKT;
    let mut header = LasHeader {
        global_encoding: source.global_encoding & kept | if has_wkt { encoding::WKT } else { 0 },
        version: (1, 4),
        generating_software: concat!("wavex ", env!("CARGO_PKG_VERSION")).into(),
        header_size: header_bytes(4),
        point_format: reshape.format,
        compressed: true,
        record_length: reshape.length() as u16,
        start_of_waveforms: 0,
        start_of_evlrs: 0,
        n_evlrs: 0,
        ..source.clone()
    };
    extent.totals.store(&mut header);
    header
}
