//! Runs over several inputs: one that fails costs nothing but its own outputs.

use std::fs;
use std::io::Write;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;
use wavex_testkit::las::Las;
use wavex_testkit::{Outcome, TestFolder, outcome, program};

const COPY: &str = "[[stage]]\ntype = 'read_las'\npath = '*.las'\n[[stage]]\ntype = 'write_arrow'\n";

/// Three strips; the second one is damaged.
fn strips() -> TestFolder {
    let las = Las::new(3);
    TestFolder::with(&[
        ("a.las", &las.las()),
        ("a.wdp", &las.packets),
        ("b.las", b"LASF"),
        ("c.las", &las.las()),
        ("c.wdp", &las.packets),
    ])
}

/// The reason why `b.las` fails.
const CUT_OFF: &str = "stage read_las: b.las: byte 4: file source ID: 2 bytes needed, 0 left; \
                       the file is cut off: copy it again from its source";

fn report(place: &TestFolder) -> Value {
    serde_json::from_str(&place.text("out/job_report.json")).unwrap()
}

/// Stem, status and reason of each input in the report.
fn inputs(report: &Value) -> Vec<[String; 3]> {
    let word = |value: &Value| value.as_str().unwrap_or_default().to_owned();
    let inputs = report["inputs"].as_array().unwrap().iter();
    inputs.map(|input| [word(&input["stem"]), word(&input["status"]), word(&input["failure"])]).collect()
}

fn row(name: &str, value: &str) -> String {
    format!("{name:<36} {value}\n")
}

#[test]
fn a_bad_input_costs_only_its_own_outputs() {
    let place = strips();
    let failed = format!("error: {CUT_OFF}\nerror: 1 of 3 inputs failed: b\n");
    let mut command = place.command(COPY);
    command.args(["--set", "job.report_page=true"]);
    assert_eq!(outcome(&mut command), Outcome::failure(1, failed));
    let expected = [
        "a.arrow",
        "a_stat.log",
        "b_stat.log",
        "c.arrow",
        "c_stat.log",
        "job_report.html",
        "job_report.json",
    ];
    assert_eq!(place.outputs(), expected);
    assert_eq!(inputs(&report(&place)), [["a", "done", ""], ["b", "failed", CUT_OFF], ["c", "done", ""]]);
    let page = place.text("out/job_report.html");
    for (stem, status) in [("a", "done"), ("b", "failed"), ("c", "done")] {
        let row = page.split("<tr>").find(|row| row.contains(&format!(">{stem}</a>"))).unwrap();
        assert!(row.contains(&format!("<td>{status}</td>")), "{stem}: {row}");
    }
    for (name, exit, file) in [("a", "0, success", "a.las"), ("b", "1, failed", "b.las")] {
        let statistics = place.text(&format!("out/{name}_stat.log"));
        let rows = [row("exit status", exit), row("file", file)];
        assert!(rows.iter().all(|row| statistics.contains(row)), "{rows:?} {statistics}");
    }
    assert!(place.text("out/b_stat.log").contains(&row("failure", CUT_OFF)));
    let log = place.text("out/job.log");
    assert!(log.contains(&format!("ERROR {CUT_OFF}\n")), "{log}");
    assert!(log.contains("ERROR 1 of 3 inputs failed: b\n"), "{log}");

    // The bytes are those of a run without the bad input.
    let [a, c] = ["out/a.arrow", "out/c.arrow"].map(|name| fs::read(place.path(name)).unwrap());
    fs::remove_file(place.path("b.las")).unwrap();
    assert_eq!(place.run(COPY), Outcome::success());
    assert!(fs::read(place.path("out/a.arrow")).unwrap() == a);
    assert!(fs::read(place.path("out/c.arrow")).unwrap() == c);
}

#[test]
fn a_missing_input_costs_only_its_own_outputs() {
    let place = strips();
    let job = COPY.replace("'*.las'", "['a.las', 'other.las', 'c.las']");
    let missing =
        "stage read_las: ./other.las: cannot open: No such file or directory (os error 2); check the path";
    let failed = format!("error: {missing}\nerror: 1 of 3 inputs failed: other\n");
    assert_eq!(place.run(&job), Outcome::failure(1, failed));
    assert_eq!(place.products(), ["a.arrow", "c.arrow"]);
}

