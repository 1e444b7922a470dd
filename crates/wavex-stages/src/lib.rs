//! The stages of a job: readers, processing, writers.
//!
//! A file of [`readers`], [`process`] and [`writers`] is a stage; [`registry`] lists them. `reading` is what readers
//! share; [`terrain`] makes rasters of points.

pub mod checks;
mod container_info;
pub mod process;
pub mod readers;
pub mod reading;
pub mod registry;
pub mod returns_file;
pub mod stac;
pub mod terrain;
pub mod writers;
