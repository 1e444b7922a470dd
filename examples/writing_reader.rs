//! A reader of your own: turns the records of a file into scan lines.
//!
//!     cargo run --example writing_reader -- out
//!
//! The format of this example is text. A line is a shot: its time, s, the time of the first sample after the
//! emission, ns, and samples at 1 ns. An empty line ends a scan line.
#![allow(clippy::print_stdout, reason = "an example prints what it finds")]

use std::io::{BufRead, BufReader, Lines};
use std::path::Path;
use std::sync::Arc;
use std::{fs, fs::File};

use anyhow::{Context as _, Result};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use wavex::engine::{self, Options};
use wavex::job::Job;
use wavex::registry::STAGES;
use wavex::scan_line::{Blocks, Channel, Emission, InputInfo, Kind, MAX_SHOTS_PER_LINE, ScanLine};
use wavex::stage::{self, Config, Context, Item, Paths, Reason, RunContext, Source, SourceConfig, StageSpec};
use wavex_formats::{Error, regular_file};

/// Name of the stage, and kind of the lines that it makes.
const READ_SHOTS: StageSpec = StageSpec::source::<ReadShots>("read_shots", Kind::Shots);

/// Reads shots from text.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct ReadShots {
    /// Recording: a file, a list, or a pattern. The engine runs the chain once for each file.
    path: Paths,
    /// Group velocity of the pulse in air, m/s.
    #[serde(default = "in_air")]
    #[schemars(range(min = 2e8, max = 3e8))]
    group_velocity_mps: f64,
}

fn in_air() -> f64 {
    299_702_547.0
}

impl Config for ReadShots {}

impl SourceConfig for ReadShots {
    fn paths(&self) -> Option<&Paths> {
        Some(&self.path)
    }

    fn make(&self, run: &RunContext) -> stage::Result<Box<dyn Source>> {
        let input = InputInfo {
            path: run.input.clone(),
            stem: run.stem.clone(),
            format: "shots as text".into(),
            sampling_interval_ns: 1.0,
            group_velocity_mps: self.group_velocity_mps,
            origin_is_sensor: true,
            ..InputInfo::default()
        };
        // Pipes and devices are refused, because reading them may never end.
        let text = BufReader::new(regular_file(&run.input)?).lines();
        Ok(Box::new(Reader { text, input: Arc::new(input), n_lines: 0, n_shots: 0, has_ended: false }))
    }
}

struct Reader {
    text: Lines<BufReader<File>>,
    input: Arc<InputInfo>,
    n_lines: u32,
    n_shots: u64,
    has_ended: bool,
}

impl Source for Reader {
    /// Reads one scan line.
    ///
    /// A recording never fits into memory, so a source reads no more than the line that it returns.
    fn next(&mut self, cx: &mut Context) -> stage::Result<Option<ScanLine>> {
        let (mut emissions, mut blocks) = (Vec::new(), Blocks::default());
        while !self.has_ended && emissions.len() < MAX_SHOTS_PER_LINE {
            let Some(text) = self.text.next() else {
                self.has_ended = true;
                break;
            };
            let text = text.map_err(Error::io(&self.input.path, "read"))?;
            if text.trim().is_empty() {
                if emissions.is_empty() { continue } else { break }
            }
            // A bad record is counted with its reason, and the run goes on.
            let Some((time_s, start_ns, samples)) = shot_of(&text) else {
                cx.reject(Reason::Custom(Item::Shots, "not two times and samples"), 1);
                continue;
            };
            let index = emissions.len() as u32;
            emissions.push(Emission {
                shot: self.n_shots,
                gps_time_s: time_s,
                clock_ps: (time_s * 1e12).round() as i64,
                mta_zone: Some(0),
                ..Emission::default()
            });
            blocks.push(index, Channel::LowPower, None, start_ns, 1.0, &samples);
            self.n_shots += 1;
        }
        if emissions.is_empty() {
            return Ok(None);
        }
        self.n_lines += 1;
        Ok(Some(ScanLine::of_shots(Arc::clone(&self.input), self.n_lines - 1, emissions, blocks)))
    }
}

/// Time, s, start of the samples, ns, and samples; `None` if the text is something else.
fn shot_of(text: &str) -> Option<(f64, f64, Vec<u16>)> {
    let mut words = text.split_whitespace();
    let mut time = || words.next()?.parse().ok().filter(|time: &f64| time.abs() < 1e6);
    let (time_s, start_ns) = (time()?, time()?);
    let samples: Vec<u16> = words.map(|word| word.parse().ok()).collect::<Option<_>>()?;
    (!samples.is_empty()).then_some((time_s, start_ns, samples))
}

const JOB: &str = "\
[[stage]]
type = 'read_shots'
path = 'three.txt'

[[stage]]
type = 'write_lstat'
path = '*_lstat.txt'
";

fn main() -> Result<()> {
    let folder = std::env::args().nth(1).context("missing argument: output folder")?;
    let recording = Path::new(&folder).join("three.txt");
    fs::create_dir_all(&folder)?;
    fs::write(
        recording,
        "0.00001 6000.0 2 3 40 12 2\n0.00002 6001.5 2 2 9 3\nnoise\n\n0.00003 6000.2 2 5 2\n",
    )?;
    let stages: Vec<&'static StageSpec> = STAGES.iter().copied().chain([&READ_SHOTS]).collect();
    let job = Job::parse(&stages, "the job of this example", JOB, &[])?;
    let run = engine::run(&job, &Options::of_job(&job, &folder, &folder))?;
    for stage in run.inputs.iter().flat_map(|input| &input.stages).take(1) {
        println!("{}: {} lines, {} shots", stage.id, stage.lines_out, stage.items_out.shots);
        println!("dropped {:?}", stage.rejected);
    }
    Ok(())
}
