//! All failures of the library and the resulting messages.

use wavex_testkit::container::container;
use wavex_testkit::sdf::{NAME, fails, header, lengths, place, plain_line, read};
use wavex_testkit::{TestFolder, notes, rejected};

/// Two lines of five shots: records 1 to 5, end of line, 7 to 11, end of line.
fn recording() -> Vec<u8> {
    container(&header(), &[plain_line(0..5, 0), plain_line(5..10, 1)])
}

const NEWER: &str = "the library may have a version that wavex does not support: use a newer one, or report this \
     to the wavex developers";
const EXTENSION: &str = "`.sdf` needs the library sdfifc, `.wfm` needs wfmifc-mt: check `library`, \
                         the file's extension, and its content";
const DAMAGED: &str = "the file may be damaged: copy it again, or try another version of the library";
const TOLD: &str = "\"injected failure\"";

#[test]
fn each_code_has_its_own_message() {
    for (code, meaning, remedy) in [
        (1, "a bad argument", NEWER),
        (2, "an unsupported format", EXTENSION),
        (4, "an unknown exception", "the file may be damaged: copy it again, or try a newer library"),
        (5, "not implemented", "use a newer version of the library"),
        (6, "a runtime error", "check the file, its folder and the disk"),
        (7, "not licensed", "ask RIEGL for a licence that covers it"),
        (
            8,
            "an unknown code",
            "use a supported version of the library, or report this to the wavex developers",
        ),
    ] {
        let message = format!(
            "record 9: fwifc_read of RIEGL's library failed with {code}, {meaning}: \
                     {TOLD}; {remedy}"
        );
        fails(&recording(), &format!("fail fwifc_read {code} 9"), "", &message);
    }
}

#[test]
fn an_index_that_does_not_help_is_an_error() {
    let message = format!(
        "record 9: fwifc_seek of RIEGL's library failed with 3, a missing index: {TOLD}; remove \
         the `.idx` file next to the data so that it is rebuilt"
    );
    fails(&recording(), "fail fwifc_read 3 9\nfail fwifc_seek 3", "", &message);
}

#[test]
fn each_function_may_fail() {
    for (function, keys) in [
        ("fwifc_open", ""),
        ("fwifc_set_sosbl_relative", ""),
        ("fwifc_get_info", ""),
        ("fwifc_seek_time_external", "time_s = [208800.2, 208800.6]"),
        ("fwifc_tell", "time_s = [208800.2, 208800.6]"),
    ] {
        let message = format!(
            "{function} of RIEGL's library failed with 6, a runtime error: {TOLD}; check the file, \
             its folder and the disk"
        );
        fails(&recording(), &format!("fail {function} 6"), keys, &message);
    }
    let unsynchronised = "unsynchronised\nfail fwifc_seek_time 4";
    let message = format!(
        "fwifc_seek_time of RIEGL's library failed with 4, an unknown exception: {TOLD}; the file \
         may be damaged: copy it again, or try a newer library"
    );
    fails(&recording(), unsynchronised, "time_s = [5.0, 6.0]", &message);
}

#[test]
fn invalid_files_show_the_message_of_the_library() {
    let message = "fwifc_open of RIEGL's library failed with 2, an unsupported format: ";
    let place = place(b"no recording", "");
    let outcome = place.run(&wavex_testkit::sdf::copy(""));
    assert!(outcome.err.contains(message) && outcome.err.contains("not Arrow"), "{}", outcome.err);
}

#[test]
fn tables_without_a_licence_are_remarks() {
    let place =
        place(&recording(), "fail fwifc_get_calib 7 2\nfail fwifc_get_calib 7 3\nfail fwifc_get_calib 5 0");
    let (report, lines) = read(&place, "");
    assert_eq!(lengths(&lines), [(0, 5), (1, 5)]);
    let fails = |code: &str| format!("fwifc_get_calib of RIEGL's library failed with {code}: {TOLD}");
    let expected = [
        format!("{}; the high power channel has no amplitudes in dB", fails("5, not implemented")),
        format!("{}; the range correction of the low power channel is off", fails("7, not licensed")),
        format!("{}; the range correction of the high power channel is off", fails("7, not licensed")),
    ];
    assert_eq!(notes(&report), expected);
}

