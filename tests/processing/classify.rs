//! `wavex classify` of clouds of others: classes, copies, and clouds that cannot be classified.

use std::io::Cursor;
use std::path::Path;

use las::point::{Classification, Format};
use las::{Builder, Point, Reader, Transform, Vector, Vlr, Writer};
use serde_json::Value;
use tiff::decoder::{Decoder, DecodingResult};
use wavex_testkit::{Outcome, TestFolder};

/// Corner of the clouds, m.
const CORNER_M: [f64; 2] = [412_990.0, 5_806_080.0];
/// Edge of the clouds, m: they cross edges of tiles.
const EDGE_M: f64 = 60.0;
const METRES: [f64; 3] = [1.0; 3];

/// A cloud: hills with a house, 4 points per m².
#[derive(Clone, Copy)]
struct Scene {
    version: (u8, u8),
    format: u8,
    is_compressed: bool,
    /// EPSG code.
    epsg: Option<u16>,
    seed: u64,
    /// Units per metre of x, y and z.
    per_m: [f64; 3],
    change: fn(usize, &mut Point),
}

const SCENE: Scene = Scene {
    version: (1, 4),
    format: 6,
    is_compressed: true,
    epsg: None,
    seed: 1,
    per_m: METRES,
    change: |_, _| {},
};

fn is_house(x_m: f64, y_m: f64) -> bool {
    (20.0..32.0).contains(&x_m) && (25.0..35.0).contains(&y_m)
}

/// Points of a scene, and whether each is on the house.
fn points(scene: &Scene) -> (Vec<Point>, Vec<bool>) {
    let mut state = scene.seed;
    let mut random = move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1u64 << 53) as f64
    };
    let (mut all, mut of_house) = (Vec::new(), Vec::new());
    for k in 0..(4.0 * EDGE_M * EDGE_M) as usize {
        let (x_m, y_m) = (random() * EDGE_M, random() * EDGE_M);
        let ground_m = 100.0 + 2.0 * (x_m / 17.0).sin() + 0.1 * y_m + 0.03 * (random() - 0.5);
        let house = is_house(x_m, y_m);
        let position_m = [CORNER_M[0] + x_m, CORNER_M[1] + y_m, ground_m + if house { 7.0 } else { 0.0 }];
        let [x, y, z] = [0, 1, 2].map(|axis| position_m[axis] * scene.per_m[axis]);
        let format = Format::new(scene.format).unwrap();
        let mut point = Point {
            x,
            y,
            z,
            return_number: 1,
            number_of_returns: 1,
            intensity: (k % 999) as u16,
            user_data: k as u8,
            point_source_id: scene.seed as u16,
            gps_time: format.has_gps_time.then_some(1e5 + k as f64 * 1e-4),
            color: format.has_color.then(|| las::Color::new(k as u16, 2, 3)),
            nir: format.has_nir.then_some(7),
            extra_bytes: vec![k as u8, 5, 9],
            ..Point::default()
        };
        (scene.change)(k, &mut point);
        all.push(point);
        of_house.push(house);
    }
    (all, of_house)
}

/// The file of points.
fn file(scene: &Scene, points: Vec<Point>) -> Vec<u8> {
    let mut builder = Builder::from(scene.version);
    builder.point_format = Format::new(scene.format).unwrap();
    builder.point_format.extra_bytes = 3;
    builder.point_format.is_compressed = scene.is_compressed;
    let axis = |offset| Transform { scale: 0.01, offset };
    builder.transforms = Vector { x: axis(4e5), y: axis(5.8e6), z: axis(0.0) };
    builder.system_identifier = "someone else's scanner".into();
    if let Some(code) = scene.epsg {
        let keys = [1, 1, 0, 2, 1024, 0, 1, if code < 5000 && code > 4000 { 2 } else { 1 }];
        let key = if code < 5000 && code > 4000 { 2048 } else { 3072 };
        let data = keys.into_iter().chain([key, 0, 1, code]).flat_map(u16::to_le_bytes).collect();
        let user_id = "LASF_Projection".to_owned();
        builder.vlrs.push(Vlr { user_id, record_id: 34735, description: String::new(), data });
    }
    let mut writer = Writer::new(Cursor::new(Vec::new()), builder.into_header().unwrap()).unwrap();
    points.into_iter().for_each(|point| writer.write_point(point).unwrap());
    writer.into_inner().unwrap().into_inner()
}

