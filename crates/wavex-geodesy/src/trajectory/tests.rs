use core::f64::consts::{PI, TAU};

use super::super::frames::{inverse, rotate};
use super::*;
use proptest::prelude::*;

/// A flight in closed form: circular or straight, climbing, with sways in all angles and shakes in
/// all directions.
#[derive(Clone, Copy)]
struct Flight {
    start: Geodetic,
    heading_rad: f64,
    turn_rad_per_s: f64,
    bank_rad: f64,
    /// Amplitude of a shake at 1 Hz, m.
    shake_m: f64,
    /// Amplitude of the sways, rad.
    sway_rad: f64,
    /// Frequency of the fastest sway, Hz.
    sway_hz: f64,
}

const SPEED_MPS: f64 = 75.0;

impl Flight {
    fn at(latitude_deg: f64, longitude_deg: f64, heading_deg: f64) -> Flight {
        Flight {
            start: Geodetic {
                latitude_rad: latitude_deg.to_radians(),
                longitude_rad: longitude_deg.to_radians(),
                height_m: 1500.0,
            },
            heading_rad: heading_deg.to_radians(),
            turn_rad_per_s: 0.0,
            bank_rad: 0.0,
            shake_m: 0.1,
            sway_rad: 5f64.to_radians(),
            sway_hz: 0.5,
        }
    }

    fn sample(&self, time_s: f64) -> Sample {
        let shake = |hz: f64| self.shake_m * (TAU * hz * time_s + hz).sin();
        let sway = |share: f64| {
            self.sway_rad
                * (0.7 * (0.38 * share * TAU * self.sway_hz * time_s).sin()
                    + 0.3 * (share * TAU * self.sway_hz * time_s + 1.0).sin())
        };
        let course_rad = self.heading_rad + self.turn_rad_per_s * time_s;
        let [north_m, east_m] = if self.turn_rad_per_s == 0.0 {
            [SPEED_MPS * time_s * course_rad.cos(), SPEED_MPS * time_s * course_rad.sin()]
        } else {
            let radius_m = SPEED_MPS / self.turn_rad_per_s;
            [radius_m * course_rad.sin(), -radius_m * course_rad.cos()]
        };
        let wrapped = |angle: f64| angle - TAU * (angle / TAU).round();
        let east = (east_m + shake(0.9)) / (6.4e6 * self.start.latitude_rad.cos());
        Sample {
            time_s,
            place: Geodetic {
                latitude_rad: self.start.latitude_rad + (north_m + shake(1.0)) / 6.4e6,
                longitude_rad: wrapped(self.start.longitude_rad + east),
                height_m: self.start.height_m + 20.0 * (TAU * 0.05 * time_s).sin() + shake(1.1),
            },
            attitude: Attitude {
                roll_rad: wrapped(self.bank_rad + sway(1.0)),
                pitch_rad: 0.6 * sway(0.73),
                heading_rad: wrapped(course_rad + 0.4 * sway(0.41)),
            },
        }
    }

    fn flown(&self, times_s: impl Iterator<Item = f64>) -> Trajectory {
        Trajectory::new(times_s.map(|time_s| self.sample(time_s)).collect()).unwrap()
    }

    /// Largest errors of position, m, and attitude, degrees, between records at this rate.
    fn worst(&self, rate_hz: f64, seconds: f64) -> [f64; 2] {
        let trajectory = self.flown((0..(seconds * rate_hz) as u32).map(|k| f64::from(k) / rate_hz));
        let [first_s, last_s] = trajectory.span_s();
        let mut worst = [0.0f64; 2];
        for k in 0..20_000 {
            let time_s = first_s + (last_s - first_s) * f64::from(k) / 20_000.0;
            let [position_m, angle_rad] = apart(&trajectory.pose(time_s).unwrap(), &self.sample(time_s));
            worst = [worst[0].max(position_m), worst[1].max(angle_rad.to_degrees())];
        }
        worst
    }
}

/// Distance of a pose from a sample, m, and the angle between them, rad.
fn apart(pose: &Pose, sample: &Sample) -> [f64; 2] {
    let truth = WGS84.ecef_of(sample.place);
    let offset = (0..3).map(|axis| (pose.origin_in_ecef_m[axis] - truth[axis]).powi(2)).sum::<f64>();
    let place = sample.place;
    let ecef_from_body =
        then(&sample.attitude.ned_from_body(), &ecef_from_ned(place.latitude_rad, place.longitude_rad));
    let squares = pose.ecef_from_body.as_flattened().iter().zip(ecef_from_body.as_flattened());
    [offset.sqrt(), (0.5 * squares.map(|(a, b)| (a - b).powi(2)).sum::<f64>()).sqrt()]
}

