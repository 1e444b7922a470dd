//! `wavex align` of clouds of points with known offsets and drifts, and of clouds that cannot be aligned.

use std::path::Path;

use serde_json::Value;
use wavex_testkit::{Outcome, TestFolder, data};

mod systems;

/// Noise of heights of the clouds, m.
const NOISE_M: f64 = 0.008;
/// Step of coordinates, m.
const STEP_M: f64 = 0.001;
/// Seconds of a strip.
const LENGTH_S: f64 = 20.0;
/// Where the clouds are, m.
const ORIGIN_M: [f64; 3] = [412_000.0, 5_806_000.0, 60.0];

/// Numbers from 0 to 1 (SplitMix64).
struct Random(u64);

impl Random {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.next()).sum::<f64>() - 6.0
    }
}

/// A strip flown to the north over terrain.
#[derive(Clone, Copy)]
struct Strip {
    seed: u64,
    /// West and east edge, m.
    from_to_m: [f64; 2],
    /// Error of x, y, z: at the start, and at the end, m.
    errors_m: [[f64; 3]; 2],
    terrain: fn(f64, f64) -> f64,
    /// First time, s; `None`: no times.
    start_s: Option<f64>,
    point_source_id: u16,
    /// EPSG code of a projected system, or of a geographic one, 4000 to 4999.
    epsg: Option<u16>,
    /// Unit of coordinates, m.
    unit_m: f64,
}

const GOOD: Strip = Strip {
    seed: 1,
    from_to_m: [0.0, 80.0],
    errors_m: [[0.0; 3]; 2],
    terrain: hills,
    start_s: Some(1000.0),
    point_source_id: 1,
    epsg: Some(32633),
    unit_m: 1.0,
};

/// Length of the strips to the north, m.
const NORTH_M: f64 = 150.0;

fn hills(x_m: f64, y_m: f64) -> f64 {
    4.0 * (x_m / 23.0).sin() * (y_m / 17.0).cos() + 0.08 * x_m
}

fn plain(_: f64, _: f64) -> f64 {
    2.0
}

/// The points of strips, 4 per m², in the order of their times, as LAS 1.2, format 1.
fn las(strips: &[Strip]) -> Vec<u8> {
    let mut records = Vec::new();
    let mut n = 0u32;
    for strip in strips {
        let mut random = Random(strip.seed);
        let [from_m, to_m] = strip.from_to_m;
        let count = (4.0 * (to_m - from_m) * NORTH_M) as u32;
        n += count;
        for k in 0..count {
            let part = f64::from(k) / f64::from(count);
            let (x_m, y_m) = (from_m + random.next() * (to_m - from_m), NORTH_M * part);
            let z_m = (strip.terrain)(x_m, y_m) + NOISE_M * random.normal();
            let [first, last] = strip.errors_m;
            for (axis, true_m) in [x_m, y_m, z_m].into_iter().enumerate() {
                let moved_m = true_m + first[axis] + part * (last[axis] - first[axis]);
                records.extend(((moved_m / strip.unit_m / STEP_M).round() as i32).to_le_bytes());
            }
            // Intensity, flags (one return of one), class 2, angle, user data, source.
            records.extend([40, 0, 0b0000_1001, 2, 0, 0]);
            records.extend(strip.point_source_id.to_le_bytes());
            records.extend(strip.start_s.map_or(0.0, |start_s| start_s + part * LENGTH_S).to_le_bytes());
        }
    }
    let mut vlr = Vec::new();
    if let Some(code) = strips.first().and_then(|strip| strip.epsg) {
        vlr.extend([0; 2]);
        vlr.extend(b"LASF_Projection\0");
        vlr.extend(34735u16.to_le_bytes());
        vlr.extend(24u16.to_le_bytes());
        vlr.extend([0; 32]);
        let (model, key) = if (4000..5000).contains(&code) { (2, 2048) } else { (1, 3072) };
        for word in [1, 1, 0, 2, 1024, 0, 1, model, key, 0, 1, code] {
            vlr.extend(u16::to_le_bytes(word));
        }
    }
    let mut bytes = b"LASF".to_vec();
    bytes.extend([0; 20]);
    bytes.extend([1, 2]);
    bytes.extend([0; 68]);
    bytes.extend(227u16.to_le_bytes());
    bytes.extend((227 + vlr.len() as u32).to_le_bytes());
    bytes.extend(u32::from(!vlr.is_empty()).to_le_bytes());
    bytes.push(1);
    bytes.extend(28u16.to_le_bytes());
    bytes.extend(n.to_le_bytes());
    bytes.extend(n.to_le_bytes());
    bytes.extend([0; 16]);
    let bounds = [1000.0, -1000.0].map(|more| ORIGIN_M.map(|value| value + more));
    let bounds = (0..3).flat_map(|axis| [bounds[0][axis], bounds[1][axis]]);
    for value in [STEP_M; 3].into_iter().chain(ORIGIN_M).chain(bounds) {
        bytes.extend(value.to_le_bytes());
    }
    bytes.extend(vlr);
    bytes.extend(records);
    bytes
}

