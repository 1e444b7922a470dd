//! Archives of runs: creation, replay in another place, and detection of tampering.

use std::fs;
use std::path::Path;

use serde_json::Value;
use wavex_testkit::flight::{OUTPUTS, STAGES, flight, run, wavex};
use wavex_testkit::{Outcome, TestFolder};

/// A flight with a run archived as `archives/NAME`.
pub(super) fn archived(name: &str) -> TestFolder {
    let place = flight();
    place
        .write("job.toml", format!("# The job of a flight.\n[job]\noutput_dir = 'out'\n{STAGES}").as_bytes());
    let outcome = run(&place, &["--threads", "2", "--archive", &format!("archives/{name}")]);
    assert_eq!(outcome, Outcome::success());
    place
}

#[track_caller]
fn holds(place: &TestFolder, arguments: &[&str]) {
    assert_eq!(wavex(place, arguments), (Some(0), String::new()), "{arguments:?}");
}

/// Asserts that the command fails with these problems, in order.
#[track_caller]
fn fails(place: &TestFolder, arguments: &[&str], expected: &[&str]) {
    let (code, err) = wavex(place, arguments);
    assert_eq!(code, Some(1), "{err}");
    let problems: Vec<&str> = err.lines().skip(1).collect();
    assert_eq!(problems.len(), expected.len(), "{err}");
    for (problem, expected) in problems.iter().zip(expected) {
        assert!(problem.trim_start().starts_with(expected), "{problem}\ndoes not begin with\n{expected}");
    }
}

fn flip(path: &Path, at: usize) {
    let mut bytes = fs::read(path).unwrap();
    bytes[at] ^= 1;
    fs::write(path, bytes).unwrap();
}

pub(super) fn change(path: &Path, from: &str, to: &str) {
    let text = fs::read_to_string(path).unwrap();
    assert!(text.contains(from), "{from} is not in {}", path.display());
    fs::write(path, text.replacen(from, to, 1)).unwrap();
}

fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap().map(Result::unwrap) {
        let to = to.join(entry.file_name());
        if entry.path().is_dir() {
            copy(&entry.path(), &to)
        } else {
            assert!(fs::copy(entry.path(), to).is_ok())
        }
    }
}

#[test]
fn an_archive_holds_what_it_takes_and_is_replayed_elsewhere() {
    let place = archived("a");
    let mut names = Vec::new();
    for folder in ["", "/lines", "/sensor_model"] {
        let entries = fs::read_dir(place.path(&format!("archives/a{folder}"))).unwrap().map(Result::unwrap);
        names.extend(entries.map(|entry| format!("{folder}/{}", entry.file_name().display())));
    }
    names.sort();
    let expected = [
        "/archive.b3",
        "/archive.json",
        "/job.resolved.toml",
        "/job.toml",
        "/lines",
        "/lines/a_lstat.txt",
        "/report.json",
        "/results.b3",
        "/sensor_model",
        "/sensor_model/a.json",
        "/wavex.log",
    ];
    assert_eq!(names, expected);
    assert_eq!(place.text("archives/a/job.toml"), place.text("job.toml"));
    assert_eq!(place.text("archives/a/lines/a_lstat.txt"), place.text("out/a_lstat.txt"));
    assert!(place.text("archives/a/wavex.log").contains("INFO wavex "));

    let archive: Value = serde_json::from_str(&place.text("archives/a/archive.json")).unwrap();
    assert_eq!(archive["set"], serde_json::json!(["job.threads=2"]));
    let paths = |of: &str| -> Vec<String> {
        let files = archive[of]["files"].as_array().unwrap();
        files.iter().map(|file| file["path"].as_str().unwrap().to_owned()).collect()
    };
    assert_eq!(
        (paths("inputs"), archive["inputs"]["folder"].as_str()),
        (vec!["in/a.arrow".into(), "in/model.json".into()], Some("../.."))
    );
    assert_eq!(
        (paths("outputs"), archive["outputs"]["folder"].as_str()),
        (OUTPUTS.map(String::from).to_vec(), Some("../../out"))
    );
    let report: Value = serde_json::from_str(&place.text("archives/a/report.json")).unwrap();
    assert_eq!(report, serde_json::from_str::<Value>(&place.text("out/job_report.json")).unwrap());
    assert_eq!(report["stages"].as_array().unwrap().len(), 9, "the archive's own stage does not appear");
    let outputs = report["inputs"][0]["outputs"].as_array().unwrap();
    assert!(outputs.len() == 5 && outputs.iter().all(|path| path.as_str().unwrap().starts_with("./out/")));

    holds(&place, &["verify", "archives/a"]);
    holds(&place, &["replay", "archives/a", "--threads", "1"]);
    // First move everything together; then the inputs alone.
    let elsewhere = TestFolder::new();
    copy(&place.path("archives"), &elsewhere.path("archives"));
    copy(&place.path("in"), &elsewhere.path("in"));
    copy(&place.path("out"), &elsewhere.path("out"));
    drop(place);
    holds(&elsewhere, &["verify", "archives/a"]);
    fs::create_dir(elsewhere.path("disk")).unwrap();
    fs::rename(elsewhere.path("in"), elsewhere.path("disk/in")).unwrap();
    fs::remove_dir_all(elsewhere.path("out")).unwrap();
    holds(&elsewhere, &["replay", "archives/a", "--inputs", "disk", "--threads", "3"]);
    let missing = ["input in/a.arrow: not found in ", "input in/model.json: not found in "];
    fails(&elsewhere, &["replay", "archives/a"], &missing);
}

