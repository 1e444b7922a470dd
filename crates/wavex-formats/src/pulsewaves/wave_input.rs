//! Numbers and samples of the waves of a pulse, stored or compressed.

use std::ops::RangeInclusive;
use std::path::Path;

use super::descriptor::{SamplingRecord, SegmentKind};
use crate::arithmetic::{Decoder, IntegerDecoder};
use crate::{Error, Result};

/// Largest size of the uncompressed waves of a pulse, bytes.
///
/// Over 600 km of range at one byte per ns.
pub(super) const MOST_BYTES: u64 = 1 << 22;

const DAMAGED: &str = "copy both files again: the waves file may be cut off, or that of another recording";

/// Numbers and samples of the waves of a pulse, in file order.
pub(super) trait WaveInput {
    /// Skips bytes before the waves.
    fn skip(&mut self, bytes: usize) -> Result<()>;
    /// Reads a number of segments of 8 or 16 bits.
    fn segment_count(&mut self, bits: u8) -> Result<u32>;
    /// Reads the quantised duration of a segment, of 8, 16 or 32 bits.
    fn duration(&mut self, bits: u8) -> Result<i32>;
    /// Reads a number of samples of 8 or 16 bits.
    fn sample_count(&mut self, bits: u8) -> Result<u32>;
    /// Appends the samples of a segment to `out`.
    fn samples(&mut self, sampling: &SamplingRecord, count: usize, out: &mut Vec<u16>) -> Result<()>;
    /// Checks that the waves end here.
    fn finish(&self) -> Result<()>;
    /// Returns whether the bytes did not suffice; results are then worthless.
    fn is_past_end(&self) -> bool;
    /// Creates an error at the next field.
    fn bad(&self, field: &str, problem: String) -> Error;
}

/// Returns the size of an uncompressed sample, bytes.
pub(super) fn bytes_per_sample(sampling: &SamplingRecord) -> usize {
    if sampling.bits_per_sample > 8 { 2 } else { 1 }
}

fn malformed(file: &Path, at: u64, pulse: u64, field: &str, problem: String) -> Error {
    Error::malformed(file, at, format!("pulse {pulse}: {field}"), problem, DAMAGED)
}

fn too_large() -> String {
    format!("the waves of the pulse take more than {MOST_BYTES} bytes")
}

/// Waves as stored without compression.
pub(super) struct StoredWaves<'a> {
    bytes: &'a [u8],
    /// Position in the bytes.
    at: usize,
    /// Bytes from the first of them to the end of the file.
    left: u64,
    is_past_end: bool,
    file: &'a Path,
    pulse: u64,
    start: u64,
}

impl<'a> StoredWaves<'a> {
    /// Starts at the first of `bytes`. The file has `left` bytes from there on; errors name the file, the number of the
    /// pulse and the offset in the file.
    pub(super) fn new(
        bytes: &'a [u8],
        left: u64,
        (file, pulse, start): (&'a Path, u64, u64),
    ) -> StoredWaves<'a> {
        StoredWaves { bytes, at: 0, left, is_past_end: false, file, pulse, start }
    }

    /// Reads `n` bytes.
    #[inline]
    fn take(&mut self, n: usize, field: &str) -> Result<&'a [u8]> {
        match self.bytes.get(self.at..).and_then(|rest| rest.get(..n)) {
            Some(taken) if self.at + n <= MOST_BYTES as usize => {
                self.at += n;
                Ok(taken)
            }
            _ => Err(self.missing(n, field)),
        }
    }

    /// Error for `n` bytes that cannot be read.
    #[cold]
    fn missing(&mut self, n: usize, field: &str) -> Error {
        let left = self.left - self.at as u64;
        if n as u64 > left {
            return self.bad(field, format!("{n} bytes needed, {left} left in the file"));
        }
        self.is_past_end = self.at + n <= MOST_BYTES as usize;
        self.bad(field, too_large())
    }

    /// Reads an unsigned number of 8, 16 or 32 bits.
    fn unsigned(&mut self, bits: u8, field: &str) -> Result<u32> {
        let bytes = self.take(usize::from(bits / 8), field)?;
        Ok(bytes.iter().rev().fold(0, |number, &byte| (number << 8) | u32::from(byte)))
    }
}

impl WaveInput for StoredWaves<'_> {
    fn skip(&mut self, bytes: usize) -> Result<()> {
        self.take(bytes, "extra waves bytes").map(|_| ())
    }

    fn segment_count(&mut self, bits: u8) -> Result<u32> {
        self.unsigned(bits, "number of segments")
    }

    fn duration(&mut self, bits: u8) -> Result<i32> {
        let unused = 32 - u32::from(bits);
        Ok(((self.unsigned(bits, "duration from anchor")? << unused) as i32) >> unused)
    }

    fn sample_count(&mut self, bits: u8) -> Result<u32> {
        self.unsigned(bits, "number of samples")
    }

    fn samples(&mut self, sampling: &SamplingRecord, count: usize, out: &mut Vec<u16>) -> Result<()> {
        let bytes_per_sample = bytes_per_sample(sampling);
        let bytes = self.take(count.saturating_mul(bytes_per_sample), "samples")?;
        if bytes_per_sample == 1 {
            out.extend(bytes.iter().map(|&b| u16::from(b)));
        } else {
            out.extend(bytes.chunks_exact(2).map(|b| u16::from_le_bytes([b[0], b[1]])));
        }
        Ok(())
    }

    fn finish(&self) -> Result<()> {
        Ok(())
    }

    fn is_past_end(&self) -> bool {
        self.is_past_end
    }

    fn bad(&self, field: &str, problem: String) -> Error {
        malformed(self.file, self.start + self.at as u64, self.pulse, field, problem)
    }
}

