//! One sensor model for the inputs of a survey, and several inputs at once.

use std::collections::BTreeMap;
use std::fs;
use std::process::Stdio;

use serde_json::Value;
use wavex_testkit::{Outcome, TestFolder, outcome};

/// Makes a strip; `seed` and `noise_dn` are those of the simulator.
fn strip(place: &TestFolder, stem: &str, seed: u32, noise_dn: f64, lines: u32) {
    let make = format!(
        "[[stage]]\ntype = 'simulate'\nstem = '{stem}'\nseed = {seed}\nnoise_sd_dn = {noise_dn}\n\
         lines = {lines}\nshots_per_line = 100\n[[stage]]\ntype = 'write_arrow'\npath = '../strips/*.arrow'\n"
    );
    assert_eq!(place.run(&make), Outcome::success());
    fs::remove_dir_all(place.path("out")).unwrap();
}

/// Four strips of one instrument, one of which is noisier, and a damaged one.
fn survey() -> TestFolder {
    let place = TestFolder::new();
    for (stem, seed, noise_dn) in [("a", 1, 0.9), ("b", 2, 0.9), ("c", 3, 1.6), ("e", 4, 0.9)] {
        strip(&place, stem, seed, noise_dn, 30);
    }
    place.write("strips/d.arrow", b"ARROW1");
    place
}

const JOB: &str = "\
[[stage]]
type = 'read_arrow'
path = 'strips/*.arrow'
[[stage]]
type = 'calibrate'
[[stage]]
type = 'decompose'
[[stage]]
type = 'write_table'
path = '*.csv'
";

/// Runs the job with these keys of `[job]`; returns the tables.
fn tables(place: &TestFolder, keys: &[&str]) -> BTreeMap<String, Vec<u8>> {
    let mut command = place.command(JOB);
    for key in keys {
        command.args(["--set", key]);
    }
    let Outcome { code, err, .. } = outcome(&mut command);
    assert_eq!(code, Some(1), "{err}");
    assert!(err.contains("1 of 5 inputs failed: d"), "{err}");
    let tables = place.products().into_iter().filter(|name| name.ends_with(".csv"));
    let tables = tables.map(|name| (name.clone(), fs::read(place.path("out").join(name)).unwrap())).collect();
    fs::rename(place.path("out/job_report.json"), place.path("report.json")).unwrap();
    fs::remove_dir_all(place.path("out")).unwrap();
    tables
}

fn report(place: &TestFolder) -> Value {
    serde_json::from_str(&place.text("report.json")).unwrap()
}

#[test]
fn the_inputs_of_a_survey_share_a_model_unless_one_contradicts() {
    let place = survey();
    let shared = tables(&place, &[]);
    assert_eq!(shared.keys().collect::<Vec<_>>(), ["a.csv", "b.csv", "c.csv", "e.csv"]);
    let report = report(&place);
    let inputs = report["survey_models"]["inputs"].as_array().unwrap();
    let own: Vec<(&str, bool)> =
        inputs.iter().map(|input| (input["stem"].as_str().unwrap(), !input["own_model"].is_null())).collect();
    assert_eq!(own, [("a", false), ("b", false), ("c", true), ("d", false), ("e", false)]);
    let reason = inputs[2]["own_model"].as_str().unwrap();
    assert!(reason.starts_with("low power noise 1.5"), "{reason}");
    assert_eq!(report["survey_models"]["instruments"][0]["inputs"], 3);
    let input = |number: usize| &report["inputs"][number];
    assert!([0, 1, 4].iter().all(|number| input(*number)["survey_instrument"] == 0));
    assert!([0, 1, 4].iter().all(|number| input(*number)["sensor_model"].is_null()));
    assert!(input(2)["survey_instrument"].is_null() && input(2)["sensor_model"]["low_power"].is_object());

    let alone = tables(&place, &["job.model=input"]);
    assert!(shared["a.csv"] != alone["a.csv"] && shared["c.csv"] == alone["c.csv"]);
}

#[test]
fn a_resumed_run_keeps_the_models_of_the_first() {
    let place = survey();
    place.write("job.toml", format!("[job]\noutput_dir = 'out'\nthreads = 2\n{JOB}").as_bytes());
    let run = |arguments: &[&str]| {
        place.wavex(&[&["run", "job.toml", "--progress", "never"], arguments].concat()).err
    };
    run(&[]);
    place.write("strips/b.arrow", b"ARROW1");
    let err = run(&["--resume"]);
    for stem in ["a", "c", "e"] {
        assert!(err.contains(&format!("{stem}: skipped, its outputs are complete")), "{err}");
    }
    let err = run(&["--resume", "--relearn"]);
    assert!(err.contains("a: not skipped: the sensor models of the survey were different"), "{err}");
}

