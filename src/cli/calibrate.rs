//! `wavex calibrate`: runs a reader and `calibrate` to make a sensor model.

use std::io::{IsTerminal, Write};
use std::path::Path;

use super::place::check_recording;
use super::{CalibrateArgs, Failure, JobArgs, run, terminal};
use wavex_engine::engine::{self, Options};
use wavex_engine::job::{Job, Override};
use wavex_formats::Error;
use wavex_formats::extensions::has_extension;
use wavex_formats::format::small_footprint_reader_of;
use wavex_line::stage::{FinishedFile, OutputFile};
use wavex_pages::report::{sensor_model_words, survey_table};
use wavex_run::archive::shown;
use wavex_run::run::{RunRequest, folders};
use wavex_stages::registry::STAGES;

/// Calibrates from a recording or a survey, saves the model if requested, prints it.
pub(super) fn calibrate(args: &CalibrateArgs, quiet: bool) -> Result<(), Failure> {
    if has_extension(&args.file, "toml") {
        return of_survey(args, quiet);
    }
    if args.out.is_some() {
        let problem = "--out is for the models of a job; to save the model of a recording, use --save-preset";
        return Err(Failure::Wrong(problem.to_owned()));
    }
    check_recording(&args.file)?;
    let text = job_text(args).map_err(Failure::Wrong)?;
    let set = args.set.iter().map(Override::new).chain(args.machine.overrides());
    let mut job = Job::parse(STAGES, "the job of `wavex calibrate`", &text, &set.collect::<Vec<_>>())?;
    // A missing sink is intended here and needs no warning.
    job.notes.clear();
    let report = run::run_job(RunRequest::quiet(&job, Path::new(".")), args.machine, true)?;
    let mut said = String::new();
    // A pattern has several.
    for input in report.inputs.iter().filter(|_| !quiet) {
        said += &format!("{}\n", shown(&input.path).display());
        for (name, words) in input.sensor_model.as_deref().into_iter().flat_map(sensor_model_words) {
            said += &format!("  {name:14}  {words}\n");
        }
        for output in &input.outputs {
            let path = shown(output).display().to_string();
            said += &format!(
                "wrote {path}; use it in a job: `load = {}` of calibrate\n",
                toml::Value::String(path.clone())
            );
        }
    }
    terminal::print(&said)
}

/// Calibrates from all inputs of a job.
fn of_survey(args: &CalibrateArgs, quiet: bool) -> Result<(), Failure> {
    if args.save_preset.is_some() {
        let problem = "--save-preset is for the model of a recording; to save the models of a job, use --out";
        return Err(Failure::Wrong(problem.to_owned()));
    }
    let job_args = JobArgs { job: args.file.clone(), set: args.set.clone() };
    let job = job_args.read(args.machine.overrides())?;
    let (input_dir, output_dir) = folders(&job, &job_args.folder());
    let progress = args.machine.progress(quiet, std::io::stderr().is_terminal());
    let options = Options { progress, ..Options::of_job(&job, input_dir, output_dir) };
    run::stop_on_signals(&options.cancel, run::end_run);
    let failed = |error: &dyn std::fmt::Display| Failure::Run(error.to_string());
    let models = engine::learn_survey_models(&job, &options).map_err(|error| failed(&error))?;
    // Inputs that contradict each other have their own models, which their runs make.
    let has_own = models.inputs.iter().any(|input| input.own_model.is_some());
    if !has_own && models.instruments.iter().all(|instrument| instrument.sensor_model.is_none()) {
        let reason = models.instruments.iter().flat_map(|instrument| &instrument.notes).next();
        let reason = reason.map_or("no input could be read; run the job to see why", String::as_str);
        return Err(Failure::Run(reason.to_owned()));
    }
    let mut said = survey_table(&models);
    if let Some(path) = &args.out {
        let mut file = OutputFile::create(path).map_err(|error| failed(&error))?;
        let written = models.to_json().map_err(std::io::Error::from);
        let written = written.and_then(|text| file.write_all(text.as_bytes()));
        written.map_err(|error| failed(&Error::io(path, "write the models")(error)))?;
        file.finish().and_then(FinishedFile::publish).map_err(|error| failed(&error))?;
        let path = shown(path).display().to_string();
        said += &format!(
            "wrote {path}; use it in a job: `survey_model = {}` of `[job]`, relative to `input_dir`\n",
            toml::Value::String(path.clone())
        );
    }
    if quiet { Ok(()) } else { terminal::print(&said) }
}

/// TOML of a job that reads the recording and calibrates.
fn job_text(args: &CalibrateArgs) -> Result<String, String> {
    let file = args.file.display().to_string();
    let reader = small_footprint_reader_of(&file)?;
    let quoted = |text: String| toml::Value::String(text);
    let save = match &args.save_preset {
        Some(path) if !has_extension(path, "json") => {
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
