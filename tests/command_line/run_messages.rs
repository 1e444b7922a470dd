//! Messages of `wavex run`: warnings, progress and the end of a run.

use wavex_testkit::TestFolder;

/// A job over a simulated flight in the scanner frame, without its trajectory.
const WITHOUT_TRAJECTORY: &str = "\
[job]
output_dir = 'out'
[[stage]]
type = 'simulate'
stem = 'flight'
sbet = '*.out'
lines = 4
shots_per_line = 300
[[stage]]
type = 'resolve_mta'
[[stage]]
type = 'fuse_channels'
[[stage]]
type = 'calibrate'
waveforms = 300
[[stage]]
type = 'decompose'
[[stage]]
type = 'correct'
range_table = false
amplitude_table = false
width_correction_low = false
[[stage]]
type = 'georeference'
[[stage]]
type = 'write_las'
[[stage]]
type = 'write_trajectory'
path = '*_path.txt'
";

fn place() -> TestFolder {
    TestFolder::with(&[("flight.toml", WITHOUT_TRAJECTORY.as_bytes())])
}

/// Lines of `text` that contain `part`.
fn lines_with<'t>(text: &'t str, part: &str) -> Vec<&'t str> {
    text.lines().filter(|line| line.contains(part)).collect()
}

#[test]
fn outputs_of_another_job_are_named_before_they_are_replaced() {
    let job = b"[job]\noutput_dir = 'out'\n[[stage]]\ntype = 'simulate'\nlines = 1\n[[stage]]\ntype = 'write_arrow'\npath = '*.arrow'\n";
    let place = TestFolder::with(&[("a.toml", job), ("b.toml", job)]);
    let warnings = |name: &str| -> Vec<String> {
        let run = place.wavex(&["run", name]);
        assert_eq!(run.code, Some(0), "{}", run.err);
        lines_with(&run.err, "replaces").into_iter().map(str::to_owned).collect()
    };
    assert!(warnings("a.toml").is_empty() && warnings("a.toml").is_empty(), "its own outputs");
    for (job, other) in [("b.toml", "a"), ("a.toml", "b")] {
        let [warning] = &warnings(job)[..] else { panic!("{job}") };
        assert!(
            warning
                .contains("if it succeeds, the run replaces outputs of another job: simulated.arrow, which ")
                && warning
                    .ends_with(&format!("{other}_report.json describes; give each job its own `output_dir`")),
            "{warning}"
        );
    }
    assert!(warnings("a.toml").is_empty(), "its own outputs again");
}

#[test]
fn a_missing_trajectory_is_one_warning_with_its_consequences() {
    let place = place();
    let run = place.wavex(&["run", "flight.toml"]);
    assert_eq!(run.code, Some(0), "{}", run.err);
    let warnings = lines_with(&run.err, "WARN");
    assert_eq!(warnings.len(), 1, "{}", run.err);
    assert!(
        warnings[0].contains("not georeferenced") && warnings[0].contains("`trajectory`"),
        "{}",
        warnings[0]
    );
    let consequences = "without a trajectory: intensities are not corrected for incidence; the LAS file has no \
                        coordinate reference system; the path of the sensor has no rows";
    assert_eq!(lines_with(&run.out, "without a trajectory"), [consequences]);
    let log = place.text("out/flight.log");
    assert_eq!(lines_with(&log, "without a trajectory").len(), 3, "{log}");
    let report = place.text("out/flight_report.json");
    assert!(report.contains("\"without a trajectory\""), "{report}");
}

#[test]
fn the_end_of_a_run_is_results_files_and_the_next_command() {
    let place = place();
    let run = place.wavex(&["run", "flight.toml", "--progress=never"]);
    let lines: Vec<&str> = run.out.lines().collect();
    let (first, last) = (lines[0], lines[lines.len() - 1]);
    assert!(
        first.starts_with("flight: ") && first.contains(" returns in ") && first.ends_with("shots/s)"),
        "{first}"
    );
    assert_eq!(last, "look: wavex view out");
    let between = &lines[1..lines.len() - 1];
    let is_known = |line: &&str| {
        ["without a trajectory", "wrote ", "decompose: rejected "].iter().any(|start| line.starts_with(start))
    };
    assert!(between.iter().all(is_known), "{}", run.out);
    assert!(!run.out.contains("working s"));
    // Beside the report of another job, it names the report.
    place.write("other.toml", WITHOUT_TRAJECTORY.replace("'flight'", "'other'").as_bytes());
    let other = place.wavex(&["run", "other.toml", "--progress=never"]);
    assert_eq!(other.out.lines().last(), Some("look: wavex view out/other_report.json"));
    // The table of stages is for who asks for it.
    for more in ["-v", "--profile"] {
        let run = place.wavex(&["run", "flight.toml", more]);
        assert!(run.out.contains("working s") && run.out.contains("<- bottleneck"), "{more}: {}", run.out);
    }
}

