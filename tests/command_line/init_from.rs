//! `wavex init --from` and `wavex calibrate` on existing recordings.

use std::fs;

use wavex_testkit::flight::sbet;
use wavex_testkit::las::Las;
use wavex_testkit::pulsewaves::PulseWaves;
use wavex_testkit::{Outcome, TestFolder, data};

/// Job for a recording of a folder; must pass `check`, without a warning but for the library of SDF.
#[track_caller]
fn job_for(place: &TestFolder, recording: &str) -> String {
    let job = "flight.toml";
    let _ = fs::remove_file(place.path(job));
    let Outcome { code, out, err } = place.wavex(&["init", "--from", recording, job]);
    // A recording may have copies of waveforms, which are a warning.
    let is_clean = err.lines().all(|line| line.contains("byte-identical copies"));
    assert!(code == Some(0) && is_clean, "{recording}: {err}");
    assert!(out.starts_with("wrote flight.toml\n"), "{out}");
    let Outcome { code, out, err } = place.wavex(&["check", job]);
    assert_eq!((code, err.as_str()), (Some(0), ""), "{recording}");
    let warnings: Vec<&str> = out.lines().filter(|line| line.trim_start().starts_with("warning:")).collect();
    // RIEGL's library is not on machines of tests, and check says so.
    let is_sdf = recording.ends_with(".sdf");
    let is_of_library = |warning: &&str| warning.contains("needs RIEGL's Waveform Extraction Library");
    assert!(out.starts_with("flight.toml is valid"), "{out}");
    assert!(warnings.iter().all(is_of_library) && warnings.len() == usize::from(is_sdf), "{out}");
    place.text(job)
}

/// Stages of a job, in order.
fn stages(text: &str) -> Vec<String> {
    let table: toml::Table = toml::from_str(text).unwrap();
    let stages = table["stage"].as_array().unwrap().iter();
    stages.map(|stage| stage["type"].as_str().unwrap().to_owned()).collect()
}

#[test]
fn las_and_pulsewaves_have_their_jobs() {
    let (las, pulsewaves) = (Las::new(3), PulseWaves::new(3));
    let place = TestFolder::with(&[
        ("in/a.las", &las.las()),
        ("in/a.wdp", &las.packets),
        ("b.pls", &pulsewaves.pls()),
        ("b.wvs", &pulsewaves.waves),
        ("c.sdf", b"not opened"),
        ("c.POF", &sbet([1.0, 2.0])),
    ]);
    let text = job_for(&place, "in/a.las");
    assert!(text.starts_with("#:schema job.schema.json\n\n# For in/a.las: LAS 1."), "{text}");
    assert!(text.contains("\ntype = \"read_las\"\npath = \"in/a.las\"\n"), "{text}");
    assert!(text.contains("#   wavex run flight.toml"), "{text}");
    assert_eq!(stages(&text)[..3], ["read_las", "calibrate", "decompose"]);
    let descriptions = text.lines().filter(|line| line.starts_with("#   wavex ")).map(|line| {
        let description =
            line.find("    ").map(|end| end + line[end..].find(|letter| letter != ' ').unwrap());
        description.unwrap()
    });
    assert_eq!(descriptions.collect::<Vec<_>>(), [31; 3], "{text}");
    let text = job_for(&place, "b.pls");
    assert!(text.contains("\ntype = \"read_pulsewaves\"\npath = \"b.pls\"\n"), "{text}");
    let text = job_for(&place, "c.sdf");
    assert!(text.contains("\ntype = \"read_sdf\"\npath = \"c.sdf\"\n"), "{text}");
    assert!(
        text.contains("\ntrajectory = \"c.POF\"\ncrs") || text.contains("\ntrajectory = \"c.POF\"\n"),
        "{text}"
    );
    assert_eq!(stages(&text)[..5], ["read_sdf", "resolve_mta", "fuse_channels", "calibrate", "decompose"]);
    // A job in another folder, which is created, also finds the recording.
    let Outcome { code, err, .. } = place.wavex(&["-q", "init", "--from", "b.pls", "jobs/b.toml"]);
    assert_eq!((code, err.as_str()), (Some(0), ""));
    let Outcome { out, .. } = place.wavex(&["check", "jobs/b.toml"]);
    assert!(!out.contains("warning"), "{out}");
    assert!(place.path("jobs/job.schema.json").is_file());
}

