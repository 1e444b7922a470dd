//! The open waveform container: recorded waveforms in an Arrow IPC file.
//!
//! One record batch is one scan line, one row is one shot. [`layout`] lists the columns and the
//! metadata of the schema; a test writes `schemas/container.json` from the same list. Sample `i` of
//! a block is at `clock_ps / 1000 + start_ns + i * interval_ns`. `interval_ns` defaults to
//! `wavex.sampling_interval_ns`.
//!
//! The reader accepts the file format (its first bytes are `ARROW1`) and the stream format, with
//! buffers uncompressed or compressed as LZ4 frames or ZSTD. See the Apache Arrow columnar format
//! 1.5, "Serialization and Interprocess Communication (IPC)". Unknown columns and metadata keys are
//! ignored.
//!
//! # Versions
//! In version 1 samples are whole digitiser steps (`u16`). Version 2 has the same columns with samples
//! that are fractions of a step (`f32`), as instruments with large footprints deliver them, and the columns
//! of [`layout::FOOTPRINT`]. A container is written in version 1 unless its samples need version 2
//! ([`ContainerHeader::has_fractions`]).
//!
//! # Digests
//! The writer stores a digest with the schema, each record batch and the footer (`digest`); the
//! reader refuses a part whose bytes give another one. Files without digests are read. If schema or
//! footer have one, each record batch needs one.
//!
//! # Validation
//! `arrow-ipc` panics on some invalid lengths of a damaged file, or allocates by them.
//! [`ContainerReader`] therefore checks the metadata of each record batch first (`guard`). Its
//! buffers must be inside its body, have the lengths required by its row count, and decompress to at
//! most [`MAX_BATCH_BYTES`]. The record batch is then decompressed (`unpack`), checked again, and
//! passed to `arrow-ipc`, whose own validation is enabled.
//!
//! # Example
//! ```
//! use std::{io::Cursor, path::Path};
//! use wavex_formats::container::*;
//!
//! let name = Path::new("flight.arrow");
//! let mut line = LineBuilder::new();
//! line.shot(&ContainerShot {
//!     shot: 0,
//!     line: 0,
//!     gps_time_s: None,
//!     clock_ps: 0,
//!     origin_m: [0.0; 3],
//!     direction: [0.0, 0.0, -1.0],
//!     facet: 0,
//!     flags: 0,
//!     mta_zone: None,
//!     scan_angle_deg: None,
//!     frame_scale: None,
//! });
//! let samples = &[12, 40, 90, 41, 13];
//! let channel = channel::LOW_POWER;
//! line.block(&ContainerBlock { channel, start_ns: 800.0, interval_ns: None, zone: None, gain: None, samples });
//! let header = ContainerHeader::new(1.0, 299_702_547.0);
//! let mut writer = ContainerWriter::stream(Vec::new(), name, &header, Compression::Lz4)?;
//! writer.write(line)?;
//! let bytes = writer.finish()?;
//!
//! let mut reader = ContainerReader::from_stream(name, Box::new(Cursor::new(bytes)))?;
//! while let Some(line) = reader.next_line()? {
//!     for block in (0..line.rows()).flat_map(|row| line.blocks(row)) {
//!         assert_eq!(block.samples, samples);
//!     }
//! }
//! # Ok::<(), wavex_formats::Error>(())
//! ```

mod builder;
mod checked_schema;
mod decode;
mod digest;
mod guard;
mod header;
mod ipc_writer;
pub mod layout;
mod line;
mod location;
mod lz4;
mod messages;
mod reader;
mod table;
#[cfg(test)]
mod tests;
mod unpack;
mod writer;

pub use builder::LineBuilder;
pub use header::{ContainerHeader, EmissionReference, Frame, GainControl, Origin, TimeScale};
pub use ipc_writer::IpcWriter;
pub use line::{ContainerBlock, ContainerFootprint, ContainerLine, ContainerOnline, ContainerShot};
pub use reader::ContainerReader;
pub use table::TableReader;
pub use writer::{Compression, ContainerWriter};

/// Version of the layout, the value of `wavex.container`: samples are whole digitiser steps.
pub const VERSION: &str = "1";

/// Version of the layout whose samples are fractions of a digitiser step.
pub const VERSION_OF_FRACTIONS: &str = "2";

/// Largest accepted record batch, bytes, compressed or not.
///
/// A scan line of 4096 shots with 500 samples each takes 2^22 bytes.
pub const MAX_BATCH_BYTES: u64 = 1 << 30;

/// Largest buffer of a line that is kept for the next one, bytes.
const MOST_KEPT_BYTES: usize = 1 << 26;

/// Codes of the column `blocks.channel`.
pub mod channel {
    /// High-power receiver, for strong echoes.
    pub const HIGH_POWER: u8 = 0;
    /// Low-power receiver, for weak echoes.
    pub const LOW_POWER: u8 = 1;
    /// Receiver that records saturation only.
    pub const SATURATION: u8 = 2;
    /// The outgoing pulse.
    pub const REFERENCE: u8 = 3;
}
