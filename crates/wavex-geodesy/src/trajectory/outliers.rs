//! Records that contradict their neighbours.
//!
//! A record is an outlier if it differs from the line through its neighbours by more than an
//! acceleration of the vehicle and the noise of the trajectory explain, and its neighbours fit without
//! it. Stretches of equal positions inside a movement are outliers, too, and attitudes beyond the limits
//! of the vehicle.

use wavex_simd::statistics::median;

use super::Sample;
use super::plausibility::{MOST_PART, MotionLimits, wrapped_rad};
use crate::ellipsoid::WGS84;

/// Largest acceleration, m/s²: five times the acceleration of free fall.
pub const MOST_ACCELERATION_MPS2: f64 = 50.0;
/// Largest angular acceleration, rad/s²: 500 degrees/s².
pub const MOST_TURNING_RADPS2: f64 = 8.7;
/// Smallest deviation of a position that matters, m.
pub const LEAST_M: f64 = 1.0;
/// Smallest deviation of an angle that matters, rad: 1 degree.
pub const LEAST_RAD: f64 = 0.0175;
/// Smallest deviation, in medians of all: the noise of the trajectory.
const LEAST_MEDIANS: f64 = 8.0;
/// Most outliers in a row: a longer run is a step of the trajectory.
const PASSES: usize = 3;
/// Fewest records of a frozen stretch.
pub const FEWEST_FROZEN: usize = 10;
/// Smallest speed around a frozen stretch, m/s.
pub const LEAST_SPEED_MPS: f64 = 5.0;

/// What is wrong with a record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RecordFault {
    /// Its position.
    Position,
    /// Its roll, pitch or heading.
    Attitude,
    /// Its roll or pitch is beyond the limits of the vehicle.
    Limit,
    /// It repeats the position of the record before, although the vehicle moves.
    Frozen,
}

/// A record that contradicts its neighbours.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outlier {
    /// Index of the record.
    pub record: usize,
    /// Time, s.
    pub time_s: f64,
    /// What is wrong.
    pub fault: RecordFault,
    /// Deviation from its neighbours or limits, m or rad; 0 for a frozen record.
    pub deviation: f64,
}

/// Outliers of samples in order of time, by record.
///
/// More than 5 % of one kind are noise of the trajectory or a contradiction of the whole
/// ([`super::plausibility`]), not outliers; repeated positions are always. Records with times out of order
/// have none.
pub fn outliers(samples: &[Sample], limits: Option<&MotionLimits>) -> Vec<Outlier> {
    let is_ordered = samples.windows(2).all(|pair| pair[0].time_s < pair[1].time_s);
    if samples.len() < 4 || !is_ordered {
        return Vec::new();
    }
    let places_m: Vec<[f64; 3]> = samples.iter().map(|sample| WGS84.ecef_of(sample.place)).collect();
    let angles_rad: Vec<[f64; 3]> = samples
        .iter()
        .map(|sample| {
            let attitude = sample.attitude;
            [attitude.roll_rad, attitude.pitch_rad, attitude.heading_rad]
        })
        .collect();
    let times_s: Vec<f64> = samples.iter().map(|sample| sample.time_s).collect();
    let most = (MOST_PART * samples.len() as f64).max(1.0);
    let is_few = |found: &Vec<Outlier>| found.len() as f64 <= most;
    let kinds = [
        deviating(&times_s, &places_m, &POSITION),
        deviating(&times_s, &angles_rad, &ATTITUDE),
        limits.map_or(Vec::new(), |limits| beyond(samples, limits)),
    ];
    let mut found = kinds.into_iter().filter(is_few).flatten().collect::<Vec<_>>();
    found.extend(frozen(&times_s, &places_m));
    found.sort_by_key(|outlier| outlier.record);
    found.dedup_by_key(|outlier| outlier.record);
    found
}

/// Records with roll or pitch beyond the limits.
fn beyond(samples: &[Sample], limits: &MotionLimits) -> Vec<Outlier> {
    let excess_rad = |sample: &Sample| {
        let roll_rad = wrapped_rad(sample.attitude.roll_rad).abs() - limits.roll_rad;
        roll_rad.max(wrapped_rad(sample.attitude.pitch_rad).abs() - limits.pitch_rad)
    };
    let records = samples.iter().enumerate().map(|(record, sample)| Outlier {
        record,
        time_s: sample.time_s,
        fault: RecordFault::Limit,
        deviation: excess_rad(sample),
    });
    records.filter(|outlier| outlier.deviation > 0.0).collect()
}

