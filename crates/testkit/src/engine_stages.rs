//! Small stages for test chains, and jobs made of them without text.

use std::fs;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use wavex::engine::Options;
use wavex::job::{Job, JobStage};
use wavex::scan_line::{Blocks, Channel, Emission, Frame, InputInfo, Kind, ScanLine};
use wavex::stage::{
    Config, Context, Item, Map, MapConfig, Output, Paths, Reason, Result, RunContext, Sink, SinkConfig,
    Source, SourceConfig, StageError, StageSpec, Transform, TransformConfig,
};
use wavex_formats::Error;

/// Input without metadata, in map coordinates.
pub fn input_info() -> InputInfo {
    InputInfo { stem: "test".into(), format: "test".into(), frame: Frame::Map, ..InputInfo::default() }
}

/// A shot at nadir from 1000 m; 10 us per shot.
pub fn emission(shot: u64) -> Emission {
    Emission {
        shot,
        gps_time_s: shot as f64 * 1e-5,
        clock_ps: shot as i64 * 10_000_000,
        origin_m: [0.0, 0.0, 1000.0],
        mta_zone: Some(0),
        scan_angle_deg: 0.0,
        ..Emission::default()
    }
}

/// A scan line of shots with one sample block each.
pub fn line_of_shots(input: &Arc<InputInfo>, line: u32, shots: usize) -> ScanLine {
    let emissions = (0..shots).map(|i| emission(u64::from(line) * shots as u64 + i as u64)).collect();
    let mut blocks = Blocks::default();
    for i in 0..shots {
        blocks.push(i as u32, Channel::LowPower, None, 6000.0, 1.0, &[2, 2, 3, (line % 200) as u16]);
    }
    ScanLine::of_shots(Arc::clone(input), line, emissions, blocks)
}

/// A source of lines of shots.
#[derive(Clone, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Count {
    /// Number of lines.
    pub lines: u32,
    /// Shots per line.
    pub shots: usize,
    /// Line at which the source fails; none if negative.
    pub fail_at: i64,
    /// Inputs, which are not read.
    pub path: Option<Paths>,
    /// What the source does to its input, or to another file, before the second line.
    pub change: Option<(String, Change)>,
}

/// What the source does to a file.
#[derive(Clone, Copy, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Change {
    /// Appends a byte.
    Append,
    /// Removes the last byte.
    Truncate,
    /// Replaces the file by a copy.
    Replace,
    /// Removes the file.
    Remove,
}

impl Default for Count {
    fn default() -> Count {
        Count { lines: 10, shots: 3, fail_at: -1, path: None, change: None }
    }
}

impl Config for Count {}

impl SourceConfig for Count {
    fn paths(&self) -> Option<&Paths> {
        self.path.as_ref()
    }
    fn make(&self, run: &RunContext) -> Result<Box<dyn Source>> {
        let input = Arc::new(InputInfo { path: run.input.clone(), ..input_info() });
        Ok(Box::new(Counting { config: self.clone(), next: 0, input }))
    }
}

impl Change {
    fn make(self, file: &Path) -> std::io::Result<()> {
        let mut bytes = fs::read(file).unwrap_or_default();
        match self {
            Change::Append => bytes.push(0),
            Change::Truncate => drop(bytes.pop()),
            Change::Replace => {
                let copy = file.with_extension("copy");
                fs::copy(file, &copy)?;
                return fs::rename(copy, file);
            }
            Change::Remove => return fs::remove_file(file),
        }
        fs::write(file, bytes)
    }
}

struct Counting {
    config: Count,
    next: u32,
    input: Arc<InputInfo>,
}

impl Source for Counting {
    fn next(&mut self, _cx: &mut Context) -> Result<Option<ScanLine>> {
        if i64::from(self.next) == self.config.fail_at {
            return Err(StageError::failed("byte 77 is wrong", "copy the file again"));
        }
        if self.next == self.config.lines {
            return Ok(None);
        }
        if let (1, Some((name, change))) = (self.next, &self.config.change) {
            change
                .make(&self.input.path.with_file_name(name))
                .map_err(Error::io(&self.input.path, "change"))?;
        }
        self.next += 1;
        Ok(Some(line_of_shots(&self.input, self.next - 1, self.config.shots)))
    }
}

/// A map with a run time that varies from line to line.
///
/// Optionally rejects the first shot of every line.
#[derive(Clone, Default, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Work {
    /// Maximum run time, us.
    pub longest_us: u64,
    /// Whether to drop one shot per line.
    pub drop_one: bool,
    /// Line at which the stage panics; none if 0.
    pub panic_at: u32,
}

impl Config for Work {}

impl MapConfig for Work {
    fn make(&self, _: &RunContext) -> Result<Box<dyn Map>> {
        Ok(Box::new(self.clone()))
    }
}

