//! Georeferencing of recordings in the scanner's frame with a trajectory.

mod chain;
mod contradictions;
mod coordinates;
mod elsewhere;
mod flights;
mod times;
mod uncertainty;
