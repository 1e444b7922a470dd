//! Outputs of a run where a command takes other files: the answer is the command that shows them.

use wavex_testkit::{Outcome, TestFolder};

/// The outputs of a run, in `out`: a page, a report and points.
fn outputs() -> TestFolder {
    let place = TestFolder::new();
    let job = "report_page = true\n[[stage]]\ntype = 'simulate'\nstem = 'flight'\nlines = 2\nshots_per_line = 300\n\
               [[stage]]\ntype = 'calibrate'\n[[stage]]\ntype = 'decompose'\n[[stage]]\ntype = 'georeference'\n\
               [[stage]]\ntype = 'write_las'\npath = '*.laz'\n";
    assert_eq!(place.run(job), Outcome::success());
    place
}

/// Asserts that a command line fails with this message.
#[track_caller]
fn refused(place: &TestFolder, line: &str, message: &str) {
    let words: Vec<&str> = line.split(' ').collect();
    let Outcome { code, out, err } = place.wavex(&words);
    assert!(code != Some(0) && out.is_empty(), "{line}: {out}");
    assert_eq!(err, format!("error: {message}\n"), "{line}");
}

#[test]
fn outputs_of_a_run_get_the_command_that_shows_them() {
    let place = outputs();
    let see = "`wavex view out` shows";
    for (line, message) in [
        (
            "run .",
            ".: it is a folder, not a job; give a job in it, such as ./job.toml; to see the outputs of a run, use \
             `wavex view ./out`"
                .to_owned(),
        ),
        ("view .", ".: no report of a run in this folder; give ./out, which has one".to_owned()),
        ("report .", ".: no report of a run in this folder; give ./out, which has one".to_owned()),
        ("scan out", format!("out: it is a folder, not a recording; {see} the outputs of a run in it")),
        ("init --from out", format!("out: it is a folder, not a recording; {see} the outputs of a run in it")),
    ] {
        refused(&place, line, &message);
    }
    let points =
        format!("out/flight.laz: points without waveforms; {see} the run in this folder with its waveforms");
    for line in [
        "scan out/*.laz",
        "explain out/flight.laz --shot 1",
        "init out/flight.laz",
        "convert out/flight.laz a.arrow",
        "calibrate out/flight.laz",
    ] {
        refused(&place, line, &points);
    }
    let page = "out/job_report.html: it is a page; open it in a browser, or give out/job_report.json, the report of its run";
    refused(&place, "view --no-open out/job_report.html", page);
    refused(&place, "report out/job_report.html", page);
    // The JSON of a survey's page is no report.
    place.write("out/job_survey.html", b"");
    place.write("out/job_survey.json", b"{}");
    let page = "out/job_survey.html: it is a page; open it in a browser, or give out, the folder of its run";
    refused(&place, "view --no-open out/job_survey.html", page);
    place.write("a_scan.html", b"");
    refused(&place, "view --no-open a_scan.html", "a_scan.html: it is a page; open it in a browser");
}

#[test]
fn the_report_of_a_job_is_found() {
    let place = outputs();
    let page = place.text("out/job_report.html");
    std::fs::remove_file(place.path("out/job_report.html")).unwrap();
    place.write("out/b_report.json", b"{}");
    let several = "out: several reports in this folder: b_report.json and job_report.json; give the report or the job of a run";
    refused(&place, "report out", several);
    let message = "out/flight.laz: points without waveforms; `wavex view` shows a run in this folder with its waveforms; \
                   give its report: out/b_report.json or out/job_report.json";
    refused(&place, "scan out/flight.laz", message);
    let Outcome { code, out, err } = place.wavex(&["report", "job.toml"]);
    assert_eq!((code, out.as_str(), err.as_str()), (Some(0), "wrote out/job_report.html\n", ""));
    assert_eq!(place.text("out/job_report.html"), page);
    std::fs::remove_file(place.path("out/job_report.json")).unwrap();
    let message = "job.toml: the job has no report of a run; run it with `wavex run job.toml`";
    refused(&place, "report job.toml", message);
    place.write("job.toml", b"[job]\nreport = ''\n[[stage]]\ntype = 'simulate'\n");
    let message = "job.toml: the job writes no report; set `report` in `[job]`, and run it";
    refused(&place, "report job.toml", message);
}

#[test]
fn a_report_of_another_name_gets_those_of_the_folder() {
    let place = outputs();
    let message = "out/flight_report.json: no such report; reports are named by the job; did you mean out/job_report.json?";
    refused(&place, "report out/flight_report.json", message);
}

#[test]
fn a_report_tells_that_outputs_or_job_were_changed() {
    let place = outputs();
    let warnings = |argument: &str| place.wavex(&["report", argument]).err;
    assert_eq!(warnings("job.toml"), "");
    let job = place.text("job.toml");
    place.write("job.toml", job.replace("lines = 2", "lines = 9").as_bytes());
    let changed = "job.toml: the job differs from that of the run in out/job_report.json: it was changed, or run \
                   with `--set`; run it again\n";
    assert!(warnings("job.toml").ends_with(changed), "{}", warnings("job.toml"));
    assert_eq!(warnings("out"), "");
    place.write("out/flight.laz", b"LASF");
    let changed =
        "out/flight.laz was changed after the run that out/job_report.json describes; run the job again\n";
    assert!(warnings("out").ends_with(changed), "{}", warnings("out"));
}

#[test]
fn a_missing_file_of_a_job_gets_the_file_that_was_meant() {
    let place = TestFolder::with(&[("fligth.pls", b""), ("flight.toml", b""), ("mount.sbet", b"")]);
    let warnings = |path: &str| {
        let job = format!(
            "[[stage]]\ntype = 'read_pulsewaves'\npath = '{path}'\n[[stage]]\ntype = 'write_arrow'\n"
        );
        place.write("a.toml", job.as_bytes());
        place.wavex(&["check", "a.toml"]).out
    };
    let said = warnings("flight.pls");
    assert!(
        said.contains("flight.pls: no such file; did you mean ") && said.contains("fligth.pls?\n"),
        "{said}"
    );
    let said = warnings("lines.pls");
    assert!(said.contains("lines.pls: no such file\n"), "{said}");
    if !cfg!(windows) {
        let said = warnings("D:\\new\\lines.pls");
        assert!(
            said.contains(": no such file; it is a path of Windows: write a path of this system\n"),
            "{said}"
        );
        let path = "D:\\new\\lines.pls";
        let message =
            format!("{path}: no such file or folder; it is a path of Windows: write a path of this system");
        refused(&place, &format!("scan {path}"), &message);
    }
}

#[test]
fn a_recording_has_no_report() {
    let place = TestFolder::with(&[("a.laz", b"LASF")]);
    let message = "error: a.laz: it is a recording or the points of a run; give the report of a run, its job or its folder\n";
    assert_eq!(place.wavex(&["report", "a.laz"]), Outcome::failure(2, message));
}
