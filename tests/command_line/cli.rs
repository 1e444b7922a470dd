//! The command line: output, streams and exit codes.

use std::fs;
use std::io::Write;
use std::process::Stdio;

use wavex_testkit::{Outcome, outcome};

/// Runs the program with these arguments and this standard input.
fn wavex_with_input(arguments: &[&str], input: &str) -> Outcome {
    let mut program = wavex_testkit::wavex();
    program.args(arguments).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = program.spawn().unwrap();
    // A program that does not read its input may already have exited.
    let _ = child.stdin.take().unwrap().write_all(input.as_bytes());
    let output = child.wait_with_output().unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    Outcome { code: output.status.code(), out: text(output.stdout), err: text(output.stderr) }
}

fn wavex(arguments: &[&str]) -> Outcome {
    wavex_with_input(arguments, "")
}

/// Asserts that the arguments are refused with this message and no other output.
fn refused(outcome: Outcome, expected: &str) {
    assert_eq!(outcome, Outcome::failure(2, expected));
}

#[test]
fn the_help_names_every_command() {
    let expected = "\
Turn full-waveform lidar recordings into point clouds

Usage: wavex [OPTIONS] <COMMAND>

Commands:
  run           Run a job
  plan          Plan a survey as tasks for several machines, one per input
  collect       Check and merge the results of planned tasks
  replay        Run an archived job again and compare the outputs bit by bit
  verify        Verify an archive, its inputs and its outputs by their digests
  check         Validate a job without reading data: keys, chain, folders, inputs
  stages        List the stages, or describe one stage and its keys
  schema        Print the JSON Schema of jobs, for editors that validate and complete TOML
  init          Write a commented starter job
  calibrate     Calibrate from a recording, or from all inputs of a job
  convert       Copy recorded waveforms into the open container format (Arrow)
  copc          Convert points to a cloud-optimised point cloud (COPC)
  false-alarms  Print the false-return rate of pure noise for each threshold
  explain       Explain one shot: samples, fit, residuals and returns
  scan          Summarise a recording: times, rates, lines, channels, noise, integrity
  report        Render a run's report as a page: timing, counts, sensor model, warnings
  survey        Make the page of a survey from the strips of one or more runs
  align         Align the strips of a survey: calibration and corrections of trajectories
  classify      Classify the ground of clouds of points: LAS, LAZ, COPC of any source
  trajectory    Project and decimate a trajectory: SBET, POF, SOL, TRJ or text
  view          Explore a recording, a job or a run's outputs in the browser: points, waveforms, fits
  import        Translate a command line of BayesWavEx 1.0 or 1.1 into a job
  doctor        Check this machine: instructions, memory, disk space, libraries
  man           Write the manual pages, one per command
  completions   Print a shell completion script
  help          Print this message or the help of the given subcommand(s)

Options:
  -v, --verbose...  Print more messages: -v for progress, -vv for details
  -q, --quiet       Print errors only
  -h, --help        Print help
  -V, --version     Print version

Exit status: 0 success; 1 the run failed; 2 the job or the command line is invalid
";
    let asked = wavex(&["--help"]);
    assert_eq!(asked, Outcome { code: Some(0), out: expected.to_owned(), err: String::new() });
    let without_a_command = wavex(&[]);
    assert_eq!(without_a_command, Outcome::failure(2, expected));
}

#[test]
fn the_help_of_run_explains_its_options() {
    let help = wavex(&["run", "--help"]);
    assert_eq!((help.code, help.err.as_str()), (Some(0), ""));
    for part in [
        "Usage: wavex run [OPTIONS] <JOB>",
        "Job file (TOML); `-` for standard input",
        "--set <STAGE.KEY=VALUE>",
        "--threads <N>",
        "--profile",
        "--archive <ARCHIVE>",
        "--resume[=<CHECK>]",
        "--progress <WHEN>",
        "- auto:   A bar on a terminal, lines elsewhere",
    ] {
        assert!(help.out.contains(part), "{part}\nis not in\n{}", help.out);
    }
}

#[test]
fn the_version_is_that_of_the_crate() {
    let version = wavex(&["--version"]);
    assert_eq!(version.out, format!("wavex {}\n", env!("CARGO_PKG_VERSION")));
}

