//! From the trajectory to the truth, by the chain that a user's own georeferencing goes.

use super::*;
use wavex_formats::trajectory::sbet::{RECORD_BYTES, SbetRecord};
use wavex_geodesy::ellipsoid::{Geodetic, WGS84};
use wavex_geodesy::frames::{Attitude, ecef_from_ned, rotate, rotation_of_angles};
use wavex_geodesy::transverse_mercator::{TransverseMercator, TransverseMercatorParameters};
use wavex_line::scan_line::Frame;

/// Flies to the end and gives the lines, and the files by their names.
fn flown(config: &Simulate) -> (Vec<ScanLine>, std::collections::BTreeMap<String, Vec<u8>>) {
    let folder = tempfile::tempdir().unwrap();
    let (mut source, mut cx) = (config.make(&run(folder.path())).unwrap(), Context::default());
    let mut lines = Vec::new();
    while let Some(line) = source.next(&mut cx).unwrap() {
        lines.push(line);
    }
    let files = cx.take_files().into_iter().map(|file| {
        let path = file.publish().unwrap();
        (path.file_name().unwrap().to_string_lossy().into_owned(), std::fs::read(&path).unwrap())
    });
    (lines, files.collect())
}

fn records(bytes: &[u8]) -> Vec<SbetRecord> {
    let records = bytes.chunks(RECORD_BYTES).map(|record| SbetRecord::decode(record.try_into().unwrap()));
    records.collect()
}

/// The trajectory at a time: places and angles linear between records.
fn pose(records: &[SbetRecord], time_s: f64) -> (Geodetic, Attitude) {
    let after = records.partition_point(|record| record.time_s <= time_s);
    let (a, b) = (&records[after - 1], &records[after]);
    let part = (time_s - a.time_s) / (b.time_s - a.time_s);
    let between = |of: fn(&SbetRecord) -> f64| of(a) + part * (of(b) - of(a));
    (
        Geodetic {
            latitude_rad: between(|r| r.latitude_rad),
            longitude_rad: between(|r| r.longitude_rad),
            height_m: between(|r| r.height_m),
        },
        Attitude {
            roll_rad: between(|r| r.roll_rad),
            pitch_rad: between(|r| r.pitch_rad),
            heading_rad: between(|r| r.platform_heading_rad - r.wander_angle_rad),
        },
    )
}

#[test]
fn georeferenced_returns_are_the_truth_to_a_millimetre() {
    let config = Simulate {
        lines: 40,
        truth: Some("*_truth.csv".to_owned()),
        sbet: Some("*.sbet".to_owned()),
        ..rich()
    };
    let (lines, files) = flown(&config);
    let trajectory = records(&files["simulated.sbet"]);
    assert!(lines.iter().all(|line| line.input.frame == Frame::Scanner && line.input.crs_wkt.is_none()));
    let map = TransverseMercator::new(WGS84, TransverseMercatorParameters::utm(33, true));
    let boresight = rotation_of_angles(config.boresight_deg.map(f64::to_radians));
    let truth = String::from_utf8(files["simulated_truth.csv"].clone()).unwrap();
    let (mut n, mut worst) = (0, 0.0f64);
    for row in truth.lines().skip(1) {
        let fields: Vec<&str> = row.split(',').collect();
        let number = |k: usize| fields[k].parse::<f64>().unwrap();
        let shot = number(0) as usize;
        let emission = &lines[shot / 400].emissions[shot % 400];
        assert_eq!(emission.origin_m, [0.0; 3]);
        let (place, attitude) = pose(&trajectory, emission.gps_time_s);
        let in_body = rotate(&boresight, emission.direction.map(|d| d * number(5)));
        let from_centre = core::array::from_fn(|axis| in_body[axis] + config.lever_arm_m[axis]);
        let in_ned = rotate(&attitude.ned_from_body(), from_centre);
        let offset = rotate(&ecef_from_ned(place.latitude_rad, place.longitude_rad), in_ned);
        let centre = WGS84.ecef_of(place);
        let point = WGS84.geodetic_of(core::array::from_fn(|axis| centre[axis] + offset[axis]));
        let (x, y) = map.project(point.latitude_rad, point.longitude_rad);
        let error = [x - number(8), y - number(9), point.height_m - number(10)];
        worst = worst.max(error.iter().map(|e| e * e).sum::<f64>().sqrt());
        n += 1;
    }
    assert!(n > 15_000 && worst < 1e-3, "{n} returns, the worst {worst} m off");
    println!("{n} returns, the worst {:.3} mm off: linear interpolation at 200 Hz", 1e3 * worst);
}

#[test]
fn a_trajectory_begins_before_the_flight_and_ends_after_it() {
    let config = Simulate {
        sbet: Some("*.out".to_owned()),
        pof: Some("*.pof".to_owned()),
        lines: 200,
        shots_per_line: 100,
        roll_deg: 1.0,
        ..bare()
    };
    let (lines, files) = flown(&config);
    let trajectory = records(&files["simulated.out"]);
    let steps = trajectory.windows(2).map(|pair| pair[1].time_s - pair[0].time_s);
    assert!(steps.into_iter().all(|step| (step - 0.005).abs() < 1e-9));
    let last_s = lines.last().and_then(|line| line.emissions.last()).unwrap().gps_time_s;
    assert_eq!(trajectory[0].time_s, 208_799.0);
    assert!(trajectory.last().unwrap().time_s > last_s + 0.9);
    // North from 47.828 N, 600 m above level ground of 400 m; the horizon of the start is straight.
    assert!((trajectory[200].latitude_rad.to_degrees() - 47.828_142_448_644).abs() < 1e-10);
    assert!((trajectory[200].height_m - 1000.0).abs() < 1e-6);
    assert!(trajectory.iter().all(|record| (record.wander_angle_rad - 0.25).abs() < 1e-15));

    // The other format holds the same, in degrees and with the longitude first.
    let pof = &files["simulated.pof"];
    let offset = u32::from_le_bytes(pof[31..35].try_into().unwrap()) as usize;
    assert_eq!(i64::from_le_bytes(pof[41..49].try_into().unwrap()), trajectory.len() as i64);
    assert_eq!(pof.len() - offset, 64 * trajectory.len());
    for (record, bytes) in trajectory.iter().zip(pof[offset..].chunks(64)) {
        let field = |k: usize| f64::from_le_bytes(bytes[8 * k..8 * k + 8].try_into().unwrap());
        assert_eq!(field(0), record.time_s);
        assert_eq!(field(1), record.longitude_rad.to_degrees());
        assert_eq!(field(2), record.latitude_rad.to_degrees());
        assert_eq!((field(3), field(4)), (record.height_m, record.roll_rad.to_degrees()));
        assert!((field(6).to_radians() - record.platform_heading_rad + 0.25).abs() < 1e-12);
    }
}

/// Without a trajectory the same scene is in map coordinates: level ground is level there.
#[test]
fn without_a_trajectory_beams_stand_in_the_map() {
    let config = Simulate { heading_deg: 90.0, roll_deg: 3.0, lever_arm_m: [1.0, 2.0, 3.0], ..bare() };
    let (lines, files) = flown(&Simulate { lines: 2, ..config });
    assert!(files.is_empty());
    for emission in lines.iter().flat_map(|line| &line.emissions) {
        let length = emission.direction.iter().map(|d| d * d).sum::<f64>();
        assert!((length - 1.0).abs() < 1e-13);
        // The lever arm's right is south of a flight to the east.
        assert!((emission.origin_m[1] - 5_299_998.0).abs() < 0.3, "{:?}", emission.origin_m);
    }
}
