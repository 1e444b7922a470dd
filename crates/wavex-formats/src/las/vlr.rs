//! Variable length records.
//!
//! LAS 1.4 R15, sections "Variable Length Records (VLRs)" and "Extended Variable Length Records
//! (EVLRs)".

use std::io::{BufRead, Read, Seek, SeekFrom};
use std::path::Path;

use wavex_geodesy::crs::GeoKeys;

use super::header::LasHeader;
use crate::bytes::{Fields, text};
use crate::{Error, RecordedCrs, Result};

/// Length of a VLR header, bytes.
pub(super) const VLR_HEADER: u64 = 54;
/// Length of an EVLR header, bytes.
pub(super) const EVLR_HEADER: u64 = 60;
/// User ID of the records defined by the specification.
pub(super) const SPEC: &str = "LASF_Spec";
/// User ID of the coordinate system records.
pub(super) const PROJECTION: &str = "LASF_Projection";
/// Record ID of the extra bytes descriptors, under [`SPEC`].
pub(super) const EXTRA_BYTES: u16 = 4;
/// Record ID of the waveform packets, under [`SPEC`].
pub(super) const WAVEFORM_PACKETS: u16 = 65535;
/// Record ID of the GeoTIFF key directory, under [`PROJECTION`].
pub(super) const GEO_KEYS: u16 = 34735;
/// Record ID of the numbers of GeoTIFF keys.
pub(super) const GEO_DOUBLES: u16 = 34736;
/// Record ID of the texts of GeoTIFF keys.
pub(super) const GEO_ASCII: u16 = 34737;
/// Record ID of a WKT coordinate system, under [`PROJECTION`].
pub(super) const WKT: u16 = 2112;

/// Longest extended record whose data are read, bytes.
///
/// No record used by wavex is longer.
const EVLR_DATA_LIMIT: u64 = 16 << 20;

/// Variable length record, extended or not.
#[derive(Debug, Clone, PartialEq)]
pub struct Vlr {
    /// User ID: the organisation that defined the record.
    pub user_id: String,
    /// Record ID within the user ID.
    pub record_id: u16,
    /// Free text.
    pub description: String,
    /// Offset of the data from the beginning of the file, bytes.
    pub offset: u64,
    /// Declared length of the data, bytes.
    pub length: u64,
    /// Data of the record.
    ///
    /// Empty for waveform packets and for extended records longer than 16 MiB.
    pub data: Vec<u8>,
}

impl Vlr {
    /// Creates a record that is not yet in a file: its offset is 0.
    pub(super) fn new(user_id: &str, record_id: u16, description: &str, data: Vec<u8>) -> Vlr {
        let (user_id, description) = (user_id.to_string(), description.to_string());
        Vlr { user_id, record_id, description, offset: 0, length: data.len() as u64, data }
    }

    /// Encodes header and data as a record before the points.
    ///
    /// # Errors
    /// The length exceeds 65535 bytes; the error names `file`.
    pub(super) fn write(&self, file: &Path) -> Result<Vec<u8>> {
        let length = u16::try_from(self.length).map_err(|_| too_much(file, &self.description))?;
        Ok(self.with_length(&length.to_le_bytes()))
    }

    /// Encodes header and data as an extended record.
    ///
    /// The declared length is [`Vlr::length`]; more data may follow.
    pub(super) fn write_extended(&self) -> Vec<u8> {
        self.with_length(&self.length.to_le_bytes())
    }

    fn with_length(&self, length: &[u8]) -> Vec<u8> {
        let (user_id, description) = (text::<16>(&self.user_id), text::<32>(&self.description));
        let record_id = self.record_id.to_le_bytes();
        [&[0; 2], user_id.as_slice(), &record_id, length, &description, &self.data].concat()
    }

    /// Reads a record header, extended or not; the data are empty.
    fn read(fields: &mut Fields, extended: bool) -> Result<Vlr> {
        fields.skip(2, "reserved")?;
        let user_id = fields.text(16, "user ID")?;
        let record_id = fields.u16("record ID")?;
        let length = if extended {
            fields.u64("record length after header")?
        } else {
            fields.u16("record length after header")?.into()
        };
        let description = fields.text(32, "description")?;
        Ok(Vlr { user_id, record_id, description, offset: fields.offset(), length, data: Vec::new() })
    }