/// A simulated container: as recorded with a trajectory, or in map coordinates.
fn simulated(keys: &str) -> TestFolder {
    let place = TestFolder::new();
    let job = format!(
        "[[stage]]\ntype = 'simulate'\nstem = 'a'\nlines = 4\nshots_per_line = 100\n{keys}\n[[stage]]\ntype = 'write_arrow'\n"
    );
    assert_eq!(place.run(&job), Outcome::success());
    place
}

#[test]
fn a_container_is_raw_or_lies_in_a_map() {
    let place = simulated("as_recorded = true\npulse_rate_hz = 300000\nmodulation_ns = 15.0\nsbet = '*.out'");
    let text = job_for(&place, "out/a.arrow");
    assert!(text.contains("\ntype = \"read_arrow\"\npath = \"out/a.arrow\"\n"), "{text}");
    assert!(text.contains("\ntrajectory = \"out/a.out\"\n"), "{text}");
    assert_eq!(stages(&text)[..3], ["read_arrow", "resolve_mta", "fuse_channels"]);
    fs::remove_file(place.path("out/a.out")).unwrap();
    let text = job_for(&place, "out/a.arrow");
    assert!(text.contains("\n# trajectory = ") && text.contains("\n# crs = "), "{text}");
    let Outcome { code, err, .. } =
        place.wavex(&["-q", "run", "flight.toml", "--set", "calibrate.waveforms=300"]);
    assert_eq!(code, Some(0), "{err}");
    let place = simulated("");
    let text = job_for(&place, "out/a.arrow");
    assert!(stages(&text)[0] == "read_arrow" && !text.contains("resolve_mta"), "{text}");
}

#[test]
fn each_recording_of_a_pattern_is_calibrated() {
    let place = simulated("");
    std::fs::copy(place.path("out/a.arrow"), place.path("out/b.arrow")).unwrap();
    let Outcome { code, out, err } =
        place.wavex(&["calibrate", "out/*.arrow", "--save-preset", "*_model.json"]);
    assert_eq!(code, Some(0), "{err}");
    for name in ["a", "b"] {
        assert!(
            out.contains(&format!("out/{name}.arrow\n")) && out.contains(&format!("wrote {name}_model.json")),
            "{out}"
        );
    }
}

#[test]
fn a_large_footprint_is_recognised() {
    let Some(data) = data() else { return };
    let place = TestFolder::new();
    for (file, job) in [
        ("pulsewaves/lvis_example1.pls", "large_footprint"),
        ("pulsewaves/riegl_example3.pls", "pulsewaves"),
        ("pulsewaves/optech_example1.pls", "pulsewaves"),
        ("riegl_q680i_dev/riegl_q680i_dev.las", "las"),
        ("pulsewaves/las13fwf_example1.pls", "pulsewaves"),
        ("pulsewaves/riegl_example4.pls", "pulsewaves"),
        ("gedi/gedi_l1b.h5", "gedi"),
    ] {
        let text = job_for(&place, data.join(file).to_str().unwrap());
        let is_large = ["large_footprint", "gedi"].contains(&job);
        assert_eq!(text.contains("profiles of ground and canopy"), is_large, "{text}");
        assert_eq!(stages(&text).contains(&"measure_footprints".to_owned()), is_large, "{text}");
        assert_eq!(stages(&text).contains(&"decompose".to_owned()), !is_large, "{text}");
        let Outcome { out, .. } = place.wavex(&["scan", "--fast", data.join(file).to_str().unwrap()]);
        assert_eq!(out.contains("  footprints "), is_large, "{out}");
    }
}

