//! The stages, one file each; `registry.rs` lists them.

pub mod georeference;
mod lines;
pub mod write_lstat;