fn clouds(strips: &[(&str, Strip)]) -> TestFolder {
    let place = TestFolder::new();
    for (name, strip) in strips {
        place.write(name, &las(&[*strip]));
    }
    place
}

fn report(place: &TestFolder) -> Value {
    serde_json::from_str(&place.text("aligned/align.json")).unwrap()
}

fn succeeds(place: &TestFolder, arguments: &[&str]) -> Outcome {
    let outcome = place.wavex(arguments);
    println!("{}{}", outcome.out, outcome.err);
    assert_eq!(outcome.code, Some(0), "wavex {arguments:?}");
    outcome
}

/// Values and SDs at the first and last knot of a strip, x, y, z, m.
fn knots(report: &Value, strip: usize) -> Vec<[[f64; 2]; 3]> {
    let three = |value: &Value| [0, 1, 2].map(|axis| value[axis].as_f64().unwrap());
    let knots = report["strips"][strip]["knots"].as_array().unwrap();
    let knot = |knot: &Value| {
        let (values, sds) = (three(&knot["x_y_z_m"]), three(&knot["x_y_z_sd_m"]));
        [0, 1, 2].map(|axis| [values[axis], sds[axis]])
    };
    knots.iter().map(knot).collect()
}

/// Known offsets and drifts of three strips are found within their SDs, about the mean of the strips.
#[test]
fn offsets_and_drifts_of_clouds_are_recovered() {
    let errors = [
        [[0.11, -0.07, 0.05], [0.15, -0.05, 0.02]],
        [[-0.06, 0.04, -0.03], [-0.04, 0.09, 0.01]],
        [[0.02, 0.05, 0.04], [-0.05, 0.01, -0.02]],
    ];
    let strip = |k: usize| Strip { seed: 7 + k as u64, errors_m: errors[k], ..GOOD };
    let second = Strip { from_to_m: [20.0, 100.0], start_s: Some(5000.0), ..strip(1) };
    let third = Strip { from_to_m: [10.0, 90.0], start_s: Some(9000.0), ..strip(2) };
    let place = clouds(&[("a.las", strip(0)), ("b.las", second), ("c.las", third)]);
    let align = ["align", "a.las", "b.las", "c.las", "-o", "aligned", "--trajectory", "linear", "--apply"];
    let outcome = succeeds(&place, &align);
    assert!(outcome.out.contains("3 strips, ") && outcome.out.contains("verdict: good"), "{}", outcome.out);
    let report = report(&place);
    for end in 0..2 {
        for axis in 0..3 {
            let mean_m = errors.iter().map(|errors| errors[end][axis]).sum::<f64>() / 3.0;
            for (strip, errors) in errors.iter().enumerate() {
                let [value_m, sd_m] = knots(&report, strip)[end][axis];
                let error_m = value_m + errors[end][axis] - mean_m;
                println!(
                    "strip {strip}, end {end}, axis {axis}: {:.2} mm, SD {:.2}",
                    1e3 * error_m,
                    1e3 * sd_m
                );
                // A common drift of all strips is not determined: SDs have its part, errors about the mean do not.
                assert!(sd_m > 0.0 && sd_m < 0.02 && error_m.abs() < 3.0 * sd_m, "{error_m} {sd_m}");
                assert!(error_m.abs() < if axis == 2 { 0.002 } else { 0.01 }, "{error_m}");
            }
        }
    }
    for overlap in report["overlaps"].as_array().unwrap() {
        assert!(overlap["median_after_m"].as_f64().unwrap().abs() < 0.001, "{overlap}");
    }
    // The corrected clouds are aligned: no corrections are left.
    for name in ["a.las", "b.las", "c.las"] {
        let (before, after) = (place.path(name), place.path(&format!("aligned/{name}")));
        assert_eq!(before.metadata().unwrap().len(), after.metadata().unwrap().len());
    }
    succeeds(&place, &["align", "aligned", "-o", "again", "--trajectory", "linear", "--quiet"]);
    let again: Value = serde_json::from_str(&place.text("again/align.json")).unwrap();
    for strip in 0..3 {
        for [value_m, sd_m] in knots(&again, strip).into_iter().flatten() {
            assert!(value_m.abs() < 3.0 * sd_m, "{value_m} {sd_m}");
        }
    }
    // The same bytes for any number of threads.
    let threads = ["-o", "one", "--threads", "1", "--quiet"];
    succeeds(&place, &[&align[..4], &threads[..], &align[6..]].concat());
    for name in ["align.json", "corrections.csv", "a.las", "c.las"] {
        let bytes = |folder: &str| std::fs::read(place.path(&format!("{folder}/{name}"))).unwrap();
        assert!(bytes("aligned") == bytes("one"), "{name}");
    }
}

