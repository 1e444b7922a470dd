//! Scenes with several pulses in the air, through the whole chain.

pub mod chain;
pub mod recording;
