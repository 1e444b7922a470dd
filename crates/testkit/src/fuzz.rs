//! Fuzz targets: one function per reader of untrusted bytes.
//!
//! The programs in `fuzz/targets` call them with the inputs of libFuzzer, and a test calls them with
//! the inputs of `fuzz/corpus`. An error of a reader is a valid result. A function panics if a
//! property does not hold, such as equality after writing and reading again.
//!
//! An input can have several parts, which [`SEPARATOR`] separates: a recording and its companion, or
//! a job and the files that it includes.

mod archives;
mod geodesy;
mod hdf5;
mod points;
mod runs;
pub mod seeds;
mod tables;
mod texts;
mod trajectories;
mod views;
mod waveforms;

use std::fs;
use std::path::PathBuf;

use tempfile::TempDir;

pub use archives::{archive_folder, archive_tar};
pub use geodesy::{geoid, geojson, geokeys, terrain_ascii, terrain_geotiff, wkt};
pub use hdf5::hdf5;
pub use points::{compressed_packets, copc, las};
pub use runs::{recording, returns, run, sdf};
pub use tables::{container, patches, survey_cells, table};
pub use texts::{calibration, corrections, import, job, lookup_tables, plan, report, sensor_model};
pub use trajectories::{accuracy, pof, sbet, sol, trajectory_text, trj};
pub use views::view;
pub use waveforms::{compressed_pulses, pulsewaves};

/// Separates the parts of an input.
pub const SEPARATOR: &[u8] = b"\n--next part--\n";

/// A fuzz target: reads an input and checks the properties of the result.
pub type Target = fn(&[u8]);

/// All fuzz targets by name.
pub const TARGETS: &[(&str, Target)] = &[
    ("accuracy", accuracy),
    ("archive_folder", archive_folder),
    ("archive_tar", archive_tar),
    ("calibration", calibration),
    ("compressed_packets", compressed_packets),
    ("compressed_pulses", compressed_pulses),
    ("container", container),
    ("copc", copc),
    ("corrections", corrections),
    ("geoid", geoid),
    ("geojson", geojson),
    ("geokeys", geokeys),
    ("hdf5", hdf5),
    ("import", import),
    ("job", job),
    ("las", las),
    ("lookup_tables", lookup_tables),
    ("patches", patches),
    ("plan", plan),
    ("pof", pof),
    ("pulsewaves", pulsewaves),
    ("recording", recording),
    ("report", report),
    ("returns", returns),
    ("run", run),
    ("sbet", sbet),
    ("sdf", sdf),
    ("sensor_model", sensor_model),
    ("sol", sol),
    ("survey_cells", survey_cells),
    ("table", table),
    ("terrain_ascii", terrain_ascii),
    ("terrain_geotiff", terrain_geotiff),
    ("trajectory_text", trajectory_text),
    ("trj", trj),
    ("view", view),
    ("wkt", wkt),
];

/// Splits an input into parts, at least one.
fn parts(bytes: &[u8]) -> Vec<&[u8]> {
    let mut parts = Vec::new();
    let mut rest = bytes;
    while let Some(at) = rest.windows(SEPARATOR.len()).position(|window| window == SEPARATOR) {
        parts.push(&rest[..at]);
        rest = &rest[at + SEPARATOR.len()..];
    }
    parts.push(rest);
    parts
}

/// Joins the parts of an input.
fn joined(parts: &[&[u8]]) -> Vec<u8> {
    parts.join(SEPARATOR)
}

/// Files of one input; the folder is empty again afterwards.
struct Files {
    folder: PathBuf,
}

thread_local! {
    /// Folder of the calling thread; a folder per input would cost more than most readers.
    static FOLDER: TempDir = tempfile::tempdir().unwrap();
}

impl Files {
    fn new() -> Files {
        Files { folder: FOLDER.with(|folder| folder.path().to_owned()) }
    }

    /// Files with these contents.
    fn with(files: &[(&str, &[u8])]) -> Files {
        let place = Files::new();
        files.iter().for_each(|(name, bytes)| drop(place.write(name, bytes)));
        place
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    /// Writes a file and its folders; returns its path.
    fn write(&self, name: &str, bytes: &[u8]) -> PathBuf {
        let path = self.path(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(&path, bytes).unwrap();
        path
    }
}

impl Drop for Files {
    fn drop(&mut self) {
        for entry in fs::read_dir(&self.folder).into_iter().flatten().flatten() {
            let path = entry.path();
            let is_folder = entry.file_type().is_ok_and(|kind| kind.is_dir());
            let removed = if is_folder { fs::remove_dir_all(&path) } else { fs::remove_file(&path) };
            removed.unwrap();
        }
    }
}