#[test]
fn long_version_has_licence_and_features() {
    for words in [&["--version", "--verbose"][..], &["-v", "-V"], &["-vV"]] {
        let details = wavex(words);
        assert_eq!((details.code, details.err.as_str()), (Some(0), ""), "{words:?}");
        assert!(
            details.out.starts_with(&format!("wavex {}\n", env!("CARGO_PKG_VERSION"))),
            "{}",
            details.out
        );
        for part in ["\nlicence: MIT OR Apache-2.0\n", "\nfeatures: ", "\ncommit: ", "\ncompiler: rustc "] {
            assert!(details.out.contains(part), "{part}: {}", details.out);
        }
    }
}

#[test]
fn the_help_of_every_command_ends_with_examples() {
    let help = wavex(&["--help"]).out;
    let commands = help.lines().skip_while(|line| *line != "Commands:").skip(1);
    let commands: Vec<&str> = commands.map_while(|line| line.split_whitespace().next()).collect();
    assert_eq!(commands.len(), 26, "{commands:?}");
    for command in commands.into_iter().filter(|command| *command != "help") {
        let help = wavex(&[command, "--help"]).out;
        let examples = help.split_once("\nExample").map(|(_, examples)| examples).unwrap_or_default();
        assert!(examples.contains(&format!("\n  wavex {command}")), "{command}: {help}");
    }
}

#[test]
fn a_command_line_that_is_wrong_is_refused() {
    for arguments in
        [&["fly"][..], &["run"], &["run", "a.toml", "--progress", "often"], &["check", "-q", "-v", "a.toml"]]
    {
        let outcome = wavex(arguments);
        assert_eq!((outcome.code, outcome.out.as_str()), (Some(2), ""), "{arguments:?}");
        assert!(outcome.err.starts_with("error: "), "{}", outcome.err);
    }
}

