//! The index required by the library: made once, in a writable folder.

use wavex_testkit::container::container;
use wavex_testkit::sdf::{NAME, copy, fails, header, lengths, place, plain_line, read};

fn recording() -> Vec<u8> {
    container(&header(), &[plain_line(0..5, 0), plain_line(5..10, 1)])
}

const WINDOW: &str = "time_s = [208800.2, 208800.6]";

#[test]
fn a_missing_index_is_made_and_the_record_is_read_again() {
    let place = place(&recording(), "index needed");
    assert_eq!(lengths(&read(&place, "").1), [(0, 5), (1, 5)]);
    assert_eq!(place.text(&format!("{NAME}.idx")), "the index of the stand-in");
}

#[test]
fn a_file_without_an_index_is_read_from_its_beginning_without_one() {
    let place = place(&recording(), "index hidden");
    assert_eq!(lengths(&read(&place, "").1), [(0, 5), (1, 5)]);
    assert!(!place.path(&format!("{NAME}.idx")).exists(), "no index was made");
    assert_eq!(lengths(&read(&place, WINDOW).1), [(0, 3), (1, 2)]);
    assert!(place.path(&format!("{NAME}.idx")).exists());
}

#[test]
fn unwritable_index_names_the_remedy() {
    let message = "the file has no index, and it cannot be built: fwifc_reindex of RIEGL's library \
                   failed with 6, a runtime error: \"the index cannot be written\"; the library \
                   writes it next to the data: make that folder writable, copy or link the file to \
                   a writable folder, or set one with the key `index_dir`";
    fails(&recording(), "index needed\nread_only .", "", message);
    fails(&recording(), "index hidden\nread_only .", WINDOW, message);
}

#[cfg(unix)]
#[test]
fn an_index_may_lie_in_another_folder_and_stays_there() {
    let place = place(&recording(), "index needed\nread_only .");
    let (_, lines) = read(&place, "index_dir = 'index'");
    assert_eq!(lengths(&lines), [(0, 5), (1, 5)]);
    let folders: Vec<_> =
        std::fs::read_dir(place.path("index")).unwrap().map(|entry| entry.unwrap().path()).collect();
    assert_eq!(folders.len(), 1);
    let index = folders[0].join(format!("{NAME}.idx"));
    assert!(index.exists());
    assert!(!place.path(&format!("{NAME}.idx")).exists());
    // The second run uses the same index: a library that cannot make one suffices.
    std::fs::write(&index, "still there").unwrap();
    place.write(&format!("{NAME}.txt"), b"index needed\nfail fwifc_reindex 6");
    assert_eq!(read(&place, "index_dir = 'index'").1, lines);
    assert_eq!(std::fs::read_to_string(&index).unwrap(), "still there");
}

#[test]
fn an_index_folder_that_is_a_file_is_an_error() {
    let place = place(&recording(), "");
    place.write("index", b"");
    let outcome = place.run(&copy("index_dir = 'index'"));
    assert_eq!(outcome.code, Some(1));
    assert!(outcome.err.contains("cannot create the folder for the index: "), "{}", outcome.err);
}
