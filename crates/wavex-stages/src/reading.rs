//! What readers share.

pub mod bad_records;
pub mod emission_choice;
pub mod line_splitter;
pub mod plausible;
pub mod recording;