/// Errors of constant corrections are as large as their SDs.
#[test]
fn errors_of_offsets_are_as_large_as_their_sds() {
    let errors = [[0.11, -0.07, 0.05], [-0.06, 0.04, -0.03], [0.02, 0.05, 0.04]];
    let strip = |k: usize| Strip { seed: 70 + k as u64, errors_m: [errors[k]; 2], ..GOOD };
    let place = clouds(&[
        ("a.las", strip(0)),
        ("b.las", Strip { from_to_m: [20.0, 100.0], ..strip(1) }),
        ("c.las", Strip { from_to_m: [10.0, 90.0], ..strip(2) }),
    ]);
    succeeds(&place, &["align", "a.las", "b.las", "c.las", "-o", "aligned"]);
    let report = report(&place);
    let mut squares = Vec::new();
    for axis in 0..3 {
        let mean_m = errors.iter().map(|errors| errors[axis]).sum::<f64>() / 3.0;
        for (strip, errors) in errors.iter().enumerate() {
            let [value_m, sd_m] = knots(&report, strip)[0][axis];
            let error_m = value_m + errors[axis] - mean_m;
            println!("strip {strip}, axis {axis}: {:.2} mm, SD {:.2}", 1e3 * error_m, 1e3 * sd_m);
            assert!(sd_m < if axis == 2 { 0.001 } else { 0.006 }, "{sd_m}");
            assert!(error_m.abs() < 4.0 * sd_m, "{error_m} {sd_m}");
            squares.push((error_m / sd_m).powi(2));
        }
    }
    let ratio = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
    assert!((0.2..2.0).contains(&ratio), "errors over SDs: {ratio}");
}

