//! Waves of a pulse: segments of samples.

use std::io::{Read, Seek};
use std::ops::Range;

use super::descriptor::{PulseDescriptor, SamplingRecord, SegmentKind};
use super::wave_input::{CompressedWaves, MOST_BYTES, StoredWaves, WaveDecoder, WaveInput, bytes_per_sample};
use super::window::FileWindow;
use crate::Result;

/// Bytes of waves that are read first; more if they do not suffice.
const FIRST_BYTES: u64 = 1 << 12;
/// Bytes that suffice for all waves of a pulse: a compressed sample takes at most five.
const MOST_READ_BYTES: u64 = 8 * MOST_BYTES;
/// Maximum number of segments of a pulse.
const MOST_SEGMENTS: usize = 1 << 16;

/// Segments of a pulse; reuse avoids allocations.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct WaveSegments {
    segments: Vec<Segment>,
    samples: Vec<u16>,
}

/// Run of equally spaced samples.
#[derive(Debug, Clone, PartialEq)]
pub struct Segment {
    /// Index of the sampling in the descriptor, from 0.
    pub sampling: u16,
    /// Number of the segment in its sampling, from 0.
    pub number: u16,
    /// Outgoing or returning.
    pub kind: SegmentKind,
    /// Channel (detector).
    pub channel: u8,
    /// Bits per sample: 8 or 16.
    pub bits: u8,
    /// Stored duration; 0 if not stored.
    pub quantized_duration: i32,
    /// Time from the anchor to the first sample, sampling units.
    ///
    /// `scale * quantized_duration + offset`. Negative if the segment starts before the anchor.
    /// `None` if the sampling stores no durations. By the specification the segment then starts at
    /// the anchor, but writers also omit durations that they do not know.
    pub duration: Option<f64>,
    /// Sampling units per sample.
    pub units_per_sample: f64,
    /// Sample spacing, ns.
    pub sample_units_ns: f64,
    range: Range<usize>,
}

impl Segment {
    /// Returns the number of samples.
    pub fn sample_count(&self) -> usize {
        self.range.len()
    }

    /// Returns the sampling units from the anchor to sample `k`.
    ///
    /// `k` may be fractional. For use with [`super::PulseRecord::position`].
    pub fn duration_of(&self, k: f64) -> f64 {
        self.duration.unwrap_or(0.0) + k * self.units_per_sample
    }
}

impl WaveSegments {
    /// Creates empty waves.
    pub fn new() -> WaveSegments {
        WaveSegments::default()
    }

    /// Returns the segments in file order: sampling by sampling.
    pub fn segments(&self) -> &[Segment] {
        &self.segments
    }

    /// Returns the samples of `segment`, digitiser steps.
    ///
    /// It must be one of [`WaveSegments::segments`] of these waves.
    pub fn samples(&self, segment: &Segment) -> &[u16] {
        self.samples.get(segment.range.clone()).unwrap_or(&[])
    }

    /// Reads an outgoing and a returning segment of 16 bits again, with 8 bits for the first.
    ///
    /// For writers that declare 16 bits for both but store the outgoing pulse in 8. `false`, and
    /// nothing changes, for waves of other segments.
    pub fn read_outgoing_as_bytes(&mut self) -> bool {
        let [outgoing, returning] = &mut self.segments[..] else { return false };
        let kinds = (outgoing.kind, returning.kind);
        let is_declared = kinds == (SegmentKind::Outgoing, SegmentKind::Returning)
            && (outgoing.bits, returning.bits) == (16, 16);
        if !is_declared {
            return false;
        }
        let bytes: Vec<u8> = self.samples.iter().flat_map(|sample| sample.to_le_bytes()).collect();
        let (of_outgoing, rest) = bytes.split_at(outgoing.range.len());
        let of_returning = &rest[..2 * returning.range.len()];
        self.samples.clear();
        self.samples.extend(of_outgoing.iter().map(|&byte| u16::from(byte)));
        self.samples.extend(of_returning.chunks_exact(2).map(|b| u16::from_le_bytes([b[0], b[1]])));
        outgoing.bits = 8;
        true
    }

    /// Removes all segments but keeps the memory.
    pub(super) fn clear(&mut self) {
        self.segments.clear();
        self.samples.clear();
    }

    /// Reads the segments of a pulse, replacing the old ones.
    ///
    /// They are at byte `offset` of the waves file, compressed if there is a decoder. Empty after an error.
    pub(super) fn read<R: Read + Seek>(
        &mut self,
        window: &mut FileWindow<R>,
        mut decoder: Option<&mut WaveDecoder>,
        offset: u64,
        pulse: u64,
        descriptor: &PulseDescriptor,
    ) -> Result<()> {
        let left = window.length().saturating_sub(offset);
        let mut length = FIRST_BYTES + u64::from(descriptor.extra_wave_bytes);
        loop {
            let (file, bytes) = window.bytes(offset, length.min(left) as usize, "waves")?;
            let place = (file, pulse, offset);
            let (read, is_past_end) = match &mut decoder {
                Some(decoder) => self.read_all(CompressedWaves::new(decoder, bytes, place), descriptor),
                None => self.read_all(StoredWaves::new(bytes, left, place), descriptor),
            };
            // Their size is not stored.
            if !is_past_end || length >= left.min(MOST_READ_BYTES) {
                return read;
            }
            length *= 8;
        }
    }

    /// Reads the segments; also returns whether the bytes did not suffice.
    fn read_all(&mut self, mut input: impl WaveInput, descriptor: &PulseDescriptor) -> (Result<()>, bool) {
        self.clear();
        let read = self.read_samplings(&mut input, descriptor).and_then(|()| input.finish());
        if read.is_err() {
            self.clear();
        }
        (read, input.is_past_end())
    }

    fn read_samplings(&mut self, input: &mut impl WaveInput, descriptor: &PulseDescriptor) -> Result<()> {
        input.skip(descriptor.extra_wave_bytes.into())?;
        for (number, sampling) in descriptor.samplings.iter().enumerate() {
            let units_per_sample = descriptor.units_per_sample(sampling);
            let segments = match sampling.segment_count_bits {
                0 => u32::from(sampling.segment_count),
                bits => input.segment_count(bits)?,
            };
            for segment in 0..segments {
                if self.segments.len() >= MOST_SEGMENTS {
                    return Err(input.bad("segments", format!("there are more than {MOST_SEGMENTS}")));
                }
                let place = (number as u16, segment as u16);
                self.read_segment(input, sampling, place, units_per_sample)?;
            }
        }
        Ok(())
    }

    fn read_segment(
        &mut self,
        input: &mut impl WaveInput,
        sampling: &SamplingRecord,
        (number, segment): (u16, u16),
        units_per_sample: f64,
    ) -> Result<()> {
        let quantized = match sampling.duration_bits {
            0 => None,
            bits => Some(input.duration(bits)?),
        };
        let count = match sampling.sample_count_bits {
            0 => sampling.sample_count,
            bits => input.sample_count(bits)?,
        };
        let start = self.samples.len();
        input.samples(sampling, count as usize, &mut self.samples)?;
        self.segments.push(Segment {
            sampling: number,
            number: segment,
            kind: sampling.kind,
            channel: sampling.channel,
            bits: 8 * bytes_per_sample(sampling) as u8,
            quantized_duration: quantized.unwrap_or(0),
            duration: quantized.map(|q| sampling.duration_scale * f64::from(q) + sampling.duration_offset),
            units_per_sample,
            sample_units_ns: sampling.sample_units_ns,
            range: start..self.samples.len(),
        });
        Ok(())
    }
}
