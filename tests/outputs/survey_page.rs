//! `survey_page`: densities, gaps and height differences of overlapping strips.

use crate::report_page::browser::{self, Look};
use serde_json::Value;
use wavex_testkit::{Outcome, TestFolder, outcome};

/// Keys of a strip of the simulated survey over one scene.
fn strip(stem: &str, seed: u32, keys: &str) -> String {
    format!(
        "report = ''\nstat_log = ''\nlog = ''\n[[stage]]\ntype = 'simulate'\nstem = '{stem}'\nseed = {seed}\n\
         scene_seed = 7\nlandscape = 'country'\nrelief_m = 8.0\nwood_ratio = 0.2\nhouse_ratio = 0.1\n\
         building_height_m = 6.0\ncanopy_height_m = 10.0\nwire_height_m = 0.0\nwater_ratio = 0.0\n\
         flying_height_m = 200.0\nscan_angle_deg = [-25.0, 25.0]\nshots_per_line = 200\n\
         pulse_rate_hz = 20000.0\nlines = 130\n{keys}\n[[stage]]\ntype = 'write_arrow'\n"
    )
}

/// Misalignment of the strip `b`, m.
const ERROR_M: f64 = 0.05;

/// Three parallel strips and a crossing one; `b` is 5 cm too high.
fn survey() -> TestFolder {
    let place = TestFolder::new();
    let strips = [
        ("a", ""),
        ("b", "track_offset_m = [80.0, 0.0]\nheight_error_m = 0.05"),
        ("c", "track_offset_m = [160.0, 0.0]"),
        ("d", "track_offset_m = [-40.0, 40.0]\ntrack_direction_deg = 90.0\nlines = 400"),
    ];
    for ((stem, keys), seed) in strips.into_iter().zip(1..) {
        let mut job = strip(stem, seed, keys);
        if keys.contains("lines") {
            job = job.replace("lines = 130\n", "");
        }
        assert_eq!(place.run(&job), Outcome::success());
    }
    place
}

const KEYS: &str = "input_dir = 'out'\nsurvey_page = true\n";
const JOB: &str = "[[stage]]\ntype = 'read_arrow'\npath = '?.arrow'\n[[stage]]\ntype = 'calibrate'\n\
                   waveforms = 2000\n[[stage]]\ntype = 'decompose'\n[[stage]]\ntype = 'georeference'\n\
                   [[stage]]\ntype = 'write_las'\npath = '*.las'\n";

fn json(place: &TestFolder) -> Value {
    serde_json::from_str(&place.text("out/job_survey.json")).unwrap()
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("no number: {value}"))
}

#[test]
fn a_misaligned_strip_is_shown_and_quantified() {
    let place = survey();
    let job = format!("{KEYS}[job.survey]\ntarget_pulses_per_m2 = 3.0\n{JOB}");
    assert_eq!(place.run(&job), Outcome::success());
    let survey = json(&place);

    // The offset of the strip and the differences of its pairs.
    let offsets: Vec<f64> =
        survey["strips"].as_array().unwrap().iter().map(|strip| number(&strip["offset_m"])).collect();
    println!("offsets of strips a, b, c, d: {offsets:?} m");
    let tolerance_m = 0.003;
    for (offset_m, expected_m) in offsets.iter().zip([0.0, ERROR_M, 0.0, 0.0]) {
        assert!((offset_m - expected_m).abs() < tolerance_m, "{offsets:?}");
    }
    let pairs = survey["pairs"].as_array().unwrap();
    assert!(pairs.len() >= 5, "{pairs:?}");
    for pair in pairs {
        let expected_m = match [pair["strips"][0].as_str().unwrap(), pair["strips"][1].as_str().unwrap()] {
            [_, "b"] => ERROR_M,
            ["b", _] => -ERROR_M,
            _ => 0.0,
        };
        let (median_m, mean_m) = (number(&pair["median_m"]), number(&pair["mean_m"]));
        println!("{}: {} cells, median {median_m:.4} m, mean {mean_m:.4} m", pair["strips"], pair["cells"]);
        assert!((median_m - expected_m).abs() < tolerance_m, "{pair}");
        assert!((mean_m - expected_m).abs() < tolerance_m, "{pair}");
        // Scatter of the differences about the misalignment: the noise explains it.
        let scatter_m = (number(&pair["rms_m"]).powi(2) - mean_m * mean_m).sqrt();
        let noise_m = number(&pair["noise_rms_m"]);
        println!("   scatter {scatter_m:.4} m, by noise {noise_m:.4} m");
        assert!((0.8..1.6).contains(&(scatter_m / noise_m)), "{pair}");
    }
    let warning = "<li><b>b</b>: lies 0.050 m above the others; check its trajectory and boresight</li>";
    assert!(place.text("out/job_survey.html").contains(warning));
    look_at(&place);
}