#[test]
fn a_resolved_job_runs_by_itself_and_gives_the_same() {
    let place = archived("a");
    let then = fs::read(place.path("out/a.laz")).unwrap();
    fs::remove_dir_all(place.path("out")).unwrap();
    holds(&place, &["run", "archives/a/job.resolved.toml"]);
    assert!(fs::read(place.path("out/a.laz")).unwrap() == then);
    let text = place.text("archives/a/job.resolved.toml");
    assert!(!text.contains(&place.path("").display().to_string()), "no absolute path:\n{text}");
    // A pattern could match other files later.
    assert!(text.contains("path = [\"in/a.arrow\"]") || text.contains("path = \"in/a.arrow\""), "{text}");
}

#[test]
fn a_packed_archive_is_as_good() {
    let place = archived("a.tar.zst");
    assert!(place.path("archives/a.tar.zst").is_file());
    assert_eq!(fs::read_dir(place.path("archives")).unwrap().count(), 1);
    holds(&place, &["verify", "archives/a.tar.zst"]);
    holds(&place, &["replay", "archives/a.tar.zst"]);
    flip(&place.path("archives/a.tar.zst"), 1000);
    let (code, err) = wavex(&place, &["verify", "archives/a.tar.zst"]);
    assert_eq!(code, Some(1), "{err}");
}

#[test]
fn every_kind_of_tampering_is_named() {
    let place = archived("a");
    let [verify, replay] = ["verify", "replay"].map(|command| [command, "archives/a"]);
    let saved = TestFolder::new();
    copy(&place.path(""), &saved.path("all"));
    let restore = |name: &str| {
        let copied = fs::copy(saved.path(&format!("all/{name}")), place.path(name));
        assert!(copied.is_ok(), "{name}");
    };

    flip(&place.path("in/a.arrow"), 5000);
    for command in [&verify, &replay] {
        fails(&place, command, &["input in/a.arrow: changed: the digest of "]);
    }
    restore("in/a.arrow");
    fs::write(place.path("in/model.json"), "{}").unwrap();
    fails(&place, &verify, &["input in/model.json: changed: "]);
    fs::remove_file(place.path("in/model.json")).unwrap();
    fails(&place, &replay, &["input in/model.json: not found in "]);
    restore("in/model.json");

    for (file, from, to) in [
        ("archives/a/job.toml", "a flight", "A flight"),
        ("archives/a/job.resolved.toml", "mode = \"fastest\"", "mode = \"refined\""),
        ("archives/a/archive.json", "\"blake3\": \"", "\"blake3\": \"0"),
        ("archives/a/report.json", "wavex", "waveX"),
        ("archives/a/lines/a_lstat.txt", " 0 ", " 1 "),
    ] {
        change(&place.path(file), from, to);
        let name = file.strip_prefix("archives/a/").unwrap();
        let expected =
            format!("{name}: the file or its digest in archive.b3 was changed after the archive was made");
        let (code, err) = wavex(&place, &verify);
        assert!(code == Some(1) && err.contains(&expected), "{err}");
        fails(&place, &replay, &[&expected]);
        restore(file);
    }
    change(&place.path("archives/a/archive.b3"), "  job.toml", "0  job.toml");
    fails(
        &place,
        &verify,
        &["job.toml: the file or its digest in archive.b3 was changed after the archive was made"],
    );
    restore("archives/a/archive.b3");
    fs::remove_file(place.path("archives/a/wavex.log")).unwrap();
    fails(&place, &verify, &["wavex.log: missing from the archive"]);
    restore("archives/a/wavex.log");
    holds(&place, &verify);
}

