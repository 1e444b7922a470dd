//! `wavex align`: a simulated survey with a known calibration, and surveys that cannot be aligned.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::fs;
use std::path::Path;
use std::sync::LazyLock;

use arrow_array::cast::AsArray;
use arrow_array::types::Float64Type;
use serde_json::Value;
use wavex_formats::container::TableReader;
use wavex_formats::trajectory::sbet::{RECORD_BYTES, SbetRecord};
use wavex_testkit::flight::files;
use wavex_testkit::{Outcome, TestFolder};

mod installations;
mod patches;

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
        let made = place.run(&simulation(
            stem,
            number,
            (direction_deg, offset_m, lines),
            BORESIGHT_DEG,
            &format!("{land}\n"),
            calibrate,
        ));
        assert_eq!(made, Outcome::success());
    }
    files(&place.path("in"))
});

/// Job that simulates a strip with this direction, offset and number of lines.
fn simulation(
    stem: &str,
    number: usize,
    (direction_deg, offset_m, lines): (f64, [f64; 2], usize),
    boresight_deg: [f64; 3],
    land: &str,
    calibrate: &str,
) -> String {
    format!(
        "[[stage]]\ntype = 'simulate'\nstem = '{stem}'\nscene_seed = 1\nseed = {number}\nlines = {lines}\n\
             shots_per_line = 120\nlandscape = 'country'\nwood_ratio = 0.1\nwater_ratio = 0.0\nwire_height_m = 0.0\n\
             {land}flying_height_m = 120\nspeed_mps = 25\npulse_rate_hz = 7000\nroll_deg = 2.0\npitch_deg = 2.0\n\
             motion_period_s = 3.0\ntrack_direction_deg = {direction_deg:?}\ntrack_offset_m = {offset_m:?}\n\
             start_time_s = {}\nlever_arm_m = {LEVER_ARM_M:?}\nboresight_deg = {boresight_deg:?}\nnoise_sd_dn = 0.5\n\
             noise_autocorrelation = []\nresponse = 'gaussian'\ntruth = '../in/*_truth.csv'\nsbet = '../in/*.out'\n\
             [[stage]]\ntype = 'write_arrow'\npath = '../in/*.arrow'\n{calibrate}",
        208_800 + 100 * number
    )
}

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

/// The page of an alignment, which has its verdict before all else, and needs no network or scripts.
fn page_of(place: &TestFolder, folder: &str, class: &str, verdict: &str) -> String {
    let page = place.text(&format!("{folder}/align.html"));
    let found = format!("<p class=\"outcome\"><span class=\"badge {class}\">{verdict}</span> ");
    let (before, _) = page.split_once(&found).unwrap_or_else(|| panic!("{verdict}: {page}"));
    assert!(!before.contains("<h2 class=\"group\">") && !before.contains("<svg"), "{verdict}");
    assert!(!page.contains("<script") && !page.contains("://"), "{verdict}");
    assert!(!page.contains("NaN") && !page.contains(">inf"), "what is unknown is said in words: {page}");
    page
}

