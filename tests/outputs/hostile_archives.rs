//! Archives that others have changed and sealed again: nothing elsewhere is read, written or loaded.

use std::fs;
use std::os::unix::fs::symlink;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;
use wavex_testkit::{TestFolder, skipped};

use super::archive::{archived, change};

/// Time after which a command counts as hanging.
const LONGEST: Duration = Duration::from_secs(50);
/// Remedy for an archive that was changed on purpose.
const REMEDY: &str = "do not trust this archive; compare its seal with the noted one";

/// Renews the seal of the archive.
fn reseal(place: &TestFolder) {
    let seal = place.text("archives/a/archive.b3");
    let line = |line: &str| {
        let name = line.split_once("  ").unwrap().1;
        let digest = blake3::hash(&fs::read(place.path(&format!("archives/a/{name}"))).unwrap()).to_hex();
        format!("{digest}  {name}\n")
    };
    place.write("archives/a/archive.b3", seal.lines().map(line).collect::<String>().as_bytes());
}

/// Runs a command on the archive, which ends in time; returns its message.
#[track_caller]
fn refuses(place: &TestFolder, command: &str) -> String {
    let mut process = wavex_testkit::wavex();
    process.args(["--quiet", command, "archives/a"]).current_dir(place.path(""));
    process.env("TMPDIR", place.path("tmp")).env_remove("WAVEX_RIWAVELIB");
    let mut child = process.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    let started = Instant::now();
    while child.try_wait().unwrap().is_none() {
        if started.elapsed() > LONGEST {
            child.kill().unwrap();
            child.wait().unwrap();
            panic!("{command} hangs");
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    let output = child.wait_with_output().unwrap();
    let err = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{err}");
    assert_eq!(fs::read_dir(place.path("tmp")).unwrap().count(), 0, "{command} leaves a folder");
    err
}

/// An archived run.
fn place() -> TestFolder {
    let place = archived("a");
    fs::create_dir(place.path("tmp")).unwrap();
    place
}

/// A folder next to others of its kind, with files of others.
fn elsewhere() -> TestFolder {
    let files = ["a.laz", "a.csv", "model.json"].map(|name| (name, &b"of others"[..]));
    TestFolder::with(&files)
}

/// Replaces the folder's absolute path and its name.
fn naming(elsewhere: &TestFolder, text: &str) -> String {
    let folder = elsewhere.path("").components().collect::<std::path::PathBuf>();
    let name = folder.file_name().unwrap().to_str().unwrap();
    text.replace("ELSEWHERE", folder.to_str().unwrap()).replace("NAME", name)
}

#[track_caller]
fn is_unchanged(elsewhere: &TestFolder) {
    let entries = fs::read_dir(elsewhere.path("")).unwrap().map(Result::unwrap);
    let names: Vec<_> = entries.map(|entry| entry.file_name().into_string().unwrap()).collect();
    assert_eq!(names.len(), 3, "{names:?}");
    for name in names {
        assert_eq!(fs::read(elsewhere.path(&name)).unwrap(), b"of others", "{name}");
    }
}

#[test]
fn a_replay_writes_nothing_elsewhere() {
    for (from, to) in [
        ("path = \"*.laz\"", "path = \"ELSEWHERE/*.laz\""),
        ("path = \"*.csv\"", "path = \"../NAME/*.csv\""),
        ("path = \"*.csv\"", "path = \"x/../../NAME/*.csv\""),
        ("path = \"*.csv\"", "path = \"/*.csv\""),
        ("load = \"in/model.json\"", "load = \"in/model.json\"\nsave = \"ELSEWHERE/model.json\""),
    ] {
        let (place, elsewhere) = (place(), elsewhere());
        let to = naming(&elsewhere, to);
        let job = place.path("archives/a/job.resolved.toml");
        if to.contains("save") {
            let text = fs::read_to_string(&job).unwrap();
            let kept =
                text.lines().filter(|line| !line.starts_with("save = ")).collect::<Vec<_>>().join("\n");
            fs::write(&job, kept + "\n").unwrap();
        }
        change(&job, from, &to);
        reseal(&place);
        let err = refuses(&place, "replay");
        assert!(err.contains("the archived job writes ") && err.contains(REMEDY), "{to}: {err}");
        is_unchanged(&elsewhere);
    }
}

#[test]
fn a_replay_reads_nothing_elsewhere() {
    for (from, to) in [
        ("load = \"in/model.json\"", "load = \"ELSEWHERE/model.json\""),
        ("load = \"in/model.json\"", "load = \"in/../../NAME/model.json\""),
        ("path = \"in/a.arrow\"", "path = \"ELSEWHERE/a.laz\""),
        ("path = \"in/a.arrow\"", "path = \"in/../../NAME/*.laz\""),
    ] {
        let (place, elsewhere) = (place(), elsewhere());
        let to = naming(&elsewhere, to);
        change(&place.path("archives/a/job.resolved.toml"), from, &to);
        reseal(&place);
        let err = refuses(&place, "replay");
        assert!(err.contains("the archived job reads ") && err.contains(REMEDY), "{to}: {err}");
    }
    // Digests are taken of files below the folders only.
    for path in ["/etc/passwd", "../elsewhere/a.laz", "in/../../a.laz", ""] {
        for of in ["inputs", "outputs"] {
            let place = place();
            let mut archive: Value = serde_json::from_str(&place.text("archives/a/archive.json")).unwrap();
            archive[of]["files"][0]["path"] = path.into();
            place.write("archives/a/archive.json", archive.to_string().as_bytes());
            reseal(&place);
            for command in ["verify", "replay"] {
                let err = refuses(&place, command);
                assert!(err.contains(&format!("the path {path:?} leads out of its folder")), "{err}");
            }
        }
    }
}

/// Compiles a library that makes a file when it is loaded; `None` without a compiler.
fn library(path: &Path, mark: &Path) -> Option<()> {
    let source = path.with_extension("c");
    let text = format!(
        "#include <stdio.h>\n__attribute__((constructor)) static void begin(void) {{ fclose(fopen(\"{}\", \"w\")); }}\n",
        mark.display()
    );
    fs::write(&source, text).unwrap();
    let output = Command::new("cc").args(["-shared", "-fPIC", "-o"]).args([path, &source]).output();
    fs::remove_file(&source).unwrap();
    output.is_ok_and(|output| output.status.success()).then_some(())
}

#[test]
fn a_replay_loads_no_library_of_an_archive() {
    let place = place();
    let mark = place.path("loaded");
    let library_path = place.path("in/libriwave.so");
    if library(&library_path, &mark).is_none() {
        return skipped("no C compiler `cc`");
    }
    // Under every usual name next to the data.
    for name in ["libsdfifc.so", "libsdfifc-mt.so"] {
        fs::copy(&library_path, place.path(&format!("in/{name}"))).unwrap();
    }
    let original = place.text("archives/a/job.resolved.toml");
    for keys in ["library = \"in/libriwave.so\"", "index_dir = \"in\"", ""] {
        let mut job: toml::Table = original.parse().unwrap();
        let reader: toml::Table =
            format!("type = 'read_sdf'\nid = 'read_arrow'\npath = 'in/a.arrow'\n{keys}").parse().unwrap();
        job["stage"].as_array_mut().unwrap()[0] = reader.into();
        place.write("archives/a/job.resolved.toml", toml::to_string(&job).unwrap().as_bytes());
        reseal(&place);
        let err = refuses(&place, "replay");
        if let Some((key, _)) = keys.split_once(" = ") {
            let expected = format!("the archived job has the key `{key}` of stage read_arrow; {REMEDY}");
            let is_refused =
                err.contains("a job cannot name a library (`library`)") || err.contains(&expected);
            assert!(is_refused, "{err}");
        }
        assert!(!mark.exists(), "the library was loaded: {keys}");
    }
}

#[test]
fn pipes_and_devices_in_place_of_files_end_no_check_late() {
    for (file, command) in [
        ("in/a.arrow", "verify"),
        ("in/a.arrow", "replay"),
        ("out/a.laz", "verify"),
        ("archives/a/job.toml", "verify"),
        ("archives/a/lines/a_lstat.txt", "replay"),
    ] {
        for is_pipe in [true, false] {
            let place = place();
            fs::remove_file(place.path(file)).unwrap();
            match is_pipe {
                true => {
                    let made = Command::new("mkfifo").arg(place.path(file)).status();
                    assert!(made.is_ok_and(|status| status.success()));
                }
                false => symlink("/dev/zero", place.path(file)).unwrap(),
            }
            let err = refuses(&place, command);
            let expected =
                if file.starts_with("archives") { "a link, pipe or device" } else { "a pipe or device" };
            assert!(err.contains(expected), "{command} {file}, pipe {is_pipe}: {err}");
        }
    }
}