/// Job and recording in each other's place.
#[test]
fn a_file_in_the_wrong_place_gets_the_command_for_it() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    fs::write(here.join("x.pls"), b"").unwrap();
    fs::write(here.join("flight.toml"), b"").unwrap();
    fs::write(here.join("notes.csv"), b"").unwrap();
    for (words, expected) in [
        (&["x.pls"][..], "`x.pls` is a recording, not a command; choose one:\n  wavex scan x.pls "),
        (&["flight.toml"], "`flight.toml` is a job, not a command; run it with `wavex run flight.toml`"),
        (&["info", "x.pls"], "there is no command `info`; use `wavex scan x.pls`\n"),
        (
            &["run", "x.pls"],
            "x.pls: it is a recording, not a job; write its job with `wavex init --from x.pls x.toml`",
        ),
        (&["check", "x.pls"], "x.pls: it is a recording, not a job; "),
        (&["run", "x.wvs"], "x.wvs: it holds only the samples of a PulseWaves recording; give x.pls\n"),
        (&["run", "."], ".: it is a folder, not a job; give a job in it, such as ./flight.toml\n"),
        (
            &["run", "flihgt.toml"],
            "flihgt.toml: cannot read the job: No such file or directory (os error 2); did you mean flight.toml?\n",
        ),
        (
            &["scan", "flight.toml"],
            "flight.toml: it is a job, not a recording; run it with `wavex run flight.toml`",
        ),
        (&["convert", "flight.toml", "a.arrow"], "flight.toml: it is a job, not a recording; "),
        (
            &["scan", "."],
            ".: it is a folder, not a recording; give a recording in it; a job reads all by `path = './*.pls'`\n",
        ),
        (&["explain", ".", "--shot", "1"], ".: it is a folder, not a recording; "),
        (&["run", "out_report.json"], "out_report.json: it is JSON, but a job is TOML: "),
        (
            &["trajectory", "x.pls"],
            "x.pls: it is a recording, not a trajectory; `wavex scan x.pls` describes it\n",
        ),
        (&["view", "x.sbet"], "x.sbet: it is a trajectory, not a recording; "),
        (&["init", "x.sbet"], "x.sbet: it is a trajectory, not a recording; "),
        (&["init", "flight9.pls"], "flight9.pls: no such file or folder; check the path\n"),
        (&["init", "x"], "x: the name of a job ends in .toml; for the recording, did you mean x.pls?\n"),
        (&["init", "--from", "x.pls", "y"], "y: the name of a job ends in .toml; write y.toml\n"),
        (&["init", "--from", "x.pls", "."], ".: the name of a job ends in .toml; write ./job.toml\n"),
        (&["view", "nofolder"], "nofolder: no such file or folder; check the path\n"),
        (&["view", "flight"], "flight: no such file or folder; did you mean flight.toml?\n"),
        (&["scan", "x"], "x: no such file or folder; did you mean x.pls?\n"),
        (&["scan", "x.las"], "x.las: no such file or folder; did you mean x.pls?\n"),
        (&["explain", "x.txt", "--shot", "1"], "x.txt: no such file or folder; did you mean x.pls?\n"),
        (&["convert", "x", "x.arrow"], "x: no such file or folder; did you mean x.pls?\n"),
        (&["calibrate", "x"], "x: no such file or folder; did you mean x.pls?\n"),
        (
            &["init", "--from", "x.pls", "y.pls"],
            "x.pls, y.pls: both are recordings; give one, and a name for the job that ends in .toml.",
        ),
        (&["init", "a.toml", "b.toml"], "a.toml, b.toml: both are jobs; give a recording and one job\n"),
        (
            &["init", "--from", "new.toml", "x.pls"],
            "new.toml: --from takes the recording: wavex init --from x.pls new.toml\n",
        ),
        (&["init", "x.csv", "b.toml"], "x.csv: no such file or folder; did you mean x.pls?\n"),
        (
            &["init", "notes.csv", "b.toml"],
            "notes.csv: unknown recording format; supported extensions: .las, .laz, .pls, .plz, .sdf, .wfm, .arrow, .h5, .hdf5 and .spd\n",
        ),
        (
            &["import", "-o", "flight9.pls", "--", "-i", "a.sdf", "-o", "b.laz"],
            "flight9.pls: a job is not written under the name of a recording or a folder; end its name in .toml\n",
        ),
    ] {
        let outcome = wavex_in(here, words);
        assert_eq!((outcome.code, outcome.out.as_str()), (Some(2), ""), "{words:?}: {}", outcome.err);
        assert!(outcome.err.starts_with(&format!("error: {expected}")), "{words:?}: {}", outcome.err);
    }
    assert_eq!(fs::read_dir(here).unwrap().count(), 3, "nothing is written");
}

#[test]
fn options_of_other_programs_are_answered_with_a_tip() {
    for (words, tip) in [
        (
            &["run", "a.toml", "-o", "out"][..],
            "  tip: `path` of the job's writers names the outputs; for another folder: --set job.output_dir=FOLDER\n",
        ),
        (&["-i", "a.sdf"], "a command line of BayesWavEx is translated by `wavex import -- -i a.sdf`\n"),
    ] {
        let outcome = wavex(words);
        assert_eq!(outcome.code, Some(2));
        assert!(outcome.err.contains(tip), "{words:?}: {}", outcome.err);
    }
}

#[test]
fn jobs_in_utf_16_get_the_remedy() {
    let folder = tempfile::tempdir().unwrap();
    let text: Vec<u8> = "\u{feff}[job]\n".encode_utf16().flat_map(u16::to_le_bytes).collect();
    let expected = "error: a.toml: cannot read the job: it is UTF-16 text, as `>` of Windows PowerShell writes; save it as UTF-8, \
                    or let wavex write the file: `wavex init RECORDING JOB.toml`\n";
    for text in [&text[..], &text[2..]] {
        fs::write(folder.path().join("a.toml"), text).unwrap();
        refused(wavex_in(folder.path(), &["run", "a.toml"]), expected);
    }
    // A byte order mark of UTF-8 is no error.
    fs::write(folder.path().join("a.toml"), "\u{feff}[[stage]]\ntype = 'simulate'\n").unwrap();
    assert_eq!(wavex_in(folder.path(), &["check", "a.toml"]).code, Some(0));
}

