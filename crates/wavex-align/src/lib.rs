#![doc = include_str!("../README.md")]
#![warn(unreachable_pub)]

pub mod adjust;
pub mod control;
mod control_rows;
pub mod estimable;
mod georeference;
pub mod matching;
mod normal;
pub mod observation;
pub mod parameters;
pub mod patch;
mod residual;
pub mod result;
pub mod scanner;
#[cfg(test)]
mod simulated;
mod solution;
pub mod sparse;
pub mod survey;
pub mod time_errors;
pub mod variance;
mod vector;
