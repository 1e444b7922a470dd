//! Command lines of the documents, run on simulated inputs.

use std::sync::OnceLock;

use wavex_testkit::las::Las;
use wavex_testkit::sdf::stand_in;
use wavex_testkit::{Outcome, TestFolder, outcome};

/// Runs `wavex import` with these words in a folder, with the stand-in for RIEGL's library.
pub(crate) fn wavex(place: &TestFolder, line: &str) -> Outcome {
    let mut program = wavex_testkit::wavex();
    program.arg("import").args(line.split_whitespace()).current_dir(place.path(""));
    if place.path("data.sdf").exists() || place.path("indir").exists() {
        program.env("WAVEX_RIWAVELIB", stand_in());
    }
    outcome(&mut program)
}

/// Asserts that the line runs without messages and leaves these files besides inputs, log and
/// report.
#[track_caller]
pub(crate) fn leaves(place: &TestFolder, line: &str, files: &[&str]) -> String {
    let ended = wavex(place, &format!("--run -- {line}"));
    assert_eq!(ended.code, Some(0), "{line}: {}", ended.err);
    assert!(!ended.err.contains("not supported by this build"), "{line}: {}", ended.err);
    for file in files {
        assert!(place.path(file).is_file(), "{file} is missing: {}", ended.out);
    }
    ended.out
}

/// A LAS recording of 400 pulses at nadir.
fn waveform_las() -> TestFolder {
    let recording = Las::new(400);
    TestFolder::with(&[("waveform.las", &recording.las()), ("waveform.wdp", &recording.packets)])
}

/// A recorded flight with two to three pulses in the air, served as SDF by the stand-in, and its
/// trajectory.
fn data_sdf() -> TestFolder {
    static FILES: OnceLock<[Vec<u8>; 2]> = OnceLock::new();
    let [recording, trajectory] = FILES.get_or_init(|| {
        let place = TestFolder::new();
        let job = "[[stage]]\ntype = 'simulate'\nstem = 'data'\nlines = 3\nshots_per_line = 100\n\
                   as_recorded = true\npulse_rate_hz = 300000\nmodulation_ns = 15.0\nflying_height_m = 1000.0\n\
                   pof = 'file.pof'\n\
                   [[stage]]\ntype = 'write_arrow'\n";
        assert_eq!(place.run(job), Outcome::success());
        ["data.arrow", "file.pof"].map(|name| std::fs::read(place.path("out").join(name)).unwrap())
    });
    TestFolder::with(&[("data.sdf", recording), ("file.pof", trajectory)])
}

/// From the header of a LAS or LAZ file: minor version, number of points, and minimum easting.
pub(crate) fn header(place: &TestFolder, file: &str) -> (u8, u64, f64) {
    let bytes = std::fs::read(place.path(file)).unwrap();
    let u32_at = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
    let u64_at = |at: usize| u64::from_le_bytes(bytes[at..at + 8].try_into().unwrap());
    let points = if bytes[25] >= 4 { u64_at(247) } else { u32_at(107).into() };
    (bytes[25], points, f64::from_bits(u64_at(187)))
}

#[test]
fn lines_of_version_1_0() {
    let place = waveform_las();
    leaves(&place, "wavex -i waveform.las -o points.laz -fastest", &["points.laz"]);
    let (minor, points, _) = header(&place, "points.laz");
    assert_eq!((minor, points), (2, 400), "an echo of each pulse");
    leaves(&place, "wavex -i waveform.las -stat -d 6 -min_width 0.5", &["out.laz", "out_stat.txt"]);
    assert_eq!(header(&place, "out.laz").1, 400);
}

#[test]
fn lines_of_version_1_1() {
    let place = data_sdf();
    let line = "wavex -i data.sdf -po file.pof -lstat -o12 -utm 33 -gps_date 2025-05-06";
    leaves(&place, line, &["data.laz", "data_lstat.txt"]);
    let (minor, points, easting) = header(&place, "data.laz");
    assert_eq!(minor, 2);
    assert!(points >= 250, "{points} points of 300 pulses");
    assert!((100_000.0..900_000.0).contains(&easting), "no easting of UTM: {easting}");
    leaves(&place, "wavex -i data.sdf -fastest -oext 0 -O nothing -nil", &["nothing/wavex_report.json"]);
    assert!(!place.path("nothing/data.laz").exists());
    // Only LAZ can contain an index.
    leaves(&place, "-i data.sdf -fastest -olas -lax_append", &["data.las", "data.lax", "data_stat.log"]);
    leaves(&place, "-i data.sdf -fastest -o flown.laz -lax_append", &["flown.laz", "flown_stat.log"]);
    assert!(!place.path("flown.lax").exists());
}

#[test]
fn statistics_of_a_recording() {
    let place = data_sdf();
    let out = leaves(&place, "wavex -sdfscan -i data.sdf -name scan", &["scan_scan.txt", "scan_scan.html"]);
    let has_all = out.lines().any(|line| line.split_whitespace().eq(["shots", "300"]));
    assert!(has_all, "{out}");
}