#[test]
fn poses_between_records_are_those_of_the_flight() {
    let turning = Flight {
        turn_rad_per_s: 4f64.to_radians(),
        bank_rad: 25f64.to_radians(),
        ..Flight::at(48.0, 11.0, 70.0)
    };
    let lively = Flight { sway_hz: 1.5, shake_m: 0.3, ..turning };
    // Rate, flight, bounds of position in m and of attitude in degrees.
    let cases = [
        ("straight on, 200 Hz", 200.0, Flight::at(48.0, 11.0, 70.0), 1e-6, 1e-6),
        ("straight on, 50 Hz", 50.0, Flight::at(48.0, 11.0, 70.0), 2e-5, 2e-5),
        ("turning, 200 Hz", 200.0, turning, 1e-6, 1e-6),
        ("turning, 50 Hz", 50.0, turning, 2e-5, 2e-5),
        ("lively, 200 Hz", 200.0, lively, 1e-6, 1e-5),
        ("lively, 50 Hz", 50.0, lively, 1e-4, 1e-3),
        ("lively, 10 Hz", 10.0, lively, 1e-2, 0.1),
    ];
    for (name, rate_hz, flight, most_m, most_deg) in cases {
        let [position_m, angle_deg] = flight.worst(rate_hz, 60.0);
        println!("{name}: {:.5} mm, {angle_deg:.2e} degrees", 1e3 * position_m);
        assert!(position_m < most_m && angle_deg < most_deg, "{name}: {position_m} m, {angle_deg} degrees");
    }
}

/// Across the 180-degree meridian, across headings of 360 and 180 degrees, near a pole, and upside
/// down.
#[test]
fn attitudes_near_singularities_are_interpolated() {
    let flights = [
        Flight::at(-17.0, 179.9999, 90.0),
        Flight::at(52.0, 5.0, 0.0),
        Flight::at(52.0, 5.0, 180.0),
        Flight::at(89.98, 0.0, 10.0),
        Flight { bank_rad: PI, ..Flight::at(-60.0, -180.0, 270.0) },
    ];
    for flight in flights {
        let [position_m, angle_deg] = flight.worst(200.0, 20.0);
        assert!(position_m < 1e-5 && angle_deg < 1e-5, "{position_m} m, {angle_deg} degrees");
    }
}

#[test]
fn poses_at_records_equal_the_records() {
    let flight = Flight::at(48.0, 11.0, 70.0);
    let trajectory = flight.flown((0..50).map(|k| 0.01 * f64::from(k)));
    for sample in trajectory.samples() {
        let [position_m, angle_rad] = apart(&trajectory.pose(sample.time_s).unwrap(), sample);
        assert!(position_m < 2e-9 && angle_rad < 2e-15, "{position_m} m, {angle_rad}");
    }
    let nose = trajectory.pose(0.1).unwrap();
    let down = rotate(&nose.ecef_from_body, [0.0, 0.0, 1.0]);
    assert!(down[0] < -0.6 && down[2] < -0.6, "down is to the earth's centre: {down:?}");
}

#[test]
fn nothing_is_extrapolated() {
    let trajectory = Flight::at(48.0, 11.0, 70.0).flown((0..5).map(|k| 100.0 + f64::from(k)));
    assert_eq!(trajectory.span_s(), [100.0, 104.0]);
    let is_there = [99.999, 100.0, 102.5, 104.0, 104.001, f64::NAN].map(|t| trajectory.pose(t).is_some());
    assert_eq!(is_there, [false, true, true, true, false, false]);
}

#[test]
fn two_records_are_a_straight_line() {
    let flight = Flight { shake_m: 0.0, sway_rad: 0.0, ..Flight::at(48.0, 11.0, 70.0) };
    let trajectory = flight.flown([0.0, 0.1].into_iter());
    let [position_m, angle_rad] = apart(&trajectory.pose(0.03).unwrap(), &flight.sample(0.03));
    assert!(position_m < 2e-3 && angle_rad < 1e-6, "{position_m} m, {angle_rad}");
}

