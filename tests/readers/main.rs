//! Readers: SDF, random access, and properties that a recording lacks or states wrongly.
#![allow(
    clippy::panic,
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a test fails by panicking, and prints its figures and what it skips"
)]

mod compressed;
mod crs_records;
mod declared;
mod foreign;
mod foreign_las;
mod hdf5;
mod random_access;
mod scan_angles;
mod sdf;
mod sensor_position;
mod spd;
