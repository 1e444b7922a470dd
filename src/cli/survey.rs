//! `wavex survey`: the page of a survey from the cells of its strips.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde_json::Value;

use super::args::SurveyArgs;
use super::{Failure, JobArgs, terminal};
use wavex_engine::job::SurveyKeys;
use wavex_pages::report::read_report;
use wavex_pages::report::survey::{SurveyInput, ending_of_cells, write_survey};

/// Writes the page of the strips in these folders.
pub(super) fn survey(args: &SurveyArgs, quiet: bool) -> Result<(), Failure> {
    let keys = match &args.job {
        Some(job) => JobArgs { job: job.clone(), set: args.set.clone() }.read([])?.settings.survey,
        None => SurveyKeys::default(),
    };
    let first = args.folders.first().map_or(Path::new("."), PathBuf::as_path);
    let page = args.out.clone().unwrap_or_else(|| first.join("survey.html"));
    if page.extension().is_none_or(|extension| extension != "html") {
        let problem = format!("{}: the page must end in .html, such as survey.html", page.display());
        return Err(Failure::Wrong(problem));
    }
    let mut inputs = BTreeMap::new();
    for folder in &args.folders {
        add_strips(folder, &mut inputs)?;
    }
    if inputs.values().all(|input| input.cells.is_none()) {
        let folders: Vec<String> = args.folders.iter().map(|folder| folder.display().to_string()).collect();
        let problem = "no cells of strips (*_cells.arrow); run the job with `survey_page = true`";
        return Err(Failure::Run(format!("{}: {problem}", folders.join(", "))));
    }
    let inputs: Vec<SurveyInput> = inputs.into_values().collect();
    let failed = |error: wavex_formats::Error| Failure::Run(error.to_string());
    let survey = write_survey(&inputs, &keys, &page).map_err(failed)?;
    survey.not_compared.iter().for_each(|strip| tracing::warn!("{strip}"));
    let written = survey.files;
    let said: String = written.iter().map(|path| format!("wrote {}\n", path.display())).collect();
    if quiet { Ok(()) } else { terminal::print(&said) }
}

/// Adds the strips in a folder by their stems, with what its reports say about them.
fn add_strips(folder: &Path, inputs: &mut BTreeMap<String, SurveyInput>) -> Result<(), Failure> {
    let failed =
        |error: std::io::Error| Failure::Run(format!("{}: {error}; check the path", folder.display()));
    if folder.is_file() {
        let problem = "it is a file, not a folder; give the folder of the outputs, and the job by `--job`";
        return Err(Failure::Wrong(format!("{}: {problem}", folder.display())));
    }
    let mut names = Vec::new();
    for entry in folder.read_dir().map_err(failed)? {
        names.push(entry.map_err(failed)?.file_name().to_string_lossy().into_owned());
    }
    names.sort();
    for name in names.iter().filter(|name| name.ends_with("_report.json")) {
        // A JSON file that is no report of a run does not concern the survey.
        let Ok(report) = read_report(&folder.join(name)) else { continue };
        for entry in report["inputs"].as_array().into_iter().flatten() {
            add(inputs, entry, &report["survey_models"]);
        }
    }
    for name in &names {
        let Some(stem) = name.strip_suffix(ending_of_cells()) else { continue };
        let input = inputs.entry(stem.to_owned()).or_default();
        let path = folder.join(name);
        if let Some(other) = input.cells.replace(path.clone()) {
            let remedy = "remove the one that is out of date";
            let problem = format!("{} and {} are of one strip; {remedy}", other.display(), path.display());
            return Err(Failure::Run(problem));
        }
        stem.clone_into(&mut input.stem);
        // Cells are complete even if a later run of the strip failed.
        input.failure = None;
    }
    Ok(())
}

/// Adds an input of a report, without its cells.
fn add(inputs: &mut BTreeMap<String, SurveyInput>, entry: &Value, models: &Value) {
    let input = SurveyInput::of_entry(entry, models);
    let earlier = inputs.entry(input.stem.clone()).or_default();
    let cells = earlier.cells.take();
    let failure = input.failure.clone().filter(|_| cells.is_none());
    *earlier = SurveyInput { cells, failure, ..input };
}