#[test]
fn the_model_of_a_survey_is_made_once_for_many_runs() {
    let place = survey();
    let shared = tables(&place, &[]);
    place.write("job.toml", JOB.as_bytes());
    let Outcome { code, out, err } = place.wavex(&["calibrate", "job.toml", "--out", "model.json"]);
    assert_eq!(code, Some(0), "{err}");
    assert!(out.contains("its own: low power noise") && out.contains("d: could not be read"), "{out}");
    assert!(out.ends_with("wrote model.json; use it in a job: `survey_model = \"model.json\"` of `[job]`, relative to `input_dir`\n"), "{out}");
    assert!(tables(&place, &["job.survey_model='model.json'"]) == shared);
    for stem in ["a", "c"] {
        let one = JOB.replace("*.arrow", &format!("{stem}.arrow"));
        let job = format!("survey_model = 'model.json'\n{one}");
        assert_eq!(place.run(&job), Outcome::success());
        let table = format!("{stem}.csv");
        assert!(fs::read(place.path("out").join(&table)).unwrap() == shared[&table], "{table}");
    }
}

#[test]
fn results_do_not_depend_on_the_number_of_inputs_at_once() {
    let place = survey();
    let [one, two, four] = ["1", "2", "4"].map(|inputs| {
        let tables = tables(&place, &[&format!("job.inputs_at_once={inputs}")]);
        let report = report(&place);
        let stems: Vec<&str> = report["inputs"]
            .as_array()
            .unwrap()
            .iter()
            .map(|input| input["stem"].as_str().unwrap())
            .collect();
        assert_eq!(stems, ["a", "b", "c", "d", "e"]);
        tables
    });
    assert!(one == two && one == four);
}

#[test]
fn files_of_models_are_checked() {
    let place = survey();
    place.write("model.json", b"{\"format\": 2}");
    let job = format!("survey_model = 'model.json'\n{JOB}");
    let expected = "error: ./model.json: not the models of a survey: missing field `wavex` at line 1 column 13; \
                    give a file written by `wavex calibrate JOB.toml -o FILE.json`\n";
    assert_eq!(place.run(&job), Outcome::failure(1, expected));
    place.write("model.json", b"{\"format\": 2, \"wavex\": \"\", \"instruments\": [], \"inputs\": []}");
    let expected = "error: ./model.json: format 2 is not 1, that of this version; \
                    give a file written by `wavex calibrate JOB.toml -o FILE.json`\n";
    assert_eq!(place.run(&job), Outcome::failure(1, expected));
}

#[test]
fn a_model_of_a_survey_needs_a_job_that_calibrates() {
    let place = survey();
    let job = JOB.replace("'calibrate'\n", "'calibrate'\nload = 'model.json'\n");
    place.write("job.toml", job.as_bytes());
    let expected =
        "error: no stage of the job estimates a sensor model; add `calibrate` without `load` and `preset`\n";
    assert_eq!(place.wavex(&["-q", "calibrate", "job.toml"]), Outcome::failure(1, expected));
    let expected =
        "error: --out is for the models of a job; to save the model of a recording, use --save-preset\n";
    assert_eq!(
        place.wavex(&["-q", "calibrate", "strips/a.arrow", "-o", "m.json"]),
        Outcome::failure(2, expected)
    );
    let expected =
        "error: --save-preset is for the model of a recording; to save the models of a job, use --out\n";
    assert_eq!(
        place.wavex(&["-q", "calibrate", "job.toml", "--save-preset", "m.json"]),
        Outcome::failure(2, expected)
    );
}

/// Peak memory of a run of this job over these strips, bytes.
#[cfg(target_os = "linux")]
fn peak_bytes(place: &TestFolder, job: &str, pattern: &str) -> u64 {
    let mut child = place
        .command(&job.replace("*.arrow", pattern))
        // The allocator keeps memory for each thread.
        .args(["--set", "job.threads=1"])
        .env("MALLOC_ARENA_MAX", "1")
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let mut peak_kb = 0;
    while child.try_wait().unwrap().is_none() {
        let status = fs::read_to_string(format!("/proc/{}/status", child.id())).unwrap_or_default();
        let row = status.lines().find_map(|row| row.strip_prefix("VmHWM:"));
        let found = row.and_then(|row| row.trim().trim_end_matches(" kB").parse().ok());
        peak_kb = found.unwrap_or(0u64).max(peak_kb);
        std::thread::sleep(std::time::Duration::from_millis(2));
    }
    assert_eq!(child.wait().unwrap().code(), Some(0));
    1024 * peak_kb
}

#[cfg(target_os = "linux")]
#[test]
fn two_hundred_inputs_take_little_more_memory_than_twenty() {
    let place = TestFolder::new();
    strip(&place, "s000", 1, 0.9, 12);
    let first = place.path("strips/s000.arrow");
    for number in 1..200 {
        fs::copy(&first, place.path(&format!("strips/s{number:03}.arrow"))).unwrap();
    }
    let with = |key: &str| JOB.replace("'calibrate'", &format!("'calibrate'\n{key}"));
    assert_eq!(place.run(&with("save = 'model.json'").replace("*.arrow", "s000.arrow")), Outcome::success());
    fs::rename(place.path("out/model.json"), place.path("model.json")).unwrap();
    // The model of the survey is made from so few waveforms that twenty inputs already have them.
    for job in [with("waveforms = 20000"), with("load = 'model.json'")] {
        let [few, many] = ["s??0.arrow", "s*.arrow"].map(|pattern| peak_bytes(&place, &job, pattern));
        println!("peak memory: {} MB for 20 inputs, {} MB for 200", few / 1_000_000, many / 1_000_000);
        // The report has an entry per input; inputs with the same model share it.
        assert!(many < few + 180 * 75_000, "{few} {many}");
    }
}
