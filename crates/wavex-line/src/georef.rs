//! Georeferencing: the table `[job.geometry]` with trajectory, mounting and output coordinates.
//!
//! With a trajectory, each shot gets its pose as soon as the source delivers it
//! ([`crate::stage::pose_source`]). Its beam is then given in the earth-centred frame (ECEF), so later stages need
//! only the shot. `georeference` converts the result to output coordinates ([`output_crs`]).
//! `docs/explanation/georeferencing.md` gives the formulas.

pub mod applied_corrections;
mod area_of_use;
pub mod calibration;
mod context;
pub mod corrections;
pub mod declared;
mod error;
pub mod keys;
pub mod mount;
pub mod output_crs;
pub mod scan_angles;
pub mod trajectory_file;
pub mod transform;

pub use area_of_use::check as area_check;
pub use context::week_check;
pub use context::{Geometry, Loader, ShotPoses};
pub use error::{Error, Result};
pub use keys::GeometryKeys;
pub use output_crs::MOST_WKT_BYTES;
pub use output_crs::{check_crs, check_crs_name};
pub use trajectory_file::checks as trajectory_checks;
pub use trajectory_file::trajectory_times;
