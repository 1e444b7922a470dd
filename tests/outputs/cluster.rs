//! `wavex plan` and `wavex collect`: tasks run one by one give the results of one run.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::time::{Duration, Instant};

use serde_json::Value;
use wavex_testkit::flight::{files, wavex};
use wavex_testkit::{Outcome, TestFolder};

const MAKE: &str = "[job]\nreport = ''\nlog = ''\nstat_log = ''\n\
[[stage]]\ntype = 'simulate'\nstem = 'a'\nlines = 6\nshots_per_line = 60\n\
[[stage]]\ntype = 'write_arrow'\npath = 'in/*.arrow'\n";

const SURVEY: &str = "[job]\noutput_dir = 'out'\nthreads = 2\nreport_page = true\n\
[[stage]]\ntype = 'read_arrow'\npath = 'in/*.arrow'\n\
[[stage]]\ntype = 'calibrate'\nwaveforms = 300\n\
[[stage]]\ntype = 'decompose'\nmode = 'fastest'\n\
[[stage]]\ntype = 'georeference'\n\
[[stage]]\ntype = 'write_las'\npath = '*.laz'\n\
[[stage]]\ntype = 'write_lstat'\n\
[[stage]]\ntype = 'write_table'\npath = 'tables/*.csv'\n";

/// A survey of three strips and its job, in the folder `s`.
fn survey() -> TestFolder {
    let place = TestFolder::new();
    fs::create_dir(place.path("s")).unwrap();
    place.write("s/make.toml", MAKE.as_bytes());
    for (number, stem) in ["a", "b", "c"].iter().enumerate() {
        let set = [format!("simulate.stem={stem}"), format!("simulate.seed={}", number + 1)];
        wavex_ok(&place, &["run", "s/make.toml", "--set", &set[0], "--set", &set[1]]);
    }
    place.write("s/job.toml", SURVEY.as_bytes());
    place
}

#[track_caller]
fn wavex_ok(place: &TestFolder, arguments: &[&str]) {
    assert_eq!(wavex(place, arguments), (Some(0), String::new()), "{arguments:?}");
}

#[track_caller]
fn plan(place: &TestFolder, arguments: &[&str]) {
    wavex_ok(place, &[&["plan", "s/job.toml", "-o", "s/plan", "--cores", "1"], arguments].concat());
}

/// Runs the tasks of a plan in a folder; returns the messages about skipped inputs.
fn run_tasks(place: &TestFolder, folder: &str) -> String {
    let plan: Value = serde_json::from_str(&place.text(&format!("{folder}/plan/plan.json"))).unwrap();
    assert_eq!((plan["root"].as_str(), plan["plan_dir"].as_str()), (Some(".."), Some("plan")));
    let path = |value: &Value| format!("{folder}/{}", value.as_str().unwrap());
    if let Some(task) = plan.get("calibration") {
        wavex_ok(place, &["calibrate", &path(&task["job"]), "-o", &path(&task["model"])]);
    }
    let mut messages = String::new();
    for task in plan["tasks"].as_array().unwrap().iter().rev() {
        let job = path(&task["job"]);
        let Outcome { err, .. } = place.wavex(&["run", &job, "--resume=digest", "--progress", "never"]);
        messages += &err;
    }
    messages
}

/// Products of all folders below the output folder.
fn products(place: &TestFolder, folder: &str) -> BTreeMap<String, Vec<u8>> {
    let mut all = files(&place.path(folder));
    all.extend(files(&place.path(&format!("{folder}/tables"))));
    let is_product = |name: &str| !name.ends_with(".log") && !name.starts_with("job");
    all.retain(|name, _| is_product(name));
    all
}

/// Whether a key of a report depends on time or on the number of cores.
fn is_volatile(key: &str) -> bool {
    let volatile = [
        "started",
        "ended",
        "wall_s",
        "working_s",
        "waiting_s",
        "blocked_s",
        "line_us",
        "modified_s",
        "peak_in_flight_bytes",
        "threads",
        "workers",
        "blake3",
    ];
    volatile.contains(&key)
}

fn without_times(value: &Value) -> Value {
    match value {
        Value::Object(table) => {
            let kept = table.iter().filter(|(key, _)| !is_volatile(key));
            Value::Object(kept.map(|(key, value)| (key.clone(), without_times(value))).collect())
        }
        Value::Array(items) => items.iter().map(without_times).collect(),
        other => other.clone(),
    }
}

