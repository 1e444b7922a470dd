//! Effects of the keys of readers, `calibrate` and `decompose` on the results.

mod effects;

use std::collections::BTreeMap;

use wavex::scan_line::flags::{ECHO_ON_OUTGOING, EMISSION_IN_BLOCK, EMISSION_ON_ECHO, OVERLAP, REFINED};
use wavex_formats::container::EmissionReference;
use wavex_testkit::container::{Shot, of_shots};
use wavex_testkit::{Outcome, TestFolder, shots};

const SHOTS: usize = 320;
/// Channel codes of the container.
const LOW: u8 = 1;
const REFERENCE: u8 = 3;
/// Interval between shots.
const INTERVAL_NS: f64 = 5000.0;

/// A row of a table of returns by column.
type Row = BTreeMap<String, String>;

fn number(row: &Row, column: &str) -> f64 {
    row[column].parse().unwrap()
}

fn flags_of(row: &Row) -> u16 {
    row["flags"].parse().unwrap()
}

/// Reads a container with these keys: table of returns, and report of the input.
fn run(place: &TestFolder, reader: &str, calibrate: &str, decompose: &str) -> (Vec<Row>, serde_json::Value) {
    let job = format!(
        "[[stage]]\ntype = 'read_arrow'\npath = 'a.arrow'\n{reader}\n[[stage]]\ntype = 'calibrate'\n{calibrate}\n\
         [[stage]]\ntype = 'decompose'\n{decompose}\n[[stage]]\ntype = 'write_table'\npath = '*.csv'\n"
    );
    assert_eq!(place.run(&job), Outcome::success());
    let table = place.text("out/a.csv");
    let mut lines = table.lines().map(|line| line.split(',').map(str::to_owned));
    let heads: Vec<String> = lines.next().unwrap().collect();
    let rows = lines.map(|cells| heads.iter().cloned().zip(cells).collect()).collect();
    let report: serde_json::Value = serde_json::from_str(&place.text("out/report.json")).unwrap();
    (rows, report["inputs"][0]["totals"].clone())
}

/// A waveform of pulses (peak sample, amplitude) with its own noise.
fn samples(shot: usize, pulses: &[(f64, f64)]) -> Vec<u16> {
    samples_at(shot, pulses, |k| k as f64)
}

/// The same waveform with sample `k` taken at another time.
fn samples_at(shot: usize, pulses: &[(f64, f64)], taken_at: impl Fn(usize) -> f64) -> Vec<u16> {
    let noise = shots::waveform(shot, 1e6, 0.0);
    let signal = |k: usize| {
        let of = |&(peak, height): &(f64, f64)| {
            let x = (taken_at(k) - peak) / (4.5 / 2.354_82);
            height * f64::exp(-0.5 * x * x)
        };
        pulses.iter().map(of).sum::<f64>()
    };
    noise
        .iter()
        .enumerate()
        .map(|(k, &n)| (f64::from(n) + signal(k)).round().clamp(0.0, 255.0) as u16)
        .collect()
}

/// Shots with an outgoing pulse at their clock and one echo 1024 ns later; `change` modifies some.
fn recording(change: impl Fn(usize, &mut Shot)) -> TestFolder {
    let shot = |number: usize| {
        let place = 0.1 * (number % 7) as f64;
        let mut shot = Shot {
            clock_ps: (number as f64 * INTERVAL_NS * 1000.0) as i64,
            blocks: vec![
                (REFERENCE, -20.0, samples(1000 + number, &[(20.0, 150.0)])),
                (LOW, 1000.0, samples(number, &[(24.0 + place, 120.0)])),
            ],
        };
        change(number, &mut shot);
        shot
    };
    let all: Vec<Shot> = (0..SHOTS).map(shot).collect();
    TestFolder::with(&[("a.arrow", &of_shots(&all, EmissionReference::OutgoingPulse, true))])
}

fn of_shot(rows: &[Row], shot: usize) -> Vec<&Row> {
    let shot = (100 + shot).to_string();
    rows.iter().filter(|row| row["shot"] == shot).collect()
}

/// Shot 50 is recorded while shot 51 is emitted, close to its echo. Shot 60 is recorded while shot
/// 61 is emitted, whose emission leaks in. An echo overlaps the outgoing pulse of shot 70.
fn with_crosstalk() -> TestFolder {
    recording(|number, shot| match number {
        50 => shot.blocks[1].1 = INTERVAL_NS - 20.0,
        60 => shot.blocks[1] = (LOW, INTERVAL_NS - 40.0, samples(number, &[(12.0, 120.0), (40.0, 60.0)])),
        70 => shot.blocks[0].2 = samples(number, &[(20.0, 150.0), (24.0, 60.0)]),
        _ => {}
    })
}