#[test]
fn a_job_that_cannot_be_read_is_refused() {
    let outcome = wavex(&["run", "no/such/job.toml"]);
    assert_eq!((outcome.code, outcome.out.as_str()), (Some(2), ""));
    assert!(outcome.err.starts_with("error: no/such/job.toml: cannot read the job: "), "{}", outcome.err);
}

#[test]
fn a_wrong_job_is_refused_in_plain_text() {
    let folder = tempfile::tempdir().unwrap();
    let job = folder.path().join("job.toml");
    fs::write(&job, "[job]\nmemory_mb = 8\n").unwrap();
    let job = job.to_str().unwrap();
    let expected = format!(
        "error: the job has no stage\n--> {job}\n = help: `wavex init` writes a starter job; `wavex stages` lists the stages\n\n\
         error: `memory_mb` must be at least 64 and at most 1000000000, got 8\n \
         --> {job}:2:13\n  |\n2 | memory_mb = 8\n  |             ^\n"
    );
    for command in ["run", "check"] {
        refused(wavex(&[command, job]), &expected);
    }
}

#[test]
fn a_job_may_come_from_standard_input() {
    let expected = "\
error: `threads` must be at least 0 and at most 65535, got -1
 --> standard input:4:11
  |
4 | threads = -1
  |           ^^
";
    let outcome = wavex_with_input(&["check", "-"], "[[stage]]\ntype = \"read_las\"\n[job]\nthreads = -1\n");
    assert_eq!((outcome.code, outcome.out.as_str()), (Some(2), ""));
    assert!(outcome.err.contains(expected), "{}", outcome.err);
}

#[test]
fn values_set_on_the_command_line_are_checked_like_those_of_the_job() {
    let outcome = wavex(&["run", "-", "--set", "job.thread=2", "--threads", "4"]);
    let expected = "\
error: `[job]` has no key `thread`
 --> --set:1:5
  |
1 | job.thread=2
  |     ^^^^^^
  |
  = help: did you mean `threads`?
  = help: keys: include, threads, memory_mb, input_dir, output_dir, channel_capacity, simd, report, report_page, survey_page, stat_log, log, on_error, inputs_at_once, model, survey_model, geometry, survey
";
    assert_eq!(outcome.code, Some(2));
    assert!(outcome.err.ends_with(expected), "{}", outcome.err);
}

#[test]
fn the_stages_of_the_registry_are_listed_and_explained() {
    let listed = wavex(&["stages"]);
    assert_eq!((listed.code, listed.err.as_str()), (Some(0), ""));
    assert_eq!(listed.out.lines().count(), wavex::registry::STAGES.len());
    for spec in wavex::registry::STAGES {
        assert!(listed.out.lines().any(|line| line.starts_with(spec.name)), "{}", listed.out);
        assert_eq!(wavex(&["stages", spec.name]).out, wavex::job::manual_of(spec));
    }
}

#[test]
fn a_stage_that_does_not_exist_is_refused() {
    let outcome = wavex(&["stages", "fly_home"]);
    assert_eq!((outcome.code, outcome.out.as_str()), (Some(2), ""));
    assert!(outcome.err.starts_with("error: unknown stage `fly_home`"), "{}", outcome.err);
}

#[test]
fn the_schema_is_json() {
    let outcome = wavex(&["schema"]);
    assert_eq!((outcome.code, outcome.err.as_str()), (Some(0), ""));
    let schema: serde_json::Value = serde_json::from_str(&outcome.out).unwrap();
    assert_eq!(schema, wavex::job::job_schema(wavex::registry::STAGES));
}