/// Over a plain, heights are corrected, and horizontal offsets are left alone.
#[test]
fn a_plain_says_nothing_of_horizontal_offsets() {
    let low = Strip { terrain: plain, errors_m: [[0.1, -0.08, 0.06]; 2], ..GOOD };
    let high = Strip { terrain: plain, seed: 2, ..GOOD };
    let place = clouds(&[("a.las", low), ("b.las", high)]);
    let outcome = succeeds(&place, &["align", "a.las", "b.las", "-o", "aligned", "--apply"]);
    for part in ["not estimable", "the overlaps are flat or have slopes of one direction only"] {
        assert!(outcome.out.contains(part), "{}", outcome.out);
    }
    let report = report(&place);
    for (strip, z_m) in [(0, -0.03), (1, 0.03)] {
        let found = &report["strips"][strip];
        assert_eq!(
            (&found["x"], &found["y"], &found["z"]),
            (&"not_estimable".into(), &"not_estimable".into(), &"estimated".into())
        );
        let [[x_m, _], [y_m, _], [found_m, sd_m]] = knots(&report, strip)[0];
        assert_eq!([x_m, y_m], [0.0; 2]);
        assert!((found_m - z_m).abs() < 4.0 * sd_m && sd_m < 0.001, "{found_m} {sd_m}");
    }
    let corrections = place.text("aligned/corrections.csv");
    assert!(corrections.starts_with("strip,time_s,x_m,y_m,z_m,x_sd_m,y_sd_m,z_sd_m\na,"), "{corrections}");
    assert!(corrections.lines().nth(1).unwrap().contains(",0,0,-0.03"), "{corrections}");
}

#[test]
fn clouds_are_aligned_by_the_commands_of_the_how_to() {
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/how-to/align-a-survey.md");
    let page = std::fs::read_to_string(page).unwrap();
    let commands: Vec<&str> = page
        .lines()
        .filter_map(|line| line.strip_prefix("wavex "))
        .filter(|command| command.contains(".laz"))
        .collect();
    assert_eq!(commands.len(), 2, "{commands:?}");
    let second = Strip { seed: 2, errors_m: [[0.05, 0.03, 0.08]; 2], ..GOOD };
    let names = ["strip1.laz", "strip2.laz", "strips/strip1.laz", "strips/strip2.laz"];
    let place = clouds(&[(names[0], GOOD), (names[1], second), (names[2], GOOD), (names[3], second)]);
    for command in commands {
        succeeds(&place, &command.split_whitespace().collect::<Vec<_>>());
        for name in ["corrections.csv", "align.json", "strip1.laz", "strip2.laz"] {
            std::fs::remove_file(place.path(&format!("aligned/{name}"))).unwrap();
        }
    }
}

/// One file with several flight lines is split by its point source IDs.
#[test]
fn a_single_cloud_is_split_by_source() {
    let place = TestFolder::new();
    let second = Strip {
        seed: 2,
        point_source_id: 2,
        start_s: Some(2000.0),
        errors_m: [[0.05, 0.03, 0.08]; 2],
        ..GOOD
    };
    place.write("both.las", &las(&[GOOD, second]));
    succeeds(&place, &["align", "both.las", "-o", "aligned", "--apply"]);
    let report = report(&place);
    let names: Vec<_> =
        report["strips"].as_array().unwrap().iter().map(|strip| strip["name"].clone()).collect();
    assert_eq!(names, ["both:1", "both:2"]);
    let [[first_m, _], [second_m, sd_m]] = [0, 1].map(|strip| knots(&report, strip)[0][2]);
    assert!((first_m - second_m - 0.08).abs() < 6.0 * sd_m, "{first_m} {second_m} {sd_m}");
    let unsplit = Strip { point_source_id: 1, ..second };
    place.write("one.las", &las(&[GOOD, unsplit]));
    let Outcome { code, err, .. } = place.wavex(&["align", "one.las", "-o", "alone"]);
    assert_eq!(code, Some(1));
    assert!(
        err.ends_with(
            "alignment needs two strips, but only `one` can be used; give a file for each strip, or one whose points have \
             the point source ID of their strip\n"
        ),
        "{err}"
    );
    assert!(!place.path("alone").exists());
}

