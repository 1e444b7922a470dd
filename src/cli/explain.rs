//! `wavex explain`: one shot as a table and a picture.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::de::DeserializeOwned;

use super::{ExplainArgs, Failure, JobArgs, run, terminal};
use crate::georef::Loader;
use crate::job::{Job, JobStage, Override};
use crate::registry::reader_of;
use crate::scan_line::{Emission, Returns, ScanLine};
use crate::stage::{Context, OutputFile, Plan, RunContext, Source, SourcePlan, TransformConfig, counted};
use crate::stages::calibrate::Calibrate;
use crate::stages::decompose::{
    Decompose, Line, Seen, SeenBlock, SeenPulse, SensorTables, Shot, ShotDecomposer,
};
use crate::stages::pose_source::PoseSource;
use upstream::{Step, Upstream};
use wavex_formats::Error;
use wavex_signal::sensor_model::SensorModel;

mod picture;
mod table;
mod upstream;

/// Prints the returns of a shot and writes its picture.
pub(super) fn explain(args: &ExplainArgs, quiet: bool) -> Result<(), Failure> {
    if let Some(out) = &args.out
        && !out.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("svg"))
    {
        let problem = "the picture is SVG; give a name that ends in .svg";
        return Err(Failure::Wrong(format!("--out {}: {problem}", out.display())));
    }
    let chain = Chain::of(args)?;
    let shot = match (args.shot, args.time) {
        (Some(shot), _) => shot,
        (None, time) => chain.nearest(time.unwrap_or_default())?,
    };
    let line = chain.line_of(shot)?;
    let explained = decompose(line, shot, &chain)?;
    let path = args.out.clone().unwrap_or_else(|| format!("{}_shot_{shot}.svg", chain.site.stem).into());
    write(&path, &picture::draw(&explained)).map_err(|error| failed(&error))?;
    let said = format!("{}\nwrote {}\n", table::table(&explained), path.display());
    if quiet { Ok(()) } else { terminal::print(&said) }
}

/// Writes a picture, which gets its final name only when complete.
fn write(path: &Path, picture: &str) -> wavex_formats::Result<()> {
    let mut file = OutputFile::create(path)?;
    file.write_all(picture.as_bytes()).map_err(Error::io(path, "write"))?;
    file.finish()?.publish()?;
    Ok(())
}

/// A job's stages up to `decompose`, applied to one recording.
struct Chain {
    job: Job,
    site: RunContext,
    /// Keys of `calibrate`, with `save` removed.
    calibrate: Calibrate,
    decompose: Decompose,
    /// Reader of the recording.
    source: Arc<dyn SourcePlan>,
}

impl Chain {
    fn of(args: &ExplainArgs) -> Result<Chain, Failure> {
        let file = args.file.display().to_string();
        let reader = reader_of(&file).map_err(Failure::Wrong)?;
        let default_job = default_job(reader, &file, if args.job.is_some() { &[] } else { &args.set })?;
        let (job, folder) = match &args.job {
            None => (default_job.clone(), PathBuf::from(".")),
            Some(path) => {
                let job = JobArgs { job: path.clone(), set: args.set.clone() };
                (job.read(None)?, job.folder())
            }
        };
        let reads_file = job.stages.first().is_some_and(|stage| stage.spec.name == reader);
        let reading = if reads_file { &job } else { &default_job };
        let Some(Plan::Source(source)) = reading.stages.first().map(|stage| stage.planned.plan.clone())
        else {
            return Err(Failure::Wrong(format!(
                "{}: the job has no source; start it with a reader",
                job.name
            )));
        };
        let mut calibrate: Calibrate = keys_of(&job, "calibrate")?;
        calibrate.save = None;
        if let Some(model) = &args.model {
            // Relative paths in the job start at its input folder, paths on the command line at the
            // current folder.
            calibrate.load = Some(std::path::absolute(model).unwrap_or_else(|_| model.clone()));
        }
        let decompose = keys_of(&job, "decompose")?;
        let (input_dir, output_dir) = run::folders(&job, &folder);
        let stem = args.file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let simd = job.settings.simd.path();
        let geometry =
            Loader::new(&job.settings.geometry, &input_dir).and_then(|mut files| files.load(&stem));
        let geometry = Arc::new(geometry.map_err(|error| failed(&error))?);
        let input = args.file.clone();
        let site = RunContext { input, stem, input_dir, output_dir, threads: 1, simd, geometry };
        Ok(Chain { job, site, calibrate, decompose, source })
    }

