//! Real recordings pass every plausibility check.

use wavex_testkit::data;
use wavex_testkit::georeferenced_flight::run;
use wavex_testkit::plausibility::alarms;

/// Recordings, and the messages that are true of them.
const RECORDINGS: &[(&str, &str, &[&str])] = &[
    ("read_pulsewaves", "pulsewaves/geolas_example1.pls", &[]),
    ("read_pulsewaves", "pulsewaves/geolas_example2_first.pls", &[]),
    ("read_pulsewaves", "pulsewaves/las13fwf_example1.pls", &[]),
    ("read_pulsewaves", "pulsewaves/lvis_example1.pls", &[]),
    ("read_pulsewaves", "pulsewaves/lvis_example2_first.pls", &[]),
    ("read_pulsewaves", "pulsewaves/optech_example1.pls", &["are byte-identical copies"]),
    ("read_pulsewaves", "pulsewaves/riegl_example3.pls", &[]),
    ("read_pulsewaves", "pulsewaves/riegl_example4.pls", &[]),
    ("read_pulsewaves", "pulsewaves/test.pls", &[]),
    ("read_pulsewaves", "pulsewaves/tezt.plz", &[]),
    ("read_pulsewaves", "riegl_q680i_dev/riegl_q680i_dev.pls", &[]),
    // Scan angles of 85 degrees and more beside beams near nadir.
    (
        "read_las",
        "riegl_q680i_dev/riegl_q680i_dev.las",
        &["the scan angles in the file contradict its beams"],
    ),
    ("read_las", "las_compressed/fwf_uncompressed.las", &[]),
    ("read_las", "las_compressed/fwf.laz", &[]),
];

#[test]
fn real_recordings_are_plausible() {
    let Some(data) = data() else { return };
    for (reader, file, true_messages) in RECORDINGS {
        let folder = tempfile::tempdir().unwrap();
        let job = format!(
            "[[stage]]\ntype = '{reader}'\npath = '{}'\n[[stage]]\ntype = 'write_arrow'\npath = '*.arrow'\n",
            data.join(file).display()
        );
        let summary = run(folder.path(), &job).unwrap_or_else(|error| panic!("{file}: {error}"));
        let said = alarms(&summary);
        let is_as_expected = said.len() == true_messages.len()
            && said.iter().zip(*true_messages).all(|(said, words)| said.contains(words));
        assert!(is_as_expected, "{file}: {said:?}");
    }
}
