//! All jobs of the repository are valid, and the demo runs.

use std::path::Path;
use wavex::registry::STAGES;

use wavex::job::Job;
use wavex_testkit::recordings::{run, run_job};

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
        Job::parse(STAGES, &name, &text, &[]).unwrap_or_else(|errors| panic!("{errors}"));
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
    assert_eq!(files, ["demo.laz", "demo_lstat.txt", "demo_returns.parquet"]);
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

/// The substitute for RIEGL's library, which cargo builds with the examples before the tests.
fn stand_in() -> String {
    let test = std::env::current_exe().unwrap();
    let (before, after) = (std::env::consts::DLL_PREFIX, std::env::consts::DLL_SUFFIX);
    let folder = test.parent().and_then(Path::parent).unwrap().join("examples");
    folder.join(format!("{before}sdf_stand_in{after}")).display().to_string()
}

#[test]
fn the_whole_chain_runs_on_a_raw_recording() {
    let folder = tempfile::tempdir().unwrap();
    let simulate = "[[stage]]\ntype = 'simulate'\nstem = 'flight'\nlines = 6\nshots_per_line = 100\nas_recorded = true\n\
                    high_power = true\npulse_rate_hz = 300000\nmodulation_ns = 15.0\nflying_height_m = 1000.0\npof = '*.pof'\n\
                    [[stage]]\ntype = 'write_arrow'\npath = 'flight.sdf'\n";
    run("flight", simulate, Path::new("."), folder.path(), &[]);
    let out = folder.path().join("out");
    let library = format!("read_sdf.library={}", stand_in());
    let report = run_job("sdf.toml", folder.path(), &out, &[&library]);
    let stages: Vec<&str> = report.stages.iter().map(|stage| stage.r#type.as_str()).collect();
    let whole = [
        "read_sdf",
        "resolve_mta",
        "fuse_channels",
        "calibrate",
        "decompose",
        "correct",
        "filter_outliers",
        "georeference",
        "write_las",
        "write_ascii",
        "write_table",
        "write_trajectory",
        "write_lstat",
    ];
    assert_eq!(stages, whole);
    let (shots, returns) = (report.stages[0].items_out.shots, report.totals["np"]);
    assert!(shots == 600 && returns >= 500, "{shots} shots, {returns} returns");
    assert_eq!(report.totals["n_georef"], returns);
    assert!(
        report.coordinates.as_deref().is_some_and(|name| name.contains("UTM zone 33N")),
        "{:?}",
        report.coordinates
    );
    for file in
        ["flight.laz", "flight_points.txt", "flight_returns.parquet", "flight_traj.txt", "flight_lstat.txt"]
    {
        assert!(out.join(file).is_file(), "{file}");
    }
}

#[test]
fn a_recording_of_each_kind_runs_by_its_job() {
    let Some(data) = wavex_testkit::data() else { return };
    for (job, recording, returns) in [
        ("las.toml", "read_las.path=riegl_q680i_dev/riegl_q680i_dev.las", 607),
        ("pulsewaves.toml", "read_pulsewaves.path=riegl_q680i_dev/riegl_q680i_dev.pls", 607),
        ("large_footprint.toml", "read_pulsewaves.path=pulsewaves/lvis_example1.pls", 1000),
        ("gedi.toml", "read_hdf5.path=gedi/gedi_l1b.h5", 164),
    ] {
        let out = tempfile::tempdir().unwrap();
        // Waveforms of crowns take long without optimisation.
        let is_decomposed = !["gedi.toml", "large_footprint.toml"].contains(&job);
        let set: Vec<&str> =
            [recording].into_iter().chain(is_decomposed.then_some("decompose.mode=fastest")).collect();
        let report = run_job(job, &data, out.path(), &set);
        assert!(report.totals["np"] >= returns, "{job}: {} returns", report.totals["np"]);
        assert!(report.outputs.iter().all(|output| output.is_file()), "{job}");
    }
    let out = tempfile::tempdir().unwrap();
    wavex_testkit::neon::to_container(&data.join("neon"), &out.path().join("flight.arrow"));
    let report = run_job("container.toml", out.path(), &out.path().join("out"), &[]);
    assert!(report.totals["np"] >= 250, "{} returns", report.totals["np"]);
}
