//! MTA resolution: from recorded blocks to their pulses, through the whole chain.

mod circular;
mod faults;
mod flights;
mod long_lines;
mod memory;
mod priors;
mod ten_scenes;
mod zones;
