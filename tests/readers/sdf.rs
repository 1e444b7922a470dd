//! `read_sdf` through the stand-in for RIEGL's library (`examples/sdf_stand_in`).
//!
//! Compared with `read_arrow`, and with faults of the library or the data.

mod faults;
mod index;
mod library;
mod same;
mod shots;
mod stand_in;
mod times;
