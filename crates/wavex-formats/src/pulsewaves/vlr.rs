//! Variable length records, before the pulses and appended after them.

use std::collections::BTreeMap;
use std::io::{Read, Seek};
use std::path::Path;

use super::descriptor::{DESCRIPTION_BYTES, PulseDescriptor, record};
use super::header::PulseHeader;
use super::table::LookupRecord;
use super::window::FileWindow;
use super::zip::PulseZip;
use crate::bytes::Fields;
use crate::{Error, Result};

/// Size of a record header or footer, bytes.
///
/// Appended records have a footer.
const HEADER_BYTES: usize = 96;
/// User ID of the records defined by the specification.
const SPEC: &str = "PulseWaves_Spec";
/// User IDs of the coordinate reference system.
///
/// The second is the user ID in LAS.
const PROJECTION: [&str; 2] = ["PulseWaves_Proj", "LASF_Projection"];
/// Record ID of the description of compressed pulses.
const COMPRESSED: u32 = 5;
/// Record ID of the empty record before the appended ones.
const FIRST_APPENDED: u32 = u32::MAX;
/// Largest payload that is read, bytes.
///
/// Far above any table or descriptor.
const MOST_PAYLOAD: u64 = 1 << 24;
/// Maximum number of appended records.
const MOST_APPENDED: usize = 1024;
/// Size of a scanner record, description included, bytes.
const SCANNER_BYTES: u32 = 248;

const CUT: &str = "the file is damaged: copy or export it again";

/// Location of a variable length record (specification 0.3, "Variable Length Records").
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Record {
    /// User ID: the organisation that defined the record.
    pub user_id: String,
    /// Record ID within the user ID.
    pub record_id: u32,
    /// Description of the record.
    pub description: String,
    /// Offset of the payload in the pulse file, bytes.
    pub offset: u64,
    /// Size of the payload, bytes.
    pub length: u64,
    /// Whether the record follows the pulses.
    pub appended: bool,
}

/// Scanner (`PulseWaves_Spec` 100001 to 100255; specification 0.3, "Scanner").
///
/// Numbers are 0 if not set by the writer.
#[derive(Debug, Clone, PartialEq)]
pub struct ScannerRecord {
    /// Model name.
    pub instrument: String,
    /// Serial number.
    pub serial: String,
    /// Wavelength of the laser, nm.
    pub wave_length_nm: f64,
    /// Full width at half maximum of the outgoing pulse, ns.
    ///
    /// "nanometer" in the specification is an error.
    pub outgoing_pulse_width_ns: f64,
    /// Scan pattern: 0 undefined, 1 oscillating, 2 line, 3 conic.
    pub scan_pattern: u32,
    /// Number of mirror facets.
    pub mirror_facets: u32,
    /// Scan frequency, Hz.
    ///
    /// Of two RIEGL files, one holds lines per second (160) and one ten times that (966.7).
    pub scan_frequency_hz: f64,
    /// Smallest scan angle, degrees.
    pub scan_angle_min_deg: f64,
    /// Largest scan angle, degrees.
    pub scan_angle_max_deg: f64,
    /// Pulse repetition frequency, kHz.
    pub pulse_frequency_khz: f64,
    /// Beam diameter at the exit, mm.
    pub beam_diameter_mm: f64,
    /// Beam divergence, mrad.
    pub beam_divergence_mrad: f64,
    /// Smallest range, m.
    pub range_min_m: f64,
    /// Largest range, m.
    pub range_max_m: f64,
    /// Description of the scanner.
    pub description: String,
}

/// Coordinate reference system as stored, with raw payloads.
///
/// Records of `PulseWaves_Proj` or `LASF_Projection`; GeoTIFF keys as in LAS 1.4 R11.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct StoredCrs {
    /// GeoKeyDirectory (34735): little-endian u16, four for the directory and four per key.
    pub geo_keys: Option<Vec<u8>>,
    /// GeoDoubleParams (34736): little-endian f64.
    pub geo_doubles: Option<Vec<u8>>,
    /// GeoAsciiParams (34737).
    pub geo_ascii: Option<Vec<u8>>,
    /// Math transform as WKT (2111).
    pub math_transform_wkt: Option<String>,
    /// Coordinate system as WKT (2112).
    pub wkt: Option<String>,
}

