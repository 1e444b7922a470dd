//! The stages: one file each, with its keys, its code and its tests.

mod container_info;
pub mod read_arrow;
pub mod write_arrow;
pub mod write_table;
