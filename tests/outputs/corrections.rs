//! Corrections of trajectories: points, corrected trajectories, messages, archives and surveys.

use std::fmt::Write;
use std::fs;

use serde_json::Value;
use wavex_formats::trajectory::sbet::{RECORD_BYTES, SbetRecord};
use wavex_testkit::flight::wavex;
use wavex_testkit::{Outcome, TestFolder};

/// Start of the strips `a` and `b`, s of the week.
const STARTS_S: [(&str, f64); 2] = [("a", 208_800.0), ("b", 209_400.0)];
/// From seconds of the week of the simulator to adjusted seconds.
const ADJUSTED_S: f64 = 2365.0 * 604_800.0 - 1e9;
/// Errors of the trajectory at the start of each strip, after 1 s, and from 3 s to its end at 4.4 s: north, east,
/// down, m; roll, pitch, heading, degrees.
const DRIFTS: [[[f64; 6]; 3]; 2] = [
    [
        [0.20, -0.10, 0.05, 0.005, -0.010, 0.025],
        [0.25, -0.05, 0.02, 0.006, -0.008, 0.015],
        [0.15, 0.10, -0.08, -0.002, 0.005, 0.010],
    ],
    [
        [-0.30, 0.10, 0.15, -0.005, 0.010, -0.020],
        [-0.28, 0.12, 0.10, -0.010, 0.005, -0.020],
        [-0.10, 0.20, 0.00, 0.000, 0.000, 0.005],
    ],
];

const STAGES: &str = "[[stage]]\ntype = 'read_arrow'\npath = 'in/*.arrow'\n\
                      [[stage]]\ntype = 'calibrate'\nload = 'in/model.json'\n\
                      [[stage]]\ntype = 'decompose'\nmode = 'fastest'\n\
                      [[stage]]\ntype = 'georeference'\n\
                      [[stage]]\ntype = 'write_table'\npath = '*.csv'\n";
const CALIBRATION: &str =
    "calibration = { lever_arm_m = [0.8, -0.35, 1.1], boresight_deg = [0.4, -0.7, 1.3] }\n";

/// Two strips of 4.4 s in `in`: recordings, truth, and one trajectory with and without drift.
fn survey() -> TestFolder {
    let place = TestFolder::new();
    for (stem, start_s) in STARTS_S {
        let calibrate = match stem {
            "a" => {
                "[[stage]]\ntype = 'calibrate'\nwaveforms = 2000\nresponse = 'gaussian'\nsave = '../in/model.json'\n"
            }
            _ => "",
        };
        let made = place.run(&format!(
            "[[stage]]\ntype = 'simulate'\nstem = '{stem}'\nlines = 30\nshots_per_line = 100\npulse_rate_hz = 1000\n\
             start_time_s = {start_s}\nroll_deg = 4.0\npitch_deg = 3.0\nmotion_period_s = 2.0\nheading_deg = 70.0\n\
             noise_sd_dn = 0.0\nnoise_autocorrelation = []\nresponse = 'gaussian'\n\
             lever_arm_m = [0.8, -0.35, 1.1]\nboresight_deg = [0.4, -0.7, 1.3]\n\
             truth = '../in/*_truth.csv'\nsbet = '../in/*.out'\n\
             [[stage]]\ntype = 'write_arrow'\npath = '../in/*.arrow'\n{calibrate}"
        ));
        assert_eq!(made, Outcome::success());
    }
    let (mut right, mut drifted) = (Vec::new(), Vec::new());
    for ((stem, start_s), drift) in STARTS_S.into_iter().zip(&DRIFTS) {
        let bytes = fs::read(place.path(&format!("in/{stem}.out"))).unwrap();
        right.extend(&bytes);
        let (records, _) = bytes.as_chunks::<RECORD_BYTES>();
        for record in records.iter().map(SbetRecord::decode) {
            drifted.extend(with_errors(record, errors_at(drift, record.time_s - start_s)).encode());
        }
    }
    place.write("in/right.out", &right);
    place.write("in/drifted.out", &drifted);
    fs::remove_dir_all(place.path("out")).unwrap();
    place
}

