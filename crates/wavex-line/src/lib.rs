//! What flows through a chain of stages, and the interfaces of those who process it.
//!
//! [`scan_line`] holds the data of one scan line; [`stage`] the four roles of stages and their context; [`reason`]
//! all reasons to drop an item; [`keys`] the keys of a job table; [`georef`] the table `[job.geometry]`.

pub mod georef;
pub mod keys;
pub mod plausibility;
pub mod printable;
pub mod reason;
pub mod scan_line;
pub mod stage;
pub mod system;
