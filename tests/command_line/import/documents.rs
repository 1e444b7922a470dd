//! Every example of both documents, run on simulated inputs with the documents' file names.

use std::borrow::Cow;
use std::collections::BTreeSet;
use std::sync::OnceLock;

use super::examples::EXAMPLES;
use super::runs::{leaves, wavex};
use super::truth::{self, Truth, agrees_with_truth};
use wavex_geodesy::crs::{Crs, Named};
use wavex_geodesy::ellipsoid::Geodetic;
use wavex_geodesy::frames::{Attitude, rotation_of_angles, then};
use wavex_testkit::las::Las;
use wavex_testkit::{Outcome, TestFolder};

/// Pulses per LAS file.
const PULSES: usize = 300;
/// Pulses per flight: slightly more than calibration requires.
const FLOWN: u64 = 2 * 120;
/// Size of an SBET record, which starts with its time, bytes.
const SBET_RECORD: usize = 136;

/// Adjusted GPS time at the start of the flights' week, s.
const WEEK_BEGINS_S: f64 = 2365.0 * 604_800.0 - 1e9;
/// Delay of the UTC clock relative to GPS time: leap seconds plus a clock error.
const LATE_S: f64 = 18.0 + 0.72;

/// A recorded flight with its trajectory in two formats.
#[derive(Clone)]
struct Flight {
    recording: Vec<u8>,
    sbet: Vec<u8>,
    pof: Vec<u8>,
    /// Table of true returns.
    truth: String,
}

impl Flight {
    /// A flight with two to three pulses in the air.
    fn new(keys: &str) -> Flight {
        let place = TestFolder::new();
        let job = format!(
            "[[stage]]\ntype = 'simulate'\nstem = 'data'\nlines = 2\nshots_per_line = 120\nas_recorded = true\n\
             pulse_rate_hz = 300000\nmodulation_ns = 15.0\nflying_height_m = 1000.0\npof = '*.pof'\nsbet = '*.out'\ntruth = '*.csv'\n\
             {keys}\n\
             [[stage]]\ntype = 'write_arrow'\n"
        );
        assert_eq!(place.run(&job), Outcome::success());
        let [recording, sbet, pof] = ["arrow", "out", "pof"]
            .map(|ending| std::fs::read(place.path(&format!("out/data.{ending}"))).unwrap());
        Flight { recording, sbet, pof, truth: place.text("out/data.csv") }
    }

    /// A flight in Bavaria, from 10:00 on 6 May 2025.
    fn usual() -> &'static Flight {
        static FLIGHT: OnceLock<Flight> = OnceLock::new();
        FLIGHT.get_or_init(|| Flight::new("heading_deg = 110.0\npitch_deg = 2.0\nyaw_deg = 3.0"))
    }

    /// The trajectory with shifted times.
    fn sbet_later(&self, seconds: f64) -> Vec<u8> {
        let mut bytes = self.sbet.clone();
        for record in bytes.chunks_exact_mut(SBET_RECORD) {
            let time = f64::from_le_bytes(record[..8].try_into().unwrap()) + seconds;
            record[..8].copy_from_slice(&time.to_le_bytes());
        }
        bytes
    }

    /// The trajectory as text: longitude, latitude, height, adjusted time, pitch, heading.
    fn text(&self) -> String {
        let row = |record: &[u8]| {
            let value =
                |index: usize| f64::from_le_bytes(record[8 * index..8 * index + 8].try_into().unwrap());
            let [latitude, longitude, pitch] = [1, 2, 8].map(|index| value(index).to_degrees());
            let heading = (value(9) - value(10)).to_degrees();
            let (time, height) = (WEEK_BEGINS_S + value(0), value(3));
            format!("{longitude:.10} {latitude:.10} {height:.4} {time:.6} {pitch:.7} {heading:.7}\n")
        };
        self.sbet.chunks_exact(SBET_RECORD).map(row).collect()
    }
}

/// UTM zone 33 north as WKT.
const PROJ: &str = r#"PROJCS["WGS 84 / UTM zone 33N",GEOGCS["WGS 84",DATUM["WGS_1984",
SPHEROID["WGS 84",6378137,298.257223563]],PRIMEM["Greenwich",0],UNIT["degree",0.0174532925199433]],
PROJECTION["Transverse_Mercator"],PARAMETER["latitude_of_origin",0],PARAMETER["central_meridian",15],
PARAMETER["scale_factor",0.9996],PARAMETER["false_easting",500000],PARAMETER["false_northing",0],UNIT["metre",1]]"#;

