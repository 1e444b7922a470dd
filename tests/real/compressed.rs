//! Compressed recordings equal their uncompressed twins.

use std::fs;
use std::path::Path;

use wavex::engine;
use wavex::scan_line::Channel;
use wavex_formats::las::{Point, RawPoints, Reader};
use wavex_testkit::recordings::{run, samples_of};
use wavex_testkit::{TestFolder, data};

/// Offset and size of the packet in a point record of format 4.
const PACKET: std::ops::Range<usize> = 29..41;

#[test]
fn waveform_packets_of_lastools_equal_their_uncompressed_twins() {
    let Some(data) = data() else { return };
    let path = |name: &str| data.join("las_compressed").join(name);
    let [mut plain, mut compressed] =
        ["fwf_uncompressed.las", "fwf.laz"].map(|name| RawPoints::open(&path(name)).unwrap());
    let [mut plain_waves, mut waves] =
        ["fwf_uncompressed.las", "fwf.laz"].map(|name| Reader::open(&path(name)).unwrap());
    assert_eq!(plain.header().point_format, compressed.header().point_format);
    let (mut n_points, mut n_samples) = (0, 0);
    let [mut expected, mut found] = [Vec::new(), Vec::new()];
    let [mut of_plain, mut of_compressed] = [Point::default(), Point::default()];
    while let Some(record) = plain.next_record().unwrap() {
        let mut record = record.to_vec();
        let mut other = compressed.next_record().unwrap().unwrap().to_vec();
        record[PACKET].fill(0);
        other[PACKET].fill(0);
        assert_eq!(record, other, "point {n_points}");
        assert!(
            plain_waves.next_point(&mut of_plain).unwrap() && waves.next_point(&mut of_compressed).unwrap()
        );
        plain_waves.packet(&of_plain.wave, &mut expected).unwrap();
        waves.packet(&of_compressed.wave, &mut found).unwrap();
        assert_eq!(expected, found, "point {n_points}");
        (n_points, n_samples) = (n_points + 1, n_samples + found.len());
    }
    assert!(compressed.next_record().unwrap().is_none());
    println!("{n_points} points and {n_samples} samples are equal");
    assert!(n_points > 1000 && n_samples > 100_000);
}

/// Runs the usual stages on a recording; returns the lines of its table, and its summary.
fn returns(reader: &str, recording: &Path) -> (Vec<String>, engine::InputSummary) {
    let out = tempfile::tempdir().unwrap();
    let job = format!(
        "[[stage]]\ntype = '{reader}'\npath = '{}'\n[[stage]]\ntype = 'calibrate'\n[[stage]]\ntype = 'decompose'\n\
         [[stage]]\ntype = 'georeference'\n[[stage]]\ntype = 'write_table'\npath = 'returns.csv'\n",
        recording.display()
    );
    let summary = run("job.toml", &job, recording.parent().unwrap(), out.path(), &[]);
    let text = fs::read_to_string(out.path().join("returns.csv")).unwrap();
    (text.lines().map(str::to_owned).collect(), summary)
}

#[test]
fn a_run_on_compressed_waveforms_gives_the_same_returns() {
    let Some(data) = data() else { return };
    let of = |name: &str| returns("read_las", &data.join("las_compressed").join(name));
    let ((expected, of_plain), (found, summary)) = (of("fwf_uncompressed.las"), of("fwf.laz"));
    assert_eq!(expected.len(), found.len());
    let different = expected.iter().zip(&found).find(|(expected, found)| expected != found);
    assert_eq!(different, None);
    println!("{} returns are equal", found.len() - 1);
    assert!(found.len() > 1000);
    assert_eq!(summary.stages[0].rejected, of_plain.stages[0].rejected);
}

#[test]
fn compressed_pulsewaves_equal_their_uncompressed_twin() {
    let Some(data) = data() else { return };
    for channel in [Channel::Reference, Channel::LowPower, Channel::HighPower] {
        let of = |name: &str| samples_of(channel, "read_pulsewaves", &data.join("pulsewaves").join(name));
        assert_eq!(of("test.pls"), of("tezt.plz"));
    }
}

#[test]
fn commands_take_compressed_recordings() {
    let Some(data) = data() else { return };
    let place = TestFolder::new();
    for (folder, files) in
        [("las_compressed", ["fwf.laz", "fwf.wdz"]), ("pulsewaves", ["tezt.plz", "tezt.wvz"])]
    {
        for file in files {
            fs::copy(data.join(folder).join(file), place.path(file)).unwrap();
        }
        let recording = files[0];
        for arguments in [
            &["scan", recording][..],
            &["init", "--from", recording, &format!("{recording}.toml")],
            &["convert", recording, &format!("{recording}.arrow")],
        ] {
            let outcome = place.wavex(arguments);
            assert_eq!(outcome.code, Some(0), "{arguments:?}: {}", outcome.err);
        }
    }
    let outcome = place.wavex(&["run", "fwf.laz.toml"]);
    assert_eq!(outcome.code, Some(0), "{}", outcome.err);
}
