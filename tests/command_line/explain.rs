//! `wavex explain`: the table agrees with that of a run, the picture is complete, and errors are
//! reported.

use wavex_formats::container::EmissionReference;
use wavex_testkit::container::{Shot, of_shots};
use wavex_testkit::table::{self, Row};
use wavex_testkit::{Outcome, TestFolder, shots};

/// Runs `wavex explain` in a folder.
fn explain(place: &TestFolder, arguments: &[&str]) -> Outcome {
    place.wavex(&[&["explain"], arguments].concat())
}

/// Asserts that the command fails with this message, without output or files.
#[track_caller]
fn refused(place: &TestFolder, arguments: &[&str], code: i32, message: &str) {
    let Outcome { code: found, out, err } = explain(place, arguments);
    assert_eq!((found, out.as_str(), err), (Some(code), "", format!("error: {message}\n")));
}

/// A simulated recording, its model and its returns, in `out`.
fn simulated() -> TestFolder {
    let place = TestFolder::new();
    let job = "[[stage]]\ntype = 'simulate'\nstem = 'flight'\nlines = 2\nshots_per_line = 300\n\
               [[stage]]\ntype = 'write_arrow'\n\
               [[stage]]\ntype = 'calibrate'\nsave = 'model.json'\n\
               [[stage]]\ntype = 'decompose'\n\
               [[stage]]\ntype = 'write_table'\npath = '*.csv'\n\
               [[stage]]\ntype = 'georeference'\n\
               [[stage]]\ntype = 'write_las'\npath = '*.las'\n";
    assert_eq!(place.run(job), Outcome::success());
    place
}

/// Objects of `--progress=json` in the messages of a successful command.
fn objects(outcome: &Outcome) -> Vec<serde_json::Value> {
    assert_eq!(outcome.code, Some(0), "{}", outcome.err);
    let objects: Vec<_> =
        outcome.err.lines().map(|line| serde_json::from_str(line).expect("only objects")).collect();
    assert!(!objects.is_empty(), "the first object comes at once");
    objects
}

#[test]
fn explain_copc_and_scan_show_their_progress_to_programs() {
    let place = simulated();
    for (arguments, phase, input) in [
        (["explain", "out/flight.arrow", "--shot", "7"].as_slice(), "run", "flight"),
        (&["copc", "out/flight.las"], "copc", "flight"),
        (&["scan", "out/flight.arrow"], "run", "flight"),
    ] {
        let objects = objects(&place.wavex(&[arguments, &["--progress=json"]].concat()));
        for object in &objects {
            assert_eq!((object["phase"].as_str(), object["input"].as_str()), (Some(phase), Some(input)));
            assert_eq!((object["number"].as_u64(), object["inputs"].as_u64()), (Some(1), Some(1)));
            assert!(object["elapsed_s"].as_f64() >= Some(0.0), "{object}");
        }
        assert_eq!(objects[0]["fraction"].as_f64(), Some(0.0), "{objects:?}");
        // Without an option, a log or a file has no lines of progress.
        let Outcome { err, .. } = place.wavex(arguments);
        assert_eq!(err, "");
    }
}

/// Rows of a table of returns for one shot, as cells by name.
fn rows_of(table: &str, shot: &str) -> Vec<Row> {
    table::rows(table).into_iter().filter(|row| row["shot"] == shot).collect()
}

/// Asserts that elements are properly nested and attributes are quoted.
fn assert_well_formed(svg: &str) {
    let mut open: Vec<&str> = Vec::new();
    let mut rest = svg;
    let mut elements = 0;
    while let Some(start) = rest.find('<') {
        assert!(!rest[..start].contains('>'), "a stray `<` or `>` before {}", &rest[start..]);
        let end = start + rest[start..].find('>').unwrap();
        let tag = &rest[start + 1..end];
        match tag.strip_prefix('/') {
            Some(closed) => assert_eq!(open.pop(), Some(closed)),
            None => {
                assert_eq!(tag.matches('"').count() % 2, 0, "{tag}");
                elements += 1;
                if !tag.ends_with('/') {
                    open.push(tag.split_whitespace().next().unwrap());
                }
            }
        }
        rest = &rest[end + 1..];
    }
    assert!(open.is_empty() && elements > 50, "{open:?} {elements}");
}

