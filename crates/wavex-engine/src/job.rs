//! A job: parses TOML into a validated chain of stages, without any input or output.
//!
//! Parsing has two passes. The first (`draft`) turns the text into a table with source positions
//! and removes `[job]` and each stage's `type` and `id`. In the second pass every stage parses the
//! rest of its keys. A serde enum tagged by `type` would be shorter, but would report errors at the
//! wrong stage.

use std::path::Path;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use wavex_simd::SimdLevel;

use wavex_line::georef::{GeometryKeys, check_crs_name};
use wavex_line::keys::{InvalidKey, Keys};
use wavex_line::scan_line::Kind;
use wavex_line::stage::{Paths, Planned, StageSpec};

mod chain;
mod draft;
mod errors;
mod example;
mod include;
mod insert;
mod limits;
mod manual;
mod outputs;
mod overrides;
mod page;
mod schema;
mod simd;
mod sources;
mod survey;
mod tables;
mod validate;

pub use errors::{JobError, JobErrors};
pub use example::example_job;
pub use include::included;
pub use limits::{MAX_BYTES, MAX_INCLUDES, read_text};
pub use manual::{manual, manual_of, summary};
pub use overrides::key_with_table;
pub use page::named;
pub use schema::{job_schema, job_schema_text};
pub use simd::Simd;
pub use survey::{CELLS, SurveyKeys};

use sources::JobSources;
pub use sources::{Include, Override};

/// A validated job.
#[derive(Clone, Debug, Default)]
pub struct Job {
    /// Name in messages: the file that the job was read from.
    pub name: String,
    /// Text as written, for archives.
    pub text: String,
    /// Included files, in order.
    pub includes: Vec<Include>,
    /// Values set from outside the text, in order.
    pub overrides: Vec<Override>,
    /// The table `[job]`.
    pub settings: JobSettings,
    /// Stages in order: one source, then the stages that process its lines.
    pub stages: Vec<JobStage>,
    /// Warnings for the user before the run.
    pub notes: Vec<String>,
}

/// A stage of a job.
#[derive(Clone, Debug)]
pub struct JobStage {
    /// The stage's `id`, or its type.
    ///
    /// If several stages without an `id` share a type, they are numbered in order (`write_las-1`,
    /// `write_las-2`).
    pub id: String,
    /// Entry in the registry.
    pub spec: &'static StageSpec,
    /// Parsed keys and constructor.
    pub planned: Planned,
}

/// Settings of the run as a whole: the table `[job]`.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct JobSettings {
    /// Files with shared defaults: one file or a list. Their keys apply where the job gives none;
    /// later files override earlier ones. Relative paths start at the folder of the job file. In
    /// such a file, `[job]` holds keys of this table, and a table such as `[decompose]` holds keys
    /// for every stage of that type.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(extend("x-file" = "include"))]
    pub include: Option<Paths>,
    /// Number of worker threads of each parallel stage such as `decompose`; 0: one per core.
    #[schemars(range(max = 65535))]
    pub threads: usize,
    /// Memory limit of all scan lines in the pipeline, MB.
    #[schemars(range(min = 64, max = 1_000_000_000))]
    pub memory_mb: u64,
    /// Folder of relative input paths; relative to the job file's folder, which is the default.
    #[schemars(extend("x-file" = "input_folder"))]
    pub input_dir: Option<String>,
    /// Folder of relative output paths; relative to the job file's folder, which is the default.
    #[schemars(extend("x-file" = "output_folder"))]
    pub output_dir: Option<String>,
    /// Maximum number of scan lines that wait between two stages. Does not affect results.
    #[schemars(range(min = 1, max = 65535))]
    pub channel_capacity: usize,
    /// SIMD instructions of the fast kernels. Does not affect results.
    pub simd: Simd,
    /// Report of the run (JSON) in the output folder; `*` is replaced by the stem of the job file;
    /// empty: none.
    #[schemars(extend("x-file" = "output"))]
    pub report: String,
    /// Report as a page for browsers and printing (one HTML file) in the output folder: a name, or
    /// `true` for `*_report.html`; `false` or empty: none. With a page, the JSON report also contains
    /// histograms, map views and some waveforms.
    #[serde(deserialize_with = "page::name")]
    #[schemars(with = "page::PageKey", extend("x-file" = "output"))]
    pub report_page: String,
    /// Page of the survey in the output folder, for inputs that are strips of one survey: a name, or
    /// `true` for `*_survey.html`; `false` or empty: none. Next to it are a JSON file and rasters of
    /// the same name, and for each input a file of its cells.
    #[serde(deserialize_with = "page::survey_name")]
    #[schemars(with = "page::PageKey", extend("x-file" = "output"))]
    pub survey_page: String,
    /// Text statistics of each input in the output folder; `*` is replaced by the stem of the input
    /// and is required for several inputs; empty: none. Those of a failed input have its error
    /// message.
    #[schemars(extend("x-file" = "output"))]
    pub stat_log: String,
    /// Log of the run in the output folder; `*` is replaced by the stem of the job file; empty: none.
    #[schemars(extend("x-file" = "output"))]
    pub log: String,
    /// What follows when an input fails: `continue` with the next one, or `stop` the run. Problems
    /// that are not of one input, such as a full disk, always stop it.
    pub on_error: OnError,
    /// Number of inputs that run at the same time; 0: as many as help. Does not affect results.
    #[schemars(range(max = 65535))]
    pub inputs_at_once: usize,
    /// Sensor model of several inputs: common to the `survey`, from waveforms of all inputs, or from
    /// each `input` alone. An input that contradicts the survey has its own model.
    pub model: ModelScope,
    /// File written by `wavex calibrate JOB.toml -o FILE.json`, whose sensor models are used instead
    /// of those of this run.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(extend("x-file" = "input"))]
    pub survey_model: Option<String>,
    /// Trajectory, mount and coordinates: the table `[job.geometry]`.
    pub geometry: GeometryKeys,
    /// Cells and limits of the survey's page: the table `[job.survey]`.
    pub survey: SurveyKeys,
}