fn report(place: &TestFolder, path: &str) -> Value {
    without_times(&serde_json::from_str(&place.text(path)).unwrap())
}

/// Collects a plan; returns exit code and messages.
fn collect(place: &TestFolder, arguments: &[&str]) -> (Option<i32>, String) {
    wavex(place, &[&["collect", "s/plan"], arguments].concat())
}

#[test]
fn tasks_give_the_bytes_and_the_results_digest_of_one_run() {
    let place = survey();
    place.write("s/in/b.arrow", b"ARROW1");
    let (code, err) = wavex(&place, &["run", "s/job.toml", "--archive", "s/archives/run"]);
    assert_eq!(code, Some(1), "{err}");
    let (whole, whole_report) = (products(&place, "s/out"), report(&place, "s/out/job_report.json"));
    assert_eq!(whole.len(), 6);
    fs::remove_dir_all(place.path("s/out")).unwrap();

    plan(&place, &["--archive", "s/archives/tasks"]);
    run_tasks(&place, "s");
    let (code, err) = collect(&place, &[]);
    let problem = "error: incomplete: 1 of 3 tasks\n  b: stage read_arrow: s/in/b.arrow: ";
    assert!(code == Some(1) && err.starts_with(problem), "{err}");
    let mut found = products(&place, "s/out");
    let lines = found.remove("job_all_lstat.txt");
    assert_eq!(lines, None, "files of the survey are no products");
    assert!(found == whole, "{:?} instead of {:?}", found.keys(), whole.keys());
    assert_eq!(report(&place, "s/out/job_report.json"), whole_report);
    let page = place.text("s/out/job_report.html");
    let row = page.split("<tr>").find(|row| row.contains(">b</a>")).unwrap();
    assert!(row.contains("<td>failed</td>"), "{row}");
    let results = |name: &str| place.text(&format!("s/archives/{name}/results.b3"));
    assert_eq!(results("tasks"), results("run"));
    assert_ne!(place.text("s/archives/tasks/archive.b3"), place.text("s/archives/run/archive.b3"));
    for command in ["verify", "replay"] {
        wavex_ok(&place, &[command, "s/archives/tasks"]);
    }
    // The archive of the same results remains.
    assert_eq!(collect(&place, &[]).1, err);

    let Outcome { err, .. } = place.wavex(&["run", "s/job.toml", "--resume=digest", "--progress", "never"]);
    let skipped = err.lines().filter(|line| line.ends_with(": skipped, its outputs are complete")).count();
    assert_eq!(skipped, 2, "{err}");
}

/// Beams of a granule are strips: each is a task.
#[test]
fn beams_are_tasks() {
    let Some(data) = wavex_testkit::data() else { return };
    let place = TestFolder::new();
    place.write("s/in/g.h5", &fs::read(data.join("gedi/gedi_l1b.h5")).unwrap());
    let job = "[job]\noutput_dir = 'out'\n[[stage]]\ntype = 'read_hdf5'\npath = 'in/*.h5'\nsplit_beams = true\n\
               [[stage]]\ntype = 'measure_footprints'\n[[stage]]\ntype = 'georeference'\n\
               [[stage]]\ntype = 'write_footprints'\npath = '*.csv'\n[[stage]]\ntype = 'write_las'\npath = '*.laz'\n";
    place.write("s/job.toml", job.as_bytes());
    assert_eq!(wavex(&place, &["run", "s/job.toml"]).0, Some(0));
    let whole = products(&place, "s/out");
    assert_eq!(whole.keys().filter(|name| name.starts_with("g_BEAM") && name.ends_with(".laz")).count(), 4);
    fs::remove_dir_all(place.path("s/out")).unwrap();

    plan(&place, &[]);
    let described: Value = serde_json::from_str(&place.text("s/plan/plan.json")).unwrap();
    let tasks = described["tasks"].as_array().unwrap();
    assert_eq!((tasks.len(), described["shared_inputs"].as_array().map(Vec::len)), (4, Some(0)));
    assert!(tasks.iter().all(|task| task["inputs"][0]["path"] == "in/g.h5"), "{described}");
    run_tasks(&place, "s");
    assert_eq!(collect(&place, &["--no-archive"]), (Some(0), String::new()));
    let mut found = products(&place, "s/out");
    found.retain(|name, _| whole.contains_key(name));
    assert!(found == whole, "{:?} instead of {:?}", found.keys(), whole.keys());
}

