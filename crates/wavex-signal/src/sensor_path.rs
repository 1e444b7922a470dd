//! Sensor position from the intersection of its beams.
//!
//! Some files give a beam by points on it but not its origin. Beams close in time then still
//! determine the sensor's path, because they pass near it. Within a short window the sensor moves
//! on a straight line, `p(t) = p + v (t - t0)`. The beam at time `t` through the point `q` with
//! unit direction `d` is offset from it by `(I - d dᵀ)(p(t) - q)`; `p` and `v` minimise the squared
//! offsets: six unknowns, two equations per beam. Motion about the straight line goes into the
//! residuals. Errors common to all beams of the window (a wrong mounting, a curved projection) go
//! into the position.

use crate::cholesky;

/// A beam: a line through the sensor position at a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Beam {
    /// Time, s.
    pub time_s: f64,
    /// Point on the beam, m.
    pub through_m: [f64; 3],
    /// Unit vector.
    pub direction: [f64; 3],
}

/// Sums over the beams of a window.
#[derive(Clone, Debug, Default)]
pub struct Window {
    /// Times and positions are relative to the first beam.
    first: Option<Beam>,
    normal: [[f64; 6]; 6],
    right: [f64; 6],
    squares_m2: f64,
    time_sum_s: f64,
    last_s: f64,
    n_beams: u64,
}

/// Estimated sensor position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// Mean time of the beams, s.
    pub time_s: f64,
    /// Position, m.
    pub position_m: [f64; 3],
    /// Velocity, m/s.
    pub velocity_mps: [f64; 3],
    /// Position SD of all axes combined, m, from the residuals.
    pub sd_m: f64,
    /// RMS distance between the beams and the path, m.
    pub residual_m: f64,
}

/// Fewest beams for an uncertainty estimate.
const FEWEST_BEAMS: u64 = 30;
/// Largest dilution of precision relative to a single beam of the window; nearly parallel beams
/// have no intersection.
const MOST_DILUTION: f64 = 1000.0;

impl Window {
    /// Adds a beam; ignores one that is not finite.
    pub fn add(&mut self, beam: &Beam) {
        let numbers = beam.through_m.iter().chain(&beam.direction).chain([&beam.time_s]);
        if !numbers.into_iter().all(|number| number.is_finite()) {
            return;
        }
        let first = *self.first.get_or_insert(*beam);
        let t = beam.time_s - first.time_s;
        let d = beam.direction;
        let q: [f64; 3] = std::array::from_fn(|axis| beam.through_m[axis] - first.through_m[axis]);
        for row in 0..3 {
            let off_beam: [f64; 3] =
                std::array::from_fn(|column| f64::from(u8::from(row == column)) - d[row] * d[column]);
            let distance = off_beam.iter().zip(q).map(|(a, b)| a * b).sum::<f64>();
            for (column, part) in off_beam.into_iter().enumerate() {
                self.normal[row][column] += part;
                self.normal[row + 3][column] += t * part;
                self.normal[row + 3][column + 3] += t * t * part;
            }
            self.right[row] += distance;
            self.right[row + 3] += t * distance;
            self.squares_m2 += q[row] * distance;
        }
        self.time_sum_s += t;
        self.last_s = beam.time_s;
        self.n_beams += 1;
    }

    /// Number of beams.
    pub fn n_beams(&self) -> u64 {
        self.n_beams
    }

    /// Time from the first beam to the last, s.
    pub fn length_s(&self) -> f64 {
        self.first.map_or(0.0, |first| self.last_s - first.time_s)
    }