#[test]
fn gaps_are_listed_and_short_ones_bridged() {
    let flight = Flight { sway_rad: 3f64.to_radians(), ..Flight::at(48.0, 11.0, 70.0) };
    // 100 Hz without the records from 1.00 to 1.17 s and from 3.00 to 4.99 s.
    let missing = |k: &i32| !(100..118).contains(k) && !(300..500).contains(k);
    let trajectory = flight.flown((0..800).filter(missing).map(|k| 0.01 * f64::from(k)));
    let gaps: Vec<(usize, bool)> = trajectory.gaps().iter().map(|gap| (gap.record, gap.is_bridged)).collect();
    assert_eq!(gaps, [(99, true), (281, false)]);
    assert!((trajectory.gaps()[0].length_s() - 0.19).abs() < 1e-12);
    assert_eq!(trajectory.gaps()[1].between_s, [2.99, 5.0]);
    assert!((trajectory.median_step_s() - 0.01).abs() < 1e-12);
    assert_eq!(trajectory.longest_bridged_s(), 0.2);
    for k in 0..=100 {
        let time_s = 0.99 + 0.0019 * f64::from(k);
        let [position_m, angle_rad] = apart(&trajectory.pose(time_s).unwrap(), &flight.sample(time_s));
        assert!(position_m < 1e-3 && angle_rad.to_degrees() < 1.2e-3, "{position_m} m, {angle_rad}");
    }
    let is_there = [2.99, 2.991, 4.0, 4.999, 5.0].map(|t| trajectory.pose(t).is_some());
    assert_eq!(is_there, [true, false, false, false, true]);
    for time_s in [2.99, 2.985, 5.0, 5.005] {
        let [position_m, angle_rad] = apart(&trajectory.pose(time_s).unwrap(), &flight.sample(time_s));
        assert!(position_m < 1e-5 && angle_rad.to_degrees() < 1e-4, "{position_m} m, {angle_rad}");
    }
}

#[test]
fn a_single_lost_record_is_no_gap() {
    let trajectory =
        Flight::at(48.0, 11.0, 70.0).flown((0..99).filter(|&k| k != 7).map(|k| 0.005 * f64::from(k)));
    assert_eq!(trajectory.gaps(), []);
}

/// A slow trajectory has no gaps merely because its steps are long.
#[test]
fn gaps_are_relative_to_the_median_step() {
    let trajectory =
        Flight::at(48.0, 11.0, 70.0).flown([0, 1, 2, 3, 8, 9, 10, 11, 17, 18].into_iter().map(f64::from));
    assert_eq!(trajectory.gaps().iter().map(|gap| gap.is_bridged).collect::<Vec<_>>(), [true, false]);
    assert!(trajectory.pose(5.5).is_some() && trajectory.pose(14.0).is_none());
}

/// A record of a second system 1 µs and 1 mm away from another: its "velocity" of 1 km/s is
/// ignored.
#[test]
fn nearly_coincident_records_do_not_disturb_neighbours() {
    let flight = Flight { shake_m: 0.0, sway_rad: 0.0, ..Flight::at(48.0, 11.0, 70.0) };
    let mut samples: Vec<Sample> = (0..20).map(|k| flight.sample(0.005 * f64::from(k))).collect();
    let mut duplicate = flight.sample(0.05 + 1e-6);
    duplicate.place.height_m += 1e-3;
    samples.insert(11, duplicate);
    let trajectory = Trajectory::new(samples).unwrap();
    for k in 0..=1000 {
        let time_s = 0.045 + 1e-5 * f64::from(k);
        let [position_m, _] = apart(&trajectory.pose(time_s).unwrap(), &flight.sample(time_s));
        assert!(position_m < 1.3e-3, "{position_m} m at {time_s}");
    }
}

#[test]
fn accuracies_are_interpolated_linearly() {
    let accuracy = |k: f64| Accuracy { position_sd_m: [k, 2.0 * k, 3.0 * k], attitude_sd_rad: [0.0, k, 5.0] };
    let samples = [(10.0, 1.0), (11.0, 2.0), (13.0, 4.0)];
    let samples = samples.map(|(time_s, k)| AccuracySample { time_s, accuracy: accuracy(k) });
    let trajectory = Flight::at(48.0, 11.0, 70.0).flown((0..20).map(f64::from));
    assert_eq!(trajectory.pose(10.0).unwrap().accuracy, None);
    let trajectory = trajectory.with_accuracies(samples.to_vec()).unwrap();
    let found = [10.0, 10.5, 12.0, 13.0].map(|t| trajectory.pose(t).unwrap().accuracy);
    assert_eq!(found, [1.0, 1.5, 3.0, 4.0].map(|k| Some(accuracy(k))));
    assert_eq!([9.9, 13.1].map(|t| trajectory.pose(t).unwrap().accuracy), [None; 2]);
}