#[test]
fn an_output_that_was_changed_is_named_with_its_first_difference() {
    let place = archived("a");
    let csv = place.text("out/a.csv");
    let mut rows: Vec<Vec<String>> =
        csv.lines().map(|row| row.split(',').map(str::to_owned).collect()).collect();
    let column = rows[0].iter().position(|name| name == "amplitude_dn").expect("a column of the table");
    let value = rows[5][column].clone();
    rows[5][column] = "7".into();
    let rows: Vec<String> = rows.iter().map(|row| row.join(",")).collect();
    place.write("out/a.csv", (rows.join("\n") + "\n").as_bytes());
    let lstat = place.text("out/a_lstat.txt");
    place.write(
        "out/a_lstat.txt",
        lstat.lines().take(3).map(|line| format!("{line}\n")).collect::<String>().as_bytes(),
    );
    fs::remove_file(place.path("out/a.parquet")).unwrap();

    let not_found = "output a.parquet: not found in ";
    fails(
        &place,
        &["verify", "archives/a"],
        &["output a.csv: changed: ", not_found, "output a_lstat.txt: changed: "],
    );
    let (code, err) = wavex(&place, &["replay", "archives/a"]);
    assert_eq!(code, Some(1), "{err}");
    let expected =
        format!("a.csv was changed since the run: row 4, column amplitude_dn: 7 instead of {value}\n");
    assert!(err.contains("  output a.csv of stage write_table-1: reproduced, but "), "{err}");
    assert!(err.contains(&expected), "{err}");
    assert!(err.contains("a_lstat.txt was changed since the run: it ends before line 4\n"), "{err}");
    assert!(!err.contains("a.parquet"), "the replay made the missing file:\n{err}");
}

/// Intensity of the first point and its offset in a LAS file of point format 6.
fn intensity(las: &[u8]) -> (usize, u16) {
    let points = u32::from_le_bytes(las[96..100].try_into().unwrap()) as usize;
    let at = points + 12;
    (at, u16::from_le_bytes([las[at], las[at + 1]]))
}

/// Messages give the current value first, for every file format.
#[test]
fn changed_files_show_new_and_old_values() {
    let place = flight();
    let stages = STAGES.replace("'*.laz'", "'*.las'");
    place.write("job.toml", format!("[job]\noutput_dir = 'out'\n{stages}").as_bytes());
    holds(&place, &["run", "job.toml", "--archive", "archive"]);
    let mut las = fs::read(place.path("out/a.las")).unwrap();
    let (at, then) = intensity(&las);
    let now = then ^ 1;
    las[at..at + 2].copy_from_slice(&now.to_le_bytes());
    place.write("out/a.las", &las);
    let lstat = place.text("out/a_lstat.txt");
    let line = lstat.lines().nth(1).unwrap();
    place.write("out/a_lstat.txt", lstat.replacen(line, "mine", 1).as_bytes());
    let (value, column) = resave_with_snappy(&place.path("out/a.parquet"));

    let (code, err) = wavex(&place, &["replay", "archive"]);
    assert_eq!(code, Some(1), "{err}");
    for expected in [
        format!("a.las was changed since the run: point 0, field intensity: {now} instead of {then}\n"),
        "a_lstat.txt was changed since the run: line 2: \"mine\" instead of \"".to_owned(),
        format!("a.parquet was changed since the run: row 2, column {column}: 87.0 instead of {value:?}\n"),
    ] {
        assert!(err.contains(&expected), "{expected} is not in\n{err}");
    }
}

