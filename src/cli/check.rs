//! `wavex check`: validates a job without reading data.

use std::collections::BTreeSet;
use std::fs::{self, OpenOptions};
use std::io;
use std::path::{Path, PathBuf};

use super::{Failure, InputRule, JobArgs, check_inputs, print, terminal};
use wavex_engine::job::Job;
use wavex_line::georef::check_crs;
use wavex_line::stage::fixed_folder;

/// Prints the job's chain, inputs and folders, or its errors.
pub(super) fn check(args: &JobArgs, rule: InputRule) -> Result<(), Failure> {
    let job = args.read(None)?;
    print(&report(&job, &args.folder(), rule).map_err(Failure::Wrong)?)
}

/// Describes the job in `folder`, or the first problem.
fn report(job: &Job, folder: &Path, rule: InputRule) -> Result<String, String> {
    let (input_dir, output_dir) = wavex_run::run::folders(job, folder);
    check_crs(&job.settings.geometry, &input_dir).map_err(|error| error.to_string())?;
    let mut said = format!("  chain:  {}\n  inputs: {}\n", job.chain(), input_dir.display());
    let absolute = std::path::absolute(&input_dir).unwrap_or(input_dir);
    let (about_inputs, problems) = check_inputs::inspect(job, &absolute);
    if rule == InputRule::Required && !problems.is_empty() {
        return Err(check_inputs::required(job, &problems));
    }
    said += &about_inputs;
    for folder in output_folders(job, &output_dir) {
        let found = writable(&folder)?;
        said += &format!("  output: {} ({found})\n", folder.display());
    }
    let verdict = match problems.len() {
        0 => "is valid".to_owned(),
        n => format!("is valid, with {}", counted_warnings(n)),
    };
    for problem in problems {
        said += &format!("  warning: {problem}\n");
    }
    for note in &job.notes {
        said += &format!("  note:   {note}\n");
    }
    Ok(format!("{} {verdict}\n{said}", job.name))
}

/// `1 warning`, `2 warnings`.
fn counted_warnings(n: usize) -> String {
    format!("{n} warning{}", if n == 1 { "" } else { "s" })
}

/// Output folders of the job, without parts that depend on the input's name.
fn output_folders(job: &Job, output_dir: &Path) -> BTreeSet<PathBuf> {
    let mut folders = BTreeSet::new();
    for pattern in job.stages.iter().flat_map(|stage| stage.planned.plan.outputs()) {
        folders.insert(fixed_folder(output_dir, pattern));
    }
    folders
}

/// Checks that a folder is writable or can be created; returns which, with the free disk space.
///
/// Leaves no file in the folder.
fn writable(folder: &Path) -> Result<String, String> {
    let exists = folder.exists();
    let existing = folder.ancestors().find(|folder| folder.exists()).unwrap_or(Path::new("."));
    match try_file_in(existing) {
        Ok(()) => {
            let found = if exists { "is writable" } else { "will be created" };
            let free =
                fs4::available_space(existing).map(|bytes| format!(", {} free", terminal::size(bytes)));
            Ok(format!("{found}{}", free.unwrap_or_default()))
        }
        Err(error) => {
            let action = if exists { "cannot write to this folder" } else { "cannot create this folder" };
            let remedy = "choose another one with `output_dir` or in the `path` of the sink";
            Err(format!("{}: {action}: {error}; {remedy}", folder.display()))
        }
    }
}

/// Creates an empty file in a folder and removes it.
pub(super) fn try_file_in(folder: &Path) -> io::Result<()> {
    let file = folder.join(format!(".wavex-check.{}.partial", std::process::id()));
    OpenOptions::new().write(true).create_new(true).open(&file)?;
    fs::remove_file(&file)
}

#[cfg(test)]
mod tests {
    use super::*;
    use wavex_stages::registry::STAGES;

    /// The text without the names of this folder and the free disk space.
    fn here(said: &str, folder: &Path) -> String {
        let line = |line: &str| match line.strip_suffix(" free)").and_then(|line| line.rsplit_once(", ")) {
            Some((begin, _)) => format!("{begin})\n"),
            None => format!("{line}\n"),
        };
        said.lines().map(line).collect::<String>().replace(&folder.display().to_string(), "HERE")
    }

