//! Runs interrupted from outside.

use std::fs;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use serde_json::Value;

use wavex_testkit::las::Las;
use wavex_testkit::{Outcome, TestFolder, outcome};

/// A flight that takes hours, written to every kind of output.
const LONG: &str = "\
[[stage]]
type = 'simulate'
lines = 1000000
shots_per_line = 20
canopy_height_m = 0.0
truth = '*_truth.csv'
[[stage]]
type = 'write_arrow'
[[stage]]
type = 'calibrate'
waveforms = 300
[[stage]]
type = 'decompose'
[[stage]]
type = 'georeference'
[[stage]]
type = 'write_las'
path = '*.laz'
[[stage]]
type = 'write_table'
[[stage]]
type = 'write_lstat'
";

/// Returns whether a run has created all its outputs and written to some.
fn has_begun(place: &TestFolder) -> bool {
    let outputs = place.outputs();
    let is_written =
        |name: &String| fs::metadata(place.path("out").join(name)).is_ok_and(|about| about.len() > 0);
    outputs.len() >= 6 && outputs.iter().any(is_written)
}

/// Starts a long run and waits until it is writing.
fn begin(place: &TestFolder, job: &str) -> Child {
    let mut child = place.command(job).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    while !has_begun(place) {
        assert_eq!(child.try_wait().unwrap(), None, "the run ended before it was interrupted");
        std::thread::sleep(Duration::from_millis(20));
    }
    child
}

/// A folder may have a name that JSON cannot represent.
#[cfg(target_os = "linux")]
#[test]
fn a_folder_whose_name_is_no_unicode_is_reported_all_the_same() {
    use std::os::unix::ffi::OsStrExt;
    let las = Las::new(3);
    let place = TestFolder::new();
    let folder = place.path("").join(std::ffi::OsStr::from_bytes(b"caf\xe9"));
    fs::create_dir(&folder).unwrap();
    fs::write(folder.join("a.las"), las.las()).unwrap();
    fs::write(folder.join("a.wdp"), &las.packets).unwrap();
    fs::write(folder.join("job.toml"), "[[stage]]\ntype = 'read_las'\npath = 'a.las'\n").unwrap();
    let mut command = wavex_testkit::wavex();
    command.args(["-q", "run"]).arg(folder.join("job.toml"));
    assert_eq!(outcome(&mut command), Outcome::success());
    let report: Value = serde_json::from_slice(&fs::read(folder.join("job_report.json")).unwrap()).unwrap();
    assert!(report["inputs"][0]["path"].as_str().unwrap().ends_with("caf\u{fffd}/a.las"), "{report}");
}

/// Sends a signal to a run.
fn send(signal: &str, to: &Child) {
    let sent = Command::new("kill").args([&format!("-{signal}"), &to.id().to_string()]).status().unwrap();
    assert!(sent.success());
}

/// Asserts the message and the absence of outputs of an interrupted run.
#[track_caller]
fn ends(place: &TestFolder, child: Child) {
    let output = child.wait_with_output().unwrap();
    let err = String::from_utf8(output.stderr).unwrap();
    assert_eq!(err, "error: interrupted; unfinished outputs were removed\n");
    assert_eq!(output.status.code(), Some(1));
    assert_eq!(place.products(), Vec::<String>::new());
}

#[test]
fn a_signal_ends_a_run_in_order() {
    for signal in ["INT", "TERM", "HUP"] {
        let place = TestFolder::new();
        let child = begin(&place, LONG);
        let is_unfinished = |name: &String| name.ends_with(".partial") || name.starts_with(".wavex");
        assert!(place.outputs().iter().all(is_unfinished), "{:?}", place.outputs());
        send(signal, &child);
        ends(&place, child);
    }
}

#[test]
fn a_second_signal_ends_a_stage_that_takes_its_time() {
    let place = TestFolder::new();
    // Calibration from 500 000 waveforms takes seconds.
    let mut child = begin(&place, &LONG.replace("waveforms = 300", "waveforms = 500000"));
    // Nothing more is written once calibration has started and all queues before it are full.
    let written = || {
        let outputs = place.outputs();
        outputs.iter().map(|name| fs::metadata(place.path("out").join(name)).unwrap().len()).sum::<u64>()
    };
    let mut before = 0;
    while before != written() {
        assert_eq!(child.try_wait().unwrap(), None, "calibration ended before it was interrupted");
        before = written();
        std::thread::sleep(Duration::from_millis(500));
    }
    send("INT", &child);
    std::thread::sleep(Duration::from_millis(100));
    send("INT", &child);
    ends(&place, child);
}
