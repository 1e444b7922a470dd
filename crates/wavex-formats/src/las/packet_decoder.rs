//! Compressed waveform packets of LAStools (`.wdz`).
//!
//! A packet is its first sample as stored without compression, followed by the differences of all further
//! samples, arithmetically coded. Every packet is coded on its own, so packets can be read in any order.

use super::descriptor::PacketDescriptor;
use crate::arithmetic::{Decoder, IntegerDecoder};

/// Most bytes that a sample takes: two symbols of at most 15 bits and 8 further bits.
const MOST_BYTES_PER_SAMPLE: u64 = 5;
/// Most bytes of a packet besides those of its samples.
const MOST_FURTHER_BYTES: u64 = 16;

/// Decoder of compressed packets.
#[derive(Debug)]
pub(super) struct PacketDecoder {
    of_8_bits: IntegerDecoder,
    of_16_bits: IntegerDecoder,
}

impl PacketDecoder {
    pub(super) fn new() -> PacketDecoder {
        PacketDecoder { of_8_bits: IntegerDecoder::new(8, 1), of_16_bits: IntegerDecoder::new(16, 1) }
    }

    /// Returns the largest possible size of a packet, bytes.
    pub(super) fn most_bytes(descriptor: &PacketDescriptor) -> u64 {
        MOST_BYTES_PER_SAMPLE * u64::from(descriptor.samples) + MOST_FURTHER_BYTES
    }

    /// Decodes the samples of a packet into `samples`, replacing its content.
    ///
    /// # Errors
    /// With a description if `packet` is not a compressed packet of this descriptor.
    pub(super) fn decode(
        &mut self,
        packet: &[u8],
        descriptor: &PacketDescriptor,
        samples: &mut Vec<u16>,
    ) -> Result<(), String> {
        let bytes_per_sample = usize::from(descriptor.bits / 8);
        let (first, coded) = packet.split_at(bytes_per_sample.min(packet.len()));
        let first = first.iter().rev().fold(0, |sample, &byte| sample << 8 | u16::from(byte));
        let numbers = if bytes_per_sample == 1 { &mut self.of_8_bits } else { &mut self.of_16_bits };
        let mut input = Decoder::new(coded);
        numbers.restart();
        samples.clear();
        samples.resize(descriptor.samples as usize, first);
        numbers.samples(&mut input, first, 0, samples.get_mut(1..).unwrap_or_default());
        let read = input.check_end()?;
        match coded.len() - read {
            0 => Ok(()),
            more => Err(format!("{more} bytes follow its samples")),
        }
    }
}
