//! Archives of runs in which an input failed.

use std::fs;

use serde_json::Value;
use wavex_testkit::flight::{STAGES, flight, run, wavex};
use wavex_testkit::{Outcome, TestFolder};

/// A flight with a damaged recording besides the good one.
fn flights() -> TestFolder {
    let place = flight();
    place.write("in/b.arrow", b"ARROW1");
    place.write("job.toml", format!("[job]\noutput_dir = 'out'\n{STAGES}").as_bytes());
    place
}

/// Archive of a run with a failed input.
fn archived() -> (TestFolder, Value) {
    let place = flights();
    let Outcome { code, err, .. } = run(&place, &["--archive", "archive"]);
    assert_eq!(code, Some(1), "{err}");
    assert!(err.ends_with("error: 1 of 2 inputs failed: b\n"), "{err}");
    let archive = serde_json::from_str(&place.text("archive/archive.json")).unwrap();
    (place, archive)
}

#[test]
fn an_archive_says_which_inputs_failed_and_why() {
    let (place, archive) = archived();
    let failed = archive["failed"].as_array().unwrap();
    assert_eq!((failed.len(), &failed[0]["stem"]), (1, &Value::from("b")));
    let reason = failed[0]["reason"].as_str().unwrap();
    assert!(reason.starts_with("stage read_arrow: in/b.arrow: "), "{reason}");
    assert!(place.text("archive/wavex.log").contains(reason));
    let report: Value = serde_json::from_str(&place.text("archive/report.json")).unwrap();
    assert_eq!(report["inputs"][1]["failure"].as_str(), Some(reason));
    let files = |of: &str| archive[of]["files"].as_array().unwrap().len();
    assert_eq!((files("inputs"), files("outputs")), (3, 5));
    assert!(
        place.path("archive/lines/a_lstat.txt").exists() && !place.path("archive/lines/b_lstat.txt").exists()
    );

    for command in [&["verify", "archive"][..], &["replay", "archive", "--progress", "never"]] {
        let Outcome { code, out, err } = place.wavex(command);
        assert_eq!((code, err.as_str()), (Some(0), ""), "{command:?}");
        assert!(out.contains("; 1 input failed in the run: b; seal "), "{out}");
    }
}

#[test]
fn an_input_that_was_missing_is_missing_again() {
    let place = flights();
    place.write(
        "job.toml",
        fs::read_to_string(place.path("job.toml"))
            .unwrap()
            .replace("'in/*.arrow'", "['in/a.arrow', 'in/none.arrow']")
            .as_bytes(),
    );
    assert_eq!(run(&place, &["--archive", "archive"]).code, Some(1));
    let archive: Value = serde_json::from_str(&place.text("archive/archive.json")).unwrap();
    assert_eq!(archive["failed"][0]["stem"], "none");
    assert_eq!(wavex(&place, &["verify", "archive"]), (Some(0), String::new()));
    assert_eq!(wavex(&place, &["replay", "archive"]), (Some(0), String::new()));
}

/// A failure that depends on the machine, here on a missing file, is a difference.
#[test]
fn a_replay_names_inputs_that_fail_only_once() {
    let place = flights();
    let text = fs::read_to_string(place.path("job.toml")).unwrap();
    let text = text.replace("'in/*.arrow'", "['in/a.arrow', 'in/none.arrow']");
    place.write("job.toml", text.as_bytes());
    assert_eq!(run(&place, &["--archive", "archive"]).code, Some(1));
    fs::copy(place.path("in/a.arrow"), place.path("in/none.arrow")).unwrap();
    let (code, err) = wavex(&place, &["replay", "archive"]);
    assert_eq!(code, Some(1));
    assert!(err.contains("  input none: failed in the archived run, but not in the replay\n"), "{err}");
    assert!(err.contains("  output none.csv: made by the replay, but not by the archived run\n"), "{err}");
}

#[test]
fn a_run_without_a_good_input_is_not_archived() {
    let place = flights();
    fs::remove_file(place.path("in/a.arrow")).unwrap();
    assert_eq!(run(&place, &["--archive", "archive"]).code, Some(1));
    assert!(!place.path("archive").exists());
}
