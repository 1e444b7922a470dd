//! Recordings without sensor positions: corrections that need them are skipped with a warning.

use std::path::Path;

use serde_json::Value;
use wavex_formats::container::{
    Compression, ContainerHeader, ContainerReader, ContainerWriter, LineBuilder, Origin,
};
use wavex_testkit::data;
use wavex_testkit::las::Las;
use wavex_testkit::pulsewaves::PulseWaves;
use wavex_testkit::recordings::Table;
use wavex_testkit::{Outcome, TestFolder};

/// Warning that replaces a wrong intensity.
const NOT_CORRECTED: &str = "intensities are not corrected for range and attenuation: the recording does \
                             not contain the sensor position, and ranges count from a point near the \
                             waveform; read the original recording of the instrument, or set \
                             `reference_range_m` and `attenuation_db_per_km` to false";

/// Stages from samples to points; `keys` are those of `correct`, which is omitted if `None`.
fn chain(keys: Option<&str>) -> String {
    let correct = keys.map_or(String::new(), |keys| format!("[[stage]]\ntype = 'correct'\n{keys}\n"));
    format!(
        "[[stage]]\ntype = 'calibrate'\nwaveforms = 300\nresponse = 'gaussian'\n[[stage]]\ntype = 'decompose'\nmode = 'fastest'\n{correct}\
         [[stage]]\ntype = 'georeference'\n[[stage]]\ntype = 'write_table'\npath = '*.csv'\n\
         [[stage]]\ntype = 'write_lstat'\npath = '*_lstat.txt'\n"
    )
}

/// All corrections except widths, which are irrelevant here.
const ALL: &str = "attenuation_db_per_km = 0.2\nwidth_correction_low = false\nwidth_correction_high = false";

/// Results of a run for `a.*`: report of the input, intensities, and `AGL` of its first line.
fn run(place: &TestFolder, reader: &str, file: &str, keys: Option<&str>) -> (Value, Vec<f64>, String) {
    let report = place.succeeds(reader, file, &chain(keys));
    let intensities = Table::read(&place.path("out/a.csv")).column("intensity");
    assert!(intensities.len() > 300);
    let lines = place.text("out/a_lstat.txt");
    let agl = lines.lines().nth(1).unwrap().rsplit(' ').next().unwrap().to_owned();
    (report, intensities, agl)
}

fn notes(report: &Value) -> Vec<&str> {
    let stages = report["stages"].as_array().unwrap();
    stages
        .iter()
        .flat_map(|stage| stage["notes"].as_array().unwrap())
        .map(|note| note.as_str().unwrap())
        .collect()
}

/// Asserts that intensities are neither corrected nor counted, with one warning.
#[track_caller]
fn is_left_alone(place: &TestFolder, reader: &str, file: &str) {
    let (_, before, _) = run(place, reader, file, None);
    let (report, after, agl) = run(place, reader, file, Some(ALL));
    assert_eq!(after, before, "{file}: beams are vertical: no other correction applies");
    assert_eq!([&report["totals"]["np_range"], &report["totals"]["np_atm"]], [0, 0]);
    assert_eq!(notes(&report).iter().filter(|note| **note == NOT_CORRECTED).count(), 1);
    assert_eq!(report["ranges_count_from"], "first_sample");
    assert_eq!(agl, "nan");
    let off = format!("reference_range_m = false\n{}", ALL.replace("0.2", "false"));
    let (report, _, _) = run(place, reader, file, Some(&off));
    assert!(!notes(&report).contains(&NOT_CORRECTED), "no warning for corrections that are off");
}

#[test]
fn intensities_of_las_are_not_corrected_for_range() {
    let recording = Las::new(400);
    let place = TestFolder::with(&[("a.las", &recording.las()), ("a.wdp", &recording.packets)]);
    is_left_alone(&place, "read_las", "a.las");
    // A container made from it has the same property.
    let to_container = "[[stage]]\ntype = 'write_arrow'\npath = 'b.arrow'\n";
    place.succeeds("read_las", "a.las", to_container);
    std::fs::copy(place.path("out/b.arrow"), place.path("a.arrow")).unwrap();
    is_left_alone(&place, "read_arrow", "a.arrow");
}

/// Offset of the distance from optical centre to anchor in a descriptor, and the value for "not
/// constant".
const CENTRE_TO_ANCHOR: usize = 8;
const NOT_CONSTANT: [u8; 4] = 0x8FFF_FFFFu32.to_le_bytes();

