//! Sensor models: given, preset, and held against the recording.

use wavex_testkit::{Outcome, TestFolder};

use super::{SHOTS, recording, run};
use wavex_testkit::table::number;

#[test]
fn a_model_for_other_samples_is_used_as_it_is_and_said_so() {
    let place = recording(|_, _| {});
    run(&place, "", "save = 'model.json'", "");
    let model = place.path("out/model.json");
    let load = format!("load = '{}'", model.display());
    let (_, _) = run(&place, "", &load, "");
    let notes = |place: &TestFolder| {
        place.text("out/job_report.json").matches("the values of the model are used").count()
    };
    assert_eq!(notes(&place), 0);
    run(&place, "odd_sample_shift = 0.2", &load, "");
    assert_eq!(notes(&place), 1);

    // A model without the outgoing pulse also works: times then count from the clock.
    let mut part: serde_json::Value = serde_json::from_str(&place.text("out/model.json")).unwrap();
    part.as_object_mut().unwrap().remove("reference");
    place.write("out/part.json", part.to_string().as_bytes());
    let (rows, _) = run(&place, "", &format!("load = '{}'", place.path("out/part.json").display()), "");
    assert_eq!(rows.len(), SHOTS);
    assert!(
        rows.iter().all(|row| number(row, "time_of_flight_sd_ns") > 0.28),
        "the sub-sample emission offset is unknown"
    );
}

/// 100 waveforms are too few for calibration; a RIEGL preset fits these, which were simulated like
/// it.
#[test]
fn a_preset_serves_where_there_is_too_little_to_calibrate_from() {
    let place = TestFolder::with(&[]);
    let job = |keys: &str| {
        format!(
            "[[stage]]\ntype = 'simulate'\nstem = 'a'\nlines = 1\nshots_per_line = 100\ncanopy_height_m = 0\n\
             building_height_m = 0\ndropout_rate = 0\n[[stage]]\ntype = 'calibrate'\n{keys}\n\
             [[stage]]\ntype = 'decompose'\n[[stage]]\ntype = 'write_table'\npath = '*.csv'\n"
        )
    };
    let Outcome { code, err, .. } = place.run(&job(""));
    assert_eq!(code, Some(1));
    assert!(err.contains("calibration needs 200 waveforms of the channel and there were 100"), "{err}");

    assert_eq!(place.run(&job("preset = 'riegl_lms_q680i'")).code, Some(0));
    assert_eq!(place.text("out/a.csv").lines().count(), 101);
    assert_eq!(place.text("out/job_report.json").matches("the sensor model is a preset").count(), 1);
}

/// A job that loads `model.json`, with further keys of `calibrate`.
fn load(place: &TestFolder, keys: &str) -> Outcome {
    let path = place.path("model.json");
    place.read(
        "read_arrow",
        "a.arrow",
        &format!(
            "[[stage]]\ntype = 'calibrate'\nload = '{}'\n{keys}\n[[stage]]\ntype = 'decompose'\n[[stage]]\n\
             type = 'write_table'\npath = '*.csv'\n",
            path.display()
        ),
    )
}

#[test]
fn a_model_is_held_against_the_recording() {
    let place = recording(|_, _| {});
    run(&place, "", "save = 'model.json'", "");
    let model: serde_json::Value = serde_json::from_str(&place.text("out/model.json")).unwrap();
    let said = |model: &serde_json::Value, keys: &str| {
        place.write("model.json", model.to_string().as_bytes());
        let outcome = load(&place, keys);
        (outcome.code, outcome.err)
    };
    let notes = |text: &str| place.text("out/job_report.json").matches(text).count();

    assert_eq!(said(&model, ""), (Some(0), String::new()));
    assert_eq!(notes("the loaded model"), 0);
    assert_eq!(said(&model, "waveforms = 300").0, Some(0));
    assert_eq!(notes("have no effect with `load` or `preset`: remove them, or recalibrate"), 1);

    let mut other = model.clone();
    other["low_power"]["full_scale_dn"] = 1023.0.into();
    assert_eq!(said(&other, "").0, Some(0));
    assert_eq!(notes("a full scale that differs from the recording: the value of the model is used"), 1);

    let mut other = model.clone();
    other["low_power"]["sampling_interval_ns"] = 0.5.into();
    let (code, err) = said(&other, "");
    assert_eq!(code, Some(1));
    let problem = "the loaded model has a sampling interval of 0.5 ns (the low power receiver), but that \
                   of the recording is 1 ns; load a model of this instrument and setting, or recalibrate";
    assert!(err.contains(problem), "{err}");

    let mut other = model;
    let low_power = other.as_object_mut().unwrap().remove("low_power").unwrap();
    let (code, err) = said(&other, "");
    assert_eq!(code, Some(1));
    assert!(err.contains("the sensor model has no echo receiver"), "{err}");
    other["high_power"] = low_power;
    assert_eq!(said(&other, "").0, Some(0));
    assert_eq!(notes("lacks the low power receiver: its waveforms are not decomposed; recalibrate"), 1);
}

#[test]
fn an_unknown_full_scale_is_said_and_can_be_given() {
    let place = recording(|_, _| {});
    // A container with the key of another program, which writes no digests.
    let mut bytes = std::fs::read(place.path("a.arrow")).unwrap();
    for (ours, theirs) in [("wavex.full_scale_dn", "other.full_scale_dn"), ("wavex.digest", "other.digest")]
        .map(|(a, b)| (a.as_bytes(), b.as_bytes()))
    {
        while let Some(at) = bytes.windows(ours.len()).position(|window| window == ours) {
            bytes[at..at + ours.len()].copy_from_slice(theirs);
        }
    }
    place.write("a.arrow", &bytes);
    let notes = || {
        place.text("out/job_report.json").matches("the reader's key `full_scale_dn` (255 for 8 bits)").count()
    };
    run(&place, "", "", "");
    let unknown = notes();
    run(&place, "full_scale_dn = 255", "save = 'model.json'", "");
    assert_eq!((unknown, notes()), (1, 0));
    let model: serde_json::Value = serde_json::from_str(&place.text("out/model.json")).unwrap();
    assert_eq!(model["low_power"]["full_scale_dn"], 255.0);
}

/// Pulses that fall faster than recorded explain no waveform: the run says so, what it used, and what
/// to set.
#[test]
fn a_recording_that_its_returns_do_not_explain_ends_with_a_warning() {
    let place = recording(|_, _| {});
    let warning = "the returns do not explain the waveforms";
    run(&place, "", "save = 'model.json'", "");
    assert!(!place.text("out/job_report.json").contains(warning));
    let mut model: serde_json::Value = serde_json::from_str(&place.text("out/model.json")).unwrap();
    let response = &mut model["low_power"]["response"];
    let peak = -8 * response["first_sample"].as_i64().unwrap();
    let values = response["nodes"][0]["values"].as_array_mut().unwrap();
    for value in values.iter_mut().skip(peak as usize) {
        *value = value.as_f64().unwrap().powi(3).into();
    }
    place.write("out/steep.json", model.to_string().as_bytes());
    run(&place, "", &format!("load = '{}'", place.path("out/steep.json").display()), "");
    let report = place.text("out/job_report.json");
    for text in [warning, "Used: the response of single echoes", "`wavex explain`", "`response` of calibrate"]
    {
        assert!(report.contains(text), "{text}: {report}");
    }
}
