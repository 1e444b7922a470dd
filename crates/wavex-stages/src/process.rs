//! Stages between readers and writers.

pub mod calibrate;
pub mod correct;
pub mod decompose;
pub mod filter_outliers;
pub mod fuse_channels;
pub mod georeference;
pub mod measure_footprints;
pub mod resolve_mta;