/// Models of compressed waves, kept for reuse.
#[derive(Debug)]
pub(super) struct WaveDecoder {
    /// Numbers of segments and samples, and durations.
    numbers: IntegerDecoder,
    of_8_bits: IntegerDecoder,
    of_16_bits: IntegerDecoder,
}

impl WaveDecoder {
    pub(super) fn new() -> WaveDecoder {
        WaveDecoder {
            numbers: IntegerDecoder::new(32, 1),
            of_8_bits: IntegerDecoder::new(8, 2),
            of_16_bits: IntegerDecoder::new(16, 2),
        }
    }
}

/// Waves that are compressed on their own: numbers and differences of samples, arithmetically coded.
pub(super) struct CompressedWaves<'a> {
    decoder: &'a mut WaveDecoder,
    bytes: &'a [u8],
    input: Decoder<'a>,
    file: &'a Path,
    pulse: u64,
    /// File offset of the coded bytes.
    start: u64,
    last_duration: i32,
    last_count: i32,
    /// Size of the samples so far without compression, bytes.
    sample_bytes: usize,
}

impl<'a> CompressedWaves<'a> {
    /// Starts at the first of `bytes`: file, number of the pulse, and offset in the file.
    pub(super) fn new(
        decoder: &'a mut WaveDecoder,
        bytes: &'a [u8],
        (file, pulse, start): (&'a Path, u64, u64),
    ) -> CompressedWaves<'a> {
        decoder.numbers.restart();
        let input = Decoder::new(bytes);
        let (last_duration, last_count, sample_bytes) = (0, 0, 0);
        CompressedWaves { decoder, bytes, input, file, pulse, start, last_duration, last_count, sample_bytes }
    }

    /// Returns a number that must be within `range`.
    fn within(&self, number: i32, range: RangeInclusive<i32>, field: &str) -> Result<i32> {
        if self.is_past_end() {
            self.finish()?;
        }
        match range.contains(&number) {
            true => Ok(number),
            false => {
                let (least, most) = range.into_inner();
                Err(self.bad(field, format!("{number} is not between {least} and {most}")))
            }
        }
    }
}

impl WaveInput for CompressedWaves<'_> {
    fn skip(&mut self, bytes: usize) -> Result<()> {
        if bytes > 0 {
            let left = self.bytes.len();
            let Some(coded) = self.bytes.get(bytes..) else {
                let problem = format!("{bytes} bytes needed, {left} left in the file");
                return Err(self.bad("extra waves bytes", problem));
            };
            self.start += bytes as u64;
            self.input = Decoder::new(coded);
        }
        Ok(())
    }

    fn segment_count(&mut self, bits: u8) -> Result<u32> {
        let count = self.decoder.numbers.number(&mut self.input, 1, 0);
        Ok(self.within(count, 0..=(1 << bits) - 1, "number of segments")? as u32)
    }

    fn duration(&mut self, bits: u8) -> Result<i32> {
        self.last_duration = self.decoder.numbers.number(&mut self.input, self.last_duration, 0);
        let most = i32::MAX >> (32 - bits);
        self.within(self.last_duration, -most - 1..=most, "duration from anchor")
    }

    fn sample_count(&mut self, bits: u8) -> Result<u32> {
        self.last_count = self.decoder.numbers.number(&mut self.input, self.last_count, 0);
        Ok(self.within(self.last_count, 0..=(1 << bits) - 1, "number of samples")? as u32)
    }

    fn samples(&mut self, sampling: &SamplingRecord, count: usize, out: &mut Vec<u16>) -> Result<()> {
        let bytes_per_sample = bytes_per_sample(sampling);
        self.sample_bytes = self.sample_bytes.saturating_add(count.saturating_mul(bytes_per_sample));
        if self.sample_bytes as u64 > MOST_BYTES {
            return Err(self.bad("samples", too_large()));
        }
        let numbers = match bytes_per_sample {
            1 => &mut self.decoder.of_8_bits,
            _ => &mut self.decoder.of_16_bits,
        };
        let context = if sampling.kind == SegmentKind::Returning { 0 } else { 1 };
        numbers.restart();
        let start = out.len();
        out.resize(start + count, 0);
        numbers.samples(&mut self.input, 0, context, out.get_mut(start..).unwrap_or_default());
        if self.is_past_end() { self.finish() } else { Ok(()) }
    }

    fn finish(&self) -> Result<()> {
        let end = self.input.check_end();
        end.map(|_| ()).map_err(|problem| self.bad("compressed waves", problem.to_owned()))
    }

    fn is_past_end(&self) -> bool {
        self.input.is_past_end()
    }

    fn bad(&self, field: &str, problem: String) -> Error {
        malformed(self.file, self.start + self.input.position(), self.pulse, field, problem)
    }
}