/// Errors at a time of the strip: linear between those at 0, 1 and 3 s.
fn errors_at(drift: &[[f64; 6]; 3], since_s: f64) -> [f64; 6] {
    let (from, to, part) = match since_s {
        early if early < 0.0 => (0, 0, 0.0),
        early if early < 1.0 => (0, 1, early),
        late if late < 3.0 => (1, 2, (late - 1.0) / 2.0),
        _ => (2, 2, 0.0),
    };
    std::array::from_fn(|k| (1.0 - part) * drift[from][k] + part * drift[to][k])
}

/// A record with errors, by the radii of curvature of WGS 84.
fn with_errors(record: SbetRecord, [north, east, down, roll, pitch, heading]: [f64; 6]) -> SbetRecord {
    let (a_m, e2) = (6_378_137.0, 0.006_694_379_990_14);
    let (sine, cosine) = record.latitude_rad.sin_cos();
    let root = (1.0 - e2 * sine * sine).sqrt();
    let (meridian_m, normal_m) = (a_m * (1.0 - e2) / root.powi(3), a_m / root);
    SbetRecord {
        latitude_rad: record.latitude_rad + north / (meridian_m + record.height_m),
        longitude_rad: record.longitude_rad + east / ((normal_m + record.height_m) * cosine),
        height_m: record.height_m - down,
        roll_rad: record.roll_rad + roll.to_radians(),
        pitch_rad: record.pitch_rad + pitch.to_radians(),
        platform_heading_rad: record.platform_heading_rad + heading.to_radians(),
        ..record
    }
}

/// The opposite of the drift as a correction file; `shift_s` is added to all times.
fn opposite(time: &str, shift_s: f64) -> String {
    let mut text = format!("version = 1\ntime = '{time}'\n");
    for ((stem, start_s), drift) in STARTS_S.into_iter().zip(&DRIFTS) {
        let at = |since_s: f64| start_s + shift_s + since_s;
        write!(
            text,
            "[[strip]]\nrecording = '{stem}'\nfirst_s = {:?}\nlast_s = {:?}\nknots = [\n",
            at(0.0),
            at(4.4)
        )
        .unwrap();
        for (since_s, errors) in [0.0, 1.0, 3.0].into_iter().zip(drift) {
            let [north, east, down, roll, pitch, heading] = errors.map(|error| 0.0 - error);
            writeln!(
                text,
                "{{ time_s = {:?}, north_east_down_m = [{north:?}, {east:?}, {down:?}], \
                 roll_pitch_heading_deg = [{roll:?}, {pitch:?}, {heading:?}] }},",
                at(since_s)
            )
            .unwrap();
        }
        text += "]\n";
    }
    text
}

/// Text of a job with these keys of its geometry.
fn job(geometry: &str) -> String {
    format!("[job.geometry]\n{CALIBRATION}{geometry}\n{STAGES}")
}

/// A return: number of the shot, range, and point.
type Found = (u64, f64, [f64; 3]);

/// Rows of a table with these columns.
fn rows(text: &str, columns: [&str; 5]) -> Vec<Found> {
    let mut lines = text.lines();
    let names: Vec<&str> = lines.next().unwrap().split(',').collect();
    let places = columns.map(|name| names.iter().position(|other| *other == name).unwrap());
    let row = |line: &str| {
        let cells: Vec<&str> = line.split(',').collect();
        let [shot, range, x, y, z] = places.map(|place| cells[place].parse::<f64>().unwrap());
        (shot as u64, range, [x, y, z])
    };
    lines.map(row).collect()
}

/// Returns of both strips of a run with these keys.
#[track_caller]
fn points(place: &TestFolder, geometry: &str) -> [Vec<Found>; 2] {
    assert_eq!(place.run(&job(geometry)), Outcome::success());
    ["a", "b"].map(|stem| rows(&place.text(&format!("out/{stem}.csv")), ["shot", "range_m", "x", "y", "z"]))
}

fn distance_m(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt()
}

