//! Attitude, speed and height of the flight during the recording.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::plot::extent;
use wavex_geodesy::ellipsoid::WGS84;
use wavex_geodesy::trajectory::{Sample, Trajectory};
use wavex_line::stage::packed;

/// Flight during the recording, from the records of the trajectory.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct Flight {
    /// Number of records during the recording.
    pub records: u64,
    /// Number of gaps during the recording, and the longest of them, s.
    pub gaps: u64,
    /// Longest gap during the recording, s; 0 without gaps.
    pub longest_gap_s: f64,
    /// Smallest and largest roll, degrees.
    pub roll_range_deg: [f64; 2],
    /// Smallest and largest pitch, degrees.
    pub pitch_range_deg: [f64; 2],
    /// Smallest and largest speed, m/s.
    pub speed_range_mps: [f64; 2],
    /// Smallest and largest height above the ellipsoid, m.
    pub height_range_m: [f64; 2],
    /// Times of some records after the first shot, s; separated by spaces, as the other lists.
    #[serde(serialize_with = "packed::serialize", deserialize_with = "packed::deserialize")]
    #[schemars(with = "String")]
    pub times_s: Vec<f64>,
    /// Roll of these records, degrees.
    #[serde(serialize_with = "packed::serialize", deserialize_with = "packed::deserialize")]
    #[schemars(with = "String")]
    pub roll_deg: Vec<f64>,
    /// Pitch, degrees.
    #[serde(serialize_with = "packed::serialize", deserialize_with = "packed::deserialize")]
    #[schemars(with = "String")]
    pub pitch_deg: Vec<f64>,
    /// Heading from north, 0 to 360 degrees.
    #[serde(serialize_with = "packed::serialize", deserialize_with = "packed::deserialize")]
    #[schemars(with = "String")]
    pub heading_deg: Vec<f64>,
    /// Speed along the path, m/s.
    #[serde(serialize_with = "packed::serialize", deserialize_with = "packed::deserialize")]
    #[schemars(with = "String")]
    pub speed_mps: Vec<f64>,
    /// Height above the ellipsoid, m.
    #[serde(serialize_with = "packed::serialize", deserialize_with = "packed::deserialize")]
    #[schemars(with = "String")]
    pub height_m: Vec<f64>,
}

/// Maximum number of records shown.
const MOST_RECORDS: usize = 300;

impl Flight {
    /// The flight between two times on the axis of the trajectory; `None` with fewer than two records.
    pub(super) fn of(trajectory: &Trajectory, [first_s, last_s]: [f64; 2]) -> Option<Flight> {
        let all = trajectory.samples();
        let from = all.partition_point(|sample| sample.time_s < first_s);
        let until = all.partition_point(|sample| sample.time_s <= last_s);
        let records = all.get(from..until).filter(|records| records.len() > 1)?;
        let speeds_mps: Vec<f64> = (0..records.len()).map(|record| speed_mps(records, record)).collect();
        let range = |of: &dyn Fn(&Sample) -> f64| extent(records.iter().map(of));
        let gaps =
            trajectory.gaps().iter().filter(|gap| gap.between_s[1] > first_s && gap.between_s[0] < last_s);
        let shown = || (0..records.len()).step_by(records.len().div_ceil(MOST_RECORDS));
        let list = |of: &dyn Fn(&Sample) -> f64| shown().map(|record| of(&records[record])).collect();
        let roll = |sample: &Sample| sample.attitude.roll_rad.to_degrees();
        let pitch = |sample: &Sample| sample.attitude.pitch_rad.to_degrees();
        Some(Flight {
            records: records.len() as u64,
            gaps: gaps.clone().count() as u64,
            longest_gap_s: gaps.map(|gap| gap.length_s()).fold(0.0, f64::max),
            roll_range_deg: range(&roll),
            pitch_range_deg: range(&pitch),
            speed_range_mps: extent(speeds_mps.iter().copied()),
            height_range_m: range(&|sample| sample.place.height_m),
            times_s: list(&|sample| sample.time_s - first_s),
            roll_deg: list(&roll),
            pitch_deg: list(&pitch),
            heading_deg: list(&|sample| sample.attitude.heading_rad.to_degrees().rem_euclid(360.0)),
            speed_mps: shown().map(|record| speeds_mps[record]).collect(),
            height_m: list(&|sample| sample.place.height_m),
        })
    }
}

/// Half the time over which a speed is averaged, s: positions are rounded.
const SPEED_S: f64 = 0.25;

/// Mean speed about a record, m/s.
fn speed_mps(records: &[Sample], record: usize) -> f64 {
    let time_s = records[record].time_s;
    let before = records[..record].iter().rposition(|other| time_s - other.time_s >= SPEED_S);
    let after = records[record..].iter().position(|other| other.time_s - time_s >= SPEED_S);
    let [a, b] = [before.unwrap_or(0), after.map_or(records.len() - 1, |after| record + after)];
    let [from, to] = [a, b].map(|at| WGS84.ecef_of(records[at].place));
    let way_m = (0..3).map(|axis| (to[axis] - from[axis]).powi(2)).sum::<f64>().sqrt();
    way_m / (records[b].time_s - records[a].time_s).max(1e-9)
}

#[cfg(test)]
mod tests {
    use super::*;
    use wavex_geodesy::ellipsoid::Geodetic;
    use wavex_geodesy::frames::Attitude;

    #[test]
    fn speed_and_attitude_are_those_of_the_records_between() {
        // 60 m/s to the north on the equator, where a radian of latitude is 6 335 439 m.
        let sample = |k: i32| {
            let time_s = 0.05 * f64::from(k);
            let place =
                Geodetic { latitude_rad: 60.0 * time_s / 6_335_439.0, longitude_rad: 0.1, height_m: 500.0 };
            let attitude = Attitude { roll_rad: 0.01 * f64::from(k % 3), ..Attitude::default() };
            Sample { time_s, place, attitude }
        };
        let trajectory =
            Trajectory::new((0..2000).filter(|k| !(1000..1010).contains(k)).map(sample).collect()).unwrap();
        let flight = Flight::of(&trajectory, [10.0, 90.0]).unwrap();
        assert_eq!((flight.records, flight.gaps), (1591, 1));
        assert!((flight.longest_gap_s - 0.55).abs() < 1e-9);
        assert!(flight.times_s.len() <= MOST_RECORDS && flight.times_s[0] == 0.0);
        assert!(
            flight.speed_range_mps.iter().all(|speed| (speed - 60.0).abs() < 0.01),
            "{:?}",
            flight.speed_range_mps
        );
        assert!((flight.roll_range_deg[1] - 0.02f64.to_degrees()).abs() < 1e-12);
        assert!(Flight::of(&trajectory, [500.0, 600.0]).is_none(), "outside of the trajectory");
    }
}
