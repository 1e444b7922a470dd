//! Scan angle, scan direction and edge of flight line in outputs, for recordings without them.

use std::collections::BTreeMap;
use std::path::Path;

use wavex::scan_line::emission_flags::SCAN_DIRECTION_POSITIVE;
use wavex_formats::container::{Compression, ContainerReader, ContainerWriter, LineBuilder};
use wavex_testkit::data;
use wavex_testkit::las::Las;
use wavex_testkit::pulsewaves::PulseWaves;
use wavex_testkit::{Outcome, TestFolder};

/// Stages from samples to points as text: time, position, angle, direction, edge.
const TO_TEXT: &str = "\
[[stage]]
type = 'calibrate'
waveforms = 300
response = 'gaussian'
[[stage]]
type = 'decompose'
[[stage]]
type = 'georeference'
[[stage]]
type = 'write_ascii'
path = 'points.txt'
columns = 'txyzade'
";

const UNKNOWN: &str = "scan angles are unknown, and are 0 in outputs: the recording has none, and its \
                       beams do not define the direction of flight";

/// A point of the text.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Row {
    time_s: f64,
    place_m: [f64; 3],
    angle_deg: f64,
    to_the_right: bool,
    is_edge: bool,
}

/// First point of each shot.
fn shots(text: &Path) -> Vec<Row> {
    let text = std::fs::read_to_string(text).unwrap();
    let rows = text.lines().filter(|line| !line.starts_with('#')).map(|line| {
        let cells: Vec<f64> = line.split([' ', ',']).map(|cell| cell.parse().unwrap()).collect();
        let (to_the_right, is_edge) = (cells[5] == 1.0, cells[6] == 1.0);
        Row {
            time_s: cells[0],
            place_m: [cells[1], cells[2], cells[3]],
            angle_deg: cells[4],
            to_the_right,
            is_edge,
        }
    });
    let mut rows: Vec<Row> = rows.collect();
    rows.dedup_by_key(|row| row.time_s);
    rows
}

/// Shots per line of the flights built by hand.
const SHOTS: usize = 150;

/// Angle of a shot: it sweeps from side to side.
fn angle_of(shot: usize) -> f64 {
    let (line, place) = (shot / SHOTS, (shot % SHOTS) as f64 / (SHOTS - 1) as f64);
    let swing = 50.0 * place - 20.0;
    if line.is_multiple_of(2) { swing } else { 10.0 - swing }
}

/// A PulseWaves flight to the east at 60 m/s with beams that sweep across the track.
fn sweeping() -> PulseWaves {
    (0..3 * SHOTS).fold(PulseWaves::new(3 * SHOTS), |recording, shot| {
        let anchor = [(shot as f64 * 60_000.0 / 1024.0).round() as i32, 0, 600_000];
        let (right, down) = angle_of(shot).to_radians().sin_cos();
        // For a flight to the east, right is south.
        let beam = [0.0, -right, -down].map(|part| (149_853.751 * part).round() as i32);
        let target: [i32; 3] = std::array::from_fn(|axis| anchor[axis] + beam[axis]);
        let bytes: Vec<u8> = anchor.iter().chain(&target).flat_map(|value| value.to_le_bytes()).collect();
        // The meaning of the flag is not defined: here it is set while the mirror moves left.
        let flags = if (shot / SHOTS).is_multiple_of(2) { 0 } else { 0x20 };
        recording.change(shot, 16, &bytes).change(shot, 45, &[flags])
    })
}

#[test]
fn pulsewaves_get_their_angles_from_beams_and_course() {
    let recording = sweeping();
    let place = TestFolder::with(&[("a.pls", &recording.pls()), ("a.wvs", &recording.waves)]);
    let report = place.succeeds("read_pulsewaves", "a.pls", TO_TEXT);
    let found = shots(&place.path("out/points.txt"));
    assert_eq!(found.len(), 3 * SHOTS);
    for (shot, row) in found.iter().enumerate() {
        let (line, of_line) = (shot / SHOTS, shot % SHOTS);
        assert!((row.angle_deg - angle_of(shot)).abs() < 0.01, "{shot}: {row:?} {}", angle_of(shot));
        // The end of the file need not be the end of a line.
        let is_edge = of_line == SHOTS - 1 && line < 2;
        assert_eq!((row.to_the_right, row.is_edge), (line.is_multiple_of(2), is_edge), "{shot}: {row:?}");
    }
    assert!(!report.to_string().contains(UNKNOWN));
}

