//! PulseWaves 0.3: pulses (`.pls`) and their waves (`.wvs`), both also compressed (`.plz`, `.wvz`).
//!
//! The layout follows the open specification (rapidlasso, "PulseWaves - Full Waveform LiDAR
//! Specification", version 0.3 revision 6). It includes extensions of the reference library,
//! revisions 7 to 11: lookup tables, signed durations, and the order of two fields of a descriptor.
//! All numbers are little-endian. The compression is PulseTools': pulses in chunks, and the waves of each
//! pulse on their own.
//!
//! A pulse record has an anchor, a target 1000 sampling units further along the beam, and an offset
//! to its waves; its descriptor defines their layout. A faulty header or VLR is an error of the
//! file. A fault in one pulse is an error of that pulse only; the next can be read.
//!
//! ```no_run
//! use wavex_formats::pulsewaves::{Reader, WaveSegments};
//!
//! let (mut reader, mut waves) = (Reader::open("flight.pls".as_ref())?, WaveSegments::new());
//! for index in 0..reader.pulse_count() {
//!     let pulse = reader.pulse(index)?;
//!     reader.waves(&pulse, &mut waves)?;
//!     for segment in waves.segments() {
//!         println!("{:?}: {:?}", segment.kind, waves.samples(segment));
//!     }
//! }
//! # Ok::<(), wavex_formats::Error>(())
//! ```

use std::collections::BTreeMap;
use std::fs::File;
use std::path::{Path, PathBuf};

use super::extensions::{COMPRESSED_PULSES, COMPRESSED_WAVES, WAVES, beside, has_extension};
use super::{Error, Result, regular_file};

mod descriptor;
mod header;
mod pulse;
mod table;
#[cfg(test)]
mod tests;
mod vlr;
mod wave_input;
mod waves;
mod window;
mod zip;

pub use descriptor::{PulseDescriptor, SamplingRecord, SegmentKind};
pub use header::{PulseHeader, TimeAxis};
pub use pulse::PulseRecord;
pub use table::{LookupRecord, LookupTable};
pub use vlr::{Record, ScannerRecord, StoredCrs};
pub use waves::{Segment, WaveSegments};

use vlr::RecordSet;
use wave_input::WaveDecoder;
use window::FileWindow;
use zip::PulseChunks;

/// Reader of a pulse file and its waves file.
#[derive(Debug)]
pub struct Reader {
    pulses: FileWindow<File>,
    waves: FileWindow<File>,
    header: PulseHeader,
    records: RecordSet,
    pulse_count: u64,
    /// Compressed pulses.
    chunks: Option<PulseChunks>,
    /// Decoder of compressed waves.
    wave_decoder: Option<WaveDecoder>,
}

impl Reader {
    /// Opens the pulse file `path` and its waves file.
    ///
    /// Reads header and records.
    ///
    /// # Errors
    /// A file cannot be opened, is empty, of another format, version or compression, or cut off
    /// before its first pulse; compressed pulses lack their chunk table; the waves file is missing; or the header or a record violates the
    /// specification. A file with fewer pulses than its header declares can be opened, see
    /// [`Reader::check_complete`].
    pub fn open(path: &Path) -> Result<Reader> {
        let mut pulses = open(path)?;
        let length = pulses.length().min(header::HEADER_BYTES as u64) as usize;
        let header = PulseHeader::parse(path, pulses.bytes(0, length, "header")?.1)?;
        if header.offset_to_pulses > pulses.length() {
            let problem =
                format!("the pulses start at byte {}, but the file ends earlier", header.offset_to_pulses);
            return Err(Error::unusable(path, problem, "it is cut off: copy it again from its source"));
        }
        let mut records = RecordSet::read(&mut pulses, &header)?;
        let chunks = match records.zip.take() {
            Some(zip) => Some(PulseChunks::open(zip, &mut pulses, &header)?),
            None if header.pulse_compression != 0 => {
                let problem = format!(
                    "its pulses are compressed (scheme {}), but the PulseZIP record is missing",
                    header.pulse_compression
                );
                return Err(Error::unusable(path, problem, zip::CUT));
            }
            None => None,
        };
        let end = records.appended_at.unwrap_or(pulses.length());
        let held = chunks
            .as_ref()
            .map_or((end - header.offset_to_pulses) / u64::from(header.pulse_size), PulseChunks::pulse_count);
        let mut waves = open(&waves_path(path)?)?;
        let length = waves.length().min(header::WAVES_HEADER_BYTES as u64) as usize;
        let (file, bytes) = waves.bytes(0, length, "header")?;
        let wave_decoder = header::check_waves_header(file, bytes)?.then(WaveDecoder::new);
        let pulse_count = held.min(header.pulse_count);
        Ok(Reader { pulses, waves, header, records, pulse_count, chunks, wave_decoder })
    }