#[test]
fn what_is_no_recording_has_no_job() {
    let place = TestFolder::with(&[("a.las", b"no LAS")]);
    let Outcome { code, out, err } = place.wavex(&["init", "--from", "b.las", "b.toml"]);
    assert_eq!((code, out.as_str()), (Some(2), ""));
    assert_eq!(err, "error: b.las: no such file or folder; did you mean a.las?\n");
    let Outcome { code, err, .. } = place.wavex(&["init", "--from", "a.las", "a.toml"]);
    assert!(code == Some(1) && err.starts_with("error: a.las: "), "{err}");
    assert!(!place.path("a.toml").exists() && !place.path("b.toml").exists());
}

#[test]
fn a_schema_that_is_there_stays() {
    let place = TestFolder::with(&[("job.schema.json", b"mine")]);
    let Outcome { code, out, .. } = place.wavex(&["init", "a.toml"]);
    assert_eq!(code, Some(0));
    assert!(out.contains("kept the existing job.schema.json\n"), "{out}");
    assert_eq!(place.text("job.schema.json"), "mine");
}

#[test]
fn a_model_is_saved_and_serves_another_recording() {
    let place = simulated("");
    let Outcome { code, out, err } =
        place.wavex(&["calibrate", "out/a.arrow", "--save-preset", "model.json"]);
    assert_eq!((code, err.lines().any(|line| line.starts_with("error"))), (Some(0), false), "{err}");
    assert!(out.starts_with("out/a.arrow\n  low power       noise 0.9"), "{out}");
    assert!(
        out.ends_with("wrote model.json; use it in a job: `load = \"model.json\"` of calibrate\n"),
        "{out}"
    );
    assert!(!place.path("wavex_report.json").exists() && !place.path("wavex.log").exists());
    // Ten waveforms are too few for calibration.
    let job = "[[stage]]\ntype = 'simulate'\nlines = 1\nshots_per_line = 10\n[[stage]]\ntype = 'calibrate'\nload = 'model.json'\n\
               [[stage]]\ntype = 'decompose'\n[[stage]]\ntype = 'write_table'\n";
    assert_eq!(place.run(job).code, Some(0));
    let Outcome { code, err, .. } = place.wavex(&["calibrate", "out/a.arrow", "--save-preset", "model.txt"]);
    let expected = "error: --save-preset model.txt: a sensor model is JSON; give a name that ends in .json\n";
    assert_eq!((code, err.as_str()), (Some(2), expected));
}

#[test]
fn a_run_names_all_that_it_wrote_by_short_paths() {
    let place = TestFolder::new();
    let job = "[job]\noutput_dir = '../out'\nreport_page = true\n[[stage]]\ntype = 'simulate'\nstem = 'a'\nlines = 2\n\
               shots_per_line = 20\n[[stage]]\ntype = 'write_arrow'\n";
    place.write("jobs/a.toml", job.as_bytes());
    let Outcome { code, out, err } = place.wavex(&["run", "jobs/a.toml", "--profile", "--progress", "never"]);
    assert_eq!((code, err.as_str()), (Some(0), ""));
    let written: Vec<&str> = out.lines().filter_map(|line| line.strip_prefix("wrote ")).collect();
    let expected = ["a.arrow", "a_stat.log", "a_report.json", "a_report.html", "a_trace.json", "a.log"]
        .map(|name| format!("out/{name}"));
    assert_eq!(written, expected);
    let log = place.text("out/a.log");
    for part in ["mount: level", "geoid: none", "unit: ", "calibration: none", "wrote out/a.arrow"] {
        assert!(log.contains(part), "{part}: {log}");
    }
    assert!(log.trim_end().ends_with("exit status 0"), "{log}");
}