#[test]
fn the_end_of_a_run_is_a_table_of_its_inputs() {
    let place = strips();
    place.write("job.toml", format!("[job]\noutput_dir = 'out'\n{COPY}").as_bytes());
    let Outcome { code, out, .. } = place.wavex(&["run", "job.toml", "--progress", "never"]);
    assert_eq!(code, Some(1));
    let rows: Vec<Vec<&str>> = out.lines().take(4).map(|row| row.split_whitespace().collect()).collect();
    assert_eq!(rows[0], ["input", "status", "points", "time", "s", "reason"]);
    let begin = |row: usize| rows[row][..3].to_vec();
    assert_eq!(
        [begin(1), begin(2), begin(3)],
        [["a", "done", "0"], ["b", "failed", "0"], ["c", "done", "0"]]
    );
    assert!(rows[2][4..].join(" ") == CUT_OFF, "{out}");
}

#[test]
fn a_run_may_stop_at_the_first_bad_input() {
    let place = strips();
    // Others that run at the same time may complete.
    let stopping = format!("on_error = 'stop'\ninputs_at_once = 1\n{COPY}");
    assert_eq!(place.run(&stopping), Outcome::failure(1, format!("error: {CUT_OFF}\n")));
    assert_eq!(place.outputs(), ["a.arrow", "a_stat.log", "b_stat.log", "job_report.json"]);
    assert_eq!(inputs(&report(&place)), [["a", "done", ""], ["b", "failed", CUT_OFF], ["c", "not_run", ""]]);
    let log = place.text("out/job.log");
    assert!(log.contains(&format!("ERROR {CUT_OFF}\n")), "{log}");
}

#[test]
fn a_file_that_all_inputs_need_ends_the_run() {
    let place = strips();
    let job = COPY.replace(
        "[[stage]]\ntype = 'write",
        "[[stage]]\ntype = 'calibrate'\nload = 'm.json'\n[[stage]]\ntype = 'write",
    );
    // Others that run at the same time would report their own errors.
    let Outcome { code, err, .. } = place.run(&format!("inputs_at_once = 1\n{job}"));
    assert_eq!(code, Some(1));
    assert!(err.starts_with("error: stage calibrate: ./m.json: cannot "), "{err}");
    assert_eq!(err.lines().count(), 1, "{err}");
    let statuses: Vec<String> = inputs(&report(&place)).into_iter().map(|[_, status, _]| status).collect();
    assert_eq!(statuses, ["failed", "not_run", "not_run"]);
    assert_eq!(place.products(), Vec::<String>::new());
}

#[cfg(unix)]
#[test]
fn a_full_disk_ends_the_run() {
    let las = Las::new(1000);
    let files = ["a", "c"]
        .map(|stem| [(format!("{stem}.las"), las.las()), (format!("{stem}.wdp"), las.packets.clone())]);
    let place = strips();
    files.into_iter().flatten().for_each(|(name, bytes)| place.write(&name, &bytes));
    place.write("job.toml", format!("[job]\noutput_dir = 'out'\ninputs_at_once = 1\n{COPY}").as_bytes());
    // A limit on file size in blocks of 512 bytes: writing fails as on a full disk.
    let mut command = Command::new("sh");
    command.args(["-c", "trap '' XFSZ; ulimit -f 16; exec \"$0\" --quiet run job.toml"]);
    let Outcome { code, err, .. } = outcome(command.arg(program()).current_dir(place.path("")));
    let message = "error: stage write_arrow: ./out/a.arrow: cannot write: File too large (os error 27); \
                   free some space, or write to another disk\n";
    assert_eq!((code, err.as_str()), (Some(1), message));
    assert!(!place.path("out/b_stat.log").exists(), "no other input is tried");
    assert_eq!(place.products(), Vec::<String>::new());
}