fn scene(scene: &Scene) -> Vec<u8> {
    file(scene, points(scene).0)
}

fn succeeds(place: &TestFolder, arguments: &[&str]) -> Outcome {
    let outcome = place.wavex(arguments);
    println!("{}{}", outcome.out, outcome.err);
    assert_eq!(outcome.code, Some(0), "wavex {arguments:?}");
    outcome
}

/// The end of the message of a command that fails with this code.
fn fails(place: &TestFolder, code: i32, arguments: &[&str]) -> String {
    let outcome = place.wavex(arguments);
    println!("{}{}", outcome.out, outcome.err);
    assert_eq!(outcome.code, Some(code), "wavex {arguments:?}");
    outcome.err
}

fn classes(place: &TestFolder, name: &str) -> Vec<u8> {
    let mut reader = Reader::from_path(place.path(name)).unwrap();
    reader.read_all().unwrap().classification().collect()
}

fn bytes(place: &TestFolder, name: &str) -> Vec<u8> {
    std::fs::read(place.path(name)).unwrap()
}

/// Part of the ground that is found, and number of points of the house that are taken for ground.
fn quality(classes: &[u8], of_house: &[bool]) -> (f64, usize) {
    let n_ground = of_house.iter().filter(|house| !**house).count();
    let of = |is_house: bool| {
        classes.iter().zip(of_house).filter(|(class, house)| **class == 2 && **house == is_house).count()
    };
    (of(false) as f64 / n_ground as f64, of(true))
}

/// Strips share the ground; bytes depend neither on threads nor on the order of files.
#[test]
fn strips_are_classified_together() {
    let place = TestFolder::new();
    let other = Scene { seed: 2, format: 7, ..SCENE };
    place.write("strips/a.laz", &scene(&SCENE));
    place.write("strips/b.laz", &scene(&other));
    let outcome = succeeds(&place, &["classify", "strips", "-o", "out", "--report", "out/report.json"]);
    for (name, scene) in [("out/a.laz", SCENE), ("out/b.laz", other)] {
        let (recall, n_house) = quality(&classes(&place, name), &points(&scene).1);
        println!("{name}: {recall}, {n_house}");
        assert!(recall > 0.95 && n_house < 10, "{recall} {n_house}");
    }
    for part in [
        "strips/a.laz: 14400 points, ",
        "% ground, 0 left alone",
        "\n  0 never classified            14400 ->            0\n  1 unc",
    ] {
        assert!(outcome.out.contains(part), "{part}: {}", outcome.out);
    }
    let report: Value = serde_json::from_str(&place.text("out/report.json")).unwrap();
    let first = &report["clouds"][0];
    assert_eq!(
        (&first["points"], &first["classes_before"]),
        (&14400.into(), &serde_json::json!({"0": 14400}))
    );
    let n_ground = classes(&place, "out/a.laz").iter().filter(|class| **class == 2).count();
    assert_eq!(first["classes_after"]["2"], n_ground);
    let words =
        ["classify", "strips/b.laz", "strips/a.laz", "-o", "again", "--threads", "1", "--memory-mb", "16"];
    succeeds(&place, &words);
    for name in ["a.laz", "b.laz"] {
        assert!(bytes(&place, &format!("out/{name}")) == bytes(&place, &format!("again/{name}")), "{name}");
    }
    // Points of the roof alone are ground, and none where another strip has the ground around it.
    let (all, of_house) = points(&SCENE);
    let roof =
        all.into_iter().zip(of_house).filter(|(_, is_house)| *is_house).map(|(point, _)| point).collect();
    place.write("roof.laz", &file(&SCENE, roof));
    succeeds(&place, &["classify", "roof.laz", "-o", "alone.laz"]);
    succeeds(&place, &["classify", "roof.laz", "strips/b.laz", "-o", "both"]);
    let n_ground = |name: &str| classes(&place, name).iter().filter(|class| **class == 2).count();
    let n_roof = classes(&place, "roof.laz").len();
    assert!(n_ground("alone.laz") > n_roof / 2 && n_ground("both/roof.laz") < 10);
}