    /// Returns whether the record is `record_id` of `user_id`.
    pub fn is(&self, user_id: &str, record_id: u16) -> bool {
        self.user_id == user_id && self.record_id == record_id
    }

    /// Returns the data as text up to the first zero byte.
    pub fn text(&self) -> String {
        let end = self.data.iter().position(|&byte| byte == 0).unwrap_or(self.data.len());
        String::from_utf8_lossy(&self.data[..end]).into_owned()
    }
}

/// Returns the coordinate reference system of a file's records.
///
/// GeoTIFF keys are preferred only by files of LAS 1.4 on in point formats 0 to 5 without the WKT bit
/// (LAS 1.4 R15, "Global Encoding").
pub(super) fn recorded_crs<'a>(
    header: &LasHeader,
    records: impl Iterator<Item = &'a Vlr> + Clone,
) -> RecordedCrs {
    let of = |id| records.clone().filter(move |vlr| vlr.is(PROJECTION, id));
    let texts = || of(WKT).map(Vlr::text);
    let wkt = texts().find(|text| !text.trim().is_empty()).or_else(|| texts().next());
    let data = |id| of(id).next().map(|vlr| vlr.data.clone());
    let keys = data(GEO_KEYS).map(|directory| GeoKeys {
        directory,
        doubles: data(GEO_DOUBLES).unwrap_or_default(),
        ascii: data(GEO_ASCII).unwrap_or_default(),
    });
    let prefers_keys = header.version >= (1, 4) && !header.says_wkt() && header.point_format <= 5;
    let centre = std::array::from_fn(|axis| f64::midpoint(header.min[axis], header.max[axis]));
    RecordedCrs::new(wkt.as_deref(), keys.as_ref(), prefers_keys, centre)
}

/// Reads the VLRs between the header and the points.
///
/// # Errors
/// A record does not fit between the header and the points.
pub(super) fn read_vlrs(
    input: &mut (impl BufRead + Seek),
    file: &Path,
    header: &LasHeader,
) -> Result<Vec<Vlr>> {
    let (mut at, end) = (u64::from(header.header_size), u64::from(header.offset_to_points));
    seek(input, file, at)?;
    let mut vlrs = Vec::new();
    for number in 1..=header.n_vlrs {
        let bytes: [u8; VLR_HEADER as usize] = read_header(input, file, at, end, number)?;
        let mut vlr = Vlr::read(&mut Fields::new(file, at, &bytes), false)?;
        if vlr.length > end - vlr.offset {
            return Err(too_long(file, at + 20, &vlr, end));
        }
        vlr.data = read_data(input, file, vlr.length)?;
        at = vlr.offset + vlr.length;
        vlrs.push(vlr);
    }
    Ok(vlrs)
}

/// Reads the EVLRs after the points.
///
/// # Errors
/// A record does not fit into the file.
pub(super) fn read_evlrs(
    input: &mut (impl BufRead + Seek),
    file: &Path,
    header: &LasHeader,
    file_length: u64,
) -> Result<Vec<Vlr>> {
    let mut at = header.start_of_evlrs;
    let mut evlrs = Vec::new();
    for number in 1..=header.n_evlrs {
        // Offsets beyond the end of the file are reported when the record is read.
        seek(input, file, at.min(file_length))?;
        let evlr = read_evlr(input, file, at, file_length, number)?;
        at = evlr.offset + evlr.length;
        evlrs.push(evlr);
    }
    Ok(evlrs)
}

