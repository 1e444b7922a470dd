//! Guarantees of the engine, tested with trivial stages.

use std::fs;
use std::path::Path;

use wavex::engine::{self, Options};
use wavex::stage::Item;
use wavex_testkit::engine_stages::{COUNT, HOLD, WORK, WRITE_NUMBERS, into, job};

fn files(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> = fs::read_dir(folder)
        .unwrap()
        .map(|e| e.unwrap().file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    names
}

fn numbers(lines: u32) -> String {
    (0..lines).map(|line| format!("{line}\n")).collect()
}

#[test]
fn lines_come_out_in_order_whatever_the_pool_and_the_capacity() {
    for (threads, capacity) in [(1, 1), (2, 1), (4, 3), (7, 64)] {
        let folder = tempfile::tempdir().unwrap();
        let job = job(&[
            (&COUNT, "lines = 300"),
            (&WORK, "longest_us = 200"),
            (&HOLD, "lines = 20"),
            (&WORK, "longest_us = 50"),
            (&WORK, "longest_us = 100"),
            (&WRITE_NUMBERS, ""),
        ]);
        let options = Options { threads, channel_capacity: capacity, ..into(&job, folder.path()) };
        let report = engine::run(&job, &options).unwrap();
        assert_eq!(fs::read_to_string(folder.path().join("out.txt")).unwrap(), numbers(300));
        assert_eq!(report.inputs[0].stages[1].workers, threads);
        assert_eq!(report.inputs[0].totals["nw"], 900);
    }
}

#[test]
fn every_item_is_passed_on_or_rejected_with_a_reason() {
    let folder = tempfile::tempdir().unwrap();
    let job = job(&[(&COUNT, "lines = 10\nshots = 3"), (&WORK, "drop_one = true"), (&WRITE_NUMBERS, "")]);
    let report = engine::run(&job, &into(&job, folder.path())).unwrap();
    let work = &report.inputs[0].stages[1];
    assert_eq!((work.items_in.shots, work.items_out.shots), (30, 20));
    assert_eq!(work.rejected_of(Item::Shots), 10);
    assert_eq!(work.rejected["shots: last of its line"], 10);
}

#[test]
fn several_sinks_follow_one_another() {
    let folder = tempfile::tempdir().unwrap();
    let job =
        job(&[(&COUNT, ""), (&WRITE_NUMBERS, "path = 'a.txt'"), (&WRITE_NUMBERS, "path = 'sub/b.txt'")]);
    let report = engine::run(&job, &into(&job, folder.path())).unwrap();
    assert_eq!(fs::read_to_string(folder.path().join("a.txt")).unwrap(), numbers(10));
    assert_eq!(fs::read_to_string(folder.path().join("sub/b.txt")).unwrap(), numbers(10));
    assert_eq!(report.inputs[0].outputs.len(), 2);
}

/// Runs a job that must fail, in a folder that must stay empty.
fn failing(stages: &[(&'static wavex::stage::StageSpec, &str)]) -> String {
    let folder = tempfile::tempdir().unwrap();
    let job = job(stages);
    let error = engine::run(&job, &Options { threads: 3, ..into(&job, folder.path()) }).unwrap_err();
    assert_eq!(files(folder.path()), Vec::<String>::new(), "a failed run leaves no file");
    error.to_string()
}

#[test]
fn a_source_that_fails_is_the_cause() {
    let error =
        failing(&[(&COUNT, "lines = 1000\nfail_at = 500"), (&WORK, ""), (&HOLD, ""), (&WRITE_NUMBERS, "")]);
    assert_eq!(error, "stage count: byte 77 is wrong; copy the file again");
}

#[test]
fn a_sink_that_fails_is_the_cause_and_not_the_stages_before_it() {
    for _ in 0..20 {
        let error = failing(&[
            (&COUNT, "lines = 100000"),
            (&WORK, ""),
            (&WRITE_NUMBERS, "path = 'first.txt'"),
            (&WRITE_NUMBERS, "fail_at = 40"),
            (&WRITE_NUMBERS, "path = 'third.txt'"),
        ]);
        assert_eq!(error, "stage write_numbers: the disk is full; make room");
    }
}

#[test]
fn a_panic_ends_the_run_and_says_where() {
    let error = failing(&[(&COUNT, "lines = 100000"), (&WORK, "panic_at = 30"), (&WRITE_NUMBERS, "")]);
    assert!(
        error.contains("bug in wavex: line 30 is a bug (crates/testkit/src/engine_stages.rs:"),
        "{error}"
    );
    assert!(error.contains("please report it with the job"), "{error}");
}

#[test]
fn a_cancelled_run_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let job =
        job(&[(&COUNT, "lines = 1000000"), (&WORK, ""), (&HOLD, ""), (&WRITE_NUMBERS, "slow_us = 100")]);
    let options = into(&job, folder.path());
    let cancel = options.cancel.clone();
    let error = std::thread::scope(|scope| {
        scope.spawn(move || {
            std::thread::sleep(std::time::Duration::from_millis(50));
            cancel.cancel();
        });
        engine::run(&job, &options).unwrap_err()
    });
    assert_eq!(error.to_string(), "interrupted; unfinished outputs were removed");
    assert_eq!(files(folder.path()), Vec::<String>::new());
}

#[test]
fn memory_in_flight_stays_within_its_bound() {
    let folder = tempfile::tempdir().unwrap();
    let mut job = job(&[
        (&COUNT, "lines = 400\nshots = 4000"),
        (&HOLD, "lines = 1000000"),
        (&HOLD, "lines = 1000000"),
        (&WORK, "longest_us = 300"),
        (&WRITE_NUMBERS, ""),
    ]);
    job.settings.memory_mb = 64;
    let report = engine::run(&job, &Options { channel_capacity: 1000, ..into(&job, folder.path()) }).unwrap();
    let peak = report.inputs[0].peak_in_flight_bytes;
    assert!((16_000_000..=64_000_000).contains(&peak), "{peak}");
    assert_eq!(fs::read_to_string(folder.path().join("out.txt")).unwrap(), numbers(400));
}

#[test]
fn a_line_that_does_not_fit_says_what_to_set() {
    let folder = tempfile::tempdir().unwrap();
    let mut job = job(&[(&COUNT, "lines = 4\nshots = 200000"), (&WRITE_NUMBERS, "")]);
    job.settings.memory_mb = 64;
    let error = engine::run(&job, &into(&job, folder.path())).unwrap_err().to_string();
    assert!(error.starts_with("stage count: scan line 0 needs "), "{error}");
    assert!(error.contains("; set memory_mb to "), "{error}");
}

#[test]
fn the_trace_has_a_track_per_worker() {
    let folder = tempfile::tempdir().unwrap();
    let job = job(&[(&COUNT, ""), (&WORK, ""), (&WRITE_NUMBERS, "")]);
    let report =
        engine::run(&job, &Options { threads: 2, profile: true, ..into(&job, folder.path()) }).unwrap();
    let mut bytes = Vec::new();
    engine::write_trace(&report, &mut bytes).unwrap();
    let trace: serde_json::Value = serde_json::from_slice(&bytes).unwrap();
    let events = trace["traceEvents"].as_array().unwrap();
    let of = |phase: &str| events.iter().filter(|event| event["ph"] == phase).count();
    assert_eq!(of("M"), 4, "source, two workers, sink");
    assert!(of("X") >= 30, "each of ten lines in each of three stages");
}

#[test]
fn an_input_that_changes_while_it_is_read_fails() {
    for (changed, change, problem) in [
        ("a.pls", "append", "it grew from 3 to 4 bytes"),
        ("a.pls", "truncate", "it shrank from 3 to 2 bytes"),
        ("a.pls", "remove", "it was removed"),
        #[cfg(unix)]
        ("a.pls", "replace", "it was replaced by another file"),
        ("a.wvs", "append", "it was created"),
        ("b.las", "remove", "it was removed"),
        ("b.WDP", "truncate", "it shrank from 3 to 2 bytes"),
    ] {
        let folder = tempfile::tempdir().unwrap();
        for name in ["a.pls", "b.las", "b.WDP"] {
            fs::write(folder.path().join(name), "abc").unwrap();
        }
        let input = if changed.starts_with('a') { "a.pls" } else { "b.las" };
        let keys = format!("path = '{input}'\nchange = ['{changed}', '{change}']");
        let job = job(&[(&COUNT, keys.as_str()), (&WRITE_NUMBERS, "path = '*.txt'")]);
        let options = Options { input_dir: folder.path().to_owned(), ..into(&job, folder.path()) };
        let error = engine::run(&job, &options).unwrap_err().to_string();
        let file = folder.path().join(changed);
        let expected = format!(
            "stage count: {}: {problem} while it was read; \
             run the job again once no other program writes the file",
            file.display()
        );
        assert_eq!(error, expected);
        let is_output = |name: &String| name.ends_with(".txt");
        assert!(!files(folder.path()).iter().any(is_output), "no output of a changed input");
    }
}

#[test]
fn an_input_that_changes_does_not_affect_the_others() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["a.pls", "b.pls", "other.pls"] {
        fs::write(folder.path().join(name), "abc").unwrap();
    }
    let keys = "path = ['a.pls', 'b.pls']\nchange = ['b.pls', 'append']";
    let job = job(&[(&COUNT, keys), (&WRITE_NUMBERS, "path = '*.txt'")]);
    let options =
        Options { input_dir: folder.path().to_owned(), inputs_at_once: 1, ..into(&job, folder.path()) };
    // The run of `a.pls` appends to `b.pls` before that is read; its own run appends once more.
    engine::run(&job, &options).unwrap_err();
    let outputs: Vec<String> =
        files(folder.path()).into_iter().filter(|name| name.ends_with(".txt")).collect();
    assert_eq!(outputs, ["a.txt"]);
}
