//! Waves of a pulse: segments of samples.

use std::io::{Read, Seek};
use std::ops::Range;

use super::descriptor::{PulseDescriptor, SamplingRecord, SegmentKind};
use super::window::FileWindow;
use crate::{Error, Result};

/// Largest size of the waves of a pulse, bytes.
///
/// Over 600 km of range at one byte per ns.
const MOST_BYTES: u64 = 1 << 22;
/// Maximum number of segments of a pulse.
const MOST_SEGMENTS: usize = 1 << 16;

const DAMAGED: &str = "leave the pulse out, or copy or export the pair of files again";

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
    /// They are at byte `offset` of the waves file. Empty after an error.
    pub(super) fn read<R: Read + Seek>(
        &mut self,
        window: &mut FileWindow<R>,
        offset: u64,
        pulse: u64,
        descriptor: &PulseDescriptor,
    ) -> Result<()> {
        self.clear();
        let mut walk = WaveCursor { window, pulse, start: offset, at: offset };
        let read = self.read_all(&mut walk, descriptor);
        if read.is_err() {
            self.clear();
        }
        read
    }

    fn read_all<R: Read + Seek>(
        &mut self,
        walk: &mut WaveCursor<'_, R>,
        descriptor: &PulseDescriptor,
    ) -> Result<()> {
        walk.take(usize::from(descriptor.extra_wave_bytes), "extra waves bytes")?;
        for (number, sampling) in descriptor.samplings.iter().enumerate() {
            let units_per_sample = descriptor.units_per_sample(sampling);
            let segments = match sampling.segment_count_bits {
                0 => u32::from(sampling.segment_count),
                bits => walk.unsigned(bits, "number of segments")?,
            };
            for segment in 0..segments {
                if self.segments.len() >= MOST_SEGMENTS {
                    return Err(walk.bad("segments", format!("there are more than {MOST_SEGMENTS}")));
                }
                let place = (number as u16, segment as u16);
                self.read_segment(walk, sampling, place, units_per_sample)?;
            }
        }
        Ok(())
    }

    fn read_segment<R: Read + Seek>(
        &mut self,
        walk: &mut WaveCursor<'_, R>,
        sampling: &SamplingRecord,
        (number, segment): (u16, u16),
        units_per_sample: f64,
    ) -> Result<()> {
        let quantized = match sampling.duration_bits {
            0 => None,
            bits => Some(walk.signed(bits, "duration from anchor")?),
        };
        let count = match sampling.sample_count_bits {
            0 => sampling.sample_count,
            bits => walk.unsigned(bits, "number of samples")?,
        };
        let start = self.samples.len();
        let bytes_per_sample = if sampling.bits_per_sample > 8 { 2 } else { 1 };
        let bytes = walk.take((count as usize).saturating_mul(bytes_per_sample), "samples")?;
        if bytes_per_sample == 1 {
            self.samples.extend(bytes.iter().map(|&b| u16::from(b)));
        } else {
            self.samples.extend(bytes.chunks_exact(2).map(|b| u16::from_le_bytes([b[0], b[1]])));
        }
        self.segments.push(Segment {
            sampling: number,
            number: segment,
            kind: sampling.kind,
            channel: sampling.channel,
            bits: (8 * bytes_per_sample) as u8,
            quantized_duration: quantized.unwrap_or(0),
            duration: quantized.map(|q| sampling.duration_scale * f64::from(q) + sampling.duration_offset),
            units_per_sample,
            sample_units_ns: sampling.sample_units_ns,
            range: start..self.samples.len(),
        });
        Ok(())
    }
}

/// Cursor over the waves of a pulse.
struct WaveCursor<'a, R> {
    window: &'a mut FileWindow<R>,
    pulse: u64,
    start: u64,
    at: u64,
}

impl<R: Read + Seek> WaveCursor<'_, R> {
    /// Reads `n` bytes.
    fn take(&mut self, n: usize, field: &str) -> Result<&[u8]> {
        let at = self.at;
        let left = self.window.length().saturating_sub(at);
        if n as u64 > left {
            return Err(self.bad(field, format!("{n} bytes needed, {left} left in the file")));
        }
        if at + n as u64 - self.start > MOST_BYTES {
            return Err(self.bad(field, format!("the waves of the pulse take more than {MOST_BYTES} bytes")));
        }
        self.at += n as u64;
        Ok(self.window.bytes(at, n, field)?.1)
    }

    /// Reads an unsigned number of 8 or 16 bits.
    fn unsigned(&mut self, bits: u8, field: &str) -> Result<u32> {
        let bytes = self.take(usize::from(bits / 8), field)?;
        Ok(bytes.iter().rev().fold(0, |number, &byte| (number << 8) | u32::from(byte)))
    }

    /// Reads a signed number of 8, 16 or 32 bits.
    fn signed(&mut self, bits: u8, field: &str) -> Result<i32> {
        let unused = 32 - u32::from(bits);
        Ok(((self.unsigned(bits, field)? << unused) as i32) >> unused)
    }

    /// Creates an error at the next field.
    fn bad(&self, field: &str, problem: String) -> Error {
        let field = format!("pulse {}: {field}", self.pulse);
        Error::malformed(self.window.file(), self.at, field, problem, DAMAGED)
    }
}
