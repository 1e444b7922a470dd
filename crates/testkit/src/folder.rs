//! A folder with inputs and a job, and the results of the program.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use serde_json::Value;

use crate::{program, wavex};

/// End of a job that finds points, writes them as a table, and needs few waveforms.
pub const TO_TABLE: &str = "\
[[stage]]
type = 'calibrate'
waveforms = 300
[[stage]]
type = 'decompose'
[[stage]]
type = 'georeference'
[[stage]]
type = 'write_table'
path = '*.csv'
";

/// A folder of inputs; outputs go to `out` in it.
pub struct TestFolder {
    folder: tempfile::TempDir,
}

/// Result of a command.
#[derive(Debug, PartialEq)]
pub struct Outcome {
    /// `None` if a signal ended the program.
    pub code: Option<i32>,
    /// Text on standard output.
    pub out: String,
    /// Text on standard error.
    pub err: String,
}

impl Outcome {
    /// Exit code 0 without any text.
    pub fn success() -> Outcome {
        Outcome { code: Some(0), out: String::new(), err: String::new() }
    }

    /// This exit code with text on standard error only.
    pub fn failure(code: i32, err: impl Into<String>) -> Outcome {
        Outcome { code: Some(code), out: String::new(), err: err.into() }
    }
}

impl TestFolder {
    /// Creates an empty folder.
    pub fn new() -> TestFolder {
        TestFolder { folder: tempfile::tempdir().unwrap() }
    }

    /// A folder with these files.
    pub fn with(files: &[(&str, &[u8])]) -> TestFolder {
        let place = TestFolder::new();
        files.iter().for_each(|(name, bytes)| place.write(name, bytes));
        place
    }

    /// Path of a file of the folder.
    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Writes a file and creates its parent folders.
    pub fn write(&self, name: &str, bytes: &[u8]) {
        let path = self.path(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, bytes).unwrap();
    }

    /// Content of a text file.
    pub fn text(&self, name: &str) -> String {
        fs::read_to_string(self.path(name)).unwrap()
    }

    /// Writes the job of these stages; returns the command that runs it quietly in this folder.
    pub fn command(&self, stages: &str) -> Command {
        self.write("job.toml", format!("[job]\noutput_dir = 'out'\nthreads = 2\n{stages}").as_bytes());
        // Limits memory, so that trusting a wrong size fails. The allocator reserves 64 MB of
        // addresses for each of up to sixteen arenas. A shell without `ulimit -v` runs the program
        // without a limit.
        let mut command = Command::new("sh");
        command.args(["-c", "ulimit -v 2000000 2>/dev/null; exec \"$0\" \"$@\""]).arg(program());
        command.args(["--quiet", "run", "job.toml"]).current_dir(self.folder.path());
        command.stdin(Stdio::null()).env_remove("RUST_LOG");
        command.env("WAVEX_RIWAVELIB", crate::sdf::stand_in());
        command
    }

    /// Runs the program with these arguments in this folder.
    pub fn wavex(&self, arguments: &[&str]) -> Outcome {
        outcome(wavex().args(arguments).current_dir(self.path("")))
    }

    /// Runs the job of these stages.
    pub fn run(&self, stages: &str) -> Outcome {
        outcome(&mut self.command(stages))
    }

    /// Runs the job of a reader of `input` and the stages after it.
    pub fn read(&self, reader: &str, input: &str, stages: &str) -> Outcome {
        self.run(&format!("[[stage]]\ntype = '{reader}'\npath = '{input}'\n{stages}"))
    }

    /// Asserts that a job fails with this message and leaves no outputs.
    #[track_caller]
    pub fn fails(&self, reader: &str, input: &str, message: &str) {
        let stages = "[[stage]]\ntype = 'write_arrow'\npath = '*_copy.arrow'\n";
        self.left_nothing(self.read(reader, input, stages), message);
    }

