//! Killed runs: only complete files have final names, and the next run needs no manual cleanup.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use wavex_testkit::flight::{OUTPUTS, STAGES, files, flight, run, wavex};
use wavex_testkit::{Outcome, TestFolder};

const KILLS: u32 = 50;

/// A flight with its job, and the expected outputs.
fn place() -> (TestFolder, BTreeMap<String, Vec<u8>>) {
    let place = flight();
    place.write("job.toml", format!("[job]\noutput_dir = 'out'\nthreads = 2\n{STAGES}").as_bytes());
    assert_eq!(run(&place, &[]), Outcome::success());
    let whole = products(&place);
    assert_eq!(whole.keys().collect::<Vec<_>>(), OUTPUTS.iter().collect::<Vec<_>>());
    (place, whole)
}

/// Files with final names in the output folder, except log and report.
fn products(place: &TestFolder) -> BTreeMap<String, Vec<u8>> {
    let mut files = files(&place.path("out"));
    let is_about_the_run =
        |name: &String| ["job.log", "job_report.json", "a_stat.log"].contains(&name.as_str());
    files.retain(|name, _| !name.starts_with('.') && !is_about_the_run(name));
    files
}

/// Asserts that all files with final names are complete.
fn is_whole(place: &TestFolder, whole: &BTreeMap<String, Vec<u8>>) {
    for (name, bytes) in products(place) {
        assert!(whole[&name] == bytes, "{name} is not complete");
    }
    if let Ok(report) = fs::read(place.path("out/job_report.json")) {
        serde_json::from_slice::<serde_json::Value>(&report).expect("a report is complete");
    }
}

