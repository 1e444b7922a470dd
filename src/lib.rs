//! wavex turns recorded full-waveform lidar into point clouds one can trust.
//!
//! The map of the crate is `ARCHITECTURE.md`; the manual of the stages is `docs/stages.md`, or `wavex stages`.

pub mod batch;
pub mod cli;
pub mod engine;
pub mod formats;
pub mod kernels;
