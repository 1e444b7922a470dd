//! Georeferencing: the table `[job.geometry]` with trajectory, mounting and output coordinates.
//!
//! With a trajectory, each shot gets its pose as soon as the source delivers it ([`posed`]). Its
//! beam is then given in the earth-centred frame (ECEF), so later stages need only the emission.
//! `georeference` converts the result to output coordinates ([`target`]). `docs/explanation/georeferencing.md`
//! gives the formulas.

pub mod calibration;
pub mod declared;
pub mod keys;
mod loaded;
pub mod mount;
pub mod posed;
pub mod poses;
pub mod scan_angles;
pub mod target;
mod track;

pub use keys::GeometryKeys;
pub use loaded::{Geometry, Loader};
pub use target::check_crs;