/// Largest distance between the points of two runs, m.
fn apart_m(a: &[Vec<Found>; 2], b: &[Vec<Found>; 2]) -> f64 {
    let pairs = a.iter().zip(b).flat_map(|(a, b)| {
        assert!(a.len() > 2500 && a.len() == b.len());
        a.iter().zip(b)
    });
    pairs.fold(0.0, |most, ((.., a), (.., b))| distance_m(*a, *b).max(most))
}

/// Warnings of the reader in the report of the last run.
fn warnings(place: &TestFolder) -> Vec<String> {
    let report: Value = serde_json::from_str(&place.text("out/job_report.json")).unwrap();
    let inputs = report["inputs"].as_array().unwrap().iter();
    let notes = inputs.flat_map(|input| input["stages"][0]["notes"].as_array().unwrap());
    let notes = notes.map(|note| note.as_str().unwrap().to_owned());
    // The trajectory has a gap between the strips.
    notes.filter(|note| !note.contains("steps of the trajectory")).collect()
}

#[test]
fn the_opposite_of_a_drift_puts_points_right() {
    let place = survey();
    let right = points(&place, "trajectory = 'in/right.out'");
    let drifted = points(&place, "trajectory = 'in/drifted.out'");
    assert!(apart_m(&right, &drifted) > 0.3, "{}", apart_m(&right, &drifted));
    for (time, shift_s) in [("week", 0.0), ("adjusted", ADJUSTED_S), ("day", -2.0 * 86_400.0)] {
        place.write("in/corrections.toml", opposite(time, shift_s).as_bytes());
        let corrected = points(&place, "trajectory = 'in/drifted.out'\ncorrections = 'in/corrections.toml'");
        let apart_m = apart_m(&right, &corrected);
        println!("{time}: {:.4} mm from the points of the right trajectory", 1e3 * apart_m);
        assert!(apart_m < 1e-4, "{time}: {apart_m}");
        assert_eq!(warnings(&place), Vec::<String>::new());
        // Ranges have errors of their own.
        let mut errors_m = Vec::new();
        for (stem, found) in ["a", "b"].into_iter().zip(&corrected) {
            let names = ["shot", "range_m", "x", "y", "z"];
            let truth = rows(&place.text(&format!("in/{stem}_truth.csv")), names);
            for (shot, range_m, point_m) in found {
                let off = |truth: &&Found| (truth.1 - range_m).abs();
                let of_shot = truth.iter().filter(|truth| truth.0 == *shot);
                let truth = of_shot.min_by(|a, b| off(a).total_cmp(&off(b))).unwrap();
                errors_m.push((distance_m(*point_m, truth.2) - off(&truth)).abs());
            }
        }
        let worst_m = errors_m.into_iter().fold(0.0, f64::max);
        assert!(worst_m < 1e-3, "{worst_m}");
    }
    let report: Value = serde_json::from_str(&place.text("out/job_report.json")).unwrap();
    let file = report["inputs"][0]["trajectory"]["corrections"].as_str().unwrap();
    assert!(file.ends_with("in/corrections.toml"), "{file}");
}

/// A run with corrections has the points of a run with the corrected trajectory.
#[test]
fn a_corrected_trajectory_is_as_good_as_its_corrections() {
    let place = survey();
    place.write("in/corrections.toml", opposite("week", 0.0).as_bytes());
    let corrected = points(&place, "trajectory = 'in/drifted.out'\ncorrections = 'in/corrections.toml'");
    let command =
        ["trajectory", "in/drifted.out", "--corrections", "in/corrections.toml", "-o", "in/corrected.txt"];
    let Outcome { code, out, err } = place.wavex(&command);
    assert_eq!((code, err.as_str()), (Some(0), ""));
    assert!(out.contains("\n  corrected  by in/corrections.toml\n"), "{out}");
    let header = place.text("in/corrected.txt");
    assert!(header.lines().next().unwrap().ends_with("; corrected by in/corrections.toml"), "{header}");
    let keys = "trajectory_columns = 'txyz___wpk'\n";
    let by_trajectory = points(&place, &format!("trajectory = 'in/corrected.txt'\n{keys}"));
    let apart_m = apart_m(&corrected, &by_trajectory);
    println!("{:.4} mm between both ways", 1e3 * apart_m);
    assert!(apart_m < 1e-4, "{apart_m}");
    assert_eq!(warnings(&place), Vec::<String>::new());
    points(&place, &format!("trajectory = 'in/corrected.txt'\n{keys}corrections = 'in/corrections.toml'"));
    let twice = "in/corrected.txt: the trajectory was written with the corrections of in/corrections.toml, and is corrected again";
    assert!(warnings(&place).len() == 2 && warnings(&place).iter().all(|warning| warning.contains(twice)));

    // The corrections of one strip, beyond its end too.
    for strip in ["a", "b"] {
        let name = format!("in/{strip}.txt");
        let of_strip = [&command[..5], &[&name, "--strip", strip, "--quiet"]].concat();
        assert_eq!(place.wavex(&of_strip), Outcome::success());
    }
    let by_strip = points(&place, &format!("trajectory = 'in/*.txt'\n{keys}"));
    assert!(self::apart_m(&corrected, &by_strip) < 1e-4);
}

