//! Every example of both documents, run on simulated inputs with the documents' names.

use std::collections::BTreeSet;
use std::sync::OnceLock;

use crate::examples::EXAMPLES;
use crate::runs::{header, leaves, wavex};
use crate::support::las::Las;
use crate::support::{Outcome, Place};

/// How many pulses there are in each LAS file.
const PULSES: u64 = 300;
/// How many there are in each flight: few more than a calibration needs.
const FLOWN: u64 = 2 * 120;
/// Bytes of a record of an SBET, which begins with its time.
const SBET_RECORD: usize = 136;

/// A flight, as recorded, with its trajectory in two formats.
struct Flight {
    recording: Vec<u8>,
    sbet: Vec<u8>,
    pof: Vec<u8>,
}

impl Flight {
    /// A flight with two to three pulses in the air.
    fn new(keys: &str) -> Flight {
        let place = Place::new();
        let job = format!(
            "[[stage]]\ntype = 'simulate'\nstem = 'data'\nlines = 2\nshots_per_line = 120\nas_recorded = true\n\
             pulse_rate_hz = 300000\nmodulation_ns = 15.0\nflying_height_m = 1000.0\npof = '*.pof'\nsbet = '*.out'\n{keys}\n\
             [[stage]]\ntype = 'write_arrow'\n"
        );
        assert_eq!(place.run(&job), Outcome { code: Some(0), err: String::new() });
        let [recording, sbet, pof] = ["arrow", "out", "pof"]
            .map(|ending| std::fs::read(place.path(&format!("out/data.{ending}"))).unwrap());
        Flight { recording, sbet, pof }
    }

    /// In Bavaria, on 6 May 2025 from 10 o'clock on.
    fn usual() -> &'static Flight {
        static FLIGHT: OnceLock<Flight> = OnceLock::new();
        FLIGHT.get_or_init(|| Flight::new(""))
    }

    /// The trajectory with its times so much later.
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
        let week_begins = 2365.0 * 604_800.0 - 1e9;
        let row = |record: &[u8]| {
            let value =
                |index: usize| f64::from_le_bytes(record[8 * index..8 * index + 8].try_into().unwrap());
            let [latitude, longitude, pitch] = [1, 2, 8].map(|index| value(index).to_degrees());
            let heading = (value(9) - value(10)).to_degrees();
            let (time, height) = (week_begins + value(0), value(3));
            format!("{longitude:.10} {latitude:.10} {height:.4} {time:.6} {pitch:.7} {heading:.7}\n")
        };
        self.sbet.chunks_exact(SBET_RECORD).map(row).collect()
    }
}

/// UTM zone 33 north, spelled out.
const PROJ: &str = r#"PROJCS["WGS 84 / UTM zone 33N",GEOGCS["WGS 84",DATUM["WGS_1984",
SPHEROID["WGS 84",6378137,298.257223563]],PRIMEM["Greenwich",0],UNIT["degree",0.0174532925199433]],
PROJECTION["Transverse_Mercator"],PARAMETER["latitude_of_origin",0],PARAMETER["central_meridian",15],
PARAMETER["scale_factor",0.9996],PARAMETER["false_easting",500000],PARAMETER["false_northing",0],UNIT["metre",1]]"#;

/// Lever arm, boresight, and e0 to e5.
const CAL: &str = "0.1 -0.2 0.3\n0.01 0.02 -0.03\n0.05 0 0 0 0 0\n";

/// A grid of NGS over the flight, 46 m above the ellipsoid.
fn geoid() -> Vec<u8> {
    let mut bytes = Vec::new();
    [46.0f64, 11.0, 1.0, 1.0].iter().for_each(|value| bytes.extend(value.to_le_bytes()));
    [4i32, 4, 1].iter().for_each(|value| bytes.extend(value.to_le_bytes()));
    (0..16).for_each(|_| bytes.extend(46.0f32.to_le_bytes()));
    bytes
}

/// The inputs of a line, by its number.
fn inputs(name: &str) -> Place {
    let recording = Las::new(PULSES as usize);
    let las = |path: &str| {
        Place::with(&[
            (path, &recording.las()),
            (&format!("{}.wdp", &path[..path.len() - 4]), &recording.packets),
        ])
    };
    let flight = Flight::usual();
    let of = |files: &[(&str, &[u8])]| Place::with(files);
    match name {
        "1.0-01" | "1.0-02" => las("waveform.las"),
        // The path of Windows is a name elsewhere.
        "1.0-03" => las(r"F:\indir/waveform.las"),
        "1.0-04" => las("titan_C3.las"),
        "1.0-05" => las("LDR100301_120340_4.LAS"),
        "1.1-01" | "1.1-02" | "1.1-03" => of(&[("data.sdf", &flight.recording), ("file.pof", &flight.pof)]),
        "1.1-04" => of(&[("indir/data.sdf", &flight.recording), ("indir/file.pof", &flight.pof)]),
        "1.1-05" => of(&[("indir/data.sdf", &flight.recording), ("podir/file.pof", &flight.pof)]),
        "1.1-06" | "1.1-07" => of(&[
            ("indir/data.sdf", &flight.recording),
            ("sbet.out", &flight.sbet),
            ("proj.txt", PROJ.as_bytes()),
            ("cal.txt", CAL.as_bytes()),
            ("G2012BU0.bin", &geoid()),
        ]),
        "1.1-08" => {
            let flight = Flight::new("start_deg = [147.0, -35.0]");
            of(&[
                ("indir/data.sdf", &flight.recording),
                ("sbet.out", &flight.sbet),
                ("cal.txt", CAL.as_bytes()),
                ("mnt.txt", b"0.5 -0.25 0\n"),
            ])
        }
        "1.1-09" => {
            // Sunday, 22:52:30 of a clock that counts UTC and is 0.72 s late.
            let flight = Flight::new("start_time_s = 82350.0");
            of(&[
                ("indir/250504_225230.sdf", &flight.recording),
                ("sbet.out", &flight.sbet_later(18.72)),
                ("cal.txt", CAL.as_bytes()),
            ])
        }
        "1.1-10" | "1.1-11" => of(&[("data.sdf", &flight.recording), ("file.txt", flight.text().as_bytes())]),
        "1.1-12" | "1.1-13" | "1.1-14" | "1.1-15" => of(&[("data.sdf", &flight.recording)]),
        _ => Place::new(),
    }
}

