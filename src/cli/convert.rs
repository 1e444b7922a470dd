//! `wavex convert`: a job of two stages, from a recording to the open container.

use std::path::Path;

use super::{Failure, Machine, run};
use crate::job::Job;

/// Runs the job that copies `input` into `output`; relative paths start at the current folder.
pub(super) fn convert(input: &str, output: &str, machine: Machine, quiet: bool) -> Result<(), Failure> {
    let text = job_text(input, output).map_err(Failure::Wrong)?;
    let overrides: Vec<_> = machine.overrides().into_iter().collect();
    let job = Job::parse("the job of `wavex convert`", &text, &overrides)?;
    run::run_job(&job, Path::new("."), machine, quiet)
}

/// The job that copies waveforms from `input` into the container `output`.
fn job_text(input: &str, output: &str) -> Result<String, String> {
    let reader = reader_of(input)?;
    let quoted = |text: &str| toml::Value::String(text.to_owned());
    Ok(format!(
        "[job]\nreport = \"\"\nlog = \"\"\nstat_log = \"\"\n\n[[stage]]\ntype = \"{reader}\"\npath = {}\n\n[[stage]]\ntype = \"write_arrow\"\npath = {}\n",
        quoted(input),
        quoted(output)
    ))
}

/// The stage that reads files with this name's extension.
pub(super) fn reader_of(input: &str) -> Result<&'static str, String> {
    let extension = Path::new(input).extension().unwrap_or_default().to_string_lossy().to_lowercase();
    match extension.as_str() {
        "las" | "laz" => Ok("read_las"),
        "pls" => Ok("read_pulsewaves"),
        "sdf" | "wfm" => Ok("read_sdf"),
        "arrow" => Ok("read_arrow"),
        _ => {
            let known = "an input ends in .las, .laz, .pls, .sdf, .wfm or .arrow";
            Err(format!("{input}: the name does not say what kind of recording this is; {known}"))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_extension_chooses_the_reader() {
        let readers =
            ["a/B.LAS", "b.laz", "in/*.pls", "d.arrow", "130621_101500.sdf", "w.WFM"].map(reader_of);
        let expected = ["read_las", "read_las", "read_pulsewaves", "read_arrow", "read_sdf", "read_sdf"];
        assert_eq!(readers, expected.map(Ok));
        let problem = "a.rxp: the name does not say what kind of recording this is; \
                       an input ends in .las, .laz, .pls, .sdf, .wfm or .arrow";
        assert_eq!(reader_of("a.rxp"), Err(problem.to_owned()));
    }

    #[test]
    fn names_are_quoted_as_toml_wants_it() {
        let text = job_text(r#"a "b" \c.las"#, "d.arrow").unwrap();
        let job: toml::Table = toml::from_str(&text).unwrap();
        assert_eq!(job["stage"][0]["path"].as_str(), Some(r#"a "b" \c.las"#));
        assert_eq!(job["stage"][1]["type"].as_str(), Some("write_arrow"));
        let about_the_run = ["report", "log", "stat_log"].map(|key| job["job"][key].as_str());
        assert_eq!(about_the_run, [Some(""); 3], "nothing but the container is written");
    }
}