/// A quantity and its limits.
struct LimitedQuantity {
    fault: RecordFault,
    most_acceleration: f64,
    least: f64,
    /// Difference of two values.
    difference: fn([f64; 3], [f64; 3]) -> [f64; 3],
}

const POSITION: LimitedQuantity = LimitedQuantity {
    fault: RecordFault::Position,
    most_acceleration: MOST_ACCELERATION_MPS2,
    least: LEAST_M,
    difference: |a, b| core::array::from_fn(|axis| a[axis] - b[axis]),
};
const ATTITUDE: LimitedQuantity = LimitedQuantity {
    fault: RecordFault::Attitude,
    most_acceleration: MOST_TURNING_RADPS2,
    least: LEAST_RAD,
    difference: |a, b| core::array::from_fn(|axis| wrapped_rad(a[axis] - b[axis])),
};

/// Outliers of one quantity, found and left out one by one.
fn deviating(times_s: &[f64], values: &[[f64; 3]], quantity: &LimitedQuantity) -> Vec<Outlier> {
    let mut kept: Vec<usize> = (0..times_s.len()).collect();
    let mut found = Vec::new();
    let mut noise = None;
    for _ in 0..PASSES {
        let deviations: Vec<[f64; 2]> =
            (0..kept.len()).map(|at| deviation(times_s, values, &kept, at, quantity)).collect();
        // The median of the first pass describes the sound records.
        let noise = *noise.get_or_insert_with(|| {
            LEAST_MEDIANS * median(deviations.iter().map(|of| of[0])).unwrap_or(f64::NAN)
        });
        let of = |at: usize| deviations.get(at).map_or(0.0, |of| of[0]);
        let is_outlier = |at: usize| {
            let [own, limit] = deviations[at];
            own > limit.max(noise) && own >= at.checked_sub(1).map_or(0.0, of) && own > of(at + 1)
        };
        let outliers: Vec<usize> = (0..kept.len()).filter(|&at| is_outlier(at)).collect();
        if outliers.is_empty() {
            break;
        }
        found.extend(outliers.iter().map(|&at| Outlier {
            record: kept[at],
            time_s: times_s[kept[at]],
            fault: quantity.fault,
            deviation: deviations[at][0],
        }));
        let mut at = 0;
        kept.retain(|_| {
            at += 1;
            outliers.binary_search(&(at - 1)).is_err()
        });
        if kept.len() < 4 {
            break;
        }
    }
    found
}

/// Deviation of a record from the line through its neighbours, and its limit.
///
/// For the first and last record: the smallest from the lines through two of the next three, one of which
/// may be an outlier itself.
fn deviation(
    times_s: &[f64],
    values: &[[f64; 3]],
    kept: &[usize],
    at: usize,
    quantity: &LimitedQuantity,
) -> [f64; 2] {
    let from_line = |[a, b]: [usize; 2]| {
        let [a, b, record] = [kept[a], kept[b], kept[at]];
        let part = (times_s[record] - times_s[a]) / (times_s[b] - times_s[a]);
        let along = (quantity.difference)(values[b], values[a]);
        let own = (quantity.difference)(values[record], values[a]);
        let square: f64 = (0..3).map(|axis| (own[axis] - part * along[axis]).powi(2)).sum();
        let steps = (times_s[record] - times_s[a]).abs() * (times_s[b] - times_s[record]).abs();
        [square.sqrt(), quantity.least.max(0.5 * quantity.most_acceleration * steps)]
    };
    let smallest = |[a, b, c]: [usize; 3]| {
        let lines = [[a, b], [a, c], [b, c]].map(from_line);
        lines.into_iter().fold([f64::INFINITY; 2], |least, of| if of[0] < least[0] { of } else { least })
    };
    match at {
        0 => smallest([1, 2, 3]),
        _ if at + 1 == kept.len() => smallest([at - 3, at - 2, at - 1]),
        _ => from_line([at - 1, at + 1]),
    }
}

