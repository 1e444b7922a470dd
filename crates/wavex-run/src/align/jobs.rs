//! Jobs of an alignment: each is one installation of a scanner.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use super::AlignRequest;
use crate::Failure;
use crate::run::folders;
use wavex_engine::engine::{self, Options};
use wavex_engine::job::Job;

/// A job of a survey: its strips have one installation.
#[derive(Clone, Copy, Debug)]
pub struct AlignJob<'a> {
    /// The job; its sinks are not run.
    pub job: &'a Job,
    /// Folder of the job file.
    pub folder: &'a Path,
}

/// A job with its name in results, and its folders.
pub(super) struct JobPlace<'a> {
    pub(super) job: &'a Job,
    /// Name of the installation; `None` for a single job.
    pub(super) name: Option<String>,
    pub(super) options: Options,
    /// Folder of its calibration and corrections.
    pub(super) output: PathBuf,
}

impl JobPlace<'_> {
    pub(super) fn input_dir(&self) -> &Path {
        &self.options.input_dir
    }

    /// Name in results of a strip, or of a parameter.
    pub(super) fn label(&self, name: &str) -> String {
        match &self.name {
            Some(own) => format!("{own}/{name}"),
            None => name.to_owned(),
        }
    }
}

/// The jobs with their places.
///
/// # Errors
/// No job, jobs of the same name, jobs whose points are in different systems.
pub(super) fn places<'a>(request: &AlignRequest<'a>) -> Result<Vec<JobPlace<'a>>, Failure> {
    let is_single = request.jobs.len() == 1;
    let mut places: Vec<JobPlace<'a>> = Vec::new();
    for AlignJob { job, folder } in request.jobs.iter().copied() {
        let name = Path::new(&job.name).file_stem().unwrap_or_default().to_string_lossy().into_owned();
        if let Some(other) = places.iter().find(|place| place.name.as_ref() == Some(&name)) {
            return Err(Failure::Wrong(format!(
                "{}: {} has the same name, and results are named after their job; rename one of the files",
                job.name, other.job.name
            )));
        }
        let (input_dir, output_dir) = folders(job, folder);
        let options = Options {
            progress: request.progress,
            cancel: request.cancel.clone(),
            ..Options::of_job(job, &input_dir, output_dir)
        };
        let output = if is_single { request.output.to_owned() } else { request.output.join(&name) };
        places.push(JobPlace { job, name: (!is_single).then_some(name), options, output });
    }
    let Some((first, others)) = places.split_first() else {
        return Err(Failure::Wrong("there is no job to align; give one or more".to_owned()));
    };
    for other in others {
        let (own, of_first) = (&other.job.settings.geometry, &first.job.settings.geometry);
        let unit =
            |keys: &wavex_line::georef::keys::GeometryKeys| keys.unit.map(|unit| super::unit_of(unit).name);
        for (key, own, of_first) in [
            ("crs", own.crs.clone(), of_first.crs.clone()),
            ("geoid", own.geoid.clone(), of_first.geoid.clone()),
            ("unit", unit(own), unit(of_first)),
        ] {
            if own != of_first {
                let word =
                    |value: Option<String>| value.map_or("not set".to_owned(), |value| format!("`{value}`"));
                return Err(Failure::Wrong(format!(
                    "{}: `{key}` of `[job.geometry]` is {}, but {} in {}; jobs that are aligned together need the same \
                     coordinate reference system",
                    other.job.name,
                    word(own),
                    word(of_first),
                    first.job.name
                )));
            }
        }
    }
    Ok(places)
}

/// Checks that no recording is an input of two jobs.
pub(super) fn check_inputs(places: &[JobPlace<'_>]) -> Result<(), Failure> {
    if places.len() < 2 {
        return Ok(());
    }
    let mut known: HashMap<PathBuf, &str> = HashMap::new();
    for place in places {
        for input in engine::inputs(place.job, place.input_dir()).unwrap_or_default() {
            let path = input.path.canonicalize().unwrap_or_else(|_| input.path.clone());
            if let Some(other) = known.insert(path, &place.job.name) {
                return Err(Failure::Wrong(format!(
                    "{}: {} is also an input of {other}; give each strip to the job of its installation",
                    place.job.name,
                    input.path.display()
                )));
            }
        }
    }
    Ok(())
}
