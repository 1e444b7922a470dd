//! Waveform packets: LAS 1.4 R15, section "Waveform Data Packets".
//!
//! Packets are in an extended record inside the file or, after the same 60-byte header, in a `.wdp`
//! file next to it. Two bits of the LAS header select the location. If the selected location has no
//! packets, or the bits select none or both, packets at the only other location are used. Packets
//! at both locations without a single deciding bit are an error.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use super::encoding;
use super::header::LasHeader;
use super::vlr::{self, EVLR_HEADER, SPEC, Vlr, WAVEFORM_PACKETS};
use crate::extensions::{PACKETS, beside};
use crate::{Error, Result, regular_file};

/// Bytes read after a jump.
const SMALL: usize = 4 << 10;
/// Maximum number of bytes read at once while packets are consecutive.
const LARGE: usize = 256 << 10;

/// Waveform packets of a file.
#[derive(Debug)]
pub(super) struct Packets {
    file: File,
    path: PathBuf,
    /// Offset of the record header in `file`.
    ///
    /// Offsets in points are relative to it.
    start: u64,
    /// Offset of the end of the packets in `file`.
    end: u64,
    /// Part of `file` read last, from byte `window_at`.
    window: Vec<u8>,
    window_at: u64,
    /// Number of bytes to read next, if access is sequential.
    span: usize,
}

/// Finds the packets of the file `path`.
///
/// `None` if there are none.
///
/// # Errors
/// The record is cut off, the separate file is not a waveform file, or both locations have packets
/// and the header does not decide.
pub(super) fn find(
    path: &Path,
    header: &LasHeader,
    evlrs: &[Vlr],
    input: &mut (impl Read + Seek),
    file_length: u64,
) -> Result<Option<Packets>> {
    let inside = inside(path, header, evlrs, input, file_length)?;
    let says = |bit| header.global_encoding & bit != 0;
    let (takes_inside, takes_beside) = (says(encoding::WAVES_INSIDE), says(encoding::WAVES_BESIDE));
    // The search for a separate file may list the folder.
    if let Some(record) = inside.as_ref().filter(|_| takes_inside && !takes_beside) {
        return Packets::inside(path, record).map(Some);
    }
    match (inside, beside(path, PACKETS)) {
        (None, None) => Ok(None),
        (Some(record), None) => Packets::inside(path, &record).map(Some),
        (None, Some(beside)) => Packets::beside(&beside).map(Some),
        (Some(_), Some(beside)) if takes_beside && !takes_inside => Packets::beside(&beside).map(Some),
        (Some(_), Some(beside)) => Err(Error::malformed(
            path,
            6,
            "global encoding",
            format!(
                "waveforms are both inside the file and in `{}`, and the header does not say which \
                 to use",
                beside.display()
            ),
            "move away the waveform file that does not belong to these points",
        )),
    }
}

/// Finds the packet record inside the file.
///
/// It is at the offset in the header; else among the extended records; else, without compression,
/// after the last point.
fn inside(
    path: &Path,
    header: &LasHeader,
    evlrs: &[Vlr],
    input: &mut (impl Read + Seek),
    file_length: u64,
) -> Result<Option<Vlr>> {
    if header.start_of_waveforms >= u64::from(header.header_size)
        && let Some(record) = vlr::waveform_record(input, path, header.start_of_waveforms, file_length)?
    {
        return Ok(Some(record));
    }
    if let Some(record) = evlrs.iter().find(|evlr| evlr.is(SPEC, WAVEFORM_PACKETS)) {
        return Ok(Some(record.clone()));
    }
    if header.compressed {
        return Ok(None);
    }
    // The header was checked against the file length, so this does not overflow.
    let end = u64::from(header.offset_to_points) + header.n_points * u64::from(header.record_length);
    vlr::waveform_record(input, path, end, file_length)
}