#[test]
fn anchors_of_pulsewaves_are_the_sensor_where_the_descriptor_says_so() {
    let recording = PulseWaves::new(400);
    let place = TestFolder::with(&[("a.pls", &recording.pls()), ("a.wvs", &recording.waves)]);
    let (_, before, _) = run(&place, "read_pulsewaves", "a.pls", None);
    let (report, after, agl) = run(&place, "read_pulsewaves", "a.pls", Some("width_correction_low = false"));
    // The ground is about 600 m below the anchors.
    let factors: Vec<f64> = after.iter().zip(&before).map(|(after, before)| after / before).collect();
    assert!(factors.iter().all(|factor| (factor / 0.36 - 1.0).abs() < 0.02), "{:?}", &factors[..5]);
    assert_eq!(
        (&report["ranges_count_from"], agl.parse::<f64>().unwrap().round()),
        (&"sensor".into(), 600.0)
    );
    assert!(!notes(&report).contains(&NOT_CORRECTED));

    let mut bytes = recording.pls();
    let at = 352 + 96 + CENTRE_TO_ANCHOR;
    assert_eq!(bytes[at..at + 4], [0; 4]);
    bytes[at..at + 4].copy_from_slice(&NOT_CONSTANT);
    place.write("a.pls", &bytes);
    is_left_alone(&place, "read_pulsewaves", "a.pls");
}

/// The options file printed in the document of version 1.0, against the same line without its last
/// row.
#[test]
fn the_option_file_of_version_1_0_leaves_intensities_as_they_are() {
    let recording = Las::new(400);
    let intensities = |options: &str| {
        let files: [(&str, &[u8]); 3] = [
            ("waveform.las", &recording.las()),
            ("waveform.wdp", &recording.packets),
            ("wavex.opt", options.as_bytes()),
        ];
        let place = TestFolder::with(&files);
        let line = ["import", "--run", "--", "wavex", "-i", "waveform.las", "-o", "out.las"];
        let Outcome { code, err, .. } = place.wavex(&line);
        assert_eq!(code, Some(0), "{err}");
        let mut reader = las::Reader::from_path(place.path("out.las")).unwrap();
        let points = reader.read_all().unwrap();
        let found: Vec<u16> = points.points().map(|point| point.unwrap().intensity).collect();
        (found, err)
    };
    let (without, _) = intensities("mem=4096\ndet=5\n");
    let (with, err) = intensities("mem=4096\ndet=5\nR=1000\n");
    assert!(with.len() > 300 && with.iter().all(|intensity| *intensity > 20), "{:?}", &with[..5]);
    assert_eq!(with, without);
    assert_eq!(err.matches(NOT_CORRECTED).count(), 1, "{err}");
}

#[test]
fn explain_says_where_ranges_count_from() {
    let recording = Las::new(400);
    let place = TestFolder::with(&[("a.las", &recording.las()), ("a.wdp", &recording.packets)]);
    let explained = place.wavex(&["explain", "a.las", "--shot", "7", "--set", "calibrate.waveforms=300"]);
    let said = "\nranges start at the first sample: the recording has no sensor position\n";
    assert!(explained.out.contains(said), "{explained:?}");
}

/// The same container with another origin in its header.
fn with_origin(path: &Path, origin: Option<Origin>) -> Vec<u8> {
    let mut reader = ContainerReader::open(path).unwrap();
    let mut lines = Vec::new();
    while let Some(line) = reader.next_line().unwrap() {
        lines.push(line);
    }
    let header = ContainerHeader { origin, ..reader.header().clone() };
    let mut writer = ContainerWriter::file(Vec::new(), path, &header, Compression::None).unwrap();
    for line in lines {
        let mut builder = LineBuilder::new();
        for row in 0..line.rows() {
            builder.shot(&line.shot(row));
            line.blocks(row).for_each(|block| builder.block(&block));
        }
        writer.write(builder).unwrap();
    }
    writer.finish().unwrap()
}