#[test]
fn several_inputs_have_a_line_each() {
    let convert = "[job]\nreport = ''\nlog = ''\nstat_log = ''\n[[stage]]\ntype = 'simulate'\nlines = 2\nshots_per_line = 200\n\
                   [[stage]]\ntype = 'write_arrow'\npath = '*.arrow'\n";
    let survey = "[job]\noutput_dir = 'out'\nsurvey_page = true\n[[stage]]\ntype = 'read_arrow'\npath = '?.arrow'\n\
                  [[stage]]\ntype = 'calibrate'\nwaveforms = 200\n[[stage]]\ntype = 'decompose'\n[[stage]]\n\
                  type = 'georeference'\n[[stage]]\ntype = 'write_las'\n";
    let place = TestFolder::with(&[("convert.toml", convert.as_bytes()), ("survey.toml", survey.as_bytes())]);
    for stem in ["a", "b"] {
        let made = place.wavex(&["run", "convert.toml", "--set", &format!("simulate.stem={stem}")]);
        assert_eq!(made.code, Some(0), "{}", made.err);
    }
    let run = place.wavex(&["run", "survey.toml"]);
    assert_eq!(run.code, Some(0), "{}", run.err);
    for stem in ["a", "b"] {
        assert_eq!(lines_with(&run.out, &format!("{stem}     done ")).len(), 1, "{}", run.out);
    }
    // The name of the job is not repeated, and all files of the survey are listed.
    assert!(
        run.out.contains("wrote out/survey.html\n") && run.out.contains("wrote out/survey.json\n"),
        "{}",
        run.out
    );
    assert!(run.out.contains(" files of the inputs to out (-v lists them)\n"), "{}", run.out);
    let all = place.wavex(&["run", "survey.toml", "-v"]);
    let listed = lines_with(&all.out, "wrote ").len();
    assert_eq!(listed, place.outputs().len(), "{}\n{:?}", all.out, place.outputs());
}

#[test]
fn a_failed_run_names_its_report() {
    let place = TestFolder::new();
    let job = "[job]\noutput_dir = 'out'\n[[stage]]\ntype = 'read_las'\npath = 'none.las'\n[[stage]]\ntype = 'write_arrow'\n";
    place.write("out/kept.txt", b"");
    place.write("job.toml", job.as_bytes());
    let run = place.wavex(&["run", "job.toml", "--progress", "never"]);
    assert_eq!(
        (run.code, run.out.as_str()),
        (Some(1), "report of the failed run: out/job_report.json\n"),
        "{}",
        run.err
    );
    // A pattern without matches begins no input.
    let run = place.wavex(&["run", "job.toml", "--progress", "never", "--set", "read_las.path=*.las"]);
    assert_eq!((run.code, run.out.as_str()), (Some(1), ""), "{}", run.err);
    let run = place.wavex(&["run", "job.toml", "-q"]);
    assert_eq!((run.code, run.out.as_str()), (Some(1), ""), "{}", run.err);
}

#[cfg(not(windows))]
#[test]
fn outputs_with_a_drive_of_windows_are_named() {
    let place = TestFolder::new();
    let job = "[[stage]]\ntype = 'simulate'\nlines = 1\nshots_per_line = 10\n[[stage]]\ntype = 'write_arrow'\npath = 'a.arrow'\n";
    place.write("job.toml", job.as_bytes());
    let of = |set: &str, name: &str, path: &str, becomes: &str| {
        let note = format!(
            "`{name}`: the output {path} is a path of Windows: here it becomes a {becomes}; write a path of this system"
        );
        let checked = place.wavex(&["check", "job.toml", "--set", set]);
        assert!(checked.out.contains(&format!("  note:   {note}\n")), "{}", checked.out);
    };
    of("write_arrow.path=C:/data/a.arrow", "write_arrow", "C:/data/a.arrow", "folder `C:`");
    of("write_arrow.path=C:\\data\\a.arrow", "write_arrow", "C:\\data\\a.arrow", "file of this name");
    of("job.output_dir=d:\\data", "job", "d:\\data", "folder `d:\\data`");
    let run =
        place.wavex(&["run", "job.toml", "--progress", "never", "--set", "write_arrow.path=C:/data/a.arrow"]);
    assert_eq!(lines_with(&run.err, "is a path of Windows").len(), 1, "{}", run.err);
    let checked = place.wavex(&["check", "job.toml", "--set", "write_arrow.path=C/a.arrow"]);
    assert!(!checked.out.contains("Windows"), "{}", checked.out);
}