#[cfg(unix)]
#[test]
fn an_interruption_ends_the_run() {
    let place = TestFolder::new();
    let make = "[[stage]]\ntype = 'simulate'\nstem = 'a'\nlines = 400\nshots_per_line = 200\n\
                [[stage]]\ntype = 'write_arrow'\npath = '../in/*.arrow'\n";
    assert_eq!(place.run(make), Outcome::success());
    fs::remove_dir_all(place.path("out")).unwrap();
    fs::copy(place.path("in/a.arrow"), place.path("in/b.arrow")).unwrap();
    let job = "[[stage]]\ntype = 'read_arrow'\npath = 'in/*.arrow'\n[[stage]]\ntype = 'calibrate'\n\
               [[stage]]\ntype = 'decompose'\n[[stage]]\ntype = 'write_table'\npath = '*.csv'\n";
    let mut child = place.command(job).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    let is_begun = |name: &String| name.starts_with(".a.csv.");
    while !place.outputs().iter().any(is_begun) {
        assert_eq!(child.try_wait().unwrap(), None, "the run ended before it was interrupted");
        std::thread::sleep(Duration::from_millis(1));
    }
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    let output = child.wait_with_output().unwrap();
    assert_eq!(
        String::from_utf8(output.stderr).unwrap(),
        "error: interrupted; unfinished outputs were removed\n"
    );
    let statuses: Vec<String> = inputs(&report(&place)).into_iter().map(|[_, status, _]| status).collect();
    assert_eq!(statuses, ["failed", "not_run"]);
    assert_eq!(place.products(), Vec::<String>::new());
}

/// The last input is standard input, which holds the run until the test ends it.
#[test]
fn the_report_is_written_after_each_input() {
    let place = strips();
    assert_eq!(place.run(&COPY.replace("*.las", "a.las")), Outcome::success());
    fs::rename(place.path("out/a.arrow"), place.path("a.arrow")).unwrap();
    fs::remove_dir_all(place.path("out")).unwrap();
    place.write("b.arrow", b"ARROW1");
    let job = "[job]\noutput_dir = 'out'\n[[stage]]\ntype = 'read_arrow'\npath = ['a.arrow', 'b.arrow', '-']\n\
               [[stage]]\ntype = 'write_lstat'\n";
    place.write("job.toml", job.as_bytes());
    let mut command = wavex_testkit::wavex();
    command.args(["--quiet", "run", "job.toml"]).current_dir(place.path(""));
    command.stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::null());
    let mut child = command.spawn().unwrap();
    let started = Instant::now();
    let statuses = || {
        let report: Value =
            serde_json::from_slice(&fs::read(place.path("out/job_report.json")).ok()?).unwrap();
        Some(inputs(&report).into_iter().map(|[_, status, _]| status).collect::<Vec<_>>())
    };
    while statuses().is_none_or(|statuses| statuses != ["done", "failed", "not_run"]) {
        assert!(started.elapsed() < Duration::from_secs(60), "the report is not written: {:?}", statuses());
        std::thread::sleep(Duration::from_millis(5));
    }
    assert!(place.path("out/a_stat.log").exists() && place.path("out/b_stat.log").exists());
    child.stdin.take().unwrap().write_all(&fs::read(place.path("a.arrow")).unwrap()).unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(1));
    assert_eq!(statuses().unwrap(), ["done", "failed", "done"]);
}

#[test]
fn the_progress_of_a_survey_is_one_json_object_per_line() {
    let place = strips();
    place.write("job.toml", format!("[job]\noutput_dir = 'out'\n{COPY}").as_bytes());
    let Outcome { code, err, .. } = place.wavex(&["run", "job.toml", "--progress=json"]);
    assert_eq!(code, Some(1));
    let (objects, others): (Vec<&str>, Vec<&str>) = err.lines().partition(|line| line.starts_with('{'));
    assert_eq!(others, [format!("error: {CUT_OFF}"), "error: 1 of 3 inputs failed: b".to_owned()]);
    let objects: Vec<Value> = objects.into_iter().map(|line| serde_json::from_str(line).unwrap()).collect();
    let first = &objects[0];
    assert_eq!((&first["input"], &first["number"], &first["inputs"]), (&"a".into(), &1.into(), &3.into()));
    assert_eq!((first["fraction"].as_f64(), &first["left_s"]), (Some(0.0), &Value::Null));
    let last = objects.last().unwrap();
    assert_eq!((&last["done"], &last["failed"], &last["shots"]), (&2.into(), &1.into(), &6.into()));
    assert_eq!((last["fraction"].as_f64(), last["left_s"].as_f64()), (Some(1.0), Some(0.0)));
}
