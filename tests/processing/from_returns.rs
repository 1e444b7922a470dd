//! `wavex run --from-returns`: outputs of decomposed lines under another trajectory and calibration.

use std::collections::BTreeMap;
use std::fs;

use wavex_formats::trajectory::sbet::RECORD_BYTES;
use wavex_testkit::flight::files;
use wavex_testkit::{Outcome, TestFolder};

const GEOMETRY: &str = "trajectory = 'in/*.out'\n";

/// Calibration and corrections of a later run.
const LATER: [&str; 2] = [
    "job.geometry.calibration={lever_arm_m=[0.31,-0.2,0.4],boresight_deg=[0.2,-0.3,0.4],e0=0.05,time_offset_s=0.0004}",
    "job.geometry.corrections=corrections.toml",
];

/// Two strips with two receivers and several pulses in the air.
fn survey(writers: &str) -> TestFolder {
    let place = TestFolder::new();
    let mut corrections = "version = 1\ntime = 'week'\n".to_owned();
    for (number, stem) in ["a", "b"].into_iter().enumerate() {
        let start_s = 208_800 + 100 * number;
        let made = place.run(&format!(
            "[[stage]]\ntype = 'simulate'\nstem = '{stem}'\nseed = {number}\nscene_seed = 1\nlandscape = 'country'\n\
             lines = 24\nshots_per_line = 160\npulse_rate_hz = 400000\nmodulation_ns = 15\nflying_height_m = 1500\n\
             as_recorded = true\nhigh_power = true\nroll_deg = 2.0\nstart_time_s = {start_s}\nresponse = 'gaussian'\n\
             sbet = '../in/*.out'\n[[stage]]\ntype = 'write_arrow'\npath = '../in/*.arrow'\n"
        ));
        assert_eq!(made, Outcome::success());
        let last_s = start_s + 1;
        corrections += &format!(
            "[[strip]]\nrecording = '{stem}'\nfirst_s = {start_s}.0\nlast_s = {last_s}.0\nknots = [\n\
             {{ time_s = {start_s}.0, north_east_down_m = [0.05, -0.02, 0.03], roll_pitch_heading_deg = [0.004, -0.002, 0.01] }},\n\
             {{ time_s = {last_s}.0, north_east_down_m = [0.01, 0.04, -0.02], roll_pitch_heading_deg = [0.001, 0.003, -0.02] }},\n]\n"
        );
    }
    fs::remove_dir_all(place.path("out")).unwrap();
    place.write("corrections.toml", corrections.as_bytes());
    place.write("survey.toml", job(writers).as_bytes());
    place
}

fn job(writers: &str) -> String {
    format!(
        "[job]\noutput_dir = 'out'\nthreads = 2\n[job.geometry]\n{GEOMETRY}\
         [[stage]]\ntype = 'read_arrow'\npath = 'in/*.arrow'\n\
         [[stage]]\ntype = 'resolve_mta'\n\
         [[stage]]\ntype = 'fuse_channels'\ngain_ratio = 0.1\ndelay_ns = 0.0\n\
         [[stage]]\ntype = 'calibrate'\nwaveforms = 2000\nresponse = 'gaussian'\n\
         [[stage]]\ntype = 'decompose'\nmode = 'fastest'\n{writers}"
    )
}

const WRITERS: &str = "[[stage]]\ntype = 'write_returns'\n\
                       [[stage]]\ntype = 'correct'\n\
                       [[stage]]\ntype = 'filter_outliers'\nwaves = true\n\
                       [[stage]]\ntype = 'write_trajectory'\n\
                       [[stage]]\ntype = 'georeference'\n\
                       [[stage]]\ntype = 'write_las'\npath = '*.laz'\n\
                       [[stage]]\ntype = 'write_ascii'\npath = '*.txt'\n\
                       [[stage]]\ntype = 'write_table'\npath = '*.parquet'\n\
                       [[stage]]\ntype = 'write_lstat'\n";

fn run(place: &TestFolder, job: &str, more: &[&str]) -> Outcome {
    let set = LATER.iter().flat_map(|set| ["--set", *set]);
    let arguments: Vec<&str> = ["run", job].into_iter().chain(set).chain(more.iter().copied()).collect();
    place.wavex(&arguments)
}

/// Outputs of the stages.
fn products(place: &TestFolder, folder: &str) -> BTreeMap<String, Vec<u8>> {
    let mut found = files(&place.path(folder));
    let is_of_run = |name: &str| name.ends_with(".json") || name.ends_with(".log");
    found.retain(|name, _| !is_of_run(name));
    found
}

