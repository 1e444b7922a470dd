//! Fails the calls of every scenario, one per run, and checks what remains.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use super::outputs::{self, Files, is_remains};
use super::scenario::{self, Scenario};
use super::shim::{self, Ended, Kind};
use wavex_testkit::TestFolder;

/// Which calls are failed if the environment does not say.
const STEP: usize = 8;
/// Runs at once: one for each processor of a small machine.
const WORKERS: usize = 2;

/// Calls whose failure may not be called a success.
const MUST_SUCCEED: [&str; 13] = [
    "open64",
    "openat64",
    "write",
    "writev",
    "pwrite64",
    "pwrite",
    "fsync",
    "fdatasync",
    "rename",
    "renameat",
    "ftruncate64",
    "ftruncate",
    "mkdir",
];
/// Calls that remove files: after their failure remains may stay until the next run.
const REMOVE: [&str; 5] = ["unlink", "unlinkat", "rmdir", "opendir", "readdir64"];

/// Whether a call belongs to the removal of files: that of a replay first opens its temporary folder.
fn removes(call: &str, path: &str) -> bool {
    let is_temporary = path.rsplit('/').next().is_some_and(|name| name.starts_with("wavex-replay-"));
    REMOVE.contains(&call) || (is_temporary && call != "mkdir")
}

/// One worker's folder for a scenario.
struct Workshop<'s> {
    scenario: &'s Scenario,
    library: &'s Path,
    /// Removed on drop.
    _place: TestFolder,
    folder: PathBuf,
    scratch: TestFolder,
    good: Files,
    said: String,
}

/// Results of a kind of fault.
#[derive(Clone, Default)]
struct Row {
    calls: usize,
    tested: usize,
    succeeded: usize,
    failed: usize,
    killed: usize,
    hung: usize,
    wrong: usize,
}

fn step() -> usize {
    match std::env::var("WAVEX_FAULTS").as_deref() {
        Ok("all") => 1,
        Ok(number) => number.parse().expect("WAVEX_FAULTS is `all` or a number"),
        Err(_) => STEP,
    }
}

/// Whether a scenario or a kind was asked for; default: all.
fn is_wanted(name: &str, variable: &str) -> bool {
    std::env::var(variable).map_or(true, |wanted| wanted.split(',').any(|one| one == name))
}

#[test]
fn no_failing_call_hangs_or_leaves_a_wrong_file() {
    let compiled = tempfile::tempdir().unwrap();
    let library = shim::compile(compiled.path());
    let mut problems = Vec::new();
    println!("| scenario | fault | calls | failed one by one | success | error | killed | hung | wrong |");
    println!("|---|---|---:|---:|---:|---:|---:|---:|---:|");
    for scenario in scenario::ALL.iter().filter(|scenario| is_wanted(scenario.name, "WAVEX_FAULT_SCENARIOS"))
    {
        let (rows, found) = sweep(scenario, &library, step());
        for (kind, row) in rows {
            println!(
                "| {} | {} | {} | {} | {} | {} | {} | {} | {} |",
                scenario.name,
                kind.name(),
                row.calls,
                row.tested,
                row.succeeded,
                row.failed,
                row.killed,
                row.hung,
                row.wrong
            );
        }
        problems.extend(found);
    }
    assert!(problems.is_empty(), "{} problems:\n{}", problems.len(), problems.join("\n"));
}

#[test]
fn messages_name_the_failed_call() {
    let compiled = tempfile::tempdir().unwrap();
    let library = shim::compile(compiled.path());
    let cases: [(&str, &[_]); 2] = [
        (
            "run",
            &[
                ("opendir", "./out", 1, "./out: cannot list the claims in: Input/output error"),
                (
                    "write",
                    "./out/job.log",
                    0,
                    "job.log: cannot write the log: Input/output error (os error 5); it is incomplete",
                ),
                ("fsync", "./out", 1, "./out: cannot write the folder: Input/output error"),
                ("fsync", "archives", 1, "archives: cannot write the folder: Input/output error"),
            ],
        ),
        ("packed", &[("opendir", "/in", 1, "/in: cannot list: Input/output error")]),
    ];
    for (name, cases) in cases {
        let scenario = scenario::ALL.iter().find(|scenario| scenario.name == name).unwrap();
        let shop = Workshop::new(scenario, &library);
        for (call, path, code, message) in cases {
            let ended = shop.fail_call(Kind::Eio, call, path);
            assert_eq!(ended.code, Some(*code), "{}", ended.text);
            assert!(ended.text.contains(message), "{call} {path}: {}", ended.text);
        }
    }
}

