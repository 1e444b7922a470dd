//! Beams that contradict an instrument above the ground.

use crate::scan_line::{Emission, Frame, Return};
use wavex_geodesy::vertical::down_at;

/// Shots that are evidence, and shots that are examined.
const FEWEST_SHOTS: u64 = 200;
const MOST_SHOTS: u64 = 100_000;
/// Cosine of 60 degrees, from which a beam is far from nadir.
const LEAST_COSINE: f64 = 0.5;
/// Part of the returns that may lie above the sensor: slopes of mountains.
const MOST_ABOVE: f64 = 0.1;

/// Counts beams far from nadir, and returns above the sensor.
#[derive(Debug, Default)]
pub(super) struct Nadir {
    shots: u64,
    far: u64,
    returns: u64,
    above: u64,
}

impl Nadir {
    /// Adds a line; a description of the contradiction, if there is one by now.
    ///
    /// Says it once, and examines only the first 100 000 shots.
    pub(super) fn add(&mut self, frame: Frame, emissions: &[Emission], returns: &[Return]) -> Option<String> {
        if self.shots > MOST_SHOTS {
            return None;
        }
        let down = down_at(frame, emissions.first()?.origin_m)?;
        let cosine = |emission: &Emission| {
            let direction = emission.direction;
            let length = direction.iter().map(|part| part * part).sum::<f64>().sqrt();
            direction.iter().zip(down).map(|(a, b)| a * b).sum::<f64>() / length
        };
        let is_up = |r: &&Return| emissions.get(r.emission as usize).is_some_and(|shot| cosine(shot) < 0.0);
        self.shots += emissions.len() as u64;
        self.far += emissions.iter().filter(|shot| cosine(shot) < LEAST_COSINE).count() as u64;
        self.returns += returns.len() as u64;
        self.above += returns.iter().filter(is_up).count() as u64;
        let [far, above] = [(self.far, self.shots), (self.above, self.returns)]
            .map(|(count, of)| count as f64 / of.max(1) as f64);
        if self.shots < FEWEST_SHOTS || (far <= 0.5 && above <= MOST_ABOVE) {
            return None;
        }
        let problem = format!(
            "{:.0} % of the first {} beams point more than 60 degrees away from straight down, and {:.0} % of their \
             returns lie above the sensor",
            100.0 * far,
            self.shots,
            100.0 * above
        );
        self.shots = MOST_SHOTS + 1;
        Some(problem)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn said(angles_deg: impl Iterator<Item = f64>) -> Option<String> {
        let beam = |angle: f64| {
            let (sine, cosine) = angle.to_radians().sin_cos();
            Emission { direction: [sine, 0.0, -cosine], ..Emission::default() }
        };
        let emissions: Vec<Emission> = angles_deg.map(beam).collect();
        let returns: Vec<Return> =
            (0..emissions.len()).map(|shot| Return { emission: shot as u32, ..Return::default() }).collect();
        Nadir::default().add(Frame::Map, &emissions, &returns)
    }

    #[test]
    fn beams_far_from_nadir_and_returns_above_the_sensor_are_said() {
        assert_eq!(said((0..300).map(|k| -45.0 + 0.3 * f64::from(k))), None);
        assert_eq!(said((0..100).map(|_| 90.0)), None, "too few");
        let expected = "100 % of the first 300 beams point more than 60 degrees away from straight down, and 0 % of \
                        their returns lie above the sensor";
        assert_eq!(said((0..300).map(|_| 85.0)).as_deref(), Some(expected));
        assert!(said((0..300).map(|k| if k % 4 == 0 { 120.0 } else { 0.0 })).is_some());
    }
}