/// Rewrites a table as other programs do: with another compression and with 87 in row 2 of a
/// column.
///
/// Returns the original value and the name of the column.
fn resave_with_snappy(path: &Path) -> (f64, String) {
    use arrow_array::{Array, ArrayRef, Float64Array, RecordBatch};
    use parquet::arrow::ArrowWriter;
    use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
    use parquet::basic::Compression;
    use parquet::file::properties::WriterProperties;

    let reader = ParquetRecordBatchReaderBuilder::try_new(fs::File::open(path).unwrap()).unwrap();
    let schema = reader.schema().clone();
    let batches: Vec<RecordBatch> = reader.build().unwrap().map(Result::unwrap).collect();
    let properties = WriterProperties::builder().set_compression(Compression::SNAPPY).build();
    let mut writer =
        ArrowWriter::try_new(fs::File::create(path).unwrap(), schema.clone(), Some(properties)).unwrap();
    let is_number = |column: &ArrayRef| {
        column.as_any().downcast_ref::<Float64Array>().is_some_and(|column| column.is_valid(2))
    };
    let at = batches[0].columns().iter().rposition(is_number).expect("a column of numbers");
    let column = batches[0].column(at).as_any().downcast_ref::<Float64Array>().unwrap();
    let then = column.value(2);
    let mut values: Vec<Option<f64>> = column.iter().collect();
    values[2] = Some(87.0);
    let mut columns = batches[0].columns().to_vec();
    columns[at] = std::sync::Arc::new(Float64Array::from(values));
    writer.write(&RecordBatch::try_new(schema.clone(), columns).unwrap()).unwrap();
    batches[1..].iter().for_each(|batch| writer.write(batch).unwrap());
    writer.close().unwrap();
    (then, schema.field(at).name().clone())
}

/// An archive with an edited job and a valid new seal: the outputs reveal the change.
#[test]
fn a_run_that_gives_something_else_says_what_and_where() {
    let place = archived("a");
    change(
        &place.path("archives/a/job.resolved.toml"),
        "path = \"*.laz\"",
        "path = \"*.laz\"\ncoordinate_step = 0.002",
    );
    change(&place.path("archives/a/job.resolved.toml"), "mode = \"fastest\"", "mode = \"refined\"");
    let digest = blake3::hash(&fs::read(place.path("archives/a/job.resolved.toml")).unwrap()).to_hex();
    let seal = place.text("archives/a/archive.b3");
    let edited = |line: &str| match line.split_once("  ") {
        Some((_, "job.resolved.toml")) => format!("{digest}  job.resolved.toml\n"),
        _ => format!("{line}\n"),
    };
    place.write("archives/a/archive.b3", seal.lines().map(edited).collect::<String>().as_bytes());
    holds(&place, &["verify", "archives/a"]);
    let (code, err) = wavex(&place, &["replay", "archives/a"]);
    assert_eq!(code, Some(1), "{err}");
    assert!(err.contains("  output a.laz of stage write_las: different: point 0, field X: "), "{err}");
    for table in [
        "a.csv of stage write_table-1",
        "a.parquet of stage write_table-2",
        "a_points.arrow of stage write_table-3",
    ] {
        let begins = format!("  output {table}: different: row ");
        let line = err
            .lines()
            .find(|line| line.starts_with(&begins))
            .unwrap_or_else(|| panic!("{table} is not in\n{err}"));
        assert!(line.contains(", column ") && line.contains(" instead of "), "{line}");
    }
}

#[test]
fn an_archive_is_never_replaced_and_its_inputs_are_files() {
    let place = archived("a");
    let exists = "error: archives/a: it already exists; choose another name: an archive is never replaced\n";
    assert_eq!(run(&place, &["--archive", "archives/a"]), Outcome::failure(2, exists));
    let from_stdin = run(
        &place,
        &["--set", "read_arrow.path='-'", "--set", "job.output_dir='out2'", "--archive", "archives/b"],
    );
    let problem = "error: standard input cannot be archived; save it to a file and read that file\n";
    assert_eq!(from_stdin, Outcome::failure(1, problem));
    assert_eq!(
        fs::read_dir(place.path("archives")).unwrap().count(),
        1,
        "no files of the other archive remain"
    );
    let (code, err) = wavex(&place, &["verify", "in"]);
    assert_eq!(code, Some(1));
    assert_eq!(
        err,
        "error: in: not an archive: archive.json is missing; give an archive made by `wavex run --archive`\n"
    );
}

/// Standard output of the program in the folder.
fn said(place: &TestFolder, arguments: &[&str]) -> String {
    place.wavex(arguments).out
}