/// Headers, records and points of copies are those of the inputs, except classes; so they are in feet.
#[test]
fn copies_differ_in_classes_only() {
    let place = TestFolder::new();
    // NAD83 / California zone 5 (ftUS).
    let feet = [3937.0 / 1200.0; 3];
    let formats = [
        Scene { version: (1, 2), format: 3, is_compressed: false, ..SCENE },
        Scene { version: (1, 2), format: 1, epsg: Some(2229), per_m: feet, ..SCENE },
        Scene { format: 8, ..SCENE },
    ];
    for cloud in formats {
        let name = if cloud.is_compressed { "a.laz" } else { "a.las" };
        place.write(name, &scene(&cloud));
        let output = format!("out/{name}");
        succeeds(&place, &["classify", name, "-o", &output]);
        let (before, after) = (bytes(&place, name), bytes(&place, &output));
        let header = Reader::new(Cursor::new(before.clone())).unwrap().header().clone();
        let start = header.clone().into_raw().unwrap().offset_to_point_data as usize;
        assert!(before[..start] == after[..start]);
        let records = |bytes: Vec<u8>| {
            let data = Reader::new(Cursor::new(bytes)).unwrap().read_all().unwrap();
            let mut records: Vec<Vec<u8>> =
                data.raw_bytes().chunks_exact(data.record_len()).map(<[u8]>::to_vec).collect();
            let (at, mask) = if cloud.format <= 5 { (15, 0b1110_0000) } else { (16, 0) };
            records.iter_mut().for_each(|record| record[at] &= mask);
            records
        };
        assert!(records(before) == records(after));
        let (recall, n_house) = quality(&classes(&place, &output), &points(&cloud).1);
        assert!(recall > 0.95 && n_house < 10, "{name}: {recall} {n_house}");
    }
}

/// Withheld, synthetic and noise points, kept classes and overlap points stay as they are.
#[test]
fn points_are_left_alone() {
    let place = TestFolder::new();
    let change = |k: usize, point: &mut Point| {
        point.classification = Classification::new([2, 1, 7, 6, 9, 5][k % 6]).unwrap();
        (point.is_withheld, point.is_synthetic) = (k % 60 == 1, k % 60 == 7);
    };
    let cloud = Scene { format: 1, version: (1, 2), change, ..SCENE };
    let mut made = scene(&cloud);
    place.write("a.laz", &made);
    let outcome = succeeds(&place, &["classify", "a.laz", "-o", "out.laz", "--keep", "6,9"]);
    assert!(outcome.out.contains("7680 left alone"), "{}", outcome.out);
    let found = classes(&place, "out.laz");
    for (k, class) in found.iter().enumerate() {
        let kept = match k % 6 {
            _ if k % 60 == 1 || k % 60 == 7 => Some(1),
            2 => Some(7),
            3 => Some(6),
            4 => Some(9),
            _ => None,
        };
        assert!(kept.map_or([1, 2].contains(class), |kept| kept == *class), "{k}: {class}");
    }
    // Class 12 is overlap in formats 0 to 5, and nothing in later ones.
    let uncompressed = Scene { is_compressed: false, ..cloud };
    made = scene(&uncompressed);
    let start = u32::from_le_bytes(made[96..100].try_into().unwrap()) as usize;
    for record in made[start..].chunks_exact_mut(31) {
        record[15] = 12;
    }
    place.write("overlap.las", &made);
    let outcome = succeeds(&place, &["classify", "overlap.las", "-o", "out.las"]);
    assert!(outcome.out.contains("14400 left alone"), "{}", outcome.out);
    assert!(bytes(&place, "out.las") == made);
}

