//! Waveform packets: LAS 1.4 R15, section "Waveform Data Packets".
//!
//! Packets are in an extended record inside the file or, after the same 60-byte header, in a `.wdp`
//! file next to it; compressed ones in a `.wdz` file (LAStools). Two bits of the LAS header select the location. If the selected location has no
//! packets, or the bits select none or both, packets at the only other location are used. Packets
//! at both locations without a single deciding bit are an error.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::ops::Range;
use std::path::{Path, PathBuf};

use super::descriptor::{Descriptors, PacketDescriptor};
use super::encoding;
use super::header::LasHeader;
use super::packet_decoder::PacketDecoder;
use super::point::Wave;
use super::vlr::{self, EVLR_HEADER, SPEC, Vlr, WAVEFORM_PACKETS};
use crate::bytes::Fields;
use crate::extensions::{COMPRESSED_PACKETS, PACKETS, beside};
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
    decoder: PacketDecoder,
}

/// Copy of the descriptors at the start of packets from LAStools: signature, size of the signature and of
/// the version after it, bytes, and size of a descriptor, bytes.
const DESCRIBED: &[u8] = b"LAStools waveform ";
const DESCRIBED_BYTES: u64 = 24;
const DESCRIPTION_BYTES: u64 = 6;

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
    descriptors: &Descriptors,
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
    match (inside, extensions(descriptors).into_iter().find_map(|extension| beside(path, extension))) {
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

/// Returns the extensions of separate files, the expected one first.
fn extensions(descriptors: &Descriptors) -> [&'static str; 2] {
    match descriptors.are_compressed() {
        true => [COMPRESSED_PACKETS, PACKETS],
        false => [PACKETS, COMPRESSED_PACKETS],
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
pub(super) fn missing(path: &Path, descriptors: &Descriptors) -> Error {
    let [extension, _] = extensions(descriptors);
    let name = path.with_extension(extension);
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

    /// Opens a `.wdp` or `.wdz` file.
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
                "give the `.wdp` or `.wdz` file that was exported together with the points",
            ));
        }
        Ok(Packets::new(file, path, 0, length))
    }

    fn new(file: File, path: &Path, start: u64, end: u64) -> Packets {
        let (path, window, decoder) = (path.to_path_buf(), Vec::new(), PacketDecoder::new());
        Packets { file, path, start, end, window, window_at: 0, span: SMALL, decoder }
    }

    /// Compares the copy of the descriptors at the start of packets from LAStools.
    ///
    /// # Errors
    /// They differ: the packets belong to other points.
    pub(super) fn check_descriptors(&mut self, descriptors: &Descriptors) -> Result<()> {
        if self.end - self.start < EVLR_HEADER + DESCRIBED_BYTES + 2
            || !self.bytes(EVLR_HEADER, DESCRIBED_BYTES)?.starts_with(DESCRIBED)
        {
            return Ok(());
        }
        let at = EVLR_HEADER + DESCRIBED_BYTES;
        let count = self.bytes(at, 2)?.iter().rev().fold(0, |count, &byte| count << 8 | u64::from(byte));
        let (path, base) = (self.path.clone(), self.start + at + 2);
        let mut fields = Fields::new(&path, base, self.bytes(at + 2, DESCRIPTION_BYTES * count)?);
        for _ in 0..count {
            let here = fields.clone();
            let index = fields.u16("index of a waveform descriptor")?;
            let stored = (
                fields.u8("compression of a waveform descriptor")?,
                fields.u8("bits of a waveform descriptor")?,
                fields.u16("samples of a waveform descriptor")?,
            );
            let of_points = u8::try_from(index).ok().and_then(|index| descriptors.get(index));
            let same = of_points.is_some_and(|of| stored == (of.compression, of.bits, of.samples as u16));
            if !same {
                let problem = "it differs from that of the points";
                let remedy =
                    "the waveforms belong to another file: give those that were exported with the points";
                return Err(here.bad(&format!("waveform descriptor {index}"), problem, remedy));
            }
        }
        Ok(())
    }

    /// Reads the waveform `wave` into `samples`, replacing its content.
    ///
    /// # Errors
    /// As [`Packets::check`]; the file cannot be read; or the packet is not a compressed packet, although
    /// `descriptor` says so. `samples` is then empty.
    pub(super) fn samples(
        &mut self,
        wave: &Wave,
        descriptor: &PacketDescriptor,
        samples: &mut Vec<u16>,
    ) -> Result<()> {
        if !descriptor.is_compressed() {
            descriptor.unpack(self.bytes(wave.offset, descriptor.packet_bytes())?, samples);
            return Ok(());
        }
        let Range { start, end } = self.range_in_window(wave.offset, wave.size.into())?;
        let decoded = self.decoder.decode(&self.window[start..end], descriptor, samples);
        decoded.map_err(|problem| {
            samples.clear();
            let problem = format!("{} bytes cannot be decompressed: {problem}", wave.size);
            let remedy = "the waveform is damaged: copy the file again from its source, or export it again";
            Error::malformed(&self.path, self.start + wave.offset, "waveform packet", problem, remedy)
        })
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
    fn bytes(&mut self, offset: u64, length: u64) -> Result<&[u8]> {
        let range = self.range_in_window(offset, length)?;
        Ok(&self.window[range])
    }

    /// Moves the window to `length` bytes from `offset`; returns where in it they are.
    fn range_in_window(&mut self, offset: u64, length: u64) -> Result<Range<usize>> {
        self.check(offset, length)?;
        let at = self.start + offset;
        // Both lengths are below the file length, which fits the address space once the window is
        // loaded.
        let length = length as usize;
        if at < self.window_at || at + length as u64 > self.window_at + self.window.len() as u64 {
            self.load(at, length)?;
        }
        let from = (at - self.window_at) as usize;
        Ok(from..from + length)
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