/// Clouds that cannot be used are named, and the others are aligned.
#[test]
fn the_rest_of_the_clouds_is_aligned() {
    let other = Strip { seed: 2, errors_m: [[0.0, 0.0, 0.05]; 2], start_s: None, ..GOOD };
    let far = Strip { from_to_m: [600.0, 640.0], ..GOOD };
    let place = clouds(&[
        ("a.las", GOOD),
        ("b.las", other),
        ("far.las", far),
        ("zone.las", Strip { epsg: Some(32632), ..GOOD }),
    ]);
    let whole = las(&[GOOD]);
    place.write("cut.las", &whole[..whole.len() / 2]);
    place.write("empty.las", &las(&[Strip { from_to_m: [0.0, 0.0], ..GOOD }]));
    place.write("text.las", b"x y z\n1 2 3\n");
    let outcome = succeeds(&place, &["align", ".", "-o", "aligned", "--trajectory", "linear", "--apply"]);
    for part in [
        "cut.las: byte 107: number of point records: the header declares",
        "empty.las: it has no points",
        "text.las: byte 0: file signature: expected `LASF`",
        "zone.las: its coordinate reference system is WGS 84 / UTM zone 32N, that of ",
        "far: the strip shares no smooth surface with another one and is not aligned",
        "b: the points have no times, one time, or times of more than a day: the correction of the strip is constant",
    ] {
        assert!(outcome.err.contains(part), "{part}\n{}", outcome.err);
    }
    assert!(outcome.out.contains("2 of 3 strips, "), "{}", outcome.out);
    let report = report(&place);
    assert_eq!(report["failed_strips"].as_array().unwrap().len(), 4);
    assert_eq!([0, 1].map(|strip| knots(&report, strip).len()), [2, 1]);
    assert!(place.path("aligned/b.las").exists() && !place.path("aligned/far.las").exists());
}

#[test]
fn clouds_that_cannot_be_aligned_are_refused_with_a_remedy() {
    let far = Strip { from_to_m: [600.0, 640.0], ..GOOD };
    let place = clouds(&[("a.las", GOOD), ("b.las", Strip { seed: 2, ..GOOD }), ("far/c.las", far)]);
    place.write("none/readme.txt", b"");
    let of = |arguments: &[&str]| {
        let Outcome { code, err, .. } = place.wavex(&[&["align"], arguments].concat());
        assert!(!place.path("aligned").exists(), "{err}");
        (code, err)
    };
    for (arguments, expected_code, expected) in [
        (&["a.las", "far/c.las", "-o", "aligned"][..], 1, "no pairs of patches: the strips do not overlap"),
        (&["a.las", "-o", "aligned"], 1, "alignment needs two strips, but only `a` can be used"),
        (&["none", "-o", "aligned"], 2, "none: the folder has no .las or .laz files"),
        (&["*.laz", "-o", "aligned"], 2, "no file matches"),
        (&["a.las", "b.las", "-o", ".", "--apply"], 2, "a.las: the output would replace an input"),
        (
            &["a.las", "b.las", "-o", "aligned", "--trajectory", "none"],
            2,
            "leaves nothing to estimate for clouds",
        ),
        (
            &["a.las", "b.las", "-o", "aligned", "--set", "job.threads=1"],
            2,
            "`--set` overrides keys of a job",
        ),
        (&["a.las", "survey.toml", "-o", "aligned"], 2, "give jobs (.toml), or clouds of points"),
        (&["survey.toml", "-o", "aligned", "--by-source"], 2, "are for clouds of points"),
        (
            &["a.las", "b.las", "-o", "aligned", "--reference", "a"],
            2,
            "are for jobs; leave them out for clouds",
        ),
        (&["a.las", "b.las", "-o", "aligned", "--position-sd", "0"], 2, "give metres from 0.001 to 10"),
    ] {
        let (code, err) = of(arguments);
        assert!(code == Some(expected_code) && err.contains(expected), "{arguments:?}: {code:?} {err}");
    }
    // Without a system, coordinates are metres, and that is said.
    let place =
        clouds(&[("a.las", Strip { epsg: None, ..GOOD }), ("b.las", Strip { seed: 2, epsg: None, ..GOOD })]);
    let outcome = succeeds(&place, &["align", "a.las", "b.las", "-o", "aligned"]);
    assert!(
        outcome
            .err
            .contains("a.las: no coordinate reference system is known; coordinates are taken as metres")
    );
}

