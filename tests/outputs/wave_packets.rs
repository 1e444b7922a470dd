//! Points written with waveforms are a full-waveform recording: decomposing it again gives the same
//! returns.

use std::path::Path;

use wavex_testkit::recordings::{Table, run};

const WRITE: &str = r#"
[[stage]]
type = "simulate"
stem = "flight"
lines = 4
shots_per_line = 200
[[stage]]
type = "calibrate"
waveforms = 400
save = "model.json"
[[stage]]
type = "decompose"
[[stage]]
type = "georeference"
[[stage]]
type = "write_table"
path = "*.csv"
"#;

const READ_AGAIN: &str = r#"
[[stage]]
type = "read_las"
path = "*"
[[stage]]
type = "calibrate"
load = "model.json"
[[stage]]
type = "decompose"
[[stage]]
type = "georeference"
[[stage]]
type = "write_table"
path = "again.csv"
"#;

/// File, version, location of the waveforms, and point format with its compression bit.
const FILES: [(&str, &str, &str, u8); 6] = [
    ("a.las", "1.4", "internal", 9),
    ("b.las", "1.4", "external", 9),
    ("c.laz", "1.4", "internal", 9 | 0x80),
    ("d.laz", "1.4", "external", 9 | 0x80),
    ("e.las", "1.3", "external", 4),
    ("f.laz", "1.3", "internal", 4 | 0x80),
];

/// Maximum difference between two columns.
fn apart(one: &Table, other: &Table, column: &str) -> f64 {
    differences(one, other, column).fold(0.0, f64::max)
}

fn differences(one: &Table, other: &Table, column: &str) -> impl Iterator<Item = f64> {
    one.column(column).into_iter().zip(other.column(column)).map(|(a, b)| (a - b).abs())
}

fn assert_same_returns(written: &Table, again: &Table, file: &str) {
    assert_eq!(again.len(), written.len(), "{file}");
    for axis in ["x", "y", "z"] {
        // Points are stored with a resolution of 1 mm.
        let apart_m = apart(written, again, axis);
        assert!(apart_m <= 0.001, "{file}: {axis} is {apart_m} m apart");
    }
    for (column, bound) in [("amplitude_dn", 1e-4), ("width_ratio", 1e-6), ("deviation_ratio", 1e-3)] {
        let apart = apart(written, again, column);
        assert!(apart <= bound, "{file}: {column} is {apart} apart");
    }
    for column in ["return_number", "number_of_returns"] {
        assert_eq!(apart(written, again, column), 0.0, "{file}: {column}");
    }
}

#[test]
fn decomposing_again_gives_the_same_returns() {
    let folder = tempfile::tempdir().unwrap();
    let sinks = FILES.map(|(file, version, packets, _)| {
        format!(
            "[[stage]]\ntype = \"write_las\"\nid = \"{}\"\npath = \"{file}\"\nversion = \"{version}\"\n\
             wave_packets = \"{packets}\"\nindex = \"{}\"\n",
            &file[..1],
            if file.ends_with('z') { "appended" } else { "none" }
        )
    });
    run("write.toml", &format!("{WRITE}{}", sinks.concat()), folder.path(), folder.path(), &[]);
    let written = Table::read(&folder.path().join("flight.csv"));
    assert!(written.len() > 800);
    for (file, _, packets, format) in FILES {
        let bytes = std::fs::read(folder.path().join(file)).unwrap();
        assert_eq!(bytes[104], format, "{file}");
        let beside = folder.path().join(file).with_extension("wdp");
        assert_eq!(beside.is_file(), packets == "external", "{file}");
        let job = READ_AGAIN.replace("\"*\"", &format!("\"{file}\""));
        run("read.toml", &job, folder.path(), folder.path(), &[]);
        assert_same_returns(&written, &Table::read(&folder.path().join("again.csv")), file);
    }
    assert_nothing_is_left(folder.path());
}

/// A flight over buildings and trees with a second receiver for strong echoes.
fn two_receivers() -> String {
    let simulate = "lines = 12\nshots_per_line = 150\nlandscape = \"country\"\nhigh_power = true\n\
                    ground_amplitude_dn = 250.0\n[[stage]]\ntype = \"fuse_channels\"";
    WRITE.replace("lines = 4\nshots_per_line = 200", simulate)
}

/// Points of one pulse are in two channels if one return is of the sensitive receiver only and
/// another of both: they are read back as one pulse.
#[test]
fn a_pulse_in_two_receivers_stays_one() {
    let folder = tempfile::tempdir().unwrap();
    let versions = ["1.4", "1.3"].map(|version| {
        format!(
            "[[stage]]\ntype = \"write_las\"\nid = \"v{version}\"\npath = \"v{version}.las\"\n\
             version = \"{version}\"\nwave_packets = \"internal\"\n"
        )
    });
    let job = format!("{}{}", two_receivers(), versions.concat().replace("id = \"v1.", "id = \"v"));
    run("write.toml", &job, folder.path(), folder.path(), &[]);
    let written = Table::read(&folder.path().join("flight.csv"));
    assert!(shots_in_two_channels(folder.path()) >= 20);
    for version in ["1.4", "1.3"] {
        let job = READ_AGAIN.replace("\"*\"", &format!("\"v{version}.las\""));
        let report = run("read.toml", &job, folder.path(), folder.path(), &[]);
        assert_eq!(report.stages[0].rejected.len(), 0, "{version}: {:?}", report.stages[0].rejected);
        let again = Table::read(&folder.path().join("again.csv"));
        assert_eq!(shots(&again), shots(&written), "{version}");
        for column in ["return_number", "number_of_returns"] {
            assert_eq!(apart(&written, &again, column), 0.0, "{version}: {column}");
        }
        for axis in ["x", "y", "z"] {
            // The high-power receiver is not written: saturated echoes move slightly, most by less
            // than 1 mm.
            let apart_m = apart(&written, &again, axis);
            let moved = differences(&written, &again, axis).filter(|moved_m| *moved_m > 0.001).count();
            println!("{version}: {moved} of {} moved by more than 1 mm, at most {apart_m} m", again.len());
            assert!(
                apart_m <= 0.002 && moved * 100 <= again.len(),
                "{version}: {axis} is {apart_m} m apart, {moved}"
            );
        }
    }
}

/// Number of returns of each shot with any.
fn shots(table: &Table) -> Vec<usize> {
    let shots = table.column("shot");
    shots.chunk_by(|a, b| a == b).map(<[f64]>::len).collect()
}

/// Shots with returns of the sensitive receiver alone and others of both.
fn shots_in_two_channels(folder: &Path) -> usize {
    let mut reader = las::Reader::from_path(folder.join("v1.4.las")).unwrap();
    let points: Vec<las::Point> = reader.read_all().unwrap().points().map(|point| point.unwrap()).collect();
    let pulses = points.chunk_by(|a, b| a.gps_time == b.gps_time);
    pulses.filter(|points| points.iter().any(|p| p.scanner_channel != points[0].scanner_channel)).count()
}

/// Asserts that packets merged into another file leave no file of their own.
fn assert_nothing_is_left(folder: &Path) {
    let names =
        std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
    let odd: Vec<String> =
        names.filter(|name| name.ends_with(".partial") || name.contains(".las.")).collect();
    assert!(odd.is_empty(), "{odd:?}");
}