/// Clouds without ground, without points, or with absurd heights have clear answers.
#[test]
fn unusual_clouds_are_copied_with_a_message() {
    let place = TestFolder::new();
    let message = |cloud: &Scene, n: usize| {
        place.write("a.laz", &file(cloud, points(cloud).0.into_iter().take(n).collect()));
        let outcome = succeeds(&place, &["classify", "a.laz", "-o", "out.laz"]);
        (outcome.err, classes(&place, "out.laz"))
    };
    let (text, found) = message(&SCENE, 0);
    assert!(text.contains("a.laz: it has no points; the copy is the same") && found.is_empty(), "{text}");
    let (_, found) = message(&SCENE, 1);
    assert_eq!(found.len(), 1);
    let withheld = Scene { change: |_, point| point.is_withheld = true, ..SCENE };
    let (text, found) = message(&withheld, 500);
    assert!(text.contains("a.laz: all points are withheld or synthetic; no class changes"), "{text}");
    assert!(found.iter().all(|class| *class == 0));
    let absurd = Scene { change: |k, point| point.z = if k % 2 == 0 { 1e6 } else { -1e6 }, ..SCENE };
    let (text, found) = message(&absurd, 500);
    assert!(text.contains("a.laz: no ground is found: the points may be a water surface"), "{text}");
    assert!(found.iter().enumerate().all(|(k, class)| *class == if k % 2 == 0 { 18 } else { 7 }));
    let legacy = Scene { version: (1, 2), format: 1, ..absurd };
    assert!(message(&legacy, 100).1.iter().all(|class| *class == 7));
    let unknown = message(&SCENE, 100).0;
    assert!(
        unknown.contains("no coordinate reference system is known; coordinates are taken as metres"),
        "{unknown}"
    );
}

/// Clouds that cannot be used are named, and the others are classified as if they were alone.
#[test]
fn the_rest_of_the_clouds_is_classified() {
    let place = TestFolder::new();
    let utm = Scene { epsg: Some(32633), version: (1, 2), format: 1, ..SCENE };
    let good = scene(&utm);
    place.write("in/a.laz", &good);
    place.write("in/b.laz", &scene(&Scene { epsg: Some(2229), ..utm }));
    place.write("in/c.laz", &scene(&Scene { epsg: Some(4326), ..utm }));
    place.write("in/d.laz", &good[..good.len() / 2]);
    place.write("in/e.laz", b"");
    // The chunks are damaged, but not the table: decoders notice it late, or never.
    let mut damaged = scene(&Scene { seed: 2, ..utm });
    let n = damaged.len();
    damaged[n / 2..n / 2 + 2000].fill(0x55);
    place.write("in/f.laz", &damaged);
    let text = fails(&place, 1, &["classify", "in", "-o", "out"]);
    for part in [
        "5 clouds were left out:",
        "in/b.laz: its coordinate reference system is NAD83",
        "that of in/a.laz is WGS 84 / UTM zone 33N; convert all clouds to one system",
        "in/c.laz: its coordinates are degrees; project the clouds",
        "in/d.laz: ",
        "in/e.laz: the file is empty",
        "in/f.laz: ",
    ] {
        assert!(text.contains(part), "{part}: {text}");
    }
    let names = |folder: &str| {
        let entries = place.path(folder).read_dir().unwrap().map(|entry| entry.unwrap().file_name());
        entries.map(|name| name.to_string_lossy().into_owned()).collect::<Vec<_>>()
    };
    assert_eq!(names("out"), ["a.laz"]);
    succeeds(&place, &["classify", "in/a.laz", "-o", "alone"]);
    assert!(bytes(&place, "out/a.laz") == bytes(&place, "alone/a.laz"));
    let text = fails(&place, 1, &["classify", "in/d.laz", "-o", "none"]);
    assert!(text.contains("in/d.laz") && !place.path("none/d.laz").exists(), "{text}");
}

/// A COPC input stays COPC, and its points get the classes of the same points in LAZ, also with little memory.
#[test]
fn copc_stays_copc() {
    let place = TestFolder::new();
    place.write("a.laz", &scene(&SCENE));
    succeeds(&place, &["copc", "a.laz", "--quiet"]);
    succeeds(&place, &["classify", "a.laz", "-o", "out/a.laz"]);
    succeeds(
        &place,
        &["classify", "a.copc.laz", "-o", "out/a.copc.laz", "--memory-mb", "16", "--threads", "2"],
    );
    let copy = bytes(&place, "out/a.copc.laz");
    // The first record is that of COPC.
    assert_eq!((&copy[377..381], &copy[393..395]), (b"copc".as_slice(), [1, 0].as_slice()));
    // The time distinguishes points.
    let by_time = |name: &str| {
        let mut reader = Reader::from_path(place.path(name)).unwrap();
        let points = reader.read_all().unwrap();
        let times = points.gps_time().unwrap().map(f64::to_bits);
        let mut all: Vec<(u64, u8)> = times.zip(points.classification()).collect();
        all.sort_unstable();
        all
    };
    let (expected, found) = (by_time("out/a.laz"), by_time("out/a.copc.laz"));
    assert!(found == expected && found.iter().any(|(_, class)| *class == 2));
    // The octree of the copy leads to its points.
    succeeds(&place, &["copc", "out/a.copc.laz", "-o", "again.copc.laz", "--quiet"]);
    assert!(by_time("again.copc.laz") == expected);
}