#[test]
fn digests_and_line_statistics_of_all_strips_are_collected() {
    let place = survey();
    plan(&place, &[]);
    run_tasks(&place, "s");
    assert_eq!(collect(&place, &["--digest"]), (Some(0), String::new()));
    let lines = place.text("s/out/job_all_lstat.txt");
    let expected: String = ["a", "b", "c"]
        .map(|stem| format!("# input {stem}\n{}", place.text(&format!("s/out/{stem}_lstat.txt"))))
        .concat();
    assert_eq!(lines, expected);
    let digests = place.text("s/out/job_outputs.b3");
    let names: Vec<&str> = digests.lines().map(|line| line.split_once("  ").unwrap().1).collect();
    assert_eq!(names[..3], ["a.laz", "a_lstat.txt", "tables/a.csv"]);
    assert_eq!(names.len(), 9);
    for line in digests.lines() {
        let (digest, name) = line.split_once("  ").unwrap();
        let bytes = fs::read(place.path(&format!("s/out/{name}"))).unwrap();
        assert_eq!(blake3::hash(&bytes).to_hex().as_str(), digest, "{name}");
    }
    assert_eq!(place.text("s/out/job.log").matches("exit status 0").count(), 3);
}

#[test]
fn incomplete_tasks_are_named() {
    let place = survey();
    plan(&place, &["--archive", "s/archive"]);
    let said = collect(&place, &[]).1;
    let never = |stem: &str| format!("\n  {stem}: not run: it has no report");
    assert_eq!(said, format!("error: incomplete: 3 of 3 tasks{}{}{}\n", never("a"), never("b"), never("c")));
    run_tasks(&place, "s");
    let whole = fs::read(place.path("s/out/a.laz")).unwrap();
    let problem = |changed: &str| format!("error: incomplete: 1 of 3 tasks\n  a: {changed}\n");

    fs::remove_file(place.path("s/out/a.laz")).unwrap();
    assert_eq!(collect(&place, &[]), (Some(1), problem("out/a.laz is missing")));
    assert!(!place.path("s/archive").exists(), "not every task has ended");
    place.write("s/out/a.laz", &whole[1..]);
    let bytes = format!("out/a.laz has {} bytes instead of {}", whole.len() - 1, whole.len());
    assert_eq!(collect(&place, &[]), (Some(1), problem(&bytes)));
    let mut other = whole.clone();
    other[whole.len() / 2] ^= 1;
    place.write("s/out/a.laz", &other);
    assert_eq!(collect(&place, &["--no-archive"]), (Some(0), String::new()));
    let changed = "out/a.laz was changed: its digest is different";
    assert_eq!(collect(&place, &["--digest"]), (Some(1), problem(changed)));
    // A task repeats what is not whole, and only that.
    let messages = run_tasks(&place, "s");
    let expected = "c: skipped, its outputs are complete\nb: skipped, its outputs are complete\n\
                    a: not skipped: out/a.laz was changed\n";
    assert_eq!(messages, expected);
    assert_eq!(collect(&place, &[]), (Some(0), String::new()));
    assert!(fs::read(place.path("s/out/a.laz")).unwrap() == whole);

    // An archive is never replaced.
    fs::remove_file(place.path("s/archive/results.b3")).unwrap();
    let Outcome { code, err, .. } = place.wavex(&["--quiet", "collect", "s/plan"]);
    assert_eq!(code, Some(1));
    assert!(err.contains("an archive of an older version, without results.b3; move it away"), "{err}");
}

