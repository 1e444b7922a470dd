//! `wavex convert`: copies a recording into the open container.

use std::path::Path;

use super::place::check_recording;
use super::{Failure, MachineArgs, run};
use wavex_engine::job::Job;
use wavex_formats::extensions::has_extension;
use wavex_formats::format::reader_of;
use wavex_run::run::RunRequest;
use wavex_stages::registry::STAGES;

/// Runs the job that copies `input` to `output`.
///
/// Relative paths start at the current folder.
pub(super) fn convert(input: &str, output: &str, machine: MachineArgs, quiet: bool) -> Result<(), Failure> {
    check_recording(Path::new(input))?;
    let text = job_text(input, output).map_err(Failure::Wrong)?;
    let overrides: Vec<_> = machine.overrides().into_iter().collect();
    let job = Job::parse(STAGES, "the job of `wavex convert`", &text, &overrides)?;
    run::run_job(RunRequest::quiet(&job, Path::new(".")), machine, quiet).map(drop)
}

/// TOML of the job that copies waveforms from `input` into container `output`.
fn job_text(input: &str, output: &str) -> Result<String, String> {
    let reader = reader_of(input)?;
    let is_arrow = has_extension(Path::new(output), "arrow");
    if output != "-" && !is_arrow {
        return Err(format!(
            "{output}: the container is Arrow; give a name that ends in .arrow. To write tables of returns \
             (Parquet, CSV or Arrow), use the stage write_table in a job"
        ));
    }
    let quoted = |text: &str| toml::Value::String(text.to_owned());
    Ok(format!(
        "[job]\nreport = \"\"\nstat_log = \"\"\nlog = \"\"\n\n[[stage]]\ntype = \"{reader}\"\npath = {}\n\n[[stage]]\ntype = \"write_arrow\"\npath = {}\n",
        quoted(input),
        quoted(output)
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_job_is_a_copy_and_its_names_are_quoted() {
        let text = job_text(r#"a "b" \c.las"#, "d.arrow").unwrap();
        let job: toml::Table = toml::from_str(&text).unwrap();
        let own_files = ["report", "stat_log", "log"].map(|key| job["job"][key].as_str());
        assert_eq!(own_files, [Some(""); 3], "writes nothing but the container");
        assert_eq!(job["stage"][0]["path"].as_str(), Some(r#"a "b" \c.las"#));
        assert_eq!(job["stage"][1]["type"].as_str(), Some("write_arrow"));
    }
}
