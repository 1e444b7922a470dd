//! Models of the beams of a granule, saved and loaded.

use std::fs;

use serde_json::{Value, json};
use wavex_testkit::{Outcome, TestFolder, data};

/// The real granule in `in`; `None` without data.
fn granule() -> Option<TestFolder> {
    let data = data()?;
    let place = TestFolder::new();
    place.write("in/a.h5", &fs::read(data.join("gedi/gedi_l1b.h5")).unwrap());
    Some(place)
}

/// Runs a job with these keys of `read_hdf5` and `measure_footprints` into a folder.
fn run(place: &TestFolder, out: &str, reader: &str, measure: &str, arguments: &[&str]) -> Outcome {
    let job = format!(
        "[job]\ninput_dir = 'in'\noutput_dir = '{out}'\n[[stage]]\ntype = 'read_hdf5'\npath = '*.h5'\n{reader}\n\
         [[stage]]\ntype = 'measure_footprints'\n{measure}\n[[stage]]\ntype = 'georeference'\n\
         [[stage]]\ntype = 'write_footprints'\npath = '*.csv'\n"
    );
    place.write("job.toml", job.as_bytes());
    place.wavex(&[&["run", "job.toml", "--progress", "never"], arguments].concat())
}

#[track_caller]
fn succeeds(outcome: Outcome) {
    assert_eq!(outcome.code, Some(0), "{}", outcome.err);
}

#[test]
fn a_loaded_model_gives_the_table_of_the_run_that_saved_it() {
    let Some(place) = granule() else { return };
    succeeds(run(&place, "saved", "", "save = '*_model.json'", &[]));
    fs::copy(place.path("saved/a_model.json"), place.path("in/a_model.json")).unwrap();
    let models: Value = serde_json::from_str(&place.text("in/a_model.json")).unwrap();
    assert_eq!((&models["format"], models["beams"].as_array().map(Vec::len)), (&json!(1), Some(4)));

    let load = "load = 'a_model.json'";
    succeeds(run(&place, "loaded", "", load, &["--archive", "archive"]));
    assert!(place.text("saved/a.csv") == place.text("loaded/a.csv"), "tables differ");
    assert!(!place.text("loaded/job_report.json").contains("DN, from the"), "nothing is learnt");
    let archive: Value = serde_json::from_str(&place.text("archive/archive.json")).unwrap();
    let inputs = archive["inputs"]["files"].as_array().unwrap().iter().map(|file| &file["path"]);
    assert_eq!(inputs.collect::<Vec<_>>(), ["a.h5", "a_model.json"]);
    for command in ["verify", "replay"] {
        let Outcome { code, err, .. } = place.wavex(&[command, "archive"]);
        assert_eq!(code, Some(0), "{command}: {err}");
    }

    // A beam of its own takes its model, and saves a file of its own.
    succeeds(run(&place, "split", "split_beams = true", &format!("{load}\nsave = '*_model.json'"), &[]));
    let of_beam: Value = serde_json::from_str(&place.text("split/a_BEAM0101_model.json")).unwrap();
    let of_all = models["beams"].as_array().unwrap().iter().find(|of| of["beam"] == "BEAM0101").unwrap();
    assert_eq!(of_beam["beams"], json!([of_all]));
    let rows = |name: &str| place.text(name).lines().count() - 1;
    let of_beams = models["beams"].as_array().unwrap().iter().map(|of| of["beam"].as_str().unwrap());
    assert_eq!(of_beams.map(|beam| rows(&format!("split/a_{beam}.csv"))).sum::<usize>(), rows("saved/a.csv"));

    // One shot, by the loaded model.
    let job = fs::read_to_string(place.path("job.toml")).unwrap();
    place.write("explain.toml", job.replace("split_beams = true", "").as_bytes());
    let explain = |arguments: &[&str]| {
        let outcome = place.wavex(&[&["explain", "in/a.h5", "--shot", "3"], arguments].concat());
        assert_eq!(outcome.code, Some(0), "{}", outcome.err);
        outcome.out
    };
    let by_default = explain(&[]);
    assert_eq!(explain(&["--job", "explain.toml"]), by_default);
    assert_eq!(explain(&["--model", "in/a_model.json"]), by_default);
}

#[test]
fn a_model_that_does_not_fit_is_refused() {
    let Some(place) = granule() else { return };
    succeeds(run(&place, "saved", "", "save = '*_model.json'", &[]));
    let models: Value = serde_json::from_str(&place.text("saved/a_model.json")).unwrap();
    let error = |change: &dyn Fn(&mut Value)| {
        let mut changed = models.clone();
        change(&mut changed);
        place.write("in/model.json", changed.to_string().as_bytes());
        let Outcome { code, err, .. } = run(&place, "out", "", "load = 'model.json'", &[]);
        assert!(code == Some(1) && !place.path("out/a.csv").exists(), "{err}");
        err
    };
    let of_first = |field: &'static str, value: Value| {
        error(&|models| models["beams"][0]["model"][field] = value.clone())
    };
    for (err, problem) in [
        (
            of_first("sampling_interval_ns", json!(0.5)),
            "`sampling_interval_ns` is 0.5, but that of the recording is 1",
        ),
        (of_first("noise_sd_dn", Value::Null), "`beams[0].model.noise_sd_dn` is no number"),
        (of_first("response", json!([])), "`response` must have 4 to 65536 values, got 0"),
        (
            error(&|models| models["beams"][0]["outgoing_samples"] = json!([7, 9])),
            "`outgoing_samples` are 7 to 9, but",
        ),
        (error(&|models| models["format"] = json!(2)), "`format` is 2, and this version of wavex reads 1"),
        (
            error(&|models| *models = json!({"low_power": {}})),
            "not models of footprints: unknown field `low_power`",
        ),
    ] {
        assert!(err.contains("model.json: ") && err.contains(problem) && err.contains("; load a "), "{err}");
    }
    let Outcome { code, err, .. } = run(&place, "out", "", "load = 'models.json'", &[]);
    assert!(code == Some(1) && err.contains("models.json"), "{err}");
}
