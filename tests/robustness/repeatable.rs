//! The same job on the same input gives the same bytes for any number of threads, queue length and
//! repetition.

use std::collections::BTreeMap;
use std::hash::{DefaultHasher, Hash, Hasher};
use wavex::registry::STAGES;

use wavex::engine::{self, Options};
use wavex::job::{Job, Override, Simd};
use wavex_simd::SimdLevel;

const JOB: &str = r#"
[[stage]]
type = "simulate"
lines = 5
shots_per_line = 80
truth = "*_truth.csv"
[[stage]]
type = "write_arrow"
[[stage]]
type = "calibrate"
waveforms = 200
[[stage]]
type = "decompose"
[[stage]]
type = "georeference"
[[stage]]
type = "write_las"
path = "*.laz"
[[stage]]
type = "write_las"
path = "*.las"
[[stage]]
type = "write_las"
path = "*_waves.laz"
wave_packets = "internal"
index = "appended"
[[stage]]
type = "write_lstat"
[[stage]]
type = "write_table"
path = "*.parquet"
[[stage]]
type = "write_table"
path = "*.csv"
[[stage]]
type = "write_table"
path = "*_returns.arrow"
"#;

/// Digests of all outputs, by name.
fn digests(threads: usize, channel_capacity: usize) -> BTreeMap<String, u64> {
    digests_with(threads, channel_capacity, &[])
}

/// The same with other keys.
fn digests_with(threads: usize, channel_capacity: usize, set: &[&str]) -> BTreeMap<String, u64> {
    let folder = tempfile::tempdir().unwrap();
    let set: Vec<Override> = set.iter().map(|set| Override::new((*set).to_owned())).collect();
    let job = Job::parse(STAGES, "repeat.toml", JOB, &set).unwrap_or_else(|errors| panic!("{errors}"));
    let options =
        Options { threads, channel_capacity, ..Options::of_job(&job, folder.path(), folder.path()) };
    let report = engine::run(&job, &options).unwrap();
    let digest = |path: &std::path::PathBuf| {
        let mut hasher = DefaultHasher::new();
        std::fs::read(path).unwrap().hash(&mut hasher);
        (path.file_name().unwrap().to_string_lossy().into_owned(), hasher.finish())
    };
    report.inputs[0].outputs.iter().map(digest).collect()
}

#[test]
fn threads_queues_and_repetition_change_no_byte() {
    let first = digests(1, 1);
    assert_eq!(first.len(), 9);
    for (threads, capacity) in [(1, 1), (2, 16), (3, 2), (8, 64)] {
        assert_eq!(digests(threads, capacity), first, "{threads} threads, {capacity} lines in a queue");
    }
}

#[test]
fn the_instructions_change_no_byte() {
    for mode in ["refined", "fastest"] {
        let mode = format!("decompose.mode='{mode}'");
        let first = digests_with(2, 16, &[&mode]);
        for path in SimdLevel::ALL.into_iter().filter(|path| path.is_available()) {
            let simd = serde_json::to_value(Simd::from(path)).unwrap();
            let set = [&mode, &format!("job.simd={simd}")];
            assert_eq!(digests_with(3, 2, &set.map(String::as_str)), first, "{mode} {path:?}");
        }
    }
}

#[test]
fn the_instructions_in_use_are_reported() {
    let folder = tempfile::tempdir().unwrap();
    for (set, used) in [("job.simd='portable'", SimdLevel::Portable), ("job.simd='auto'", SimdLevel::best())]
    {
        let job = Job::parse(STAGES, "repeat.toml", JOB, &[Override::new(set)]).unwrap();
        let report = engine::run(&job, &Options::of_job(&job, folder.path(), folder.path())).unwrap();
        assert_eq!(report.simd, used.into());
    }
}

/// Returns of a small simulated flight with these keys of `calibrate`, in `folder`.
fn returns(folder: &std::path::Path, name: &str, calibrate: &str) -> Vec<u8> {
    let text = format!(
        "[[stage]]\ntype = 'simulate'\nlines = 3\nshots_per_line = 120\n[[stage]]\ntype = 'calibrate'\n{calibrate}\n\
         [[stage]]\ntype = 'decompose'\n[[stage]]\ntype = 'write_table'\npath = '{name}'\n"
    );
    let job = Job::parse(STAGES, "model.toml", &text, &[]).unwrap_or_else(|errors| panic!("{errors}"));
    engine::run(&job, &Options::of_job(&job, folder, folder)).unwrap();
    std::fs::read(folder.join(name)).unwrap()
}

#[test]
fn a_saved_sensor_model_gives_the_same_returns_again() {
    let folder = tempfile::tempdir().unwrap();
    let found = returns(folder.path(), "found.csv", "save = 'model.json'");
    let again = returns(folder.path(), "again.csv", "load = 'model.json'");
    assert!(found.len() > 10_000, "there are returns: {} bytes", found.len());
    assert!(found == again, "to the byte");
}