#[test]
fn a_job_to_start_from_is_printed_or_written_and_replaces_nothing() {
    let printed = wavex(&["init"]);
    assert_eq!((printed.code, printed.err.as_str()), (Some(0), ""));
    assert_eq!(printed.out, wavex::job::example_job(wavex::registry::STAGES));

    let folder = tempfile::tempdir().unwrap();
    let [file, schema] = ["job.toml", "job.schema.json"].map(|name| folder.path().join(name));
    let (file, schema) = (file.to_str().unwrap(), schema.to_str().unwrap());
    let written = wavex(&["init", file]);
    let remark = "the job reads RECORDING.las: edit `type` and `path` of the first stage, or use `wavex init RECORDING JOB.toml`\n";
    let expected = format!("wrote {file}\nwrote {schema}\n{remark}");
    assert_eq!(written, Outcome { code: Some(0), out: expected, err: String::new() });
    assert_eq!(fs::read_to_string(file).unwrap(), printed.out);
    assert_eq!(fs::read_to_string(schema).unwrap(), wavex(&["schema"]).out);
    assert!(printed.out.starts_with("#:schema job.schema.json\n"), "{}", printed.out);
    let checked = wavex(&["check", file]);
    assert_eq!((checked.code, checked.err.as_str()), (Some(0), ""));
    let warning = format!("  warning: {}: no such file\n", folder.path().join("RECORDING.las").display());
    assert!(checked.out.contains(&warning), "{}", checked.out);

    fs::write(file, "mine").unwrap();
    let expected = format!("error: {file}: the file already exists; choose another name\n");
    refused(wavex(&["init", file]), &expected);
    assert_eq!(fs::read_to_string(file).unwrap(), "mine");
}

#[test]
fn an_input_of_an_unknown_kind_is_not_converted() {
    let expected = "error: flight.dat: unknown recording format; \
                    supported extensions: .las, .laz, .pls, .plz, .sdf, .wfm, .arrow, .h5, .hdf5 and .spd\n";
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("flight.dat"), b"").unwrap();
    refused(wavex_in(folder.path(), &["convert", "flight.dat", "flight.arrow"]), expected);
}

#[test]
fn large_footprints_are_not_decomposed() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("a.h5"), b"").unwrap();
    let Outcome { code, err, .. } =
        wavex_in(folder.path(), &["calibrate", "a.h5", "--save-preset", "a.json"]);
    assert_eq!(code, Some(2), "{err}");
    let begins = "error: a.h5: its waveforms are profiles of large footprints, ";
    assert!(err.starts_with(begins) && err.contains("`wavex init a.h5 job.toml` writes a job"), "{err}");
}

#[test]
fn a_container_has_the_name_of_what_it_is() {
    let expected = "error: flight.parquet: the container is Arrow; give a name that ends in .arrow. To write tables of returns (Parquet, CSV or Arrow), use the stage write_table in a job\n";
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("flight.pls"), b"").unwrap();
    refused(wavex_in(folder.path(), &["convert", "flight.pls", "flight.parquet"]), expected);
}

#[test]
fn a_format_that_cannot_be_read_is_named_with_the_way_round_wherever_it_is_tried() {
    for (file, problem) in [
        ("flight.rxp", "RIEGL RXP is not supported; export the waveforms with RIEGL's software "),
        (
            "flight.f5",
            "F5, the layout of HydroVISH in HDF5, is not supported; copy its waveforms into the open waveform container ",
        ),
        (
            "flight.wvs",
            "it holds only the samples of a PulseWaves recording; give the .pls or .plz of the same name",
        ),
        (
            "flight.wdp",
            "it holds only the waveform packets of a LAS recording; give the .las or .laz of the same name",
        ),
        (
            "flight.sbet",
            "it is a trajectory, not a recording; give the recording, and name the trajectory in the job",
        ),
        ("flight.zip", "it is a compressed file or an archive; unpack it and give a recording in it"),
    ] {
        for words in [
            &["convert", file, "a.arrow"][..],
            &["scan", file],
            &["explain", file, "--shot", "1"],
            &["init", file],
            &["view", file],
            &["calibrate", file],
        ] {
            let outcome = wavex(words);
            assert_eq!((outcome.code, outcome.out.as_str()), (Some(2), ""), "{words:?}");
            let begins = format!("error: {file}: {problem}");
            assert!(outcome.err.starts_with(&begins), "{words:?}: {}", outcome.err);
        }
        let job = format!("[job]\nlog = ''\n[[stage]]\ntype = 'read_las'\npath = '{file}'\n");
        let run = wavex_with_input(&["run", "-"], &job);
        assert!(run.code == Some(1) && run.err.contains(&format!("{file}: {problem}")), "{}", run.err);
        let checked = wavex_with_input(&["check", "-"], &job);
        assert!(checked.code == Some(0) && checked.out.contains(problem), "{}", checked.out);
    }
}

