//! `wavex stages`: lists all stages or describes one.

use super::{Failure, print};
use wavex_engine::job::{manual_of, summary};
use wavex_line::stage::StageSpec;
use wavex_line::stage::{find_in, nearest_of};

/// Prints the list, or the page of one stage.
pub(super) fn stages(known: &[&'static StageSpec], name: Option<&str>) -> Result<(), Failure> {
    match name {
        None => print(&list(known)),
        Some(name) => print(&page(known, name)?),
    }
}

/// One row per stage: name, input and output kinds, first sentence.
fn list(known: &[&'static StageSpec]) -> String {
    let widest = |width: fn(&&'static StageSpec) -> usize| known.iter().map(width).max().unwrap_or(0);
    let (name_width, flow_width) = (widest(|spec| spec.name.len()), widest(|spec| flow(spec).len()));
    let line = |spec: &&'static StageSpec| {
        format!("{:name_width$}  {:flow_width$}  {}\n", spec.name, flow(spec), summary(spec))
    };
    known.iter().map(line).collect()
}

/// Input and output kinds; only the input if the kind does not change.
fn flow(spec: &StageSpec) -> String {
    let takes: Vec<String> = spec.accepts.iter().map(ToString::to_string).collect();
    match spec.makes {
        Some(makes) => format!("{} -> {makes}", takes.join("|")).trim_start().to_owned(),
        None => takes.join("|"),
    }
}

fn page(known: &[&'static StageSpec], name: &str) -> Result<String, Failure> {
    if let Some(spec) = find_in(known, name) {
        return Ok(manual_of(spec));
    }
    let names: Vec<&str> = known.iter().map(|spec| spec.name).collect();
    // `las` is a part of two names.
    let has_part = |stage: &&&str| stage.split('_').any(|part| part == name);
    let mut meant: Vec<&str> = nearest_of(name, names.iter().copied()).into_iter().collect();
    if meant.is_empty() {
        meant.extend(names.iter().filter(has_part));
    }
    let meant = match meant.join("` or `") {
        none if none.is_empty() => none,
        meant => format!("; did you mean `{meant}`?"),
    };
    let names = names.join(", ");
    Err(Failure::Wrong(format!("unknown stage `{name}`{meant} (stages: {names})")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use wavex_stages::registry::{STAGES, find};

    fn known<const N: usize>(names: [&str; N]) -> [&'static StageSpec; N] {
        names.map(|name| find(name).unwrap())
    }

    #[test]
    fn the_list_has_a_line_for_each_stage() {
        let known = known(["read_las", "calibrate", "decompose"]);
        let [read_las, calibrate, decompose] = known.map(summary);
        let expected = format!(
            "read_las   -> Shots          {read_las}\n\
             calibrate  Shots             {calibrate}\n\
             decompose  Shots -> Returns  {decompose}\n"
        );
        assert_eq!(list(&known), expected);
    }

    #[test]
    fn a_stage_has_a_page_and_a_misspelt_one_has_not() {
        assert_eq!(page(STAGES, "simulate").unwrap(), manual_of(find("simulate").unwrap()));
        let known = known(["read_las", "simulate"]);
        let error = page(&known, "simulat").unwrap_err();
        let expected =
            "error: unknown stage `simulat`; did you mean `simulate`? (stages: read_las, simulate)\n";
        assert_eq!(super::super::terminal::message(&error, false), expected);
        let error = page(STAGES, "decomp").unwrap_err();
        assert!(
            error.text().starts_with("unknown stage `decomp`; did you mean `decompose`? "),
            "{}",
            error.text()
        );
        let error = page(STAGES, "las").unwrap_err();
        assert!(error.text().contains("; did you mean `read_las` or `write_las`? "), "{}", error.text());
        let error = page(&known, "fly").unwrap_err();
        assert_eq!(
            super::super::terminal::message(&error, false),
            "error: unknown stage `fly` (stages: read_las, simulate)\n"
        );
    }
}
