//! The list of all stages, for jobs, the manual and the tests.

use crate::process::{
    calibrate, classify, correct, decompose, filter_outliers, fuse_channels, georeference,
    measure_footprints, resolve_mta,
};
use crate::readers::{read_arrow, read_hdf5, read_las, read_pulsewaves, read_returns, read_sdf, simulate};
use crate::writers::{
    write_arrow, write_ascii, write_dem, write_footprints, write_las, write_lstat, write_patches,
    write_returns, write_table, write_trajectory,
};
use wavex_line::stage::{StageSpec, find_in};

/// All stages that a job can use, in the order of the manual.
pub const STAGES: &[&StageSpec] = &[
    &read_las::STAGE,
    &read_pulsewaves::STAGE,
    &read_sdf::STAGE,
    &read_arrow::STAGE,
    &read_hdf5::STAGE,
    &read_returns::STAGE,
    &simulate::STAGE,
    &resolve_mta::STAGE,
    &fuse_channels::STAGE,
    &calibrate::STAGE,
    &decompose::STAGE,
    &measure_footprints::STAGE,
    &correct::STAGE,
    &filter_outliers::STAGE,
    &georeference::STAGE,
    &classify::STAGE,
    &write_las::STAGE,
    &write_ascii::STAGE,
    &write_trajectory::STAGE,
    &write_lstat::STAGE,
    &write_table::STAGE,
    &write_footprints::STAGE,
    &write_patches::STAGE,
    &write_dem::STAGE,
    &write_arrow::STAGE,
    &write_returns::STAGE,
];

/// Returns the stage of this name.
pub fn find(name: &str) -> Option<&'static StageSpec> {
    find_in(STAGES, name)
}

#[cfg(test)]
mod tests {
    use wavex_formats::format::FORMATS;

    use super::*;

    #[test]
    fn readers_of_all_formats_are_stages() {
        for format in FORMATS {
            assert!(find(format.reader).is_some(), "{}", format.reader);
        }
    }
}
