//! `wavex calibrate`: runs a reader and `calibrate` to make a sensor model.

use std::path::Path;

use super::{CalibrateArgs, Failure, run, terminal};
use crate::job::{Job, Override};
use crate::registry::reader_of;
use crate::report::sensor_model_words;

/// Calibrates from a recording, saves the model if requested, prints it.
pub(super) fn calibrate(args: &CalibrateArgs, quiet: bool) -> Result<(), Failure> {
    let text = job_text(args).map_err(Failure::Wrong)?;
    let set = args.set.iter().map(Override::new).chain(args.machine.overrides());
    let mut job = Job::parse("the job of `wavex calibrate`", &text, &set.collect::<Vec<_>>())?;
    // A missing sink is intended here and needs no warning.
    job.notes.clear();
    let report = run::run_job(&job, Path::new("."), args.machine, true)?;
    let Some(input) = report.inputs.first().filter(|_| !quiet) else {
        return Ok(());
    };
    let mut said = format!("{}\n", args.file.display());
    for (name, words) in input.sensor_model.iter().flat_map(sensor_model_words) {
        said += &format!("  {name:14}  {words}\n");
    }
    for output in &input.outputs {
        let path = terminal::shown(output).display().to_string();
        said += &format!(
            "wrote {path}; use it in a job: `load = {}` of calibrate\n",
            toml::Value::String(path.clone())
        );
    }
    terminal::print(&said)
}

/// TOML of a job that reads the recording and calibrates.
fn job_text(args: &CalibrateArgs) -> Result<String, String> {
    let file = args.file.display().to_string();
    let reader = reader_of(&file)?;
    let quoted = |text: String| toml::Value::String(text);
    let save = match &args.save_preset {
        Some(path) if !path.extension().is_some_and(|found| found.eq_ignore_ascii_case("json")) => {
            return Err(format!(
                "--save-preset {}: a sensor model is JSON; give a name that ends in .json",
                path.display()
            ));
        }
        Some(path) => format!("save = {}\n", quoted(path.display().to_string())),
        None => String::new(),
    };
    Ok(format!(
        "[job]\nreport = \"\"\nstat_log = \"\"\nlog = \"\"\n\n[[stage]]\ntype = \"{reader}\"\npath = {}\n\n\
         [[stage]]\ntype = \"calibrate\"\n{save}",
        quoted(file)
    ))
}
