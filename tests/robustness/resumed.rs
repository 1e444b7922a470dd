//! Resumed runs: the same outputs and reports as those of an undisturbed run.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::process::{Child, Stdio};
use std::time::{Duration, Instant, SystemTime};

use serde_json::Value;
use wavex_testkit::flight::{STAGES, files, flight, run};
use wavex_testkit::{Outcome, TestFolder};

const KILLS: u32 = 24;

/// A survey of three strips, not yet run.
fn survey() -> TestFolder {
    let place = flight();
    for stem in ["b", "c"] {
        fs::copy(place.path("in/a.arrow"), place.path(&format!("in/{stem}.arrow"))).unwrap();
    }
    place.write("job.toml", format!("[job]\noutput_dir = 'out'\nthreads = 2\n{STAGES}").as_bytes());
    place
}

/// Outputs, without files about the run.
fn products(place: &TestFolder) -> BTreeMap<String, Vec<u8>> {
    let mut files = files(&place.path("out"));
    files.retain(|name, _| !name.starts_with('.') && !name.ends_with(".log") && name != "job_report.json");
    files
}

/// The report without times and memory, which differ between runs.
fn report(place: &TestFolder) -> Value {
    fn strip(value: &mut Value) {
        let volatile =
            ["started", "ended", "wall_s", "working_s", "waiting_s", "blocked_s", "line_us", "modified_s"];
        match value {
            Value::Object(table) => {
                table.retain(|key, _| !volatile.contains(&key.as_str()) && key != "peak_in_flight_bytes");
                table.values_mut().for_each(strip);
            }
            Value::Array(items) => items.iter_mut().for_each(strip),
            _ => {}
        }
    }
    let mut report = serde_json::from_str(&place.text("out/job_report.json")).unwrap();
    strip(&mut report);
    report
}

fn spawn(place: &TestFolder) -> Child {
    let mut command = wavex_testkit::wavex();
    command.args(["--quiet", "run", "job.toml", "--resume"]).current_dir(place.path(""));
    command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap()
}

/// Messages of a resumed run about its inputs.
#[track_caller]
fn resumed(place: &TestFolder, arguments: &[&str]) -> Vec<String> {
    let all = [&["run", "job.toml", "--progress", "never"], arguments].concat();
    let Outcome { code, err, .. } = place.wavex(&all);
    assert_eq!(code, Some(0), "{err}");
    err.lines()
        .filter(|line| line.contains("skipped"))
        .filter(|line| line.contains(": "))
        .map(str::to_owned)
        .collect()
}

const COMPLETE: &str = "skipped, its outputs are complete";

/// The messages if only this input is run again.
fn only(stem: &str, reason: &str) -> Vec<String> {
    let message = |other: &str| match other == stem {
        true => format!("{other}: not skipped: {reason}"),
        false => format!("{other}: {COMPLETE}"),
    };
    ["a", "b", "c"].map(message).to_vec()
}

/// The messages if all inputs are run again.
fn none(reason: &str) -> Vec<String> {
    ["a", "b", "c"].map(|stem| format!("{stem}: not skipped: {reason}")).to_vec()
}

#[test]
fn a_run_killed_at_any_moment_and_resumed_gives_the_bytes_of_an_undisturbed_one() {
    let place = survey();
    let started = Instant::now();
    assert_eq!(run(&place, &[]), Outcome::success());
    let duration = started.elapsed();
    let (whole, whole_report) = (products(&place), report(&place));
    assert_eq!(whole.len(), 15);
    let (mut killed, mut skipped, mut random) = (0, 0, 54321u64);
    for attempt in 0..KILLS {
        if attempt % 3 == 0 {
            fs::remove_dir_all(place.path("out")).unwrap();
        }
        // Constants of Knuth's MMIX generator.
        random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let mut child = spawn(&place);
        std::thread::sleep(duration.mul_f64((random >> 40) as f64 / f64::from(1 << 24)));
        child.kill().unwrap();
        killed += u32::from(child.wait().unwrap().code().is_none());
        for (name, bytes) in products(&place) {
            assert!(whole[&name] == bytes, "{name} is not complete");
        }
        if attempt % 3 == 2 {
            skipped += resumed(&place, &["--resume"]).iter().filter(|line| line.ends_with(COMPLETE)).count();
            assert!(products(&place) == whole, "attempt {attempt}");
            assert_eq!(report(&place), whole_report, "attempt {attempt}");
        }
    }
    println!("{killed} of {KILLS} runs were killed; {skipped} inputs were skipped");
    assert!(killed > 0);
}