/// Fails the calls of a scenario; returns the results by kind, and all problems.
fn sweep(scenario: &Scenario, library: &Path, step: usize) -> (BTreeMap<Kind, Row>, Vec<String>) {
    let shops: Vec<Workshop> = (0..WORKERS).map(|_| Workshop::new(scenario, library)).collect();
    let (mut rows, mut points) = (BTreeMap::new(), Vec::new());
    let wanted = Kind::ALL.into_iter().filter(|kind| is_wanted(kind.name(), "WAVEX_FAULT_KINDS"));
    for (offset, kind) in wanted.enumerate() {
        let calls = shops[0].count(kind);
        rows.insert(kind, Row { calls, ..Row::default() });
        // Different kinds fail different calls.
        points.extend((1 + offset % step..=calls).step_by(step).map(|at| (kind, at)));
    }
    let (next, results, problems) = (AtomicUsize::new(0), Mutex::new(rows), Mutex::new(Vec::new()));
    std::thread::scope(|scope| {
        for shop in &shops {
            scope.spawn(|| {
                while let Some((kind, at)) = points.get(next.fetch_add(1, Ordering::Relaxed)) {
                    let (ended, found) = shop.fail(*kind, *at);
                    let mut rows = results.lock().unwrap();
                    let row = rows.get_mut(kind).unwrap();
                    row.tested += 1;
                    match ended.code {
                        _ if ended.hung => row.hung += 1,
                        Some(0) => row.succeeded += 1,
                        Some(_) => row.failed += 1,
                        None => row.killed += 1,
                    }
                    row.wrong += usize::from(!found.is_empty());
                    let hit = ended.calls.first().map(|(call, path)| format!("{call} {path}"));
                    let hit = hit
                        .unwrap_or_else(|| "no call".to_owned())
                        .replace(&shop.folder.display().to_string(), "");
                    let prefix = format!("{} {} {at} ({hit})", scenario.name, kind.name());
                    let found: Vec<String> = found.iter().map(|found| format!("{prefix}: {found}")).collect();
                    found.iter().for_each(|problem| println!("{problem}"));
                    problems.lock().unwrap().extend(found);
                }
            });
        }
    });
    (results.into_inner().unwrap(), problems.into_inner().unwrap())
}