#[test]
fn completions_are_those_of_the_shell() {
    for (shell, begins) in [("bash", "_wavex() {"), ("zsh", "#compdef wavex"), ("fish", "# Print an optspec")]
    {
        let outcome = wavex(&["completions", shell]);
        assert_eq!((outcome.code, outcome.err.as_str()), (Some(0), ""), "{shell}");
        assert!(outcome.out.starts_with(begins), "{shell}: {}", outcome.out);
    }
}

#[test]
fn manual_pages_are_one_per_command() {
    let folder = tempfile::tempdir().unwrap();
    let outcome = wavex_in(folder.path(), &["--quiet", "man", "share/man1"]);
    assert_eq!((outcome.code, outcome.err.as_str()), (Some(0), ""));
    let page = |name: &str| fs::read_to_string(folder.path().join("share/man1").join(name)).unwrap();
    assert!(page("wavex.1").contains("wavex\\-run(1)"), "{}", page("wavex.1"));
    let run = page("wavex-run.1");
    assert!(run.starts_with(".ie") && run.contains(".TH wavex-run 1"), "{run}");
    assert!(run.contains("\\-\\-archive"), "{run}");

    fs::write(folder.path().join("file"), "").unwrap();
    let outcome = wavex_in(folder.path(), &["man", "file/man1"]);
    assert_eq!(outcome.code, Some(1));
    let error = "error: file/man1: cannot write the manual pages: Not a directory (os error 20); choose another folder\n";
    assert_eq!(outcome.err, error);
}

#[test]
fn the_doctor_states_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    let outcome = outcome(
        wavex_testkit::wavex().arg("doctor").env_remove("WAVEX_RIWAVELIB").current_dir(folder.path()),
    );
    assert_eq!((outcome.code, outcome.err.as_str()), (Some(0), ""));
    for subject in ["wavex", "instructions", "cores", "memory", "disk", "RIEGL library", "PROJ"] {
        let state = |line: &str| line.starts_with("ok") || line.starts_with("note");
        let of_subject = |line: &&str| line.get(9..).is_some_and(|rest| rest.starts_with(subject));
        assert!(outcome.out.lines().find(of_subject).is_some_and(state), "{subject}: {}", outcome.out);
    }
    let named = wavex_testkit::wavex().arg("doctor").env("WAVEX_RIWAVELIB", "none.so").output().unwrap();
    let text = String::from_utf8(named.stdout).unwrap();
    assert!(text.contains("the environment variable WAVEX_RIWAVELIB names, cannot be loaded"), "{text}");
}

#[cfg(unix)]
#[test]
fn a_reader_that_has_seen_enough_is_no_failure() {
    let mut program = wavex_testkit::wavex();
    let mut child = program.args(["completions", "zsh"]).stdout(Stdio::piped()).spawn().unwrap();
    drop(child.stdout.take());
    assert_eq!(child.wait().unwrap().code(), Some(0));
}

/// Folder with a job whose `crs` is the WKT in `zone.prj`.
fn place_with_wkt(wkt: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let job = "[job]\noutput_dir = 'out'\ngeometry = { crs = 'zone.prj' }\n\
               [[stage]]\ntype = 'simulate'\nlines = 1\nshots_per_line = 10\n[[stage]]\ntype = 'write_arrow'\n";
    fs::write(folder.path().join("job.toml"), job).unwrap();
    fs::write(folder.path().join("zone.prj"), wkt).unwrap();
    folder
}

fn wavex_in(folder: &std::path::Path, arguments: &[&str]) -> Outcome {
    outcome(wavex_testkit::wavex().args(arguments).current_dir(folder))
}

