//! Waveform packet descriptors and sample packing.
//!
//! LAS 1.4 R15, section "Waveform Packet Descriptor".

use std::path::Path;

use super::Wave;
use super::vlr::{SPEC, Vlr};
use crate::Result;
use crate::bytes::Fields;

/// Largest accepted number of samples per packet.
///
/// Over 600 km of range at 1 ns.
const MOST_SAMPLES: u32 = 1 << 22;

/// Compression type of LAStools.
const COMPRESSED: u8 = 1;
/// Length of a descriptor's data, bytes.
pub(super) const DESCRIPTOR_BYTES: usize = 26;
/// Record ID of the first descriptor.
pub(super) const FIRST_DESCRIPTOR: u16 = 100;

/// Storage and spacing of the samples of a waveform packet.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PacketDescriptor {
    /// Bits per sample; 2 to 32 by the specification.
    pub bits: u8,
    /// Compression type: 0 none, 1 that of LAStools.
    pub compression: u8,
    /// Number of samples per packet.
    pub samples: u32,
    /// Sample spacing, ps.
    pub spacing_ps: u32,
    /// Gain: volts = `offset` + `gain` * sample.
    pub gain: f64,
    /// Offset, V.
    pub offset: f64,
}

/// Descriptors of a file by their index in the points.
///
/// Record ID minus 99, from 1 to 255.
#[derive(Debug, Default)]
pub(super) struct Descriptors(Vec<Option<PacketDescriptor>>);

impl Descriptors {
    /// Collects the descriptors among `records`.
    ///
    /// A record that is too short counts as missing, so only points that refer to it are lost.
    pub(super) fn collect<'a>(file: &Path, records: impl Iterator<Item = &'a Vlr>) -> Descriptors {
        let mut all = vec![None; 256];
        for vlr in records.filter(|vlr| vlr.user_id == SPEC && (100..=354).contains(&vlr.record_id)) {
            if let Some(place) = all.get_mut(usize::from(vlr.record_id - 99)) {
                *place = parse(&mut Fields::new(file, vlr.offset, &vlr.data)).ok();
            }
        }
        Descriptors(all)
    }

    pub(super) fn get(&self, index: u8) -> Option<&PacketDescriptor> {
        self.0.get(usize::from(index)).and_then(Option::as_ref)
    }

    /// Returns whether the digitizer gains of non-empty descriptors differ.
    pub(super) fn have_different_gains(&self) -> bool {
        let mut gains = self.0.iter().flatten().filter(|of| of.samples > 0).map(|of| of.gain.to_bits());
        let first = gains.next();
        gains.any(|gain| Some(gain) != first)
    }

    /// Returns whether a non-empty descriptor has compressed packets.
    pub(super) fn are_compressed(&self) -> bool {
        self.0.iter().flatten().any(|descriptor| descriptor.samples > 0 && descriptor.is_compressed())
    }

    /// Returns whether the file has a non-empty descriptor.
    pub(super) fn describe_anything(&self) -> bool {
        self.0.iter().flatten().any(|descriptor| descriptor.samples > 0)
    }
}

fn parse(fields: &mut Fields) -> Result<PacketDescriptor> {
    Ok(PacketDescriptor {
        bits: fields.u8("bits per sample")?,
        compression: fields.u8("waveform compression type")?,
        samples: fields.u32("number of samples")?,
        spacing_ps: fields.u32("temporal sample spacing")?,
        gain: fields.f64("digitizer gain")?,
        offset: fields.f64("digitizer offset")?,
    })
}

impl PacketDescriptor {
    /// Returns the length of an uncompressed packet, bytes.
    ///
    /// Samples are packed without padding.
    pub fn packet_bytes(&self) -> u64 {
        (u64::from(self.samples) * u64::from(self.bits)).div_ceil(8)
    }

    /// Returns the descriptor of a packet as it is stored.
    ///
    /// Samples of 9 to 15 bits may be stored in words of 16 bits: such a packet has two bytes per
    /// sample.
    pub(super) fn as_stored(&self, wave: &Wave) -> PacketDescriptor {
        let is_in_words = !self.is_compressed()
            && (9..16).contains(&self.bits)
            && u64::from(wave.size) == 2 * u64::from(self.samples);
        PacketDescriptor { bits: if is_in_words { 16 } else { self.bits }, ..*self }
    }

