//! Paths given as a recording by mistake: folders, parts of recordings, trajectories, jobs.

use std::path::{Path, PathBuf};

use super::Error;
use super::extensions::{LAS, LAZ, beside, extension};
use super::las::RawPoints;

/// Extensions of trajectories, in order of preference.
pub const TRAJECTORIES: [&str; 5] = ["pof", "sbet", "out", "sol", "trj"];
/// Extensions of recordings that a folder is searched for, in order of preference.
pub(super) const RECORDINGS: [&str; 10] =
    ["pls", "plz", "las", "laz", "sdf", "wfm", "arrow", "h5", "hdf5", "spd"];
/// Extensions of files with samples, their content, and the extensions of the recordings.
const SAMPLES: [(&[&str], &str, &[&str]); 2] = [
    (&["wvs", "wvz"], "the samples of a PulseWaves recording", &["pls", "plz"]),
    (&["wdp", "wdz"], "the waveform packets of a LAS recording", &["las", "laz"]),
];
/// Extensions of compressed files and archives.
const PACKED: [&str; 9] = ["zip", "gz", "7z", "tar", "tgz", "bz2", "xz", "rar", "zst"];
/// Number of entries of a folder that are searched.
const MOST_ENTRIES: usize = 10_000;

/// Returns the error for a path that is no recording, with what to give instead.
///
/// `None` if it may be one.
pub(super) fn misplaced(path: &Path) -> Option<Error> {
    if path.is_dir() {
        return Some(folder(path));
    }
    let name = path.display();
    let own = extension(path);
    let is_one_of = |extensions: &[&str]| extensions.contains(&own.as_str());
    let (problem, remedy) = if let Some((_, content, recordings)) =
        SAMPLES.iter().find(|(extensions, ..)| is_one_of(extensions))
    {
        let remedy = match recordings.iter().find_map(|extension| beside(path, extension)) {
            Some(recording) => format!("give {}", recording.display()),
            None => format!(
                "give the .{} of the same name, which must be in its folder",
                recordings.join(" or .")
            ),
        };
        (format!("it holds only {content}"), remedy)
    } else if is_one_of(&TRAJECTORIES) || own == "poq" {
        let remedy = format!(
            "give the recording, and name the trajectory in the job: `trajectory = \"{name}\"` in `[job.geometry]`; \
             `wavex trajectory {name}` describes it"
        );
        ("it is a trajectory, not a recording".to_owned(), remedy)
    } else if own == "toml" {
        let remedy = format!("run it with `wavex run {name}`, or view it with `wavex view {name}`");
        ("it is a job, not a recording".to_owned(), remedy)
    } else if own == "wvxi" {
        ("it is the index of a recording".to_owned(), format!("give {}", path.with_extension("").display()))
    } else if is_one_of(&PACKED) {
        (
            "it is a compressed file or an archive".to_owned(),
            "unpack it and give a recording in it".to_owned(),
        )
    } else {
        return None;
    };
    Some(Error::unusable(path, problem, remedy))
}

/// The error for a folder, with a pattern of the recordings in it, and the outputs of a run.
fn folder(path: &Path) -> Error {
    let entries = entries(path);
    let has =
        |wanted: &&&str| entries.iter().any(|file| extension(file) == **wanted && !is_only_points(file));
    let recordings = RECORDINGS.iter().find(has).map(|extension| {
        let all = path.join(format!("*.{extension}"));
        format!("give a recording in it; a job reads all by `path = '{}'`", all.display())
    });
    let outputs = entries
        .iter()
        .any(|file| is_report(file))
        .then(|| format!("`wavex view {}` shows the outputs of a run in it", path.display()));
    let remedies: Vec<String> = recordings.into_iter().chain(outputs).collect();
    let remedy = match remedies.is_empty() {
        true => "there is no recording in it: give the path of one".to_owned(),
        false => remedies.join("; "),
    };
    Error::unusable(path, "it is a folder, not a recording", remedy)
}

