//! Sound flights pass every plausibility check.

use wavex_testkit::georeferenced_flight::run;
use wavex_testkit::plausibility::alarms;

/// Flights: name, and keys of the simulation.
const FLIGHTS: &[(&str, &str)] = &[
    ("airplane", "flying_height_m = 600.0\nroll_deg = 4.0\npitch_deg = 3.0\nyaw_deg = 5.0"),
    (
        "steep banks",
        "roll_deg = 15.0\nmotion_period_s = 8.0\nscan_angle_deg = [-20.0, 20.0]\nturn_radius_m = 400.0",
    ),
    (
        "helicopter that flies sideways",
        "flying_height_m = 150.0\nspeed_mps = 12.0\nroll_deg = 12.0\npitch_deg = 15.0\nmotion_period_s = 5.0\n\
         track_direction_deg = 80.0",
    ),
    (
        "drone",
        "flying_height_m = 30.0\nbuilding_height_m = 0.0\ncanopy_height_m = 0.0\nspeed_mps = 5.0\nroll_deg = 15.0\npitch_deg = 15.0\nyaw_deg = 15.0\n\
         motion_period_s = 3.0\npulse_rate_hz = 100e3\nscan_angle_deg = [-45.0, 45.0]\nblind_gap_ns = 0.0",
    ),
    ("circular scanner", "scanner = 'circular'\nscan_angle_deg = [-20.0, 20.0]\nroll_deg = 3.0"),
    ("hills", "landscape = 'country'\nrelief_m = 300.0\nflying_height_m = 500.0\nroll_deg = 3.0"),
];

#[test]
fn simulated_flights_are_plausible() {
    for (name, simulated) in FLIGHTS {
        let folder = tempfile::tempdir().unwrap();
        let simulated = format!(
            "[[stage]]\ntype = 'simulate'\nstem = 'a'\nlines = 40\nshots_per_line = 100\nsbet = '*.out'\n\
             {simulated}\n[[stage]]\ntype = 'write_arrow'\npath = '*.arrow'\n"
        );
        run(folder.path(), &simulated).unwrap_or_else(|error| panic!("{name}: {error}"));
        let job = "[job.geometry]\ntrajectory = 'a.out'\n[[stage]]\ntype = 'read_arrow'\npath = 'a.arrow'\n\
             [[stage]]\ntype = 'calibrate'\n[[stage]]\ntype = 'decompose'\n[[stage]]\ntype = 'georeference'\n\
             [[stage]]\ntype = 'write_las'\npath = '*.las'\n";
        let summary = run(folder.path(), job).unwrap_or_else(|error| panic!("{name}: {error}"));
        assert_eq!(alarms(&summary), Vec::<String>::new(), "{name}");
    }
}