/// All names in a folder.
fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).into_iter().flatten().map(Result::unwrap);
    let mut names: Vec<String> = entries.map(|entry| entry.file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

/// Removes finished files from a folder; with `all`, also unfinished ones.
fn clear(folder: &Path, all: bool) {
    for name in names(folder).iter().filter(|name| all || !name.starts_with('.')) {
        fs::remove_file(folder.join(name)).unwrap();
    }
}

fn spawn(place: &TestFolder, arguments: &[&str]) -> Child {
    let mut command = wavex_testkit::wavex();
    command.args(["--quiet", "run", "job.toml"]).args(arguments).current_dir(place.path(""));
    command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap()
}

#[test]
fn a_run_killed_at_any_moment_leaves_whole_files_only() {
    let (place, whole) = place();
    let started = Instant::now();
    assert_eq!(run(&place, &["--archive", "archives/first"]), Outcome::success());
    let duration = started.elapsed();
    let (mut killed, mut begun, mut random) = (0, 0, 12345u64);
    for attempt in 0..KILLS {
        clear(&place.path("out"), attempt % 2 == 0);
        // Constants of Knuth's MMIX generator.
        random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let mut child = spawn(&place, &["--archive", &format!("archives/{attempt}")]);
        std::thread::sleep(duration.mul_f64((random >> 40) as f64 / f64::from(1 << 24)));
        child.kill().unwrap();
        killed += u32::from(child.wait().unwrap().code().is_none());
        let own = format!(".{}.partial", child.id());
        begun += u32::from(names(&place.path("out")).iter().any(|name| name.ends_with(&own)));
        is_whole(&place, &whole);
    }
    println!("{killed} of {KILLS} runs were killed, the others had ended; {begun} left unfinished files");
    assert!(killed > 0);
    for name in names(&place.path("archives")).iter().filter(|name| !name.starts_with('.')) {
        let archive = format!("archives/{name}");
        // The next attempt may have removed its outputs; the archive itself is sealed.
        let (_, err) = wavex(&place, &["verify", &archive]);
        assert!(err.lines().skip(1).all(|line| line.trim_start().starts_with("output ")), "{err}");
    }

    assert_eq!(run(&place, &["--archive", "archives/last"]), Outcome::success());
    assert!(products(&place) == whole, "the next run makes all outputs");
    assert_eq!(wavex(&place, &["verify", "archives/last"]), (Some(0), String::new()));
    let unfinished = |folder: &str| {
        names(&place.path(folder)).into_iter().filter(|name| name.starts_with('.')).collect::<Vec<_>>()
    };
    assert_eq!(unfinished("archives"), Vec::<String>::new(), "remains of dead runs are removed");
    assert_eq!(unfinished("out"), Vec::<String>::new());
}

#[test]
fn leavings_of_killed_runs_are_swept_up_by_the_next() {
    let (place, whole) = place();
    for attempt in 0..3 {
        let mut child = spawn(&place, &["--archive", &format!("archives/{attempt}")]);
        wait_for(|| names(&place.path("out")).iter().any(|name| name.ends_with(".partial")));
        child.kill().unwrap();
        child.wait().unwrap();
    }
    let mut expected: Vec<String> =
        whole.keys().cloned().chain(["a_stat.log", "job_report.json", "job.log"].map(String::from)).collect();
    expected.sort();
    assert_ne!(names(&place.path("out")), expected, "a killed run leaves its unfinished files");
    assert_eq!(run(&place, &["--archive", "archives/last"]), Outcome::success());
    assert_eq!(names(&place.path("out")), expected);
    assert!(products(&place) == whole);
    assert_eq!(names(&place.path("archives")).last().map(String::as_str), Some("last"));
    assert!(names(&place.path("archives")).iter().all(|name| !name.starts_with('.')));
}

/// Waits for a condition that becomes true eventually.
fn wait_for(mut so: impl FnMut() -> bool) {
    let started = Instant::now();
    while !so() {
        assert!(started.elapsed() < Duration::from_secs(60), "the condition never became true");
        std::thread::sleep(Duration::from_millis(1));
    }
}

#[test]
fn a_full_disk_leaves_whole_files_only() {
    let (place, whole) = place();
    let largest = whole.values().map(Vec::len).max().unwrap() / 512 + 1;
    let mut failed = 0;
    for blocks in [1, 20, largest / 4, largest / 2, largest - 1, 10 * largest] {
        fs::remove_dir_all(place.path("out")).unwrap();
        // A limit on file size in blocks of 512 bytes: writing fails as on a full disk.
        let mut command = Command::new("sh");
        command.args([
            "-c",
            &format!("ulimit -f {blocks}; exec \"$0\" --quiet run job.toml --archive archives/{blocks}"),
        ]);
        let output = command.arg(wavex_testkit::program()).current_dir(place.path("")).output().unwrap();
        let err = String::from_utf8(output.stderr).unwrap();
        is_whole(&place, &whole);
        if output.status.code() == Some(0) {
            assert!(products(&place) == whole);
        } else {
            failed += 1;
            assert_eq!(output.status.code(), Some(1), "{err}");
            assert!(err.contains("free some space, or write to another disk"), "{err}");
            assert!(!place.path(&format!("archives/{blocks}")).exists());
            assert!(
                names(&place.path("out")).iter().all(|name| !name.ends_with(".partial")),
                "a run that fails cleans up"
            );
        }
    }
    assert!(failed >= 3, "{failed} of 6 runs ran out of disk space");
    assert_eq!(run(&place, &[]), Outcome::success());
    assert!(products(&place) == whole);
}

/// A job that runs for a while: many lines, written as they arrive.
const LONG: &str = "[job]\noutput_dir = 'out'\n[[stage]]\ntype = 'simulate'\nlines = 4000\nshots_per_line = 200\n\
                    [[stage]]\ntype = 'write_arrow'\n";

#[test]
fn a_folder_that_is_removed_under_a_run_leaves_nothing_and_says_so() {
    let place = TestFolder::new();
    place.write("job.toml", LONG.replace("lines = 4000", "lines = 60").as_bytes());
    let mut command = wavex_testkit::wavex();
    command.args(["--quiet", "run", "job.toml"]).current_dir(place.path("")).stderr(Stdio::piped());
    let child = command.spawn().unwrap();
    let is_begun = |name: &String| name.starts_with(".simulated.arrow.");
    wait_for(|| names(&place.path("out")).iter().any(is_begun));
    wait_for(|| fs::remove_dir_all(place.path("out")).is_ok());
    let output = child.wait_with_output().unwrap();
    let err = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{err}");
    assert!(err.contains("simulated.arrow: cannot rename to the final name: "), "{err}");
    assert_eq!(names(&place.path("out")), Vec::<String>::new());
    assert_eq!(run(&place, &[]), Outcome::success());
    assert_eq!(
        names(&place.path("out")),
        ["job.log", "job_report.json", "simulated.arrow", "simulated_stat.log"]
    );
}

#[test]
fn a_second_run_on_the_same_outputs_is_refused_while_the_first_lives() {
    let place = TestFolder::new();
    place.write("job.toml", LONG.as_bytes());
    let mut first = spawn(&place, &[]);
    wait_for(|| names(&place.path("out")).iter().any(|name| name.starts_with(".simulated.arrow.")));
    let shorter = ["--set", "simulate.lines=1"];
    let second = run(&place, &shorter);
    assert_eq!(second.code, Some(1), "{}", second.err);
    let process = first.id();
    let problem = format!(
        "error: ./out/simulated_stat.log is being written by another run (process {process}); wait until it ends, or choose another folder with `output_dir`\n"
    );
    assert_eq!(second.err, problem);
    // Without statistics, both runs conflict on the output itself.
    let silent = run(&place, &[&shorter[..], &["--set", "job.stat_log=''"]].concat());
    assert!(silent.err.contains("out/simulated.arrow is being written by another run"), "{}", silent.err);
    // Other runs succeed: to another folder, and to this folder under another name.
    assert_eq!(
        run(&place, &[&shorter[..], &["--set", "job.output_dir=elsewhere"]].concat()),
        Outcome::success()
    );
    let other_names = [
        "--set",
        "job.report='b.json'",
        "--set",
        "job.log='b.log'",
        "--set",
        "job.stat_log=''",
        "--set",
        "write_arrow.path='b.arrow'",
    ];
    assert_eq!(run(&place, &[&shorter[..], &other_names].concat()), Outcome::success());
    first.kill().unwrap();
    first.wait().unwrap();
    assert_eq!(run(&place, &shorter), Outcome::success(), "a killed run holds no lock");
    let expected = [
        "b.arrow",
        "b.json",
        "b.log",
        "job-2.log",
        "job.log",
        "job_report.json",
        "simulated.arrow",
        "simulated_stat.log",
    ];
    assert_eq!(names(&place.path("out")), expected);
}

#[test]
fn runs_over_other_inputs_do_not_block_each_other() {
    let place = TestFolder::new();
    place.write("job.toml", LONG.as_bytes());
    place.write("other.toml", LONG.as_bytes());
    let mut first = spawn(&place, &[]);
    wait_for(|| names(&place.path("out")).iter().any(|name| name.starts_with(".simulated.arrow.")));
    let of = |job: &str, stem: &str| {
        let stem = format!("simulate.stem={stem}");
        place.wavex(&["--quiet", "run", job, "--set", "simulate.lines=1", "--set", &stem])
    };
    assert_eq!(of("other.toml", "b"), Outcome::success(), "another job");
    assert_eq!(of("job.toml", "c"), Outcome::success(), "the same job");
    first.kill().unwrap();
    first.wait().unwrap();
    assert_eq!(of("job.toml", "d"), Outcome::success(), "the killed run has left its name");
    let mut expected: Vec<String> = ["b", "c", "d"]
        .iter()
        .flat_map(|stem| [format!("{stem}.arrow"), format!("{stem}_stat.log")])
        .collect();
    for name in ["job", "job-2", "other"] {
        expected.extend([format!("{name}.log"), format!("{name}_report.json")]);
    }
    expected.sort();
    let partial = |name: &String| name.starts_with('.');
    let found: Vec<String> = names(&place.path("out")).into_iter().filter(|name| !partial(name)).collect();
    assert_eq!(found, expected);
    let stem_in = |report: &str| -> serde_json::Value {
        let report: serde_json::Value = serde_json::from_str(&place.text(&format!("out/{report}"))).unwrap();
        report["inputs"][0]["stem"].clone()
    };
    assert_eq!(["other_report.json", "job-2_report.json", "job_report.json"].map(stem_in), ["b", "c", "d"]);
}
