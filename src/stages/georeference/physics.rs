//! Beams and points that contradict an instrument above the ground of the earth.

use std::ops::RangeInclusive;

use crate::plausibility::{Check, Otherwise};
use crate::scan_line::{Emission, Frame, InputInfo, Return};
use wavex_geodesy::ellipsoid::WGS84;
use wavex_geodesy::frames::Vector;
use wavex_geodesy::vertical::down_at;

/// Shots that are evidence, and shots that are examined.
const FEWEST_SHOTS: u64 = 200;
const MOST_SHOTS: u64 = 100_000;
/// Angle from which a beam is far from nadir, degrees.
const FAR_DEG: f64 = 60.0;
/// Part of the returns that may lie above the sensor: slopes of mountains.
const MOST_ABOVE: f64 = 0.1;
/// Ellipsoidal heights of ground, m: the shore of the Dead Sea lies at -410 m, Mount Everest at 8820 m.
const GROUND_M: RangeInclusive<f64> = -500.0..=9000.0;

/// Words of the messages.
const FAR: &str = "of their returns lie above the sensor";
const NOWHERE: &str = "lie where the earth has no ground";

/// The checks of this module.
pub(crate) fn checks() -> Vec<Check> {
    let check = |compared, accepted, source, message| {
        let (otherwise, key) = (Otherwise::Warning, Some("mount"));
        Check { compared, accepted, source, otherwise, message, key }
    };
    vec![
        check(
            "beams and straight down, without a frame of the instrument",
            format!("at most half of at least {FEWEST_SHOTS} beams more than {FAR_DEG} degrees away"),
            "scanners of aircraft look down",
            "away from straight down",
        ),
        check(
            "heights of returns and of the sensor",
            format!("at most {:.0} % of the returns above the sensor", 100.0 * MOST_ABOVE),
            "slopes of mountains",
            FAR,
        ),
        Check {
            key: Some("trajectory_heights"),
            ..check(
                "heights of returns and of the ground of the earth",
                format!("at least half of them from {} to {} m", GROUND_M.start(), GROUND_M.end()),
                "the Dead Sea and Mount Everest",
                NOWHERE,
            )
        },
    ]
}

/// Counts contradictions of the first 100 000 shots.
#[derive(Debug, Default)]
pub(super) struct Physics {
    shots: u64,
    /// Beams far from nadir.
    far: u64,
    returns: u64,
    /// Returns above the sensor.
    above: u64,
    /// Returns where there is no ground.
    nowhere: u64,
    is_said: bool,
}

/// A contradiction, for a message.
#[derive(Debug, PartialEq)]
pub(super) enum Problem {
    /// Of beams.
    Beams(String),
    /// Of heights.
    Heights(String),
}

impl Problem {
    /// The message, with the likely cause in a run with or without a trajectory.
    pub(super) fn explained(self, has_trajectory: bool) -> String {
        let (problem, cause) = match (self, has_trajectory) {
            (Problem::Beams(problem), true) => (
                problem,
                "is the wrong `mount` in `[job.geometry]`, or a trajectory with other axes than forward, right, down; an \
                 instrument on the ground has such beams, too",
            ),
            (Problem::Beams(problem), false) => (
                problem,
                "are wrong beam vectors in the file: export it again; an instrument on the ground has such beams, too",
            ),
            (Problem::Heights(problem), true) => (
                problem,
                "are heights of the trajectory in another unit or above a geoid (`trajectory_heights`), or wrong ranges",
            ),
            (Problem::Heights(problem), false) => {
                (problem, "are heights of the file in another unit, or wrong ranges: export it again")
            }
        };
        format!("{problem}: the likely cause {cause}")
    }
}

