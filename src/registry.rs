//! The list of all stages. A stage exists for jobs, the manual and the tests as soon as it stands here.

use crate::stage::StageSpec;
use crate::stages::{
    calibrate, correct, decompose, filter_outliers, fuse_channels, georeference, read_arrow, read_las,
    read_pulsewaves, read_sdf, resolve_mta, simulate, write_arrow, write_ascii, write_las, write_lstat,
    write_table, write_trajectory,
};

/// Every stage that a job can name, in the order of the manual: sources, what changes lines, sinks.
pub const STAGES: &[&StageSpec] = &[
    &read_las::STAGE,
    &read_pulsewaves::STAGE,
    &read_sdf::STAGE,
    &read_arrow::STAGE,
    &simulate::STAGE,
    &resolve_mta::STAGE,
    &fuse_channels::STAGE,
    &calibrate::STAGE,
    &decompose::STAGE,
    &correct::STAGE,
    &filter_outliers::STAGE,
    &georeference::STAGE,
    &write_las::STAGE,
    &write_ascii::STAGE,
    &write_trajectory::STAGE,
    &write_lstat::STAGE,
    &write_table::STAGE,
    &write_arrow::STAGE,
];

/// The stage of this name.
pub fn find(name: &str) -> Option<&'static StageSpec> {
    find_in(STAGES, name)
}

/// The name in the list that one may have meant by `name`.
pub fn nearest(name: &str) -> Option<&'static str> {
    nearest_of(name, STAGES.iter().map(|spec| spec.name))
}

/// The stage of this name in a list of one's own.
pub fn find_in(stages: &[&'static StageSpec], name: &str) -> Option<&'static StageSpec> {
    stages.iter().find(|spec| spec.name == name).copied()
}

/// The name among `names` that one may have meant: the one that the fewest slips of the pen lead to, where these are
/// few against its length.
pub fn nearest_of<'n>(name: &str, names: impl IntoIterator<Item = &'n str>) -> Option<&'n str> {
    let slips_allowed = name.chars().count().max(3) / 3;
    let slips = |candidate: &'n str| (strsim::damerau_levenshtein(name, candidate), candidate);
    names.into_iter().map(slips).filter(|(slips, _)| *slips <= slips_allowed).min().map(|(_, name)| name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slip_of_the_pen_finds_the_name_that_was_meant() {
        let names = ["read_las", "decompose", "write_las", "write_lstat"];
        let nearest = |name| nearest_of(name, names);
        assert_eq!(nearest("decompsoe"), Some("decompose"));
        assert_eq!(nearest("write_laz"), Some("write_las"));
        assert_eq!(nearest("write_lstats"), Some("write_lstat"));
        assert_eq!(nearest("ready"), None, "too far from any");
        assert_eq!(nearest(""), None);
    }
}
