//! Tests that need more than one part: files made by hand, written files, real files.

mod chunks;
pub(super) mod made;
mod reader;
mod samples;
mod together;
mod writer;