/// Differences after, m, in rows of `residuals.arrow`, with strips, stated SD and use.
fn residuals(place: &TestFolder, folder: &str) -> Vec<([String; 2], f64, f64, bool)> {
    let mut table = TableReader::open(&place.path(&format!("{folder}/residuals.arrow"))).unwrap();
    let mut rows = Vec::new();
    while let Some(batch) = table.next_batch().unwrap() {
        let column = |name: &str| batch.column_by_name(name).unwrap();
        let number = |name: &str, row: usize| column(name).as_primitive::<Float64Type>().value(row);
        for row in 0..batch.num_rows() {
            let strips = ["first_strip", "second_strip"]
                .map(|name| column(name).as_string::<i32>().value(row).to_owned());
            let used = column("used").as_boolean().value(row);
            rows.push((strips, number("difference_after_m", row), number("sd_m", row), used));
            let up = number("normal_up", row);
            assert!(up > 0.3 && up < 1.0 + 1e-12, "{up}");
        }
    }
    rows
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

/// A file of control points: true points of a strip; the named ones are 1 m too high.
fn control(wrong: &[&str]) -> String {
    let truth = String::from_utf8(FLOWN["a_truth.csv"].clone()).unwrap();
    let mut text = "name,east_m,north_m,ellipsoidal_height_m,sd_east_m,sd_north_m,sd_height_m\n".to_owned();
    for (number, [x, y, z]) in points(&truth).into_values().step_by(601).enumerate() {
        let name = format!("P{number}");
        let z = if wrong.contains(&name.as_str()) { z + 1.0 } else { z };
        writeln!(text, "{name},{x},{y},{z},0.005,0.005,0.005").unwrap();
    }
    text
}

/// Control points are used, and wrong ones named; the reference strip stays.
#[test]
fn control_points_and_reference_strips_hold() {
    let place = survey(&["a", "b", "c"]);
    place.write("gcp.csv", control(&[]).as_bytes());
    let with = |folder: &str, more: &[&str]| {
        let start = ["align", "survey.toml", "-o", folder, "--control-crs", "utm:33N", "--control"];
        succeeds(&place, &[&start[..], more].concat())
    };
    let Outcome { out, .. } = with("right", &["gcp.csv", "--reference", "b"]);
    println!("{out}");
    assert!(
        out.contains("\ncontrol points (utm:33N") || out.contains("\ncontrol points (EPSG:32633"),
        "{out}"
    );
    let right = report(&place, "right");
    let points = right["control"]["points"].as_array().unwrap();
    let used: Vec<&str> = points
        .iter()
        .filter(|point| point["used"] == "used")
        .map(|point| point["name"].as_str().unwrap())
        .collect();
    assert!(used.len() >= 5 && used.len() < points.len(), "{used:?} of {}", points.len());
    assert_eq!(right["reference_strips"][0], "b");
    let of_b = &right["strips"][1];
    assert_eq!((&of_b["name"], &of_b["knots"][0]["north_east_down_m"]), (&"b".into(), &[0.0; 3][..].into()));
    let wrong = used[used.len() / 2];
    place.write("gcp.csv", control(&[wrong]).as_bytes());
    let Outcome { err, .. } = with("wrong", &["gcp.csv", "--reference", "b"]);
    println!("{err}");
    assert!(
        err.contains(&format!("gcp.csv: `{wrong}` is rejected: the strips differ from it by -")),
        "{err}"
    );
    assert!(err.contains("is not used: no strip has a smooth surface within 2.2 m of it"), "{err}");
    let found = report(&place, "wrong");
    for name in ["lever_down_m", "boresight_roll_rad", "e0_m"] {
        let [was, is] = [&right, &found].map(|report| parameter(report, name)["value"].as_f64().unwrap());
        let sd = parameter(&found, name)["sd"].as_f64().unwrap();
        assert!((was - is).abs() < 0.5 * sd, "{name}: {was} {is} {sd}");
    }
    let refused = |arguments: &[&str]| {
        let Outcome { code, err, .. } =
            place.wavex(&[&["align", "survey.toml", "-o", "refused", "--quiet"], arguments].concat());
        assert!(code == Some(2) && !place.path("refused").exists(), "{err}");
        err
    };
    let err = refused(&["--reference", "d"]);
    assert!(err.ends_with("there is no strip `d` for `--reference`; the strips are a, b, c\n"), "{err}");
    let err = refused(&["--control", "gcp.csv"]);
    assert!(
        err.contains("gcp.csv: its coordinate reference system is not known: give `--control-crs`"),
        "{err}"
    );
    let err = refused(&["--estimate", "e6"]);
    assert!(err.contains("give e1, e2, e3 or e4"), "{err}");
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
        // Commands for clouds of points: align_clouds.rs; for several jobs: installations.rs.
        .filter(|command| !command.contains(".laz") && !command.contains("day2"))
        .map(|command| command.replace('"', ""))
        .collect();
    assert_eq!(commands.len(), 8, "{commands:?}");
    place.write("gcp.csv", control(&[]).as_bytes());
    let keeping = "mode = 'fastest'\n[[stage]]\ntype = 'write_returns'\n";
    let job = JOB.replace("mode = 'fastest'\n", keeping) + "[[stage]]\ntype = 'write_patches'\n";
    place.write("survey.toml", job.as_bytes());
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
    assert!(outputs[0] != outputs[6], "the run with the new files has changed the points");
    assert!(outputs[6] == outputs[7], "--apply gives the bytes of that run");
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
    the_report_agrees_with_its_files(&place);
    let text = page_of(&place, "aligned", "good", "good");
    for part in [
        "the remaining differences of the strips are noise",
        "boresight roll, deg",
        "Correlations above 0.9",
        "Differences before and after",
        "Normalised residuals",
        "Residuals after alignment",
        "aria-label=\"Heading\"",
        "in/a.out",
    ] {
        assert!(text.contains(part), "{part}");
    }
    let fixed = page_of(&place, "fixed", "good", "good");
    assert!(fixed.contains("No trajectory is corrected.") && !fixed.contains("aria-label=\"Heading\""));
    assert!(page_of(&place, "splines", "good", "good").contains("knots at most 20 s apart"));
    assert!(place.path("splines/corrections.toml").exists());
    assert!(!place.path("fixed/corrections.toml").exists(), "that of an earlier alignment is removed");
    // The same bytes for any number of threads.
    succeeds(&place, &["align", "survey.toml", "-o", "one", "--threads", "1", "--quiet"]);
    let names = ["calibration.toml", "corrections.toml", "align.json", "align.html", "residuals.arrow"];
    for name in names {
        let read = |folder: &str| fs::read(place.path(&format!("{folder}/{name}"))).unwrap();
        assert!(read("aligned") == read("one"), "{name}");
    }
    assert_eq!(files(&place.path("one")).len(), names.len());
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

/// Residuals, covariance and digests of `aligned` agree with the numbers of the report.
fn the_report_agrees_with_its_files(place: &TestFolder) {
    let report = report(place, "aligned");
    let rows = residuals(place, "aligned");
    let used = rows.iter().filter(|(.., used)| *used).count();
    assert_eq!(report["pairs"], rows.len());
    assert_eq!(report["rejected_pairs"], rows.len() - used);
    for overlap in report["overlaps"].as_array().unwrap() {
        let strips = [0, 1].map(|k| overlap["strips"][k].as_str().unwrap().to_owned());
        let own = rows.iter().filter(|(found, .., used)| *found == strips && *used);
        let mut sizes_m: Vec<f64> = own.map(|(_, after_m, ..)| after_m.abs()).collect();
        sizes_m.sort_by(f64::total_cmp);
        let spread_m = 1.4826 * sizes_m[sizes_m.len() / 2];
        assert!((overlap["spread_after_m"].as_f64().unwrap() - spread_m).abs() < 1e-12, "{overlap}");
    }
    let covariance = &report["covariance"];
    for (k, name) in covariance["parameters"].as_array().unwrap().iter().enumerate() {
        let sd = parameter(&report, name.as_str().unwrap())["sd"].as_f64().unwrap();
        let variance = covariance["matrix"][k][k].as_f64().unwrap();
        assert!((variance / (sd * sd) - 1.0).abs() < 1e-9, "{name}: {variance} {sd}");
    }
    let is_digest = |found: &Value| {
        let path = found["recording"].as_str().or(found["path"].as_str()).unwrap();
        let bytes = fs::read(place.path(path)).unwrap();
        found["blake3"] == blake3::hash(&bytes).to_hex().as_str() && found["bytes"] == bytes.len()
    };
    let files = [&report["strips"], &report["trajectories"]].map(|files| files.as_array().unwrap());
    assert_eq!(files.map(Vec::len), [3, 3]);
    assert!(files.into_iter().flatten().all(is_digest), "{report}");
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
    let text = page_of(&place, "aligned", "good", "good");
    for part in [
        "<h3>Strips that could not be used</h3>",
        "in/c.arrow: the recording and the trajectory have no time in common",
        "not aligned: shares no smooth surface with others",
        "<b>2 of 4</b><span>strips aligned</span>",
        "strips left out or not aligned: 2",
    ] {
        assert!(text.contains(part), "{part}: {text}");
    }
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
    let bad = report(&place, "aligned");
    assert_eq!(bad["verdict"], "bad");
    let text = page_of(&place, "aligned", "bad", "bad");
    let reason = bad["problems"][0].as_str().unwrap();
    assert!(err.contains(reason) && text.contains(&format!("<li>{reason}</li>")), "{reason}");
    for part in [
        "do not use this result. Calibration and corrections of trajectories are not written.",
        "What to do: </b>check mount, units of the start values, trajectories and coordinates",
        "<h2 class=\"group\">Parameters <span class=\"badge bad\">bad</span></h2>",
        "<h2 class=\"group\">Strip differences <span class=\"badge bad\">bad</span></h2>",
    ] {
        assert!(text.contains(part), "{part}");
    }
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
    let text = page_of(&place, "far", "look", "doubtful");
    assert!(text.contains("<li>the boresight roll moves by 7."), "{text}");
    assert!(text.contains("<h2 class=\"group\">Parameters <span class=\"badge look\">look</span></h2>"));
}

/// What a flight over a plain does not determine is left alone, with cause and remedy.
#[test]
fn a_plain_leaves_the_lever_arm_alone() {
    let place = survey(&["plain_1", "plain_2"]);
    let Outcome { out, .. } = succeeds(&place, &["align", "survey.toml", "-o", "aligned"]);
    println!("{out}");
    for part in [
        "lever arm forward, m          0.30000   not estimable\n    the overlaps are flat; fly over roofs or slopes",
        "lever arm down, m             0.40000   not estimable\n    it moves all strips alike; give control points",
    ] {
        assert!(out.contains(part), "{out}");
    }
    let report = report(&place, "aligned");
    let found = parameter(&report, "lever_down_m");
    assert_eq!((&found["treatment"], &found["value"]), (&"not_estimable".into(), &0.4f64.into()), "{found}");
    assert_eq!(found["reasons"][0]["cause"], "it moves all strips alike");
    let text = page_of(&place, "aligned", "good", "good");
    for part in [
        "not estimable: kept",
        "it moves all strips alike: give control points",
        "the overlaps are flat: fly over roofs or slopes of several aspects",
    ] {
        assert!(text.contains(part), "{part}");
    }
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