/// Inputs that share a sensor model.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ModelScope {
    /// All inputs of an instrument.
    #[default]
    Survey,
    /// None.
    Input,
}

/// What follows when an input fails.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum OnError {
    /// The next input.
    #[default]
    Continue,
    /// The end of the run.
    Stop,
}

impl Default for JobSettings {
    fn default() -> JobSettings {
        JobSettings {
            include: None,
            threads: 0,
            memory_mb: 1024,
            input_dir: None,
            output_dir: None,
            channel_capacity: 16,
            simd: Simd::Auto,
            report: "*_report.json".into(),
            report_page: String::new(),
            survey_page: String::new(),
            stat_log: "*_stat.log".into(),
            log: "*.log".into(),
            on_error: OnError::default(),
            inputs_at_once: 0,
            model: ModelScope::default(),
            survey_model: None,
            geometry: GeometryKeys::default(),
            survey: SurveyKeys::default(),
        }
    }
}

impl JobSettings {
    /// The keys of the table with their documentation.
    pub fn keys() -> Keys {
        Keys::of(JobSettings::json_schema)
    }

    /// Checks constraints that the types cannot express.
    fn check(&self) -> Result<(), InvalidKey> {
        self.simd.check(SimdLevel::is_available).map_err(|problem| InvalidKey::new("simd", problem))?;
        let fits = self.stat_log.is_empty() || self.stat_log.ends_with(".log");
        InvalidKey::unless(fits, "stat_log", "it must end in .log, such as \"*_stat.log\"")?;
        // The command line sets a key as text if the key accepts only text.
        let is_name = !matches!(self.report.as_str(), "true" | "false");
        InvalidKey::unless(is_name, "report", page::REPORT_IS_A_NAME)?;
        let fits = self.report_page.is_empty() || self.report_page.ends_with(".html");
        InvalidKey::unless(
            fits,
            "report_page",
            "it must end in .html, such as \"report.html\", or be `true` without quotation marks",
        )?;
        let fits = self.survey_page.is_empty() || self.survey_page.ends_with(".html");
        InvalidKey::unless(
            fits,
            "survey_page",
            "it must end in .html, such as \"survey.html\", or be `true` without quotation marks",
        )?;
        let fits = self.survey.cells.is_empty() || self.survey.cells.ends_with(CELLS);
        InvalidKey::unless(
            fits,
            "survey.cells",
            "it must end in *_cells.arrow, such as \"qc/*_cells.arrow\"",
        )?;
        self.geometry.check()?;
        check_crs_name(&self.geometry)
    }

    /// Pattern of the files of cells, if the job requests them.
    pub fn cells(&self) -> Option<&str> {
        match self.survey.cells.as_str() {
            "" => (!self.survey_page.is_empty()).then_some(CELLS),
            cells => Some(cells),
        }
    }
}