/// Content of all records of a file.
#[derive(Debug, Default)]
pub(super) struct RecordSet {
    pub(super) list: Vec<Record>,
    pub(super) scanners: BTreeMap<u8, ScannerRecord>,
    pub(super) descriptors: BTreeMap<u8, PulseDescriptor>,
    pub(super) tables: BTreeMap<u8, LookupRecord>,
    pub(super) crs: StoredCrs,
    /// Description of compressed pulses.
    pub(super) zip: Option<PulseZip>,
    /// Offset of the appended records, if any.
    pub(super) appended_at: Option<u64>,
}

impl RecordSet {
    /// Reads all records of the pulse file.
    ///
    /// An appended record replaces one of the same ID.
    pub(super) fn read<R: Read + Seek>(
        window: &mut FileWindow<R>,
        header: &PulseHeader,
    ) -> Result<RecordSet> {
        let mut records = RecordSet::default();
        let mut at = u64::from(header.header_size);
        for number in 0..header.vlr_count {
            let record = read_header(window, header, number, at)?;
            at = record.offset + record.length;
            records.keep(window, header, record)?;
        }
        let (appended_at, appended) = find_appended(window, header.offset_to_pulses)?;
        records.appended_at = appended_at;
        for record in appended.into_iter().rev() {
            records.keep(window, header, record)?;
        }
        Ok(records)
    }

    /// Stores the record and, if it is known, its content.
    fn keep<R: Read + Seek>(
        &mut self,
        window: &mut FileWindow<R>,
        header: &PulseHeader,
        record: Record,
    ) -> Result<()> {
        if record.user_id == SPEC && record.record_id == COMPRESSED {
            let (file, bytes) = payload(window, &record)?;
            self.zip = Some(PulseZip::parse(Fields::new(file, record.offset, bytes), header)?);
        } else if record.user_id == SPEC {
            self.keep_defined(window, &record)?;
        } else if PROJECTION.contains(&record.user_id.as_str()) {
            self.keep_projection(window, &record)?;
        }
        self.list.push(record);
        Ok(())
    }

    fn keep_defined<R: Read + Seek>(&mut self, window: &mut FileWindow<R>, record: &Record) -> Result<()> {
        let base = record.offset;
        if let Some(index) = index(record.record_id, 100_000) {
            let (file, bytes) = payload(window, record)?;
            self.scanners.insert(index, ScannerRecord::parse(file, base, bytes)?);
        } else if let Some(index) = index(record.record_id, 200_000) {
            let (file, bytes) = payload(window, record)?;
            self.descriptors.insert(index, PulseDescriptor::parse(file, base, bytes)?);
        } else if let Some(index) = index(record.record_id, 300_000) {
            let (file, bytes) = payload(window, record)?;
            self.tables.insert(index, LookupRecord::parse(file, base, bytes)?);
        }
        Ok(())
    }

    fn keep_projection<R: Read + Seek>(&mut self, window: &mut FileWindow<R>, record: &Record) -> Result<()> {
        let slot = match record.record_id {
            34735 => &mut self.crs.geo_keys,
            34736 => &mut self.crs.geo_doubles,
            34737 => &mut self.crs.geo_ascii,
            2111 => return text(window, record).map(|wkt| self.crs.math_transform_wkt = Some(wkt)),
            2112 => return text(window, record).map(|wkt| self.crs.wkt = Some(wkt)),
            _ => return Ok(()),
        };
        *slot = Some(payload(window, record)?.1.to_vec());
        Ok(())
    }
}

impl ScannerRecord {
    /// Parses the payload of a scanner record at byte `base` of `file`.
    fn parse(file: &Path, base: u64, payload: &[u8]) -> Result<ScannerRecord> {
        let mut f = Fields::new(file, base, payload);
        let (mut f, description) = record(file, &mut f, "scanner", SCANNER_BYTES)?;
        f.skip(8, "scanner: size, reserved")?;
        let float = |f: &mut Fields<'_>, field: &str| f.f32(field).map(f64::from);
        Ok(ScannerRecord {
            instrument: f.text(DESCRIPTION_BYTES, "instrument")?,
            serial: f.text(DESCRIPTION_BYTES, "serial")?,
            wave_length_nm: float(&mut f, "wave length")?,
            outgoing_pulse_width_ns: float(&mut f, "outgoing pulse width")?,
            scan_pattern: f.u32("scan pattern")?,
            mirror_facets: f.u32("number of mirror facets")?,
            scan_frequency_hz: float(&mut f, "scan frequency")?,
            scan_angle_min_deg: float(&mut f, "scan angle min")?,
            scan_angle_max_deg: float(&mut f, "scan angle max")?,
            pulse_frequency_khz: float(&mut f, "pulse frequency")?,
            beam_diameter_mm: float(&mut f, "beam diameter at exit aperture")?,
            beam_divergence_mrad: float(&mut f, "beam divergence")?,
            range_min_m: float(&mut f, "minimal range")?,
            range_max_m: float(&mut f, "maximal range")?,
            description,
        })
    }
}