/// Ctrl-C leaves no file.
#[cfg(unix)]
#[test]
fn an_interruption_leaves_no_file() {
    use std::process::{Command, Stdio};
    let place = TestFolder::new();
    let (all, _) = points(&SCENE);
    let far = |i: usize| {
        let moved = move |point: &Point| Point { x: point.x + EDGE_M * i as f64, ..point.clone() };
        all.iter().map(moved).collect::<Vec<Point>>()
    };
    place.write("a.laz", &file(&SCENE, (0..20).flat_map(far).collect()));
    let n_files = || place.path("out").read_dir().map_or(0, |entries| entries.count());
    for signal in ["INT", "TERM"] {
        let mut child = wavex_testkit::wavex()
            .args([
                "classify",
                "a.laz",
                "-o",
                "out",
                "--report",
                "out/report.json",
                "--threads",
                "1",
                "--quiet",
            ])
            .current_dir(place.path(""))
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        while n_files() == 0 {
            assert_eq!(child.try_wait().unwrap(), None, "it ended before it was interrupted");
            std::thread::sleep(std::time::Duration::from_millis(2));
        }
        let sent =
            Command::new("kill").args([&format!("-{signal}"), &child.id().to_string()]).status().unwrap();
        assert!(sent.success());
        let output = child.wait_with_output().unwrap();
        let err = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.code() == Some(1) && err.starts_with("error: interrupted"), "{err}");
        assert_eq!(n_files(), 0);
    }
}

#[test]
fn wrong_outputs_are_refused() {
    let place = TestFolder::new();
    place.write("in/a.laz", &file(&SCENE, Vec::new()));
    place.write("in/b.laz", &file(&SCENE, Vec::new()));
    place.write("other/a.laz", &file(&SCENE, Vec::new()));
    place.write("x.txt", b"");
    for (arguments, expected) in [
        (
            vec!["in/a.laz", "-o", "in/a.laz"],
            "in/a.laz: the output would replace an input; write to another folder",
        ),
        (vec!["in", "-o", "in"], "in/a.laz: the output would replace an input; write to another folder"),
        (vec!["in", "-o", "all.laz"], "all.laz: the output of several clouds is a folder"),
        (vec!["other", "-o", "all.laz"], "all.laz: the output of a folder or pattern is a folder"),
        (
            vec!["in/a.laz", "-o", "a.las"],
            "a.las: the copy is compressed as its input is; give it the extension",
        ),
        (vec!["x.txt", "-o", "a.las"], "x.txt: it is no .las or .laz file"),
        (
            vec!["in/a.laz", "-o", "out", "--report", "in/a.laz"],
            "in/a.laz: the output would replace an input",
        ),
        (vec!["in/a.laz", "-o", "out", "--keep", "300"], "300 is not in 0..=255"),
    ] {
        let text = fails(&place, 2, &[&["classify"], &arguments[..]].concat());
        assert!(text.contains(expected), "{expected}: {text}");
    }
    let text = fails(&place, 2, &["classify", "in/a.laz", "other/a.laz", "-o", "out"]);
    assert!(text.contains("the outputs of in/a.laz and other/a.laz would have the same names"), "{text}");
    assert!(!place.path("out").exists());
}

