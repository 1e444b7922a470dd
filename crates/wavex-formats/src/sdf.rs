//! RIEGL SDF and WFM files, read through RIEGL's own library.
//!
//! The byte layout of these files is not public. The C interface of RIEGL's Waveform Extraction
//! Library (RiWAVELib) is: thirteen functions `fwifc_*`, provided by `sdfifc` for `.sdf` and, with
//! the same interface, by `wfmifc-mt` for `.wfm`. Owners of a RIEGL instrument can obtain the
//! library. Its licence forbids redistribution, so it is located and loaded at run time
//! ([`library`]). The declarations (`interface`) and the stand-in library of the tests
//! (`examples/sdf_stand_in`) are our own. **No real SDF file has been read with this module.**
//!
//! # Trust
//! The library is not thread-safe, its pointers are valid until its next call, and its last error
//! is global. A process-wide lock is therefore held from each call until all results are copied.
//! Counts and strides are checked against limits before anything is allocated or read; null
//! pointers and invalid sizes are errors. Whether a pointer refers to as much memory as the library
//! states cannot be checked.

mod fault;
mod index_dir;
mod interface;
pub mod library;
mod reader;

pub use interface::LibraryVersion;
pub use reader::{CalibrationTables, SdfReader};

/// Maximum number of blocks of a record.
const MAX_BLOCKS: u32 = 1 << 12;
/// Maximum number of samples of a block.
///
/// 65 µs at 1 ns.
const MAX_SAMPLES: u32 = 1 << 16;
/// Maximum number of samples of a record.
const MAX_RECORD_SAMPLES: usize = 1 << 20;
/// Maximum number of entries of a calibration table.
///
/// 8-bit digitisers have 256.
const MAX_TABLE: u32 = 1 << 16;

/// Metadata of a recording (`fwifc_get_info`).
#[derive(Clone, Debug, PartialEq)]
pub struct SdfInfo {
    /// Instrument name; may be empty.
    pub instrument: String,
    /// Serial number; may be empty.
    pub serial: String,
    /// Epoch of external times.
    ///
    /// Date and time (ISO 8601), `DAYSEC`, `WEEKSEC` or `UNKNOWN`.
    pub epoch: String,
    /// Group velocity of the pulse in air, m/s.
    ///
    /// Above 0, at most the vacuum speed of light.
    pub group_velocity_mps: f64,
    /// Sampling interval, s; above 0, at most 1 µs.
    pub sampling_interval_s: f64,
    /// Bit 0: external times are synchronised with GPS.
    pub flags: u16,
    /// Number of mirror facets.
    pub facets: u16,
}

impl SdfInfo {
    /// Returns whether external times are synchronised with GPS.
    pub fn is_synchronised(&self) -> bool {
        self.flags & record_flags::SYNCHRONISED != 0
    }
}

/// Bits of [`SdfRecord::flags`].
pub mod record_flags {
    /// The clock is synchronised with GPS.
    pub const SYNCHRONISED: u16 = 1;
    /// The clock was synchronised within the last second.
    pub const SYNCHRONISED_WITHIN_LAST_SECOND: u16 = 1 << 1;
    /// Housekeeping record of the instrument.
    pub const HOUSEKEEPING: u16 = 1 << 2;
    /// End of a scan line.
    ///
    /// Set on its last shot, and on the following record without blocks.
    pub const END_OF_LINE: u16 = 1 << 3;
}

/// Codes of [`SdfBlock::channel`].
pub mod channel {
    /// High-power channel, for strong echoes.
    pub const HIGH_POWER: u32 = 0;
    /// Low-power channel, the more sensitive one.
    pub const LOW_POWER: u32 = 1;
    /// Saturation channel; only marks saturation.
    pub const SATURATION: u32 = 2;
    /// Reference channel: the outgoing pulse.
    pub const REFERENCE: u32 = 3;
}

/// Record: a shot with its blocks, or an event between shots.
///
/// All values are as returned by the library; only sizes are checked.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SdfRecord {
    /// Time on the instrument's clock, s.
    ///
    /// The start of the range gate, which identifies the shot.
    pub time_s: f64,
    /// The same instant in external time, s.
    pub time_external_s: f64,
    /// Origin of the beam in the scanner frame, m.
    pub origin_m: [f64; 3],
    /// Direction of the outgoing beam in the scanner frame.
    ///
    /// A unit vector for shots.
    pub direction: [f64; 3],
    /// Bits of [`record_flags`].
    pub flags: u16,
    /// Number of the mirror facet.
    pub facet: u16,
    /// Blocks, in the library's order.
    pub blocks: Vec<SdfBlock>,
    /// Samples of all blocks, concatenated.
    samples: Vec<u16>,
}

/// Sample block of a record.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SdfBlock {
    /// Channel code, see [`channel`]; may have any value.
    pub channel: u32,
    /// Time of the first sample relative to the record's `time_s`, s.
    pub start_s: f64,
    /// Index of the first sample in the samples of the record.
    first: usize,
    /// Number of samples.
    ///
    /// A reference block without samples carries the emission time in `start_s` (`.wfm`).
    len: usize,
}

impl SdfRecord {
    /// Returns the samples of a block of this record, digitiser steps.
    pub fn samples(&self, block: &SdfBlock) -> &[u16] {
        self.samples.get(block.first..block.first + block.len).unwrap_or_default()
    }

    /// Returns the number of samples of all blocks.
    pub fn n_samples(&self) -> usize {
        self.samples.len()
    }

    /// Appends a block.
    pub fn push(&mut self, channel: u32, start_s: f64, samples: &[u16]) {
        let first = self.samples.len();
        self.samples.extend_from_slice(samples);
        self.blocks.push(SdfBlock { channel, start_s, first, len: samples.len() });
    }

    /// Removes all blocks.
    fn clear(&mut self) {
        self.blocks.clear();
        self.samples.clear();
    }
}

impl SdfBlock {
    /// Returns the number of samples.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Returns whether the block has no samples.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_block_has_its_own_samples() {
        let mut record = SdfRecord::default();
        record.push(channel::REFERENCE, 1e-9, &[]);
        record.push(channel::HIGH_POWER, 2e-9, &[5, 6]);
        record.push(channel::LOW_POWER, 3e-9, &[7]);
        let lengths: Vec<usize> = record.blocks.iter().map(SdfBlock::len).collect();
        assert_eq!(lengths, [0, 2, 1]);
        assert!(record.blocks[0].is_empty() && !record.blocks[2].is_empty());
        let samples: Vec<&[u16]> = record.blocks.iter().map(|block| record.samples(block)).collect();
        assert_eq!(samples, [&[][..], &[5, 6], &[7]]);
        assert_eq!(record.n_samples(), 3);
        // A block of another record.
        assert_eq!(SdfRecord::default().samples(&record.blocks[1]), &[] as &[u16]);
    }
}
