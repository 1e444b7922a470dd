//! Instrument returns: when they become points, and comparison with computed ones.

use std::path::Path;

use wavex::scan_line::flags::INSTRUMENT;
use wavex_formats::container::{
    Compression, ContainerHeader, ContainerOnline, ContainerShot, ContainerWriter, EmissionReference,
    LineBuilder, TimeScale,
};
use wavex_testkit::container::{Shot, block, nadir_shot, of_shots};
use wavex_testkit::shots::{echo, peak, time_s};
use wavex_testkit::table::{self, Row, number};
use wavex_testkit::{Outcome, TestFolder};

const SHOTS: usize = 320;
/// Every tenth shot has no waveform.
const WITHOUT: usize = SHOTS / 10;
const START_NS: f64 = 4000.0;

/// Each shot has an instrument return 0.25 ns after its echo with twice its amplitude; shots
/// without a waveform have two.
fn recording(zone: Option<i16>) -> TestFolder {
    let header = ContainerHeader {
        time_scale: TimeScale::Week,
        emission_reference: Some(EmissionReference::Clock),
        ..ContainerHeader::new(1.0, 299_707_502.0)
    };
    let mut writer =
        ContainerWriter::file(Vec::new(), Path::new("made by hand"), &header, Compression::None).unwrap();
    let mut line = LineBuilder::new();
    for shot in 0..SHOTS {
        let clock_ps = (time_s(shot) * 1e12) as i64;
        line.shot(&ContainerShot {
            gps_time_s: Some(time_s(shot)),
            mta_zone: zone,
            ..nadir_shot(shot as u64, clock_ps)
        });
        let time_ns = START_NS + peak(shot) + 0.25;
        if shot % 10 == 0 {
            line.online(&ContainerOnline { time_ns: time_ns + 100.0, amplitude: 30.0 });
        } else {
            let samples: Vec<u16> = echo(shot).into_iter().map(u16::from).collect();
            line.block(&block(1, START_NS, &samples));
        }
        line.online(&ContainerOnline { time_ns, amplitude: 120.0 });
    }
    writer.write(line).unwrap();
    TestFolder::with(&[("a.arrow", &writer.finish().unwrap())])
}

/// A job over the recording, with `keys` of `decompose`.
fn job(keys: &str) -> String {
    format!(
        "[[stage]]\ntype = 'read_arrow'\npath = 'a.arrow'\n[[stage]]\ntype = 'calibrate'\nwaveforms = 250\n\
         [[stage]]\ntype = 'decompose'\n{keys}\n[[stage]]\ntype = 'correct'\nincidence = 'none'\n\
         [[stage]]\ntype = 'write_table'\npath = '*.csv'\n"
    )
}

/// Rows of the table, and the input's part of the report.
#[track_caller]
fn run(keys: &str) -> (Vec<Row>, serde_json::Value) {
    let place = recording(Some(0));
    let outcome = place.run(&job(keys));
    assert_eq!(outcome, Outcome::success());
    let rows = table::rows(&place.text("out/a.csv"));
    let report: serde_json::Value = serde_json::from_str(&place.text("out/job_report.json")).unwrap();
    (rows, report["inputs"][0].clone())
}

fn is_own(row: &&Row) -> bool {
    row["flags"].parse::<u16>().unwrap() & INSTRUMENT != 0
}

#[test]
fn shots_without_a_waveform_have_the_instruments_returns() {
    let (rows, report) = run("");
    let own: Vec<&Row> = rows.iter().filter(is_own).collect();
    assert_eq!(own.len(), 2 * WITHOUT);
    assert_eq!(report["totals"]["np_online"], 2 * WITHOUT);
    assert_eq!(report["totals"]["nw"], SHOTS - WITHOUT);
    // Sorted by time, with the instrument's amplitude; unknown attributes are missing.
    let (first, second) = (own[0], own[1]);
    assert_eq!((number(first, "return_number"), number(second, "return_number")), (1.0, 2.0));
    assert_eq!(number(first, "number_of_returns"), 2.0);
    let range_m = 0.5e-9 * 299_707_502.0 * (START_NS + peak(0) + 0.25);
    assert!((number(first, "range_m") - range_m).abs() < 1e-3, "{first:?}");
    assert_eq!(number(first, "range_sd_m"), 0.255);
    let unknown = ["width_ratio", "amplitude_dn", "amplitude_sd_dn", "intensity_sd", "deviation_ratio"];
    assert!(unknown.iter().all(|column| number(first, column).is_nan()), "{first:?}");
    // Corrected for range like any other return.
    let by_range = (range_m / 1000.0).powi(2);
    assert!((number(first, "intensity") / (120.0 * by_range) - 1.0).abs() < 1e-6, "{first:?}");
    let shots: Vec<f64> = rows.iter().map(|row| number(row, "gps_time_s")).collect();
    assert!(shots.is_sorted(), "returns are in order of their shots");
}

