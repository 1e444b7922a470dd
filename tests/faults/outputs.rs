//! Files of a run: complete, of an earlier run, or wrong.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

/// Content of the files of an earlier run.
const EARLIER: &[u8] = b"of an earlier run\n";
/// Outputs that belong together: never one of this run beside one of an earlier run.
const PAIRS: [[&str; 2]; 2] = [["out/a.laz", "out/a.lax"], ["out/a.laz", "out/a.wdp"]];

/// Files by path below a folder.
pub type Files = BTreeMap<String, Vec<u8>>;

/// Files below the folders of outputs.
pub fn files(place: &Path) -> Files {
    let mut files = Files::new();
    for folder in ["out", "archives", "tmp"] {
        collect(&place.join(folder), folder, &mut files);
    }
    files
}

fn collect(folder: &Path, name: &str, files: &mut Files) {
    for entry in fs::read_dir(folder).into_iter().flatten().map(Result::unwrap) {
        let name = format!("{name}/{}", entry.file_name().into_string().unwrap());
        match entry.file_type().unwrap().is_dir() {
            true => collect(&entry.path(), &name, files),
            false => drop(files.insert(name, fs::read(entry.path()).unwrap())),
        }
    }
}

/// Puts files of an earlier run under all final names.
pub fn put_earlier(place: &Path, good: &Files) {
    for name in good.keys().filter(|name| name.starts_with("out/")) {
        let path = place.join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, EARLIER).unwrap();
    }
}

/// Whether a file is one of those that a run removes.
pub fn is_remains(name: &str) -> bool {
    name.starts_with("tmp/") || name.split('/').any(|step| step.starts_with('.'))
}

/// Lists wrong files; with `whole`, also missing ones.
pub fn problems(now: &Files, good: &Files, new: &str, whole: bool) -> Vec<String> {
    let mut problems = Vec::new();
    let archive = format!("archives/{new}");
    for (name, bytes) in now.iter().filter(|(name, _)| !is_remains(name)) {
        let is_earlier = bytes == EARLIER && !whole;
        // Archives are checked as a whole.
        if !is_earlier && !name.starts_with("archives/") && !is_good(name, bytes, good.get(name)) {
            problems.push(format!("{name} is wrong ({} bytes)", bytes.len()));
        }
    }
    for [first, second] in PAIRS {
        let [first_is_earlier, second_is_earlier] =
            [first, second].map(|name| now.get(name).map(|bytes| bytes == EARLIER));
        if let (Some(one), Some(other)) = (first_is_earlier, second_is_earlier)
            && one != other
        {
            problems.push(format!("{first} and {second} are of different runs"));
        }
    }
    let of_archive: Files = of_folder(now, &archive);
    let packed = now.get(&format!("{archive}.tar.zst"));
    if !of_archive.is_empty() {
        problems.extend(unsealed(&of_archive));
    }
    if let Some(packed) = packed {
        match unpack(packed) {
            None => problems.push(format!("{archive}.tar.zst cannot be unpacked")),
            Some(files) => problems.extend(unsealed(&files)),
        }
    }
    let is_archiving = good.keys().any(|name| name.starts_with("archives/"));
    if whole {
        let expected = good.keys().filter(|name| !name.starts_with("archives/"));
        let missing = expected.filter(|name| !now.contains_key(*name));
        problems.extend(missing.map(|name| format!("{name} is missing")));
        if is_archiving {
            let results = |of: Option<&Vec<u8>>| of.cloned();
            let results_now = match packed.and_then(|packed| unpack(packed)) {
                Some(files) => results(files.get("results.b3")),
                None => results(of_archive.get("results.b3")),
            };
            let results_good = match good.iter().find(|(name, _)| name.ends_with(".tar.zst")) {
                Some((_, packed)) => unpack(packed).and_then(|files| results(files.get("results.b3"))),
                None => results(good.iter().find(|(name, _)| name.ends_with("/results.b3")).map(|(_, b)| b)),
            };
            if results_now.is_none() || results_now != results_good {
                problems.push(format!("{archive}: missing or with other results"));
            }
        }
    }
    problems
}

/// Whether a file under a final name is complete.
fn is_good(name: &str, bytes: &[u8], good: Option<&Vec<u8>>) -> bool {
    let Some(good) = good else { return false };
    let lines = |bytes: &[u8]| bytes.iter().filter(|byte| **byte == b'\n').count();
    match name {
        // The log is written while the run goes on.
        "out/job.log" | "out/las.log" => true,
        // Reports contain times, and the errors of failed runs.
        _ if name.ends_with("_report.json") => serde_json::from_slice::<serde_json::Value>(bytes).is_ok(),
        _ if name.ends_with(".html") => bytes.ends_with(b"</html>\n") || bytes.ends_with(b"</html>"),
        _ if name.ends_with("_stat.log") => bytes.ends_with(b"\n") && 2 * lines(bytes) > lines(good) / 2,
        _ => bytes == good,
    }
}

fn of_folder(files: &Files, folder: &str) -> Files {
    let below = |(name, bytes): (&String, &Vec<u8>)| {
        Some((name.strip_prefix(folder)?.strip_prefix('/')?.to_owned(), bytes.clone()))
    };
    files.iter().filter_map(below).collect()
}

fn unpack(packed: &[u8]) -> Option<Files> {
    let mut files = Files::new();
    let mut tar = tar::Archive::new(zstd::stream::read::Decoder::new(packed).ok()?);
    for entry in tar.entries().ok()? {
        let mut entry = entry.ok()?;
        let path = entry.path().ok()?.to_str()?.split_once('/')?.1.to_owned();
        let mut bytes = Vec::new();
        std::io::Read::read_to_end(&mut entry, &mut bytes).ok()?;
        files.insert(path, bytes);
    }
    Some(files)
}

/// Files of an archive that its seal does not confirm.
fn unsealed(archive: &Files) -> Vec<String> {
    let seal = archive.get("archive.b3").map(|seal| String::from_utf8_lossy(seal).into_owned());
    let Some(seal) = seal else { return vec!["an archive without a seal".to_owned()] };
    let is_wrong = |line: &str| {
        let (digest, name) = line.split_once("  ").unwrap_or_default();
        archive.get(name).is_none_or(|bytes| *blake3::hash(bytes).to_hex() != *digest)
    };
    let wrong = seal.lines().filter(|line| is_wrong(line));
    let mut problems: Vec<String> = wrong.map(|line| format!("archive: {line} is wrong")).collect();
    if seal.lines().count() + 1 != archive.len() {
        problems.push("archive: other files than sealed".to_owned());
    }
    problems
}
