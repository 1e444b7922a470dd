//! The open waveform container: recorded waveforms in an Arrow IPC file, before anything was decided about them.
//!
//! One record batch holds one scan line, one row one shot. The columns and the schema's metadata are listed in
//! [`layout`] and, for programs, in `schemas/container.json`, which a test writes from the same list. A sample `i` of
//! a block is at `clock_ps / 1000 + start_ns + i * interval_ns`, where `interval_ns` is `wavex.sampling_interval_ns`
//! unless the block says another.
//!
//! Read are the file format (told by its first bytes, `ARROW1`) and the stream format, with buffers plain or
//! compressed as LZ4 frames or ZSTD; see the Apache Arrow columnar format 1.5, "Serialization and Interprocess
//! Communication (IPC)". Columns and metadata keys that are not in the list are passed over.
//!
//! # Trust
//! `arrow-ipc` panics on, or allocates by, some lengths that a damaged file gives it. [`ContainerReader`] therefore
//! walks over the metadata of each record batch first (`guard`), and only a record batch whose buffers lie in its
//! body, are as long as its row count wants and unpack to at most [`MAX_BATCH_BYTES`] is unpacked (`unpack`), checked once
//! more, and handed to it; there, its own validation stays on.

mod builder;
mod decode;
mod guard;
mod header;
pub mod layout;
mod line;
mod lz4;
mod messages;
mod place;
mod reader;
mod table;
#[cfg(test)]
mod tests;
mod unpack;
mod writer;
mod xxh32;

pub use builder::LineBuilder;
pub use header::{ContainerHeader, EmissionReference, Frame, GainControl, Origin, TimeScale};
pub use line::{ContainerBlock, ContainerLine, ContainerOnline, ContainerShot};
pub use reader::ContainerReader;
pub use table::TableReader;
pub use writer::{Compression, ContainerWriter};

/// The value of `wavex.container` that this module reads and writes.
pub const VERSION: &str = "1";

/// The largest record batch that is read, in bytes, packed or unpacked: 2^30. A scan line of 4096 shots with 500
/// samples each takes 2^22.
pub const MAX_BATCH_BYTES: u64 = 1 << 30;

/// Memory for a line up to this size is kept for the next one, bytes.
const MOST_KEPT_BYTES: usize = 1 << 26;

/// Codes of the column `blocks.channel`.
pub mod channel {
    /// The receiver for strong echoes.
    pub const HIGH_POWER: u8 = 0;
    /// The more sensitive receiver.
    pub const LOW_POWER: u8 = 1;
    /// A receiver that only tells of saturation.
    pub const SATURATION: u8 = 2;
    /// The outgoing pulse.
    pub const REFERENCE: u8 = 3;
}