/// The commands of the how-to work, in their order.
#[test]
fn strips_are_classified_by_the_commands_of_the_how_to() {
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/how-to/ground-and-terrain.md");
    let page = std::fs::read_to_string(page).unwrap();
    let commands: Vec<String> = page
        .lines()
        .filter_map(|line| line.strip_prefix("wavex "))
        .map(|command| command.replace('\'', ""))
        .collect();
    assert_eq!(commands.len(), 10, "{commands:?}");
    let place = TestFolder::new();
    let job = page.split("```toml\n").nth(1).and_then(|rest| rest.split("```").next()).unwrap();
    // Fewer waveforms suffice here.
    let job = job.replace("\"calibrate\"", "\"calibrate\"\nwaveforms = 300");
    place.write("night.toml", job.as_bytes());
    for (seed, offset) in [(1, "0.0"), (2, "40.0")] {
        let flight = format!(
            "[job]\noutput_dir = 'night'\nreport = ''\nlog = ''\nstat_log = ''\n[[stage]]\ntype = 'simulate'\nstem = 'strip{seed}'\n\
             seed = {seed}\nscene_seed = 1\nlandscape = 'country'\nwater_ratio = 0.0\nwire_height_m = 0.0\nlines = 60\n\
             shots_per_line = 150\nflying_height_m = 100.0\nspeed_mps = 240.0\ntrack_offset_m = [{offset}, 0.0]\n\
             start_time_s = {}.0\nsbet = '*.out'\n[[stage]]\ntype = 'write_arrow'\npath = '*.arrow'\n",
            208_800 + 100 * seed
        );
        place.write("make.toml", flight.as_bytes());
        succeeds(&place, &["run", "make.toml"]);
    }
    let cloud = Scene { epsg: Some(32633), version: (1, 2), format: 1, ..SCENE };
    for (name, seed) in [("strips/strip1.laz", 1), ("strips/strip2.laz", 2)] {
        place.write(name, &scene(&Scene { seed, ..cloud }));
    }
    for command in &commands {
        succeeds(&place, &command.split_whitespace().collect::<Vec<_>>());
    }
}

/// One model of all strips: bytes depend neither on threads nor on the order of files.
#[test]
fn terrain_is_written_with_standard_deviations() {
    let place = TestFolder::new();
    place.write("strips/a.laz", &scene(&Scene { epsg: Some(25833), ..SCENE }));
    place.write("strips/b.laz", &scene(&Scene { seed: 2, epsg: Some(25833), ..SCENE }));
    let words = ["classify", "strips", "-o", "out", "--dem", "out/ground.tif", "--cell", "2"];
    let outcome = succeeds(&place, &words);
    assert!(outcome.out.contains("terrain: 9"), "{}", outcome.out);
    let words = [
        "strips/b.laz",
        "strips/a.laz",
        "-o",
        "again",
        "--dem",
        "again.tif",
        "--cell",
        "2",
        "--threads",
        "1",
    ];
    succeeds(&place, &[&["classify"], &words[..]].concat());
    assert!(bytes(&place, "out/ground.tif") == bytes(&place, "again.tif"));
    let mut decoder = Decoder::new(Cursor::new(bytes(&place, "again.tif"))).unwrap();
    // A point whose northing is rounded to the edge is in a row of its own.
    let (columns, rows) = decoder.dimensions().unwrap();
    assert!((30..=31).contains(&columns) && (30..=31).contains(&rows), "{columns} {rows}");
    let DecodingResult::F32(values) = decoder.read_chunk(0).unwrap() else { panic!() };
    let mut deviations = Vec::new();
    for (i, cell) in values.chunks_exact(4).enumerate() {
        let (column, row) = ((i % columns as usize) as f64, (i / columns as usize) as f64);
        let (x_m, y_m) = (2.0 * column + 1.0, 2.0 * (f64::from(rows) - row) - 1.0);
        if cell[0] > -9000.0 && !is_house(x_m, y_m) {
            let truth_m = 100.0 + 2.0 * (x_m / 17.0).sin() + 0.1 * y_m;
            deviations.push((f64::from(cell[0]) - truth_m) / f64::from(cell[1]));
            assert!((0.0..0.2).contains(&cell[1]) && cell[2] < 60.0 && cell[3] < 5.0, "{cell:?}");
        }
    }
    let rms = (deviations.iter().map(|d| d * d).sum::<f64>() / deviations.len() as f64).sqrt();
    // The noise is that of files with steps of 1 cm, and the error of strips is unknown but none.
    assert!(deviations.len() > 800 && rms < 1.5, "{rms} of {}", deviations.len());
}