/// The stages learn from the first lines; the lines up to the shot are then skipped.
#[test]
fn a_shot_far_behind_the_first_ones_is_that_of_the_run() {
    let place = TestFolder::new();
    let learns = "calibrate.waveforms=500";
    let job = "[[stage]]\ntype = 'simulate'\nstem = 'flight'\nlines = 60\nshots_per_line = 100\n\
               [[stage]]\ntype = 'write_arrow'\n\
               [[stage]]\ntype = 'calibrate'\nwaveforms = 500\n\
               [[stage]]\ntype = 'decompose'\n\
               [[stage]]\ntype = 'write_table'\npath = '*.csv'\n";
    assert_eq!(place.run(job), Outcome::success());
    let table = place.text("out/flight.csv");
    for shot in ["5950", "1234"] {
        let Outcome { code, out, err } =
            explain(&place, &["out/flight.arrow", "--shot", shot, "--set", learns]);
        assert_eq!((code, err.as_str()), (Some(0), ""));
        let times: Vec<String> = rows_of(&table, shot)
            .iter()
            .map(|row| format!("{:.4}", row["time_of_flight_ns"].parse::<f64>().unwrap()))
            .collect();
        let printed = out.lines().skip(3).take_while(|line| !line.is_empty());
        let printed: Vec<&str> = printed.map(|line| line.split_whitespace().nth(2).unwrap()).collect();
        assert!(!times.is_empty());
        assert_eq!(printed, times);
    }
    let problem = "out/flight.arrow: no shot 6000; the 6000 shots are numbered 0 to 5999";
    refused(&place, &["out/flight.arrow", "--shot", "6000", "--set", learns], 2, problem);
}

#[test]
fn the_table_is_that_of_the_run_and_the_picture_is_whole() {
    let place = simulated();
    let table = place.text("out/flight.csv");
    let many = table.lines().skip(1).find(|row| row.split(',').nth(3) == Some("3")).unwrap();
    let shot = many.split(',').next().unwrap();
    let with_model =
        ["out/flight.arrow", "--shot", shot, "--model", "out/model.json", "--out", "picture.svg"];
    let Outcome { code, out, err } = explain(&place, &with_model);
    assert_eq!((code, err.as_str()), (Some(0), ""));

    let printed: Vec<&str> = out.lines().skip(3).take_while(|line| !line.is_empty()).collect();
    let rows = rows_of(&table, shot);
    assert_eq!(printed.len(), rows.len());
    for (line, row) in printed.iter().zip(&rows) {
        let number = |column: &str| row[column].parse::<f64>().unwrap();
        let pair = |value: &str, digits: usize| {
            let sd = match value.rsplit_once('_') {
                Some((quantity, unit)) if ["m", "ns", "dn"].contains(&unit) => {
                    format!("{quantity}_sd_{unit}")
                }
                _ => format!("{value}_sd"),
            };
            format!("{:.digits$} ± {:.digits$}", number(value), number(&sd))
        };
        let flags = wavex::scan_line::flags::words(row["flags"].parse().unwrap());
        let expected = [
            row["return_number"].clone(),
            row["channel"].clone(),
            pair("time_of_flight_ns", 4),
            pair("range_m", 4),
            pair("amplitude_dn", 2),
            pair("width_ratio", 4),
            pair("thickness_m", 4),
            format!("{:.2}", number("deviation_ratio")),
            flags,
        ];
        let cells: Vec<&str> = line.split("  ").map(str::trim).filter(|cell| !cell.is_empty()).collect();
        assert_eq!(cells, expected);
    }
    assert!(out.contains("\n  candidates: ") && out.contains("degrees of freedom"), "{out}");
    assert!(out.ends_with("wrote picture.svg\n"), "{out}");

    let svg = place.text("picture.svg");
    assert_well_formed(&svg);
    assert!(svg.contains("prefers-color-scheme:dark") && !svg.contains("<script"));
    for text in
        ["time of flight, ns", "digitiser steps, DN", "residual, std. dev.", "outgoing pulse", ">3</text>"]
    {
        assert!(svg.contains(text), "{text}");
    }

    // Calibration from the same waveforms gives the model that the run saved.
    let Outcome { code, out: by_itself, err } = explain(&place, &["out/flight.arrow", "--shot", shot]);
    assert_eq!((code, err.as_str()), (Some(0), ""));
    let name = format!("flight_shot_{shot}.svg");
    assert_eq!(by_itself, out.replace("picture.svg", &name));
    assert_eq!(place.text(&name), svg);

    // Points without waveforms cannot be explained.
    let message = "out/flight.las: points without waveforms; `wavex view out` shows the run in this folder with its waveforms";
    refused(&place, &["out/flight.las", "--shot", shot], 2, message);

    // The time of the shot selects it, and the keys of a job apply.
    let time = rows[0]["gps_time_s"].clone();
    let Outcome { code, out: by_time, err } =
        explain(&place, &["out/flight.arrow", "--time", &time, "--job", "job.toml"]);
    assert_eq!((code, by_time), (Some(0), by_itself));
    let other = "job.toml: its first stage `simulate` does not read out/flight.arrow: it is read by `read_arrow` with \
                 default keys\n";
    assert!(err.ends_with(other) && err.lines().count() == 1, "{err}");
    let set = ["--job", "job.toml", "--set", "decompose.detection_sigma=100"];
    let Outcome { code, out: none, .. } = explain(&place, &[&with_model[..], &set].concat());
    assert_eq!(code, Some(0));
    let nothing = "0 detected + 0 added = 0 kept";
    assert!(none.contains(nothing) && !out.contains(nothing), "{none}");
    // Returns before the last one stay; the others are filtered for one reason.
    let set = ["--set", "decompose.detection_sigma_last=1000"];
    let Outcome { code, out: fewer, .. } = explain(&place, &[&with_model[..], &set].concat());
    assert_eq!(code, Some(0));
    let reasons = fewer.lines().find_map(|line| line.strip_prefix("  filtered: ")).unwrap();
    assert!(reasons.contains(" too weak"), "{fewer}");
}

