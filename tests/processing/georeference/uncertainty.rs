//! Reported uncertainties of points against their actual errors.

use std::collections::BTreeMap;

use wavex_formats::trajectory::sbet::{RECORD_BYTES, SbetRecord};
use wavex_simulation::random::{Normal, Purpose, Random};

use super::chain::{Found, SWAYING, pairs, process, returns};
use wavex_testkit::georeferenced_flight::{Flight, Truth, distance_m, fly, write_accuracy};

/// SD of the trajectory: north, east, down, m; roll, pitch, heading, degrees.
const POSITION_SD_M: [f64; 3] = [0.008, 0.006, 0.012];
const ATTITUDE_SD_DEG: [f64; 3] = [0.001, 0.0015, 0.003];
/// Number of consecutive records with the same errors: errors change in steps, and few shots lie
/// between steps.
const SAME_RECORDS: usize = 40;
const METRES_PER_RAD: f64 = 6.38e6;

/// Adds errors to the trajectory and writes their SD to `smrmsg.out`.
fn disturb(flight: &Flight) {
    let bytes = std::fs::read(flight.path("a.out")).unwrap();
    let (records, _) = bytes.as_chunks::<RECORD_BYTES>();
    let normal = Normal::default();
    let mut disturbed = Vec::new();
    for (k, record) in records.iter().map(SbetRecord::decode).enumerate() {
        let mut random = Random::of_shot(11, (k / SAME_RECORDS) as u32, 0, Purpose::Noise);
        let mut error = |sd: f64| sd * normal.draw(&mut random);
        let [north, east, down] = POSITION_SD_M.map(&mut error);
        let [roll, pitch, heading] = ATTITUDE_SD_DEG.map(|sd| error(sd).to_radians());
        let changed = SbetRecord {
            latitude_rad: record.latitude_rad + north / METRES_PER_RAD,
            longitude_rad: record.longitude_rad + east / (METRES_PER_RAD * record.latitude_rad.cos()),
            height_m: record.height_m - down,
            roll_rad: record.roll_rad + roll,
            pitch_rad: record.pitch_rad + pitch,
            platform_heading_rad: record.platform_heading_rad + heading,
            ..record
        };
        disturbed.extend(changed.encode());
    }
    std::fs::write(flight.path("a.out"), disturbed).unwrap();
    write_accuracy(flight, POSITION_SD_M, ATTITUDE_SD_DEG);
}

const NOISY: &str = "lines = 200\nshots_per_line = 40\npulse_rate_hz = 1000\nbuilding_height_m = 0\ncanopy_height_m = 0\n\
                     response = 'gaussian'\n";

/// Each shot's only true return with the nearest return found in its shot.
///
/// Other returns in the shot are false, so their distances are not errors.
fn nearest_found<'t>(pairs: &[(&'t Found, &'t Truth)]) -> Vec<(&'t Found, &'t Truth)> {
    let mut of_shot: BTreeMap<u64, (&Found, &Truth)> = BTreeMap::new();
    for &(found, truth) in pairs {
        let off_m = |found: &Found| (found.range_m - truth.range_m).abs();
        let kept = of_shot.entry(truth.shot).or_insert((found, truth));
        if off_m(found) < off_m(kept.0) {
            *kept = (found, truth);
        }
    }
    of_shot.into_values().collect()
}

/// With noise in waveforms, positions and attitudes, the mean square error of all points equals the
/// reported variance.
#[test]
fn total_uncertainty_is_what_points_are_off_by() {
    let flight = fly(&format!("{NOISY}{SWAYING}"));
    disturb(&flight);
    process(&flight, 2, "trajectory = '*.out'\ntrajectory_accuracy = 'smrmsg_*.out'\n", "");
    let found = returns(flight.folder());
    let of_found = pairs(&flight, &found);
    let pairs = nearest_found(&of_found);
    let false_returns = of_found.len() - pairs.len();
    assert!(false_returns <= 8, "{false_returns} false returns of {} shots", pairs.len());
    assert!(pairs.len() > 7900, "{}", pairs.len());
    let squares = pairs
        .iter()
        .map(|(found, truth)| (distance_m(found.point_m, truth.point_m) / found.total_uncertainty_m).powi(2));
    let normalised = (squares.sum::<f64>() / pairs.len() as f64).sqrt();
    let mean_m = found.iter().map(|found| found.total_uncertainty_m).sum::<f64>() / found.len() as f64;
    println!(
        "{} true returns, {:.1} mm on average, normalised error {normalised:.3}; {false_returns} false returns",
        pairs.len(),
        1e3 * mean_m
    );
    assert!((0.9..=1.1).contains(&normalised), "{normalised}");
}

/// Without accuracies of the trajectory, no uncertainties are reported.
#[test]
fn what_is_not_known_is_null() {
    let flight = fly(&format!("lines = 20\nshots_per_line = 40\n{SWAYING}"));
    process(&flight, 1, "trajectory = '*.out'\n", "");
    let found = returns(flight.folder());
    assert!(!found.is_empty() && found.iter().all(|found| found.total_uncertainty_m.is_nan()));
}
