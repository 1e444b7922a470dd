//! The stages, one file each; `registry.rs` lists them.

pub mod georeference;
pub mod write_lstat;
