//! Readers of lidar waveforms in HDF5.
//!
//! | product | content |
//! |---|---|
//! | GEDI L1B (`GEDI01_B_*.h5`) | eight beams, each a recording |
//! | LVIS L1B (`ILVIS1B_*.h5`, `LVIS1B_*.h5`) | one beam; 352 to 1216 samples per shot |
//! | SPD 3 and 4 (`*.spd`) | pulses of a laser scanner, by SPDLib and pylidar |
//!
//! The crate has its own reader of HDF5, because no size in a file is trusted: every address, count and size is
//! checked against the file before anything is allocated. It reads integers, IEEE floats and records of both with
//! one or two dimensions in all layouts except virtual ones, with the filters deflate, shuffle and Fletcher-32;
//! and text in headers.
//!
//! [`Granule`] lists the beams, [`BeamReader`] reads shots in any order, [`SpdReader`] pulses. One row of chunks of
//! each data set is kept decoded, so reading in order decodes each chunk once, and a shot at any place needs at
//! most two.

mod attribute;
mod beam;
mod chunk_arrays;
mod chunk_index;
mod dataset;
mod filters;
mod fractal_heap;
mod gedi;
mod granule;
mod group;
mod input;
mod layout;
mod lvis;
mod members;
mod number;
mod object;
mod product;
mod record;
mod shot;
mod spd;
mod superblock;
mod table;
mod text;
mod tree;

pub use beam::BeamReader;
pub use granule::{Beam, Granule, Power};
pub use product::{Product, product_of};
pub use shot::{Position, Shot, TimeScale};
pub use spd::{SpdHeader, SpdPulse, SpdReader, SpdVersion, SpdWaveform};
