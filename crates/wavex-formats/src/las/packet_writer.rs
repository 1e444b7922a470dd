//! Waveform packet writer.
//!
//! LAS 1.4 R15, sections "Waveform Data Packets" and "Waveform Packet Descriptor".

use std::io::{Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use super::descriptor::PacketDescriptor;
use super::vlr::{EVLR_HEADER, SPEC, Vlr, WAVEFORM_PACKETS};
use crate::{Error, Result};

/// Maximum number of packet kinds: the number of descriptor indexes.
pub(super) const MOST_KINDS: usize = 255;

/// Writer of the packet record `LASF_Spec`/65535.
///
/// The record is a `.wdp` file or part of a LAS file.
pub struct PacketWriter<W> {
    sink: W,
    path: PathBuf,
    /// Number of bytes written, record header included.
    end: u64,
    kinds: Vec<PacketDescriptor>,
    packet: Vec<u8>,
}

/// Reference to a written packet, for its points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PacketReference {
    /// Descriptor index of the packet kind, from 1.
    pub descriptor: u8,
    /// Offset of the packet from the record header, bytes.
    pub offset: u64,
    /// Length, bytes.
    pub size: u32,
}

impl<W: Write + Seek> PacketWriter<W> {
    /// Starts the record in a sink at its first byte.
    ///
    /// `path` names it in errors.
    ///
    /// # Errors
    /// Writing fails.
    pub fn new(mut sink: W, path: &Path) -> Result<PacketWriter<W>> {
        sink.write_all(&header(0)).map_err(Error::io(path, "write"))?;
        let path = path.to_path_buf();
        Ok(PacketWriter { sink, path, end: EVLR_HEADER, kinds: Vec::new(), packet: Vec::new() })
    }

    /// Writes the samples of a waveform as a packet.
    ///
    /// Samples have 8 bits each if they fit, else 16. Returns `None` and writes nothing if there
    /// are no samples or they would need a 256th kind. Packets of a kind share the number of
    /// samples, spacing and bits.
    ///
    /// # Errors
    /// Writing fails.
    pub fn add(&mut self, samples: &[u16], spacing_ps: u32) -> Result<Option<PacketReference>> {
        let is_narrow = samples.iter().all(|&sample| sample <= u16::from(u8::MAX));
        let kind = PacketDescriptor {
            bits: if is_narrow { 8 } else { 16 },
            compression: 0,
            samples: samples.len() as u32,
            spacing_ps,
            gain: 1.0,
            offset: 0.0,
        };
        if kind.obstacle().is_some() {
            return Ok(None);
        }
        let known = self.kinds.iter().position(|known| *known == kind);
        let Some(index) = known.or_else(|| self.add_kind(kind)) else { return Ok(None) };
        self.packet.clear();
        match is_narrow {
            true => self.packet.extend(samples.iter().map(|&sample| sample as u8)),
            false => self.packet.extend(samples.iter().flat_map(|sample| sample.to_le_bytes())),
        }
        self.sink.write_all(&self.packet).map_err(Error::io(&self.path, "write"))?;
        let (offset, size) = (self.end, self.packet.len() as u32);
        self.end += u64::from(size);
        Ok(Some(PacketReference { descriptor: index as u8 + 1, offset, size }))
    }

    fn add_kind(&mut self, kind: PacketDescriptor) -> Option<usize> {
        let index = self.kinds.len();
        (index < MOST_KINDS).then(|| {
            self.kinds.push(kind);
            index
        })
    }

    /// Writes the length of the record.
    ///
    /// Returns the flushed sink and the packet kinds.
    ///
    /// # Errors
    /// Writing fails.
    pub fn finish(self) -> Result<(W, Vec<PacketDescriptor>)> {
        let PacketWriter { mut sink, path, end, kinds, .. } = self;
        let mut patch = || {
            sink.seek(SeekFrom::Start(0))?;
            sink.write_all(&header(end - EVLR_HEADER))?;
            sink.seek(SeekFrom::End(0))?;
            sink.flush()
        };
        patch().map_err(Error::io(&path, "write"))?;
        Ok((sink, kinds))
    }
}

/// Encodes the header of a record with `length` bytes of packets.
fn header(length: u64) -> Vec<u8> {
    let record = Vlr::new(SPEC, WAVEFORM_PACKETS, "Waveform data packets", Vec::new());
    Vlr { length, ..record }.write_extended()
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use super::*;

    fn writer() -> PacketWriter<Cursor<Vec<u8>>> {
        PacketWriter::new(Cursor::new(Vec::new()), Path::new("a.wdp")).unwrap()
    }

    #[test]
    fn packets_are_spelled_out() {
        let mut writer = writer();
        let packets = [
            writer.add(&[1, 2, 255], 1000).unwrap(),
            writer.add(&[1, 2, 256], 1000).unwrap(),
            writer.add(&[3, 3, 3], 1000).unwrap(),
            writer.add(&[], 1000).unwrap(),
            writer.add(&[1], 0).unwrap(),
        ];
        let packet = |descriptor, offset, size| Some(PacketReference { descriptor, offset, size });
        assert_eq!(packets, [packet(1, 60, 3), packet(2, 63, 6), packet(1, 69, 3), None, None]);
        let (sink, kinds) = writer.finish().unwrap();
        assert_eq!(kinds.iter().map(|kind| (kind.bits, kind.samples)).collect::<Vec<_>>(), [(8, 3), (16, 3)]);
        let bytes = sink.into_inner();
        assert_eq!(&bytes[..12], b"\0\0LASF_Spec\0");
        assert_eq!(bytes[18..20], 65535u16.to_le_bytes());
        assert_eq!(bytes[20..28], 12u64.to_le_bytes());
        assert_eq!(bytes[60..], [1, 2, 255, 1, 0, 2, 0, 0, 1, 3, 3, 3]);
    }

    #[test]
    fn more_kinds_than_points_can_name_are_refused() {
        let mut writer = writer();
        let samples = [7; 300];
        for length in 1..=255 {
            let packet = writer.add(&samples[..length], 1000).unwrap().unwrap();
            assert_eq!(usize::from(packet.descriptor), length);
        }
        assert_eq!(writer.add(&samples[..256], 1000).unwrap(), None);
        assert_eq!(writer.add(&samples[..9], 1000).unwrap().unwrap().descriptor, 9);
    }
}
