//! Trajectories and their accuracies.

use wavex_formats::trajectory::sbet::SbetRecord;
use wavex_formats::trajectory::{self, Angles, FileTime, Options};
use wavex_geodesy::ellipsoid::Geodetic;

use super::{Files, parts};

/// Length of a record of SOL, bytes.
const SOL_RECORD: usize = 184;
/// Length of a record of SBET, bytes.
const SBET_RECORD: usize = 136;

/// A POF file, and its POQ as second part.
pub fn pof(bytes: &[u8]) {
    let parts = parts(bytes);
    let place = Files::with(&[("a.pof", parts[0])]);
    if let Some(accuracy) = parts.get(1) {
        place.write("a.poq", accuracy);
    }
    read(&place, "a.pof", &Options::default());
    read(&place, "a.pof", &Options { time: Some(FileTime::Adjusted), ..Options::default() });
}

/// A TRJ file.
pub fn trj(bytes: &[u8]) {
    read(&Files::with(&[("a.trj", bytes)]), "a.trj", &Options::default());
}

/// A SOL file, with the check bytes that it has and with those that it should have.
pub fn sol(bytes: &[u8]) {
    read(&Files::with(&[("a.sol", bytes)]), "a.sol", &Options::default());
    let mut sound = bytes.to_vec();
    for record in sound.chunks_exact_mut(SOL_RECORD) {
        record[34] = record[..34].iter().fold(0, |check, byte| check ^ byte);
    }
    read(&Files::with(&[("a.sol", &sound)]), "a.sol", &Options::default());
}

/// An SBET file, and its smrmsg as second part; records are the same after writing.
pub fn sbet(bytes: &[u8]) {
    let parts = parts(bytes);
    let place = Files::with(&[("a.out", parts[0])]);
    let accuracy = parts.get(1).map(|bytes| place.write("smrmsg_a.out", bytes));
    read(&place, "a.out", &Options { accuracy, ..Options::default() });
    for record in parts[0].as_chunks::<SBET_RECORD>().0 {
        let decoded = SbetRecord::decode(record);
        assert_eq!(&decoded.encode()[..8], &record[..8]);
        let again = SbetRecord::decode(&decoded.encode());
        assert_eq!(format!("{again:?}"), format!("{decoded:?}"));
    }
}

/// A text trajectory, and the letters of its columns as first part.
pub fn trajectory_text(bytes: &[u8]) {
    let parts = parts(bytes);
    let Some(text) = parts.get(1) else { return };
    let columns = String::from_utf8_lossy(parts[0]).into_owned();
    let place = Files::with(&[("a.txt", text)]);
    for angles in [Angles::Degrees, Angles::Radians] {
        let options = Options { columns: Some(columns.clone()), angles: Some(angles), ..Options::default() };
        read(&place, "a.txt", &options);
    }
}

/// A file of accuracies for a fixed trajectory, as POQ or smrmsg.
pub fn accuracy(bytes: &[u8]) {
    let record = |k: i32| SbetRecord {
        time_s: 300_000.0 + f64::from(k),
        latitude_rad: 0.84 + f64::from(k) * 1e-6,
        longitude_rad: 0.26,
        height_m: 900.0,
        ..SbetRecord::default()
    };
    let sbet: Vec<u8> = (0..20).flat_map(|k| record(k).encode()).collect();
    let place = Files::with(&[("a.out", &sbet), ("a.accuracy", bytes)]);
    let accuracy = Some(place.path("a.accuracy"));
    read(&place, "a.out", &Options { accuracy, ..Options::default() });
}

/// Reads a trajectory and interpolates it.
fn read(place: &Files, name: &str, options: &Options) {
    let Ok(recorded) = trajectory::read(&place.path(name), options) else { return };
    let times = recorded.times();
    assert!(recorded.records.times_s().all(f64::is_finite), "a time is no number");
    let unproject = |[x, y, z]: [f64; 3]| {
        let is_near = x.abs() < 1e7 && y.abs() < 1e7;
        let place = Geodetic { latitude_rad: y / 1e7, longitude_rad: x / 1e7, height_m: z };
        if is_near { Ok(place) } else { Err("too far".to_owned()) }
    };
    let Ok(trajectory) = recorded.into_trajectory(Some(&unproject)) else { return };
    let [first_s, last_s] = trajectory.span_s();
    assert!(first_s <= last_s && times.first_s.is_finite());
    assert!(trajectory.samples().is_sorted_by(|a, b| a.time_s < b.time_s));
    let _ = (trajectory.median_step_s(), trajectory.longest_bridged_s(), trajectory.gaps().len());
    let mut poses = trajectory.poses();
    for part in [0.0, 0.25, 0.5, 0.9999, 1.0] {
        let time_s = first_s + part * (last_s - first_s);
        let pose = trajectory.pose(time_s);
        assert_eq!(format!("{pose:?}"), format!("{:?}", poses.at(time_s)), "at {time_s} s");
    }
    assert!(trajectory.pose(f64::NAN).is_none());
}
