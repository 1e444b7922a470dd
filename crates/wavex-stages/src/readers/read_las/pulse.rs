//! Grouping of LAS points into pulses.

use wavex_formats::las::Point;

/// Maximum of 1 - cos between directions of points of one pulse.
const SAME_BEAM: f64 = 1e-9;

/// Whether a point belongs to the same pulse as these points.
pub(super) fn same_pulse(pulse: &[Point], b: &Point) -> bool {
    let Some(a) = pulse.last() else { return false };
    let (u, v) = (a.wave.direction_per_ps.map(f64::from), b.wave.direction_per_ps.map(f64::from));
    let dot = |u: [f64; 3], v: [f64; 3]| u[0] * v[0] + u[1] * v[1] + u[2] * v[2];
    let cosine = dot(u, v) / (dot(u, u) * dot(v, v)).sqrt();
    let is_one_channel = pulse.iter().all(|point| point.scanner_channel == b.scanner_channel);
    let counts_on = if is_one_channel { a.return_number != b.return_number } else { is_one_series(pulse, b) };
    a.gps_time == b.gps_time && counts_on && cosine > 1.0 - SAME_BEAM
}

/// Whether a point continues the return numbering of points from several channels.
///
/// A scanner channel is either a separate laser with its own numbering, or one of several receivers
/// of the same pulse, as `write_las` writes it. In the second case the returns of all receivers are
/// numbered together, in ascending order.
fn is_one_series(pulse: &[Point], b: &Point) -> bool {
    pulse.iter().all(|a| a.number_of_returns == b.number_of_returns && a.return_number < b.return_number)
}

#[cfg(test)]
mod tests {
    use super::*;
    use wavex_formats::las::Wave;

    fn point(gps_time: f64, return_number: u8, offset: u64) -> Point {
        let wave =
            Wave { descriptor: 1, offset, size: 60, location_ps: 0.0, direction_per_ps: [0.0, 0.0, 1.5e-4] };
        Point { gps_time, return_number, wave, ..Point::default() }
    }

    #[test]
    fn points_of_one_time_and_beam_are_one_pulse() {
        let alone = |a: Point, b: Point| same_pulse(&[a], &b);
        assert!(alone(point(1.0, 1, 60), point(1.0, 2, 60)));
        assert!(alone(point(1.0, 1, 60), point(1.0, 2, 180)), "a second waveform of the same pulse");
        assert!(!alone(point(1.0, 1, 60), point(1.000_002, 2, 60)));
        assert!(
            !alone(point(1.0, 1, 60), point(1.0, 1, 180)),
            "time resolution too coarse to separate pulses"
        );
        let mut tilted = point(1.0, 2, 60);
        tilted.wave.direction_per_ps[0] = 1e-7;
        assert!(!alone(point(1.0, 1, 60), tilted));
    }

    #[test]
    fn receivers_of_one_pulse_count_together_and_lasers_on_their_own() {
        let of = |scanner_channel, return_number, number_of_returns| Point {
            scanner_channel,
            number_of_returns,
            ..point(1.0, return_number, 60)
        };
        assert!(same_pulse(&[of(0, 1, 3)], &of(1, 2, 3)));
        assert!(same_pulse(&[of(0, 1, 3), of(1, 2, 3)], &of(0, 3, 3)));
        assert!(!same_pulse(&[of(0, 1, 3)], &of(1, 2, 2)), "another number of returns");
        assert!(!same_pulse(&[of(0, 1, 1)], &of(1, 1, 1)), "both have a first return");
        assert!(
            !same_pulse(&[of(0, 1, 2), of(0, 2, 2)], &of(1, 1, 2)),
            "the second laser restarts its numbering"
        );
        assert!(!same_pulse(&[of(0, 1, 3), of(1, 3, 3)], &of(1, 2, 3)), "numbers must ascend");
        let mut tilted = of(1, 2, 3);
        tilted.wave.direction_per_ps[0] = 1e-7;
        assert!(!same_pulse(&[of(0, 1, 3)], &tilted));
    }
}