#[test]
fn they_can_be_left_out_or_stand_in_for_all() {
    let (never, report) = run("online_points = 'never'");
    assert_eq!((never.iter().filter(is_own).count(), &report["totals"]["np_online"]), (0, &0.into()));
    let (only, report) = run("online_points = 'only'");
    assert_eq!(only.len(), SHOTS + WITHOUT);
    assert!(only.iter().all(|row| is_own(&row)));
    let totals = &report["totals"];
    assert_eq!(
        (&totals["nw"], &totals["nw_with_points"]),
        (&(SHOTS - WITHOUT).into(), &(SHOTS - WITHOUT).into())
    );
    assert_eq!((&totals["nw_empty"], &totals["n_candidates"]), (&0.into(), &0.into()));
}

/// Nothing is decomposed, so nothing needs to be calibrated.
#[test]
fn without_decomposition_there_is_no_need_to_calibrate() {
    let calibrate = "[[stage]]\ntype = 'calibrate'\nwaveforms = 250\n";
    let place = recording(Some(0));
    let with = job("online_points = 'only'");
    assert_eq!(place.run(&with), Outcome::success());
    let expected = place.text("out/a.csv");
    assert_eq!(expected.lines().count(), 1 + SHOTS + WITHOUT);
    let without = with.replace(calibrate, "");
    assert_eq!(place.run(&without), Outcome::success());
    assert_eq!(place.text("out/a.csv"), expected);
    let report: serde_json::Value = serde_json::from_str(&place.text("out/job_report.json")).unwrap();
    assert_eq!(report["inputs"][0]["totals"]["nw_with_points"], SHOTS - WITHOUT);

    for keys in ["", "online_points = 'fallback'"] {
        let outcome = place.run(&job(keys).replace(calibrate, ""));
        assert_eq!(outcome.code, Some(2));
        assert!(outcome.err.contains("`decompose` requires `calibrate` before it"), "{outcome:?}");
    }
}

/// Waveforms of a recording without the instrument's returns are accounted for as empty.
#[test]
fn waveforms_without_an_own_return_are_empty() {
    let shot = |number: usize| Shot {
        clock_ps: (time_s(number) * 1e12) as i64,
        blocks: vec![(1, START_NS, echo(number).into_iter().map(u16::from).collect())],
    };
    let shots: Vec<Shot> = (0..40).map(shot).collect();
    let place = TestFolder::with(&[("a.arrow", &of_shots(&shots, EmissionReference::Clock, true))]);
    let stages = "[[stage]]\ntype = 'decompose'\nonline_points = 'only'\n";
    let totals = place.succeeds("read_arrow", "a.arrow", stages)["totals"].clone();
    assert_eq!((&totals["nw"], &totals["nw_empty"], &totals["np"]), (&40.into(), &40.into(), &0.into()));
}

/// Ranges count from outgoing pulses where they are recorded: those must be fitted.
#[test]
fn outgoing_pulses_need_a_calibration() {
    let place = TestFolder::new();
    let simulate = "[[stage]]\ntype = 'simulate'\nlines = 2\nshots_per_line = 50\n";
    let stages = "[[stage]]\ntype = 'decompose'\nonline_points = 'only'\n[[stage]]\ntype = 'write_table'\n";
    let problem = "stage decompose: ranges count from the outgoing pulses of this recording, and fitting them \
                   requires a sensor model; put calibrate before decompose";
    place.left_nothing(place.run(&format!("{simulate}{stages}")), problem);
}

#[test]
fn the_report_compares_them_with_computed_ones() {
    let (_, report) = run("");
    let stages = report["stages"].as_array().unwrap();
    let observed = &stages.iter().find(|stage| stage["type"] == "decompose").unwrap()["observed"];
    let of = |name: &str, what: &str| observed[name][what].as_f64().unwrap_or(f64::NAN);
    assert_eq!(of("online_matched", "count"), (SHOTS - WITHOUT) as f64, "{observed}");
    assert!(of("online_matched", "mean") > 0.99 && of("computed_matched", "mean") > 0.98, "{observed}");
    assert!((of("online_minus_computed_ns", "p50") - 0.25).abs() < 0.02, "{observed}");
    assert!((of("online_over_computed_amplitude", "p50") - 2.0).abs() < 0.05, "{observed}");
}

#[test]
fn zones_must_be_resolved() {
    let place = recording(None);
    let outcome = place.run(&job("online_points = 'only'"));
    assert_eq!(outcome.code, Some(1));
    assert!(outcome.err.contains("put resolve_mta before decompose"), "{outcome:?}");
}