/// The projection library takes missing parameters as 0.
#[test]
fn a_system_with_missing_parameters_is_a_wrong_job() {
    let parameters = |names: &[&str]| -> String {
        names.iter().map(|name| format!(r#"PARAMETER["{name}",1],"#)).collect::<String>()
    };
    let centred = ["latitude_of_center", "longitude_of_center"];
    for (method, given, missing) in [
        ("Krovak", &centred[..], "azimuth, scale_factor, false_easting, false_northing"),
        ("Mercator_1SP", &["scale_factor", "false_easting"], "central_meridian, false_northing"),
        (
            "Stereographic",
            &["latitude_of_origin", "false_easting", "false_northing"],
            "central_meridian, scale_factor or standard_parallel_1",
        ),
        ("Polyconic", &["false_easting"], "latitude_of_origin, central_meridian, false_northing"),
    ] {
        let wkt = format!(
            r#"PROJCS["local",GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.257223563]],PRIMEM["Greenwich",0],UNIT["degree",0.0174532925199433]],PROJECTION["{method}"],{}UNIT["metre",1]]"#,
            parameters(given)
        );
        let folder = place_with_wkt(&wkt);
        let expected = format!(
            "error: ./zone.prj: local: its projection has no {missing}; complete the parameters in its WKT, or use an EPSG \
             code\n"
        );
        for command in ["check", "run"] {
            refused(wavex_in(folder.path(), &[command, "job.toml"]), &expected);
        }
        assert!(!folder.path().join("out").exists(), "a wrong job makes nothing");
    }
}

#[test]
fn a_system_in_another_spelling_is_a_wrong_job() {
    for (word, meant) in [("25832", "EPSG:25832"), ("WGS84", "geodetic"), ("EPSG:2956+6647", "EPSG:2956")] {
        let folder = place_with_wkt("");
        let path = folder.path().join("job.toml");
        fs::write(&path, fs::read_to_string(&path).unwrap().replace("zone.prj", word)).unwrap();
        for command in ["check", "run"] {
            let Outcome { code, err, .. } = wavex_in(folder.path(), &[command, "job.toml"]);
            let is_said = err.starts_with(&format!("error: `geometry.crs`: crs `{word}`: "))
                && err.contains(&format!("; write `{meant}`\n"));
            assert!(code == Some(2) && is_said, "{err}");
        }
    }
}

/// A word without extension is the name of a system, not a file.
#[test]
fn an_unknown_system_and_a_missing_file_are_told_apart() {
    let folder = place_with_wkt("");
    let path = folder.path().join("job.toml");
    let text = fs::read_to_string(&path).unwrap();
    fs::write(&path, text.replace("zone.prj", "Lambert93")).unwrap();
    for command in ["check", "run"] {
        let Outcome { code, err, .. } = wavex_in(folder.path(), &[command, "job.toml"]);
        let expected = "error: crs `Lambert93`: it is neither a known system nor a file; write `utm`";
        assert!(code == Some(2) && err.starts_with(expected), "{err}");
    }
    fs::write(&path, text.replace("zone.prj", "EPSG2154.prj")).unwrap();
    let Outcome { code, out, .. } = wavex_in(folder.path(), &["check", "job.toml"]);
    assert!(code == Some(0) && out.contains("EPSG2154.prj: no such file\n"), "{out}");
}

/// A shared file may set the geoid folder, also for jobs without a geoid.
#[test]
fn a_shared_file_may_name_the_folder_of_geoids() {
    let folder = tempfile::tempdir().unwrap();
    let job = "[job]\ninclude = 'base.toml'\noutput_dir = 'out'\n\
               [[stage]]\ntype = 'simulate'\nlines = 1\nshots_per_line = 10\n[[stage]]\ntype = 'write_arrow'\n";
    fs::write(folder.path().join("job.toml"), job).unwrap();
    fs::write(folder.path().join("base.toml"), "[job.geometry]\ngeoid_dir = 'geoids'\n").unwrap();
    let checked = wavex_in(folder.path(), &["check", "job.toml"]);
    assert_eq!((checked.code, checked.err.as_str()), (Some(0), ""));
    assert!(
        checked.out.starts_with("./job.toml is valid\n") || checked.out.starts_with("job.toml is valid\n")
    );
    assert!(!checked.out.contains("warning"), "{}", checked.out);
    let run = wavex_in(folder.path(), &["--quiet", "run", "job.toml"]);
    assert_eq!(run, Outcome::success());
    assert!(folder.path().join("out/simulated.arrow").is_file());
}