#[test]
fn sizes_that_cannot_be_are_errors_before_anything_is_allocated() {
    for (mischief, problem) in [
        ("samples 2 4294967295", "a block of 4294967295 samples"),
        ("samples 2 65537", "a block of 65537 samples"),
        ("null 2", "a null pointer to samples"),
        ("blocks 2 4294967295", "a record of 4294967295 blocks"),
        ("blocks 2 4097", "a record of 4097 blocks"),
    ] {
        let message = format!(
            "record 2: fwifc_read of RIEGL's library returned invalid data: {problem}; \
                     {DAMAGED}"
        );
        fails(&recording(), mischief, "", &message);
    }
    for stride in [0, 8, 31, 4097] {
        let message = format!(
            "record 1: fwifc_read of RIEGL's library returned invalid data: blocks of {stride} \
             bytes each, but 32 to 4096 are valid; {DAMAGED}"
        );
        fails(&recording(), &format!("stride {stride}"), "", &message);
    }
}

#[test]
fn a_table_that_cannot_be_is_a_remark() {
    let place = place(&recording(), "table 65537");
    let expected = "fwifc_get_calib of RIEGL's library returned invalid data: a table of 65537 \
                    entries; the low power channel has no amplitudes in dB";
    assert_eq!(notes(&read(&place, "").0)[0], expected);
}

#[test]
fn facts_that_cannot_be_are_errors() {
    for (mischief, problem) in [
        ("v_group 0", "a group velocity of 0 m/s"),
        ("v_group NaN", "a group velocity of NaN m/s"),
        ("v_group 299792459", "a group velocity of 299792459 m/s"),
        ("sampling_time -1e-9", "a sampling interval of -0.000000001 s"),
        ("sampling_time 1", "a sampling interval of 1 s"),
    ] {
        let message =
            format!("fwifc_get_info of RIEGL's library returned invalid data: {problem}; {DAMAGED}");
        fails(&recording(), mischief, "", &message);
    }
}

#[test]
fn shots_without_directions_are_rejected_with_their_blocks() {
    let place = place(&recording(), "nan 2\nnan 8");
    let (report, lines) = read(&place, "");
    assert_eq!(lengths(&lines), [(0, 4), (1, 4)]);
    let expected = [
        ("blocks: the origin is not finite".to_owned(), 4),
        ("shots: the origin is not finite".to_owned(), 2),
    ];
    assert_eq!(rejected(&report).into_iter().collect::<Vec<_>>(), expected);
}

#[test]
fn a_file_that_ends_in_a_line_is_said_to_be_cut() {
    let place = place(&recording(), "end_after 9");
    let (report, lines) = read(&place, "");
    assert_eq!(lengths(&lines), [(0, 5), (1, 3)]);
    assert_eq!(notes(&report), ["the file ends within a scan line: it may be truncated"]);
}

#[test]
fn a_file_that_ends_with_a_line_is_whole() {
    let place = place(&recording(), "end_after 6");
    let (report, lines) = read(&place, "");
    assert_eq!(lengths(&lines), [(0, 5)]);
    assert_eq!(notes(&report), Vec::<String>::new());
}

#[test]
fn a_slow_library_is_waited_for() {
    let place = place(&recording(), "slow_us 2000");
    assert_eq!(lengths(&read(&place, "").1), [(0, 5), (1, 5)]);
}

#[test]
fn a_missing_file_is_missing_and_a_folder_is_none() {
    let place = TestFolder::new();
    let outcome = place.run(&wavex_testkit::sdf::copy(""));
    let message = format!(
        "stage read_sdf: ./{NAME}: cannot open: No such file or directory (os error 2); check the path"
    );
    place.left_nothing(outcome, &message);
    let place = TestFolder::new();
    std::fs::create_dir(place.path(NAME)).unwrap();
    let outcome = place.run(&wavex_testkit::sdf::copy(""));
    place.left_nothing(
        outcome,
        &format!(
            "./{NAME}: it is a folder, not a recording; there is no recording in it: give the path of one"
        ),
    );
}
