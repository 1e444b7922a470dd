//! Flights of every kind, without noise: what the stage computes against the truth.

use super::made::{Flight, distance_m, fly};

/// What all flights have in common: short, and without noise.
const QUIET: &str = "lines = 40\nshots_per_line = 120\npulse_rate_hz = 20000\nnoise_sd_dn = 0.0\nnoise_autocorrelation = []\n\
                     response = 'gaussian'\n";

/// The farthest that a point lies from its truth, m.
#[track_caller]
fn worst_m(flight: &Flight, geometry: &str) -> f64 {
    let placed = flight.place(geometry, |truth| truth.range_m).unwrap();
    assert!(placed.points.len() > 4000, "{}", placed.points.len());
    assert_eq!(placed.points.len(), flight.truth.len());
    let off = flight.truth.iter().zip(&placed.points).map(|(truth, point)| distance_m(truth.point_m, *point));
    off.fold(0.0, f64::max)
}

#[test]
fn a_level_flight_comes_back_within_a_millimetre() {
    let flight = fly(QUIET);
    let worst_m = worst_m(&flight, "trajectory = '*.out'");
    println!("level: {:.4} mm", 1e3 * worst_m);
    assert!(worst_m < 1e-3, "{worst_m}");
}