    /// Returns the header.
    pub fn header(&self) -> &PulseHeader {
        &self.header
    }

    /// Returns all records before and after the pulses, in file order.
    pub fn records(&self) -> &[Record] {
        &self.records.list
    }

    /// Returns the scanners by index, 1 to 255.
    pub fn scanners(&self) -> &BTreeMap<u8, ScannerRecord> {
        &self.records.scanners
    }

    /// Returns the pulse descriptors by index, 1 to 255.
    pub fn descriptors(&self) -> &BTreeMap<u8, PulseDescriptor> {
        &self.records.descriptors
    }

    /// Returns the lookup tables by index, 1 to 255, as in [`SamplingRecord::lookup_table_index`].
    pub fn tables(&self) -> &BTreeMap<u8, LookupRecord> {
        &self.records.tables
    }

    /// Returns the coordinate reference system as stored.
    pub fn crs(&self) -> &StoredCrs {
        &self.records.crs
    }

    /// Returns the number of readable pulses.
    ///
    /// Those declared, if present in the file.
    pub fn pulse_count(&self) -> u64 {
        self.pulse_count
    }

    /// Checks that the file has all pulses that its header declares.
    ///
    /// # Errors
    /// Pulses are missing; the error gives the declared and the actual number.
    pub fn check_complete(&self) -> Result<()> {
        match self.pulse_count < self.header.pulse_count {
            true => Err(self.missing(self.pulse_count)),
            false => Ok(()),
        }
    }

    /// Returns the number of stray bytes after the pulses.
    ///
    /// They belong to no record. They are remains of appended records in a truncated file.
    pub fn stray_bytes(&self) -> u64 {
        // The chunk table follows compressed pulses.
        if self.chunks.is_some() {
            return 0;
        }
        let end = self.records.appended_at.unwrap_or(self.pulses.length());
        end.saturating_sub(self.header.record_at(self.header.pulse_count))
    }

    /// Returns the size of the waves file, bytes.
    pub fn waves_bytes(&self) -> u64 {
        self.waves.length()
    }

    /// Reads pulse `index`, from 0; sequential reads are buffered.
    ///
    /// # Errors
    /// The pulse does not exist, or the file cannot be read.
    pub fn pulse(&mut self, index: u64) -> Result<PulseRecord> {
        if index >= self.pulse_count {
            return Err(self.missing(index));
        }
        let at = self.pulse_at(index, 0);
        let known = self.header.known_pulse_bytes();
        if let Some(chunks) = &mut self.chunks {
            let bytes = chunks.record(&mut self.pulses, index)?;
            return PulseRecord::parse(self.pulses.file(), at, bytes, index, &self.header);
        }
        let (file, bytes) = self.pulses.bytes(at, known, "pulse record")?;
        PulseRecord::parse(file, at, bytes, index, &self.header)
    }

    /// Returns the file offset of a field of a pulse; of its chunk if pulses are compressed.
    fn pulse_at(&self, index: u64, field: u64) -> u64 {
        let of_chunk = self.chunks.as_ref().map(|chunks| chunks.chunk_at(index));
        of_chunk.unwrap_or_else(|| self.header.record_at(index).saturating_add(field))
    }

