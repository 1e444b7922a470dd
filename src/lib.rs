//! Open engine that turns full-waveform lidar recordings into point clouds.
//!
//! `ARCHITECTURE.md` describes the structure of the crate. `docs/stages.md` and `wavex stages`
//! document the stages.

pub mod archive;
pub mod cli;
pub mod engine;
pub mod georef;
pub mod inspect;
pub mod job;
pub mod keys;
pub mod registry;
pub mod report;
pub mod scan_line;
pub mod stage;
pub mod stages;