/// Returns the index, 1 to 255, of a record ID.
///
/// The ID counts from `base`.
fn index(record_id: u32, base: u32) -> Option<u8> {
    record_id.checked_sub(base).and_then(|i| u8::try_from(i).ok()).filter(|&i| i > 0)
}

/// Parses a record's header or footer.
///
/// User ID, record ID, payload length, description.
fn parse(file: &Path, base: u64, bytes: &[u8]) -> Result<(String, u32, i64, String)> {
    let mut f = Fields::new(file, base, bytes);
    let user_id = f.text(16, "user ID")?;
    let record_id = f.u32("record ID")?;
    f.skip(4, "reserved")?;
    let length = f.i64("record length")?;
    Ok((user_id, record_id, length, f.text(DESCRIPTION_BYTES, "description")?))
}

/// Reads the record header at byte `at`.
///
/// The record must end before the pulses.
fn read_header<R: Read + Seek>(
    window: &mut FileWindow<R>,
    header: &PulseHeader,
    number: u32,
    at: u64,
) -> Result<Record> {
    let file = window.file().to_path_buf();
    let end = header.offset_to_pulses;
    let bad = |at: u64, field: &str, problem: String| {
        Error::malformed(&file, at, format!("variable length record {number}: {field}"), problem, CUT)
    };
    if end.saturating_sub(at) < HEADER_BYTES as u64 {
        let problem = format!("{HEADER_BYTES} bytes needed, but the pulses start at byte {end}");
        return Err(bad(at, "header", problem));
    }
    let (_, bytes) = window.bytes(at, HEADER_BYTES, "variable length record")?;
    let (user_id, record_id, length, description) = parse(&file, at, bytes)?;
    let offset = at + HEADER_BYTES as u64;
    let length = u64::try_from(length).ok().filter(|&l| l <= end - offset).ok_or_else(|| {
        bad(at + 24, "record length after header", format!("{length} does not fit before the pulses"))
    })?;
    Ok(Record { user_id, record_id, description, offset, length, appended: false })
}

/// Finds the appended records.
///
/// Follows them from the end of the file to the marker after the pulses. Returns their start and
/// all of them except the marker, the last in the file first. A chain that does not reach the
/// marker is ignored.
fn find_appended<R: Read + Seek>(
    window: &mut FileWindow<R>,
    offset_to_pulses: u64,
) -> Result<(Option<u64>, Vec<Record>)> {
    let mut end = window.length();
    let mut records = Vec::new();
    while records.len() <= MOST_APPENDED {
        let Some(footer) = end.checked_sub(HEADER_BYTES as u64).filter(|&at| at >= offset_to_pulses) else {
            break;
        };
        let (file, bytes) = window.bytes(footer, HEADER_BYTES, "appended record")?;
        let (user_id, record_id, length, description) = parse(file, footer, bytes)?;
        if user_id == SPEC && record_id == FIRST_APPENDED && length == 0 {
            return Ok((Some(footer), records));
        }
        let start = u64::try_from(length).ok().and_then(|l| footer.checked_sub(l));
        let Some(offset) = start.filter(|&s| s >= offset_to_pulses && !user_id.is_empty()) else { break };
        let length = footer - offset;
        records.push(Record { user_id, record_id, description, offset, length, appended: true });
        end = offset;
    }
    Ok((None, Vec::new()))
}

/// Reads the payload of a record.
///
/// Also returns the file name.
fn payload<'w, R: Read + Seek>(
    window: &'w mut FileWindow<R>,
    record: &Record,
) -> Result<(&'w Path, &'w [u8])> {
    let field = format!("record {} of {}", record.record_id, record.user_id);
    if record.length > MOST_PAYLOAD {
        let problem = format!("its {} bytes exceed the limit of {MOST_PAYLOAD}", record.length);
        return Err(Error::malformed(window.file(), record.offset, field, problem, CUT));
    }
    window.bytes(record.offset, record.length as usize, &field)
}

/// Reads a payload as text up to its first zero.
fn text<R: Read + Seek>(window: &mut FileWindow<R>, record: &Record) -> Result<String> {
    let (file, bytes) = payload(window, record)?;
    Fields::new(file, record.offset, bytes).text(bytes.len(), "WKT")
}
