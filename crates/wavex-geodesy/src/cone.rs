//! Detects beams that rotate about an axis, as in circular scanners.
//!
//! Consecutive steps of the beam rotate about the axis of its cone: their cross products add up to
//! the axis. The azimuth of the beam about it increases with time and serves to compare
//! revolutions.

use std::f64::consts::{FRAC_PI_3, PI, TAU};

use super::frames::Vector;

/// Smallest distance of unit vectors between compared beams.
const LEAST_STEP: f64 = 0.02;
/// Longest step; longer ones are jumps.
const MOST_STEP: f64 = 0.3;
/// Largest turn between steps; larger ones are reversals.
const MOST_TURN_RAD: f64 = FRAC_PI_3;
/// Total turn after which the axis is determined.
const DECIDED_RAD: f64 = FRAC_PI_3;
/// Smallest and largest angle between beam and axis; it is 90 degrees for a plane sweep.
const HALF_ANGLES_RAD: [f64; 2] = [0.035, 1.05];
/// Smallest ratio of the least to the greatest angle between beam and axis.
const LEAST_ROUNDNESS: f64 = 0.4;
/// Number of recent steps that determine the axis: one or two revolutions.
const REMEMBERED_STEPS: f64 = 128.0;
/// Number of steps without a result after which the search restarts.
const MOST_STEPS: usize = 512;

/// Axis of the beams of a circular scanner.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cone {
    axis: Vector,
    /// Reference directions across the axis; azimuths count from the first towards the second.
    across: [Vector; 2],
}

impl Cone {
    fn of(normal: Vector, beams: &[Vector]) -> Option<Cone> {
        let axis = unit(normal)?;
        let angles = || beams.iter().map(|&beam| libm::acos(dot(axis, beam).abs().min(1.0)));
        let (least, most) =
            angles().fold((PI, 0.0), |(least, most): (f64, f64), angle| (least.min(angle), most.max(angle)));
        let is_cone = least >= HALF_ANGLES_RAD[0] && most <= HALF_ANGLES_RAD[1];
        match beams.first() {
            Some(&first) if is_cone && least >= LEAST_ROUNDNESS * most => Cone::about(axis, first),
            _ => None,
        }
    }

    /// Azimuths about a unit vector, counted from a direction.
    fn about(axis: Vector, from: Vector) -> Option<Cone> {
        let along = dot(axis, from);
        let first = unit(std::array::from_fn(|k| from[k] - along * axis[k]))?;
        Some(Cone { axis, across: [first, cross(axis, first)] })
    }

    /// Azimuth of a beam about the axis, rad: 0 to 2π, increasing with time.
    pub fn azimuth_rad(&self, beam: Vector) -> f64 {
        let [x, y] = self.across.map(|across| dot(across, beam));
        let azimuth_rad = libm::atan2(y, x);
        if azimuth_rad < 0.0 { azimuth_rad + TAU } else { azimuth_rad }
    }

    /// Rotation from one beam to another, rad: -π to π.
    pub fn turned_rad(&self, from: Vector, to: Vector) -> f64 {
        let turned_rad = self.azimuth_rad(to) - self.azimuth_rad(from);
        turned_rad - TAU * (turned_rad / TAU).round()
    }
}

/// Tracks beams in time order and finds their axis of rotation.
#[derive(Clone, Debug, Default)]
pub struct Turning {
    beams: Vec<Vector>,
    step: Option<Vector>,
    normal: Vector,
    turned_rad: f64,
    restarts: usize,
    cone: Option<Cone>,
}

impl Turning {
    /// Adds the next beam, a unit vector; ignores one that is not finite.
    pub fn add(&mut self, beam: Vector) {
        let Some(&last) = self.beams.last() else {
            if beam.iter().all(|part| part.is_finite()) {
                self.beams.push(beam);
            }
            return;
        };
        let step: Vector = std::array::from_fn(|k| beam[k] - last[k]);
        let length = dot(step, step).sqrt();
        if length.is_nan() || length < LEAST_STEP {
            return;
        }
        let step = step.map(|part| part / length);
        if length > MOST_STEP || self.step.is_some_and(|before| !self.turns(before, step)) {
            return self.restart(beam);
        }
        if let Some(before) = self.step {
            let turn = cross(before, step);
            let kept = 1.0 - 1.0 / REMEMBERED_STEPS;
            self.normal = std::array::from_fn(|k| kept * self.normal[k] + turn[k]);
            self.turned_rad += libm::asin(dot(turn, turn).sqrt().min(1.0)).copysign(dot(turn, self.normal));
        }
        self.step = Some(step);
        match &mut self.cone {
            Some(cone) => {
                if let Some(followed) = unit(self.normal).and_then(|axis| Cone::about(axis, cone.across[0])) {
                    *cone = followed;
                }
                self.beams.clear();
                self.beams.push(beam);
            }
            None => {
                self.beams.push(beam);
                if self.turned_rad.abs() >= DECIDED_RAD {
                    self.cone = Cone::of(self.normal, &self.beams);
                }
                let is_none = self.turned_rad.abs() >= DECIDED_RAD || self.beams.len() > MOST_STEPS;
                if self.cone.is_none() && is_none {
                    self.restart(beam);
                }
            }
        }
    }

    /// Whether a step continues the previous one without a reversal.
    fn turns(&self, before: Vector, step: Vector) -> bool {
        dot(before, step) > libm::cos(MOST_TURN_RAD)
    }

