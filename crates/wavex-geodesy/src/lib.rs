#![doc = include_str!("../README.md")]
#![warn(unreachable_pub)]

pub mod beam_length;
pub mod calendar;
pub mod calibration;
pub mod cone;
mod conformal;
pub mod crs;
pub mod ellipsoid;
pub mod frames;
pub mod geoid;
mod lambert;
pub mod polygon;
pub mod time;
pub mod time_axis;
pub mod trajectory;
pub mod transverse_mercator;
pub mod vertical;
