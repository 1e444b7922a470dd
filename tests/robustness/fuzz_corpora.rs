//! The corpora of the fuzz targets, as ordinary tests: see `docs/explanation/testing.md`.

use std::collections::BTreeSet;
use std::fs;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;
use std::sync::Mutex;

use wavex_testkit::fuzz::{TARGETS, Target, seeds::seeds};
use wavex_testkit::root;

/// Most bytes of all corpora.
const MOST_BYTES: u64 = 5_000_000;

fn corpora() -> PathBuf {
    root().join("fuzz/corpus")
}

/// Inputs of a target, sorted by name.
fn inputs(target: &str) -> Vec<PathBuf> {
    let entries = fs::read_dir(corpora().join(target)).into_iter().flatten();
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    paths.sort();
    paths
}

#[test]
fn every_input_of_the_corpora_holds() {
    let rest: Mutex<Vec<(&str, Target, PathBuf)>> = Mutex::default();
    for &(name, target) in TARGETS {
        let paths = inputs(name);
        assert!(!paths.is_empty(), "fuzz/corpus/{name} has no input: `just fuzz-seeds` makes some");
        rest.lock().unwrap().extend(paths.into_iter().map(|path| (name, target, path)));
    }
    let work = || {
        let mut failed = Vec::new();
        loop {
            let next = rest.lock().unwrap().pop();
            let Some((name, target, path)) = next else { return failed };
            let bytes = fs::read(&path).unwrap();
            if catch_unwind(AssertUnwindSafe(|| target(&bytes))).is_err() {
                failed.push(format!("{name} {}", path.display()));
            }
        }
    };
    let workers = std::thread::available_parallelism().map_or(1, usize::from);
    let failed: Vec<String> = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..workers).map(|_| scope.spawn(work)).collect();
        threads.into_iter().flat_map(|thread| thread.join().unwrap()).collect()
    });
    assert_eq!(failed, Vec::<String>::new(), "the messages are above");
}

#[test]
fn corpora_are_small_and_belong_to_targets() {
    let names: BTreeSet<&str> = TARGETS.iter().map(|(name, _)| *name).collect();
    let folders = fs::read_dir(corpora()).unwrap().map(|entry| entry.unwrap().file_name());
    let folders: BTreeSet<String> = folders.map(|name| name.into_string().unwrap()).collect();
    assert!(folders.iter().map(String::as_str).eq(names.iter().copied()), "{folders:?}");
    let sizes = names.iter().flat_map(|name| inputs(name)).map(|path| path.metadata().unwrap().len());
    let bytes: u64 = sizes.sum();
    assert!(bytes < MOST_BYTES, "the corpora have {bytes} bytes");
}

#[test]
fn every_target_has_a_program() {
    let manifest = fs::read_to_string(root().join("fuzz/Cargo.toml")).unwrap();
    let manifest: toml::Table = toml::from_str(&manifest).unwrap();
    let programs = manifest["bin"].as_array().unwrap().iter();
    let programs: Vec<&str> = programs.map(|program| program["name"].as_str().unwrap()).collect();
    assert!(programs.iter().eq(TARGETS.iter().map(|(name, _)| name)), "{programs:?}");
    for name in programs {
        let text = fs::read_to_string(root().join(format!("fuzz/targets/{name}.rs"))).unwrap();
        assert!(text.contains(&format!("wavex_fuzz::target!({name});")), "{text}");
    }
}

/// Writes the inputs from which fuzzing starts, as `seed-NAME`.
#[test]
#[ignore = "writes fuzz/corpus: just fuzz-seeds"]
fn write_seeds() {
    for (target, name, bytes) in seeds() {
        assert!(TARGETS.iter().any(|(known, _)| *known == target), "{target}");
        let folder = corpora().join(target);
        fs::create_dir_all(&folder).unwrap();
        fs::write(folder.join(format!("seed-{name}")), bytes).unwrap();
    }
}
