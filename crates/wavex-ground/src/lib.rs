#![doc = include_str!("../README.md")]
#![warn(unreachable_pub)]

pub mod filter;
pub mod height;
pub mod point;
pub mod rays;
pub mod terrain;