/// Two real strips meet within 2 mm, with and without known offsets and drifts of one of them.
#[test]
fn real_clouds_meet_again_after_known_offsets() {
    let Some(data) = data() else { return };
    let source = |name: &str| data.join("golm").join(name).display().to_string();
    let (one, other) = (source("strip04.laz"), source("strip05.laz"));
    if !Path::new(&one).exists() {
        println!("skipped: WAVEX_DATA has no golm/strip04.laz");
        return;
    }
    let place = TestFolder::new();
    let spread_mm = |report: &Value| {
        let overlap = &report["overlaps"][0];
        let number = |key: &str| 1e3 * overlap[key].as_f64().unwrap();
        assert!(number("median_after_m").abs() < 2.0 && number("spread_after_m") < 10.0, "{overlap}");
        number("spread_after_m")
    };
    succeeds(&place, &["align", &one, &other, "-o", "aligned"]);
    let recorded = report(&place);
    let recorded_mm = spread_mm(&recorded);
    // A drift of 20 mm in all axes about the middle of the strip of 2.4 s.
    let (shift_m, drift_m) = ([0.11, -0.07, 0.05], [0.02, -0.02, 0.02]);
    let moved = place.path("moved/strip04.laz");
    std::fs::create_dir_all(place.path("moved")).unwrap();
    let file = std::fs::File::create(&moved).unwrap();
    let [first_s, last_s] = ["first_s", "last_s"].map(|key| recorded["strips"][0][key].as_f64().unwrap());
    wavex_formats::las::write_shifted(Path::new(&one), file, &moved, |point| {
        let part = (point.gps_time - first_s) / (last_s - first_s) - 0.5;
        std::array::from_fn(|axis| shift_m[axis] + part * drift_m[axis])
    })
    .unwrap();
    let moved = moved.display().to_string();
    // The differences of the corrections to those without the shift are the shift; both strips share them.
    succeeds(&place, &["align", &one, &other, "-o", "aligned", "--trajectory", "linear"]);
    let before = report(&place);
    let outcome = succeeds(&place, &["align", &moved, &other, "-o", "aligned", "--trajectory", "linear"]);
    // These strips are tilted by roll: drifts that imitate it are named.
    assert!(outcome.err.contains("the strips are rather tilted than drifting"), "{}", outcome.err);
    let after = report(&place);
    assert!(spread_mm(&after) < 1.1 * recorded_mm);
    for end in 0..2 {
        for axis in 0..3 {
            let of = |report: &Value| {
                let [[one_m, sd_m], [other_m, _]] = [0, 1].map(|strip| knots(report, strip)[end][axis]);
                [one_m - other_m, 2.0 * sd_m]
            };
            let ([before_m, _], [after_m, sd_m]) = (of(&before), of(&after));
            let expected_m = -(shift_m[axis] + (end as f64 - 0.5) * drift_m[axis]);
            let error_m = after_m - before_m - expected_m;
            println!("end {end}, axis {axis}: error {:.2} mm, SD {:.2}", 1e3 * error_m, 1e3 * sd_m);
            assert!(error_m.abs() < 3.0 * sd_m && sd_m < 0.06, "{error_m} {sd_m}");
        }
    }
}