#[cfg(unix)]
#[test]
fn texts_from_outside_of_a_plan_are_not_collected() {
    let place = survey();
    plan(&place, &[]);
    run_tasks(&place, "s");
    place.write("secret.txt", b"secret");
    let log = "s/plan/logs/a.log";
    let plan = place.text("s/plan/plan.json");
    for (name, problem) in [("logs/a.log", "a link"), ("../../secret.txt", "a path")] {
        fs::remove_file(place.path(log)).unwrap();
        std::os::unix::fs::symlink(place.path("secret.txt"), place.path(log)).unwrap();
        let text = plan.replace("plan/logs/a.log", &format!("plan/{name}"));
        place.write("s/plan/plan.json", text.as_bytes());
        let Outcome { code, err, .. } = place.wavex(&["collect", "s/plan"]);
        assert!(code == Some(0) && err.contains(&format!("{problem} that leads out of ")), "{err}");
        assert!(!place.text("s/out/job.log").contains("secret"));
    }
}

#[cfg(unix)]
#[test]
fn pipes_in_a_plan_end_its_collection() {
    let place = survey();
    plan(&place, &[]);
    for name in ["reports/a_report.json", "plan.json"] {
        let path = place.path(&format!("s/plan/{name}"));
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        let _ = fs::remove_file(&path);
        assert!(std::process::Command::new("mkfifo").arg(&path).status().unwrap().success());
        let (code, err) = collect(&place, &[]);
        assert!(code == Some(1) && err.contains(&format!("{name}: a pipe or device")), "{err}");
    }
}

#[test]
fn results_of_another_plan_are_out_of_date() {
    let place = survey();
    place.write("s/job.toml", SURVEY.replace("[job]\n", "[job]\nmodel = 'input'\n").as_bytes());
    plan(&place, &[]);
    run_tasks(&place, "s");
    plan(&place, &["--set", "decompose.detection_sigma=6"]);
    let (code, err) = collect(&place, &[]);
    let changed = "  a: out of date: `detection_sigma` of `decompose` was different\n";
    assert!(code == Some(1) && err.contains(changed), "{err}");
    run_tasks(&place, "s");
    assert_eq!(collect(&place, &[]), (Some(0), String::new()));

    fs::copy(place.path("s/in/a.arrow"), place.path("s/in/d.arrow")).unwrap();
    let (code, err) = collect(&place, &[]);
    let problem =
        "error: the job now has 4 inputs, the plan 3; run `wavex plan` again, and then the new tasks\n";
    assert_eq!((code, err.as_str()), (Some(1), problem));
}

#[test]
fn a_task_with_another_geometry_is_out_of_date() {
    let place = survey();
    plan(&place, &["--set", "job.geometry.crs='utm:33N'"]);
    run_tasks(&place, "s");
    plan(&place, &["--set", "job.geometry.crs='utm:32N'"]);
    let (code, said) = collect(&place, &[]);
    assert_eq!(code, Some(1));
    assert!(said.contains("out of date: `geometry` of `[job]` was different"), "{said}");
}

#[test]
fn the_page_of_the_survey_is_collected() {
    let place = survey();
    let page = ["--set", "job.survey_page=true"];
    let archive = |name: &str| ["--archive".to_owned(), format!("s/archives/{name}")];
    let [option, path] = archive("run");
    let job = ["run", "s/job.toml", "--progress", "never", &option, &path];
    wavex_ok(&place, &[&job[..], &page].concat());
    let of_survey = || -> BTreeMap<String, Vec<u8>> {
        let mut all = files(&place.path("s/out"));
        all.retain(|name, _| {
            name.starts_with("job_survey") || name.ends_with(".tif") || name.ends_with(".arrow")
        });
        all
    };
    let (whole, of_run) = (of_survey(), report(&place, "s/out/job_report.json"));
    let names: Vec<&String> = whole.keys().collect();
    for name in ["job_survey.html", "job_survey.json", "a_cells.arrow", "c_pulse_density.tif"] {
        assert!(whole.contains_key(name), "{names:?}");
    }
    fs::remove_dir_all(place.path("s/out")).unwrap();

    let [option, path] = archive("tasks");
    plan(&place, &[&page[..], &[option.as_str(), path.as_str()]].concat());
    run_tasks(&place, "s");
    assert!(!place.path("s/out/job_survey.html").exists(), "a task has no page of the survey");
    assert_eq!(collect(&place, &["--digest"]), (Some(0), String::new()));
    let found = of_survey();
    assert!(found == whole, "{:?} instead of {names:?}", found.keys());
    assert_eq!(report(&place, "s/out/job_report.json"), of_run);
    let results = |name: &str| place.text(&format!("s/archives/{name}/results.b3"));
    assert_eq!(results("tasks"), results("run"));

    fs::remove_file(place.path("s/out/b_cells.arrow")).unwrap();
    let problem = "error: incomplete: 1 of 3 tasks\n  b: out/b_cells.arrow is missing\n";
    assert_eq!(collect(&place, &["--no-archive"]), (Some(1), problem.to_owned()));
}