/// A stationary sensor gives no flight direction.
#[test]
fn a_recording_without_a_course_has_no_scan_angles() {
    let recording = (0..400).fold(PulseWaves::new(400), |recording, shot| {
        recording.change(shot, 16, &[0; 4]).change(shot, 28, &[0; 4])
    });
    let place = TestFolder::with(&[("a.pls", &recording.pls()), ("a.wvs", &recording.waves)]);
    let report = place.succeeds("read_pulsewaves", "a.pls", TO_TEXT);
    assert!(shots(&place.path("out/points.txt")).iter().all(|row| row.angle_deg == 0.0));
    assert_eq!(report.to_string().matches(UNKNOWN).count(), 1, "{report}");
}

#[test]
fn las_keeps_its_own_values() {
    // Angle of -12.6 degrees to the left; direction and edge in bits 6 and 7 of the flags.
    let recording = (0..400).fold(Las::new(400), |recording, shot| {
        let bits = if shot % 100 == 99 { 0xC0 } else { 0x40 };
        recording.change(shot, 15, &[bits]).change(shot, 18, &(-2100i16).to_le_bytes())
    });
    let place = TestFolder::with(&[("a.las", &recording.las()), ("a.wdp", &recording.packets)]);
    place.succeeds("read_las", "a.las", TO_TEXT);
    for (shot, row) in shots(&place.path("out/points.txt")).iter().enumerate() {
        assert_eq!((row.angle_deg, row.to_the_right, row.is_edge), (-12.6, true, shot % 100 == 99), "{shot}");
    }
}

/// Removes angles and directions from a container; returns the directions by time.
fn without_angles(path: &Path) -> (Vec<u8>, BTreeMap<i64, bool>) {
    let mut reader = ContainerReader::open(path).unwrap();
    let mut writer = ContainerWriter::file(Vec::new(), path, reader.header(), Compression::None).unwrap();
    let mut directions = BTreeMap::new();
    while let Some(line) = reader.next_line().unwrap() {
        let mut builder = LineBuilder::new();
        for row in 0..line.rows() {
            let mut shot = line.shot(row);
            let time_us = (shot.gps_time_s.unwrap() * 1e6).round() as i64;
            directions.insert(time_us, shot.flags & SCAN_DIRECTION_POSITIVE != 0);
            shot.scan_angle_deg = None;
            shot.flags &= !SCAN_DIRECTION_POSITIVE;
            builder.shot(&shot);
            line.blocks(row).for_each(|block| builder.block(&block));
        }
        writer.write(builder).unwrap();
    }
    (writer.finish().unwrap(), directions)
}

/// Microseconds of the week of an adjusted time, minus one because times are rounded.
fn just_before_us(adjusted_s: f64) -> i64 {
    ((adjusted_s * 1e6).round() as i64 + 1_000_000_000_000_000) % 604_800_000_000 - 1
}