    /// Returns whether packets are compressed.
    pub(super) fn is_compressed(&self) -> bool {
        self.compression == COMPRESSED
    }

    /// Number of bytes of a packet that this descriptor, as [`Reader::packet`] returns it, does not
    /// describe; 0 if they are less than two samples, such as padding.
    ///
    /// [`Reader::packet`]: super::Reader::packet
    pub fn surplus_bytes(&self, wave: &Wave) -> u64 {
        // All bytes of a compressed packet are read.
        if self.is_compressed() {
            return 0;
        }
        let surplus = u64::from(wave.size).saturating_sub(self.packet_bytes());
        if 8 * surplus >= 2 * u64::from(self.bits.max(8)) { surplus } else { 0 }
    }

    /// Encodes the data of the descriptor's record.
    pub(super) fn encode(&self) -> [u8; DESCRIPTOR_BYTES] {
        let mut out = [0; DESCRIPTOR_BYTES];
        (out[0], out[1]) = (self.bits, self.compression);
        out[2..6].copy_from_slice(&self.samples.to_le_bytes());
        out[6..10].copy_from_slice(&self.spacing_ps.to_le_bytes());
        out[10..18].copy_from_slice(&self.gain.to_le_bytes());
        out[18..26].copy_from_slice(&self.offset.to_le_bytes());
        out
    }

    /// Returns problem and remedy if packets cannot be read.
    pub(super) fn obstacle(&self) -> Option<(String, &'static str)> {
        const EXPORT: &str = "export the waveforms again, uncompressed and with 8 or 16 bits";
        if self.samples == 0 || self.spacing_ps == 0 {
            let problem = format!("it is empty ({} samples every {} ps)", self.samples, self.spacing_ps);
            return Some((problem, "the point has no waveform: leave it out"));
        }
        if self.samples > MOST_SAMPLES {
            let problem = format!("{} samples exceed the limit of {MOST_SAMPLES}", self.samples);
            return Some((problem, "the descriptor is damaged: export the file again"));
        }
        if self.compression > COMPRESSED {
            return Some((format!("compression {} is not defined", self.compression), EXPORT));
        }
        if self.is_compressed() && !matches!(self.bits, 8 | 16) {
            return Some((format!("compressed samples have 8 or 16 bits, not {}", self.bits), EXPORT));
        }
        if !(2..=16).contains(&self.bits) {
            return Some((format!("{} bits per sample are not supported, only 2 to 16", self.bits), EXPORT));
        }
        None
    }

    /// Unpacks the samples of a packet into `samples`, replacing its content.
    ///
    /// The specification defines the order only for whole bytes, as little-endian. Other widths are
    /// read in the order that extends it: each sample begins at the lowest bit not used by the
    /// previous one.
    pub(super) fn unpack(&self, packet: &[u8], samples: &mut Vec<u16>) {
        samples.clear();
        match self.bits {
            8 => samples.extend(packet.iter().map(|&byte| u16::from(byte))),
            16 => samples.extend(packet.chunks_exact(2).map(|pair| u16::from_le_bytes([pair[0], pair[1]]))),
            bits => unpack_bits(bits.into(), packet, samples),
        }
        samples.truncate(self.samples as usize);
    }
}