/// The page in a browser: readable, with all pictures and without console messages.
fn look_at(place: &TestFolder) {
    let Some(browser) = browser::find() else { return };
    let page = place.text("out/job_survey.html");
    for look in [Look::Light, Look::Dark] {
        let (_, said) = browser::show(&browser, &place.path("out/job_survey.html"), look);
        assert_eq!(said, [] as [&str; 0], "{look:?}: the console");
        let found = browser::measured(&browser, &page, look);
        for nothing in ["empty", "faint", "small", "overlapping", "loaded"] {
            assert_eq!(found[nothing], serde_json::json!([]), "{look:?}: {nothing}");
        }
        assert_eq!(found["wide"], false, "{look:?}: the page scrolls horizontally");
        let images = found["images"].as_array().unwrap();
        assert!(images.len() >= 3 && images.iter().all(|size| size[0].as_u64() > Some(20)), "{images:?}");
    }
}

/// Two small strips side by side.
fn small_survey() -> TestFolder {
    let place = TestFolder::new();
    for (stem, seed, keys) in [("a", 1, ""), ("b", 2, "track_offset_m = [60.0, 0.0]")] {
        let job = strip(stem, seed, keys).replace("lines = 130", "lines = 60");
        assert_eq!(place.run(&job), Outcome::success());
    }
    place
}

/// Files of the survey with their content.
fn survey_files(place: &TestFolder) -> Vec<(String, Vec<u8>)> {
    let is_of_survey =
        |name: &String| name.contains("survey") || name.contains("cells") || name.ends_with("tif");
    let names = place.outputs().into_iter().filter(is_of_survey);
    names.map(|name| (name.clone(), std::fs::read(place.path(&format!("out/{name}"))).unwrap())).collect()
}

fn names(files: &[(String, Vec<u8>)]) -> Vec<&str> {
    files.iter().map(|(name, _)| name.as_str()).collect()
}