/// Shots with one echo each, except the third, which has only an outgoing pulse.
fn by_hand(timed: bool) -> Vec<u8> {
    with_gap(timed, 0)
}

/// The same, with a gap before the last ten shots.
fn with_gap(timed: bool, gap_ps: i64) -> Vec<u8> {
    let block = |shot: usize| shots::echo(shot).into_iter().map(u16::from).collect::<Vec<u16>>();
    let shot = |number: usize| Shot {
        clock_ps: number as i64 * 5_000_000 + if number < 250 { 0 } else { gap_ps },
        blocks: vec![if number == 2 { (3, 0.0, block(number)) } else { (1, 1000.0, block(number)) }],
    };
    of_shots(&(0..260).map(shot).collect::<Vec<_>>(), EmissionReference::Clock, timed)
}

#[test]
fn what_cannot_be_explained_is_said() {
    let place =
        TestFolder::with(&[("a.arrow", &by_hand(true)), ("timeless.arrow", &by_hand(false)), ("a.dat", b"")]);
    let message = "a.arrow: no shot 99; the 260 shots are numbered 100 to 359";
    refused(&place, &["-q", "a.arrow", "--shot", "99"], 2, message);
    let message = "--out a.arrow: the picture is SVG; give a name that ends in .svg";
    refused(&place, &["a.arrow", "--shot", "101", "--out", "a.arrow"], 2, message);
    let message = "a.arrow: shot 102 has no recorded echoes; choose another one";
    refused(&place, &["-q", "a.arrow", "--shot", "102"], 2, message);
    let message = "timeless.arrow: its shots have no times; select one with --shot";
    refused(&place, &["-q", "timeless.arrow", "--time", "1"], 2, message);
    for time in ["-5", "NaN"] {
        let message = format!(
            "a.arrow: no shot at {time} s; its times are from 0.000000 to 0.001295 s, seconds of the GPS week"
        );
        refused(&place, &["-q", "a.arrow", "--time", time], 2, &message);
    }
    for (time, remedy) in [
        ("0,001", "write a decimal point: 0.001"),
        (
            "2026-11-27",
            "give GPS seconds on the time scale of the recording, as in the column `gps_time_s` of write_table",
        ),
    ] {
        let Outcome { code, err, .. } = place.wavex(&["explain", "a.arrow", "--time", time]);
        let message = format!("error: invalid value '{time}' for '--time <GPS_SECONDS>': {remedy}\n");
        assert!(code == Some(2) && err.starts_with(&message), "{err}");
    }
    let message = "a.dat: unknown recording format; supported extensions: .las, .laz, .pls, .plz, .sdf, .wfm, .arrow, .h5, .hdf5 and .spd";
    refused(&place, &["a.dat", "--shot", "1"], 2, message);
    place.write("short.toml", b"[[stage]]\ntype = 'read_arrow'\npath = 'a.arrow'\n");
    let message = "short.toml: the job has no stage `calibrate`; add one";
    refused(&place, &["a.arrow", "--shot", "1", "--job", "short.toml"], 2, message);
}

#[test]
fn a_large_footprint_that_cannot_be_measured_is_named() {
    let granule = include_bytes!("../../crates/wavex-hdf5/tests/data/gedi_product.h5");
    let place = TestFolder::with(&[("a.h5", granule)]);
    let message = "a.h5: no shot 99; give a number of the column `shot_number`, or a running number below 12";
    refused(&place, &["a.h5", "--shot", "99"], 1, message);
    place.write("m.json", b"{}");
    let message = format!(
        "a.h5: {}: not models of footprints: missing field `format` at line 1 column 2; load a file written by `save` \
         of measure_footprints, or learn from the recording",
        place.path("m.json").display()
    );
    refused(&place, &["a.h5", "--shot", "3", "--model", "m.json"], 1, &message);
    place.write("short.toml", b"[[stage]]\ntype = 'read_hdf5'\npath = 'a.h5'\n");
    let message = "short.toml: the job has no stage `measure_footprints`; add one";
    refused(&place, &["a.h5", "--shot", "1", "--job", "short.toml"], 2, message);
    let message = "a.h5: 0 shots have a recorded outgoing pulse, and 10 are needed for the response of the receiver; \
                   read a longer part of the beam, leave the beam out with `beams` of read_hdf5, or `load` the models that `save` wrote of the whole recording; small footprints \
                   are for `calibrate` and `decompose`";
    refused(&place, &["a.h5", "--shot", "3"], 1, message);
}

