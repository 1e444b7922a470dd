//! Tests across several modules: handmade files, written files, real files.

mod chunks;
pub(super) mod made;
mod reader;
mod samples;
mod together;
mod writer;
