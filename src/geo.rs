//! Time and geometry: numbers to numbers.

pub mod beam_length;
pub mod time;
