//! Recordings without a trajectory or in a map, and effects of the calibration on ranges and
//! angles.

use wavex_formats::trajectory::sbet::RECORD_BYTES;

use super::flights::QUIET;
use wavex_testkit::georeferenced_flight::{Flight, distance_m, fly, run};
use wavex_testkit::{Outcome, outcome, wavex};

const GEOREFERENCE: &str = "[[stage]]\ntype = 'calibrate'\nwaveforms = 500\nresponse = 'gaussian'\n\
                            [[stage]]\ntype = 'decompose'\n[[stage]]\ntype = 'georeference'\n";

/// The flight in map coordinates, without a trajectory.
#[track_caller]
fn in_map(geometry: &str) -> Result<(), String> {
    let folder = tempfile::tempdir().unwrap();
    let job = format!(
        "[job.geometry]\n{geometry}\n[[stage]]\ntype = 'simulate'\nlines = 12\nshots_per_line = 60\n{GEOREFERENCE}"
    );
    run(folder.path(), &job).map(|_| ())
}

#[test]
fn a_recording_in_a_map_stays_there() {
    assert_eq!(in_map(""), Ok(()));
    for same in ["crs = 'utm'", "crs = 'utm:33N'", "crs = 'EPSG:32633'", "unit = 'm'"] {
        assert_eq!(in_map(same), Ok(()), "{same}");
    }
    let refused = "stage georeference: the beams of this recording are already in WGS 84 / UTM zone 33N, \
                   but `[job.geometry]` requests other coordinates; remove `crs`, `geoid` and `unit`, and \
                   transform the points with another program, such as PDAL";
    for other in ["crs = 'utm:32N'", "crs = 'geodetic'", "unit = 'ft'"] {
        assert_eq!(in_map(other), Err(refused.to_owned()), "{other}");
    }
}

#[test]
fn coordinates_need_a_trajectory() {
    let flight = fly(QUIET);
    let error = flight.place("crs = 'EPSG:2154'", |truth| truth.range_m).err().unwrap();
    assert_eq!(
        error,
        "`[job.geometry]` requests coordinates, but this recording is not georeferenced; set its \
         `trajectory`, or remove `crs`, `geoid` and `unit`"
    );
}

/// Without a trajectory, points are in the aircraft's axes if any mounting or calibration is given.
#[test]
fn points_stand_in_the_aircraft() {
    let flight = fly(&format!("{QUIET}scan_angle_deg = [-20.0, 20.0]"));
    let plain = flight.place("", |truth| truth.range_m).unwrap();
    let notes = |placed: &wavex_testkit::georeferenced_flight::Placed| placed.cx.counters().notes.clone();
    let expected = |axes: &str| {
        format!(
            "the input is not georeferenced: its points are in the {axes}; give [job.geometry] a `trajectory` and a `crs`"
        )
    };
    assert_eq!(notes(&plain), [expected("scanner frame")]);
    assert!(plain.points.iter().zip(&flight.truth).all(|(point, truth)| {
        let length_m = distance_m(*point, [0.0; 3]);
        point[0] == 0.0 && (length_m - truth.range_m).abs() < 1e-9
    }));
    let installed = flight
        .place("calibration = { lever_arm_m = [1.0, 2.0, 3.0] }\nmount = [0, 0, 90]", |truth| truth.range_m)
        .unwrap();
    assert_eq!(notes(&installed), [expected("body frame of the aircraft")]);
    for (point, [x, y, z]) in installed.points.iter().zip(&plain.points) {
        assert!(distance_m(*point, [1.0 - y, 2.0 + x, 3.0 + z]) < 1e-9, "a yaw of 90 degrees to the right");
    }
}

#[test]
fn a_dummy_velocity_lays_lines_side_by_side() {
    let flight = fly(QUIET);
    let job = "[[stage]]\ntype = 'read_arrow'\npath = 'a.arrow'\n[[stage]]\ntype = 'calibrate'\nwaveforms = 500\n\
               response = 'gaussian'\n[[stage]]\ntype = 'decompose'\n\
               [[stage]]\ntype = 'georeference'\ndummy_velocity_mps = 50.0\n\
               [[stage]]\ntype = 'write_table'\npath = 'a.csv'\n";
    run(flight.folder(), job).unwrap();
    let text = std::fs::read_to_string(flight.path("a.csv")).unwrap();
    let names: Vec<&str> = text.lines().next().unwrap().split(',').collect();
    let column = |name: &str| names.iter().position(|other| *other == name).unwrap();
    let (x, time) = (column("x"), column("gps_time_s"));
    for row in text.lines().skip(1) {
        let cells: Vec<&str> = row.split(',').collect();
        let since_s = cells[time].parse::<f64>().unwrap() - 208_800.0;
        assert!((cells[x].parse::<f64>().unwrap() - 50.0 * since_s).abs() < 1e-6, "{row}");
    }
}