#[test]
fn strips_that_a_trajectory_cannot_have_are_refused() {
    let place = survey();
    let text = opposite("week", 0.0);
    place.write("in/corrections.toml", text.as_bytes());
    place.write("in/overlap.toml", text.replace("first_s = 209400.0", "first_s = 208802.0").as_bytes());
    place.write("in/day.toml", opposite("week", 86_400.0).as_bytes());
    let fails = |file: &str, more: &[&str], expected: &str| {
        let file = format!("in/{file}.toml");
        let outcome =
            place.wavex(&[&["trajectory", "in/drifted.out", "--corrections", &file], more].concat());
        assert_eq!(outcome, Outcome::failure(1, format!("error: {file}: {expected}\n")));
    };
    fails("corrections", &["--strip", "c"], "it has no strip `c`; give one of its strips: `a`, `b`");
    fails(
        "overlap",
        &[],
        "its strips `a` and `b` have times in common, and a trajectory has one position at a time; choose one with \
         `--strip`, and write a trajectory for each",
    );
    fails(
        "day",
        &[],
        "none of its strips is at a time of the trajectory, which lasts from Tuesday 09:59:59.0 to 10:10:05.5 GPS \
         (208799.0 to 209405.5 s of the week); give the corrections of this flight",
    );
    let Outcome { code, err, .. } = place.wavex(&["trajectory", "in/drifted.out", "--strip", "a"]);
    assert!(code == Some(2) && err.contains("--corrections <FILE>"), "{err}");
}

/// A folder with a recording `in/a.arrow` of 2.9 s, its trajectory, and a correction file.
fn one_strip(corrections: &str) -> TestFolder {
    let place = TestFolder::new();
    let made = place.run(
        "[[stage]]\ntype = 'simulate'\nstem = 'a'\nlines = 20\nshots_per_line = 100\npulse_rate_hz = 1000\nsbet = '../in/*.out'\n\
         [[stage]]\ntype = 'write_arrow'\npath = '../in/*.arrow'\n",
    );
    assert_eq!(made, Outcome::success());
    fs::remove_dir_all(place.path("out")).unwrap();
    place.write("in/c.toml", corrections.as_bytes());
    place
}

const COPY: &str = "[job.geometry]\ntrajectory = 'in/*.out'\ncorrections = 'in/c.toml'\n\
                    [[stage]]\ntype = 'read_arrow'\npath = 'in/a.arrow'\n\
                    [[stage]]\ntype = 'write_arrow'\npath = '*_copy.arrow'\n";

/// A file with one strip and one knot.
fn constant(time: &str, recording: &str, [first_s, last_s]: [f64; 2]) -> String {
    format!(
        "version = 1\ntime = '{time}'\n[[strip]]\nrecording = '{recording}'\nfirst_s = {first_s:?}\nlast_s = {last_s:?}\n\
         knots = [{{ time_s = {first_s:?}, north_east_down_m = [0.1, 0, 0] }}]\n"
    )
}

