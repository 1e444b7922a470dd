//! The list of all stages, for jobs, the manual and the tests.

use std::path::Path;

use crate::stage::StageSpec;
use crate::stages::{
    calibrate, correct, decompose, filter_outliers, fuse_channels, georeference, read_arrow, read_las,
    read_pulsewaves, read_sdf, resolve_mta, simulate, write_arrow, write_ascii, write_las, write_lstat,
    write_table, write_trajectory,
};
use wavex_formats::{Format, unsupported};

/// All stages that a job can use, in the order of the manual.
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

/// Returns the stage of this name.
pub fn find(name: &str) -> Option<&'static StageSpec> {
    find_in(STAGES, name)
}

/// Returns the reader for files with this extension.
///
/// # Errors
/// If the format is not supported, with an alternative if one is known.
pub fn reader_of(input: &str) -> Result<&'static str, String> {
    if let Some(error) = unsupported(Path::new(input)) {
        return Err(error.to_string());
    }
    let format = Format::of(Path::new(input)).map(|format| format.reader);
    format.ok_or_else(|| {
        format!("{input}: unknown recording format; supported extensions: {}", Format::all_extensions())
    })
}

/// Returns the registered name most similar to `name`.
pub fn nearest(name: &str) -> Option<&'static str> {
    nearest_of(name, STAGES.iter().map(|spec| spec.name))
}

/// Returns the stage of this name in a list.
pub fn find_in(stages: &[&'static StageSpec], name: &str) -> Option<&'static StageSpec> {
    stages.iter().find(|spec| spec.name == name).copied()
}

/// Returns the name most similar to `name`.
///
/// Similarity is the edit distance, which must not exceed a third of the length (at least 1).
pub fn nearest_of<'n>(name: &str, names: impl IntoIterator<Item = &'n str>) -> Option<&'n str> {
    let length = name.chars().count();
    let slips_allowed = length.max(3) / 3;
    // The distance is at least the difference of the lengths; a long name would take long.
    let is_close = |candidate: &&'n str| candidate.chars().count().abs_diff(length) <= slips_allowed;
    let slips = |candidate: &'n str| (strsim::damerau_levenshtein(name, candidate), candidate);
    names
        .into_iter()
        .filter(is_close)
        .map(slips)
        .filter(|(slips, _)| *slips <= slips_allowed)
        .min()
        .map(|(_, name)| name)
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

    #[test]
    fn the_extension_chooses_the_reader() {
        let readers =
            ["a/B.LAS", "b.laz", "in/*.pls", "d.arrow", "130621_101500.sdf", "w.WFM"].map(reader_of);
        let expected = ["read_las", "read_las", "read_pulsewaves", "read_arrow", "read_sdf", "read_sdf"];
        assert_eq!(readers, expected.map(Ok));
        let problem = "a.dat: unknown recording format; \
                       supported extensions: .las, .laz, .pls, .sdf, .wfm and .arrow";
        assert_eq!(reader_of("a.dat"), Err(problem.to_owned()));
        for name in ["a.rxp", "a.h5", "a.plz"] {
            assert!(reader_of(name).unwrap_err().contains(" is not supported; "), "{name}");
        }
    }

    #[test]
    fn a_slip_of_the_pen_finds_the_name_that_was_meant() {
        let names = ["read_las", "decompose", "write_las", "write_lstat"];
        let nearest = |name| nearest_of(name, names);
        assert_eq!(nearest("decompsoe"), Some("decompose"));
        assert_eq!(nearest("write_laz"), Some("write_las"));
        assert_eq!(nearest("write_lstats"), Some("write_lstat"));
        assert_eq!(nearest("ready"), None, "not similar to any name");
        assert_eq!(nearest(""), None);
    }
}