#[test]
fn crosstalk_is_flagged_and_dropped_on_request() {
    let place = with_crosstalk();
    let (rows, totals) = run(&place, "", "", "");
    let flags =
        |shot: usize| of_shot(&rows, shot).iter().map(|row| flags_of(row) & 0b11_1000).collect::<Vec<_>>();
    assert_eq!(flags(50), [EMISSION_ON_ECHO]);
    assert_eq!(flags(60), [EMISSION_IN_BLOCK, EMISSION_ON_ECHO]);
    assert_eq!(flags(70), [ECHO_ON_OUTGOING]);
    let others = (0..SHOTS).filter(|shot| ![50, 60, 70].contains(shot));
    assert!(others.flat_map(flags).all(|flags| flags == 0));
    assert_eq!((&totals["np_xtalk"], &totals["np_xtalk_dropped"]), (&4.into(), &0.into()));

    // The joint fit of pulse and echo recovers the emission time; a separate fit of the pulse is
    // 0.1 m late.
    let mixed = of_shot(&rows, 70)[0];
    let error_m = number(mixed, "range_m") - number(of_shot(&rows, 77)[0], "range_m");
    let sd_m = number(mixed, "range_sd_m");
    assert!(error_m.abs() < 3.0 * sd_m && (0.001..0.03).contains(&sd_m), "{error_m} {mixed:?}");
    assert!(rows.iter().all(|row| row["shot"] == "170" || number(row, "range_sd_m") < 0.02));

    let (kept, totals) = run(&place, "", "", "drop_emission_crosstalk = true");
    assert_eq!(of_shot(&kept, 50).len(), 0);
    assert_eq!(of_shot(&kept, 60).len(), 1);
    assert_eq!((&totals["np_xtalk"], &totals["np_xtalk_dropped"]), (&2.into(), &2.into()));
    let total = |name: &str| totals[name].as_u64().unwrap();
    assert_eq!(
        total("n_candidates") + total("n_added"),
        total("np") + total("np_filtered") + total("np_merged") + total("np_xtalk_dropped")
    );
    assert_eq!(total("nw"), total("nw_empty") + total("nw_deleted") + total("nw_with_points"));
}

/// Echoes 1.5 and 3.25 samples from the outgoing pulse widen it without a second maximum.
#[test]
fn echoes_that_merge_with_the_outgoing_pulse_are_flagged_and_their_ranges_hold() {
    let height = |number: usize| if number.is_multiple_of(20) { 75.0 } else { 15.0 };
    let distance = |number: usize| if number % 40 < 20 { 1.5 } else { 3.25 };
    let place = recording(|number, shot| {
        if number % 10 == 5 || number.is_multiple_of(20) {
            let pulses = [(20.0, 150.0), (20.0 + distance(number), height(number))];
            shot.blocks[0].2 = samples(1000 + number, &pulses);
        }
    });
    let (rows, _) = run(&place, "", "", "");
    let is_mixed = |row: &Row| {
        let shot = number(row, "shot") as usize - 100;
        shot % 10 == 5 || shot.is_multiple_of(20)
    };
    let error_ns = |row: &Row| {
        let place = 0.1 * ((number(row, "shot") as usize - 100) % 7) as f64;
        number(row, "time_of_flight_ns") - (1024.0 + place)
    };
    let (mixed, clean): (Vec<&Row>, Vec<&Row>) = rows.iter().partition(|row| is_mixed(row));
    let flagged = |rows: &[&Row]| rows.iter().filter(|row| flags_of(row) & ECHO_ON_OUTGOING != 0).count();
    assert_eq!((flagged(&mixed), flagged(&clean)), (mixed.len(), 0));
    // Shots share a calibrated constant, estimated from the other shots.
    let constant = clean.iter().map(|row| error_ns(row)).sum::<f64>() / clean.len() as f64;
    let scores = mixed.iter().map(|row| (error_ns(row) - constant) / number(row, "time_of_flight_sd_ns"));
    let z = (scores.map(|score| score * score).sum::<f64>() / mixed.len() as f64).sqrt();
    println!("{} mixed shots: z {z:.2}", mixed.len());
    assert!(mixed.len() == 48 && z < 1.2, "{z}");
}

