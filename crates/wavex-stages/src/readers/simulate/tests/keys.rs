//! What the keys may be.

use super::*;
use wavex_line::keys::InvalidKey;

#[test]
fn each_limit_has_its_message() {
    type Change = fn(&mut Simulate);
    let cases: [(Change, &str, &str); 15] = [
        (|c| c.stem = "a/b".to_owned(), "stem", "must be a file name without folders"),
        (|c| c.scan_angle_deg = [30.0, -30.0], "scan_angle_deg", "must be two ascending angles"),
        (
            |c| (c.scanner, c.scan_angle_deg) = (ScannerKind::Circular, [-30.0, 20.0]),
            "scan_angle_deg",
            "must be -a and a for a circular scanner of half angle a",
        ),
        (|c| c.modulation_ns = 3334.0, "modulation_ns", "must be below half the interval between pulses"),
        (|c| c.turn_radius_m = 99.0, "turn_radius_m", "must be 0, or at least 100 to either side"),
        (
            |c| c.start_deg = Some([0.0, 90.0]),
            "start_deg",
            "must be a longitude, and a latitude between -89 and 89",
        ),
        (|c| c.start_deg = Some([0.0, 80.0]), "start_deg", "needs a trajectory: give `sbet` or `pof`"),
        (
            |c| (c.scan_angle_deg, c.roll_deg, c.boresight_deg) = ([0.0, 60.0], 10.0, [0.0, 6.0, 0.0]),
            "scan_angle_deg",
            "must leave beams within 75 degrees of straight down, whatever roll, pitch and boresight",
        ),
        (
            |c| (c.landscape, c.relief_m, c.flying_height_m) = (Landscape::Country, 100.0, 153.9),
            "flying_height_m",
            "must be at least 30 m above all terrain and objects",
        ),
        (|c| c.high_power_noise_sd_dn = 0.4, "high_power_noise_sd_dn", "must be 0, or at least 0.5"),
        (
            |c| (c.high_power, c.high_power_noise_sd_dn, c.noise_autocorrelation) = (true, 0.5, vec![0.7]),
            "noise_autocorrelation",
            "belongs to no noise that can be recorded at this high_power_noise_sd_dn",
        ),
        (|c| c.flying_height_m = 37.0, "flying_height_m", "must be at least 20 m above building and wood"),
        (|c| c.noise_sd_dn = 0.3, "noise_sd_dn", "must be 0, or at least 0.5"),
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
        SimulatedFlight::new(&config).unwrap_err().to_string(),
        "no noise has this spread and autocorrelation; leave `noise_autocorrelation` out"
    );
}

#[test]
fn a_job_without_keys_has_the_defaults() {
    let planned = (STAGE.parse)(toml::de::DeTable::parse("").unwrap()).unwrap();
    assert_eq!(planned.resolved, serde_json::to_value(Simulate::default()).unwrap());
    assert!((STAGE.parse)(toml::de::DeTable::parse("stem = ''").unwrap()).is_err());
    assert!((STAGE.parse)(toml::de::DeTable::parse("line = 10").unwrap()).is_err());
}