    fn restart(&mut self, beam: Vector) {
        self.restarts += 1;
        self.beams.clear();
        self.beams.push(beam);
        (self.step, self.turned_rad) = (None, 0.0);
        if self.cone.is_none() {
            self.normal = [0.0; 3];
        }
    }

    /// The cone of the beams; `None` until a rotation is found.
    pub fn cone(&self) -> Option<&Cone> {
        self.cone.as_ref()
    }

    /// Number of jumps, reversals and plane sweeps so far.
    pub fn restarts(&self) -> usize {
        self.restarts
    }
}

fn unit(vector: Vector) -> Option<Vector> {
    let length = dot(vector, vector).sqrt();
    (length > 0.0).then(|| vector.map(|part| part / length))
}

fn dot(a: Vector, b: Vector) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: Vector, b: Vector) -> Vector {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Beams with these half angles along and across, 500 per revolution, `sense` 1 or -1, about a
    /// tilted axis.
    fn circle(beams: usize, half_deg: [f64; 2], sense: f64, tilt_deg: f64) -> Vec<Vector> {
        let (sin_tilt, cos_tilt) = tilt_deg.to_radians().sin_cos();
        (0..beams)
            .map(|k| {
                let (sin, cos) = (sense * TAU * k as f64 / 500.0).sin_cos();
                let [x, y] = [cos * half_deg[0].to_radians().sin(), sin * half_deg[1].to_radians().sin()];
                let z = (1.0 - x * x - y * y).sqrt();
                [x, cos_tilt * y - sin_tilt * z, sin_tilt * y + cos_tilt * z]
            })
            .collect()
    }

    fn turning(beams: &[Vector]) -> Turning {
        let mut turning = Turning::default();
        beams.iter().for_each(|&beam| turning.add(beam));
        turning
    }

    #[test]
    fn azimuths_on_a_cone_increase() {
        for (half_deg, tilt_deg) in [([20.0, 20.0], 0.0), ([20.0, 14.0], 12.0), ([5.0, 5.0], 30.0)] {
            for sense in [1.0, -1.0] {
                let beams = circle(1500, half_deg, sense, tilt_deg);
                let turning = turning(&beams);
                let cone = turning.cone().unwrap();
                let steps = beams.windows(2).map(|pair| cone.turned_rad(pair[0], pair[1]));
                let (least, most) =
                    steps.fold((PI, 0.0), |(a, b): (f64, f64), step| (a.min(step), b.max(step)));
                assert!(least > 0.5 * TAU / 500.0 && most < 2.0 * TAU / 500.0, "{half_deg:?} {least} {most}");
            }
        }
        // An arc of 75 degrees is enough.
        let beams = circle(104, [20.0, 20.0], 1.0, 8.0);
        let turning = turning(&beams);
        let turned_rad = turning.cone().unwrap().turned_rad(beams[0], beams[103]);
        assert!((turned_rad - TAU * 103.0 / 500.0).abs() < 1e-3, "{turned_rad}");
    }

    /// The axis follows an aircraft whose roll exceeds the width of the cone.
    #[test]
    fn the_axis_follows_the_aircraft() {
        let beams: Vec<Vector> =
            (0..120).flat_map(|part| circle(500, [20.0, 20.0], 1.0, 0.25 * f64::from(part))).collect();
        let mut turning = Turning::default();
        let mut turned_rad = 0.0;
        for pair in beams.windows(2) {
            turning.add(pair[0]);
            turned_rad += turning.cone().map_or(0.0, |cone| cone.turned_rad(pair[0], pair[1]));
        }
        assert!((turned_rad / TAU - 119.8).abs() < 0.3, "{}", turned_rad / TAU);
    }

    #[test]
    fn plane_sweeps_are_not_cones() {
        let at = |across_deg: f64, along: f64| -> Vector {
            let (sin, cos) = across_deg.to_radians().sin_cos();
            [along, sin, cos]
        };
        // Lines of a polygon mirror with some sway; an oscillating mirror; a panoramic scanner.
        let lines: Vec<Vector> = (0..4000)
            .map(|k| at(f64::from(k % 200) * 0.3 - 30.0, 0.02 * (f64::from(k) * 1e-3).sin()))
            .collect();
        let swing: Vec<Vector> = (0..4000)
            .map(|k| at(30.0 * (f64::from(k) * 0.01).sin(), 0.02 * (f64::from(k) * 0.005).cos()))
            .collect();
        let around: Vec<Vector> = (0..4000).map(|k| at(f64::from(k) * 0.5, 0.0)).collect();
        let still = vec![[0.0, 0.0, 1.0]; 100];
        for beams in [lines, swing, around] {
            let turning = turning(&beams);
            assert_eq!(turning.cone(), None);
            assert!(turning.restarts() >= 3);
        }
        assert_eq!(turning(&still).cone(), None);
        assert_eq!(turning(&[[f64::NAN; 3], [0.0, 0.0, 1.0], [f64::NAN; 3]]).cone(), None);
    }

    #[test]
    fn a_gap_does_not_lose_the_axis() {
        let mut beams = circle(1000, [20.0, 20.0], 1.0, 5.0);
        beams.drain(600..800);
        let turning = turning(&beams);
        let turned_rad = turning.cone().unwrap().turned_rad(beams[0], beams[750]);
        // Beam 750 is the 950th, at 450 of 500 in its revolution.
        assert!((turned_rad + TAU * 0.1).abs() < 1e-2, "{turned_rad}");
    }
}