/// A rolling flight with an oscillating mirror: angles against the position of each point relative
/// to the sensor.
#[test]
fn with_a_trajectory_angles_include_the_roll() {
    let place = TestFolder::new();
    let job = "[[stage]]\ntype = 'simulate'\nstem = 'a'\nlines = 6\nshots_per_line = 120\nscanner = 'oscillating'\n\
               roll_deg = 4.0\nscan_angle_deg = [-25.0, 20.0]\npof = 'a.pof'\n[[stage]]\ntype = 'write_arrow'\n";
    assert_eq!(place.run(job), Outcome::success());
    std::fs::copy(place.path("out/a.pof"), place.path("a.pof")).unwrap();
    let (recording, directions) = without_angles(&place.path("out/a.arrow"));
    place.write("a.arrow", &recording);
    let text = format!(
        "[job.geometry]\ntrajectory = 'a.pof'\n[[stage]]\ntype = 'read_arrow'\npath = 'a.arrow'\n{TO_TEXT}\
         [[stage]]\ntype = 'write_trajectory'\npath = 'path.txt'\nevery = 1\n"
    );
    assert_eq!(place.run(&text), Outcome::success());
    let path = place.text("out/path.txt");
    let cells = |line: &str| line.split(' ').map(|cell| cell.parse::<f64>().unwrap()).collect::<Vec<f64>>();
    let path: BTreeMap<i64, Vec<f64>> = path
        .lines()
        .filter(|line| !line.starts_with('#'))
        .map(cells)
        .map(|row| ((row[0] * 1e6).round() as i64, row))
        .collect();
    let (mut n, mut largest_roll, mut worst_deg) = (0, 0.0f64, 0.0f64);
    for row in shots(&place.path("out/points.txt")) {
        let since = (row.time_s * 1e6).round() as i64 - 1;
        let Some((_, sensor)) = path.range(since..).next() else { continue };
        let [east, north, up]: [f64; 3] = std::array::from_fn(|axis| row.place_m[axis] - sensor[axis + 1]);
        let (sin, cos) = sensor[6].to_radians().sin_cos();
        let expected_deg = (east * cos - north * sin).atan2(-up).to_degrees();
        worst_deg = worst_deg.max((row.angle_deg - expected_deg).abs());
        largest_roll = largest_roll.max(sensor[4].abs());
        let (_, to_the_right) = directions.range(just_before_us(row.time_s)..).next().unwrap();
        // At the turning points of the mirror, two shots have the same angle.
        assert!(row.to_the_right == *to_the_right || (expected_deg + 2.5).abs() > 18.0, "{row:?}");
        n += 1;
    }
    println!("{n} shots, roll up to {largest_roll:.2} degrees, largest difference {worst_deg:.4} degrees");
    assert!(n > 500 && largest_roll > 1.0 && worst_deg < 0.05, "{n} {largest_roll} {worst_deg}");
}

/// Angles of real recordings, and directions given by RIEGL's own flags; the LAS file of the same
/// pulses agrees.
#[test]
fn real_pulsewaves_have_scan_angles() {
    let Some(data) = data() else { return };
    for (name, angles_deg, edges, to_the_right) in [
        ("riegl_q680i_dev/riegl_q680i_dev", [-7.0, -4.8], 25, Some(true)),
        ("pulsewaves/riegl_example3", [-10.0, -1.2], 641, Some(false)),
        ("pulsewaves/geolas_example1", [-40.0, 40.0], 1, None),
        ("pulsewaves/optech_example1", [-40.0, 40.0], 1, None),
    ] {
        let out = tempfile::tempdir().unwrap();
        let job = format!(
            "[[stage]]\ntype = 'read_pulsewaves'\npath = '{name}.pls'\n[[stage]]\ntype = 'write_arrow'\n"
        );
        wavex_testkit::recordings::run("job.toml", &job, &data, out.path(), &[]);
        let stem = Path::new(name).file_name().unwrap().to_str().unwrap();
        let mut reader = ContainerReader::open(&out.path().join(format!("{stem}.arrow"))).unwrap();
        let mut found = Vec::new();
        while let Some(line) = reader.next_line().unwrap() {
            found.extend((0..line.rows()).map(|row| line.shot(row)));
        }
        let angles: Vec<f32> = found.iter().map(|shot| shot.scan_angle_deg.unwrap_or(f32::NAN)).collect();
        let [least, most] = angles.iter().fold([90.0f32, -90.0], |[a, b], x| [a.min(*x), b.max(*x)]);
        let right = found.iter().filter(|shot| shot.flags & SCAN_DIRECTION_POSITIVE != 0).count();
        let n_edges = found.iter().filter(|shot| shot.flags & 1 << 9 != 0).count();
        println!(
            "{name}: {least:.2} to {most:.2} degrees, {right} of {} to the right, {n_edges} edges",
            found.len()
        );
        assert!(angles.iter().all(|angle| angle.is_finite()), "{name}");
        assert!(
            f64::from(least) >= angles_deg[0] && f64::from(most) <= angles_deg[1],
            "{name}: {least} {most}"
        );
        let same = to_the_right.map(|to_the_right| if to_the_right { right } else { found.len() - right });
        assert!(same.is_none_or(|same| same == found.len()), "{name}: {right} of {}", found.len());
        assert_eq!(n_edges, edges, "{name}");
    }
}