#[test]
fn a_shot_that_is_not_at_the_time_is_reported() {
    let place = TestFolder::with(&[("a.arrow", &with_gap(true, 100_000_000_000))]);
    for (time, said) in [
        ("0.011245", Some("\nthe nearest shot is 10.000 ms before 0.011245 s\nwrote a_shot_349.svg\n")),
        ("0.09925", Some("\nthe nearest shot is 2.000 ms after 0.09925 s\nwrote a_shot_350.svg\n")),
        ("0.0005", None),
        ("-0.0005", None),
    ] {
        let Outcome { code, out, err } = explain(&place, &["a.arrow", "--time", time]);
        assert_eq!(code, Some(0), "{err}");
        assert_eq!(out.contains("the nearest shot"), said.is_some(), "{time}: {out}");
        assert!(out.ends_with(said.unwrap_or_default()), "{time}: {out}");
    }
}

#[test]
fn a_file_without_waveforms_is_refused() {
    let empty = of_shots(
        &[Shot { clock_ps: 0, blocks: Vec::new() }, Shot { clock_ps: 5, blocks: Vec::new() }],
        EmissionReference::Clock,
        true,
    );
    let place = TestFolder::with(&[("empty.arrow", &empty)]);
    let message = "stage calibrate: empty.arrow: the low power receiver: calibration needs 200 \
                   waveforms of the channel and there were 0; give it more data, or load a saved sensor model";
    refused(&place, &["empty.arrow", "--shot", "100"], 1, message);
    let Outcome { code, err, .. } = explain(&place, &["empty.arrow", "--shot", "1", "--time", "2"]);
    assert_eq!(code, Some(2));
    assert!(err.contains("cannot be used with"), "{err}");
}

#[test]
fn a_job_in_place_of_the_recording_is_given_by_its_option() {
    let place = TestFolder::with(&[("a.toml", b"")]);
    let message = "a.toml: it is a job, not a recording; give the recording, and the job by an option: wavex explain \
                   RECORDING --job a.toml --shot N";
    refused(&place, &["a.toml"], 2, message);
}

#[test]
fn a_job_of_one_recording_is_explained_with_its_keys() {
    let place = simulated();
    let job = |path: &str| {
        format!(
            "[job]\ninput_dir = 'out'\n[[stage]]\ntype = 'read_arrow'\npath = '{path}'\n[[stage]]\ntype = 'calibrate'\n\
             load = 'model.json'\n[[stage]]\ntype = 'decompose'\ndetection_sigma = 7\n"
        )
    };
    place.write("a.toml", job("*.arrow").as_bytes());
    let of_job = explain(&place, &["a.toml", "--shot", "3"]);
    assert_eq!(of_job.code, Some(0), "{}", of_job.err);
    assert_eq!(of_job, explain(&place, &["out/flight.arrow", "--job", "a.toml", "--shot", "3"]));
    assert!(of_job.out.contains("wrote flight_shot_3.svg"), "{}", of_job.out);

    let remedy =
        "give the recording, and the job by an option: wavex explain RECORDING --job a.toml --shot N";
    let message = format!("a.toml: it is a job, and --job is another one; {remedy}");
    refused(&place, &["a.toml", "--shot", "3", "--job", "b.toml"], 2, &message);
    place.write("out/second.arrow", &std::fs::read(place.path("out/flight.arrow")).unwrap());
    refused(&place, &["a.toml", "--shot", "3"], 2, &format!("a.toml: it is a job of 2 recordings; {remedy}"));
    place.write("a.toml", b"[[stage]]\ntype = 'simulate'\n");
    refused(&place, &["a.toml", "--shot", "3"], 2, &format!("a.toml: it is a job of 0 recordings; {remedy}"));
    place.write("a.toml", job("none.arrow").as_bytes());
    refused(&place, &["a.toml", "--shot", "3"], 2, "out/none.arrow: no such file or folder; check the path");
    place.write("a.toml", job("none*.arrow").as_bytes());
    let Outcome { code, err, .. } = explain(&place, &["a.toml", "--shot", "3"]);
    assert!(code == Some(2) && err.starts_with("error: a.toml: ") && err.contains("none*.arrow"), "{err}");
}
