//! `wavex align`: a simulated survey with a known calibration, and surveys that cannot be aligned.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::fs;
use std::path::Path;
use std::sync::LazyLock;

use serde_json::Value;
use wavex_formats::trajectory::sbet::{RECORD_BYTES, SbetRecord};
use wavex_testkit::flight::files;
use wavex_testkit::{Outcome, TestFolder};

/// Lever arm and boresight of the flights.
const LEVER_ARM_M: [f64; 3] = [0.3, -0.2, 0.4];
const BORESIGHT_DEG: [f64; 3] = [0.2, -0.3, 0.4];

/// Error of the times of the trajectories.
const TIME_OFFSET_S: f64 = 0.003;

const JOB: &str = "[job]\noutput_dir = 'out'\nthreads = 2\nreport = ''\nlog = ''\nstat_log = ''\n\
                   [job.geometry]\ntrajectory = 'in/*.out'\n\
                   calibration = { lever_arm_m = [0.3, -0.2, 0.4], e0 = 0.03 }\n\
                   [[stage]]\ntype = 'read_arrow'\npath = 'in/*.arrow'\n\
                   [[stage]]\ntype = 'calibrate'\nload = 'in/model.json'\n\
                   [[stage]]\ntype = 'decompose'\nmode = 'fastest'\n\
                   [[stage]]\ntype = 'georeference'\n\
                   [[stage]]\ntype = 'write_table'\npath = '*.csv'\n";

/// Strips `a` and `b` in opposite directions and `c` across, `far` elsewhere, two more over a plain.
static FLOWN: LazyLock<BTreeMap<String, Vec<u8>>> = LazyLock::new(|| {
    let place = TestFolder::new();
    let (hills, plain) = ("house_ratio = 0.3", "house_ratio = 0.0\nrelief_m = 0.0");
    let strips = [
        ("a", 0.0, [0.0, 0.0], 120, hills),
        ("b", 180.0, [-30.0, 80.0], 120, hills),
        ("c", 90.0, [-40.0, 40.0], 120, hills),
        ("far", 0.0, [3000.0, 0.0], 40, hills),
        ("plain_1", 0.0, [0.0, 0.0], 60, plain),
        ("plain_2", 180.0, [-30.0, 40.0], 60, plain),
    ];
    for (number, (stem, direction_deg, offset_m, lines, land)) in strips.into_iter().enumerate() {
        let calibrate = match stem {
            "a" => {
                "[[stage]]\ntype = 'calibrate'\nwaveforms = 2000\nresponse = 'gaussian'\nsave = '../in/model.json'\n"
            }
            _ => "",
        };
        let made = place.run(&format!(
            "[[stage]]\ntype = 'simulate'\nstem = '{stem}'\nscene_seed = 1\nseed = {number}\nlines = {lines}\n\
             shots_per_line = 120\nlandscape = 'country'\nwood_ratio = 0.1\nwater_ratio = 0.0\nwire_height_m = 0.0\n\
             {land}\nflying_height_m = 120\nspeed_mps = 25\npulse_rate_hz = 7000\nroll_deg = 2.0\npitch_deg = 2.0\n\
             motion_period_s = 3.0\ntrack_direction_deg = {direction_deg:?}\ntrack_offset_m = {offset_m:?}\n\
             start_time_s = {}\nlever_arm_m = {LEVER_ARM_M:?}\nboresight_deg = {BORESIGHT_DEG:?}\nnoise_sd_dn = 0.5\n\
             noise_autocorrelation = []\nresponse = 'gaussian'\ntruth = '../in/*_truth.csv'\nsbet = '../in/*.out'\n\
             [[stage]]\ntype = 'write_arrow'\npath = '../in/*.arrow'\n{calibrate}",
            208_800 + 100 * number
        ));
        assert_eq!(made, Outcome::success());
    }
    files(&place.path("in"))
});

/// A survey of these strips with the job `survey.toml`.
fn survey(strips: &[&str]) -> TestFolder {
    let place = TestFolder::new();
    place.write("survey.toml", JOB.as_bytes());
    let copy = |name: &str| {
        place.write(&format!("in/{name}"), &FLOWN[name]);
    };
    copy("model.json");
    for strip in strips {
        copy(&format!("{strip}.arrow"));
        copy(&format!("{strip}.out"));
    }
    place
}

fn report(place: &TestFolder, folder: &str) -> Value {
    serde_json::from_str(&place.text(&format!("{folder}/align.json"))).unwrap()
}

fn parameter<'r>(report: &'r Value, name: &str) -> &'r Value {
    report["parameters"].as_array().unwrap().iter().find(|found| found["name"] == name).unwrap()
}