/// Unpacks samples of up to 16 bits, lowest bit first.
fn unpack_bits(bits: u32, packet: &[u8], samples: &mut Vec<u16>) {
    let mask = (1u32 << bits) - 1;
    let (mut store, mut held) = (0u32, 0);
    for &byte in packet {
        store |= u32::from(byte) << held;
        held += 8;
        while held >= bits {
            samples.push((store & mask) as u16);
            store >>= bits;
            held -= bits;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn descriptor(bits: u8, samples: u32) -> PacketDescriptor {
        PacketDescriptor { bits, compression: 0, samples, spacing_ps: 1000, gain: 1.0, offset: 0.0 }
    }

    fn vlr(record_id: u16, data: &[u8]) -> Vlr {
        let length = data.len() as u64;
        Vlr {
            user_id: SPEC.into(),
            record_id,
            description: String::new(),
            offset: 281,
            length,
            data: data.to_vec(),
        }
    }

    #[test]
    fn a_descriptor_is_26_bytes() {
        let mut bytes = vec![16, 0];
        bytes.extend(60u32.to_le_bytes());
        bytes.extend(1000u32.to_le_bytes());
        bytes.extend(0.5f64.to_le_bytes());
        bytes.extend((-2.0f64).to_le_bytes());
        let records = [vlr(99, &bytes), vlr(100, &bytes), vlr(354, &bytes), vlr(101, &bytes[..25])];
        let descriptors = Descriptors::collect(Path::new("f"), records.iter());
        let expected = PacketDescriptor {
            bits: 16,
            compression: 0,
            samples: 60,
            spacing_ps: 1000,
            gain: 0.5,
            offset: -2.0,
        };
        assert_eq!(descriptors.get(1), Some(&expected));
        assert_eq!(expected.encode().as_slice(), bytes);
        assert_eq!(descriptors.get(255), Some(&expected));
        assert_eq!(descriptors.get(0), None);
        assert_eq!(descriptors.get(2), None);
        assert!(descriptors.describe_anything());
    }

    #[test]
    fn what_cannot_be_read_is_said() {
        let said = |descriptor: PacketDescriptor| descriptor.obstacle().map(|(problem, _)| problem);
        assert_eq!(said(descriptor(8, 60)), None);
        assert_eq!(said(descriptor(8, 0)).as_deref(), Some("it is empty (0 samples every 1000 ps)"));
        assert_eq!(
            said(PacketDescriptor { spacing_ps: 0, ..descriptor(8, 60) }).as_deref(),
            Some("it is empty (60 samples every 0 ps)")
        );
        assert_eq!(said(descriptor(8, MOST_SAMPLES)), None);
        assert_eq!(
            said(descriptor(8, MOST_SAMPLES + 1)).as_deref(),
            Some("4194305 samples exceed the limit of 4194304")
        );
        assert_eq!(
            said(PacketDescriptor { compression: 2, ..descriptor(8, 60) }).as_deref(),
            Some("compression 2 is not defined")
        );
        assert_eq!(said(PacketDescriptor { compression: 1, ..descriptor(16, 60) }), None);
        assert_eq!(
            said(PacketDescriptor { compression: 1, ..descriptor(12, 60) }).as_deref(),
            Some("compressed samples have 8 or 16 bits, not 12")
        );
        assert_eq!(
            said(descriptor(17, 60)).as_deref(),
            Some("17 bits per sample are not supported, only 2 to 16")
        );
        assert_eq!(
            said(descriptor(1, 60)).as_deref(),
            Some("1 bits per sample are not supported, only 2 to 16")
        );
    }

    #[test]
    fn packets_are_as_long_as_their_bits() {
        assert_eq!(descriptor(16, 60).packet_bytes(), 120);
        assert_eq!(descriptor(12, 3).packet_bytes(), 5);
        assert_eq!(descriptor(255, u32::MAX).packet_bytes(), 136_902_082_529);
    }

    #[test]
    fn samples_are_little_endian() {
        let mut samples = vec![9; 9];
        descriptor(16, 2).unpack(&[0x34, 0x12, 0xff, 0xff], &mut samples);
        assert_eq!(samples, [0x1234, 0xffff]);
        descriptor(8, 3).unpack(&[1, 2, 255], &mut samples);
        assert_eq!(samples, [1, 2, 255]);
        descriptor(12, 2).unpack(&[0xbc, 0x3a, 0x12], &mut samples);
        assert_eq!(samples, [0xabc, 0x123]);
        descriptor(2, 3).unpack(&[0b11_10_01_00], &mut samples);
        assert_eq!(samples, [0, 1, 2]);
    }

    proptest! {
        #[test]
        fn any_width_unpacks_what_was_packed(bits in 2u8..=16, values in prop::collection::vec(any::<u16>(), 1..50)) {
            let values: Vec<u16> = values.iter().map(|v| v & ((1u32 << bits) - 1) as u16).collect();
            let d = descriptor(bits, values.len() as u32);
            let mut packet = vec![0u8; d.packet_bytes() as usize];
            for (i, &value) in values.iter().enumerate() {
                for bit in 0..usize::from(bits) {
                    let at = i * usize::from(bits) + bit;
                    packet[at / 8] |= ((value >> bit & 1) as u8) << (at % 8);
                }
            }
            let mut samples = Vec::new();
            d.unpack(&packet, &mut samples);
            prop_assert_eq!(samples, values);
        }
    }
}
