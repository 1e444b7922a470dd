//! Flights, and files of them in each format.

use super::*;

/// Date of the flights, a Tuesday, and its midnight.
pub(super) const DATE: [u16; 3] = [2025, 5, 6];
pub(super) const MIDNIGHT_S: f64 = 2365.0 * WEEK_S + 2.0 * DAY_S - 1e9;

/// Creates a flight with records every 0.5 s from this time on.
pub(super) fn flight(first_s: f64, records: u32) -> Vec<Sample> {
    let sample = |k: u32| {
        let since_s = 0.5 * f64::from(k);
        let place = Geodetic {
            latitude_rad: 0.83 + 1e-5 * since_s,
            longitude_rad: 0.21 - 2e-5 * since_s,
            height_m: 900.0 + (0.3 * since_s).sin(),
        };
        let attitude = Attitude {
            roll_rad: 0.05 * since_s.sin(),
            pitch_rad: 0.03 * since_s.cos(),
            heading_rad: -1.1 + 0.01 * since_s,
        };
        Sample { time_s: first_s + since_s, place, attitude }
    };
    (0..records).map(sample).collect()
}

pub(super) fn sbet(samples: &[Sample], clock: impl Fn(f64) -> f64) -> Vec<u8> {
    let record = |sample: &Sample| {
        let record = SbetRecord {
            time_s: clock(sample.time_s),
            latitude_rad: sample.place.latitude_rad,
            longitude_rad: sample.place.longitude_rad,
            height_m: sample.place.height_m,
            roll_rad: sample.attitude.roll_rad,
            pitch_rad: sample.attitude.pitch_rad,
            platform_heading_rad: sample.attitude.heading_rad + 0.25,
            wander_angle_rad: 0.25,
            ..SbetRecord::default()
        };
        record.encode()
    };
    samples.iter().flat_map(record).collect()
}

pub(super) fn pof(samples: &[Sample], time_unit: u8, time_info: u8, clock: impl Fn(f64) -> f64) -> Vec<u8> {
    let records = samples.len() as i64;
    let header = PofHeader { date: DATE, records, time_unit, time_info, ..PofHeader::default() };
    let record = |sample: &Sample| {
        let record = PofRecord {
            time_s: clock(sample.time_s),
            longitude_deg: sample.place.longitude_rad.to_degrees(),
            latitude_deg: sample.place.latitude_rad.to_degrees(),
            altitude_m: sample.place.height_m,
            roll_deg: sample.attitude.roll_rad.to_degrees(),
            pitch_deg: sample.attitude.pitch_rad.to_degrees(),
            yaw_deg: sample.attitude.heading_rad.to_degrees(),
            distance_m: 7.0,
        };
        record.encode()
    };
    header.encode().into_iter().chain(samples.iter().flat_map(record)).collect()
}

pub(super) fn sol(samples: &[Sample]) -> Vec<u8> {
    let record = |sample: &Sample| {
        let since_1980_s = sample.time_s + 1e9;
        let week = (since_1980_s / WEEK_S).floor();
        sol::tests::made(week as u16, since_1980_s - week * WEEK_S, sample)
    };
    samples.iter().flat_map(record).collect()
}

pub(super) fn utm33() -> TransverseMercator {
    TransverseMercator::new(WGS84, TransverseMercatorParameters::utm(33, true))
}

pub(super) fn unproject(place: [f64; 3]) -> std::result::Result<Geodetic, String> {
    let (latitude_rad, longitude_rad) = utm33().unproject(place[0], place[1]);
    Ok(Geodetic { latitude_rad, longitude_rad, height_m: place[2] })
}