/// Whether a file is LAS of a point format without waveforms, as a run writes it.
pub fn is_only_points(file: &Path) -> bool {
    let is_las = [LAS, LAZ].contains(&extension(file).as_str());
    is_las && RawPoints::open(file).is_ok_and(|points| !points.header().has_waveforms())
}

/// Whether a file is the report of a run, by its name.
pub fn is_report(file: &Path) -> bool {
    let name = file.file_name().unwrap_or_default().to_string_lossy();
    name == "report.json" || name.ends_with("_report.json")
}

/// The folder with the report of a run: this folder, or else the first one in it.
pub fn folder_of_outputs(folder: &Path) -> Option<PathBuf> {
    let has_report = |folder: &Path| entries(folder).iter().any(|file| is_report(file));
    if has_report(folder) {
        return Some(folder.to_owned());
    }
    entries(folder).into_iter().filter(|entry| entry.is_dir() && has_report(entry)).min()
}

/// Paths in a folder; none if it cannot be read.
fn entries(folder: &Path) -> Vec<PathBuf> {
    let entries = folder.read_dir().into_iter().flatten().flatten().take(MOST_ENTRIES);
    entries.map(|entry| entry.path()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    #[test]
    fn what_to_give_instead_is_named() {
        for (name, expected) in [
            (
                "a.wvs",
                "it holds only the samples of a PulseWaves recording; give the .pls or .plz of the same name, which must be in its folder",
            ),
            (
                "a.WVZ",
                "it holds only the samples of a PulseWaves recording; give the .pls or .plz of the same name, which must be in its folder",
            ),
            (
                "a.wdp",
                "it holds only the waveform packets of a LAS recording; give the .las or .laz of the same name, which must be in its folder",
            ),
            (
                "a.wdz",
                "it holds only the waveform packets of a LAS recording; give the .las or .laz of the same name, which must be in its folder",
            ),
            (
                "a.sbet",
                "it is a trajectory, not a recording; give the recording, and name the trajectory in the job: `trajectory = \"a.sbet\"` in `[job.geometry]`; `wavex trajectory a.sbet` describes it",
            ),
            (
                "a.toml",
                "it is a job, not a recording; run it with `wavex run a.toml`, or view it with `wavex view a.toml`",
            ),
            ("a.las.wvxi", "it is the index of a recording; give a.las"),
            ("a.zip", "it is a compressed file or an archive; unpack it and give a recording in it"),
        ] {
            let error = misplaced(Path::new(name)).map(|error| error.to_string());
            assert_eq!(error, Some(format!("{name}: {expected}")));
        }
        assert!(["a.las", "wdp", "a", "a.txt"].iter().all(|name| misplaced(Path::new(name)).is_none()));
    }

    #[test]
    fn recordings_next_to_it_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let remedy = |name: &str| {
            let error = misplaced(&path(name)).unwrap().to_string();
            error.split_once("; ").unwrap().1.to_owned()
        };
        assert_eq!(remedy(""), "there is no recording in it: give the path of one");
        fs::write(path("a.LAZ"), b"").unwrap();
        assert_eq!(remedy("a.wdp"), format!("give {}", path("a.LAZ").display()));
        let recordings =
            format!("give a recording in it; a job reads all by `path = '{}'`", path("*.laz").display());
        assert_eq!(remedy(""), recordings);
        fs::create_dir(path("out")).unwrap();
        assert_eq!(folder_of_outputs(folder.path()), None);
        fs::write(path("out/job_report.json"), b"").unwrap();
        assert_eq!(folder_of_outputs(folder.path()), Some(path("out")));
        let outputs =
            |name: &str| format!("`wavex view {}` shows the outputs of a run in it", path(name).display());
        assert_eq!(remedy("out"), outputs("out"));
        fs::write(path("a_report.json"), b"").unwrap();
        assert_eq!(folder_of_outputs(folder.path()), Some(folder.path().to_owned()));
        assert_eq!(remedy(""), format!("{recordings}; {}", outputs("")));
    }
}
