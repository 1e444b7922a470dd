//! Stages between readers and writers.

pub mod calibrate;
pub mod classify;
pub mod correct;
pub mod decompose;
pub mod filter_outliers;
pub mod fuse_channels;
pub mod georeference;
mod line_blocks;
pub mod measure_footprints;
pub mod resolve_mta;
