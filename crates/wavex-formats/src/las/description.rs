//! Everything about a file but its points.

use std::io::{BufRead, Seek};
use std::path::Path;

use super::extra_bytes::{self, ExtraBytes};
use super::header::LasHeader;
use super::vlr::{self, SPEC, Vlr};
use crate::{RecordedCrs, Result};

/// Header and records of a LAS, LAZ or COPC file.
#[derive(Debug, Clone)]
pub struct LasDescription {
    /// Public header block.
    pub header: LasHeader,
    /// VLRs and EVLRs.
    pub vlrs: Vec<Vlr>,
}

impl LasDescription {
    /// Reads a file of `file_length` bytes from its first byte; `path` names it in errors.
    ///
    /// # Errors
    /// The file is not LAS, is cut off, or has contradictory sizes.
    pub fn read(input: &mut (impl BufRead + Seek), path: &Path, file_length: u64) -> Result<LasDescription> {
        let header = LasHeader::read(input, path, file_length)?;
        let mut vlrs = vlr::read_vlrs(input, path, &header)?;
        vlrs.extend(vlr::read_evlrs(input, path, &header, file_length)?);
        Ok(LasDescription { header, vlrs })
    }

    /// Returns the descriptors of the extra bytes.
    ///
    /// # Errors
    /// A descriptor is cut off.
    pub fn extra_bytes(&self, path: &Path) -> Result<Vec<ExtraBytes>> {
        let record = self.vlrs.iter().find(|vlr| vlr.is(SPEC, vlr::EXTRA_BYTES));
        record.map_or(Ok(Vec::new()), |record| extra_bytes::parse(path, record))
    }

    /// Returns the coordinate reference system, and what is wrong with its records.
    pub fn crs(&self) -> RecordedCrs {
        vlr::recorded_crs(&self.header, self.vlrs.iter())
    }
}