/// Recordings of a pattern are scanned one by one, and additional commands run even if one
/// recording fails.
#[test]
fn statistics_of_each_recording_of_a_pattern() {
    let source = data_sdf();
    let [recording, trajectory] =
        ["data.sdf", "file.pof"].map(|name| std::fs::read(source.path(name)).unwrap());
    let line = "wavex -i indir/*.sdf -O outdir -po file.pof -osdfstat -ostat -fastest -plot_po track.txt";
    let files = |second: &'static str| {
        [
            "outdir/one.laz".to_owned(),
            "outdir/out_one_scan.txt".to_owned(),
            "outdir/out_one_ranges.txt".to_owned(),
            format!("outdir/{second}"),
            "outdir/track.txt".to_owned(),
        ]
    };
    let place = TestFolder::with(&[
        ("indir/one.sdf", &recording[..]),
        ("indir/two.sdf", &recording),
        ("file.pof", &trajectory),
    ]);
    let wanted = files("out_two_scan.txt");
    leaves(&place, line, &wanted.each_ref().map(String::as_str));
    // A custom name, and a single recording.
    leaves(&place, "wavex -sdfscanfast -i indir/*.sdf -name n", &["n_one_scan.txt", "n_two_scan.txt"]);
    leaves(&place, "wavex -sdfscan -i indir/o*.sdf -name n", &["n_scan.txt"]);

    place.write("indir/bad.sdf", b"no recording");
    let ended = wavex(&place, "--run -- -sdfscan -i indir/*.sdf -name m -po file.pof -plot_po track_2.txt");
    assert_eq!(ended.code, Some(1));
    assert!(ended.err.contains("indir/bad.sdf"), "{}", ended.err);
    for file in ["m_one_scan.txt", "m_two_scan.txt", "track_2.txt"] {
        assert!(place.path(file).is_file(), "{file} is missing: {}", ended.err);
    }
    let none = wavex(&place, "--run -- -sdfscan -i nowhere/*.sdf");
    let expected = "error: no file matches `nowhere/*.sdf`; check the pattern and the folder\n";
    assert_eq!((none.code, none.err.as_str()), (Some(1), expected));
}

#[test]
fn a_line_that_asks_for_information_gets_it() {
    let place = TestFolder::new();
    let ended = wavex(&place, "--run -- wavex -v");
    let version = format!("wavex {}\n", env!("CARGO_PKG_VERSION"));
    assert_eq!(ended, Outcome { code: Some(0), out: version, err: String::new() });
    let help = wavex(&place, "--run -- -h").out;
    assert!(help.contains("Usage: wavex [OPTIONS] <COMMAND>"), "{help}");
    let cleared = wavex(&place, "--run -- -clear_log").out;
    assert!(cleared.contains("-clear_log: logs are next to the outputs"), "{cleared}");
}

#[test]
fn a_job_is_printed_or_written_and_what_is_there_is_left_alone() {
    let place = waveform_las();
    let line = "-- -i waveform.las -o points.laz -fastest";
    let printed = wavex(&place, line);
    assert_eq!((printed.code, printed.err.as_str()), (Some(0), ""));
    assert_eq!(wavex(&place, &format!("-o job.toml {line}")).out, "");
    assert_eq!(place.text("job.toml"), printed.out);
    let again = wavex(&place, &format!("-o job.toml {line}"));
    let expected = "error: job.toml: the file already exists; choose another name\n";
    assert_eq!(again, Outcome::failure(2, expected));
    std::fs::create_dir(place.path("jobs")).unwrap();
    assert_eq!(wavex(&place, &format!("--run -o jobs/job.toml {line}")).code, Some(0));
    assert!(place.path("points.laz").is_file(), "paths start where the line was typed");
}

#[test]
fn a_line_without_a_job_is_not_written() {
    let place = TestFolder::new();
    let ended = wavex(&place, "-o job.toml -- -v");
    assert_eq!((ended.code, ended.out.as_str()), (Some(2), ""));
    assert!(
        ended.err.starts_with("error: this command line makes no job, so `-o` has nothing to write:\n"),
        "{}",
        ended.err
    );
    assert!(!place.path("job.toml").exists());
}

#[test]
fn a_wrong_line_is_refused() {
    let ended = wavex(&TestFolder::new(), "-- -i a.sdf -dett 5");
    let expected = "error: version 1.1 has no option `-dett`\n  | wavex -i a.sdf -dett 5\n  |                ^^^^^\n  \
                    = help: did you mean `-det`?\n";
    assert_eq!(ended, Outcome::failure(2, expected));
}

#[test]
fn a_value_that_a_key_cannot_take_is_shown_at_its_option() {
    let ended = wavex(&TestFolder::new(), "-- -i a.sdf -mem 16");
    let expected = "error: the job of this line is invalid: `memory_mb` must be at least 64 and at most 1000000000, \
                    got 16\n  | wavex -i a.sdf -mem 16\n  |                ^^^^\n";
    assert_eq!(ended, Outcome::failure(2, expected));
}

/// A job without a part that changes its points is not run.
#[test]
fn a_line_with_columns_that_are_not_enough_is_not_run() {
    let place = data_sdf();
    let ended = wavex(&place, "--run -- -i data.sdf -po a.txt -po_parse xyztwk");
    assert_eq!((ended.code, ended.out.as_str()), (Some(2), ""));
    let expected = "error: not run: -po_parse xyztwk: the pitch (`p`) is missing, and points cannot be georeferenced without it: give a trajectory that has it, or add the column to the text file and its letter here\n";
    assert!(ended.err.ends_with(expected), "{}", ended.err);
}
