//! The library that fails calls, and runs of the program with it.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// Time after which a run counts as hanging; a run takes about a second.
const LONGEST: Duration = Duration::from_secs(50);

/// What happens to a call.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    /// An error of the device.
    Eio,
    /// A full disk, for one call.
    Enospc,
    /// A full disk, from a call on.
    EnospcSticky,
    /// Interrupted by a signal.
    Eintr,
    /// Half of the bytes are transferred.
    Short,
    /// The process is killed.
    Kill,
}

impl Kind {
    /// All kinds.
    pub const ALL: [Kind; 6] =
        [Kind::Eio, Kind::Enospc, Kind::EnospcSticky, Kind::Eintr, Kind::Short, Kind::Kill];

    /// Name in tables and for the library.
    pub fn name(self) -> &'static str {
        match self {
            Kind::Eio => "eio",
            Kind::Enospc => "enospc",
            Kind::EnospcSticky => "enospc_sticky",
            Kind::Eintr => "eintr",
            Kind::Short => "short",
            Kind::Kill => "kill",
        }
    }
}

/// Compiles the library into this folder.
pub fn compile(folder: &Path) -> PathBuf {
    let source = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/faults/shim.c");
    let library = folder.join("shim.so");
    let mut compiler = Command::new(std::env::var_os("CC").unwrap_or_else(|| "cc".into()));
    compiler.args(["-Wall", "-Wextra", "-Werror", "-O1", "-fPIC", "-shared", "-o"]).arg(&library);
    let output =
        compiler.arg(source).arg("-ldl").output().expect("a C compiler: install cc, or name it in CC");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    library
}

/// End of a run.
#[derive(Debug)]
pub struct Ended {
    /// `None` if a signal ended the program.
    pub code: Option<i32>,
    /// Whether it was ended for taking too long.
    pub hung: bool,
    /// Text on standard output and standard error.
    pub text: String,
    /// Calls that failed, or all calls of a counting run: name and path.
    pub calls: Vec<(String, String)>,
}

/// Runs the program in `place`; its files besides those of the test are in `scratch`.
///
/// Fails call `at` by the library; 0 only counts; `None`: runs without the library.
pub fn run(
    library: &Path,
    place: &Path,
    scratch: &Path,
    arguments: &[String],
    fault: Option<(Kind, usize)>,
) -> Ended {
    let [text, log] = ["messages", "calls"].map(|name| scratch.join(name));
    let _ = fs::remove_file(&log);
    let messages = fs::File::create(&text).unwrap();
    let mut command = wavex_testkit::wavex();
    command.args(arguments).current_dir(place).env("TMPDIR", place.join("tmp"));
    // Rayon starts as many threads as there are processors, and the allocator as many arenas.
    command.stdout(messages.try_clone().unwrap()).stderr(messages).stdin(Stdio::null());
    if let Some((kind, at)) = fault {
        command.env("LD_PRELOAD", library).env("WAVEX_FAULT_BELOW", place).env("WAVEX_FAULT_LOG", &log);
        command.env("WAVEX_FAULT_KIND", kind.name()).env("WAVEX_FAULT_AT", at.to_string());
    }
    let started = Instant::now();
    let mut child = command.spawn().unwrap();
    let (code, hung) = loop {
        if let Some(status) = child.try_wait().unwrap() {
            break (status.code(), false);
        }
        if started.elapsed() > LONGEST {
            child.kill().unwrap();
            child.wait().unwrap();
            break (None, true);
        }
        std::thread::sleep(Duration::from_millis(2));
    };
    let called = fs::read_to_string(&log).unwrap_or_default();
    let calls = called.lines().filter_map(|line| line.split_once(' '));
    let calls = calls.map(|(call, path)| (call.to_owned(), path.to_owned())).collect();
    Ended { code, hung, text: fs::read_to_string(&text).unwrap(), calls }
}
