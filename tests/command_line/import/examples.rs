//! Every example of both documents with its job.
//!
//! A test that finds an outdated job rewrites it and fails, so that the new one is reviewed and
//! committed.

use std::fs;
use std::path::{Path, PathBuf};

use wavex::classic::draft::Known;

use super::{complete, files, here, in_version, words};

/// Name of the job file, and the command line.
pub(crate) const EXAMPLES: &[(&str, &str)] = &[
    ("1.0-01", "wavex -i waveform.las -o points.laz -fastest"),
    ("1.0-02", "wavex -i waveform.las -o points.laz -fastsep -traj -stat"),
    ("1.0-03", r"wavex -i waveform.las -o points.laz -I F:\indir -O E:\outdir -ounc 0"),
    ("1.0-04", "wavex -i titan_C3.las -o points.laz -odd_dt -0.25"),
    ("1.0-05", "wavex -i LDR100301_120340_4.LAS -o points.laz -min_width 0.5"),
    ("1.1-01", "wavex -i data.sdf -po file.pof -fastest"),
    ("1.1-02", "wavex -i data.sdf -po file.pof -lstat -o12"),
    ("1.1-03", "wavex -i data.sdf -po file.pof -lstat -olas -olax"),
    ("1.1-04", "wavex -i data.sdf -po file.pof -lstat -I indir -O outdir -ounc 0 -o*_abc"),
    ("1.1-05", "wavex -i indir/*.sdf -O outdir -po podir/file.pof -fastest -oext 0"),
    ("1.1-06", "wavex -i indir/*.sdf -O outdir -po sbet.out -wkt proj.txt -geoid g2012bu0"),
    ("1.1-07", "wavex -i indir/*.sdf -O outdir -po sbet.out -wkt proj.txt -calib_corr cal.txt"),
    (
        "1.1-08",
        "wavex -i indir/*.sdf -O outdir -po sbet.out -utm 55 -feet -calib_corr cal.txt -mount mnt.txt",
    ),
    (
        "1.1-09",
        "wavex -i indir/*.sdf -O outdir -po sbet.out -calib_corr cal.txt -utc -t_corr 0.72 -t_min 82300 -t_max 82400",
    ),
    ("1.1-10", "wavex -i data.sdf -po file.txt -A -po_parse xyztpk -fastest"),
    ("1.1-11", "wavex -i data.sdf -po file.txt -A -po_parse xyztpk -fastest -geo"),
    ("1.1-12", "wavex -i data.sdf"),
    ("1.1-13", "wavex -i data.sdf -det 6 -lm_det 10"),
    ("1.1-14", "wavex -i data.sdf -fastest -oext 0 -nil"),
    ("1.1-15", "wavex -sdfscan -i data.sdf -name scan"),
    ("1.1-16", "wavex -h"),
    ("1.1-17", "wavex -v"),
    ("1.1-18", "wavex -clear_log"),
];

fn file(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("tests/command_line/import/jobs/{name}.toml"))
}

/// Returns whether a stored job is up to date; rewrites it if not.
fn is_up_to_date(name: &str, text: &str) -> bool {
    let found = fs::read_to_string(file(name)).unwrap_or_default().replace("\r\n", "\n");
    if found != text {
        fs::create_dir_all(file(name).parent().unwrap()).unwrap();
        fs::write(file(name), text).unwrap();
    }
    found == text
}

#[track_caller]
fn check<'n>(jobs: impl IntoIterator<Item = (&'n str, String)>) {
    let old: Vec<&str> =
        jobs.into_iter().filter(|(name, text)| !is_up_to_date(name, text)).map(|(name, _)| name).collect();
    assert!(
        old.is_empty(),
        "outdated jobs rewritten in tests/command_line/import/jobs; review and commit them: {old:?}"
    );
}

#[test]
fn every_example_becomes_the_job_that_is_written_out() {
    check(EXAMPLES.iter().map(|(name, line)| (*name, complete(line).text)));
}

#[test]
fn every_example_becomes_a_job_that_fits_this_build() {
    for (name, line) in EXAMPLES {
        let import = here(line);
        let has_input = line.contains("-i ") && !line.contains("-sdfscan");
        assert_eq!(import.has_job, has_input, "{name}");
    }
}

/// The options files of both documents are equivalent; `R` is an option of version 1.0 in both.
#[test]
fn the_example_of_a_file_of_options_is_read() {
    let job = |(classic, name, file, line): (&str, _, &str, &str)| {
        let read = |path: &str| (path == file).then(|| "mem=4096\ndet=5\nR=1000\n".to_owned());
        (name, in_version(Some(classic), &words(line), &Known::Everything, &read).unwrap().text)
    };
    let both = [
        ("1.0", "1.0-file", "wavex.opt", "-i waveform.las"),
        ("1.1", "1.1-file", "wavex.opt.txt", "-i data.sdf"),
    ];
    check(both.map(job));
}

/// Both documents also print command lines that request information only: `wavex -h`, and
/// `wavex -v` in 1.0.
#[test]
fn information_is_asked_for_in_the_same_words_in_both_versions() {
    for line in ["wavex -h", "wavex -v"] {
        let of = |classic| in_version(Some(classic), &words(line), &Known::Everything, &files).unwrap();
        assert_eq!(of("1.0").commands, of("1.1").commands);
        assert!(!of("1.0").has_job);
    }
}
