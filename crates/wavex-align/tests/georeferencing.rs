//! A scanner of the alignment locates points as `[job.geometry]` does.

use wavex_align::scanner::{BeamSource, Scanner, ScannerBeam};
use wavex_geodesy::calibration::Calibration;
use wavex_geodesy::ellipsoid::Geodetic;
use wavex_geodesy::frames::Attitude;
use wavex_geodesy::trajectory::corrections::{CorrectionKnot, PoseOffset, TrajectoryCorrections};
use wavex_geodesy::trajectory::{Sample, Trajectory};
use wavex_line::georef::mount::{Mount, MountName};
use wavex_line::georef::transform::{Installation, to_earth};
use wavex_line::scan_line::Emission;

#[test]
fn points_are_those_of_the_georeferencing() {
    let calibration = Calibration {
        lever_arm_m: [0.4, -0.3, 1.1],
        boresight_deg: [0.3, -0.2, 1.5],
        e0: 0.05,
        e1: 1e-4,
        e2: 1e-3,
        e3: -2e-3,
        e4: 3e-3,
        e5: 0.0,
        e6: 1e-3,
        e7: -0.02,
        time_offset_s: 0.25,
    };
    let sample = |k: i32| Sample {
        time_s: f64::from(k),
        place: Geodetic { latitude_rad: 0.8 + 1e-5 * f64::from(k), longitude_rad: -2.0, height_m: 900.0 },
        attitude: Attitude { roll_rad: 0.05, pitch_rad: -0.03 + 1e-3 * f64::from(k), heading_rad: 2.0 },
    };
    let trajectory = Trajectory::new((0..6).map(sample).collect()).unwrap();
    let offset =
        PoseOffset { north_east_down_m: [0.1, -0.2, 0.3], roll_pitch_heading_rad: [1e-3, -2e-3, 3e-3] };
    let corrections = TrajectoryCorrections::new(vec![CorrectionKnot { time_s: 0.0, offset }]).unwrap();
    for mount in [Mount::Named(MountName::Level), Mount::Named(MountName::XDownZLeft)] {
        let scanner = Scanner { body_from_mount: mount.body_from_scanner(), calibration };
        let installation = Installation::new(&mount, &calibration);
        for (direction, low) in [([0.6, 0.48, 0.64], false), ([0.8, 0.0, -0.6], true)] {
            let source = BeamSource { origin_m: [0.125, 0.0, -0.25], on_low_power_scale: low };
            let beam = ScannerBeam { time_s: 2.5, direction, range_m: 1000.0 };
            let mut poses = trajectory.poses();
            let found = scanner.locate(&source, &beam, &mut poses, Some(&corrections)).unwrap();
            let pose = corrections.at(2.75).applied_to(&trajectory.pose(2.75).unwrap());
            let mut emission = Emission { origin_m: [0.125, 0.0, -0.25], direction, ..Emission::default() };
            installation.to_body(&mut emission);
            to_earth(&mut emission, &pose);
            let range_m = calibration.range_m(1000.0, low);
            let expected: [f64; 3] =
                std::array::from_fn(|axis| emission.origin_m[axis] + emission.direction[axis] * range_m);
            let is_near = found.iter().zip(expected).all(|(found, expected)| (found - expected).abs() < 1e-8);
            assert!(is_near, "{mount:?}: {found:?} {expected:?}");
        }
    }
}