/// Creates the error for points that refer to missing packets.
pub(super) fn missing(path: &Path) -> Error {
    if let Some(packed) = beside(path, "wdz") {
        return Error::unusable(
            path,
            format!("its waveforms are compressed, in `{}`, which cannot be read", packed.display()),
            "decompress points and waveforms together, to `.las` and `.wdp`, with the program that compressed them \
             (LASzip: `laszip -i FILE.laz -o FILE.las -waveforms`)",
        );
    }
    let name = path.with_extension(PACKETS);
    let name = name.file_name().unwrap_or_default().display();
    Error::unusable(
        path,
        format!("its waveforms are missing: neither inside the file nor in `{name}` next to it"),
        format!("copy `{name}` into the same folder, or export the file with its waveforms inside"),
    )
}

impl Packets {
    /// Returns the offset of the record header, if the packets are in `path`.
    pub(super) fn start_in(&self, path: &Path) -> Option<u64> {
        (self.path == path).then_some(self.start)
    }

    fn inside(path: &Path, record: &Vlr) -> Result<Packets> {
        let file = regular_file(path)?;
        let length = file.metadata().map_err(Error::io(path, "find the length"))?.len();
        // Writers that cannot seek back leave the length 0.
        let end = if record.length == 0 { length } else { record.offset + record.length };
        Ok(Packets::new(file, path, record.offset - EVLR_HEADER, end))
    }

    /// Opens a `.wdp` file.
    ///
    /// A declared length that is too short is ignored, as nothing else can follow.
    fn beside(path: &Path) -> Result<Packets> {
        let mut file = regular_file(path)?;
        let length = file.metadata().map_err(Error::io(path, "find the length"))?.len();
        if length == 0 {
            return Err(Error::unusable(path, "the file is empty", "copy it again from its source"));
        }
        if vlr::waveform_record(&mut file, path, 0, length)?.is_none() {
            return Err(Error::malformed(
                path,
                0,
                "header",
                "this is not a waveform packet file (LASF_Spec/65535)",
                "give the `.wdp` file that was exported together with the points",
            ));
        }
        Ok(Packets::new(file, path, 0, length))
    }

    fn new(file: File, path: &Path, start: u64, end: u64) -> Packets {
        Packets { file, path: path.to_path_buf(), start, end, window: Vec::new(), window_at: 0, span: SMALL }
    }

    /// Checks that `length` bytes from `offset`, relative to the record header, are within the packets.
    ///
    /// # Errors
    /// They are not.
    pub(super) fn check(&self, offset: u64, length: u64) -> Result<()> {
        let packets = EVLR_HEADER..=self.end - self.start;
        let end = offset.saturating_add(length);
        if !packets.contains(&offset) || !packets.contains(&end) {
            let problem = format!(
                "{length} bytes at offset {offset} are outside the packets ({} to {})",
                packets.start(),
                packets.end()
            );
            let at = self.start.saturating_add(offset);
            let remedy = "the point is damaged or the waveforms belong to another file: export both again";
            return Err(Error::malformed(&self.path, at, "waveform packet", problem, remedy));
        }
        Ok(())
    }

    /// Returns `length` bytes from `offset`, relative to the record header.
    ///
    /// # Errors
    /// As [`Packets::check`], or the file cannot be read.
    pub(super) fn bytes(&mut self, offset: u64, length: u64) -> Result<&[u8]> {
        self.check(offset, length)?;
        let at = self.start + offset;
        // Both lengths are below the file length, which fits the address space once the window is
        // loaded.
        let length = length as usize;
        if at < self.window_at || at + length as u64 > self.window_at + self.window.len() as u64 {
            self.load(at, length)?;
        }
        let from = (at - self.window_at) as usize;
        Ok(&self.window[from..from + length])
    }

    /// Moves the window to byte `at`.
    ///
    /// Small after a jump, growing with sequential access.
    fn load(&mut self, at: u64, least: usize) -> Result<()> {
        let reach = self.window_at + (self.window.len() + self.span) as u64;
        let is_ahead = (self.window_at..=reach).contains(&at);
        self.span = if is_ahead { (2 * self.span).min(LARGE) } else { SMALL };
        let length = (self.end - at).min(self.span.max(least) as u64) as usize;
        self.window.clear();
        self.window.resize(length, 0);
        self.window_at = at;
        let read = self.file.seek(SeekFrom::Start(at)).and_then(|_| self.file.read_exact(&mut self.window));
        if read.is_err() {
            self.window.clear();
        }
        read.map_err(Error::io(&self.path, "read the waveform packets"))
    }
}