/// Lever arm, boresight, and e0 to e5.
const CAL: &str = "0.1 -0.2 0.3\n0.01 0.02 -0.03\n0 0 0 0 0 0\n";
/// The same as keys of the simulation, for an aircraft with large roll, pitch and yaw.
const INSTALLED: &str = "heading_deg = 110.0\nroll_deg = 15.0\npitch_deg = 15.0\nyaw_deg = 15.0\n\
                         motion_period_s = 1.0\n\
                         lever_arm_m = [0.1, -0.2, 0.3]\nboresight_deg = [0.01, 0.02, -0.03]\n";
/// Mounting angles, applied after the boresight.
const MOUNT_DEG: [f64; 3] = [0.5, -0.25, 0.0];
const US_SURVEY_FOOT_M: f64 = 1200.0 / 3937.0;
/// Height of the geoid above the ellipsoid.
const GEOID_M: f64 = 46.0;

/// An NGS grid around the flight, 46 m above the ellipsoid.
fn geoid() -> Vec<u8> {
    let mut bytes = Vec::new();
    [46.0f64, 11.0, 1.0, 1.0].iter().for_each(|value| bytes.extend(value.to_le_bytes()));
    [4i32, 4, 1].iter().for_each(|value| bytes.extend(value.to_le_bytes()));
    (0..16).for_each(|_| bytes.extend((GEOID_M as f32).to_le_bytes()));
    bytes
}

/// Flight of an example of version 1.1.
fn flight(name: &str) -> Cow<'static, Flight> {
    match name {
        "1.1-07" => Cow::Owned(Flight::new(INSTALLED)),
        "1.1-08" => {
            let turned = |degrees: [f64; 3]| rotation_of_angles(degrees.map(f64::to_radians));
            let both = Attitude::of(&then(&turned([0.01, 0.02, -0.03]), &turned(MOUNT_DEG)));
            let [roll, pitch, yaw] = [both.roll_rad, both.pitch_rad, both.heading_rad].map(f64::to_degrees);
            let (before, _) = INSTALLED.split_once("boresight").unwrap();
            Cow::Owned(Flight::new(&format!(
                "start_deg = [147.0, -35.0]\n{before}boresight_deg = [{roll}, {pitch}, {yaw}]"
            )))
        }
        "1.1-09" => Cow::Owned(Flight::new(&format!("start_time_s = 82350.0\n{INSTALLED}"))),
        _ => Cow::Borrowed(Flight::usual()),
    }
}

/// Inputs of an example, by number, and the truth.
fn inputs(name: &str) -> (TestFolder, Vec<Truth>) {
    if name.starts_with("1.0") {
        return inputs_of_1_0(name);
    }
    let flight = flight(name);
    let sdf = match name {
        "1.1-09" => "indir/250504_225230.sdf",
        "1.1-04" | "1.1-05" | "1.1-06" | "1.1-07" | "1.1-08" => "indir/data.sdf",
        _ => "data.sdf",
    };
    let place = TestFolder::with(&[(sdf, &flight.recording)]);
    let write = |files: &[(&str, &[u8])]| files.iter().for_each(|(file, bytes)| place.write(file, bytes));
    match name {
        "1.1-01" | "1.1-02" | "1.1-03" => write(&[("file.pof", &flight.pof)]),
        "1.1-04" => write(&[("indir/file.pof", &flight.pof)]),
        "1.1-05" => write(&[("podir/file.pof", &flight.pof)]),
        "1.1-06" => {
            write(&[("sbet.out", &flight.sbet), ("proj.txt", PROJ.as_bytes()), ("G2012BU0.bin", &geoid())])
        }
        "1.1-07" => {
            write(&[("sbet.out", &flight.sbet), ("proj.txt", PROJ.as_bytes()), ("cal.txt", CAL.as_bytes())])
        }
        "1.1-08" => {
            let [roll, pitch, yaw] = MOUNT_DEG;
            let mount = format!("{roll} {pitch} {yaw}\n");
            write(&[("sbet.out", &flight.sbet), ("cal.txt", CAL.as_bytes()), ("mnt.txt", mount.as_bytes())]);
        }
        // Sunday 22:52:30 on a UTC clock that is 0.72 s slow.
        "1.1-09" => write(&[("sbet.out", &flight.sbet_later(LATE_S)), ("cal.txt", CAL.as_bytes())]),
        "1.1-10" | "1.1-11" => write(&[("file.txt", flight.text().as_bytes())]),
        _ => (),
    }
    let in_scanner = matches!(name, "1.1-12" | "1.1-13");
    let mut truth = truth::of_flight(&flight.truth, &flight.recording, in_scanner);
    // The file name or the trajectory contains the date, so times are adjusted GPS times.
    let later_s = match name {
        "1.1-01" | "1.1-02" | "1.1-03" | "1.1-04" | "1.1-05" | "1.1-10" | "1.1-11" => WEEK_BEGINS_S,
        "1.1-09" => WEEK_BEGINS_S + LATE_S,
        _ => 0.0,
    };
    truth.iter_mut().for_each(|truth| truth.time_s += later_s);
    (place, truth)
}