    /// Sensor position at the mean time of the beams.
    ///
    /// `None` if undetermined: too few beams, nearly parallel beams, or all at one time.
    pub fn place(&self) -> Option<Place> {
        let first = self.first.filter(|_| self.n_beams >= FEWEST_BEAMS)?;
        let mut factor = [0.0; 36];
        factor.copy_from_slice(self.normal.as_flattened());
        let mut solved = self.right;
        let mut covariance = [0.0; 36];
        if !cholesky::factor(&mut factor, 6) {
            return None;
        }
        cholesky::solve(&factor, 6, &mut solved);
        cholesky::invert(&factor, 6, &mut covariance);
        let n = self.n_beams as f64;
        let t = self.time_sum_s / n;
        let at = |row: usize, column: usize| covariance[6 * row + column];
        let variance: f64 = (0..3)
            .map(|axis| at(axis, axis) + 2.0 * t * at(axis, axis + 3) + t * t * at(axis + 3, axis + 3))
            .sum();
        // Rounding may give a slightly negative value.
        let left_m2 =
            (self.squares_m2 - solved.iter().zip(self.right).map(|(a, b)| a * b).sum::<f64>()).max(0.0);
        let beam_variance_m2 = left_m2 / (2.0 * n - 6.0);
        if !(variance > 0.0 && (variance * n).sqrt() < MOST_DILUTION) {
            return None;
        }
        let [x, y, z, vx, vy, vz] = solved;
        let velocity_mps = [vx, vy, vz];
        let place = [x, y, z];
        Some(Place {
            time_s: first.time_s + t,
            position_m: std::array::from_fn(|axis| {
                first.through_m[axis] + place[axis] + t * velocity_mps[axis]
            }),
            velocity_mps,
            sd_m: (variance * beam_variance_m2).sqrt(),
            residual_m: (left_m2 / n).sqrt(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Beams of a scanner at 1000 m that flies east at 60 m/s with 47.3 lines per second.
    ///
    /// Each has a point near the ground, rounded if `step_m` is above 0, and a direction with the
    /// given error.
    fn beams(seconds: f64, half_angle_deg: f64, step_m: f64, direction_error_rad: f64) -> Vec<Beam> {
        let n = (seconds * 10_000.0) as usize;
        // Deterministic errors: evenly spread, repeating after hundreds of beams.
        let spread = |k: usize, by: usize| ((k * by) % 499) as f64 / 249.0 - 1.0;
        (0..n)
            .map(|k| {
                let time_s = k as f64 * 1e-4;
                let sweep = (time_s * 47.3).fract();
                let across = (2.0 * sweep - 1.0) * half_angle_deg.to_radians();
                let aim =
                    [spread(k, 137), spread(k, 211)].map(|error| 3f64.sqrt() * direction_error_rad * error);
                let (sin, cos) = (across + aim[0]).sin_cos();
                let direction = [aim[1].sin(), sin * aim[1].cos(), -cos * aim[1].cos()];
                let ground_m = 990.0 / across.cos();
                let sensor = sensor(time_s);
                let on_beam = [0.0, across.sin(), -across.cos()];
                let rounded = |m: f64| if step_m > 0.0 { (m / step_m).round() * step_m } else { m };
                Beam {
                    time_s,
                    through_m: std::array::from_fn(|axis| rounded(sensor[axis] + ground_m * on_beam[axis])),
                    direction,
                }
            })
            .collect()
    }

    fn sensor(time_s: f64) -> [f64; 3] {
        [500_000.0 + 60.0 * time_s, 5_300_000.0, 1000.0]
    }

    fn fitted(beams: &[Beam]) -> Option<Place> {
        let mut window = Window::default();
        beams.iter().for_each(|beam| window.add(beam));
        window.place()
    }

    fn error_m(place: &Place) -> f64 {
        let truth = sensor(place.time_s);
        (0..3).map(|axis| (place.position_m[axis] - truth[axis]).powi(2)).sum::<f64>().sqrt()
    }

    #[test]
    fn exact_beams_meet_at_the_sensor() {
        let place = fitted(&beams(0.2, 30.0, 0.0, 0.0)).unwrap();
        assert!((place.time_s - 0.099_95).abs() < 1e-9);
        assert!(error_m(&place) < 1e-5, "{}", error_m(&place));
        let expected = [60.0, 0.0, 0.0];
        (0..3).for_each(|axis| assert!((place.velocity_mps[axis] - expected[axis]).abs() < 1e-4));
        assert!(place.residual_m < 1e-4 && place.sd_m < 1e-4);
    }

    /// The standard deviation covers the effect of rounded points and directions.
    #[test]
    fn errors_are_as_large_as_their_standard_deviation_says() {
        let rounded = fitted(&beams(0.2, 30.0, 0.01, 0.0)).unwrap();
        assert!((0.003..0.006).contains(&rounded.residual_m), "{}", rounded.residual_m);
        assert!(error_m(&rounded) < 4.0 * rounded.sd_m && rounded.sd_m < 1e-3, "{rounded:?}");
        let turned = fitted(&beams(0.2, 30.0, 0.001, 1e-5)).unwrap();
        // 0.01 mrad over 990 to 1143 m, in two directions.
        assert!((0.014..0.017).contains(&turned.residual_m), "{}", turned.residual_m);
        assert!(error_m(&turned) < 4.0 * turned.sd_m && turned.sd_m < 2e-3, "{turned:?}");
    }

    /// A conical scan of 20 degrees at 80 revolutions per second determines the position as well.
    #[test]
    fn beams_of_a_cone_meet_at_the_sensor() {
        for (step_m, direction_error_rad) in [(0.0, 0.0), (0.001, 1e-5)] {
            let mut cone = beams(0.2, 0.0, 0.0, direction_error_rad);
            let (away, down) = 20f64.to_radians().sin_cos();
            for beam in &mut cone {
                let (sin, cos) = (std::f64::consts::TAU * 80.0 * beam.time_s).sin_cos();
                let (on_beam, sensor) = ([away * cos, away * sin, -down], sensor(beam.time_s));
                let rounded = |m: f64| if step_m > 0.0 { (m / step_m).round() * step_m } else { m };
                beam.through_m =
                    std::array::from_fn(|axis| rounded(sensor[axis] + 990.0 / down * on_beam[axis]));
                // The deviation of a beam from the vertical is applied to the beam on the cone.
                let off = [beam.direction[0], beam.direction[1], 0.0];
                let turned: [f64; 3] = std::array::from_fn(|axis| on_beam[axis] + off[axis]);
                let length = dot_of(turned, turned).sqrt();
                beam.direction = turned.map(|part| part / length);
            }
            let place = fitted(&cone).unwrap();
            println!("{place:?}: {} m off", error_m(&place));
            assert!(error_m(&place) < 4.0 * place.sd_m + 1e-5 && place.sd_m < 3e-3, "{place:?}");
        }
    }

    fn dot_of(a: [f64; 3], b: [f64; 3]) -> f64 {
        a.iter().zip(b).map(|(a, b)| a * b).sum()
    }

    #[test]
    fn parallel_beams_give_no_position() {
        assert_eq!(fitted(&[]), None);
        assert_eq!(fitted(&beams(0.002, 30.0, 0.0, 0.0)), None, "20 beams");
        assert_eq!(fitted(&beams(0.2, 0.0, 0.0, 0.0)), None, "parallel beams");
        let one_moment: Vec<Beam> =
            beams(0.2, 30.0, 0.0, 0.0).iter().map(|beam| Beam { time_s: 1.0, ..*beam }).collect();
        assert_eq!(fitted(&one_moment), None);
        let mut window = Window::default();
        window.add(&Beam { time_s: f64::NAN, through_m: [0.0; 3], direction: [0.0, 0.0, 1.0] });
        assert_eq!((window.n_beams(), window.length_s()), (0, 0.0));
    }
}
