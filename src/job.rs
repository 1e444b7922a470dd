//! A job: TOML text to a chain of stages that is known to fit. No input or output happens here.
//!
//! Two passes: the text becomes a table that knows where each value stands, and `[job]` and each stage's `type` and
//! `id` are taken out of it (`draft`); then every stage reads what is left of its own keys. A serde enum tagged by
//! `type` would be shorter, and would point its errors at the wrong stage.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::batch::Kind;
use crate::geometry::GeometryKeys;
use crate::kernels::lockstep;
use crate::registry;
use crate::stage::{InvalidKey, Keys, Paths, Planned, StageSpec};

mod chain;
mod draft;
mod errors;
mod example;
mod include;
mod manual;
mod outputs;
mod overrides;
mod page;
mod schema;
mod simd;
mod sources;
mod tables;
mod validate;

pub use errors::{JobError, JobErrors};
pub use example::example_job;
pub use include::{Include, included};
pub use manual::{manual, manual_of, summary};
pub use overrides::Override;
pub use schema::job_schema;
pub use simd::Simd;

use sources::Sources;

/// A job that can be run.
#[derive(Clone, Debug, Default)]
pub struct Job {
    /// What messages call it: the file it was read from.
    pub name: String,
    /// Its text as it was written, so that it can be archived and repeated.
    pub text: String,
    /// What it includes, in order.
    pub includes: Vec<Include>,
    /// What was set from outside the text, in order.
    pub overrides: Vec<Override>,
    /// The table `[job]`.
    pub settings: JobSettings,
    /// The chain, in order: one source, then what takes its lines.
    pub stages: Vec<JobStage>,
    /// What the user should know before it runs.
    pub notes: Vec<String>,
}

/// A stage of a job.
#[derive(Clone, Debug)]
pub struct JobStage {
    /// What the job calls it: its `id`, or its type; where several stages without an `id` share one type, they are
    /// numbered in order (`write_las-1`, `write_las-2`).
    pub id: String,
    /// Its place in the registry.
    pub spec: &'static StageSpec,
    /// Its keys, and how it is made.
    pub planned: Planned,
}

/// The table `[job]`: what concerns the run as a whole.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct JobSettings {
    /// Files with keys that count where the job gives none: one or a list, of which the later counts. Relative paths start at
    /// the job file's folder. In such a file `[job]` holds keys of this table, and `[decompose]` those of every stage of that
    /// type.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(extend("x-file" = "include"))]
    pub include: Option<Paths>,
    /// How many threads work in the pools of `decompose` and its like; 0: as many as the machine has cores.
    pub threads: usize,
    /// A bound on the memory taken by the scan lines that are under way, MB.
    #[schemars(range(min = 64, max = 1_000_000_000))]
    pub memory_mb: u64,
    /// Where relative input paths start; the job file's folder when not given. A relative one starts there, too.
    #[schemars(extend("x-file" = "input_folder"))]
    pub input_dir: Option<String>,
    /// Where relative output paths start; the job file's folder when not given. A relative one starts there, too.
    #[schemars(extend("x-file" = "output_folder"))]
    pub output_dir: Option<String>,
    /// How many scan lines may wait between two stages. The results do not depend on it.
    #[schemars(range(min = 1))]
    pub channel_capacity: usize,
    /// The processor's instructions that the fast kernels use. The results do not depend on it.
    pub simd: Simd,
    /// The report of the run (JSON), in the folder of the outputs; empty: none.
    #[schemars(extend("x-file" = "output"))]
    pub report: String,
    /// The report as a page that browsers show and print (HTML, one file), in the folder of the outputs: its name, or `true`
    /// for `report.html`; `false` or empty: none. With a page, the report holds histograms, pictures of the points and a few
    /// waveforms, too.
    #[serde(deserialize_with = "page::name")]
    #[schemars(with = "page::PageKey", extend("x-file" = "output"))]
    pub report_page: String,
    /// The statistics of each input in words, in the folder of the outputs; `*` is the input's stem, needed where
    /// there are several inputs; empty: none. A run that fails writes them, too, with the failure.
    #[schemars(extend("x-file" = "output"))]
    pub stat_log: String,
    /// The log of the run, in the folder of the outputs; empty: none.
    #[schemars(extend("x-file" = "output"))]
    pub log: String,
    /// Trajectory, mount and coordinates: the table `[job.geometry]`.
    pub geometry: GeometryKeys,
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
            report: "report.json".into(),
            report_page: String::new(),
            stat_log: "*_stat.log".into(),
            log: "wavex.log".into(),
            geometry: GeometryKeys::default(),
        }
    }
}