/// Median distance of the points of a strip from their true places, m.
fn distance_m(place: &TestFolder, strip: &str) -> f64 {
    let truth = String::from_utf8(FLOWN[&format!("{strip}_truth.csv")].clone()).unwrap();
    let (found, truth) = (points(&place.text(&format!("out/{strip}.csv"))), points(&truth));
    let distance_m = |(key, point): (&[u64; 2], &[f64; 3])| {
        let squares = point.iter().zip(truth.get(key)?).map(|(found, true_m)| (found - true_m).powi(2));
        Some(squares.sum::<f64>().sqrt())
    };
    let mut distances_m: Vec<f64> = found.iter().filter_map(distance_m).collect();
    distances_m.sort_by(f64::total_cmp);
    assert!(distances_m.len() > 10_000, "{}", distances_m.len());
    distances_m[distances_m.len() / 2]
}

/// Points of a table by shot and number of the return.
fn points(table: &str) -> BTreeMap<[u64; 2], [f64; 3]> {
    let mut rows = table.lines();
    let names: Vec<&str> = rows.next().unwrap().split(',').collect();
    let column = |name: &str| names.iter().position(|found| *found == name).unwrap();
    let (keys, places) = (["shot", "return_number"].map(column), ["x", "y", "z"].map(column));
    rows.map(|row| {
        let values: Vec<&str> = row.split(',').collect();
        let key = keys.map(|column| values[column].parse().unwrap());
        (key, places.map(|column| values[column].parse().unwrap()))
    })
    .collect()
}

