//! `wavex doctor`: reports what this machine offers, and what to do about what it lacks.

use std::path::Path;

use wavex_formats::sdf::library::{self, Installed};
use wavex_simd::SimdLevel;

use super::check::try_file_in;
use super::terminal::size;
use super::{Failure, print};
use wavex_run::archive::{Machine, Program};

/// Free disk space below which a run is unlikely to end, bytes.
const LITTLE_DISK: u64 = 1_000_000_000;
/// Memory below which the defaults of a job may not fit, MB.
const LITTLE_MEMORY_MB: u64 = 2_000;

/// How a finding affects runs.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Severity {
    Ok,
    /// Something is slower or cannot be read.
    Note,
    /// Runs will fail.
    Problem,
}

/// A property of the machine or of the program.
struct MachineFinding {
    state: Severity,
    subject: &'static str,
    found: String,
    /// What to do, unless the state is `Ok`.
    advice: String,
}

impl MachineFinding {
    fn ok(subject: &'static str, found: impl Into<String>) -> MachineFinding {
        MachineFinding { state: Severity::Ok, subject, found: found.into(), advice: String::new() }
    }

    fn note(subject: &'static str, found: impl Into<String>, advice: impl Into<String>) -> MachineFinding {
        MachineFinding { state: Severity::Note, subject, found: found.into(), advice: advice.into() }
    }

    fn problem(subject: &'static str, found: impl Into<String>, advice: impl Into<String>) -> MachineFinding {
        MachineFinding { state: Severity::Problem, ..MachineFinding::note(subject, found, advice) }
    }
}

/// Prints all findings; fails if runs in this folder will fail.
pub(super) fn doctor() -> Result<(), Failure> {
    let machine = Machine::this();
    let findings = [
        program(),
        instructions(SimdLevel::best()),
        MachineFinding::ok(
            "cores",
            machine.cores.map_or("unknown on this system".to_owned(), |cores| cores.to_string()),
        ),
        memory(machine.memory_mb, memory_limit_mb()),
        disk(Path::new(".")),
        riegl(library::installed()),
        proj(),
    ];
    print(&report(&findings))?;
    match findings.iter().filter(|finding| finding.state == Severity::Problem).count() {
        0 => Ok(()),
        1 => Err(Failure::Run("runs in this folder will fail: 1 problem".to_owned())),
        problems => Err(Failure::Run(format!("runs in this folder will fail: {problems} problems"))),
    }
}

/// One row per finding; advice on a row of its own.
fn report(findings: &[MachineFinding]) -> String {
    let row = |finding: &MachineFinding| {
        let state = match finding.state {
            Severity::Ok => "ok",
            Severity::Note => "note",
            Severity::Problem => "problem",
        };
        let advice = match finding.advice.is_empty() {
            true => String::new(),
            false => format!("{:25}{}\n", "", finding.advice),
        };
        format!("{state:9}{:16}{}\n{advice}", finding.subject, finding.found)
    };
    findings.iter().map(row).collect()
}

fn program() -> MachineFinding {
    let program = Program::this();
    match program.profile.as_str() {
        "debug" => MachineFinding::note(
            "wavex",
            program.words(),
            "this build is several times slower: install it with `cargo install --locked --path .`",
        ),
        _ => MachineFinding::ok("wavex", program.words()),
    }
}

fn instructions(level: SimdLevel) -> MachineFinding {
    match level {
        SimdLevel::Avx512 => MachineFinding::ok("instructions", "AVX-512"),
        SimdLevel::Avx2 => MachineFinding::ok("instructions", "AVX2 with FMA"),
        SimdLevel::Portable if cfg!(target_arch = "x86_64") => MachineFinding::note(
            "instructions",
            "neither AVX2 with FMA nor AVX-512",
            "results are the same, but decomposition is many times slower: use a processor from 2013 or later, \
             or a virtual machine that passes these instructions on",
        ),
        SimdLevel::Portable => {
            MachineFinding::ok("instructions", "those that every processor of this kind has")
        }
    }
}

/// Memory limit of this process's control group, MB.
fn memory_limit_mb() -> Option<u64> {
    let text = std::fs::read_to_string("/sys/fs/cgroup/memory.max").ok()?;
    text.trim().parse::<u64>().ok().map(|bytes| bytes / 1_000_000)
}

