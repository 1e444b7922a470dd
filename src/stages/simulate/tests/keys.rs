//! What the keys may be.

use super::*;
use crate::keys::InvalidKey;

#[test]
fn each_limit_has_its_message() {
    type Change = fn(&mut Simulate);
    let cases: [(Change, &str, &str); 45] = [
        (|c| c.stem = "a/b".to_owned(), "stem", "must be a file name without folders"),
        (|c| c.lines = 0, "lines", "must be at least 1"),
        (|c| c.shots_per_line = 4097, "shots_per_line", "must lie between 1 and 4096"),
        (|c| c.pulse_rate_hz = 999.0, "pulse_rate_hz", "must lie between 1000 and 2000000"),
        (
            |c| c.scan_angle_deg = [30.0, -30.0],
            "scan_angle_deg",
            "must be two ascending angles between -60 and 60",
        ),
        (
            |c| (c.scanner, c.scan_angle_deg) = (ScannerKind::Circular, [-30.0, 20.0]),
            "scan_angle_deg",
            "must be -a and a for a circular scanner of half angle a",
        ),
        (|c| c.rotation_hz = 0.5, "rotation_hz", "must lie between 1 and 1000"),
        (
            |c| c.modulation_ns = 3334.0,
            "modulation_ns",
            "must lie between 0 and half the interval between pulses",
        ),
        (|c| c.speed_mps = f64::NAN, "speed_mps", "must lie between 1 and 1000"),
        (|c| c.heading_deg = 361.0, "heading_deg", "must lie between -360 and 360"),
        (|c| c.turn_radius_m = 99.0, "turn_radius_m", "must be 0, or 100 to 1000000 to either side"),
        (
            |c| c.start_deg = Some([0.0, 90.0]),
            "start_deg",
            "must be a longitude, and a latitude between -89 and 89",
        ),
        (|c| c.start_deg = Some([0.0, 80.0]), "start_deg", "needs a trajectory: give `sbet` or `pof`"),
        (|c| c.start_time_s = 604_800.0, "start_time_s", "must lie between 0 and 604800"),
        (|c| c.roll_deg = 15.1, "roll_deg", "must lie between 0 and 15"),
        (|c| c.pitch_deg = -0.1, "pitch_deg", "must lie between 0 and 15"),
        (|c| c.yaw_deg = f64::NAN, "yaw_deg", "must lie between 0 and 15"),
        (|c| c.motion_period_s = 0.9, "motion_period_s", "must lie between 1 and 1000"),
        (|c| c.lever_arm_m[2] = 11.0, "lever_arm_m", "must be three lengths between -10 and 10"),
        (|c| c.boresight_deg[0] = -11.0, "boresight_deg", "must be three angles between -10 and 10"),
        (
            |c| (c.scan_angle_deg, c.roll_deg, c.boresight_deg) = ([0.0, 60.0], 10.0, [0.0, 6.0, 0.0]),
            "scan_angle_deg",
            "must leave beams within 75 degrees of straight down, whatever roll, pitch and boresight",
        ),
        (|c| c.relief_m = 2001.0, "relief_m", "must lie between 0 and 2000"),
        (|c| c.water_ratio = 1.1, "water_ratio", "must lie between 0 and 1"),
        (|c| c.wood_ratio = -0.1, "wood_ratio", "must lie between 0 and 1"),
        (|c| c.house_ratio = f64::NAN, "house_ratio", "must lie between 0 and 1"),
        (|c| c.wire_height_m = 101.0, "wire_height_m", "must lie between 0 and 100"),
        (
            |c| (c.landscape, c.relief_m, c.flying_height_m) = (Landscape::Country, 100.0, 153.9),
            "flying_height_m",
            "must lie between 30 m above all terrain and objects, and 10000",
        ),
        (|c| c.false_alarm_rate = 2.0, "false_alarm_rate", "must lie between 0 and 1"),
        (|c| c.blind_gap_ns = -1.0, "blind_gap_ns", "must lie between 0 and 1000"),
        (
            |c| c.high_power_noise_sd_dn = 0.4,
            "high_power_noise_sd_dn",
            "must be 0, or lie between 0.5 and 100",
        ),
        (|c| c.high_power_from_dn = -1.0, "high_power_from_dn", "must lie between 0 and 10000"),
        (|c| c.high_power_delay_ns = 11.0, "high_power_delay_ns", "must lie between -10 and 10"),
        (
            |c| (c.high_power, c.high_power_noise_sd_dn, c.noise_autocorrelation) = (true, 0.5, vec![0.7]),
            "noise_autocorrelation",
            "belongs to no noise that can be recorded at this high_power_noise_sd_dn",
        ),
        (|c| c.building_height_m = -1.0, "building_height_m", "must lie between 0 and 200"),
        (|c| c.canopy_height_m = 201.0, "canopy_height_m", "must lie between 0 and 200"),
        (
            |c| c.flying_height_m = 37.0,
            "flying_height_m",
            "must lie between 20 m above building and wood, and 10000",
        ),
        (|c| c.ground_amplitude_dn = 0.0, "ground_amplitude_dn", "must lie between 1 and 10000"),
        (|c| c.dropout_rate = 1.1, "dropout_rate", "must lie between 0 and 1"),
        (|c| c.background_dn = [2.0, -0.1], "background_dn", "must be two values between 0 and 100"),
        (|c| c.odd_sample_shift = 0.5, "odd_sample_shift", "it must lie between -0.5 and 0.5"),
        (|c| c.noise_sd_dn = 0.3, "noise_sd_dn", "must be 0, or lie between 0.5 and 100"),
        (|c| c.noise_sd_dn = f64::INFINITY, "noise_sd_dn", "must be 0, or lie between 0.5 and 100"),
        (|c| c.noise_autocorrelation = vec![0.1; 17], "noise_autocorrelation", "must have at most 16 values"),
        (
            |c| c.noise_autocorrelation = vec![0.95],
            "noise_autocorrelation",
            "belongs to no noise that can be recorded at this noise_sd_dn",
        ),
        (
            |c| c.noise_autocorrelation = vec![f64::NAN],
            "noise_autocorrelation",
            "belongs to no noise that can be recorded at this noise_sd_dn",
        ),
    ];
    assert_eq!(Simulate::default().check(), Ok(()));
    for (change, key, problem) in cases {
        let mut config = Simulate::default();
        change(&mut config);
        assert_eq!(config.check(), Err(InvalidKey::new(key, problem)));
    }
}

#[test]
fn noise_that_nothing_can_have_is_an_error_with_a_remedy() {
    let config = Simulate { noise_autocorrelation: vec![1.0], ..bare() };
    assert_eq!(
        Flight::new(&config).unwrap_err().to_string(),
        "no noise has this spread and autocorrelation; leave `noise_autocorrelation` out"
    );
}

#[test]
fn a_job_without_keys_has_the_defaults() {
    let planned = (STAGE.parse)(toml::de::DeTable::parse("").unwrap()).unwrap();
    assert_eq!(planned.resolved, serde_json::to_value(Simulate::default()).unwrap());
    assert!((STAGE.parse)(toml::de::DeTable::parse("lines = 0").unwrap()).is_err());
    assert!((STAGE.parse)(toml::de::DeTable::parse("line = 10").unwrap()).is_err());
}
