//! Loading of the library: found, not found, wrong library.

use std::path::Path;

use wavex_testkit::container::{container, rows};
use wavex_testkit::sdf::{NAME, copy, header, lengths, place, plain_line, read, stand_in};
use wavex_testkit::{Outcome, TestFolder, outcome};

fn recording() -> Vec<u8> {
    container(&header(), &[plain_line(0..5, 0)])
}

fn library_file(stem: &str) -> String {
    format!("{}{stem}{}", std::env::consts::DLL_PREFIX, std::env::consts::DLL_SUFFIX)
}

const REMEDY: &str = "give the path of RIEGL's Waveform Extraction Library (sdfifc for `.sdf`, \
                      wfmifc-mt for `.wfm`), built for this system, or its folder";

/// Runs with this library on the command line.
fn with_key(place: &TestFolder, library: &str) -> Outcome {
    let mut command = place.command(&copy(""));
    outcome(
        command.args(["--set", &format!("read_sdf.library={library}")]).env("WAVEX_RIWAVELIB", "/nowhere"),
    )
}

/// Runs with this environment variable.
fn with_variable(place: &TestFolder, value: Option<&Path>) -> Outcome {
    let mut command = place.command(&copy(""));
    match value {
        Some(value) => command.env("WAVEX_RIWAVELIB", value),
        None => command.env_remove("WAVEX_RIWAVELIB"),
    };
    outcome(&mut command)
}

#[test]
fn without_a_library_the_message_says_what_it_is_who_has_it_and_how_to_point_to_it() {
    let place = place(&recording(), "");
    let outcome = with_variable(&place, None);
    assert_eq!(outcome.code, Some(1));
    let begins = format!(
        "error: stage read_sdf: ./{NAME}: this format needs RIEGL's Waveform Extraction Library \
         (RiWAVELib), but {} was found neither where the system looks for libraries nor in ",
        library_file("sdfifc")
    );
    let ends = "; its licence forbids shipping it, but owners of a RIEGL instrument can download \
                it from RIEGL: then name the library or its folder in the environment variable \
                WAVEX_RIWAVELIB or with `--set read_sdf.library=PATH`\n";
    assert!(outcome.err.starts_with(&begins) && outcome.err.ends_with(ends), "{}", outcome.err);
}

#[test]
fn the_variable_names_the_library_or_its_folder() {
    let place = place(&recording(), "");
    let folder = place.path("riwavelib");
    std::fs::create_dir(&folder).unwrap();
    std::fs::copy(stand_in(), folder.join(library_file("sdfifc"))).unwrap();
    for value in [&stand_in(), &folder] {
        assert_eq!(with_variable(&place, Some(value)), Outcome::success());
        assert_eq!(lengths(&rows(&place.path("out/sdf.arrow"))), [(0, 5)]);
    }
}

#[test]
fn the_key_names_the_library_or_its_folder_and_goes_before_the_variable() {
    let place = place(&recording(), "");
    std::fs::create_dir(place.path("riwavelib")).unwrap();
    std::fs::copy(stand_in(), place.path("riwavelib").join(library_file("sdfifc"))).unwrap();
    for key in ["riwavelib".to_owned(), format!("riwavelib/{}", library_file("sdfifc"))] {
        assert_eq!(with_key(&place, &key).err, "", "{key}");
    }
}

#[test]
fn a_job_cannot_name_the_library() {
    let place = place(&recording(), "");
    let outcome = place.run(&copy("library = 'here/sdfifc.so'"));
    assert_eq!(outcome.code, Some(2));
    for words in [
        "job.toml:7:11",
        "a job cannot name a library (`library`)",
        "name it on the command line, `--set read_sdf.library=PATH`, or in the environment variable WAVEX_RIWAVELIB",
    ] {
        assert!(outcome.err.contains(words), "{words}: {}", outcome.err);
    }
}

#[test]
fn missing_library_is_reported() {
    let place = place(&recording(), "");
    std::fs::create_dir(place.path("empty")).unwrap();
    let message = format!(
        "stage read_sdf: ./{NAME}: the key `library` names the folder ./empty, which has no {}; \
         {REMEDY}",
        library_file("sdfifc")
    );
    place.left_nothing(with_key(&place, "empty"), &message);
    let outcome = with_variable(&place, Some(&place.path("empty")));
    assert!(
        outcome.err.contains("the environment variable WAVEX_RIWAVELIB names the folder "),
        "{}",
        outcome.err
    );
}

/// Start of the message for an unusable library, up to the loader's own text.
#[track_caller]
fn cannot_be_used(place: &TestFolder, library: &str, words: &str) {
    let outcome = with_key(place, library);
    assert_eq!(outcome.code, Some(1));
    assert!(outcome.err.contains(", which the key `library` names, cannot be loaded: "), "{}", outcome.err);
    assert!(
        outcome.err.contains(words) && outcome.err.ends_with(&format!("; {REMEDY}\n")),
        "{}",
        outcome.err
    );
}

#[test]
fn invalid_library_shows_the_message_of_the_system() {
    let place = place(&recording(), "");
    place.write("text.so", b"no library");
    cannot_be_used(&place, "text.so", "text.so");
    cannot_be_used(&place, "missing/library.so", "missing/library.so");
}

#[cfg(target_os = "linux")]
#[test]
fn another_library_lacks_the_functions() {
    cannot_be_used(&place(&recording(), ""), "libc.so.6", "fwifc_get_library_version");
}

#[test]
fn another_major_version_is_refused() {
    let place = place(&recording(), "");
    let outcome = outcome(place.command(&copy("")).env("SDF_STAND_IN_MAJOR", "2"));
    let message = format!(
        "stage read_sdf: ./{NAME}: RIEGL's library has version 2.7, but wavex supports 1.x; set a \
         library of version 1, or use a newer wavex"
    );
    place.left_nothing(outcome, &message);
}

#[test]
fn the_version_is_not_kept_from_the_library_that_fits() {
    let place = place(&recording(), "");
    assert_eq!(read(&place, "").0["format"], "RIEGL SDF (RiWAVELib 1.7)");
}

#[test]
fn convert_reads_it_by_its_name() {
    let place = place(&recording(), "");
    let mut command = wavex_testkit::wavex();
    command
        .args(["-q", "convert", NAME, "copy.arrow"])
        .current_dir(place.path(""))
        .env("WAVEX_RIWAVELIB", stand_in());
    assert_eq!(outcome(&mut command), Outcome::success());
    assert_eq!(lengths(&rows(&place.path("copy.arrow"))), [(0, 5)]);
}
