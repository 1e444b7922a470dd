//! The table `[job.geometry]`: a run's trajectory, how the scanner is mounted, and the coordinates that points get.
//!
//! With a trajectory each shot gets its pose as soon as the source has delivered it ([`posed`]): its beam then starts and
//! points in the earth's own frame (ECEF), so that no later stage needs more than the emission. `georeference` turns what
//! it finds there into coordinates ([`target`]). `docs/georeferencing.md` gives the formulas.

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
