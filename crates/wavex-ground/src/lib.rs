#![doc = include_str!("../README.md")]
#![warn(unreachable_pub)]

pub mod point;
pub mod rays;
