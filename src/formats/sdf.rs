//! RIEGL's SDF and WFM files, read through RIEGL's own library.
//!
//! The byte layout of these files is not public; the C interface of RIEGL's Waveform Extraction Library (RiWAVELib)
//! is: thirteen functions `fwifc_*`, served by `sdfifc` for `.sdf` and, with the same interface, by `wfmifc-mt` for
//! `.wfm`. Owners of a RIEGL instrument have the library, and its licence forbids shipping it: it is found and loaded at
//! run time ([`library`]). The declarations are our own (`interface`), and so is the stand-in library that the tests
//! read through (`examples/sdf_stand_in`). **No real SDF file has been read with this module.**
//!
//! # Trust
//! The library is not thread-safe, what it points to is valid until its next call, and its last error is global: one
//! process-wide lock is held from a call until everything it gave is copied out. Counts and strides pass a limit before
//! anything is allocated or read; null pointers and sizes that cannot be are errors. That a pointer points to as much
//! memory as the library says is beyond any check.

mod fault;
mod index_dir;
mod interface;
pub mod library;
mod reader;

pub use interface::Version;
pub use reader::{CalibrationTables, SdfReader};

/// Most blocks of one record.
pub const MAX_BLOCKS: u32 = 1 << 12;
/// Most samples of one block: 65 µs at 1 ns.
pub const MAX_SAMPLES: u32 = 1 << 16;
/// Most samples of one record.
pub const MAX_RECORD_SAMPLES: usize = 1 << 20;
/// Most entries of a calibration table; digitisers of 8 bits have 256.
pub const MAX_TABLE: u32 = 1 << 16;

/// What a file says of the recording as a whole (`fwifc_get_info`).
#[derive(Clone, Debug, PartialEq)]
pub struct SdfInfo {
    /// The instrument's name; may be empty.
    pub instrument: String,
    /// The instrument's serial number; may be empty.
    pub serial: String,
    /// What external times count from: a date and time (ISO 8601), `DAYSEC`, `WEEKSEC` or `UNKNOWN`.
    pub epoch: String,
    /// Speed of the pulse in air, m/s; above 0, at most that of light in vacuum.
    pub group_velocity_mps: f64,
    /// Time between samples, s; above 0, at most a microsecond.
    pub sampling_interval_s: f64,
    /// Bit 0: external times are synchronised with GPS.
    pub flags: u16,
    /// How many facets the mirror has.
    pub facets: u16,
}

impl SdfInfo {
    /// Whether external times are synchronised with GPS.
    pub fn is_synchronised(&self) -> bool {
        self.flags & record_flags::SYNCHRONISED != 0
    }
}

/// Bits of [`SdfRecord::flags`].
pub mod record_flags {
    /// The clock is synchronised with GPS.
    pub const SYNCHRONISED: u16 = 1;
    /// It was synchronised within the last second.
    pub const SYNCHRONISED_WITHIN_LAST_SECOND: u16 = 1 << 1;
    /// A record of the instrument's housekeeping.
    pub const HOUSEKEEPING: u16 = 1 << 2;
    /// The end of a scan line: on its last shot, and on the record without blocks that follows.
    pub const END_OF_LINE: u16 = 1 << 3;
}

/// Codes of [`SdfBlock::channel`].
pub mod channel {
    /// The receiver for strong echoes.
    pub const HIGH_POWER: u32 = 0;
    /// The more sensitive receiver.
    pub const LOW_POWER: u32 = 1;
    /// A receiver that only tells of saturation.
    pub const SATURATION: u32 = 2;
    /// The outgoing pulse.
    pub const REFERENCE: u32 = 3;
}

/// A record: a shot with its blocks, or something between shots. Everything is as the library gave it; nothing is checked
/// but the sizes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SdfRecord {
    /// Time on the instrument's clock, s: the start of the shot's range gate, which names the shot.
    pub time_s: f64,
    /// The same moment in external time, s.
    pub time_external_s: f64,
    /// Where the beam starts, m, in the scanner's frame.
    pub origin_m: [f64; 3],
    /// Along the outgoing beam, in the scanner's frame; a unit vector, if the shot is one.
    pub direction: [f64; 3],
    /// Bits of [`record_flags`].
    pub flags: u16,
    /// Mirror facet.
    pub facet: u16,
    /// The blocks, in the library's order.
    pub blocks: Vec<SdfBlock>,
    /// The samples of all blocks, one after the other.
    samples: Vec<u16>,
}

/// A block of a record.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SdfBlock {
    /// See [`channel`]; any value may stand here.
    pub channel: u32,
    /// Time of the first sample after the record's `time_s`, s.
    pub start_s: f64,
    /// The first sample's place among those of the record.
    first: usize,
    /// How many samples there are; a reference block without any carries the emission's time in `start_s` (`.wfm`).
    len: usize,
}

impl SdfRecord {
    /// The samples of one of this record's blocks, digitiser steps.
    pub fn samples(&self, block: &SdfBlock) -> &[u16] {
        self.samples.get(block.first..block.first + block.len).unwrap_or_default()
    }

    /// How many samples all blocks have.
    pub fn n_samples(&self) -> usize {
        self.samples.len()
    }

    /// Adds a block behind the others.
    pub fn push(&mut self, channel: u32, start_s: f64, samples: &[u16]) {
        let first = self.samples.len();
        self.samples.extend_from_slice(samples);
        self.blocks.push(SdfBlock { channel, start_s, first, len: samples.len() });
    }

    /// Forgets the blocks.
    fn clear(&mut self) {
        self.blocks.clear();
        self.samples.clear();
    }
}

impl SdfBlock {
    /// How many samples the block has.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether it has none.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }
}
