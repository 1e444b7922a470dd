//! The stages, one file each; `registry.rs` lists them.

mod broken;
pub mod georeference;
mod lines;
pub mod read_pulsewaves;
pub mod write_lstat;