    fn file(&self) -> &Path {
        &self.site.input
    }

    /// The reader's scan lines, with a pose for each shot.
    fn posed(&self) -> Result<Box<dyn Source>, Failure> {
        let source = self.source.make(&self.site).map_err(|error| failed(&error))?;
        Ok(Box::new(PoseSource::new(source, Arc::clone(&self.site.geometry))))
    }

    /// The stages between the reader and `decompose`, without sinks.
    fn steps(&self) -> Result<Vec<Step>, Failure> {
        let until_decompose = self.job.stages.iter().take_while(|stage| stage.spec.name != "decompose");
        let mut steps = Vec::new();
        for stage in until_decompose {
            let made = match &stage.planned.plan {
                _ if stage.spec.name == "calibrate" => {
                    TransformConfig::make(&self.calibrate, &self.site).map(Step::transform)
                }
                Plan::Transform(plan) => plan.make(&self.site).map(Step::transform),
                Plan::Map(plan) => plan.make(&self.site).map(Step::map),
                Plan::Source(_) | Plan::Sink(_) => continue,
            };
            steps.push(made.map_err(|error| failed(&error))?);
        }
        Ok(steps)
    }

    /// Returns the scan line that contains a shot, ready for decomposition.
    fn line_of(&self, shot: u64) -> Result<ScanLine, Failure> {
        let source = self.posed()?;
        let mut upstream = Upstream::new(source, self.steps()?, crate::engine::may_hold_bytes(&self.job));
        let mut seen = Numbers::default();
        let holds = |scan_line: &ScanLine| {
            scan_line.emissions.iter().for_each(|emission| seen.add(emission.shot));
            scan_line.emissions.iter().any(|emission| emission.shot == shot)
        };
        let line = upstream.first(holds).map_err(|error| failed(&error))?;
        line.ok_or_else(|| Failure::Wrong(seen.without(shot, self.file())))
    }

    /// Returns the number of the shot nearest to a time.
    fn nearest(&self, time_s: f64) -> Result<u64, Failure> {
        let source = self.posed()?;
        let mut nearest: Option<(f64, u64)> = None;
        let mut look = |scan_line: &ScanLine| {
            for emission in &scan_line.emissions {
                let distance_s = (emission.gps_time_s - time_s).abs();
                if distance_s.is_finite() && nearest.is_none_or(|(least_s, _)| distance_s < least_s) {
                    nearest = Some((distance_s, emission.shot));
                }
            }
            false
        };
        Upstream::new(source, Vec::new(), 0).first(&mut look).map_err(|error| failed(&error))?;
        nearest.map(|(_, shot)| shot).ok_or_else(|| {
            let file = self.file().display();
            Failure::Wrong(format!("{file}: its shots have no times; select one with --shot"))
        })
    }
}

/// Count and range of the shot numbers of a recording.
#[derive(Default)]
struct Numbers {
    count: u64,
    range: Option<(u64, u64)>,
}

impl Numbers {
    fn add(&mut self, shot: u64) {
        self.count += 1;
        let (first, last) = self.range.unwrap_or((shot, shot));
        self.range = Some((first.min(shot), last.max(shot)));
    }

    /// Error message for a missing shot number.
    fn without(&self, shot: u64, file: &Path) -> String {
        let file = file.display();
        match self.range {
            None => format!("{file}: no shot {shot}: the recording has no shots; choose another file"),
            Some((first, last)) => {
                let count = self.count;
                format!("{file}: no shot {shot}; the {count} shots are numbered {first} to {last}")
            }
        }
    }
}

/// A shot with its decomposition.
struct Explained {
    file: String,
    emission: Emission,
    /// Sorted by time.
    returns: Returns,
    /// Sorted by time.
    blocks: Vec<SeenBlock>,
    outgoing: Option<SeenPulse>,
    model: Arc<SensorModel>,
    /// Rejections and notes as text.
    remarks: Vec<String>,
}