/// Records that repeat the position of the one before, in the middle of a movement.
fn frozen(times_s: &[f64], places_m: &[[f64; 3]]) -> Vec<Outlier> {
    let speed_mps = |a: usize, b: usize| {
        let square: f64 = (0..3).map(|axis| (places_m[b][axis] - places_m[a][axis]).powi(2)).sum();
        square.sqrt() / (times_s[b] - times_s[a])
    };
    let mut found = Vec::new();
    let mut first = 0;
    while first + 1 < places_m.len() {
        let same = places_m[first..].iter().take_while(|place| **place == places_m[first]).count();
        let next = first + same;
        let is_moving = first > 0
            && next + 1 < places_m.len()
            && speed_mps(first - 1, first) > LEAST_SPEED_MPS
            && speed_mps(next, next + 1) > LEAST_SPEED_MPS;
        if same >= FEWEST_FROZEN && is_moving {
            let of = |record| Outlier {
                record,
                time_s: times_s[record],
                fault: RecordFault::Frozen,
                deviation: 0.0,
            };
            found.extend((first + 1..next).map(of));
        }
        first = next;
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ellipsoid::Geodetic;
    use crate::frames::Attitude;

    /// 60 m/s to the north at 200 Hz, or the given step.
    fn flight(records: usize, step_s: f64) -> Vec<Sample> {
        let sample = |k: usize| {
            let time_s = 1000.0 + step_s * k as f64;
            Sample {
                time_s,
                place: Geodetic {
                    latitude_rad: 0.8 + 60.0 * step_s * k as f64 / 6.37e6,
                    longitude_rad: 0.2,
                    height_m: 1000.0 + 0.01 * (k as f64).sin(),
                },
                attitude: Attitude {
                    roll_rad: 0.05 * (time_s).sin(),
                    pitch_rad: 0.03,
                    heading_rad: 0.001 * (k as f64).sin(),
                },
            }
        };
        (0..records).map(sample).collect()
    }

    fn found(change: impl Fn(&mut Vec<Sample>), step_s: f64) -> Vec<(usize, RecordFault)> {
        let mut samples = flight(1000, step_s);
        change(&mut samples);
        outliers(&samples, Some(&MotionLimits::AIRPLANE))
            .iter()
            .map(|outlier| (outlier.record, outlier.fault))
            .collect()
    }

    #[test]
    fn single_records_far_from_their_neighbours_are_outliers() {
        for step_s in [0.005, 1.0] {
            assert_eq!(found(|_| {}, step_s), []);
            assert_eq!(
                found(|s| s[500].place.latitude_rad += 0.0175, step_s),
                [(500, RecordFault::Position)]
            );
            assert_eq!(found(|s| s[500].place.height_m += 100.0, step_s), [(500, RecordFault::Position)]);
            assert_eq!(
                found(
                    |s| s[0].place = Geodetic { latitude_rad: 0.0, longitude_rad: 0.0, height_m: 0.0 },
                    step_s
                ),
                [(0, RecordFault::Position)]
            );
            assert_eq!(found(|s| s[999].place.height_m += 500.0, step_s), [(999, RecordFault::Position)]);
        }
        assert_eq!(found(|s| s[500].attitude.roll_rad += 1.57, 0.005), [(500, RecordFault::Attitude)]);
        let bank = |s: &mut Vec<Sample>| s[400..420].iter_mut().for_each(|s| s.attitude.roll_rad = 1.57);
        let banked: Vec<usize> = found(bank, 0.005).iter().map(|of| of.0).collect();
        assert!((400..420).all(|record| banked.contains(&record)) && banked.len() <= 26, "{banked:?}");
        for step_s in [0.005, 1.0] {
            assert_eq!(found(|s| s[1].place.height_m += 500.0, step_s), [(1, RecordFault::Position)]);
            assert_eq!(found(|s| s[997].place.height_m += 500.0, step_s), [(997, RecordFault::Position)]);
        }
        assert_eq!(
            found(
                |s| s.iter_mut().for_each(|s| s.attitude.heading_rad =
                    (s.attitude.heading_rad - 1e-4).rem_euclid(core::f64::consts::TAU)),
                0.005
            ),
            []
        );
    }

    #[test]
    fn repeated_positions_of_a_moving_vehicle_are_outliers() {
        let freeze = |s: &mut Vec<Sample>| (401..421).for_each(|k| s[k].place = s[400].place);
        let frozen = found(freeze, 0.005);
        assert!(frozen.len() >= 20 && frozen.contains(&(410, RecordFault::Frozen)), "{frozen:?}");
        let stand = |s: &mut Vec<Sample>| {
            let place = s[0].place;
            s.iter_mut().for_each(|s| s.place = place)
        };
        assert_eq!(found(stand, 0.005), [], "on the ground");
    }

    #[test]
    fn a_noisy_trajectory_is_as_it_is() {
        let noise = |s: &mut Vec<Sample>| {
            s.iter_mut()
                .enumerate()
                .for_each(|(k, s)| s.place.height_m += 3.0 * ((k * 7919 % 101) as f64 / 50.0 - 1.0));
        };
        assert_eq!(found(noise, 0.1), []);
    }
}
