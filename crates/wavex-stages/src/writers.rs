//! Writers: sinks of scan lines.

pub mod table;
pub mod write_arrow;
pub mod write_ascii;
pub mod write_dem;
pub mod write_footprints;
pub mod write_las;
pub mod write_lstat;
pub mod write_patches;
pub mod write_returns;
pub mod write_table;
pub mod write_trajectory;