/// Killed after its first input, which the report then has.
#[test]
fn finished_inputs_of_a_killed_run_are_skipped() {
    let place = survey();
    assert_eq!(run(&place, &[]), Outcome::success());
    let (whole, whole_report) = (products(&place), report(&place));
    fs::remove_dir_all(place.path("out")).unwrap();
    let mut child = spawn(&place);
    let started = Instant::now();
    while !place.path("out/job_report.json").exists() {
        assert!(started.elapsed() < Duration::from_secs(60), "no report was written");
        std::thread::sleep(Duration::from_millis(1));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    let messages = resumed(&place, &["--resume"]);
    assert_eq!(messages[0], format!("a: {COMPLETE}"), "{messages:?}");
    assert!(products(&place) == whole);
    assert_eq!(report(&place), whole_report);
}

#[test]
fn the_folder_of_the_inputs_does_not_matter() {
    let place = survey();
    let job = format!("[job]\ninput_dir = '..'\noutput_dir = '../out'\nthreads = 2\n{STAGES}");
    fs::create_dir(place.path("jobs")).unwrap();
    place.write("jobs/job.toml", job.as_bytes());
    let resume = || {
        let Outcome { code, err, .. } =
            place.wavex(&["run", "jobs/job.toml", "--progress", "never", "--resume"]);
        assert_eq!(code, Some(0), "{err}");
        err.lines().filter(|line| line.contains("skipped")).map(str::to_owned).collect::<Vec<_>>()
    };
    assert_eq!(resume(), none("there is no report of an earlier run"));
    assert_eq!(resume(), ["a", "b", "c"].map(|stem| format!("{stem}: {COMPLETE}")));
    let file = File::options().append(true).open(place.path("in/b.arrow")).unwrap();
    file.set_modified(SystemTime::now()).unwrap();
    let again = resume();
    assert!(
        again[1].starts_with("b: not skipped: ") && again[1].ends_with("b.arrow was changed"),
        "{again:?}"
    );
    assert!(again[0].ends_with(COMPLETE) && again[2].ends_with(COMPLETE), "{again:?}");
}

#[test]
fn what_is_complete_is_skipped_and_what_was_changed_is_not() {
    let place = survey();
    assert_eq!(resumed(&place, &["--resume"]), none("there is no report of an earlier run"));
    let (whole, whole_report) = (products(&place), report(&place));
    let time = |name: &str| fs::metadata(place.path(name)).unwrap().modified().unwrap();
    let before = [time("out/b.laz"), time("out/job_report.json")];
    assert_eq!(resumed(&place, &["--resume"]), ["a", "b", "c"].map(|stem| format!("{stem}: {COMPLETE}")));
    assert_eq!([time("out/b.laz"), time("out/job_report.json")], before, "nothing was written");
    // Keys that do not affect outputs may differ.
    assert!(resumed(&place, &["--resume", "--threads", "1"])[0].ends_with(COMPLETE));

    fs::remove_file(place.path("out/b.csv")).unwrap();
    assert_eq!(resumed(&place, &["--resume"]), only("b", "b.csv is missing"));
    place.write("out/c.csv", b"mine");
    assert_eq!(resumed(&place, &["--resume"]), only("c", "c.csv was changed"));
    File::options()
        .append(true)
        .open(place.path("in/a.arrow"))
        .unwrap()
        .set_modified(SystemTime::now())
        .unwrap();
    assert_eq!(resumed(&place, &["--resume"]), only("a", "in/a.arrow was changed"));
    assert!(products(&place) == whole);
    assert_eq!(report(&place), whole_report);

    let model = place.text("in/model.json");
    place.write("in/model.json", format!("{model}\n").as_bytes());
    assert_eq!(resumed(&place, &["--resume"]), none("in/model.json was changed"));
    let keys = ["--resume", "--set", "decompose.detection_sigma=6"];
    assert_eq!(resumed(&place, &keys), none("`detection_sigma` of `decompose` was different"));
    assert_eq!(resumed(&place, &["--resume"]), none("`detection_sigma` of `decompose` was different"));
    let memory = ["--resume", "--set", "job.memory_mb=500"];
    assert_eq!(resumed(&place, &memory), none("`memory_mb` of `[job]` was different"));
    assert_eq!(resumed(&place, &["--resume"]).len(), 3);

    let text = place.text("out/job_report.json");
    let version = format!("\"wavex\": \"{}\"", env!("CARGO_PKG_VERSION"));
    place.write("out/job_report.json", text.replacen(&version, "\"wavex\": \"0.0.7\"", 1).as_bytes());
    assert_eq!(resumed(&place, &["--resume"]), none("the earlier run was made by wavex 0.0.7"));
    let mut other: Value = serde_json::from_str(&place.text("out/job_report.json")).unwrap();
    other["commit"] = "0ther".into();
    place.write("out/job_report.json", other.to_string().as_bytes());
    assert_eq!(resumed(&place, &["--resume"]), none("the earlier run was made by wavex of commit 0ther"));
    place.write(
        "job.toml",
        place.text("job.toml").replace("[[stage]]\ntype = 'write_lstat'\n", "").as_bytes(),
    );
    assert_eq!(resumed(&place, &["--resume"]), none("the stages were different"));
    place.write("out/job_report.json", b"{}");
    let damaged = resumed(&place, &["--resume"]);
    assert!(damaged[0].contains("not skipped: ./out/job_report.json: not a report of a run"), "{damaged:?}");
}

#[test]
fn digests_recognise_files_that_were_only_touched() {
    let place = survey();
    assert_eq!(run(&place, &[]), Outcome::success());
    let digest = ["--resume=digest"];
    let untaken =
        |stem: &str| format!("{stem}: not skipped: the earlier run took no digest of in/{stem}.arrow");
    assert_eq!(resumed(&place, &digest), ["a", "b", "c"].map(untaken));
    for name in ["in/a.arrow", "in/model.json", "out/a.laz"] {
        let file = File::options().append(true).open(place.path(name)).unwrap();
        file.set_modified(SystemTime::now()).unwrap();
    }
    assert_eq!(resumed(&place, &digest), ["a", "b", "c"].map(|stem| format!("{stem}: {COMPLETE}")));
    // Same size and time, other content.
    let modified = fs::metadata(place.path("out/b.csv")).unwrap().modified().unwrap();
    let mut bytes = fs::read(place.path("out/b.csv")).unwrap();
    bytes[0] ^= 1;
    place.write("out/b.csv", &bytes);
    let file = File::options().append(true).open(place.path("out/b.csv")).unwrap();
    file.set_modified(modified).unwrap();
    assert_eq!(resumed(&place, &digest), only("b", "b.csv was changed"));
}

#[test]
fn failed_and_new_inputs_are_run() {
    let place = survey();
    let whole = fs::read(place.path("in/b.arrow")).unwrap();
    place.write("in/b.arrow", b"ARROW1");
    fs::rename(place.path("in/c.arrow"), place.path("c.arrow")).unwrap();
    assert_eq!(run(&place, &[]).code, Some(1));
    place.write("in/b.arrow", &whole);
    fs::rename(place.path("c.arrow"), place.path("in/c.arrow")).unwrap();
    let expected = [
        format!("a: {COMPLETE}"),
        "b: not skipped: it failed in the earlier run".to_owned(),
        "c: not skipped: it was no input of the earlier run".to_owned(),
    ];
    assert_eq!(resumed(&place, &["--resume"]), expected);
    assert_eq!(products(&place).len(), 15);
}

/// Points have the number of their strip in the job, unless `point_source_id` says otherwise.
#[test]
fn a_strip_with_another_number_is_run_again() {
    let place = survey();
    let alone = ["--set", "read_arrow.path=in/b.arrow"];
    assert_eq!(run(&place, &alone), Outcome::success());
    let message = "b: not skipped: its flight line was number 1, and is 2; numbers of `point_source_id = \"name\"` do not \
                   depend on the other inputs";
    assert_eq!(resumed(&place, &["--resume"])[1], message);
    let numbered = ["--set", "write_las.point_source_id=7"];
    assert_eq!(run(&place, &[alone, numbered].concat()), Outcome::success());
    assert_eq!(resumed(&place, &[&["--resume"][..], &numbered].concat())[1], format!("b: {COMPLETE}"));
}

#[test]
fn a_run_that_stopped_is_resumed_where_it_stopped() {
    let place = survey();
    let whole = fs::read(place.path("in/b.arrow")).unwrap();
    place.write("in/b.arrow", b"ARROW1");
    assert_eq!(run(&place, &["--set", "job.on_error=stop"]).code, Some(1));
    place.write("in/b.arrow", &whole);
    let messages = resumed(&place, &["--resume"]);
    assert_eq!(messages[2], "c: not skipped: the earlier run ended before it");
    let log = place.text("out/job.log");
    assert!(log.contains(&format!("INFO a: {COMPLETE}\n")), "{log}");
}

#[test]
fn resuming_needs_a_report_and_makes_no_archive() {
    let place = survey();
    let problem = "error: --resume reads the report of the earlier run, but this job writes none; \
                   set `report` in `[job]`\n";
    assert_eq!(run(&place, &["--resume", "--set", "job.report=''"]), Outcome::failure(2, problem));
    let Outcome { code, err, .. } = run(&place, &["--resume", "--archive", "archive"]);
    assert_eq!(code, Some(2));
    assert!(err.contains("'--resume[=<CHECK>]' cannot be used with '--archive <ARCHIVE>'"), "{err}");
}

#[test]
fn an_output_on_standard_output_is_written_again() {
    let place = survey();
    let job = "[job]\noutput_dir = 'out'\n[[stage]]\ntype = 'read_arrow'\npath = 'in/a.arrow'\n\
               [[stage]]\ntype = 'write_arrow'\npath = '-'\n";
    place.write("job.toml", job.as_bytes());
    for reason in ["there is no report of an earlier run", "an output goes to standard output"] {
        let mut command = wavex_testkit::wavex();
        command.args(["--quiet", "run", "job.toml", "--resume"]).current_dir(place.path(""));
        let output = command.output().unwrap();
        assert!(output.status.success() && output.stdout.len() > 1000);
        let log = place.text("out/job.log");
        assert!(log.contains(&format!("INFO a: not skipped: {reason}\n")), "{log}");
    }
}

#[test]
fn a_report_that_names_no_outputs_is_not_believed() {
    let place = survey();
    assert_eq!(run(&place, &[]), Outcome::success());
    let mut report: Value = serde_json::from_str(&place.text("out/job_report.json")).unwrap();
    report["inputs"][1]["files"]["written"] = Value::Array(Vec::new());
    place.write("out/job_report.json", report.to_string().as_bytes());
    let messages = resumed(&place, &["--resume"]);
    let expected = "b: not skipped: the earlier report does not name its output ";
    assert!(messages[1].starts_with(expected), "{messages:?}");
    assert!([0, 2].iter().all(|&other| messages[other].ends_with(COMPLETE)), "{messages:?}");
}