#[test]
fn the_survey_depends_on_its_strips_alone() {
    let place = small_survey();
    let job = format!("{KEYS}{JOB}");
    assert_eq!(place.run(&job), Outcome::success());
    let first = survey_files(&place);
    let expected = [
        "a_cells.arrow",
        "a_pulse_density.tif",
        "b_cells.arrow",
        "b_pulse_density.tif",
        "job_survey.html",
        "job_survey.json",
        "job_survey_height_difference.tif",
        "job_survey_point_density.tif",
        "job_survey_pulse_density.tif",
        "job_survey_roughness.tif",
        "job_survey_strips.tif",
    ];
    assert_eq!(names(&first), expected);
    let is_same = |files: &[(String, Vec<u8>)]| {
        let pairs = first.iter().zip(files);
        pairs.filter(|(a, b)| a != b).map(|(a, _)| a.0.clone()).collect::<Vec<String>>()
    };

    // Not on threads.
    let mut command = place.command(&job);
    assert_eq!(outcome(command.args(["--threads", "1"])), Outcome::success());
    assert_eq!(is_same(&survey_files(&place)), [] as [&str; 0]);

    // A resumed run repeats a strip without cells, and has the page of all strips.
    std::fs::remove_file(place.path("out/b_cells.arrow")).unwrap();
    std::fs::remove_file(place.path("out/job_survey.json")).unwrap();
    assert_eq!(outcome(place.command(&job).arg("--resume")), Outcome::success());
    let log = place.text("out/job.log");
    assert!(log.contains("a: skipped, its outputs are complete"), "{log}");
    assert!(log.contains("b: not skipped: b_cells.arrow is missing"), "{log}");
    assert_eq!(is_same(&survey_files(&place)), [] as [&str; 0]);

    // The strips of several runs.
    std::fs::create_dir(place.path("other")).unwrap();
    std::fs::rename(place.path("out/b_cells.arrow"), place.path("other/b_cells.arrow")).unwrap();
    let arguments = ["survey", "out", "other", "--job", "job.toml", "--out", "all/job_survey.html"];
    let Outcome { code, out, err } = place.wavex(&arguments);
    assert_eq!((code, err.as_str()), (Some(0), ""));
    assert!(out.contains("wrote all/job_survey_strips.tif\n"), "{out}");
    for (name, bytes) in first.iter().filter(|(name, _)| name.starts_with("job_survey")) {
        assert!(std::fs::read(place.path(&format!("all/{name}"))).unwrap() == *bytes, "{name}");
    }

    // Keys of the job are overridden as for a run.
    let set = ["--set", "job.survey.max_difference_rms_m=0.125"];
    let Outcome { code, err, .. } = place.wavex(&[&arguments[..], &set].concat());
    assert_eq!((code, err.as_str()), (Some(0), ""));
    assert!(
        place.text("all/job_survey.json").contains("\"max_difference_rms_m\": 0.125"),
        "the limit is in the file"
    );
    let Outcome { code, err, .. } = place.wavex(&[&["survey", "out"], &set[..]].concat());
    assert!(code == Some(2) && err.contains("--job <FILE>"), "{err}");
}

#[test]
fn a_failed_strip_is_named() {
    let place = small_survey();
    place.write("out/b.arrow", b"ARROW1 cut off");
    let run = place.run(&format!("{KEYS}{JOB}"));
    assert_eq!(run.code, Some(1));
    let survey = json(&place);
    let failure = survey["strips"][1]["failure"].as_str().unwrap();
    assert!(run.err.contains(failure), "{failure} is not in {}", run.err);
    assert!(number(&survey["strips"][0]["area_m2"]) > 1000.0);
    assert!(place.text("out/job_survey.html").contains("<li><b>b</b>: stage read_arrow: "));
    assert!(!place.path("out/b_cells.arrow").exists());
}

#[test]
fn keys_and_commands_without_a_survey_are_refused() {
    let place = TestFolder::new();
    let refused = place.run(&format!("survey_page = 'page.pdf'\n{JOB}"));
    assert!(refused.err.contains("`survey_page`: it must end in .html"), "{}", refused.err);
    let refused = place.run(&format!("[job.survey]\ncell_m = 0.0\n{JOB}"));
    assert!(refused.err.contains("`cell_m` must be at least 0.1 and at most 100"), "{}", refused.err);
    let none = place.wavex(&["survey", "."]);
    let remedy = "no cells of strips (*_cells.arrow); run the job with `survey_page = true`";
    assert!(none.code == Some(1) && none.err.contains(remedy), "{none:?}");
    let missing = place.wavex(&["survey", "nowhere"]);
    assert!(missing.code == Some(1) && missing.err.contains("check the path"), "{missing:?}");
    place.write("job.toml", b"");
    let file = place.wavex(&["survey", "job.toml"]);
    let remedy =
        "job.toml: it is a file, not a folder; give the folder of the outputs, and the job by `--job`";
    assert!(file.code == Some(2) && file.err.contains(remedy), "{file:?}");
}

#[test]
fn a_run_without_points_has_a_page() {
    let place = TestFolder::new();
    let job = "survey_page = 'page.html'\n[[stage]]\ntype = 'simulate'\nstem = 'raw'\nlines = 3\n\
               shots_per_line = 20\n[[stage]]\ntype = 'write_arrow'\n";
    assert_eq!(place.run(job), Outcome::success());
    let why = "it has no points with coordinates; add the stage `georeference`";
    assert!(place.text("out/page.html").contains(why));
    let expected =
        ["job_report.json", "page.html", "page.json", "raw.arrow", "raw_cells.arrow", "raw_stat.log"];
    assert_eq!(place.outputs(), expected);
}