/// Ranges distorted by the inverse of the calibration formula are corrected.
#[test]
fn ranges_are_corrected_by_the_calibration() {
    let flight = fly(QUIET);
    let keys = "trajectory = '*.out'\ncalibration = { e0 = 0.25, e1 = 2e-4, e7 = -0.1 }";
    let placed = flight.place(keys, |truth| (truth.range_m - 0.15) / (1.0 + 2e-4)).unwrap();
    for ((point, r), truth) in placed.points.iter().zip(&placed.returns).zip(&flight.truth) {
        assert!(distance_m(*point, truth.point_m) < 1e-3);
        assert!((r.range_m - truth.range_m).abs() < 1e-9, "the table contains the corrected range");
    }
}

/// A calibration file of the classic program is equivalent to inline keys.
#[test]
fn a_calibration_may_stand_in_a_file() {
    let keys = "roll_deg = 8.0\nlever_arm_m = [0.8, -0.35, 1.1]\nboresight_deg = [0.4, -0.7, 1.3]\n";
    let flight: Flight = fly(&format!("{QUIET}{keys}"));
    std::fs::write(flight.path("calib.txt"), "0.8 -0.35 1.1\n0.4 -0.7 1.3\n0 0 0 0 0 0\n").unwrap();
    let placed =
        flight.place("trajectory = 'a.pof'\ncalibration = 'calib.txt'", |truth| truth.range_m).unwrap();
    let off = placed.points.iter().zip(&flight.truth).map(|(point, truth)| distance_m(*point, truth.point_m));
    assert!(off.fold(0.0, f64::max) < 1e-3);
    let error = flight.place("trajectory = 'a.out'\ncalibration = 'none.txt'", |t| t.range_m).err().unwrap();
    assert!(error.contains("none.txt: cannot open: "), "{error}");
}

/// A text in radians gives the same attitudes as in degrees; read as degrees it gives others.
#[test]
fn a_text_with_angles_in_radians_gives_the_same_points() {
    let flight = fly(&format!("{QUIET}roll_deg = 8.0\npitch_deg = 5.0\nheading_deg = 70.0\n"));
    let bytes = std::fs::read(flight.path("a.out")).unwrap();
    let (records, _) = bytes.as_chunks::<RECORD_BYTES>();
    let text = |angle: fn(f64) -> f64| -> String {
        let row = |bytes: &[u8; RECORD_BYTES]| {
            let value =
                |index: usize| f64::from_le_bytes(bytes[8 * index..8 * index + 8].try_into().unwrap());
            let [latitude, longitude] = [1, 2].map(|index| value(index).to_degrees());
            let heading = value(9) - value(10);
            let [roll, pitch, heading] = [value(7), value(8), heading].map(angle);
            format!(
                "{:.9} {longitude:.12} {latitude:.12} {:.6} {roll:.12} {pitch:.12} {heading:.12}\n",
                value(0),
                value(3)
            )
        };
        records.iter().map(row).collect()
    };
    std::fs::write(flight.path("degrees.txt"), text(f64::to_degrees)).unwrap();
    std::fs::write(flight.path("radians.txt"), text(|radians| radians)).unwrap();
    let place = |keys: &str| {
        let keys = format!("trajectory_columns = 'txyzwpk'\n{keys}");
        flight.place(&keys, |truth| truth.range_m).unwrap().points
    };
    let degrees = place("trajectory = 'degrees.txt'");
    let farthest_m = |points: &[[f64; 3]]| {
        assert!(points.len() > 4000 && points.len() == degrees.len());
        points.iter().zip(&degrees).map(|(a, b)| distance_m(*a, *b)).fold(0.0, f64::max)
    };
    let right_m = farthest_m(&place("trajectory = 'radians.txt'\ntrajectory_angles = 'rad'"));
    let wrong_m = farthest_m(&place("trajectory = 'radians.txt'"));
    assert!(right_m < 1e-3 && wrong_m > 10.0, "{right_m} {wrong_m}");
}