    /// Reads the segments of `pulse` into `waves`, replacing its content.
    ///
    /// Reads in file order are buffered.
    ///
    /// # Errors
    /// The descriptor of the pulse is missing or unsupported (such as samples of more than 16
    /// bits), or its waves are outside the waves file. `waves` is then empty, and the reader can
    /// continue.
    pub fn waves(&mut self, pulse: &PulseRecord, waves: &mut WaveSegments) -> Result<()> {
        waves.clear();
        let file = self.pulses.file();
        let at = |field| self.pulse_at(pulse.index, field);
        let descriptor = descriptor(file, at(44), &self.records, pulse)?;
        let offset = wave_offset(file, at(8), self.waves.length(), pulse)?;
        waves.read(&mut self.waves, self.wave_decoder.as_mut(), offset, pulse.index, descriptor)
    }

    /// Creates the error for a missing pulse.
    fn missing(&self, index: u64) -> Error {
        let promised = self.header.pulse_count;
        let (problem, remedy) = if index < promised {
            let held = self.pulse_count;
            (
                format!("the header declares {promised} pulses, but the file has {held}"),
                "the file is cut off: copy it again from its source",
            )
        } else {
            (format!("the file has {promised} pulses"), "request one of them")
        };
        Error::malformed(
            self.pulses.file(),
            self.pulse_at(index, 0),
            format!("pulse {index}"),
            problem,
            remedy,
        )
    }
}

/// Returns the descriptor of the pulse, if its waves can be read.
///
/// Its index is at byte `at`.
fn descriptor<'r>(
    file: &Path,
    at: u64,
    records: &'r RecordSet,
    pulse: &PulseRecord,
) -> Result<&'r PulseDescriptor> {
    let index = pulse.descriptor;
    let bad = |field: String, problem: String| {
        let field = format!("pulse {}: {field}", pulse.index);
        let remedy = "export the files with 8 or 16 bit uncompressed waves";
        Error::malformed(file, at, field, problem, remedy)
    };
    let descriptor = records.descriptors.get(&index).ok_or_else(|| {
        bad("pulse descriptor index".to_string(), format!("the file has no descriptor {index}"))
    })?;
    match descriptor.problem() {
        Some((field, problem)) => Err(bad(format!("descriptor {index}: {field}"), problem)),
        None => Ok(descriptor),
    }
}

/// Returns the checked offset of the waves of a pulse.
///
/// It is stored at byte `at` and must be within the waves file of `length` bytes.
fn wave_offset(file: &Path, at: u64, length: u64, pulse: &PulseRecord) -> Result<u64> {
    let range = header::WAVES_HEADER_BYTES as u64..length;
    u64::try_from(pulse.wave_offset).ok().filter(|offset| range.contains(offset)).ok_or_else(|| {
        let field = format!("pulse {}: offset to waves", pulse.index);
        let problem =
            format!("{} is outside the waves file's bytes {} to {length}", pulse.wave_offset, range.start);
        let remedy = "copy both files again: the waves file may be cut off, or that of another recording";
        Error::malformed(file, at, field, problem, remedy)
    })
}

/// Opens a buffered window over a file.
fn open(path: &Path) -> Result<FileWindow<File>> {
    let file = regular_file(path)?;
    let about = file.metadata().map_err(Error::io(path, "open"))?;
    if !about.is_file() {
        return Err(Error::unusable(path, "this is not a file", "give a .pls or .plz file"));
    }
    Ok(FileWindow::new(file, path, about.len()))
}

/// Returns the waves file of a pulse file: of the same compression, or else the other one.
fn waves_path(path: &Path) -> Result<PathBuf> {
    let extensions = match has_extension(path, COMPRESSED_PULSES) {
        true => [COMPRESSED_WAVES, WAVES],
        false => [WAVES, COMPRESSED_WAVES],
    };
    extensions.iter().find_map(|extension| beside(path, extension)).ok_or_else(|| {
        let wanted = path.with_extension(extensions[0]);
        let problem = format!("its waves file {} is missing", wanted.display());
        Error::unusable(path, problem, "put it into the folder of the pulse file")
    })
}
