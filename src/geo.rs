//! Time and geometry: numbers to numbers.

pub mod time;