    #[test]
    fn what_a_job_will_do_is_said_without_its_data() {
        let folder = tempfile::tempdir().unwrap();
        let text = "[job]\noutput_dir = \"out\"\n\n[[stage]]\ntype = \"simulate\"\n\n\
                    [[stage]]\ntype = \"write_lstat\"\npath = \"lines/*.txt\"\n\n\
                    [[stage]]\ntype = \"write_arrow\"\npath = \"*.arrow\"\n";
        let job = Job::parse(STAGES, "a.toml", text, &[]).unwrap();
        let said = here(&report(&job, folder.path(), InputRule::Required).unwrap(), folder.path());
        let expected = "\
a.toml is valid
  chain:  simulate -> Shots -> write_lstat -> write_arrow
  inputs: HERE
  output: HERE/out (will be created)
  output: HERE/out/lines (will be created)
";
        assert_eq!(said, expected);
    }

    #[test]
    fn inputs_that_are_missing_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let of = |path: &str, more: &str| {
            let text = format!(
                "[job.geometry]\n{more}\n[[stage]]\ntype = 'read_arrow'\npath = '{path}'\n\
                 [[stage]]\ntype = 'calibrate'\nload = 'model.json'\n[[stage]]\ntype = 'write_arrow'\npath = 'out/*.arrow'\n"
            );
            let job = Job::parse(STAGES, "a.toml", &text, &[]).unwrap_or_else(|errors| panic!("{errors}"));
            let said = here(&report(&job, folder.path(), InputRule::Optional).unwrap(), folder.path());
            let warnings = said.lines().filter_map(|line| line.strip_prefix("  warning: "));
            let warnings = warnings.map(str::to_owned).collect::<Vec<_>>();
            let verdict = match warnings.len() {
                1 => "a.toml is valid, with 1 warning\n".to_owned(),
                n => format!("a.toml is valid, with {n} warnings\n"),
            };
            assert!(said.starts_with(&verdict), "{said}");
            warnings
        };
        let geometry = "trajectory = '*.pof'\ncrs = 'zone.wkt'\ngeoid = 'egm96'\ngeoid_dir = 'geoids'";
        assert_eq!(
            of("flight.arrow", geometry),
            [
                "HERE/flight.arrow: no such file",
                "HERE/flight.pof: no such file",
                "HERE/model.json: no such file",
                "HERE/zone.wkt: no such file",
                "HERE/geoids: no geoid egm96 (.bin, .gtx)",
            ]
        );
        let pattern =
            "no file matches `HERE/lines/*.arrow`; check `path` of the reader and `input_dir` of the job";
        assert_eq!(of("lines/*.arrow", ""), [pattern, "HERE/model.json: no such file"]);
        for name in ["flight.arrow", "model.json"] {
            fs::write(folder.path().join(name), "").unwrap();
        }
        let empty = "HERE/flight.arrow: the file is empty; copy it again from its source";
        assert_eq!(of("flight.arrow", ""), [empty]);
    }

    #[test]
    fn a_job_that_writes_nothing_is_noted() {
        let text = "[[stage]]\ntype = \"simulate\"\n";
        let job = Job::parse(STAGES, "a.toml", text, &[]).unwrap();
        let expected = "\
a.toml is valid
  chain:  simulate -> Shots
  inputs: .
  note:   no stage of this job writes a file: a run produces only the report
";
        assert_eq!(report(&job, Path::new("."), InputRule::Required).unwrap(), expected);
    }

    #[test]
    fn a_folder_is_tried_and_nothing_stays_behind() {
        let folder = tempfile::tempdir().unwrap();
        let begins = |folder: &Path, found: &str| writable(folder).unwrap().starts_with(found);
        assert!(begins(folder.path(), "is writable, "));
        assert!(begins(&folder.path().join("new/las"), "will be created, "));
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
    }

    #[test]
    fn a_file_is_no_folder() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("file");
        fs::write(&file, "").unwrap();
        let error = writable(&file.join("out")).unwrap_err();
        let begins = format!("{}: cannot create this folder: ", file.join("out").display());
        assert!(error.starts_with(&begins), "{error}");
        let ends = "; choose another one with `output_dir` or in the `path` of the sink";
        assert!(error.ends_with(ends), "{error}");
    }
}