/// A recording with its own positions ignores a trajectory and says so.
#[test]
fn a_place_is_given_once() {
    let flight = fly(QUIET);
    let posed = "[[stage]]\ntype = 'read_arrow'\npath = 'a.arrow'\n[[stage]]\ntype = 'write_arrow'\npath = 'b.arrow'\n";
    let with = |keys: &str, stages: &str| {
        run(flight.folder(), &format!("[job.geometry]\n{keys}\n{stages}")).unwrap()
    };
    with("trajectory = 'a.out'", posed);
    std::fs::rename(flight.path("b.arrow"), flight.path("a.arrow")).unwrap();
    let placed = flight.place("calibration = { e0 = 1.0 }", |truth| truth.range_m - 1.0).unwrap();
    let off = placed.points.iter().zip(&flight.truth).map(|(point, truth)| distance_m(*point, truth.point_m));
    assert!(off.fold(0.0, f64::max) < 1e-3, "a container keeps the poses");
    assert_eq!(placed.cx.counters().notes, Vec::<String>::new(), "ranges are corrected");
    let report = with("trajectory = 'missing.out'", posed);
    assert_eq!(
        report.inputs[0].stages[0].notes,
        ["the recording is already georeferenced: `trajectory` is not used; remove it from `[job.geometry]`"]
    );
    let report = with("mount = 'x_down_z_left'", "[[stage]]\ntype = 'simulate'\nlines = 1\n");
    assert_eq!(
        report.inputs[0].stages[0].notes,
        ["the recording is already in a projected CRS: `mount` is not used; remove it from `[job.geometry]`"]
    );
}

/// Beams already in the aircraft's axes cannot be mounted, and a map needs no trajectory.
#[test]
fn a_mount_is_for_scanners() {
    let flight = fly(QUIET).in_body();
    let mounted = |mount: &str| {
        flight.place(&format!("trajectory = 'a.out'\nmount = '{mount}'"), |truth| truth.range_m)
    };
    let error = mounted("x_down_z_right").err().unwrap();
    assert_eq!(
        error,
        "the beams of this recording are already in body axes, but `[job.geometry]` has a `mount`; remove \
         `mount`"
    );
    // An identity mount has no effect.
    for placed in [flight.place("trajectory = 'a.out'", |truth| truth.range_m), mounted("level")] {
        let placed = placed.unwrap();
        let off =
            placed.points.iter().zip(&flight.truth).map(|(point, truth)| distance_m(*point, truth.point_m));
        assert!(off.fold(0.0, f64::max) < 1e-3);
    }
}

/// Unreadable files and invalid coordinate systems are reported before the run starts.
#[test]
fn what_the_table_names_must_be_there() {
    let flight = fly(QUIET);
    let refused = |keys: &str| {
        let error = flight.place(keys, |truth| truth.range_m).err().unwrap();
        error.replace(&format!("{}/", flight.folder().display()), "")
    };
    assert!(refused("trajectory = 'b.out'").starts_with("b.out: cannot open: "));
    assert!(
        refused("trajectory = 'a.csv'").starts_with("a.csv: it is text, but its columns are not defined")
    );
    assert_eq!(
        refused("crs = 'EPSG:99999'"),
        "EPSG:99999 is not in the table of coordinate reference systems; check the code, or use a WKT file"
    );
    assert!(refused("crs = 'zone.prj'").starts_with("zone.prj: cannot open: "));
    std::fs::write(flight.path("huge.prj"), " ".repeat(1_000_001)).unwrap();
    assert_eq!(
        refused("crs = 'huge.prj'"),
        "huge.prj: 1000001 bytes is too large for WKT; give the .prj or .wkt file of a coordinate \
         reference system"
    );
    assert!(refused("crs = 'utm:61N'").starts_with("crs `utm:61N`: a zone is a number from 1 to 60"));
    assert!(refused("geoid = 'egm96'").contains("there is no geoid `egm96` in this folder"));
}

/// `wavex explain` uses the same poses as a run of the job.
#[test]
fn explain_reads_the_trajectory_of_the_job() {
    let flight = fly("lines = 12\nshots_per_line = 60\nresponse = 'gaussian'");
    let explain = |trajectory: &str| {
        let job = format!(
            "[job.geometry]\ntrajectory = '{trajectory}'\n[[stage]]\ntype = 'read_arrow'\npath = 'a.arrow'\n{GEOREFERENCE}"
        );
        std::fs::write(flight.path("job.toml"), job).unwrap();
        let arguments = ["--quiet", "explain", "a.arrow", "--shot", "5", "--job", "job.toml"];
        let Outcome { code, err, .. } = outcome(wavex().args(arguments).current_dir(flight.folder()));
        (code, err)
    };
    assert_eq!(explain("a.out"), (Some(0), String::new()));
    let (code, error) = explain("b.out");
    assert_eq!(code, Some(1));
    assert!(error.contains("b.out: cannot open: "), "{error}");
}