/// Decomposes one shot of a scan line and records the intermediate results.
fn decompose(mut line: ScanLine, shot: u64, chain: &Chain) -> Result<Explained, Failure> {
    let without = |what: &str| {
        let file = chain.file().display();
        Failure::Wrong(format!("{file}: shot {shot} has {what}; choose another one"))
    };
    let model = line.model.clone().ok_or_else(|| without("no sensor model"))?;
    let index = line.emissions.iter().position(|emission| emission.shot == shot).unwrap_or_default();
    let crate::scan_line::Content::Shots(blocks) = line.content else {
        return Err(without("no samples"));
    };
    let of_shot = blocks.by_emission().find(|(emission, _)| *emission as usize == index);
    let echoes = of_shot.filter(|(_, of_shot)| of_shot.iter().any(|block| block.channel.is_echo()));
    let Some((index, of_shot)) = echoes else {
        return Err(without("no recorded echoes"));
    };
    let mut seen = Seen::new(&blocks);
    let (mut returns, mut cx) = (Returns::new(), Context::default());
    let tables = SensorTables::new(&model, chain.decompose.mode);
    let mut shots = ShotDecomposer::new(&model, &tables, &chain.decompose, chain.site.simd)
        .and_then(|shots| shots.fusing(line.fusion.as_deref()))
        .map_err(|error| failed(&error))?;
    let of_line = Shot { index, blocks: &blocks, of_shot, input: &line.input };
    // The whole line is decomposed first: it defines the usual outgoing pulse.
    let shot_of = |(index, of_shot)| Shot { index, blocks: &blocks, of_shot, input: &line.input };
    let all: Vec<Shot> = blocks.by_emission().map(shot_of).collect();
    let (mut emissions, mut others) = (line.emissions.clone(), Returns::new());
    let mut whole = Line { emissions: &mut emissions, returns: &mut others, stats: &mut line.stats.clone() };
    shots.decompose(&all, &mut whole, &mut Context::default(), &mut ()).map_err(|error| failed(&error))?;
    let mut into = Line { emissions: &mut line.emissions, returns: &mut returns, stats: &mut line.stats };
    shots.decompose_again(&of_line, &mut into, &mut cx, &mut seen).map_err(|error| failed(&error))?;
    let emission = line.emissions[index as usize];
    let file = chain.file().display().to_string();
    let (blocks, outgoing) = seen.finish(&emission, &returns);
    let mut remarks = remarks(&cx);
    if !line.input.origin_is_sensor {
        remarks.push("ranges start at the first sample: the recording has no sensor position".into());
    }
    Ok(Explained { file, emission, returns, blocks, outgoing, model, remarks })
}

/// Rejections and notes of a context as text.
fn remarks(cx: &Context) -> Vec<String> {
    let rejected = &cx.counters().rejected;
    let dropped = rejected
        .iter()
        .map(|((item, why), n)| format!("rejected {}", counted(*n, &format!("{}: {why}", item.name()))));
    dropped.chain(cx.counters().notes.iter().cloned()).collect()
}

/// A job with the default keys of all stages.
fn default_job(reader: &str, file: &str, set: &[String]) -> Result<Job, Failure> {
    let path = toml::Value::String(file.to_owned());
    let text = format!(
        "[[stage]]\ntype = \"{reader}\"\npath = {path}\n\n[[stage]]\ntype = \"calibrate\"\n\n\
         [[stage]]\ntype = \"decompose\"\n"
    );
    let overrides: Vec<Override> = set.iter().map(Override::new).collect();
    Ok(Job::parse("the job of `wavex explain`", &text, &overrides)?)
}

/// Keys of the first stage of this type in a job.
fn keys_of<C: DeserializeOwned>(job: &Job, stage: &str) -> Result<C, Failure> {
    let is_it = |candidate: &&JobStage| candidate.spec.name == stage;
    let Some(found) = job.stages.iter().find(is_it) else {
        return Err(Failure::Wrong(format!("{}: the job has no stage `{stage}`; add one", job.name)));
    };
    serde_json::from_value(found.planned.resolved.clone())
        .map_err(|error| Failure::Run(format!("`{stage}`: {error}; please report this bug in wavex")))
}

fn failed(error: &dyn std::fmt::Display) -> Failure {
    Failure::Run(error.to_string())
}
