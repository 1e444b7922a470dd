//! Stages by their names, and names that were probably meant.

use super::StageSpec;

/// Returns the stage of this name in a list.
pub fn find_in(stages: &[&'static StageSpec], name: &str) -> Option<&'static StageSpec> {
    stages.iter().find(|spec| spec.name == name).copied()
}

/// Returns the name most similar to `name`.
///
/// Similarity is the edit distance, which must not exceed a third of the length (at least 1). If no name is
/// similar, the shortest one that begins with `name`, of at least three characters.
pub fn nearest_of<'n>(name: &str, names: impl IntoIterator<Item = &'n str>) -> Option<&'n str> {
    let length = name.chars().count();
    let slips_allowed = length.max(3) / 3;
    // The distance is at least the difference of the lengths; a long name would take long.
    let is_close = |candidate: &&'n str| candidate.chars().count().abs_diff(length) <= slips_allowed;
    let slips = |candidate: &'n str| (strsim::damerau_levenshtein(name, candidate), candidate);
    let names: Vec<&str> = names.into_iter().collect();
    let close = names.iter().copied().filter(is_close).map(slips);
    let nearest = close.filter(|(slips, _)| *slips <= slips_allowed).min().map(|(_, name)| name);
    nearest.or_else(|| {
        let longer = names.into_iter().filter(|candidate| length >= 3 && candidate.starts_with(name));
        longer.min_by_key(|candidate| candidate.len())
    })
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
        assert_eq!(nearest("decomp"), Some("decompose"), "a beginning");
        assert_eq!(nearest("write"), Some("write_las"), "the shortest");
        assert_eq!(nearest("wr"), None, "too short");
        assert_eq!(nearest("ready"), None, "not similar to any name");
        assert_eq!(nearest(""), None);
    }
}
