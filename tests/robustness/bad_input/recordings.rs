//! Damaged real recordings.

use std::fs;
use std::path::Path;

use serde_json::json;
use wavex_formats::container::ContainerReader;

use wavex_testkit::{TestFolder, data, rejected};

/// Copies a recording of one or more files to a folder, as `a` with their extensions.
fn copy(data: &Path, name: &str, extensions: &[&str]) -> TestFolder {
    let place = TestFolder::new();
    for extension in extensions {
        place.write(&format!("a.{extension}"), &fs::read(data.join(name).with_extension(extension)).unwrap());
    }
    place
}

/// Replaces bytes of a file.
fn change(place: &TestFolder, name: &str, at: usize, bytes: &[u8]) {
    let mut whole = fs::read(place.path(name)).unwrap();
    whole[at..at + bytes.len()].copy_from_slice(bytes);
    place.write(name, &whole);
}

/// Reads a 16 or 32-bit number from a file.
fn number(place: &TestFolder, name: &str, at: usize, bytes: usize) -> usize {
    let whole = fs::read(place.path(name)).unwrap();
    whole[at..at + bytes].iter().rev().fold(0, |number, byte| number << 8 | usize::from(*byte))
}

/// Contents of a container by shot: time, position, and all samples of all blocks.
fn shots(path: &Path) -> Vec<String> {
    let mut reader = ContainerReader::open(path).unwrap();
    let mut shots = Vec::new();
    while let Some(line) = reader.next_line().unwrap() {
        for row in 0..line.rows() {
            let shot = line.shot(row);
            let blocks: Vec<String> = line.blocks(row).map(|block| format!("{block:?}")).collect();
            shots.push(format!("{} {:?} {:?} {blocks:?}", shot.clock_ps, shot.origin_m, shot.direction));
        }
    }
    shots
}

/// Asserts that a recording with a damaged record in the middle is read except for one shot, which
/// is counted.
#[track_caller]
fn loses_one_shot(place: &TestFolder, reader: &str, name: &str, damage: (usize, &[u8]), what: &str) {
    const COPY: &str = "[[stage]]\ntype = 'write_arrow'\n";
    place.succeeds(reader, name, COPY);
    let whole = shots(&place.path("out/a.arrow"));
    change(place, name, damage.0, damage.1);
    let input = place.succeeds(reader, name, COPY);
    assert_eq!(json!(rejected(&input)), json!({ what: 1 }));
    assert_eq!((whole.len(), &input["totals"]["nw"]), (607, &json!(606)));
    let found = shots(&place.path("out/a.arrow"));
    let lost = whole.iter().zip(&found).position(|(whole, found)| whole != found).unwrap();
    assert_eq!((&whole[..lost], &whole[lost + 1..]), (&found[..lost], &found[lost..]));
}

#[test]
fn a_recording_without_its_waveforms() {
    let Some(data) = data() else { return };
    let message = "stage read_las: ./a.laz: its waveforms are missing: neither inside the file nor \
                   in `a.wdp` next to it; copy `a.wdp` into the same folder, or export the file \
                   with its waveforms inside";
    copy(&data, "las_wavepackets/fullwave", &["laz"]).fails("read_las", "a.laz", message);
}

#[test]
fn a_las_recording_with_a_damaged_point_loses_that_pulse_alone() {
    let Some(data) = data() else { return };
    let place = copy(&data, "riegl_q680i_dev/riegl_q680i_dev", &["las", "wdp"]);
    let point = number(&place, "a.las", 96, 4) + 301 * number(&place, "a.las", 105, 2);
    let what = "blocks: a point's waveform that cannot be read";
    loses_one_shot(&place, "read_las", "a.las", (point + 30, &[250]), what);
}

#[test]
fn a_pulsewaves_recording_with_a_damaged_pulse_loses_that_pulse_alone() {
    let Some(data) = data() else { return };
    let place = copy(&data, "riegl_q680i_dev/riegl_q680i_dev", &["pls", "wvs"]);
    let pulse = number(&place, "a.pls", 176, 4) + 300 * number(&place, "a.pls", 200, 4);
    let what = "shots: a pulse whose waves cannot be read";
    loses_one_shot(&place, "read_pulsewaves", "a.pls", (pulse + 8, &i64::MAX.to_le_bytes()), what);
}