impl Physics {
    /// Adds a line with its points in the frame of the recording; the contradictions that it proves.
    ///
    /// Says them once.
    pub(super) fn add(
        &mut self,
        input: &InputInfo,
        emissions: &[Emission],
        returns: &[Return],
        points: &[Vector],
    ) -> Vec<Problem> {
        let down = emissions.first().and_then(|first| down_at(input.frame, first.origin_m));
        let Some(down) = down.filter(|_| !self.is_said && self.shots <= MOST_SHOTS) else {
            return Vec::new();
        };
        let cosine = |emission: &Emission| {
            let direction = emission.direction;
            let length = direction.iter().map(|part| part * part).sum::<f64>().sqrt();
            direction.iter().zip(down).map(|(a, b)| a * b).sum::<f64>() / length
        };
        // Ranges from a point near the waveform may be negative.
        let sign = |r: &Return| if input.origin_is_sensor { r.range_m } else { 1.0 };
        let is_above =
            |r: &&Return| emissions.get(r.emission as usize).is_some_and(|shot| cosine(shot) * sign(r) < 0.0);
        let map_unit_m = input.map_unit_m();
        let height_m = |point: &Vector| match input.frame {
            Frame::Earth => WGS84.geodetic_of(*point).height_m,
            _ => point[2] * map_unit_m,
        };
        let least_cosine = FAR_DEG.to_radians().cos();
        self.shots += emissions.len() as u64;
        self.far += emissions.iter().filter(|shot| cosine(shot) < least_cosine).count() as u64;
        self.returns += returns.len() as u64;
        self.above += returns.iter().filter(is_above).count() as u64;
        let heights_m = points.iter().map(height_m);
        let nowhere_m: Vec<f64> = heights_m.filter(|height_m| !GROUND_M.contains(height_m)).collect();
        self.nowhere += nowhere_m.len() as u64;
        if self.shots < FEWEST_SHOTS {
            return Vec::new();
        }
        let [far, above, nowhere] =
            [(self.far, self.shots), (self.above, self.returns), (self.nowhere, self.returns)]
                .map(|(count, of)| count as f64 / of.max(1) as f64);
        let mut problems = Vec::new();
        if far > 0.5 || above > MOST_ABOVE {
            problems.push(Problem::Beams(format!(
                "{:.0} % of the first {} beams point more than {FAR_DEG} degrees away from straight down, and {:.0} % {FAR}",
                100.0 * far,
                self.shots,
                100.0 * above
            )));
        }
        if let Some(example_m) = nowhere_m.first().filter(|_| nowhere > 0.5) {
            problems.push(Problem::Heights(format!(
                "{:.0} % of the first {} points {NOWHERE}, such as at {example_m:.0} m, below {} or above {} m",
                100.0 * nowhere,
                self.returns,
                GROUND_M.start(),
                GROUND_M.end()
            )));
        }
        self.is_said = !problems.is_empty();
        problems
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Contradictions of beams at these angles from nadir, with points of this range from 1000 m.
    fn found(angles_deg: impl Iterator<Item = f64>, range_m: f64) -> Vec<Problem> {
        let beam = |angle: f64| {
            let (sine, cosine) = angle.to_radians().sin_cos();
            Emission { direction: [sine, 0.0, -cosine], ..Emission::default() }
        };
        let emissions: Vec<Emission> = angles_deg.map(beam).collect();
        let returns: Vec<Return> = (0..emissions.len())
            .map(|shot| Return { emission: shot as u32, range_m, ..Return::default() })
            .collect();
        let heights = emissions.iter().map(|shot| [0.0, 0.0, 1000.0 + range_m * shot.direction[2]]);
        let points: Vec<Vector> = heights.collect();
        let input = InputInfo { frame: Frame::Map, origin_is_sensor: true, ..InputInfo::default() };
        Physics::default().add(&input, &emissions, &returns, &points)
    }

    #[test]
    fn beams_far_from_nadir_and_returns_above_the_sensor_are_said() {
        assert_eq!(found((0..300).map(|k| -45.0 + 0.3 * f64::from(k)), 900.0), []);
        assert_eq!(found((0..100).map(|_| 90.0), 900.0), [], "too few");
        let beams = "100 % of the first 300 beams point more than 60 degrees away from straight down, and 0 % of \
                     their returns lie above the sensor";
        assert_eq!(found((0..300).map(|_| 85.0), 900.0), [Problem::Beams(beams.into())]);
        assert_eq!(found((0..300).map(|k| if k % 4 == 0 { 120.0 } else { 0.0 }), 900.0).len(), 1);
        let above = "0 % of the first 300 beams point more than 60 degrees away from straight down, and 100 % of \
                     their returns lie above the sensor";
        assert_eq!(found((0..300).map(|_| 0.0), -100.0), [Problem::Beams(above.into())], "negative ranges");
    }

    #[test]
    fn points_where_the_earth_has_no_ground_are_said() {
        let said = |range_m| found((0..300).map(|_| 0.0), range_m);
        assert_eq!(said(1490.0), []);
        let heights = "100 % of the first 300 points lie where the earth has no ground, such as at -510 m, below -500 or \
                       above 9000 m";
        assert_eq!(said(1510.0), [Problem::Heights(heights.into())]);
        assert_eq!(found((0..300).map(|k| if k % 2 == 0 { 0.0 } else { 59.0 }), 1600.0), [], "half of them");
    }
}
