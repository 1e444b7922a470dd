//! LAS and LAZ: full-waveform input, point and waveform output, COPC copies.
//!
//! Input has point formats 4, 5, 9 and 10. Output has formats 1 and 6, or 4 and 9 with waveforms.
//!
//! The specification is ASPRS LAS 1.4 R15. Older versions differ only in the length of the header;
//! LAS 1.5 appends three fields to it. Points are compressed by LASzip, through the `laz` crate;
//! waveform packets can be compressed as by LAStools (`.wdz`).
//!
//! [`Reader`] yields points one by one and, on request, the waveform packet of a point. [`Writer`]
//! takes points, preferably many at once, and compresses them in parallel slabs. Neither allocates
//! per point.
//!
//! ```
//! use std::{fs::File, io::Cursor};
//! use wavex_formats::las::*;
//!
//! let folder = tempfile::tempdir()?;
//! let path = folder.path().join("flight.las");
//! let options = WriterOptions {
//!     version: LasVersion::V1_4,
//!     scale: [0.001; 3],
//!     offset: [0.0; 3],
//!     wkt: None,
//!     extra_attributes: &[],
//!     adjusted_gps_time: true,
//!     creation_day: 1,
//!     creation_year: 2026,
//!     system_identifier: "",
//!     generating_software: "an example",
//!     file_source_id: 0,
//!     project_id: [0; 16],
//!     waveforms: WavePlace::Inside,
//!     index: IndexPlace::None,
//!     pool: None,
//! };
//! let mut writer = Writer::new(File::create(&path)?, &path, &options)?;
//! let mut packets = PacketWriter::new(Cursor::new(Vec::new()), &path)?;
//! let packet = packets.add(&[12, 40, 90, 41, 13], 1000)?.ok_or("too many kinds of packets")?;
//! let PacketReference { descriptor, offset, size } = packet;
//! let wave = Wave { descriptor, offset, size, ..Wave::default() };
//! writer.write_point(&PointOut { z: 1.5, wave, ..PointOut::default() }, &[])?;
//! let (mut packets, kinds) = packets.finish()?;
//! packets.set_position(0);
//! writer.finish_with_waveforms(&kinds, Some(&mut packets))?;
//!
//! let mut reader = Reader::open(&path)?;
//! let (mut point, mut samples) = (Point::default(), Vec::new());
//! while reader.next_point(&mut point)? {
//!     reader.packet(&point.wave, &mut samples)?;
//!     assert_eq!(samples, [12, 40, 90, 41, 13]);
//! }
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod checked;
mod chunks;
mod classified;
mod contained;
mod copc;
mod description;
mod descriptor;
mod encoding;
mod extent;
mod extra_bytes;
mod header;
mod lax;
mod packet_decoder;
mod packet_writer;
mod packets;
mod point;
mod point_out;
mod raw;
mod reader;
mod records;
mod round;
mod shifted;
mod totals;
mod vlr;
mod writer;

pub use checked::CheckedFile;
pub use classified::{ClassifiedCopy, write_classified};
pub use copc::{CopcSummary, Keep, ProgressObserver, write_copc};
pub use description::LasDescription;
pub use descriptor::PacketDescriptor;
#[cfg(test)]
use extra_bytes::tests::{AMP, CHANNEL};
pub use extra_bytes::{DataType, ExtraAttribute, ExtraBytes, quantise};
pub use header::{GpsTime, LasHeader, MAX_COORDINATE};
pub use lax::beside as indexes_beside;
pub use packet_writer::{PacketReference, PacketWriter};
pub use point::{Point, Wave};
pub use point_out::PointOut;
pub use raw::{RawField, RawPoints};
pub use reader::Reader;
pub use round::nearest;
pub use shifted::{ShiftedCopy, write_shifted};
pub use vlr::Vlr;
pub use writer::{ExtraColumns, IndexPlace, LasVersion, TOGETHER, WavePlace, Writer, WriterOptions};

#[cfg(test)]
mod tests;
