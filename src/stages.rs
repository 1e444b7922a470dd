//! Pipeline stages, one file each; `registry.rs` lists them.

mod bad_records;
pub mod calibrate;
mod container_info;
pub mod correct;
pub mod decompose;
mod emission_choice;
pub mod filter_outliers;
pub mod fuse_channels;
pub mod georeference;
mod line_splitter;
pub(crate) mod plausible;
pub mod pose_source;
pub mod read_arrow;
pub mod read_las;
pub mod read_pulsewaves;
pub mod read_sdf;
pub(crate) mod recording;
pub mod resolve_mta;
pub mod simulate;
pub(crate) mod stac;
pub mod write_arrow;
pub mod write_ascii;
pub mod write_las;
pub mod write_lstat;
pub mod write_table;
pub mod write_trajectory;