/// Judges the memory of the machine and the limit of the process, MB.
fn memory(machine_mb: Option<u64>, limit_mb: Option<u64>) -> MachineFinding {
    let Some(memory_mb) = machine_mb.into_iter().chain(limit_mb).min() else {
        return MachineFinding::ok("memory", "unknown on this system");
    };
    let limited = limit_mb.is_some_and(|limit_mb| machine_mb.is_none_or(|machine_mb| limit_mb < machine_mb));
    let limited = if limited { " (limit of this container or job)" } else { "" };
    let found = format!("{}{limited}", size(memory_mb * 1_000_000));
    if memory_mb < LITTLE_MEMORY_MB {
        return MachineFinding::note(
            "memory",
            found,
            "set `memory_mb` and `threads` in `[job]` to smaller numbers",
        );
    }
    MachineFinding::ok("memory", found)
}

/// Judges the current folder as an output folder.
fn disk(folder: &Path) -> MachineFinding {
    let free = fs4::available_space(folder).unwrap_or(u64::MAX);
    let advice = "change to another folder, or choose one with `output_dir` in `[job]`";
    if let Err(error) = try_file_in(folder) {
        return MachineFinding::problem("disk", format!("cannot write to this folder: {error}"), advice);
    }
    match free {
        u64::MAX => MachineFinding::ok("disk", "this folder is writable"),
        _ if free < LITTLE_DISK => MachineFinding::problem("disk", format!("{} free", size(free)), advice),
        _ => MachineFinding::ok("disk", format!("{} free in this folder", size(free))),
    }
}

/// Judges RIEGL's library for SDF files.
fn riegl(installed: Installed) -> MachineFinding {
    let subject = "RIEGL library";
    let advice = format!(
        "only for SDF and WFM files: get RiWAVELib from RIEGL, and set {} to its file or folder",
        library::VARIABLE
    );
    match installed {
        Installed::Loaded(version) => {
            MachineFinding::ok(subject, format!("{}.{}", version.major, version.minor))
        }
        Installed::Missing => MachineFinding::note(subject, "not found", advice),
        Installed::Unusable(problem) => MachineFinding::note(subject, problem, advice),
        Installed::Unsupported => MachineFinding::note(
            subject,
            "a static program cannot load it",
            format!("only for SDF and WFM files: {}", library::LOADING_PROGRAM),
        ),
    }
}

fn proj() -> MachineFinding {
    if cfg!(feature = "proj") {
        return MachineFinding::ok("PROJ", "built in");
    }
    let advice =
        "only for systems on other datums: build with `--features proj` (docs/reference/coordinates.md)";
    MachineFinding::note("PROJ", "not built in", advice)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_is_the_smaller_of_machine_and_limit() {
        let found = |machine, limit| {
            let finding = memory(machine, limit);
            (finding.state, finding.found)
        };
        assert_eq!(found(Some(24_000), None), (Severity::Ok, "24.0 GB".to_owned()));
        let limited = "1.5 GB (limit of this container or job)".to_owned();
        assert_eq!(found(Some(24_000), Some(1_500)), (Severity::Note, limited));
        assert_eq!(found(Some(24_000), Some(64_000)), (Severity::Ok, "24.0 GB".to_owned()));
        assert_eq!(found(None, None), (Severity::Ok, "unknown on this system".to_owned()));
    }

    #[test]
    fn a_folder_that_cannot_be_written_to_is_a_problem() {
        let finding = disk(Path::new("/dev/null/folder"));
        assert_eq!(finding.state, Severity::Problem);
        assert!(finding.found.starts_with("cannot write to this folder: "), "{}", finding.found);
    }

    #[test]
    fn what_is_missing_comes_with_advice() {
        let text = report(&[MachineFinding::ok("cores", "2"), riegl(Installed::Missing)]);
        let expected = "ok       cores           2\n\
            note     RIEGL library   not found\n                         \
            only for SDF and WFM files: get RiWAVELib from RIEGL, and set WAVEX_RIWAVELIB to its file or folder\n";
        assert_eq!(text, expected);
        let text = report(&[riegl(Installed::Unsupported)]);
        let expected = "note     RIEGL library   a static program cannot load it\n                         \
            only for SDF and WFM files: use wavex from its Debian package, or built by `cargo install`\n";
        assert_eq!(text, expected);
    }
}