#[test]
fn the_last_of_several_returns_may_have_its_own_threshold() {
    let place = recording(|number, shot| match number {
        10 => shot.blocks[1].2 = samples(number, &[(14.0, 120.0), (36.0, 9.0)]),
        11 => shot.blocks[1].2 = samples(number, &[(14.0, 9.0), (36.0, 120.0)]),
        12 => shot.blocks[1].2 = samples(number, &[(24.0, 9.0)]),
        _ => {}
    });
    let counts = |keys: &str| {
        let (rows, totals) = run(&place, "", "", keys);
        ([10, 11, 12].map(|shot| of_shot(&rows, shot).len()), totals["np_filtered"].as_u64().unwrap())
    };
    let (without, filtered) = counts("");
    assert_eq!(without, [2, 2, 1]);
    let (with, more_filtered) = counts("detection_sigma_last = 30");
    assert_eq!(with, [1, 2, 1], "only the last of several returns is affected");
    assert_eq!(more_filtered, filtered + 1);
}

/// Mean error of `time_of_flight_ns` and its SD, for echoes at 24 + 0.1 (shot % 7).
fn bias_ns(rows: &[Row]) -> (f64, f64) {
    let error = |row: &Row| {
        let place = 0.1 * ((number(row, "shot") as usize - 100) % 7) as f64;
        number(row, "time_of_flight_ns") - (1024.0 + place)
    };
    let errors: Vec<f64> = rows.iter().map(error).filter(|error| error.abs() < 1.0).collect();
    assert!(errors.len() > SHOTS / 2);
    let n = errors.len() as f64;
    let mean = errors.iter().sum::<f64>() / n;
    let variance = errors.iter().map(|error| (error - mean).powi(2)).sum::<f64>() / (n - 1.0);
    (mean, (variance / n).sqrt())
}

/// Odd samples are taken 0.1 samples late. The bias appears only in the echo digitiser, because the
/// outgoing pulse is omitted and times count from the clock.
#[test]
fn odd_samples_that_come_late_bias_no_range() {
    let late = |k: usize| k as f64 + if k % 2 == 1 { 0.1 } else { 0.0 };
    let shot = |number: usize| Shot {
        clock_ps: (number as f64 * INTERVAL_NS * 1000.0) as i64,
        blocks: vec![(LOW, 1000.0, samples_at(number, &[(24.0 + 0.1 * (number % 7) as f64, 120.0)], late))],
    };
    let all: Vec<Shot> = (0..SHOTS).map(shot).collect();
    let place = TestFolder::with(&[("a.arrow", &of_shots(&all, EmissionReference::Clock, true))]);
    let (without, _) = run(&place, "", "response = 'gaussian'", "");
    let (bias, sd) = bias_ns(&without);
    assert!((bias + 0.05).abs() < 4.0 * sd, "half of the shift: {bias} {sd}");
    let (with, _) = run(&place, "odd_sample_shift = 0.1", "response = 'gaussian'", "");
    let (bias, sd) = bias_ns(&with);
    assert!(bias.abs() < 4.0 * sd && sd < 0.004, "{bias} {sd}");

    // With a response calibrated on the recording itself, time zero is the peak of the response.
    let (with, _) = run(&place, "odd_sample_shift = 0.1", "save = 'model.json'", "");
    let (bias, sd) = bias_ns(&with);
    assert!(bias.abs() < 0.01 + 4.0 * sd, "{bias} {sd}");
    let model: serde_json::Value = serde_json::from_str(&place.text("out/model.json")).unwrap();
    assert_eq!(model["low_power"]["digitiser"]["odd_sample_shift"], 0.1);
}

/// Points of LAS move along their beams by the added time of flight.
#[test]
fn a_time_offset_moves_points_along_their_beams() {
    let las = wavex_testkit::las::Las::new(SHOTS);
    let place = TestFolder::with(&[("a.las", &las.las()), ("a.wdp", &las.packets)]);
    let mut found = Vec::new();
    for offset in ["", "range_time_offset_ns = 10.0\n"] {
        let stages = format!("{offset}{}", wavex_testkit::TO_TABLE);
        place.succeeds("read_las", "a.las", &stages);
        let text = place.text("out/a.csv");
        let mut rows = text.lines().map(|row| row.split(',').map(str::to_owned).collect::<Vec<_>>());
        let names = rows.next().unwrap();
        let columns = ["range_m", "x", "y", "z"].map(|name| names.iter().position(|n| n == name).unwrap());
        found.push(rows.map(|row| columns.map(|at| row[at].parse::<f64>().unwrap())).collect::<Vec<_>>());
    }
    let [as_is, moved] = &found[..] else { panic!("two runs") };
    assert!(as_is.len() >= SHOTS && as_is.len() == moved.len());
    let expected_m = 10.0 * shots::METRES_PER_NS;
    for (as_is, moved) in as_is.iter().zip(moved) {
        let farther_m = moved[0] - as_is[0];
        let step_m = (1..4).map(|axis| (moved[axis] - as_is[axis]).powi(2)).sum::<f64>().sqrt();
        assert!(
            (farther_m - expected_m).abs() < 1e-5 && (step_m - expected_m).abs() < 1e-3,
            "{farther_m} {step_m}"
        );
    }
}

