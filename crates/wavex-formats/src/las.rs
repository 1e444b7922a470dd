//! LAS and LAZ: full-waveform input, point and waveform output, COPC copies.
//!
//! Input has point formats 4, 5, 9 and 10. Output has formats 1 and 6, or 4 and 9 with waveforms.
//!
//! The specification is ASPRS LAS 1.4 R15. Older versions differ only in the length of the header;
//! LAS 1.5 appends three fields to it. Compression is LASzip, through the `laz` crate.
//!
//! [`Reader`] yields points one by one and, on request, the waveform packet of a point. [`Writer`]
//! takes points, preferably many at once, and compresses them in parallel slabs. Neither allocates
//! per point.

mod chunks;
mod copc;
mod descriptor;
mod extra_bytes;
mod header;
mod lax;
mod packet_writer;
mod packets;
mod point;
mod point_out;
mod raw;
mod reader;
mod records;
mod round;
mod totals;
mod vlr;
mod writer;

pub use copc::{CopcSummary, Keep, write_copc};
pub use descriptor::Descriptor;
pub use extra_bytes::{
    AMP, ATTRIBUTES_1_0, ATTRIBUTES_1_1, CHANNEL, DEV_RATIO, DataType, ExtraAttribute, ExtraBytes, INT_ERR,
    RANGE_ERR, RAW_AMP, TARGET_THICK, THICK_ERR, WIDE_ERR, WIDE_RATIO, quantise,
};
pub use header::{GpsTime, Header};
pub use lax::beside as indexes_beside;
pub use packet_writer::{Packet, PacketWriter};
pub use point::{Point, Wave};
pub use point_out::PointOut;
pub use raw::{RawField, RawPoints};
pub use reader::Reader;
pub use round::nearest;
pub use vlr::Vlr;
pub use writer::{ExtraColumns, IndexPlace, TOGETHER, Version, WavePlace, Writer, WriterOptions};

#[cfg(test)]
mod tests;