/// Kept classes belong to the models: ground to the terrain, buildings to the surface.
#[test]
fn surface_and_canopy_have_kept_buildings() {
    let place = TestFolder::new();
    let change = |k: usize, point: &mut Point| {
        let (x_m, y_m) = (point.x - CORNER_M[0], point.y - CORNER_M[1]);
        let class = if is_house(x_m, y_m) { 6 } else { 2 };
        point.classification = Classification::new(class).unwrap();
        point.is_withheld = k.is_multiple_of(100);
        if k.is_multiple_of(100) {
            point.z += 50.0;
        }
    };
    place.write("a.laz", &scene(&Scene { change, epsg: Some(25833), ..SCENE }));
    let words = "classify a.laz -o b.laz --keep 2,6 --dem t.tif --surface s.tif --canopy c.tif --cell 2";
    succeeds(&place, &words.split(' ').collect::<Vec<_>>());
    let read = |name: &str| {
        let mut decoder = Decoder::new(Cursor::new(bytes(&place, name))).unwrap();
        let DecodingResult::F32(values) = decoder.read_chunk(0).unwrap() else { panic!() };
        (decoder.dimensions().unwrap(), values)
    };
    let ((columns, rows), terrain) = read("t.tif");
    let (surface, canopy) = (read("s.tif"), read("c.tif"));
    assert_eq!([surface.0, canopy.0], [(columns, rows); 2]);
    let (mut of_house, mut others) = (0, 0);
    for i in 0..(columns * rows) as usize {
        let (x_m, y_m) =
            (2.0 * (i as u32 % columns) as f64 + 1.0, 2.0 * (rows - i as u32 / columns) as f64 - 1.0);
        let (height, top, above) = (terrain[4 * i], surface.1[i], canopy.1[i]);
        if height < -9000.0 || top < -9000.0 {
            continue;
        }
        assert!((above - (top - height)).abs() < 1e-3);
        if (21.0..31.0).contains(&x_m) && (26.0..34.0).contains(&y_m) {
            assert!((above - 7.0).abs() < 1.0, "{x_m} {y_m}: {above}");
            of_house += 1;
        } else if !(18.0..34.0).contains(&x_m) || !(23.0..37.0).contains(&y_m) {
            assert!(above.abs() < 0.6, "{x_m} {y_m}: {above}");
            others += 1;
        }
    }
    assert!(of_house == 20 && others > 600, "{of_house} {others}");
}

/// SDs of the points reach the model: the error that strips share is that of the total uncertainty.
#[test]
fn total_uncertainties_of_clouds_are_used() {
    let place = TestFolder::new();
    let descriptor = |name: &str| {
        let mut bytes = vec![0; 192];
        bytes[2] = 9;
        bytes[4..4 + name.len()].copy_from_slice(name.as_bytes());
        bytes
    };
    let write = |file: &str, name: &str| {
        let change = |_: usize, point: &mut Point| point.extra_bytes = 0.2f32.to_le_bytes().to_vec();
        let cloud = Scene { change, epsg: Some(25833), ..SCENE };
        let mut header = Builder::from((1, 4));
        header.point_format = Format::new(6).unwrap();
        header.point_format.extra_bytes = 4;
        header.point_format.is_compressed = true;
        let axis = |offset| Transform { scale: 0.01, offset };
        header.transforms = Vector { x: axis(4e5), y: axis(5.8e6), z: axis(0.0) };
        header.vlrs.push(Vlr {
            user_id: "LASF_Spec".into(),
            record_id: 4,
            description: String::new(),
            data: descriptor(name),
        });
        let mut writer = Writer::new(Cursor::new(Vec::new()), header.into_header().unwrap()).unwrap();
        points(&cloud).0.into_iter().for_each(|point| writer.write_point(point).unwrap());
        place.write(file, &writer.into_inner().unwrap().into_inner());
    };
    write("total.laz", "Total uncertainty");
    write("range.laz", "Range SD");
    let median = |file: &str| {
        let outcome = succeeds(&place, &["classify", file, "-o", "out.laz", "--dem", "t.tif", "--cell", "2"]);
        let text = outcome.out.split("SD of heights ").nth(1).unwrap();
        (text.split(' ').next().unwrap().parse::<f64>().unwrap(), outcome.err)
    };
    let (sd_cm, err) = median("total.laz");
    assert!((19.0..23.0).contains(&sd_cm) && !err.contains("assumed to be 5 cm"), "{sd_cm}: {err}");
    // The SD of ranges is no error of the strip.
    let (sd_cm, err) = median("range.laz");
    assert!((4.0..7.0).contains(&sd_cm) && err.contains("assumed to be 5 cm"), "{sd_cm}: {err}");
}

