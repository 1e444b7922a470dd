//! Every job of the repository is whole, and the demo runs.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a test fails by panicking, and tells its figures"
)]

#[path = "common/recordings.rs"]
#[allow(dead_code, reason = "each test binary uses its own part")]
mod recordings;

use std::path::Path;

use recordings::run_job;
use wavex::job::Job;

fn jobs() -> Vec<std::path::PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("jobs");
    let mut jobs: Vec<_> = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    jobs.sort();
    jobs
}

#[test]
fn every_job_fits() {
    let jobs = jobs();
    assert!(jobs.len() >= 4);
    for path in jobs {
        let text = std::fs::read_to_string(&path).unwrap();
        let name = path.display().to_string();
        Job::parse(&name, &text, &[]).unwrap_or_else(|errors| panic!("{errors}"));
        assert!(text.starts_with("#:schema ../schemas/job.schema.json\n"), "{name}");
    }
}

#[test]
fn the_demo_finds_what_it_simulates() {
    let out = tempfile::tempdir().unwrap();
    let set = ["simulate.lines=2", "simulate.shots_per_line=300"];
    let report = run_job("demo.toml", Path::new("."), out.path(), &set);
    let (waveforms, returns) = (report.totals["nw"], report.totals["np"]);
    assert!(waveforms > 550 && returns > waveforms, "{waveforms} waveforms, {returns} returns");
    let mut files: Vec<_> = report.outputs.iter().map(|path| path.file_name().unwrap().to_owned()).collect();
    files.sort();
    assert_eq!(files, ["demo.laz", "demo_lstat.txt", "demo_returns.parquet", "demo_truth.csv"]);
}

#[test]
fn a_flight_is_made_and_georeferenced() {
    let out = tempfile::tempdir().unwrap();
    let set = ["simulate.lines=8", "simulate.shots_per_line=200"];
    run_job("flight.toml", Path::new("."), out.path(), &set);
    let report = run_job("georeference.toml", out.path(), &out.path().join("points"), &[]);
    assert_eq!(report.totals["n_georef"], report.totals["np"]);
    assert!(report.totals["np"] > 1500, "{} returns", report.totals["np"]);
    assert_eq!(report.frame.as_deref(), Some("earth"));
    assert!(out.path().join("points/flight.laz").exists());
}