/// The files that a line leaves besides the log and the report; the first holds its points.
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

/// Runs a line, which leaves its points and other files.
#[track_caller]
fn runs(name: &str) -> (Place, u64, f64) {
    let place = inputs(name);
    let line = EXAMPLES.iter().find(|(example, _)| *example == name).unwrap().1;
    let files = outputs(name);
    leaves(&place, line, files);
    let (_, points, easting) = header(&place, files[0]);
    assert!(points >= FLOWN * 8 / 10, "{name}: {points} points");
    (place, points, easting)
}

#[test]
fn the_lines_of_version_1_0() {
    for name in ["1.0-01", "1.0-02", "1.0-04", "1.0-05"] {
        assert_eq!(runs(name).1, PULSES, "{name}: an echo of each pulse");
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
        let (_, _, easting) = runs(name);
        assert!((319_000.0..321_000.0).contains(&easting), "{name}: {easting} is no easting of this flight");
    }
}

#[test]
fn the_lines_of_version_1_1_with_an_sbet() {
    let (place, _, easting) = runs("1.1-06");
    assert!((319_000.0..321_000.0).contains(&easting), "{easting}");
    let lowest = |place: &Place| {
        let bytes = std::fs::read(place.path("outdir/data.laz")).unwrap();
        f64::from_le_bytes(bytes[219..227].try_into().unwrap())
    };
    let (other, _, _) = runs("1.1-07");
    let lower = lowest(&other) - lowest(&place);
    assert!((45.0..47.0).contains(&lower), "the geoid lies 46 m above the ellipsoid: {lower}");
}

#[test]
fn the_line_with_a_zone_and_feet() {
    // Zone 55 begins at 144 degrees east, its middle is 147.
    let (_, _, easting_ft) = runs("1.1-08");
    assert!((1_638_000.0..1_643_000.0).contains(&easting_ft), "{easting_ft} ft");
}

#[test]
fn the_line_with_a_clock_of_utc() {
    let (place, _, _) = runs("1.1-09");
    let text = place.text("outdir/250504_225230_traj.txt");
    let first: f64 = text.lines().nth(1).unwrap().split(' ').next().unwrap().parse().unwrap();
    let expected = 2365.0 * 604_800.0 - 1e9 + 82_350.0 + 18.72;
    assert!((first - expected).abs() < 1e-3, "{first} instead of {expected}");
}

/// Their columns, `xyztpk`, lack the roll: 0 is taken, and said.
#[test]
fn the_lines_with_a_trajectory_in_text() {
    for (name, first) in [("1.1-10", 319_000.0..321_000.0), ("1.1-11", 12.5..12.7)] {
        let place = inputs(name);
        let line = EXAMPLES.iter().find(|(example, _)| *example == name).unwrap().1;
        let ended = wavex(&place, &format!("--run -- {line}"));
        assert_eq!(ended.code, Some(0), "{}", ended.err);
        let what = "the trajectory's columns have no roll (`w`): 0 is taken, and each degree of true roll puts points off";
        assert!(ended.err.contains(what), "{}", ended.err);
        let (_, points, least) = header(&place, "data.laz");
        assert!(
            points >= PULSES * 8 / 10 && first.contains(&least),
            "{name}: {points} points from {least} on"
        );
    }
}

#[test]
fn the_lines_without_a_trajectory() {
    for name in ["1.1-12", "1.1-13"] {
        let (_, _, least_x) = runs(name);
        assert!(least_x.abs() < 1000.0, "{name}: the aircraft's own frame: {least_x}");
    }
}

#[test]
fn the_line_that_writes_nothing() {
    let place = inputs("1.1-14");
    leaves(&place, "wavex -i data.sdf -fastest -oext 0 -nil", &["report.json"]);
    assert!(!place.path("data.laz").exists());
}

#[test]
fn the_line_that_scans() {
    let place = inputs("1.1-15");
    leaves(&place, "wavex -sdfscan -i data.sdf -name scan", &["scan_scan.txt", "scan_scan.html"]);
}

/// Every example is run by a test: those above, and in `runs` the three that ask for information.
#[test]
fn no_example_is_forgotten() {
    let runs: BTreeSet<&str> = EXAMPLES.iter().map(|(name, _)| *name).collect();
    let v10 = (1..=5).map(|number| format!("1.0-{number:02}"));
    let v11 = (1..=18).map(|number| format!("1.1-{number:02}"));
    let known: Vec<String> = v10.chain(v11).collect();
    assert_eq!(runs.into_iter().collect::<Vec<_>>(), known.iter().map(String::as_str).collect::<Vec<_>>());
}

/// The files of options that both documents print.
#[test]
fn the_example_of_a_file_of_options() {
    let options = b"mem=4096\ndet=5\nR=1000\n";
    let place = inputs("1.0-01");
    place.write("wavex.opt", options);
    leaves(&place, "wavex -i waveform.las", &["out.laz"]);
    let place = inputs("1.1-12");
    place.write("wavex.opt.txt", options);
    leaves(&place, "wavex -i data.sdf", &["data.laz"]);
}