#[test]
fn outputs_are_those_of_a_run_of_the_whole_job() {
    let place = survey(WRITERS);
    assert_eq!(place.wavex(&["run", "survey.toml", "--quiet"]), Outcome::success());
    let before = products(&place, "out");
    assert_eq!(run(&place, "survey.toml", &["--quiet", "--set", "job.output_dir=fresh"]), Outcome::success());
    let fresh = products(&place, "fresh");
    assert_eq!(fresh.len(), 12, "{:?}", fresh.keys());
    for (name, bytes) in &fresh {
        let is_same = before[name] == *bytes;
        assert_eq!(is_same, name.ends_with("_decomposed.arrow"), "{name}: beams are stored before poses");
    }
    // The recordings are not needed.
    fs::rename(place.path("in/a.arrow"), place.path("a.bak")).unwrap();
    fs::write(place.path("in/a.arrow"), "").unwrap();
    let refused = run(&place, "survey.toml", &["--from-returns", "--quiet"]);
    assert!(
        refused.err.contains("a_decomposed.arrow: cannot be used for this job: the recording has changed"),
        "{}",
        refused.err
    );
    fs::rename(place.path("a.bak"), place.path("in/a.arrow")).unwrap();
    for threads in ["1", "4"] {
        let outcome = run(&place, "survey.toml", &["--from-returns", "--quiet", "--threads", threads]);
        assert_eq!(outcome, Outcome::success());
        let applied = products(&place, "out");
        assert!(applied.keys().eq(fresh.keys()), "{:?}", applied.keys());
        for (name, bytes) in &fresh {
            assert!(applied[name] == *bytes, "{name} with {threads} threads");
        }
    }
    // Archives, replay and resume know such a run as any other.
    let outcome = run(&place, "survey.toml", &["--from-returns", "--quiet", "--archive", "archived"]);
    assert_eq!(outcome, Outcome::success());
    assert_eq!(place.wavex(&["replay", "archived", "--quiet"]), Outcome::success());
    let resumed = run(&place, "survey.toml", &["--from-returns", "--resume"]);
    assert!(
        resumed.out.contains("2 skipped") || resumed.err.contains("skipped"),
        "{}{}",
        resumed.out,
        resumed.err
    );
}

#[test]
fn files_of_other_settings_are_refused() {
    let place = survey(WRITERS);
    let refused = |job: &str, more: &[&str], code: i32, expected: &str| {
        place.write("other.toml", job.as_bytes());
        let outcome = run(&place, "other.toml", &[&["--from-returns", "--quiet"], more].concat());
        assert_eq!(outcome.code, Some(code), "{}", outcome.err);
        assert!(outcome.err.contains(expected), "{}", outcome.err);
    };
    let whole = job(WRITERS);
    let missing =
        "out/a_decomposed.arrow and 1 more: no such returns file; run the job without `--from-returns` first";
    refused(&whole, &[], 1, missing);
    assert_eq!(place.wavex(&["run", "survey.toml", "--quiet"]), Outcome::success());
    let without = whole.replace("[[stage]]\ntype = 'write_returns'\n", "");
    refused(&without, &[], 2, "other.toml: the job has no stage `write_returns`, whose files could be read");
    let early = whole
        .replace("[[stage]]\ntype = 'resolve", "[[stage]]\ntype = 'write_lstat'\n[[stage]]\ntype = 'resolve");
    let early = early.replacen("'write_lstat'\n", "'write_lstat'\npath = '*_raw.txt'\n", 1);
    refused(&early, &[], 2, "is before `write_returns` and would not be written again");
    let late = whole.replace("[[stage]]\ntype = 'correct'\n", "");
    let late = late.replace(
        "[[stage]]\ntype = 'write_returns'",
        "[[stage]]\ntype = 'correct'\n[[stage]]\ntype = 'write_returns'",
    );
    refused(&late, &[], 1, "`write_returns` does not follow `decompose`");
    let packets = ["--set", "write_las.wave_packets=external"];
    refused(&whole, &packets, 2, "`write_las` writes waveforms, which returns files do not have");
    let other = ["--set", "decompose.mode=fast_separated"];
    let expected = "`mode` of `decompose` was \"fastest\", and is \"fast_separated\"; run the job without `--from-returns`";
    refused(&whole, &other, 1, expected);
    let unfused = whole.replace("[[stage]]\ntype = 'fuse_channels'\ngain_ratio = 0.1\ndelay_ns = 0.0\n", "");
    let expected = "the stages before it were read_arrow, resolve_mta, fuse_channels, calibrate, decompose, and are read_arrow";
    refused(&unfused, &[], 1, expected);
    // The trajectory ends within the recording now: 1 s before it, and 5 ms of it, with 200 records per second.
    let expected =
        "has no pose with this trajectory and calibration, but had one when its line was decomposed";
    let trajectory = fs::read(place.path("in/a.out")).unwrap();
    place.write("in/a.out", &trajectory[..202 * RECORD_BYTES]);
    refused(&whole, &[], 1, expected);
    place.write("in/a.out", &trajectory);
    // Cut off.
    let path = place.path("out/b_decomposed.arrow");
    let bytes = fs::read(&path).unwrap();
    fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    refused(&whole, &[], 1, "b_decomposed.arrow: byte ");
}
