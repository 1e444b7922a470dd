//! Missing inputs and inputs of other formats.

use std::fs;

use wavex_testkit::las::Las;
use wavex_testkit::pulsewaves::PulseWaves;
use wavex_testkit::{TO_TABLE, TestFolder};

/// Every reader with the name of an input.
const READERS: [(&str, &str); 4] =
    [("read_las", "a.las"), ("read_las", "a.laz"), ("read_pulsewaves", "a.pls"), ("read_arrow", "a.arrow")];

#[test]
fn a_missing_file() {
    for (reader, name) in READERS {
        let message = format!(
            "stage {reader}: ./{name}: cannot open: No such file or directory (os error 2); check the path"
        );
        TestFolder::new().fails(reader, name, &message);
    }
}

#[test]
fn a_misspelt_file_gets_the_recording_that_was_meant() {
    for (reader, name) in READERS {
        let missing = name.replace("a.", "b.");
        let message = format!(
            "stage {reader}: ./{missing}: cannot open: No such file or directory (os error 2); did you mean ./{name}?"
        );
        TestFolder::with(&[(name, b"")]).fails(reader, &missing, &message);
    }
}

#[test]
fn an_empty_file() {
    for (reader, name) in READERS {
        let message = format!("stage {reader}: ./{name}: the file is empty; copy it again from its source");
        TestFolder::with(&[(name, b"")]).fails(reader, name, &message);
    }
}

#[test]
fn a_folder() {
    for (reader, name) in READERS {
        let place = TestFolder::new();
        fs::create_dir(place.path(name)).unwrap();
        let message = format!(
            "./{name}: it is a folder, not a recording; there is no recording in it: give the path of one"
        );
        place.fails(reader, name, &message);
    }
}

#[test]
fn a_file_of_another_format() {
    let pls = PulseWaves::new(3);
    let las = Las::new(3).las();
    let text = b"x,y,z\n1,2,3\n4,5,6\n7,8,9\n".to_vec();
    let no_las = "byte 0: file signature: expected `LASF`; give a LAS or LAZ file";
    let no_pls = |start: &str| {
        format!("this is not a PulseWaves pulse file: it starts with \"{start}\"; give a .pls or .plz file")
    };
    let no_arrow = "neither an Arrow IPC file nor a stream; \
                    give a waveform container, or use the reader of the file's own format";
    let other = |what: &str, reader: &str| format!("this is {what} read it with the stage `{reader}`");
    let cases: [(&str, &str, &[u8], String); 13] = [
        ("read_las", "a.las", &text, no_las.into()),
        ("read_las", "a.laz", &text, no_las.into()),
        (
            "read_las",
            "a.las",
            &pls.pls(),
            other("PulseWaves, not LAS; rename it to .pls, and", "read_pulsewaves"),
        ),
        ("read_las", "a.pls", &pls.pls(), other("PulseWaves, not LAS;", "read_pulsewaves")),
        ("read_las", "a.sdf", &text, format!("by its extension {}", other("SDF, not LAS;", "read_sdf"))),
        ("read_sdf", "a.laz", &las, format!("by its extension {}", other("LAS, not SDF;", "read_las"))),
        ("read_pulsewaves", "a.pls", &text, no_pls("x,y,z\\n1,2,3\\n4,5")),
        ("read_pulsewaves", "a.pls", &las, other("LAS, not PulseWaves; rename it to .las, and", "read_las")),
        ("read_pulsewaves", "a.laz", &las, other("LAS, not PulseWaves;", "read_las")),
        (
            "read_pulsewaves",
            "a.pls",
            &pls.waves,
            "this is the waves file of a PulseWaves pair; give the .pls or .plz file of the same name".into(),
        ),
        ("read_arrow", "a.arrow", &text, no_arrow.into()),
        ("read_arrow", "a.arrow", &las, other("LAS, not Arrow; rename it to .las, and", "read_las")),
        ("read_arrow", "a.pls", &pls.pls(), other("PulseWaves, not Arrow;", "read_pulsewaves")),
    ];
    for (reader, name, bytes, problem) in cases {
        TestFolder::with(&[(name, bytes)]).fails(
            reader,
            name,
            &format!("stage {reader}: ./{name}: {problem}"),
        );
    }
}

#[test]
fn a_pattern_without_matches() {
    let place = TestFolder::with(&[("lines/a.las", &Las::new(3).las())]);
    for reader in ["read_las", "read_pulsewaves", "read_arrow"] {
        let message =
            "no file matches `./lines/*.pls`; check `path` of the reader and `input_dir` of the job";
        place.fails(reader, "lines/*.pls", message);
    }
}

#[test]
fn inputs_whose_outputs_would_have_the_same_names() {
    let place = TestFolder::with(&[("a/x.las", b""), ("b/x.las", b"")]);
    let message = "the outputs of a/x.las and b/x.las would have the same names; \
                   run them as two jobs with different output folders";
    place.fails("read_las", "*/x.las", message);
}

#[test]
fn too_few_waveforms_to_calibrate_from() {
    let las = Las::new(150);
    let place = TestFolder::with(&[("a.las", &las.las()), ("a.wdp", &las.packets)]);
    let message = "stage calibrate: ./a.las: the low power receiver: calibration needs 200 waveforms of the channel \
                   and there were 150; give it more data, or load a saved sensor model";
    place.left_nothing(place.read("read_las", "a.las", TO_TABLE), message);
}

#[test]
fn no_waveform_at_all() {
    let las = Las::new(0);
    let place = TestFolder::with(&[("a.las", &las.las()), ("a.wdp", &las.packets)]);
    let input = place.succeeds("read_las", "a.las", TO_TABLE);
    assert_eq!(input["totals"], serde_json::json!({}));
    assert_eq!(place.text("out/a.csv").lines().count(), 1, "a table without rows");
}
