//! Small runs of the program whose calls are failed.

use std::fs;
use std::path::Path;

use wavex_testkit::las::Las;
use wavex_testkit::{Outcome, TestFolder};

/// Makes the recording `in/a.arrow` and its sensor model.
const MAKE: &str = "\
[[stage]]
type = 'simulate'
stem = 'a'
lines = 4
shots_per_line = 60
[[stage]]
type = 'write_arrow'
path = '../in/*.arrow'
[[stage]]
type = 'calibrate'
waveforms = 200
save = '../in/model.json'
";

/// Every kind of output.
const JOB: &str = "\
[job]
output_dir = 'out'
threads = 1
report_page = true
[[stage]]
type = 'read_arrow'
path = 'in/*.arrow'
[[stage]]
type = 'calibrate'
load = 'in/model.json'
save = '*_model.json'
[[stage]]
type = 'decompose'
mode = 'fastest'
[[stage]]
type = 'georeference'
[[stage]]
type = 'write_las'
path = '*.laz'
index = 'file'
wave_packets = 'external'
[[stage]]
type = 'write_lstat'
[[stage]]
type = 'write_table'
path = '*.csv'
[[stage]]
type = 'write_table'
path = '*.parquet'
[[stage]]
type = 'write_ascii'
path = '*.txt'
";

/// A recording in LAS becomes a container.
const FROM_LAS: &str = "\
[job]
output_dir = 'out'
threads = 1
[[stage]]
type = 'read_las'
path = 'in/b.las'
[[stage]]
type = 'write_arrow'
path = '*_copy.arrow'
";

/// A run of the program.
pub struct Scenario {
    /// Name in tables.
    pub name: &'static str,
    /// Arguments; `NEW` is replaced by a new name.
    arguments: &'static [&'static str],
    /// Whether it needs an archived run, which remains.
    needs_archive: bool,
}

/// All scenarios.
pub const ALL: [Scenario; 5] = [
    Scenario {
        name: "run",
        arguments: &["run", "job.toml", "--archive", "archives/NEW"],
        needs_archive: false,
    },
    Scenario {
        name: "packed",
        arguments: &["run", "las.toml", "--archive", "archives/NEW.tar.zst"],
        needs_archive: false,
    },
    Scenario {
        name: "copc",
        arguments: &["copc", "in/points.laz", "--out", "out/a.copc.laz"],
        needs_archive: false,
    },
    Scenario {
        name: "verify",
        arguments: &["verify", "kept/archive", "--outputs", "kept/out"],
        needs_archive: true,
    },
    Scenario {
        name: "replay",
        arguments: &["replay", "kept/archive", "--outputs", "kept/out"],
        needs_archive: true,
    },
];

impl Scenario {
    /// Arguments of the program for the run of this name.
    pub fn arguments(&self, new: &str) -> Vec<String> {
        let quiet = ["--progress", "never"].map(String::from);
        let takes_progress = ["run", "copc"].contains(&self.arguments[0]);
        let own = self.arguments.iter().map(|argument| argument.replace("NEW", new));
        own.chain(quiet.into_iter().filter(|_| takes_progress)).collect()
    }

    /// Whether it has outputs.
    pub fn writes(&self) -> bool {
        !self.needs_archive
    }

    /// A folder for the runs, with all inputs.
    pub fn place(&self) -> TestFolder {
        let place = TestFolder::new();
        assert_eq!(place.run(MAKE), Outcome::success());
        fs::remove_dir_all(place.path("out")).unwrap();
        let las = Las::new(40);
        place.write("in/b.las", &las.las());
        place.write("in/b.wdp", &las.packets);
        place.write("job.toml", JOB.as_bytes());
        place.write("las.toml", FROM_LAS.as_bytes());
        fs::create_dir(place.path("tmp")).unwrap();
        let archive = ["--quiet", "run", "job.toml", "--archive", "kept/archive"];
        assert_eq!(place.wavex(&archive), Outcome::success());
        fs::copy(place.path("out/a.laz"), place.path("in/points.laz")).unwrap();
        if self.needs_archive {
            fs::rename(place.path("out"), place.path("kept/out")).unwrap();
        } else {
            fs::remove_dir_all(place.path("kept")).unwrap();
            fs::remove_dir_all(place.path("out")).unwrap();
        }
        place
    }
}

/// Removes all outputs.
pub fn clear(place: &Path) {
    for folder in ["out", "archives", "tmp"] {
        let _ = fs::remove_dir_all(place.join(folder));
    }
    fs::create_dir(place.join("tmp")).unwrap();
}