impl Map for Work {
    fn map(&mut self, mut scan_line: ScanLine, cx: &mut Context) -> Result<ScanLine> {
        assert!(self.panic_at == 0 || scan_line.line != self.panic_at, "line {} is a bug", scan_line.line);
        if self.longest_us > 0 {
            let pseudo_random = u64::from(scan_line.line).wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 40;
            std::thread::sleep(Duration::from_micros(pseudo_random % self.longest_us));
        }
        if self.drop_one && scan_line.emissions.pop().is_some() {
            cx.reject(Reason::Custom(Item::Shots, "last of its line"), 1);
        }
        Ok(scan_line)
    }
}

/// A transform that holds back the first lines.
#[derive(Clone, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Hold {
    /// Number of lines.
    pub lines: usize,
}

impl Default for Hold {
    fn default() -> Hold {
        Hold { lines: 4 }
    }
}

impl Config for Hold {}

impl TransformConfig for Hold {
    fn make(&self, _: &RunContext) -> Result<Box<dyn Transform>> {
        Ok(Box::new(Holding { lines: self.lines, held: Vec::new(), released: false }))
    }
}

struct Holding {
    lines: usize,
    held: Vec<ScanLine>,
    released: bool,
}

impl Transform for Holding {
    fn process(&mut self, scan_line: ScanLine, out: &mut Output) -> Result<()> {
        if self.released {
            return out.emit(scan_line);
        }
        self.held.push(scan_line);
        let bytes: usize = self.held.iter().map(ScanLine::bytes).sum();
        if self.held.len() >= self.lines || bytes > out.may_hold_bytes() {
            self.released = true;
            return self.finish(out);
        }
        Ok(())
    }

    fn finish(&mut self, out: &mut Output) -> Result<()> {
        self.held.drain(..).try_for_each(|scan_line| out.emit(scan_line))
    }
}

/// A sink that writes line numbers.
#[derive(Clone, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct WriteNumbers {
    /// Output file.
    pub path: String,
    /// Line at which writing fails; none if 0.
    pub fail_at: u32,
    /// Run time per line, us.
    pub slow_us: u64,
}

impl Default for WriteNumbers {
    fn default() -> WriteNumbers {
        WriteNumbers { path: "*.txt".into(), fail_at: 0, slow_us: 0 }
    }
}

impl Config for WriteNumbers {}

impl SinkConfig for WriteNumbers {
    fn outputs(&self) -> Vec<&str> {
        vec![&self.path]
    }
    fn make(&self, run: &RunContext) -> Result<Box<dyn Sink>> {
        Ok(Box::new(Numbers { config: self.clone(), file: run.create(&self.path)? }))
    }
}

struct Numbers {
    config: WriteNumbers,
    file: wavex::stage::OutputFile,
}

impl Sink for Numbers {
    fn write(&mut self, scan_line: &ScanLine, _cx: &mut Context) -> Result<()> {
        use std::io::Write;
        std::thread::sleep(Duration::from_micros(self.config.slow_us));
        if self.config.fail_at > 0 && scan_line.line == self.config.fail_at {
            return Err(StageError::failed("the disk is full", "make room"));
        }
        writeln!(self.file, "{}", scan_line.line)
            .map_err(|e| StageError::failed(e.to_string(), "check the disk"))
    }
    fn finish(self: Box<Self>, cx: &mut Context) -> Result<()> {
        cx.publish(self.file.finish()?);
        Ok(())
    }
}

/// Entry of [`Count`].
pub const COUNT: StageSpec = StageSpec::source::<Count>("count", Kind::Shots);
/// Entry of [`Work`].
pub const WORK: StageSpec = StageSpec::map::<Work>("work", &[Kind::Shots], None);
/// Entry of [`Hold`].
pub const HOLD: StageSpec = StageSpec::transform::<Hold>("hold", &[Kind::Shots]);
/// Entry of [`WriteNumbers`].
pub const WRITE_NUMBERS: StageSpec = StageSpec::sink::<WriteNumbers>("write_numbers", &[Kind::Shots]);

/// A job of these stages, each with its keys as TOML.
pub fn job(stages: &[(&'static StageSpec, &str)]) -> Job {
    let stages = stages.iter().map(|(spec, keys)| stage(spec, keys)).collect();
    Job { stages, ..Job::default() }
}

/// A stage of a job with keys as TOML; stages `work` get distinct IDs.
pub fn stage(spec: &'static StageSpec, keys: &str) -> JobStage {
    let table = toml::de::DeTable::parse(keys).expect("the test's own TOML");
    let planned = (spec.parse)(table).expect("the test's own keys");
    static COUNT: AtomicUsize = AtomicUsize::new(0);
    let id = match spec.name {
        "work" => format!("work-{}", COUNT.fetch_add(1, Ordering::Relaxed)),
        name => name.to_string(),
    };
    JobStage { id, spec, planned }
}

/// Options that write to a folder.
pub fn into(job: &Job, folder: &std::path::Path) -> Options {
    Options::of_job(job, folder, folder)
}