#[test]
fn seals_are_printed_and_compared() {
    let place = flight();
    place.write("job.toml", format!("[job]\noutput_dir = 'out'\n{STAGES}").as_bytes());
    let run = said(&place, &["run", "job.toml", "--archive", "archive"]);
    let (_, seal) = run.trim_end().rsplit_once("archived in archive; seal ").expect("a seal");
    assert_eq!(seal, blake3::hash(place.text("archive/archive.b3").as_bytes()).to_hex().as_str());
    let results = blake3::hash(place.text("archive/results.b3").as_bytes()).to_hex();
    assert!(run.contains(&format!("\nresults {results}\n")), "{run}");
    let expected = "8 archive files, 2 inputs and 5 outputs are unchanged; seal";
    let verified = format!("results {results}\narchive: {expected} {seal}\n");
    assert_eq!(said(&place, &["verify", "archive"]), verified);
    let replayed = said(&place, &["replay", "archive"]);
    assert_eq!(replayed, format!("archive: 5 outputs are identical bit by bit; seal {seal}\n"));
    holds(&place, &["verify", "archive", "--seal", seal]);
    holds(&place, &["verify", "archive", "--seal", &seal.to_uppercase()]);

    let other = "0123456789abcdef".repeat(4);
    let (code, err) = wavex(&place, &["verify", "archive", "--seal", &other]);
    let expected = format!(
        "error: archive: verification failed; seal {seal}\n  the seal is {seal} instead of {other}: this is not the archive with the noted seal, or it was changed and resealed\n"
    );
    assert_eq!((code, err), (Some(1), expected));
    let (code, err) = wavex(&place, &["verify", "archive", "--seal", "0123"]);
    assert_eq!(code, Some(2), "{err}");
    assert!(err.contains("a seal has 64 hexadecimal digits, as `wavex run --archive` prints them"), "{err}");
    // Without the seal there is nothing to compare with.
    fs::remove_file(place.path("archive/archive.b3")).unwrap();
    let (code, err) = wavex(&place, &["verify", "archive", "--seal", seal]);
    let expected = "error: archive: verification failed\n  archive.b3: missing: the integrity of the archive cannot be verified\n";
    assert_eq!((code, err.as_str()), (Some(1), expected));
}

#[test]
fn archives_of_another_kind_are_not_made() {
    let place = flight();
    place.write("job.toml", format!("[job]\noutput_dir = 'out'\n{STAGES}").as_bytes());
    for (name, kind) in [("x.zip", ".zip"), ("a/x.tar.gz", ".gz")] {
        let expected = format!(
            "error: {name}: wavex cannot make {kind} archives; give a name that ends in .tar.zst, or the name of a new folder\n"
        );
        assert_eq!(run(&place, &["--archive", name]), Outcome::failure(2, expected));
        assert!(!place.path(name).exists() && !place.path("out").exists());
    }
}

#[test]
fn what_is_no_archive_or_no_whole_one_is_refused_with_a_remedy() {
    let place = archived("a.tar.zst");
    let other = "error: job.toml: not an archive: neither a folder nor a .tar.zst file; give an archive made by `wavex run --archive`\n";
    assert_eq!(wavex(&place, &["verify", "job.toml"]), (Some(1), other.to_owned()));
    let whole = fs::read(place.path("archives/a.tar.zst")).unwrap();
    place.write("cut.tar.zst", &whole[..whole.len() / 2]);
    let cut = "error: cut.tar.zst: damaged archive: the file is truncated, its data end too early; get a complete copy\n";
    for command in ["verify", "replay"] {
        assert_eq!(wavex(&place, &[command, "cut.tar.zst"]), (Some(1), cut.to_owned()));
    }
}

/// The archived job contains every effective value and nothing specific to this machine.
#[test]
fn a_resolved_job_spells_out_defaults_that_hang_on_other_keys() {
    let place = flight();
    let more = "[[stage]]\ntype = 'write_trajectory'\n";
    place.write("job.toml", format!("[job]\noutput_dir = 'out'\n{STAGES}{more}").as_bytes());
    let job = place.path("job.toml");
    holds(&place, &["run", job.to_str().unwrap(), "--archive", "archive"]);
    let text = place.text("archive/job.resolved.toml");
    let begin = "# Job \"job.toml\" as run by wavex ";
    assert!(text.starts_with(begin), "{text}");
    let job: toml::Table = text.parse().unwrap();
    let geometry = &job["job"]["geometry"];
    assert_eq!(geometry["mount"].as_str(), Some("level"));
    let calibration = geometry["calibration"].as_table().unwrap();
    assert_eq!((calibration.len(), calibration["e7"].as_float()), (11, Some(0.0)));
    let stages = job["stage"].as_array().unwrap();
    let last = stages.last().unwrap();
    assert_eq!(last["interval_s"].as_float(), Some(0.1), "{text}");
    holds(&place, &["replay", "archive"]);
}

