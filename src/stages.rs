//! The stages: one file each, with its keys, what it does, and its tests.

pub mod simulate;