impl<'s> Workshop<'s> {
    fn new(scenario: &'s Scenario, library: &'s Path) -> Workshop<'s> {
        let place = scenario.place();
        let folder = place.path("").canonicalize().unwrap();
        let mut shop = Workshop {
            scenario,
            library,
            _place: place,
            folder,
            scratch: TestFolder::new(),
            good: Files::new(),
            said: String::new(),
        };
        let ended = shop.run("good", None);
        assert_eq!(ended.code, Some(0), "{}", ended.text);
        shop.good = outputs::files(&shop.folder);
        assert!(!shop.good.keys().any(|name| is_remains(name)), "{:?}", shop.good.keys());
        shop.said = ended.text;
        shop
    }

    fn run(&self, new: &str, fault: Option<(Kind, usize)>) -> Ended {
        shim::run(self.library, &self.folder, &self.scratch.path(""), &self.scenario.arguments(new), fault)
    }

    /// Runs with the first call of this name on this path failing; a path may lack the folder of the test.
    fn fail_call(&self, kind: Kind, call: &str, path: &str) -> Ended {
        let folder = self.folder.display().to_string();
        let is_it = |(name, of): &(String, String)| name == call && of.replace(&folder, "") == path;
        // Threads make the order of later calls vary.
        for _ in 0..50 {
            let calls = self.calls(kind);
            let at = calls.iter().position(is_it).unwrap_or_else(|| panic!("no {call} of {path}: {calls:?}"));
            scenario::clear(&self.folder);
            let ended = self.run("new", Some((kind, at + 1)));
            if ended.calls.first().is_some_and(is_it) {
                return ended;
            }
        }
        panic!("{call} of {path} was never hit");
    }

    /// Number of calls to which a kind applies.
    fn count(&self, kind: Kind) -> usize {
        self.calls(kind).len()
    }

    /// Calls to which a kind applies.
    fn calls(&self, kind: Kind) -> Vec<(String, String)> {
        scenario::clear(&self.folder);
        let ended = self.run("new", Some((kind, 0)));
        assert_eq!(ended.code, Some(0), "{}", ended.text);
        assert!(kind != Kind::Eio || !ended.calls.is_empty(), "the library was not loaded");
        if std::env::var_os("WAVEX_FAULT_CALLS").is_some() {
            ended.calls.iter().for_each(|(call, path)| println!("{call} {path}"));
        }
        ended.calls
    }

    /// Runs with a failing call, and again without; returns the first end and all problems.
    fn fail(&self, kind: Kind, at: usize) -> (Ended, Vec<String>) {
        scenario::clear(&self.folder);
        if at.is_multiple_of(2) {
            outputs::put_earlier(&self.folder, &self.good);
        }
        let ended = self.run("new", Some((kind, at)));
        let mut problems = self.first(kind, &ended);
        let again = self.run("again", None);
        let left = outputs::files(&self.folder);
        if again.code != Some(0) {
            problems.push(format!("the next run ends with {:?}: {}", again.code, again.text.trim_end()));
        } else {
            let wrong = outputs::problems(&left, &self.good, "again", true);
            problems.extend(wrong.into_iter().map(|problem| format!("after the next run, {problem}")));
        }
        let remains = left.keys().filter(|name| is_remains(name));
        problems.extend(remains.map(|name| format!("the next run leaves {name}")));
        (ended, problems)
    }

    /// Problems of the run with the failing call.
    fn first(&self, kind: Kind, ended: &Ended) -> Vec<String> {
        let mut problems = Vec::new();
        let now = outputs::files(&self.folder);
        let is_success = ended.code == Some(0);
        problems.extend(outputs::problems(&now, &self.good, "new", is_success));
        let said = ended.text.trim_end();
        match ended.code {
            _ if ended.hung => problems.push(format!("it hangs: {said}")),
            Some(0) => {
                let is_without_log = |path: &str| path.ends_with(".log") && !path.ends_with("_stat.log");
                for (call, path) in &ended.calls {
                    let is_told = is_without_log(path) && said.contains("the log");
                    let is_gate = path.ends_with("/.wavex.lock");
                    let fails = matches!(kind, Kind::Eio | Kind::Enospc | Kind::EnospcSticky);
                    let must = MUST_SUCCEED.contains(&call.as_str()) && !removes(call, path);
                    if fails && must && !is_told && !is_gate {
                        problems.push(format!("{call} of {path} failed, but the run calls itself a success"));
                    }
                }
                // Progress has times.
                let results = |said: &str| -> Vec<String> {
                    said.lines().filter(|line| line.starts_with("kept/")).map(str::to_owned).collect()
                };
                if !self.scenario.writes() && results(said) != results(&self.said) {
                    problems.push(format!("it succeeds with another result: {said}"));
                }
            }
            Some(1 | 2) if matches!(kind, Kind::Short | Kind::Eintr) => {
                problems.push(format!("it does not go on: {said}"));
            }
            Some(1 | 2) if said.contains("error") || said.contains("problem") => {}
            None if kind == Kind::Kill => {}
            code => problems.push(format!("it ends with {code:?}: {said}")),
        }
        let may_remain = |name: &str| {
            let could_not = ended.calls.iter().any(|(call, path)| removes(call, path));
            kind == Kind::Kill || ended.hung || could_not || name.ends_with(".wavex.lock")
        };
        let remains = now.keys().filter(|name| is_remains(name) && !may_remain(name));
        problems.extend(remains.map(|name| format!("it leaves {name}")));
        problems
    }
}
