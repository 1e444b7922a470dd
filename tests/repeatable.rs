//! The same job on the same input gives the same bytes, whatever the threads, the queues and the repetition.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a test fails by panicking, and tells its figures"
)]

use std::collections::BTreeMap;
use std::hash::{DefaultHasher, Hash, Hasher};

use wavex::engine::{self, Options};
use wavex::job::Job;

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

/// The digest of every output, by name.
fn digests(threads: usize, channel_capacity: usize) -> BTreeMap<String, u64> {
    let folder = tempfile::tempdir().unwrap();
    let job = Job::parse("repeat.toml", JOB, &[]).unwrap_or_else(|errors| panic!("{errors}"));
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
    assert_eq!(first.len(), 8);
    for (threads, capacity) in [(1, 1), (2, 16), (3, 2), (8, 64)] {
        assert_eq!(digests(threads, capacity), first, "{threads} threads, {capacity} lines in a queue");
    }
}
