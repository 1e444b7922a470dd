//! A small simulated flight with its sensor model, and a fast job with every kind of output.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use crate::{Outcome, TestFolder};
use wavex_formats::trajectory::sbet::SbetRecord;

/// Makes the recording `in/a.arrow` and its sensor model.
const MAKE: &str = "\
[[stage]]
type = 'simulate'
stem = 'a'
lines = 6
shots_per_line = 60
[[stage]]
type = 'write_arrow'
path = '../in/*.arrow'
[[stage]]
type = 'calibrate'
waveforms = 300
save = '../in/model.json'
";

/// Stages with every kind of output.
pub const STAGES: &str = "\
[[stage]]
type = 'read_arrow'
path = 'in/*.arrow'
[[stage]]
type = 'calibrate'
load = 'in/model.json'
[[stage]]
type = 'decompose'
mode = 'fastest'
[[stage]]
type = 'georeference'
[[stage]]
type = 'write_las'
path = '*.laz'
[[stage]]
type = 'write_lstat'
[[stage]]
type = 'write_table'
path = '*.csv'
[[stage]]
type = 'write_table'
path = '*.parquet'
[[stage]]
type = 'write_table'
path = '*_points.arrow'
";

/// Outputs of these stages.
pub const OUTPUTS: [&str; 5] = ["a.csv", "a.laz", "a.parquet", "a_lstat.txt", "a_points.arrow"];

/// A folder with only the recording and its sensor model, in `in`.
pub fn flight() -> TestFolder {
    let place = TestFolder::new();
    assert_eq!(place.run(MAKE), Outcome::success());
    fs::remove_dir_all(place.path("out")).unwrap();
    place
}

/// A trajectory (SBET) with records at these times, s.
pub fn sbet(times_s: [f64; 2]) -> Vec<u8> {
    let record = |time_s| SbetRecord {
        time_s,
        latitude_rad: 0.84,
        longitude_rad: 0.26,
        height_m: 900.0,
        ..SbetRecord::default()
    };
    times_s.into_iter().flat_map(|time_s| record(time_s).encode()).collect()
}

/// Runs the program in the folder; returns exit code and all messages.
pub fn wavex(place: &TestFolder, arguments: &[&str]) -> (Option<i32>, String) {
    let Outcome { code, err, .. } = place.wavex(&[arguments, &["--quiet"]].concat());
    (code, err)
}

/// Runs a job that is already in its file.
pub fn run(place: &TestFolder, arguments: &[&str]) -> Outcome {
    place.wavex(&[&["--quiet", "run", "job.toml"], arguments].concat())
}

/// Files of a folder by name, without those in subfolders.
pub fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let entries = fs::read_dir(folder).into_iter().flatten().map(Result::unwrap);
    let files = entries.filter(|entry| entry.path().is_file());
    files.map(|file| (file.file_name().into_string().unwrap(), fs::read(file.path()).unwrap())).collect()
}