impl JobSettings {
    /// The keys of the table with their meaning.
    pub fn keys() -> Keys {
        Keys::of(JobSettings::json_schema)
    }

    /// What the types alone cannot say of the keys.
    fn check(&self) -> Result<(), InvalidKey> {
        self.simd.check(lockstep::Path::is_available).map_err(|problem| InvalidKey::new("simd", problem))?;
        let fits = self.stat_log.is_empty() || self.stat_log.ends_with(".log");
        InvalidKey::unless(fits, "stat_log", "it must end in .log, as in \"*_stat.log\"")?;
        // What the command line sets is text, where a key takes nothing else.
        let is_name = !matches!(self.report.as_str(), "true" | "false");
        InvalidKey::unless(is_name, "report", page::REPORT_IS_A_NAME)?;
        let fits = self.report_page.is_empty() || self.report_page.ends_with(".html");
        InvalidKey::unless(fits, "report_page", "it must end in .html, as in \"report.html\"")?;
        self.geometry.check()
    }
}

impl Job {
    /// Reads a job of the stages in the registry; `name` is what errors call the text.
    ///
    /// # Errors
    /// Everything that is wrong with the job, each with its place in the text or in an override.
    pub fn parse(name: &str, text: &str, overrides: &[Override]) -> Result<Job, JobErrors> {
        Job::parse_with(registry::STAGES, name, text, &[], overrides)
    }

    /// The same, with a list of stages of one's own, and with the files that the text includes, as [`included`] names them.
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
        let sources = Sources::new(name, text, includes, overrides);
        match read(stages, text, &sources) {
            Ok((settings, stages)) => Ok(Job {
                name: name.to_owned(),
                text: text.to_owned(),
                includes: includes.to_vec(),
                overrides: overrides.to_vec(),
                notes: notes(&stages),
                settings,
                stages,
            }),
            Err(errors) => Err(JobErrors::new(errors, sources)),
        }
    }

    /// The chain as a line, with the kind of lines wherever it changes:
    /// `read_las -> Shots -> decompose -> Returns -> write_table`.
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

/// The settings and the stages, or everything that is wrong with them.
fn read(
    stages: &[&'static StageSpec],
    text: &str,
    sources: &Sources,
) -> Result<(JobSettings, Vec<JobStage>), Vec<JobError>> {
    let included: Vec<String> = sources.includes().map(|(start, text)| include::pad(start, text)).collect();
    let padded: Vec<String> = sources.overrides().map(|(start, text)| overrides::pad(start, text)).collect();
    let (changes, mut errors) = overrides::read(sources, &padded);
    let root = match draft::syntax(text) {
        Ok(root) => root,
        Err(syntax) => return Err(syntax.into_iter().chain(errors).collect()),
    };
    let (mut draft, problems) = draft::Draft::new(root, stages);
    errors.extend(problems);
    errors.extend(include::apply(&included, &mut draft, stages));
    errors.extend(overrides::apply(changes, &mut draft));
    errors.extend(include::check(&draft, included.len()));

    let settings = tables::settings(draft.settings, &mut errors);
    let links: Vec<chain::Link> = draft.stages.iter().map(chain::Link::of).collect();
    errors.extend(chain::check(&links, stages));
    let planned: Vec<Option<tables::Stage>> =
        draft.stages.into_iter().map(|stage| tables::stage(stage, &mut errors)).collect();
    errors.extend(outputs::check(&planned, settings.as_ref()));

    match settings {
        Some(settings) if errors.is_empty() => {
            Ok((settings, planned.into_iter().flatten().map(|stage| stage.stage).collect()))
        }
        _ => Err(errors),
    }
}

/// What the user should know of a chain that fits.
fn notes(stages: &[JobStage]) -> Vec<String> {
    let writes = stages.iter().any(|stage| matches!(stage.planned.plan, crate::stage::Plan::Sink(_)));
    if writes {
        return Vec::new();
    }
    vec![
        "no stage of this job writes a file: a run counts and measures, and leaves only its report"
            .to_owned(),
    ]
}