/// Grid convergence follows from the direction of a meridian in the projection.
pub(super) fn trj(samples: &[Sample], clock: impl Fn(f64) -> f64) -> Vec<u8> {
    let map = utm33();
    let sample = |sample: &Sample| {
        let Geodetic { latitude_rad, longitude_rad, height_m } = sample.place;
        let (x, y) = map.project(latitude_rad, longitude_rad);
        let [(east, north), (west, south)] =
            [1e-6, -1e-6].map(|step_rad| map.project(latitude_rad + step_rad, longitude_rad));
        let convergence_rad = (east - west).atan2(north - south);
        let heading_rad = sample.attitude.heading_rad + convergence_rad;
        let attitude = Attitude { heading_rad, ..sample.attitude };
        MapSample { time_s: clock(sample.time_s), place: [x, y, height_m], attitude }
    };
    trj::tests::made(&samples.iter().map(sample).collect::<Vec<_>>())
}

pub(super) fn text(samples: &[Sample], clock: impl Fn(f64) -> f64) -> Vec<u8> {
    let mut text = "Time Latitude Longitude Height\n(s) (deg) (deg) (m)\n\n".to_owned();
    for Sample { time_s, place, attitude } in samples {
        let angles = [attitude.roll_rad, attitude.pitch_rad, attitude.heading_rad].map(f64::to_degrees);
        let [longitude, latitude] = [place.longitude_rad, place.latitude_rad].map(f64::to_degrees);
        let [roll, pitch, heading] = angles;
        let time_s = clock(*time_s);
        text += &format!("{time_s} {latitude} {longitude} ok {} {roll} {pitch} {heading}\n", place.height_m);
    }
    text.into_bytes()
}

/// Temporary folder of files; messages omit its path.
pub(super) struct Folder(tempfile::TempDir);

impl Folder {
    pub(super) fn with(files: &[(&str, &[u8])]) -> Folder {
        let folder = Folder(tempfile::tempdir().unwrap());
        files.iter().for_each(|(name, bytes)| fs::write(folder.path(name), bytes).unwrap());
        folder
    }

    pub(super) fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    pub(super) fn read(&self, name: &str, options: &Options) -> std::result::Result<Recorded, String> {
        read(&self.path(name), options).map_err(|error| self.message(&error))
    }

    pub(super) fn message(&self, error: &Error) -> String {
        error.to_string().replace(&format!("{}/", self.0.path().display()), "")
    }

    /// Returns the trajectory of a valid file.
    pub(super) fn flown(&self, name: &str, options: &Options) -> Trajectory {
        self.read(name, options).unwrap().into_trajectory(Some(&unproject)).unwrap()
    }
}

pub(super) fn columns(columns: &str) -> Options {
    Options { columns: Some(columns.to_owned()), ..Options::default() }
}

pub(super) fn read_bytes(bytes: &[u8], options: &Options) -> std::result::Result<Recorded, String> {
    Folder::with(&[("t.dat", bytes)]).read("t.dat", options)
}

pub(super) fn week(time_s: f64) -> f64 {
    (time_s + 1e9).rem_euclid(WEEK_S)
}

pub(super) fn day(time_s: f64) -> f64 {
    (time_s + 1e9).rem_euclid(DAY_S)
}

/// Returns the largest differences of position, m, and of attitude, rad, at the records of a
/// flight.
pub(super) fn apart(trajectory: &Trajectory, flight: &[Sample], shift_s: f64) -> [f64; 2] {
    let mut worst = [0.0f64; 2];
    for sample in flight {
        let pose = trajectory.pose(sample.time_s + shift_s).unwrap();
        let truth =
            Trajectory::new(vec![*sample, Sample { time_s: sample.time_s + 1.0, ..*sample }]).unwrap();
        let truth = truth.pose(sample.time_s).unwrap();
        let place = pose.origin_in_ecef_m.iter().zip(truth.origin_in_ecef_m);
        let turn = pose.ecef_from_body.as_flattened().iter().zip(truth.ecef_from_body.as_flattened());
        worst[0] = place.map(|(a, b)| (a - b).abs()).fold(worst[0], f64::max);
        worst[1] = turn.map(|(a, b)| (a - b).abs()).fold(worst[1], f64::max);
    }
    worst
}
