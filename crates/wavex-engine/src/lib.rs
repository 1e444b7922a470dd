//! Runs a job: [`job`] makes a chain of stages of a text, [`engine`] runs it, [`recording`] reads parts of a
//! recording, [`missing`] finds what a wrong path meant.

pub mod build;
pub mod engine;
pub mod job;
pub mod missing;
pub mod recording;