impl Job {
    /// Parses a job of these stages; errors call the text `name`.
    ///
    /// # Errors
    /// If the job is invalid: all errors, each with its position in the text or in an override.
    pub fn parse(
        stages: &[&'static StageSpec],
        name: &str,
        text: &str,
        overrides: &[Override],
    ) -> Result<Job, JobErrors> {
        Job::parse_with(stages, name, text, &[], overrides)
    }

    /// Parses a job with included files.
    ///
    /// `includes` are the files named by [`included`].
    ///
    /// # Errors
    /// See [`Job::parse`].
    pub fn parse_with(
        stages: &[&'static StageSpec],
        name: &str,
        text: &str,
        includes: &[Include],
        overrides: &[Override],
    ) -> Result<Job, JobErrors> {
        if let Some(error) = limits::check(text, includes) {
            return Err(JobErrors::new(vec![error], JobSources::new(name, "", &[], &[])));
        }
        let sources = JobSources::new(name, text, includes, overrides);
        match read(stages, text, &sources) {
            Ok((settings, stages)) => Ok(Job {
                name: name.to_owned(),
                text: text.to_owned(),
                includes: includes.to_vec(),
                overrides: overrides.to_vec(),
                notes: notes(&settings, &stages),
                settings,
                stages,
            }),
            Err(errors) => Err(JobErrors::new(errors, sources)),
        }
    }

    /// Name of its runs: the stem of the job file, or `wavex` if it was not read from a file.
    pub fn stem(&self) -> String {
        let stem = Path::new(&self.name).file_stem().filter(|_| Path::new(&self.name).extension().is_some());
        stem.map_or_else(|| "wavex".to_owned(), |stem| stem.to_string_lossy().into_owned())
    }

    /// The chain on one line, with the kind of lines wherever it changes.
    ///
    /// Example: `read_las -> Shots -> decompose -> Returns -> write_table`.
    pub fn chain(&self) -> String {
        let mut words: Vec<String> = Vec::new();
        let mut kind: Option<Kind> = None;
        for stage in &self.stages {
            words.push(stage.id.clone());
            let gives = stage.spec.gives(kind);
            if gives != kind {
                words.extend(gives.map(|kind| kind.to_string()));
            }
            kind = gives;
        }
        words.join(" -> ")
    }
}

/// Parses settings and stages, or returns all errors.
fn read(
    stages: &[&'static StageSpec],
    text: &str,
    sources: &JobSources,
) -> Result<(JobSettings, Vec<JobStage>), Vec<JobError>> {
    let included: Vec<String> = sources.includes().map(|(start, text)| include::pad(start, text)).collect();
    let padded: Vec<String> = sources.overrides().map(|(start, text)| overrides::pad(start, text)).collect();
    let (changes, mut errors) = overrides::read(sources, &padded, stages);
    let root = match draft::syntax(text) {
        Ok(root) => root,
        Err(syntax) => return Err(syntax.into_iter().chain(errors).collect()),
    };
    let (mut draft, problems) = draft::JobDraft::new(root, stages);
    errors.extend(problems);
    errors.extend(include::apply(&included, &mut draft, stages));
    errors.extend(draft.libraries());
    errors.extend(overrides::apply(changes, &mut draft));
    errors.extend(include::check(&draft, included.len()));

    let settings = tables::settings(draft.settings, &draft.stages, &mut errors);
    let links: Vec<chain::ChainLink> = draft.stages.iter().map(chain::ChainLink::of).collect();
    errors.extend(chain::check(&links, stages));
    let planned: Vec<Option<tables::ParsedStage>> =
        draft.stages.into_iter().map(|stage| tables::stage(stage, &mut errors)).collect();
    errors.extend(outputs::check(&planned, settings.as_ref()));

    match settings {
        Some(settings) if errors.is_empty() => {
            Ok((settings, planned.into_iter().flatten().map(|stage| stage.stage).collect()))
        }
        _ => Err(errors),
    }
}

/// Warnings about a valid job.
fn notes(settings: &JobSettings, stages: &[JobStage]) -> Vec<String> {
    let mut notes = Vec::new();
    if !stages.iter().any(|stage| matches!(stage.planned.plan, wavex_line::stage::Plan::Sink(_))) {
        notes.push("no stage of this job writes a file: a run produces only the report".to_owned());
    }
    let of_stages = stages
        .iter()
        .flat_map(|stage| stage.planned.plan.outputs().into_iter().map(|path| (stage.id.as_str(), path)));
    let folder = settings.output_dir.as_deref().map(|folder| ("job", folder));
    let foreign = folder.into_iter().chain(of_stages).filter(|(_, path)| !cfg!(windows) && has_drive(path));
    notes.extend(foreign.map(|(name, path)| {
        // Only a slash separates folders here.
        let folder = path.split('/').next().unwrap_or(path);
        let problem = match folder == path && name != "job" {
            true => "is a path of Windows: here it becomes a file of this name".to_owned(),
            false => format!("is a path of Windows: here it becomes a folder `{folder}`"),
        };
        format!("`{name}`: the output {path} {problem}; write a path of this system")
    }));
    notes
}

/// Whether a path begins with a drive of Windows: `C:/data`.
fn has_drive(path: &str) -> bool {
    matches!(path.as_bytes(), [drive, b':', b'/' | b'\\', ..] if drive.is_ascii_alphabetic())
}