#[test]
fn a_plan_moves_with_its_data() {
    let place = survey();
    plan(&place, &["--archive", "s/archive"]);
    run_tasks(&place, "s");
    fs::rename(place.path("s"), place.path("elsewhere")).unwrap();
    let messages = run_tasks(&place, "elsewhere");
    assert_eq!(messages.matches("skipped, its outputs are complete").count(), 3, "{messages}");
    assert_eq!(wavex(&place, &["collect", "elsewhere/plan"]), (Some(0), String::new()));
    for name in ["plan.json", "job.resolved.toml", "tasks/a.toml", "Snakefile", "tasks.tsv"] {
        let text = place.text(&format!("elsewhere/plan/{name}"));
        let here = place.path("").canonicalize().unwrap();
        assert!(!text.contains(here.to_str().unwrap()), "{name}: {text}");
    }
}

/// Modification times of the files of a plan.
fn times(folder: &Path) -> BTreeMap<String, std::time::SystemTime> {
    let names = files(folder).into_keys();
    names.map(|name| (name.clone(), folder.join(name).metadata().unwrap().modified().unwrap())).collect()
}

#[test]
fn a_second_plan_replaces_only_what_changed() {
    let place = survey();
    plan(&place, &[]);
    let (before, tasks) = (times(&place.path("s/plan")), times(&place.path("s/plan/tasks")));
    fs::copy(place.path("s/in/a.arrow"), place.path("s/in/d.arrow")).unwrap();
    place.write("s/plan/profiles/slurm/config.yaml", b"edited");
    plan(&place, &[]);
    assert_eq!(place.text("s/plan/profiles/slurm/config.yaml"), "edited");
    let (after, tasks_after) = (times(&place.path("s/plan")), times(&place.path("s/plan/tasks")));
    let changed: Vec<&String> = before.keys().filter(|name| before[*name] != after[*name]).collect();
    assert_eq!(changed, ["job.resolved.toml", "plan.json", "tasks.tsv"]);
    assert!(tasks.iter().all(|(name, time)| tasks_after[name] == *time) && tasks_after.len() == 4);

    let other = "error: s/in: the folder is not empty and has no plan; give a new folder, or that of an earlier plan\n";
    assert_eq!(wavex(&place, &["plan", "s/job.toml", "-o", "s/in"]), (Some(1), other.to_owned()));
    place.write("s/job.toml", SURVEY.replace("'in/*.arrow'", "['in/a.arrow', 'in/none.arrow']").as_bytes());
    let (code, err) = wavex(&place, &["plan", "s/job.toml", "-o", "s/plan"]);
    assert!(code == Some(1) && err.contains("in/none.arrow: cannot find the input: "), "{err}");
}

#[test]
fn ten_thousand_inputs_are_planned_in_seconds() {
    let place = TestFolder::new();
    fs::create_dir(place.path("in")).unwrap();
    for number in 0..10_000 {
        fs::write(place.path(&format!("in/{number:05}.las")), b"").unwrap();
        fs::write(place.path(&format!("in/{number:05}.wdp")), b"").unwrap();
    }
    let job = SURVEY.replace("read_arrow", "read_las").replace("*.arrow", "*.las");
    place.write("job.toml", job.as_bytes());
    let started = Instant::now();
    wavex_ok(&place, &["plan", "job.toml", "-o", "plan"]);
    let duration = started.elapsed();
    println!("10 000 inputs: planned in {:.1} s", duration.as_secs_f64());
    assert!(duration < Duration::from_secs(60), "{duration:?}");
    assert_eq!(place.text("plan/tasks.tsv").lines().count(), 10_001);
    let started = Instant::now();
    assert_eq!(wavex(&place, &["collect", "plan"]).0, Some(1));
    println!("10 000 inputs: collected without results in {:.1} s", started.elapsed().as_secs_f64());
}
