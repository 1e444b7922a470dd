//! The library examples run and produce the documented results.

use std::path::Path;
use std::process::Command;

use wavex_testkit::{Outcome, built, outcome, wavex};

/// Output of an example.
#[track_caller]
fn printed(name: &str, arguments: &[&Path]) -> String {
    let output = Command::new(built(&format!("examples/{name}{}", std::env::consts::EXE_SUFFIX)))
        .args(arguments)
        .output()
        .unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    assert!(output.status.success(), "{name}: {}", text(output.stderr));
    text(output.stdout)
}

#[test]
fn an_array_of_samples_is_decomposed() {
    let out = printed("decompose_samples", &[]);
    let mut lines = out.lines();
    assert!(lines.next().unwrap().starts_with("noise SD 1.0"), "{out}");
    for (line, at) in lines.zip([25.3, 31.3]) {
        let position: f64 =
            line.strip_prefix("echo at ").unwrap().split(' ').next().unwrap().parse().unwrap();
        assert!((position - at).abs() < 0.3, "{out}");
    }
    assert_eq!(out.lines().count(), 3, "{out}");
}

#[test]
fn a_job_is_run_from_rust_and_its_recording_read() {
    let folder = tempfile::tempdir().unwrap();
    let out = printed("run_job", &[folder.path()]);
    assert!(out.starts_with("demo: ") && out.contains(" returns\n"), "{out}");
    assert!(folder.path().join("demo.laz").is_file(), "{out}");
    // A recording for the example that reads one.
    let job = folder.path().join("job.toml");
    std::fs::write(
        &job,
        "[[stage]]\ntype = 'simulate'\nstem = 'a'\nlines = 2\nshots_per_line = 50\n[[stage]]\ntype = 'write_arrow'\n",
    )
    .unwrap();
    assert_eq!(outcome(wavex().args(["-q", "run"]).arg(&job)), Outcome::success());
    let out = printed("read_recording", &[&folder.path().join("a.arrow")]);
    assert!(out.contains("\nshot 0 at 208800") && out.contains("\n2 scan lines, 100 shots, "), "{out}");
}

#[test]
fn a_map_of_ones_own_drops_returns() {
    let folder = tempfile::tempdir().unwrap();
    let out = printed("writing_map", &[folder.path()]);
    assert!(out.contains("drop_weak: ") && out.contains("{\"returns: too weak\": "), "{out}");
    assert!(folder.path().join("simulated.csv").is_file());
}

#[test]
fn a_reader_of_ones_own_reads_lines_and_counts_bad_records() {
    let folder = tempfile::tempdir().unwrap();
    let out = printed("writing_reader", &[folder.path()]);
    assert!(out.starts_with("read_shots: 2 lines, 3 shots\n"), "{out}");
    assert!(out.contains("{\"shots: not two times and samples\": 1}"), "{out}");
    assert!(folder.path().join("three_lstat.txt").is_file());
}

#[test]
fn a_sink_of_ones_own_writes_a_row_per_line() {
    let folder = tempfile::tempdir().unwrap();
    let out = printed("writing_sink", &[folder.path()]);
    assert!(out.starts_with("wrote ") && out.ends_with("highest.txt\n"), "{out}");
    let text = std::fs::read_to_string(folder.path().join("highest.txt")).unwrap();
    let lines: Vec<&str> = text.lines().map(|line| line.split(' ').next().unwrap()).collect();
    assert_eq!(lines, ["0", "1", "2"], "{text}");
}