/// Every echo has an exponential tail of 40 % of its area. After its removal, no return is found in
/// it, and widths and amplitudes are those of the echoes.
#[test]
fn a_given_tail_is_taken_off_before_everything_else() {
    let (amplitude, time_ns) = (0.4, 12.0);
    let with_tail = |number: usize| {
        let clean = samples(number, &[(16.0, 120.0)]);
        let kept = f64::exp(-1.0 / time_ns);
        let mut tail = 0.0;
        let digitised = clean.iter().map(|&sample| {
            let seen = f64::from(sample) + tail;
            tail = kept * tail + amplitude * (1.0 - kept) * (f64::from(sample) - 3.0);
            seen.round().clamp(0.0, 255.0) as u16
        });
        digitised.collect::<Vec<u16>>()
    };
    let shot = |number: usize| Shot {
        clock_ps: (number as f64 * INTERVAL_NS * 1000.0) as i64,
        blocks: vec![(LOW, 1000.0, with_tail(number))],
    };
    let all: Vec<Shot> = (0..SHOTS).map(shot).collect();
    let place = TestFolder::with(&[("a.arrow", &of_shots(&all, EmissionReference::Clock, true))]);
    let gaussian = "response = 'gaussian'";
    let (without, _) = run(&place, "", gaussian, "");
    let keys = format!("{gaussian}\ndecay_amplitude = {amplitude}\ndecay_time_ns = {time_ns}");
    let (with, _) = run(&place, "", &keys, "");
    assert!(without.len() > SHOTS * 5 / 4, "a Gaussian takes the tail for returns: {}", without.len());
    assert_eq!(with.len(), SHOTS);
    let mean = |column: &str| with.iter().map(|row| number(row, column)).sum::<f64>() / with.len() as f64;
    assert!((mean("amplitude_dn") - 120.0).abs() < 0.5, "{}", mean("amplitude_dn"));
    assert!((mean("time_of_flight_ns") - 1016.0).abs() < 0.01, "{}", mean("time_of_flight_ns"));
    assert!((mean("fwhm_ns") - 4.5).abs() < 0.05, "{}", mean("fwhm_ns"));
}

#[test]
fn a_model_for_other_samples_is_used_as_it_is_and_said_so() {
    let place = recording(|_, _| {});
    run(&place, "", "save = 'model.json'", "");
    let model = place.path("out/model.json");
    let load = format!("load = '{}'", model.display());
    let (_, _) = run(&place, "", &load, "");
    let notes = |place: &TestFolder| {
        place.text("out/report.json").matches("the values of the model are used").count()
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
    assert_eq!(place.text("out/report.json").matches("the sensor model is a preset").count(), 1);
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
    let notes = |text: &str| place.text("out/report.json").matches(text).count();

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
    // A container with the key of another program.
    let (ours, theirs) = (b"wavex.full_scale_dn", b"other.full_scale_dn");
    let mut bytes = std::fs::read(place.path("a.arrow")).unwrap();
    while let Some(at) = bytes.windows(ours.len()).position(|window| window == ours) {
        bytes[at..at + ours.len()].copy_from_slice(theirs);
    }
    place.write("a.arrow", &bytes);
    let notes =
        || place.text("out/report.json").matches("the reader's key `full_scale_dn` (255 for 8 bits)").count();
    run(&place, "", "", "");
    let unknown = notes();
    run(&place, "full_scale_dn = 255", "save = 'model.json'", "");
    assert_eq!((unknown, notes()), (1, 0));
    let model: serde_json::Value = serde_json::from_str(&place.text("out/model.json")).unwrap();
    assert_eq!(model["low_power"]["full_scale_dn"], 255.0);
}

/// Returns of the same shots in two modes.
fn pairs<'a>(a: &'a [Row], b: &'a [Row], shots: &[usize]) -> Vec<(&'a Row, &'a Row)> {
    let of = |&shot: &usize| {
        let (a, b) = (of_shot(a, shot), of_shot(b, shot));
        assert_eq!(a.len(), b.len(), "shot {shot}");
        a.into_iter().zip(b).collect::<Vec<_>>()
    };
    shots.iter().flat_map(of).collect()
}

#[test]
fn modes_agree_where_returns_stand_alone_and_refine_on_request_where_they_overlap() {
    modes_differ_as_their_names_say("", 0);
}

