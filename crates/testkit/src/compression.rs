//! Compressed waveforms and pulses, written with the arithmetic coder of the crate `laz`.
//!
//! Layouts: `crates/wavex-formats/src/las/packet_decoder.rs` and `crates/wavex-formats/src/pulsewaves/zip.rs`.

mod pulses;

use laz::compressors::IntegerCompressor;
use laz::encoders::ArithmeticEncoder;

pub use pulses::chunks;

/// Encoder into memory.
type Encoder = ArithmeticEncoder<Vec<u8>>;

/// Integers of these bits in this many contexts.
fn integers(bits: u32, contexts: u32) -> IntegerCompressor {
    let mut integers = IntegerCompressor::new(bits, contexts, 8, 0);
    integers.init();
    integers
}

fn finished(mut encoder: Encoder) -> Vec<u8> {
    encoder.done().unwrap();
    encoder.into_inner()
}

/// Waveform packet of a `.wdz` file: at least one sample of 8 or 16 bits.
pub fn packet(bits: u8, samples: &[u16]) -> Vec<u8> {
    let mut bytes = samples[0].to_le_bytes()[..usize::from(bits / 8)].to_vec();
    let (mut encoder, mut numbers) = (Encoder::new(Vec::new()), integers(bits.into(), 1));
    for pair in samples.windows(2) {
        numbers.compress(&mut encoder, pair[0].into(), pair[1].into(), 0).unwrap();
    }
    bytes.extend(finished(encoder));
    bytes
}

/// Segment of the waves of a pulse.
#[derive(Clone, Debug, PartialEq)]
pub struct Segment {
    /// Whether it is a returning one.
    pub is_returning: bool,
    /// Bits of a sample: 8 or 16.
    pub bits: u8,
    /// Number of the segments of the sampling, if the segment is its first and the number is stored.
    pub segments: Option<u16>,
    /// Quantised duration, if it is stored.
    pub duration: Option<i32>,
    /// Whether the number of samples is stored.
    pub has_count: bool,
    /// Samples.
    pub samples: Vec<u16>,
}

/// Waves of a pulse in a `.wvz` file.
pub fn waves(segments: &[Segment]) -> Vec<u8> {
    let (mut encoder, mut numbers) = (Encoder::new(Vec::new()), integers(32, 1));
    let (mut last_duration, mut last_count) = (0, 0);
    for segment in segments {
        if let Some(count) = segment.segments {
            numbers.compress(&mut encoder, 1, count.into(), 0).unwrap();
        }
        if let Some(duration) = segment.duration {
            numbers.compress(&mut encoder, last_duration, duration, 0).unwrap();
            last_duration = duration;
        }
        if segment.has_count {
            let count = segment.samples.len() as i32;
            numbers.compress(&mut encoder, last_count, count, 0).unwrap();
            last_count = count;
        }
        let mut differences = integers(segment.bits.into(), 2);
        let mut last = 0;
        for &sample in &segment.samples {
            let context = u32::from(!segment.is_returning);
            differences.compress(&mut encoder, last, sample.into(), context).unwrap();
            last = sample.into();
        }
    }
    finished(encoder)
}