/// Reads the extended record at byte `at`.
///
/// `at` is the position of the input. Long data are not read.
pub(super) fn read_evlr(
    input: &mut impl Read,
    file: &Path,
    at: u64,
    file_length: u64,
    number: u32,
) -> Result<Vlr> {
    let bytes: [u8; EVLR_HEADER as usize] = read_header(input, file, at, file_length, number)?;
    let mut evlr = Vlr::read(&mut Fields::new(file, at, &bytes), true)?;
    if evlr.length > file_length - evlr.offset {
        return Err(too_long(file, at + 20, &evlr, file_length));
    }
    if !evlr.is(SPEC, WAVEFORM_PACKETS) && evlr.length <= EVLR_DATA_LIMIT {
        evlr.data = read_data(input, file, evlr.length)?;
    }
    Ok(evlr)
}

/// Returns the waveform packet record at byte `at`.
///
/// `None` if it is another record.
///
/// # Errors
/// The record is longer than the file.
pub(super) fn waveform_record(
    input: &mut (impl Read + Seek),
    file: &Path,
    at: u64,
    file_length: u64,
) -> Result<Option<Vlr>> {
    if file_length.saturating_sub(at) < EVLR_HEADER {
        return Ok(None);
    }
    seek(input, file, at)?;
    let bytes: [u8; EVLR_HEADER as usize] = read_header(input, file, at, file_length, 1)?;
    let vlr = Vlr::read(&mut Fields::new(file, at, &bytes), true)?;
    if !vlr.is(SPEC, WAVEFORM_PACKETS) {
        return Ok(None);
    }
    if vlr.length > file_length - vlr.offset {
        return Err(too_long(file, at + 20, &vlr, file_length));
    }
    Ok(Some(vlr))
}

fn read_header<const N: usize>(
    input: &mut impl Read,
    file: &Path,
    at: u64,
    end: u64,
    number: u32,
) -> Result<[u8; N]> {
    if end.saturating_sub(at) < N as u64 {
        let problem = format!("record {number} needs {N} bytes, {} left", end.saturating_sub(at));
        return Err(Error::malformed(file, at, "variable length record", problem, CUT));
    }
    let mut bytes = [0; N];
    input.read_exact(&mut bytes).map_err(Error::io(file, "read the variable length records"))?;
    Ok(bytes)
}

/// Reads `length` bytes.
///
/// The caller has checked `length` against the file.
fn read_data(input: &mut impl Read, file: &Path, length: u64) -> Result<Vec<u8>> {
    let mut data = Vec::new();
    input.take(length).read_to_end(&mut data).map_err(Error::io(file, "read the variable length records"))?;
    Ok(data)
}

fn seek(input: &mut impl Seek, file: &Path, at: u64) -> Result<()> {
    input.seek(SeekFrom::Start(at)).map(drop).map_err(Error::io(file, "seek to the variable length records"))
}

const CUT: &str = "the header is wrong or the file is cut off: copy it again from its source";

fn too_long(file: &Path, at: u64, vlr: &Vlr, end: u64) -> Error {
    let problem =
        format!("{}/{} declares {} bytes, {} left", vlr.user_id, vlr.record_id, vlr.length, end - vlr.offset);
    Error::malformed(file, at, "record length after header", problem, CUT)
}

/// Creates the error for `content` that is too long for a record.
pub(super) fn too_much(file: &Path, content: &str) -> Error {
    let problem = format!("{content}: more than the 65535 bytes that a LAS record may have");
    Error::unusable(file, problem, "give a shorter WKT, or fewer extra attributes")
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn a_written_record_reads_as_the_same(
            user_id in "[a-zA-Z_ ]{0,16}",
            record_id in any::<u16>(),
            description in "[a-zA-Z ]{0,32}",
            data in prop::collection::vec(any::<u8>(), 0..200),
        ) {
            let (file, vlr) = (Path::new("a.las"), Vlr::new(&user_id, record_id, &description, data));
            for (bytes, is_extended) in [(vlr.write(file).unwrap(), false), (vlr.write_extended(), true)] {
                let mut fields = Fields::new(file, 0, &bytes);
                let read = Vlr::read(&mut fields, is_extended).unwrap();
                let data = fields.take(fields.left(), "data").unwrap().to_vec();
                prop_assert_eq!(read.offset, if is_extended { EVLR_HEADER } else { VLR_HEADER });
                prop_assert_eq!(Vlr { data, offset: 0, ..read }, vlr.clone());
            }
        }
    }
}