/// A single point is not found to be ground. If it is known to be, its terrain is one cell, as uncertain as land without
/// neighbours.
#[test]
fn the_terrain_of_one_point_is_uncertain() {
    let place = TestFolder::new();
    let change = |_, point: &mut Point| point.classification = Classification::Ground;
    let point = points(&Scene { change, ..SCENE }).0.swap_remove(0);
    place.write("a.laz", &file(&SCENE, vec![point.clone()]));
    let words = ["classify", "a.laz", "-o", "b.laz", "--dem", "a.tif"];
    let message = fails(&place, 1, &words);
    assert!(message.contains("a.laz: no ground is found"), "{message}");
    assert!(!place.path("a.tif").exists());
    succeeds(&place, &[&words[..], &["--keep", "2"]].concat());
    let mut decoder = Decoder::new(Cursor::new(bytes(&place, "a.tif"))).unwrap();
    assert_eq!(decoder.dimensions().unwrap(), (1, 1));
    let DecodingResult::F32(cell) = decoder.read_chunk(0).unwrap() else { panic!() };
    assert!(
        (f64::from(cell[0]) - point.z).abs() < 0.01 && (0.1..1.0).contains(&cell[1]) && cell[2] == 1.0,
        "{cell:?}"
    );
}

#[test]
fn terrain_without_ground_is_refused() {
    let place = TestFolder::new();
    place.write("a.laz", &file(&SCENE, Vec::new()));
    let message = fails(&place, 1, &["classify", "a.laz", "-o", "b.laz", "--dem", "a.tif"]);
    assert!(message.contains("a.tif: no terrain model is written: there are no ground points"), "{message}");
    assert!(!place.path("a.tif").exists());
    let no_ground = |cloud: Scene, n: usize| {
        place.write("c.laz", &file(&cloud, points(&cloud).0.into_iter().take(n).collect()));
        fails(&place, 1, &["classify", "c.laz", "-o", "b.laz", "--dem", "c.tif"])
    };
    let expected =
        "c.tif: no terrain model is written: there are no ground points; check the classes of the points";
    let withheld = Scene { change: |_, point| point.is_withheld = true, ..SCENE };
    let absurd = Scene { change: |_, point| point.z = 1e6, ..SCENE };
    for message in [no_ground(withheld, 500), no_ground(absurd, 500)] {
        assert!(message.contains(expected), "{message}");
    }
    let degrees = Scene { epsg: Some(4326), version: (1, 2), format: 1, ..SCENE };
    let message = no_ground(degrees, 500);
    assert!(message.contains("c.laz: its coordinates are degrees; project the clouds"), "{message}");
    assert!(!place.path("c.tif").exists());
    // A far point of the ground would need too large a raster.
    let change = |k: usize, point: &mut Point| {
        point.classification = Classification::Ground;
        let away_m = if k == 0 { 1e6 } else { 0.0 };
        (point.x, point.y) = (point.x + away_m, point.y + away_m);
    };
    let far = Scene { change, ..SCENE };
    place.write("d.laz", &file(&far, points(&far).0));
    let words = "classify d.laz -o b.laz --keep 2 --dem d.tif --surface e.tif --cell 0.05";
    let message = fails(&place, 1, &words.split(' ').collect::<Vec<_>>());
    assert!(
        message.contains("cells are too many; set a larger `--cell`, or leave out points far away"),
        "{message}"
    );
    assert!(!place.path("d.tif").exists() && !place.path("e.tif").exists());
    let words = "classify a.laz -o b.laz --dem same.tif --canopy same.tif";
    let message = fails(&place, 2, &words.split(' ').collect::<Vec<_>>());
    assert!(message.contains("same.tif: two models would have this name; give each its own"), "{message}");
    let message = fails(&place, 2, &["classify", "a.laz", "-o", "b.laz", "--surface", "s.tif"]);
    assert!(message.contains("--dem"), "{message}");
    let message = fails(&place, 2, &["classify", "a.laz", "-o", "b.laz", "--dem", "a.png"]);
    assert!(message.contains("a.png: the terrain model is a GeoTIFF; give a name with .tif"), "{message}");
}