/// A trajectory does not provide sensor positions if the origins are elsewhere, and an offset
/// proportional to range cannot be added to such ranges.
#[test]
fn a_part_of_the_range_is_not_added_where_ranges_do_not_count_from_the_sensor() {
    let place = TestFolder::new();
    let job = "[[stage]]\ntype = 'simulate'\nstem = 'a'\nlines = 4\nshots_per_line = 100\npof = 'a.pof'\n\
               [[stage]]\ntype = 'write_arrow'\n";
    assert_eq!(place.run(job), Outcome::success());
    let recording = place.path("recording.arrow");
    std::fs::copy(place.path("out/a.arrow"), &recording).unwrap();
    std::fs::copy(place.path("out/a.pof"), place.path("a.pof")).unwrap();
    let said = "ranges are not corrected by `e1`: the recording does not contain the sensor position, and \
                ranges count from a point near the waveform; remove `e1` from the calibration";
    let mut ranges = Vec::new();
    for (origin, e1, is_said) in
        [(None, 0.01, false), (Some(Origin::Waveform), 0.01, true), (Some(Origin::Waveform), 0.0, false)]
    {
        place.write("a.arrow", &with_origin(&recording, origin));
        let geometry = format!(
            "[job.geometry]\ntrajectory = 'a.pof'\n[job.geometry.calibration]\ne1 = {e1}\n{}",
            chain(Some("width_correction_low = false"))
        );
        let text = format!("[[stage]]\ntype = 'read_arrow'\npath = 'a.arrow'\n{}", geometry);
        // The geometry table precedes the stages.
        let (before, after) = text.split_at(text.find("[job.geometry]").unwrap());
        let (table, stages) = after.split_at(after.find("[[stage]]").unwrap());
        assert_eq!(place.run(&format!("{table}{before}{stages}")), Outcome::success());
        let report: Value = serde_json::from_str(&place.text("out/job_report.json")).unwrap();
        let report = &report["inputs"][0];
        assert_eq!(
            (notes(report).contains(&said), notes(report).contains(&NOT_CORRECTED)),
            (is_said, origin.is_some())
        );
        ranges.push(Table::read(&place.path("out/a.csv")).column("range_m"));
    }
    assert_eq!(ranges[1], ranges[2]);
    assert!((ranges[0][0] / ranges[1][0] - 1.01).abs() < 1e-9);
}

/// Real recordings: the makers' own formats give sensor positions; recordings converted from LAS,
/// and LVIS, do not.
#[test]
fn real_recordings_say_where_ranges_count_from() {
    let Some(data) = data() else { return };
    for (reader, file, from) in [
        ("read_las", "riegl_q680i_dev/riegl_q680i_dev.las", "first_sample"),
        ("read_pulsewaves", "riegl_q680i_dev/riegl_q680i_dev.pls", "sensor"),
        ("read_pulsewaves", "pulsewaves/riegl_example3.pls", "sensor"),
        ("read_pulsewaves", "pulsewaves/geolas_example1.pls", "sensor"),
        ("read_pulsewaves", "pulsewaves/optech_example1.pls", "sensor"),
        ("read_pulsewaves", "pulsewaves/las13fwf_example1.pls", "first_sample"),
        ("read_pulsewaves", "pulsewaves/lvis_example1.pls", "first_sample"),
    ] {
        let out = tempfile::tempdir().unwrap();
        let job = format!("[[stage]]\ntype = '{reader}'\npath = '{file}'\n[[stage]]\ntype = 'write_lstat'\n");
        let report = wavex_testkit::recordings::run("job.toml", &job, &data, out.path(), &[]);
        assert_eq!(report.ranges_count_from.as_deref(), Some(from), "{file}");
    }
}

/// For RIEGL's recording in both formats, corrected intensities of LAS equal those without range
/// correction.
#[test]
fn real_las_keeps_its_intensities() {
    let Some(data) = data() else { return };
    let found = |keys: &str| {
        let out = tempfile::tempdir().unwrap();
        let job = format!(
            "[[stage]]\ntype = 'read_las'\npath = 'riegl_q680i_dev/riegl_q680i_dev.las'\n{}",
            chain(Some(&format!("width_correction_low = false\n{keys}")))
        );
        let report = wavex_testkit::recordings::run("job.toml", &job, &data, out.path(), &[]);
        (Table::read(&out.path().join("riegl_q680i_dev.csv")).column("intensity"), report.totals["np_range"])
    };
    let (before, _) = found("reference_range_m = false");
    let (after, np_range) = found("");
    assert_eq!((&after, np_range), (&before, 0));
    println!("median intensity {:.1}", wavex_testkit::recordings::median(&after));
    assert!(wavex_testkit::recordings::median(&after) > 5.0);
}
