//! Runs on real recordings, and their tables.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use wavex::registry::STAGES;

use wavex::engine::{self, InputSummary, Options};
use wavex::job::{Job, Override};
use wavex::scan_line::Channel;
use wavex::stage::{Context, Plan, Planned, RunContext};

/// Runs a job of the folder `jobs` on the recordings; writes to `out`.
pub fn run_job(name: &str, data: &Path, out: &Path, set: &[&str]) -> InputSummary {
    let path = crate::root().join("jobs").join(name);
    let text = std::fs::read_to_string(&path).expect("the job exists in the repository");
    run(name, &text, data, out, set)
}

/// Runs a job on the inputs of a folder; writes to `out`.
pub fn run(name: &str, text: &str, inputs: &Path, out: &Path, set: &[&str]) -> InputSummary {
    let overrides: Vec<Override> = set.iter().map(|text| Override::new(*text)).collect();
    let job = Job::parse(STAGES, name, text, &overrides).unwrap_or_else(|errors| panic!("{errors}"));
    let options = Options::of_job(&job, inputs, out);
    let mut report = engine::run(&job, &options).unwrap_or_else(|error| panic!("{error}"));
    report.inputs.remove(0)
}

/// A numeric table by column; other text is NaN.
pub struct Table {
    columns: HashMap<String, usize>,
    rows: Vec<Vec<f64>>,
}

impl Table {
    /// Reads a text table with a header line.
    pub fn read(path: &Path) -> Table {
        let text =
            std::fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        let mut lines = text.lines();
        let names = lines.next().expect("a header line").split(',');
        let columns = names.enumerate().map(|(i, name)| (name.to_string(), i)).collect();
        let row = |line: &str| line.split(',').map(|cell| cell.parse().unwrap_or(f64::NAN)).collect();
        Table { columns, rows: lines.map(row).collect() }
    }

    /// Values of a column.
    pub fn column(&self, name: &str) -> Vec<f64> {
        let i = self.columns[name];
        self.rows.iter().map(|row| row[i]).collect()
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.rows.len()
    }
}

/// Median and robust SD (1.4826 MAD).
pub fn robust(values: &[f64]) -> (f64, f64) {
    let centre = median(values);
    let deviations: Vec<f64> = values.iter().map(|value| (value - centre).abs()).collect();
    (centre, 1.4826 * median(&deviations))
}

/// Median; panics on an empty list.
pub fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let n = sorted.len();
    assert!(n > 0, "median of an empty list");
    (sorted[(n - 1) / 2] + sorted[n / 2]) / 2.0
}

/// Low-power samples of all blocks of a recording, in order.
pub fn samples(reader: &str, path: &Path) -> Vec<Vec<u16>> {
    samples_of(Channel::LowPower, reader, path).into_iter().map(|(_, samples)| samples).collect()
}

/// Samples and shots of all blocks of one channel, in order.
pub fn samples_of(channel: Channel, reader: &str, path: &Path) -> Vec<(u64, Vec<u16>)> {
    let spec = wavex::registry::find(reader).expect("a reader of the registry");
    let keys = toml::toml! { path = "unused" }.to_string();
    let table = toml::de::DeTable::parse(&keys).expect("the test's own TOML");
    let Ok(Planned { plan: Plan::Source(source), .. }) = (spec.parse)(table) else {
        panic!("{reader} is a source")
    };
    let run = RunContext {
        input: path.to_path_buf(),
        stem: String::new(),
        input_dir: PathBuf::new(),
        output_dir: PathBuf::new(),
        simd: wavex_simd::SimdLevel::best(),
        ..RunContext::alone("".as_ref())
    };
    let mut source = source.make(&run).unwrap_or_else(|error| panic!("{error}"));
    let mut cx = Context::default();
    let mut found = Vec::new();
    while let Some(scan_line) = source.next(&mut cx).unwrap_or_else(|error| panic!("{error}")) {
        let blocks = scan_line.blocks().expect("a reader gives waveforms");
        for block in blocks.iter().filter(|block| block.channel == channel) {
            let shot = scan_line.emissions[block.emission as usize].shot;
            found.push((shot, blocks.samples(block).to_vec()));
        }
    }
    found
}