/// The same for version 1.0.
fn inputs_of_1_0(name: &str) -> (TestFolder, Vec<Truth>) {
    let (path, odd_sample_shift) = match name {
        // On other systems, the Windows path is a plain name.
        "1.0-03" => (r"F:\indir/waveform.las", 0.0),
        "1.0-04" => ("titan_C3.las", -0.25),
        "1.0-05" => ("LDR100301_120340_4.LAS", 0.0),
        _ => ("waveform.las", 0.0),
    };
    let recording = Las::with_odd_sample_shift(PULSES, odd_sample_shift);
    let packets = format!("{}.wdp", &path[..path.len() - 4]);
    let place = TestFolder::with(&[(path, &recording.las()), (&packets, &recording.packets)]);
    (place, truth::of_pulses(PULSES))
}

/// Conversion from an example's coordinates to those of the truth, m.
fn in_map(name: &str) -> Box<dyn Fn([f64; 3]) -> [f64; 3]> {
    match name {
        "1.1-06" => Box::new(|[x, y, z]| [x, y, z + GEOID_M]),
        "1.1-08" => Box::new(|place| place.map(|feet| feet * US_SURVEY_FOOT_M)),
        "1.1-11" => {
            let named = Named::UtmZone { zone: 33, north: true };
            let anywhere = Geodetic { longitude_rad: 0.22, latitude_rad: 0.83, height_m: 0.0 };
            let crs = Crs::new(&named, anywhere, None, None).unwrap();
            Box::new(move |[longitude, latitude, height_m]| {
                let (longitude_rad, latitude_rad) = (longitude.to_radians(), latitude.to_radians());
                crs.from_geodetic(Geodetic { longitude_rad, latitude_rad, height_m }).unwrap()
            })
        }
        _ => Box::new(|place| place),
    }
}

/// Output files of an example besides log and report; the first one contains its points.
fn outputs(name: &str) -> &'static [&'static str] {
    match name {
        "1.0-01" | "1.0-04" | "1.0-05" => &["points.laz"],
        "1.0-02" => &["points.laz", "points_traj.txt", "points_stat.txt"],
        "1.0-03" => &[r"E:\outdir/points.laz"],
        "1.1-01" => &["data.laz", "data_traj.txt", "data_stat.log"],
        "1.1-02" => &["data.laz", "data_traj.txt", "data_lstat.txt", "data_stat.log"],
        "1.1-03" => &["data.las", "data.lax", "data_traj.txt", "data_lstat.txt", "data_stat.log"],
        "1.1-04" => &[
            "outdir/data_abc.laz",
            "outdir/data_abc_traj.txt",
            "outdir/data_abc_lstat.txt",
            "outdir/data_abc_stat.log",
        ],
        "1.1-05" | "1.1-06" | "1.1-07" | "1.1-08" => {
            &["outdir/data.laz", "outdir/data_traj.txt", "outdir/data_stat.log"]
        }
        "1.1-09" => &["outdir/250504_225230.laz", "outdir/250504_225230_traj.txt"],
        "1.1-12" | "1.1-13" => &["data.laz", "data_stat.log"],
        _ => &[],
    }
}

/// Runs an example; asserts its files and that points lie at the true returns.
#[track_caller]
fn runs(name: &str) -> TestFolder {
    let (place, truth) = inputs(name);
    let line = EXAMPLES.iter().find(|(example, _)| *example == name).unwrap().1;
    let files = outputs(name);
    leaves(&place, line, files);
    agrees_with_truth(name, &truth::points(&place, files[0]), &truth, in_map(name));
    place
}