/// Also with a background per waveform, few waveforms are left to the plain kernels.
#[test]
fn modes_differ_where_each_waveform_has_a_background_of_its_own() {
    let place = modes_differ_as_their_names_say("background = 'per_waveform'", 3);
    for mode in ["fastest", "fast_separated", "refined"] {
        run(&place, "", "background = 'per_waveform'", &format!("mode = '{mode}'"));
        let report: serde_json::Value = serde_json::from_str(&place.text("out/report.json")).unwrap();
        let stages = report["inputs"][0]["stages"].as_array().unwrap();
        let observed = |stage: &serde_json::Value| stage["observed"]["left_to_plain_kernels"].clone();
        let left = stages.iter().map(observed).find(|left| !left.is_null()).unwrap();
        let left = left["mean"].as_f64().unwrap() * left["count"].as_f64().unwrap();
        assert!(left < 0.05 * SHOTS as f64, "{mode}: {left}");
    }
}

/// Runs all modes with this key of `calibrate`, on waveforms whose levels differ by up to
/// `levels - 1` DN.
fn modes_differ_as_their_names_say(calibrate: &str, levels: usize) -> TestFolder {
    let place = recording(|number, shot| {
        if number % 5 == 3 {
            let apart = 7.0 + 0.05 * (number % 40) as f64;
            shot.blocks[1].2 = samples(number, &[(20.0, 120.0), (20.0 + apart, 70.0)]);
        }
        let level = (number % levels.max(1)) as u16;
        shot.blocks[1].2.iter_mut().for_each(|sample| *sample += level);
    });
    let of_mode = |keys: &str| run(&place, "", calibrate, keys);
    let (refined, totals) = of_mode("");
    assert_eq!(totals["nw_refined1x"], SHOTS);
    assert!(refined.iter().all(|row| flags_of(row) & REFINED != 0));
    let (overlapping, isolated): (Vec<usize>, Vec<usize>) = (0..SHOTS).partition(|shot| shot % 5 == 3);
    assert!(overlapping.iter().all(|&shot| of_shot(&refined, shot).len() == 2));

    for mode in ["fastest", "fast_separated", "slow"] {
        let (rows, totals) = of_mode(&format!("mode = '{mode}'"));
        let pairs = pairs(&refined, &rows, &isolated);
        assert_eq!(pairs.len(), isolated.len());
        for quantity in ["time_of_flight_ns", "amplitude_dn", "width_ratio"] {
            let sd = match quantity.rsplit_once('_') {
                Some((name, unit @ ("ns" | "dn"))) => format!("{name}_sd_{unit}"),
                _ => format!("{quantity}_sd"),
            };
            let distance =
                |(a, b): &(&Row, &Row)| (number(a, quantity) - number(b, quantity)).abs() / number(a, &sd);
            let far = pairs.iter().map(distance).fold(0.0, f64::max);
            println!("{mode}: {quantity} within {far:.3} standard deviations");
            assert!(far < 0.5, "{mode} {quantity}: {far}");
        }
        let refined_of = |shots: &[usize]| {
            let rows = shots.iter().flat_map(|&shot| of_shot(&rows, shot));
            rows.filter(|row| flags_of(row) & REFINED != 0).count()
        };
        let found = (refined_of(&isolated), refined_of(&overlapping));
        let both = 2 * overlapping.len();
        match mode {
            // Pulses that one step does not settle are fitted.
            "fastest" => assert!(found.0 == 0 && 4 * found.1 < both, "{found:?}"),
            "fast_separated" => {
                let is = |row: &Row, flag: u16| flags_of(row) & flag != 0;
                assert!(rows.iter().all(|row| is(row, REFINED) == is(row, OVERLAP)));
                assert!(found.0 == 0 && found.1 * 100 >= 95 * both, "{found:?}");
            }
            _ => assert_eq!(found, (isolated.len(), both)),
        }
        let any_refined = |shot: &usize| of_shot(&rows, *shot).iter().any(|row| flags_of(row) & REFINED != 0);
        assert_eq!(totals["nw_refined1x"], (0..SHOTS).filter(any_refined).count(), "{mode}");
    }
    for mode in ["fastest", "fast_separated"] {
        let (rows, _) = of_mode(&format!("mode = '{mode}'\nrefine_when_needed = true"));
        for (expected, found) in pairs(&refined, &rows, &overlapping) {
            assert_eq!(expected, found, "{mode}");
        }
        let untouched = isolated.iter().flat_map(|&shot| of_shot(&rows, shot));
        assert!(untouched.filter(|row| flags_of(row) & REFINED == 0).count() * 10 > isolated.len() * 9);
    }
    place
}
