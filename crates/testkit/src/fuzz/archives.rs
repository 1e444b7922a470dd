//! Archives of runs, as folder and packed.

use std::fs;
use std::path::{Component, Path, PathBuf};

use wavex::archive::{Folders, Replay, replay, verify};
use wavex::engine::{Cancel, ProgressMode};

use super::{Files, parts};

/// Folder of the archive; files of other folders are inputs and outputs.
const FOLDER: &str = "a";
/// File of the digests of all others.
const SEAL: &str = "archive.b3";
/// Most bytes of a path.
const LONGEST_PATH: usize = 100;

/// Files of an archive, one per part: the first line is the path.
///
/// Files outside of the folder `a` are inputs and outputs. Without `a/archive.b3` the archive is
/// sealed, so that its description and its job are read.
pub fn archive_folder(bytes: &[u8]) {
    let place = Files::new();
    fs::create_dir(place.path(FOLDER)).unwrap();
    let mut seal = String::new();
    for part in parts(bytes) {
        let end = part.iter().position(|byte| *byte == b'\n').unwrap_or(part.len());
        let (name, content) = part.split_at(end);
        let content = content.get(1..).unwrap_or_default();
        let Some(name) = std::str::from_utf8(name).ok().filter(|name| is_below(name)) else { continue };
        let path = place.path(name);
        let is_new = !path.exists() && fs::create_dir_all(path.parent().unwrap()).is_ok();
        if !is_new || fs::write(&path, content).is_err() {
            continue;
        }
        if let Some(name) = name.strip_prefix("a/").filter(|name| *name != SEAL) {
            seal += &format!("{}  {name}\n", blake3::hash(content).to_hex());
        }
    }
    let path = place.path(&format!("{FOLDER}/{SEAL}"));
    if !path.exists() {
        fs::write(path, seal).unwrap();
    }
    read(&place.path(FOLDER));
}

/// A packed archive, compressed or not.
pub fn archive_tar(bytes: &[u8]) {
    const ZSTD: [u8; 4] = [0x28, 0xb5, 0x2f, 0xfd];
    let packed = if bytes.starts_with(&ZSTD) { bytes.to_vec() } else { zstd::encode_all(bytes, 1).unwrap() };
    let place = Files::with(&[("a.tar.zst", &packed)]);
    read(&place.path("a.tar.zst"));
}

/// Whether a path leads to a file below its folder.
fn is_below(name: &str) -> bool {
    let is_normal = |part: Component| matches!(part, Component::Normal(_));
    !name.is_empty() && name.len() < LONGEST_PATH && Path::new(name).components().all(is_normal)
}

/// Verifies an archive, and replays it up to the first line of its run.
fn read(path: &Path) {
    let before = files_of(path.parent().unwrap());
    if let Ok(verified) = verify(path, &Folders::default(), None) {
        assert_eq!(verified.seal.len() % 64, 0);
        let cancel = Cancel::default();
        cancel.cancel();
        let options = Replay {
            folders: Folders::default(),
            seal: None,
            threads: Some(1),
            progress: ProgressMode::Hidden,
            cancel,
        };
        let _ = replay(path, &options);
    }
    assert_eq!(files_of(path.parent().unwrap()), before, "reading an archive has changed files");
}

/// All files below a folder with their lengths.
fn files_of(folder: &Path) -> Vec<(PathBuf, u64)> {
    let mut files = Vec::new();
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let path = entry.path();
        match entry.metadata() {
            Ok(about) if about.is_dir() => files.extend(files_of(&path)),
            Ok(about) => files.push((path, about.len())),
            Err(_) => {}
        }
    }
    files.sort();
    files
}
