//! The table `[job.geometry]`.

use super::{FULL, check, check_set, parse};

#[test]
fn a_misspelt_key() {
    check(
        r#"
[job.geometry]
trajectry = "a.out"

[[stage]]
type = "simulate"
"#,
        r#"
error: `geometry` of `[job]` has no key `trajectry`
 --> job.toml:2:1
  |
2 | trajectry = "a.out"
  | ^^^^^^^^^
  |
  = help: did you mean `trajectory`?
  = help: keys: trajectory, trajectory_time, trajectory_angles, trajectory_columns, trajectory_outliers, trajectory_limits, trajectory_heights, trajectory_accuracy, mount, calibration, crs, geoid, geoid_dir, unit
"#,
    );
}

#[test]
fn a_word_that_is_none() {
    check(
        r#"
[job.geometry]
unit = "feet"

[[stage]]
type = "simulate"
"#,
        r#"
error: `unit` must be "m", "us_ft" or "ft", got "feet"
 --> job.toml:2:8
  |
2 | unit = "feet"
  |        ^^^^^^
"#,
    );
}

#[test]
fn a_key_of_a_calibration() {
    check(
        r#"
[job.geometry]
calibration = { lever_arms_m = [0.0, 0.0, 0.0] }

[[stage]]
type = "simulate"
"#,
        r#"
error: `calibration` of `geometry` of `[job]` has no key `lever_arms_m`
 --> job.toml:2:17
  |
2 | calibration = { lever_arms_m = [0.0, 0.0, 0.0] }
  |                 ^^^^^^^^^^^^
  |
  = help: did you mean `lever_arm_m`?
  = help: keys: lever_arm_m, boresight_deg, e0, e1, e2, e3, e4, e5, e6, e7
"#,
    );
}

/// Constraints checked by the table itself are also reported at the key.
#[test]
fn a_key_of_no_use_alone() {
    check(
        r#"
[job.geometry]
crs = "utm"
trajectory_time = "day"

[[stage]]
type = "simulate"
"#,
        r#"
error: `geometry.trajectory_time`: it has no effect without `trajectory`
 --> job.toml:3:19
  |
3 | trajectory_time = "day"
  |                   ^^^^^
"#,
    );
}

#[test]
fn a_length_beyond_all_aircraft() {
    check_set(
        FULL,
        &["job.geometry.calibration={ lever_arm_m = [0, 0, 101] }"],
        r#"
error: an item of `lever_arm_m` must be at least -100 and at most 100, got 101
 --> --set:1:49
  |
1 | job.geometry.calibration={ lever_arm_m = [0, 0, 101] }
  |                                                 ^^^
"#,
    );
}

/// Values without quotation marks are text, also in the nested table.
#[test]
fn overrides_reach_into_the_table() {
    let set = ["job.geometry.crs=EPSG:2154", "job.geometry.trajectory=*.out", "job.geometry.mount=[1, 2, 3]"];
    let job = parse(FULL, &set).unwrap();
    let keys = &job.settings.geometry;
    assert_eq!((keys.crs.as_deref(), keys.trajectory.as_deref()), (Some("EPSG:2154"), Some("*.out")));
    assert_eq!(keys.mount, Some(wavex::georef::mount::Mount::Angles([1.0, 2.0, 3.0])));
    check_set(
        FULL,
        &["job.geometry.crs.name=EPSG:2154"],
        r#"
error: `crs` must be text, got a table
 --> --set:1:18
  |
1 | job.geometry.crs.name=EPSG:2154
  |                  ^^^^^^^^^^^^^^
"#,
    );
}
