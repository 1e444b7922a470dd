//! wavex turns recorded full-waveform lidar into point clouds one can trust.
//!
//! The map of the crate is `ARCHITECTURE.md`; the manual of the stages is `docs/stages.md`, or `wavex stages`.

pub mod archive;
pub mod batch;
pub mod cli;
pub mod engine;
pub mod formats;
pub mod geo;
pub mod geometry;
pub mod job;
pub mod kernels;
pub mod overview;
pub mod registry;
pub mod simulation;
pub mod stage;
pub mod stages;
pub mod survey;

// The stages of the integration tests serve the unit tests, too: there the crate goes by its own name.
#[cfg(test)]
extern crate self as wavex;
#[cfg(test)]
#[path = "../tests/stages/mod.rs"]
mod test_stages;