#[test]
fn unusable_correction_files_are_refused_with_a_remedy() {
    let place = one_strip("");
    let good = constant("week", "a", [208_800.0, 208_803.0]);
    let remedy = "a correction file is TOML with `version = 1`, `time` and a table `[[strip]]` with `recording`, `first_s`, \
                  `last_s` and `knots` for each strip";
    let knot = "{ time_s = 208800.0, north_east_down_m = [0.1, 0, 0] }";
    for (from, to, expected) in [
        ("version = 1", "version = 2", "it has version 2 of the format, and this program reads version 1"),
        (knot, "", "strip 1 (`a`): it has no knots"),
        ("0.1, 0, 0", "0.1, 0, 101", "strip 1 (`a`): knot 1: an offset is 101 m, at most 100 are plausible"),
        (
            "last_s = 208803.0",
            "last_s = 0",
            "strip 1 (`a`): `first_s` and `last_s` are 208800 and 0, not a time span",
        ),
    ] {
        assert!(good.contains(from), "{from}");
        place.write("in/c.toml", good.replace(from, to).as_bytes());
        let Outcome { code, err, .. } = place.run(COPY);
        assert_eq!(code, Some(1), "{err}");
        assert!(err.ends_with(&format!("in/c.toml: {expected}; {remedy}\n")), "{err}");
    }
    place.write("in/c.toml", good.replace("recording", "strip").as_bytes());
    let err = place.run(COPY).err;
    assert!(err.contains("line 4") && err.contains("unknown field `strip`") && err.contains(remedy), "{err}");
    // A sparse file: its size alone is refused.
    fs::File::create(place.path("in/c.toml")).unwrap().set_len(50_000_001).unwrap();
    let err = place.run(COPY).err;
    assert!(err.contains("in/c.toml: ") && err.contains("50000001 bytes"), "{err}");
    fs::remove_file(place.path("in/c.toml")).unwrap();
    let Outcome { code, err, .. } = place.run(COPY);
    assert!(code == Some(1) && err.contains("in/c.toml: cannot open"), "{err}");
    assert_eq!(place.products(), Vec::<String>::new());

    let err = place.run(&COPY.replace("trajectory = 'in/*.out'\n", "")).err;
    assert!(err.contains("`geometry.corrections`: it has no effect without `trajectory`"), "{err}");
}

#[test]
fn corrections_for_another_recording_or_time_are_named() {
    let place = one_strip("");
    let of = |corrections: String| {
        place.write("in/c.toml", corrections.as_bytes());
        let outcome = place.run(COPY);
        let warnings = if outcome.code == Some(0) { warnings(&place) } else { Vec::new() };
        let check = place.wavex(&["check", "job.toml"]).out;
        (outcome, warnings, check)
    };
    let whole = [208_800.0, 208_803.0];
    let (outcome, warnings, check) = of(constant("week", "a", whole));
    assert_eq!((outcome, warnings), (Outcome::success(), vec![]));
    assert!(check.starts_with("job.toml is valid\n"), "{check}");

    // Without an entry, or outside of its times: warnings.
    let (outcome, warnings, check) = of(constant("week", "b", whole));
    assert_eq!((outcome.code, warnings.len()), (Some(0), 1), "{warnings:?}");
    let expected =
        ["the recording `a` has no entry in ", "in/c.toml, which has `b`: its trajectory is not corrected"];
    assert!(
        expected.iter().all(|part| warnings[0].contains(part) && check.contains(part)),
        "{warnings:?} {check}"
    );
    let (outcome, warnings, check) = of(constant("week", "a", [208_800.0, 208_801.5]));
    assert_eq!((outcome.code, warnings.len()), (Some(0), 1), "{warnings:?}");
    let expected = "in/c.toml, 0.0 s before it and 1.4 s after it: the recording lasts from 2025-05-06 10:00:00.0 to 10:00:02.9 GPS";
    assert!(
        warnings[0].contains(expected) && check.contains("0.0 s before it and 1.4 s after it"),
        "{warnings:?} {check}"
    );
    assert_eq!(
        of(constant("week", "a", [208_800.0, 208_802.0])).1,
        Vec::<String>::new(),
        "within the tolerance"
    );

    // Another time: an error, as soon as it is certain.
    for (corrections, begins) in [
        (constant("week", "a", whole.map(|time_s| time_s - 60.0)), "begins at"),
        (constant("week", "a", whole.map(|time_s| time_s + 60.0)), "lasts from"),
        (constant("adjusted", "a", whole.map(|time_s| time_s + ADJUSTED_S + 604_800.0)), "begins at"),
        (constant("adjusted", "a", whole), "begins at"),
    ] {
        let (Outcome { code, err, .. }, _, check) = of(corrections);
        let expected = format!(
            "in/c.toml: the corrections of `a` and the recording have no time in common: the recording {begins} 2025-05-06 10:00:00.0"
        );
        assert!(code == Some(1) && err.contains(&expected), "{err}");
        assert!(err.ends_with(
            "give the corrections of this flight, or correct `time`, the scale of the times in the file\n"
        ));
        assert!(check.contains("the corrections of `a` and the recording have no time in common"), "{check}");
    }
}