    /// Asserts that the run of one input failed with this message and left no outputs.
    ///
    /// Log, statistics and report contain the message.
    #[track_caller]
    pub fn left_nothing(&self, outcome: Outcome, message: &str) {
        assert_eq!(outcome, Outcome::failure(1, format!("error: {message}\n")));
        assert_eq!(self.products(), Vec::<String>::new(), "a failed run leaves no outputs");
        for name in self.outputs() {
            let text = self.text(&format!("out/{name}"));
            if name.ends_with("_stat.log") {
                let failure = format!("{:<36} 1, failed\n{:<36} {message}\n", "exit status", "failure");
                assert!(text.contains(&failure), "{name}: {text}");
            } else {
                let report: Value = serde_json::from_str(&text).unwrap();
                let input = &report["inputs"][0];
                assert_eq!((&input["status"], &input["failure"]), (&"failed".into(), &message.into()));
            }
        }
        let log = self.text("out/job.log");
        assert!(log.contains(message), "the log lacks the cause of the failure:\n{log}");
    }

    /// Runs a job successfully; returns its report of the only input.
    #[track_caller]
    pub fn succeeds(&self, reader: &str, input: &str, stages: &str) -> Value {
        let outcome = self.read(reader, input, stages);
        assert_eq!(outcome, Outcome::success());
        let report: Value = serde_json::from_str(&self.text("out/job_report.json")).unwrap();
        assert_eq!(report["inputs"].as_array().unwrap().len(), 1);
        report["inputs"][0].clone()
    }

    /// Files in the output folder except the log, recursively.
    pub fn outputs(&self) -> Vec<String> {
        let mut names = Vec::new();
        collect(&self.path("out"), "", &mut names);
        names.retain(|name| name != "job.log");
        names.sort();
        names
    }

    /// Output files except statistics and report, which a failed run also leaves.
    pub fn products(&self) -> Vec<String> {
        let is_about_the_run = |name: &String| name.ends_with("_stat.log") || name == "job_report.json";
        self.outputs().into_iter().filter(|name| !is_about_the_run(name)).collect()
    }

    /// Times of the shots with returns in a table, in its order and format.
    pub fn times(&self, table: &str) -> Vec<String> {
        let text = self.text(table);
        let times = text.lines().skip(1).map(|row| row.split(',').nth(1).unwrap().to_owned());
        let mut times: Vec<String> = times.collect();
        times.dedup();
        times
    }
}

/// Runs a command to its end.
pub fn outcome(command: &mut Command) -> Outcome {
    let output = command.output().unwrap();
    let text = |bytes| String::from_utf8(bytes).unwrap();
    Outcome { code: output.status.code(), out: text(output.stdout), err: text(output.stderr) }
}

fn collect(folder: &Path, prefix: &str, names: &mut Vec<String>) {
    for entry in fs::read_dir(folder).into_iter().flatten() {
        let entry = entry.unwrap();
        let name = format!("{prefix}{}", entry.file_name().to_string_lossy());
        match entry.file_type().unwrap().is_dir() {
            true => collect(&entry.path(), &format!("{name}/"), names),
            false => names.push(name),
        }
    }
}

/// All rejections of the stages of an input.
pub fn rejected(input: &Value) -> BTreeMap<String, u64> {
    let stages = input["stages"].as_array().unwrap();
    let rejected = stages.iter().flat_map(|stage| stage["rejected"].as_object().unwrap());
    rejected.map(|(what, n)| (what.clone(), n.as_u64().unwrap())).collect()
}

/// All warnings of the stages of an input, then consequences without their causes.
pub fn notes(input: &Value) -> Vec<String> {
    let stages = input["stages"].as_array().unwrap();
    let notes = stages.iter().flat_map(|stage| stage["notes"].as_array().unwrap());
    let by_cause = stages.iter().flat_map(|stage| stage["consequences"].as_object().unwrap().values());
    let consequences = by_cause.flat_map(|texts| texts.as_array().unwrap());
    notes.chain(consequences).map(|note| note.as_str().unwrap().to_owned()).collect()
}
