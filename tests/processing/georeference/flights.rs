//! Noise-free flights of every kind: computed points against the truth.

use wavex::georef::mount::{Mount, MountName};
use wavex_geodesy::frames::{inverse, rotation_of_angles, then};

use wavex_testkit::georeferenced_flight::{Flight, distance_m, fly};

/// Keys common to all flights: short and noise-free.
pub const QUIET: &str = "lines = 40\nshots_per_line = 120\npulse_rate_hz = 20000\nnoise_sd_dn = 0.0\n\
                         noise_autocorrelation = []\nresponse = 'gaussian'\n";

/// Lever arm and boresight as keys of the simulator and of `[job.geometry]`.
const INSTALLED: &str = "lever_arm_m = [0.8, -0.35, 1.1]\nboresight_deg = [0.4, -0.7, 1.3]\n";
const CALIBRATED: &str =
    "calibration = { lever_arm_m = [0.8, -0.35, 1.1], boresight_deg = [0.4, -0.7, 1.3] }\n";

/// Angles of up to 15 degrees that change within seconds.
const SWAYING: &str =
    "roll_deg = 15.0\npitch_deg = 12.0\nyaw_deg = 8.0\nmotion_period_s = 4.0\nscan_angle_deg = [-25, 25]\n";

/// Maximum point error, m.
#[track_caller]
fn worst_m(what: &str, flight: &Flight, geometry: &str) -> f64 {
    let placed = flight.place(&format!("trajectory = '*.out'\n{geometry}"), |truth| truth.range_m).unwrap();
    assert!(placed.points.len() > 4000, "{}", placed.points.len());
    assert_eq!(placed.points.len(), flight.truth.len());
    assert_eq!(placed.cx.counters().rejected_of(wavex::stage::Item::Shots), 0);
    let off = flight.truth.iter().zip(&placed.points).map(|(truth, point)| distance_m(truth.point_m, *point));
    let worst_m = off.fold(0.0, f64::max);
    println!("{what}: {} points, the farthest {:.5} mm off", placed.points.len(), 1e3 * worst_m);
    worst_m
}

/// Asserts errors within 1 mm in the UTM zone of the start.
#[track_caller]
fn comes_back(what: &str, keys: &str) {
    let flight = fly(&format!("{QUIET}{INSTALLED}{keys}"));
    let worst_m = worst_m(what, &flight, CALIBRATED);
    assert!(worst_m < 1e-3, "{what}: {worst_m} m");
}

#[test]
fn a_level_flight() {
    comes_back("level", "heading_deg = 30.0\n");
}

/// 500 shots per revolution at a half angle of 20 degrees, level and in a turn.
#[test]
fn a_circular_scanner() {
    let circular = "scanner = 'circular'\nrotation_hz = 40.0\nscan_angle_deg = [-20, 20]\n";
    comes_back("circular, level", &format!("{circular}heading_deg = 30.0\n"));
    let swaying = SWAYING.replace("scan_angle_deg = [-25, 25]\n", "");
    comes_back("circular, in a turn", &format!("{circular}{swaying}turn_radius_m = 300.0\n"));
}

#[test]
fn a_turning_flight() {
    comes_back("a turn to the right", &format!("{SWAYING}turn_radius_m = 300.0\n"));
    comes_back("a turn to the left", &format!("{SWAYING}turn_radius_m = -300.0\nheading_deg = 170.0\n"));
}

#[test]
fn steep_roll_and_pitch() {
    comes_back("steep roll and pitch", SWAYING);
}

/// The heading crosses 180 degrees and returns.
#[test]
fn a_flight_to_the_south() {
    comes_back("to the south", &format!("{SWAYING}heading_deg = 180.0\n"));
}

/// Eastwards across 6 degrees east: all points have coordinates in the zone of the first shot.
#[test]
fn across_a_zone_border() {
    comes_back("a zone border", &format!("{SWAYING}heading_deg = 90.0\nstart_deg = [5.9999, 47.0]\n"));
}

/// Eastwards across the antimeridian.
#[test]
fn across_the_date_line() {
    comes_back("the date line", &format!("{SWAYING}heading_deg = 90.0\nstart_deg = [179.9999, -17.0]\n"));
}

#[test]
fn in_the_southern_hemisphere() {
    comes_back(
        "the southern hemisphere",
        &format!("{SWAYING}start_deg = [151.2, -33.9]\nheading_deg = -100.0\n"),
    );
}

#[test]
fn at_a_high_latitude() {
    comes_back("a high latitude", &format!("{SWAYING}start_deg = [-42.0, 83.5]\nheading_deg = 45.0\n"));
    comes_back("near the pole", &format!("{SWAYING}start_deg = [100.0, 88.9]\nheading_deg = -45.0\n"));
}

/// The mount compensates a boresight rotation: the same flight with a scanner that points along its
/// x axis.
#[test]
fn a_scanner_mounted_in_another_way() {
    let simulated = rotation_of_angles([0.4, -0.7, 1.3].map(f64::to_radians));
    let boresight = rotation_of_angles([-0.2, 0.3, 0.15].map(f64::to_radians));
    let calibration = "calibration = { lever_arm_m = [0.8, -0.35, 1.1], boresight_deg = [-0.2, 0.3, 0.15] }";
    let mounts = [
        (Mount::Named(MountName::XDownZRight), "'x_down_z_right'"),
        (Mount::Named(MountName::XDownZBackward), "'x_down_z_backward'"),
        (Mount::Angles([3.0, -85.0, 178.0]), "[3.0, -85.0, 178.0]"),
    ];
    for (mount, key) in mounts {
        // Boresight and mount rotate from the new frame to the aircraft, as the simulator's
        // boresight does from its own.
        let body_from_scanner = then(&boresight, &mount.body_from_scanner());
        let turned = then(&simulated, &inverse(&body_from_scanner));
        let flight = fly(&format!("{QUIET}{INSTALLED}{SWAYING}")).turned(turned);
        let worst_m = worst_m(key, &flight, &format!("{calibration}\nmount = {key}"));
        assert!(worst_m < 1e-3, "{key}: {worst_m} m");
    }
}