/// Parameters with their true values, units, and largest errors in these.
fn truth() -> [(&'static str, f64, f64, f64); 8] {
    let millidegree = 1e-3f64.to_radians();
    let [roll, pitch, yaw] = BORESIGHT_DEG.map(f64::to_radians);
    let [forward_m, right_m, down_m] = LEVER_ARM_M;
    [
        ("boresight_roll_rad", roll, millidegree, 1.0),
        ("boresight_pitch_rad", pitch, millidegree, 8.0),
        ("boresight_yaw_rad", yaw, millidegree, 9.0),
        ("lever_forward_m", forward_m, 1e-3, 30.0),
        ("lever_right_m", right_m, 1e-3, 30.0),
        ("lever_down_m", down_m, 1e-3, 30.0),
        ("e0_m", 0.0, 1e-3, 5.0),
        ("time_offset_s", TIME_OFFSET_S, 1e-3, 0.1),
    ]
}

fn succeeds(place: &TestFolder, arguments: &[&str]) -> Outcome {
    let outcome = place.wavex(arguments);
    assert_eq!(outcome.code, Some(0), "wavex {arguments:?}\n{}{}", outcome.out, outcome.err);
    outcome
}

/// The commands of the how-to work, and find the calibration of the flights.
#[test]
fn a_survey_is_aligned_by_the_commands_of_the_how_to() {
    let place = survey(&["a", "b", "c"]);
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/how-to/align-a-survey.md");
    let page = fs::read_to_string(page).unwrap();
    let commands: Vec<String> = page
        .lines()
        .filter_map(|line| line.strip_prefix("wavex "))
        .map(|command| command.replace('"', ""))
        .collect();
    assert_eq!(commands.len(), 5, "{commands:?}");
    let keeping = "mode = 'fastest'\n[[stage]]\ntype = 'write_returns'\n";
    place.write("survey.toml", JOB.replace("mode = 'fastest'\n", keeping).as_bytes());
    for strip in ["a", "b", "c"] {
        let (records, _) = FLOWN[&format!("{strip}.out")].as_chunks::<RECORD_BYTES>();
        let late = records
            .iter()
            .map(SbetRecord::decode)
            .map(|record| SbetRecord { time_s: record.time_s + TIME_OFFSET_S, ..record });
        place
            .write(&format!("in/{strip}.out"), &late.flat_map(|record| record.encode()).collect::<Vec<u8>>());
    }
    succeeds(&place, &["run", "survey.toml", "--quiet"]);
    let before_m = ["a", "b", "c"].map(|strip| distance_m(&place, strip));
    place.write("fixed/corrections.toml", b"of an earlier alignment");
    let mut printed = String::new();
    let mut outputs = Vec::new();
    for command in &commands {
        let words: Vec<&str> = command.split_whitespace().collect();
        writeln!(printed, "{command}\n{}", succeeds(&place, &words).out).unwrap();
        outputs.push(["a", "b", "c"].map(|strip| place.text(&format!("out/{strip}.csv"))));
    }
    assert!(outputs[0] != outputs[3], "the run with the new files has changed the points");
    assert!(outputs[3] == outputs[4], "--apply gives the bytes of that run");
    println!("{printed}");
    let after_m = ["a", "b", "c"].map(|strip| distance_m(&place, strip));
    println!("points are {before_m:?} m from the truth before, {after_m:?} m after");
    assert!(
        before_m.iter().all(|m| *m > 0.3) && after_m.iter().all(|m| *m < 0.02),
        "{before_m:?} {after_m:?}"
    );
    for part in ["boresight roll, deg", "strips, ", "verdict: good", "next: wavex run survey.toml"] {
        assert!(printed.contains(part), "{part}: {printed}");
    }
    for folder in ["aligned", "fixed"] {
        let report = report(&place, folder);
        for (name, truth, unit, most) in truth() {
            let found = parameter(&report, name);
            let (value, sd) = (found["value"].as_f64().unwrap(), found["sd"].as_f64().unwrap());
            let error = (value - truth) / unit;
            println!("{folder}, {name}: error {error:.2}, SD {:.2}, in units of {unit:e}", sd / unit);
            assert_eq!(found["treatment"], "estimated", "{found}");
            // With the trajectory kept, SDs fall below what the curvature of the ground does to patches.
            let of_sd = if folder == "fixed" { f64::INFINITY } else { 3.0 * sd / unit };
            assert!(error.abs() < most && error.abs() < of_sd && sd / unit < most, "{found}");
        }
    }
    assert!(place.path("splines/corrections.toml").exists());
    assert!(!place.path("fixed/corrections.toml").exists(), "that of an earlier alignment is removed");
    // The same bytes for any number of threads.
    succeeds(&place, &["align", "survey.toml", "-o", "one", "--threads", "1", "--quiet"]);
    for name in ["calibration.toml", "corrections.toml", "align.json"] {
        assert!(place.text(&format!("aligned/{name}")) == place.text(&format!("one/{name}")), "{name}");
    }
    // Corrections are estimated anew, not added to those of the job.
    let corrected = ["--set", "job.geometry.corrections=aligned/corrections.toml"];
    let again = succeeds(&place, &[&["align", "survey.toml", "-o", "again"], &corrected[..]].concat());
    let note = "aligned/corrections.toml: the corrections of the job are not applied; those of this alignment replace them";
    assert!(again.err.contains(note), "{}", again.err);
    assert!(place.text("aligned/corrections.toml") == place.text("again/corrections.toml"));
    // The files of the job are not replaced.
    let set = "job.geometry.calibration=aligned/calibration.toml";
    let Outcome { code, err, .. } = place.wavex(&["align", "survey.toml", "-o", "aligned", "--set", set]);
    assert_eq!(code, Some(2));
    assert!(
        err.ends_with("aligned/calibration.toml: the job reads this file; write to another folder\n"),
        "{err}"
    );
}

/// A strip that cannot be aligned is named, and the others are aligned.
#[test]
fn the_rest_of_a_survey_is_aligned() {
    let place = survey(&["a", "b", "c", "far"]);
    // Of another day.
    fs::copy(place.path("in/far.out"), place.path("in/c.out")).unwrap();
    let Outcome { out, err, .. } = succeeds(&place, &["align", "survey.toml", "-o", "aligned"]);
    println!("{err}");
    let parts = [
        "left out: stage read_arrow: in/c.arrow: the recording and the trajectory have no time in common",
        "far: the strip shares no smooth surface with another one and is not aligned",
    ];
    assert!(parts.iter().all(|part| err.contains(part)), "{err}");
    let report = report(&place, "aligned");
    assert_eq!(report["failed_strips"][0]["name"], "c");
    assert!(out.contains("\n2 of 3 strips, "), "{out}");
    let corrections = place.text("aligned/corrections.toml");
    let named: Vec<&str> = corrections.lines().filter(|line| line.starts_with("recording")).collect();
    assert_eq!(named, ["recording = \"a\"", "recording = \"b\""]);
}

/// A wrong mount leaves no files that could be used; a start value that is far off is named.
#[test]
fn a_bad_alignment_leaves_its_report_alone() {
    let place = survey(&["a", "b", "c"]);
    succeeds(&place, &["align", "survey.toml", "-o", "aligned", "--quiet"]);
    let turned = ["align", "survey.toml", "-o", "aligned", "--set", "job.geometry.mount=[0,0,180]"];
    let Outcome { code, out, err } = place.wavex(&turned);
    println!("{out}{err}");
    assert_eq!(code, Some(1), "{err}");
    assert!(out.contains("verdict: bad") && !out.contains("next:"), "{out}");
    for part in [
        "error: the alignment is bad: the remaining differences are ",
        "check mount, units of the start values",
    ] {
        assert!(err.contains(part), "{err}");
    }
    assert_eq!(report(&place, "aligned")["verdict"], "bad");
    assert!(
        !place.path("aligned/calibration.toml").exists() && !place.path("aligned/corrections.toml").exists()
    );
    let far = "job.geometry.calibration={lever_arm_m=[0.3,-0.2,0.4],boresight_deg=[-7.0,0.0,0.0],e0=0.0}";
    let Outcome { out, err, .. } = succeeds(&place, &["align", "survey.toml", "-o", "far", "--set", far]);
    println!("{out}{err}");
    assert!(
        out.contains("verdict: doubtful")
            && err.contains("the alignment is doubtful: the boresight roll moves by 7."),
        "{err}"
    );
}

/// What a flight over a plain does not determine is left alone, with cause and remedy.
#[test]
fn a_plain_leaves_the_lever_arm_alone() {
    let place = survey(&["plain_1", "plain_2"]);
    let Outcome { out, .. } = succeeds(&place, &["align", "survey.toml", "-o", "aligned"]);
    println!("{out}");
    for part in [
        "lever arm forward, m          0.30000   not estimable\n    the overlaps are flat; fly over roofs or slopes",
        "lever arm down, m             0.40000   not estimable\n    it moves all strips alike; compare heights with",
    ] {
        assert!(out.contains(part), "{out}");
    }
    let report = report(&place, "aligned");
    let found = parameter(&report, "lever_down_m");
    assert_eq!((&found["treatment"], &found["value"]), (&"not_estimable".into(), &0.4f64.into()), "{found}");
    assert_eq!(found["reasons"][0]["cause"], "it moves all strips alike");
    let calibration = place.text("aligned/calibration.toml");
    assert!(
        calibration.contains("lever_arm_m = [0.3, ") && calibration.contains(", 0.4]\n"),
        "{calibration}"
    );
}

#[test]
fn what_cannot_be_aligned_is_refused_with_a_remedy() {
    let place = survey(&["a", "far"]);
    let of = |from: &str, to: &str, more: &[&str]| {
        assert!(JOB.contains(from), "{from}");
        place.write("other.toml", JOB.replacen(from, to, 1).as_bytes());
        let Outcome { code, err, .. } =
            place.wavex(&[&["align", "other.toml", "-o", "aligned", "--quiet"], more].concat());
        assert!(!place.path("aligned").exists(), "{err}");
        (code, err)
    };
    let georeference = "[[stage]]\ntype = 'georeference'\n[[stage]]\ntype = 'write_table'\npath = '*.csv'\n";
    for (from, to, more, expected) in [
        (
            "trajectory = 'in/*.out'\n",
            "",
            &[][..],
            "other.toml: the job has no trajectory; set `trajectory` in `[job.geometry]`",
        ),
        (
            georeference,
            "[[stage]]\ntype = 'write_table'\npath = '*.csv'\n",
            &[],
            "other.toml: the job has no stage `georeference`; add one after `decompose`",
        ),
        (
            "in/*.arrow",
            "in/a.arrow",
            &[],
            "other.toml: the job has one input, `a`, and alignment compares strips; give the reader a pattern such as \
             `path = \"*.las\"`",
        ),
        (
            "calibration =",
            "corrections = 'c.toml'\ncalibration =",
            &["--trajectory", "none"],
            "other.toml: `--trajectory none` keeps the trajectory as recorded, but the job corrects it; remove `corrections` \
             from `[job.geometry]`, or choose another `--trajectory`",
        ),
    ] {
        assert_eq!(of(from, to, more), (Some(2), format!("error: {expected}\n")));
    }
    let (code, err) = of("in/*.arrow", "in/*.arrow", &[]);
    assert_eq!(code, Some(1), "{err}");
    assert!(err.contains("no pairs of patches: the strips do not overlap, share no smooth surface"), "{err}");
    let (code, err) = of("in/*.arrow", "in/*.arrow", &["--trajectory", "wild"]);
    assert_eq!(code, Some(2));
    assert!(err.contains("give none, constant, linear, or the distance of knots in seconds"), "{err}");
    // One strip remains.
    fs::copy(place.path("in/far.out"), place.path("in/a.out")).unwrap();
    let (code, err) = of("in/*.arrow", "in/*.arrow", &[]);
    assert_eq!(code, Some(1));
    assert!(
        err.contains("alignment needs two strips, but only `far` can be used") && err.contains("in/a.arrow"),
        "{err}"
    );
}