#[test]
fn inputs_outside_the_job_folder_have_a_common_folder() {
    let place = flight();
    let model = place.path("in/model.json");
    let stages = STAGES.replace("'in/model.json'", &format!("'{}'", model.display()));
    place.write(
        "jobs/job.toml",
        format!(
            "[job]\ninput_dir = '../in'\noutput_dir = '../out'\nlog = ''\n{}",
            stages.replace("in/*", "*")
        )
        .as_bytes(),
    );
    holds(&place, &["run", "jobs/job.toml", "--archive", "archive"]);
    let archive: Value = serde_json::from_str(&place.text("archive/archive.json")).unwrap();
    assert_eq!(archive["inputs"]["folder"], "../in");
    assert_eq!(archive["inputs"]["files"][1]["path"], "model.json");
    assert!(place.text("archive/wavex.log").contains("INFO wavex "), "the archive contains a log anyway");

    // With a higher common folder, the paths start there.
    fs::create_dir(place.path("models")).unwrap();
    fs::rename(&model, place.path("models/m.json")).unwrap();
    let set = format!("calibrate.load='{}'", place.path("models/m.json").display());
    holds(&place, &["run", "jobs/job.toml", "--set", &set, "--archive", "archives/b"]);
    let archive: Value = serde_json::from_str(&place.text("archives/b/archive.json")).unwrap();
    assert_eq!(archive["inputs"]["folder"], "../..");
    assert_eq!(archive["inputs"]["files"][0]["path"], "in/a.arrow");
    assert_eq!(archive["inputs"]["files"][1]["path"], "models/m.json");
    holds(&place, &["replay", "archives/b"]);
}

#[test]
fn the_trajectory_is_an_input() {
    let place = TestFolder::new();
    let make = "[[stage]]\ntype = 'simulate'\nstem = 'a'\nlines = 2\nshots_per_line = 200\nsbet = '../in/*.out'\n\
                [[stage]]\ntype = 'write_arrow'\npath = '../in/*.arrow'\n";
    assert_eq!(place.run(make), Outcome::success());
    let job = "[job]\ninput_dir = 'in'\noutput_dir = 'out'\n[job.geometry]\ntrajectory = '*.out'\n[[stage]]\ntype = 'read_arrow'\n\
               path = 'a.arrow'\n[[stage]]\ntype = 'calibrate'\nwaveforms = 300\n[[stage]]\ntype = 'decompose'\n\
               [[stage]]\ntype = 'georeference'\n[[stage]]\ntype = 'write_las'\n";
    place.write("job.toml", job.as_bytes());
    holds(&place, &["run", "job.toml", "--archive", "archive"]);
    let archive: Value = serde_json::from_str(&place.text("archive/archive.json")).unwrap();
    let inputs = archive["inputs"]["files"].as_array().unwrap();
    let paths: Vec<&str> = inputs.iter().map(|file| file["path"].as_str().unwrap()).collect();
    assert_eq!((paths, &archive["inputs"]["folder"]), (vec!["a.arrow", "a.out"], &Value::from("../in")));
    fs::rename(place.path("in"), place.path("moved")).unwrap();
    holds(&place, &["replay", "archive", "--inputs", "moved"]);
    flip(&place.path("moved/a.out"), 100);
    fails(&place, &["replay", "archive", "--inputs", "moved"], &["input a.out: changed: the digest of "]);
}

/// Included keys appear in the resolved job; the included text is archived as written.
#[test]
fn included_keys_are_resolved() {
    let place = flight();
    let job = STAGES.replace("mode = 'fastest'\n", "");
    place.write("job.toml", format!("[job]\ninclude = 'shared/base.toml'\n{job}").as_bytes());
    let base = "[job]\noutput_dir = 'out'\n[decompose]\nmode = 'fastest'\n[fuse_channels]\n";
    place.write("shared/base.toml", base.as_bytes());
    holds(&place, &["run", "job.toml", "--archive", "archive"]);
    assert_eq!(place.text("archive/included/1_base.toml"), base);
    let resolved = place.text("archive/job.resolved.toml");
    assert!(resolved.contains("mode = \"fastest\"") && !resolved.contains("include"), "{resolved}");
    fs::remove_dir_all(place.path("shared")).unwrap();
    holds(&place, &["replay", "archive"]);
    holds(&place, &["verify", "archive"]);
    let missing = wavex(&place, &["run", "job.toml"]);
    let problem = "error: shared/base.toml: cannot read the included file: No such file or directory (os error 2); \
                   check `include` in `[job]`\n";
    assert_eq!(missing, (Some(2), problem.to_owned()));
}
