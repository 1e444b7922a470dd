//! Readers: sources of scan lines.

pub mod read_arrow;
pub mod read_hdf5;
pub mod read_las;
pub mod read_pulsewaves;
pub mod read_returns;
pub mod read_sdf;
pub mod simulate;
