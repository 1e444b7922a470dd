//! Commands as functions: production runs with their files, archives, surveys on clusters, single shots.
//!
//! [`run`] runs a job with report, log and archive; [`archive`] makes runs repeatable; [`cluster`] spreads a survey
//! over computers; [`align`] aligns its strips; [`classify`] classifies clouds of points; [`explain`] decomposes one shot.
//! Nothing here parses arguments or prints.

pub mod align;
pub mod archive;
pub mod classify;
pub mod cluster;
pub mod explain;
mod failure;
pub mod from_returns;
pub mod job_file;
pub mod log;
pub mod run;

pub use failure::Failure;