#[test]
fn a_failed_run_ends_its_log_with_its_exit_status() {
    let place = TestFolder::with(&[("a.las", b"no LAS")]);
    assert_eq!(place.read("read_las", "a.las", "[[stage]]\ntype = 'write_arrow'\n").code, Some(1));
    let log = place.text("out/job.log");
    assert!(log.trim_end().ends_with("exit status 1"), "{log}");
}

#[test]
fn a_warning_of_several_inputs_is_given_once_with_their_names() {
    let recording = PulseWaves::new(3);
    let place = TestFolder::new();
    for name in ["a", "b", "c"] {
        place.write(&format!("{name}.pls"), &recording.pls());
        place.write(&format!("{name}.wvs"), &recording.waves);
    }
    let job = "[[stage]]\ntype = 'read_pulsewaves'\npath = '*.pls'\n[[stage]]\ntype = 'calibrate'\npreset = 'riegl_lms_q680i'\n\
               [[stage]]\ntype = 'decompose'\n[[stage]]\ntype = 'georeference'\n[[stage]]\ntype = 'write_las'\n";
    place.write("a.toml", job.as_bytes());
    let Outcome { code, err, .. } = place.wavex(&["run", "a.toml", "--progress", "never"]);
    assert_eq!(code, Some(0), "{err}");
    let warnings: Vec<&str> =
        err.lines().filter_map(|line| line.trim_start().strip_prefix("WARN ")).collect();
    assert!(!warnings.is_empty() && warnings.len().is_multiple_of(2), "{err}");
    let (first, repeated) = warnings.split_at(warnings.len() / 2);
    for warning in first {
        let (input, text) = warning.split_once(": ").unwrap();
        assert!(["a", "b", "c"].contains(&input), "{err}");
        assert!(repeated.contains(&format!("3 of 3 inputs (a, b, c): {text}").as_str()), "{err}");
    }
    let Outcome { err, .. } = place.wavex(&["run", "a.toml", "--set", "read_pulsewaves.path=a.pls"]);
    assert!(err.contains("WARN ") && !err.contains("WARN a: "), "{err}");
}

/// The job makes no demand that the recording cannot meet.
#[test]
fn the_job_of_a_recording_without_a_range_table_asks_for_none() {
    let Some(data) = data() else { return };
    let place = TestFolder::new();
    let recording = data.join("riegl_q680i_dev/riegl_q680i_dev.pls");
    job_for(&place, recording.to_str().unwrap());
    let Outcome { code, err, .. } = place.wavex(&["run", "flight.toml", "--progress", "never"]);
    assert_eq!(code, Some(0), "{err}");
    // The recording names no CRS.
    let warnings: Vec<&str> =
        err.lines().filter(|line| !line.contains("has no coordinate reference system")).collect();
    assert_eq!(warnings, Vec::<&str>::new());
}

#[test]
fn the_job_of_gedi_shows_the_keys_of_beams_and_cuts() {
    let place = TestFolder::new();
    place.write("a.h5", include_bytes!("../../crates/wavex-hdf5/tests/data/gedi_product.h5"));
    let Outcome { code, out, err } = place.wavex(&["init", "--from", "a.h5"]);
    assert_eq!(code, Some(0), "{err}");
    for key in ["beams", "split_beams", "extent_deg", "time_s", "shots"] {
        let line =
            out.lines().find_map(|line| line.strip_prefix("# ")?.strip_prefix(key)?.strip_prefix(" = "));
        let value = line.unwrap_or_else(|| panic!("{key}: {out}"));
        let job = format!("[[stage]]\ntype = 'read_hdf5'\npath = 'a.h5'\n{key} = {value}\n");
        place.write("job.toml", job.as_bytes());
        let Outcome { out, err, .. } = place.wavex(&["check", "job.toml"]);
        assert!(!err.contains("no key") && !err.contains("must be"), "{key}: {out}{err}");
    }
}