#[test]
fn the_lines_of_version_1_0() {
    for name in ["1.0-01", "1.0-02", "1.0-04", "1.0-05"] {
        runs(name);
    }
}

#[cfg(unix)]
#[test]
fn the_line_of_version_1_0_with_folders_of_windows() {
    runs("1.0-03");
}

#[test]
fn the_lines_of_version_1_1_with_a_pof() {
    for name in ["1.1-01", "1.1-02", "1.1-03", "1.1-04", "1.1-05"] {
        runs(name);
    }
}

#[test]
fn the_lines_of_version_1_1_with_an_sbet() {
    for name in ["1.1-06", "1.1-07"] {
        runs(name);
    }
}

#[test]
fn the_line_with_a_zone_and_feet() {
    runs("1.1-08");
}

#[test]
fn the_line_with_a_clock_of_utc() {
    let text = runs("1.1-09").text("outdir/250504_225230_traj.txt");
    let first: f64 = text.lines().nth(1).unwrap().split(' ').next().unwrap().parse().unwrap();
    let expected = WEEK_BEGINS_S + 82_350.0 + LATE_S;
    assert!((first - expected).abs() < 1e-3, "{first} instead of {expected}");
}

/// Their columns, `xyztpk`, lack the roll: it is set to 0, with a message.
#[test]
fn the_lines_with_a_trajectory_in_text() {
    for name in ["1.1-10", "1.1-11"] {
        let (place, truth) = inputs(name);
        let line = EXAMPLES.iter().find(|(example, _)| *example == name).unwrap().1;
        let ended = wavex(&place, &format!("--run -- {line}"));
        assert_eq!(ended.code, Some(0), "{}", ended.err);
        let what = "the trajectory's columns have no roll (`w`): assuming 0; each degree of true \
                    roll displaces points";
        assert!(ended.err.contains(what), "{}", ended.err);
        agrees_with_truth(name, &truth::points(&place, "data.laz"), &truth, in_map(name));
    }
}

#[test]
fn the_lines_without_a_trajectory() {
    for name in ["1.1-12", "1.1-13"] {
        runs(name);
    }
}

#[test]
fn the_line_that_writes_nothing() {
    let (place, truth) = inputs("1.1-14");
    leaves(&place, "wavex -i data.sdf -fastest -oext 0 -nil", &["wavex_report.json"]);
    assert!(!place.path("data.laz").exists());
    let report: serde_json::Value = serde_json::from_str(&place.text("wavex_report.json")).unwrap();
    let total = |name: &str| report["inputs"][0]["totals"][name].as_u64().unwrap();
    assert_eq!([total("nw"), total("n_georef")], [FLOWN, truth.len() as u64]);
}

#[test]
fn the_line_that_scans() {
    let (place, _) = inputs("1.1-15");
    let out = leaves(&place, "wavex -sdfscan -i data.sdf -name scan", &["scan_scan.txt", "scan_scan.html"]);
    let says = |name: &str, value: &str| {
        out.lines().any(|line| {
            line.trim().strip_prefix(name).is_some_and(|rest| rest.trim_start().starts_with(value))
        })
    };
    for (name, value) in [("shots", "240"), ("scan lines", "2"), ("shots per line", "120"), ("blocks", "240")]
    {
        assert!(says(name, value), "{name} {value}: {out}");
    }
    assert!(says("pulse rate, measured", "299999.") || says("pulse rate, measured", "300000."), "{out}");
}

/// Every example has a test: those above, and three in `runs` that request information.
#[test]
fn no_example_is_forgotten() {
    let runs: BTreeSet<&str> = EXAMPLES.iter().map(|(name, _)| *name).collect();
    let v10 = (1..=5).map(|number| format!("1.0-{number:02}"));
    let v11 = (1..=18).map(|number| format!("1.1-{number:02}"));
    let known: Vec<String> = v10.chain(v11).collect();
    assert_eq!(runs.into_iter().collect::<Vec<_>>(), known.iter().map(String::as_str).collect::<Vec<_>>());
}

/// The options files printed in both documents.
#[test]
fn the_example_of_a_file_of_options() {
    let options = b"mem=4096\ndet=5\nR=1000\n";
    let (place, _) = inputs("1.0-01");
    place.write("wavex.opt", options);
    leaves(&place, "wavex -i waveform.las", &["out.laz"]);
    let (place, _) = inputs("1.1-12");
    place.write("wavex.opt.txt", options);
    leaves(&place, "wavex -i data.sdf", &["data.laz"]);
}