#[test]
fn corrections_are_archived_and_replayed() {
    let place = survey();
    place.write("in/corrections.toml", opposite("week", 0.0).as_bytes());
    let text = job("trajectory = 'in/drifted.out'\ncorrections = 'in/corrections.toml'");
    place.write("job.toml", format!("[job]\noutput_dir = 'out'\n{text}").as_bytes());
    let ok = |arguments: &[&str]| {
        assert_eq!(wavex(&place, arguments), (Some(0), String::new()), "{arguments:?}");
    };
    ok(&["run", "job.toml", "--archive", "archives/a"]);
    let archive: Value = serde_json::from_str(&place.text("archives/a/archive.json")).unwrap();
    let files = archive["inputs"]["files"].as_array().unwrap();
    assert!(files.iter().any(|file| file["path"] == "in/corrections.toml"), "{files:?}");
    ok(&["verify", "archives/a"]);
    ok(&["replay", "archives/a"]);
    // A tenth of a millimetre in one knot.
    let changed = opposite("week", 0.0).replacen("[-0.2,", "[-0.2001,", 1);
    assert_ne!(changed, opposite("week", 0.0));
    place.write("in/corrections.toml", changed.as_bytes());
    let (code, err) = wavex(&place, &["verify", "archives/a"]);
    assert!(code == Some(1) && err.contains("in/corrections.toml"), "{err}");
    // A resumed run repeats the inputs.
    let before = place.text("out/a.csv");
    ok(&["run", "job.toml", "--resume=digest"]);
    assert_ne!(place.text("out/a.csv"), before);
}

#[test]
fn tasks_of_a_survey_apply_corrections() {
    let place = survey();
    place.write("in/corrections.toml", opposite("week", 0.0).as_bytes());
    let geometry = "trajectory = 'in/drifted.out'\ncorrections = 'in/corrections.toml'";
    place.write("job.toml", format!("[job]\noutput_dir = 'out'\n{}", job(geometry)).as_bytes());
    let ok = |arguments: &[&str]| {
        assert_eq!(wavex(&place, arguments), (Some(0), String::new()), "{arguments:?}");
    };
    ok(&["run", "job.toml"]);
    let whole = ["a", "b"].map(|stem| place.text(&format!("out/{stem}.csv")));
    let expected: Value = serde_json::from_str(&place.text("out/job_report.json")).unwrap();
    fs::remove_dir_all(place.path("out")).unwrap();
    ok(&["plan", "job.toml", "-o", "plan", "--cores", "1"]);
    let plan: Value = serde_json::from_str(&place.text("plan/plan.json")).unwrap();
    let shared = plan["shared_inputs"].as_array().unwrap();
    assert!(shared.iter().any(|file| file["path"] == "in/corrections.toml"), "{shared:?}");
    for task in plan["tasks"].as_array().unwrap() {
        ok(&["run", task["job"].as_str().unwrap()]);
    }
    ok(&["collect", "plan"]);
    assert_eq!(["a", "b"].map(|stem| place.text(&format!("out/{stem}.csv"))), whole);
    let report: Value = serde_json::from_str(&place.text("out/job_report.json")).unwrap();
    for (input, expected) in [0, 1].map(|n| (&report["inputs"][n], &expected["inputs"][n])) {
        assert_eq!(input["trajectory"], expected["trajectory"]);
        assert!(input["trajectory"]["corrections"].is_string());
    }
}
