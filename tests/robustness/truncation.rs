//! Truncated recordings give an error or fewer shots; never a panic.
//!
//! The remaining part of the file is valid, as after an aborted copy or a full disk.

use std::collections::BTreeSet;
use std::fs::{self, OpenOptions};
use std::path::Path;

use wavex::engine::{self, Cause};
use wavex::stage::StageSpec;
use wavex::stages::readers::{read_arrow, read_las, read_pulsewaves, simulate};
use wavex::stages::writers::write_arrow;

/// Headers end before this byte; every byte up to here is tested.
const HEADERS: usize = 400;
/// Number of further positions, spread over the rest, and as many at the end.
const SPREAD: usize = 24;

/// Number of shots and notes of a reader, or its error.
fn read(reader: &'static StageSpec, path: &Path) -> Result<(u64, Vec<String>), String> {
    let job = wavex_testkit::engine_stages::job(&[(reader, &format!("path = '{}'", path.display()))]);
    match engine::run(&job, &wavex_testkit::engine_stages::into(&job, path.parent().unwrap())) {
        Ok(report) => {
            let reader = &report.inputs[0].stages[0];
            Ok((reader.items_out.shots, reader.notes.clone()))
        }
        Err(error) => {
            assert!(matches!(error.cause, Cause::Stage(_)), "{error}");
            Err(error.to_string())
        }
    }
}

/// Positions at which to truncate a file of `length` bytes.
fn cuts(length: usize) -> BTreeSet<usize> {
    let spread = (0..SPREAD).map(|i| HEADERS + i * length.saturating_sub(HEADERS) / SPREAD + i % 8);
    let end = (1..=SPREAD).map(|i| length.saturating_sub(i));
    (0..HEADERS).chain(spread).chain(end).filter(|cut| *cut < length).collect()
}

/// End of the last required record of a file: the number of records appended to pulses is not
/// stored.
fn end_of_records(extension: &str, bytes: &[u8]) -> usize {
    let number = |at: usize| u32::from_le_bytes(*bytes[at..].first_chunk().unwrap()) as usize;
    if extension == "pls" { number(176) + number(184) * number(200) } else { bytes.len() }
}

/// Truncates each file of a recording everywhere; returns the shots of the whole recording, or its
/// error.
fn cut_everywhere(
    reader: &'static StageSpec,
    data: &Path,
    name: &str,
    extensions: &[&str],
) -> Result<u64, String> {
    let folder = tempfile::tempdir().unwrap();
    let path = |extension: &str| folder.path().join("a").with_extension(extension);
    for extension in extensions {
        fs::copy(data.join(format!("{name}.{extension}")), path(extension)).unwrap();
    }
    let whole = read(reader, &path(extensions[0])).map(|(shots, _)| shots);
    for extension in extensions {
        let bytes = fs::read(path(extension)).unwrap();
        // From the end, so that the file is written only once.
        for cut in cuts(bytes.len()).into_iter().rev() {
            OpenOptions::new().write(true).open(path(extension)).unwrap().set_len(cut as u64).unwrap();
            let what = format!("{name}.{extension}, cut at {cut}");
            match read(reader, &path(extensions[0])) {
                Ok((found, notes)) => {
                    assert_eq!(Ok(found), whole, "{what}");
                    assert!(cut >= end_of_records(extension, &bytes), "{what}");
                    assert!(
                        notes.iter().any(|note| note.contains("the file may be truncated")),
                        "{what}: {notes:?}"
                    );
                }
                // If the whole file is unreadable, the error must report the truncation.
                Err(error) => assert_ne!(Err(error), whole, "{what}"),
            }
        }
        fs::write(path(extension), &bytes).unwrap();
    }
    whole
}

const RIEGL: &str = "riegl_q680i_dev/riegl_q680i_dev";

/// The points of these files refer to waveforms that the writing program omitted.
#[track_caller]
fn cut_points_without_waveforms(extension: &str, names: &[&str]) {
    let Some(data) = wavex_testkit::data() else { return };
    for name in names {
        let name = format!("las_wavepackets/{name}");
        let problem = cut_everywhere(&read_las::STAGE, &data, &name, &[extension]).unwrap_err();
        assert!(problem.contains("a point refers to waveform descriptor"), "{name}: {problem}");
    }
}

#[test]
fn las() {
    let names = ["pdrf4-1.3", "pdrf5-1.3", "pdrf9-1.4", "pdrf10-1.4", "pdrf9-1.5", "pdrf10-1.5"];
    cut_points_without_waveforms("las", &names);
}

#[test]
fn laz() {
    cut_points_without_waveforms("laz", &["pdrf4-1.3", "pdrf5-1.3", "pdrf9-1.4", "pdrf10-1.4"]);
}

#[test]
fn laz_beside_a_file_of_no_waveforms() {
    let Some(data) = wavex_testkit::data() else { return };
    let folder = tempfile::tempdir().unwrap();
    fs::copy(data.join("las_wavepackets/fullwave.laz"), folder.path().join("fullwave.laz")).unwrap();
    fs::write(folder.path().join("fullwave.wdp"), &wavex_testkit::las::Las::new(0).packets).unwrap();
    let problem = cut_everywhere(&read_las::STAGE, folder.path(), "fullwave", &["laz", "wdp"]).unwrap_err();
    assert!(problem.contains("are outside the packets (60 to 60)"), "{problem}");
}

#[test]
fn las_with_waveforms() {
    let Some(data) = wavex_testkit::data() else { return };
    assert_eq!(cut_everywhere(&read_las::STAGE, &data, RIEGL, &["las", "wdp"]), Ok(607));
}

#[test]
fn container() {
    let folder = tempfile::tempdir().unwrap();
    let job = wavex_testkit::engine_stages::job(&[
        (&simulate::STAGE, "lines = 3\nshots_per_line = 20"),
        (&write_arrow::STAGE, ""),
    ]);
    engine::run(&job, &wavex_testkit::engine_stages::into(&job, folder.path())).unwrap();
    assert_eq!(cut_everywhere(&read_arrow::STAGE, folder.path(), "simulated", &["arrow"]), Ok(60));
}

#[test]
fn pulsewaves() {
    let Some(data) = wavex_testkit::data() else { return };
    for (name, shots) in [
        ("pulsewaves/geolas_example1", 1000),
        ("pulsewaves/las13fwf_example1", 1000),
        ("pulsewaves/lvis_example1", 1000),
        ("pulsewaves/optech_example1", 998),
        ("pulsewaves/riegl_example3", 16_486),
        ("pulsewaves/test", 15),
        (RIEGL, 607),
    ] {
        assert_eq!(
            cut_everywhere(&read_pulsewaves::STAGE, &data, name, &["pls", "wvs"]),
            Ok(shots),
            "{name}"
        );
    }
}