#[test]
fn invalid_records_are_errors() {
    type Change = fn(&mut Vec<Sample>);
    let flight = Flight::at(48.0, 11.0, 70.0);
    let problem = |change: Change| {
        let mut samples: Vec<Sample> = (0..6).map(|k| flight.sample(0.5 * f64::from(k))).collect();
        change(&mut samples);
        let problem = Trajectory::new(samples).unwrap_err();
        (problem.record(), problem.to_string())
    };
    let cases: [(Change, Option<usize>, &str); 6] = [
        (|samples| samples.truncate(1), None, "1 record(s): at least two are needed"),
        (|samples| samples[2].place.height_m = f64::NAN, Some(2), "record 3: its height is NaN"),
        (|samples| samples[0].place.latitude_rad = -2.0, Some(0), "record 1: its latitude is -2"),
        (|samples| samples.swap(1, 2), Some(2), "record 3: its time 0.5 s is before the 1 s of record 2"),
        (
            |samples| samples.reverse(),
            Some(1),
            "record 2: its time 2 s is before the 2.5 s of record 1 (and 4 more like this)",
        ),
        (|samples| samples[4].time_s = 1.5, Some(4), "records 4 and 5 have the same time 1.5 s"),
    ];
    for (change, record, message) in cases {
        assert_eq!(problem(change), (record, message.to_owned()));
    }
    assert_eq!(
        TrajectoryError::TooMany { count: 5_000_000_000 }.to_string(),
        "5000000000 records: at most 4294967295 are supported"
    );
}

#[test]
fn invalid_accuracies_are_errors() {
    let trajectory = Flight::at(48.0, 11.0, 70.0).flown((0..3).map(f64::from));
    let mut samples = vec![AccuracySample { time_s: 0.0, accuracy: Accuracy::default() }; 2];
    samples[1].time_s = 1.0;
    samples[1].accuracy.attitude_sd_rad[2] = -1.0;
    let problem = trajectory.clone().with_accuracies(samples.clone()).unwrap_err();
    assert_eq!(problem.to_string(), "record 2: its standard deviation of the heading is -1");
    samples[1] = samples[0];
    let problem = trajectory.with_accuracies(samples).unwrap_err();
    assert_eq!(problem, TrajectoryError::Duplicate { record: 1, time_s: 0.0, more: 0 });
}

/// In any order of times, at records, in gaps that are not interpolated, and outside the span.
#[test]
fn sequential_poses_equal_single_poses() {
    let records = (0..40).chain(600..640).chain(660..700).map(|k| f64::from(k) / 100.0);
    let trajectory = Flight::at(48.0, 11.0, 70.0).flown(records);
    let mut poses = trajectory.poses();
    let forth = (-20..1500).map(|k| f64::from(k) / 200.0);
    let back = (-20..1500).rev().step_by(7).map(|k| f64::from(k) / 200.0);
    let mut found = 0;
    for time_s in forth.chain(back) {
        let pose = poses.at(time_s);
        found += usize::from(pose.is_some());
        assert_eq!(pose, trajectory.pose(time_s), "{time_s}");
    }
    assert!((200..1700).contains(&found), "{found}");
}

proptest! {
    /// For any records, a pose inside the span is finite, and its rotation is valid.
    #[test]
    fn poses_are_finite_and_rotations(
        steps in proptest::collection::vec(1e-6..0.3f64, 1..30),
        angles in proptest::collection::vec(-3.1..3.1f64, 31),
        part in 0.0..=1.0f64,
    ) {
        let mut time_s = 0.0;
        let mut samples = Vec::new();
        for (k, step) in steps.iter().chain([&1.0]).enumerate() {
            let [a, b] = [angles[k], angles[k / 2]];
            samples.push(Sample {
                time_s,
                place: Geodetic { latitude_rad: 0.5 * a, longitude_rad: b, height_m: 100.0 * a },
                attitude: Attitude { roll_rad: a, pitch_rad: 0.5 * b, heading_rad: a - b },
            });
            time_s += step;
        }
        let trajectory = Trajectory::new(samples).unwrap();
        let [first_s, last_s] = trajectory.span_s();
        let time_s = (first_s + part * (last_s - first_s)).min(last_s);
        let in_gap = |gap: &Gap| !gap.is_bridged && gap.between_s[0] < time_s && time_s < gap.between_s[1];
        match trajectory.pose(time_s) {
            Some(pose) => {
                prop_assert!(pose.origin_in_ecef_m.iter().all(|x| x.is_finite()));
                let unit = then(&pose.ecef_from_body, &inverse(&pose.ecef_from_body));
                let off = |(a, b): (&f64, &f64)| (a - b).abs() < 1e-14;
                prop_assert!(unit.as_flattened().iter().zip(super::super::frames::IDENTITY.as_flattened()).all(off));
            }
            None => prop_assert!(trajectory.gaps().iter().any(in_gap)),
        }
    }
}
