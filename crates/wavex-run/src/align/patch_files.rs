//! Patches of strips from the files of `write_patches`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::jobs::JobPlace;
use crate::Failure;
use wavex_engine::engine::{self, Input};
use wavex_line::georef::{Geometry, Loader};
use wavex_stages::writers::write_patches::{ENDING, PatchesFile, StripName, read_patches, read_strip_name};

/// File with the patches of a strip, or the reason that it is missing.
pub(super) struct FoundStrip {
    /// Name of the strip; that of its file if it cannot be read.
    pub(super) name: String,
    /// The recording.
    recording: Result<PathBuf, String>,
    file: PathBuf,
}

/// Files of patches of each job; `None` if none are given.
///
/// Of several jobs, a file belongs to the first one that has its strip as an input and the calibration, mount and trajectory
/// it was made with; without such a job, to the first one that has its strip; else to the first one it fits, or the first.
///
/// # Errors
/// A folder that cannot be listed or has no patches.
pub(super) fn of_jobs(
    places: &[JobPlace<'_>],
    given: &[PathBuf],
    cell_m: f64,
) -> Result<Vec<Option<Vec<PathBuf>>>, Failure> {
    if given.is_empty() {
        return Ok(vec![None; places.len()]);
    }
    if places.len() < 2 {
        return Ok(vec![Some(given.to_vec()); places.len()]);
    }
    let mut files = Vec::new();
    for path in given {
        if path.is_dir() { files.extend(in_folder(path)?) } else { files.push(path.clone()) }
    }
    let mut made = vec![Some(Vec::new()); places.len()];
    for file in files {
        let patches = read_patches(&file).ok();
        let rank = |place: &JobPlace<'_>| {
            let Some(patches) = &patches else { return 0 };
            let inputs = engine::inputs(place.job, place.input_dir()).unwrap_or_default();
            let has_strip = inputs.iter().any(|input| input.stem == patches.stem);
            let mut keys = place.job.settings.geometry.clone();
            keys.corrections = None;
            let geometry = Loader::new(&keys, place.input_dir())
                .and_then(|mut loader| loader.load(&patches.stem, || false));
            let fits = geometry.is_ok_and(|geometry| patches.difference(&geometry, cell_m).is_none());
            2 * u8::from(has_strip) + u8::from(fits)
        };
        let ranks: Vec<u8> = places.iter().map(rank).collect();
        let most = ranks.iter().max().copied().unwrap_or_default();
        let job = ranks.iter().position(|rank| *rank == most).unwrap_or_default();
        made[job].get_or_insert_default().push(file);
    }
    Ok(made)
}

/// Finds the files of patches in the order of the job's inputs, then by name; inputs without a file come last.
///
/// Patches are read by [`FoundStrip::open`], one strip after another.
///
/// # Errors
/// A folder that cannot be listed or has no patches.
pub(super) fn find(given: &[PathBuf], inputs: &[Input]) -> Result<Vec<FoundStrip>, Failure> {
    let mut files = Vec::new();
    for path in given {
        if path.is_dir() { files.extend(in_folder(path)?) } else { files.push(path.clone()) }
    }
    let order: BTreeMap<&str, usize> =
        inputs.iter().enumerate().map(|(place, input)| (input.stem.as_str(), place)).collect();
    let found = files.into_iter().map(|file| match read_strip_name(&file) {
        Ok(StripName { stem, recording }) => {
            let input = order.get(stem.as_str()).and_then(|place| inputs.get(*place));
            let recording = input.map_or_else(|| recording.into(), |input| input.path.clone());
            FoundStrip { name: stem, recording: Ok(recording), file }
        }
        Err(error) => {
            let name = file.file_name().unwrap_or_default().to_string_lossy();
            let name = name.strip_suffix(ENDING).unwrap_or(&name).to_owned();
            FoundStrip { name, recording: Err(error.to_string()), file }
        }
    });
    let mut found: Vec<FoundStrip> = found.collect();
    found.sort_by_key(|strip| {
        (order.get(strip.name.as_str()).copied().unwrap_or(usize::MAX), strip.name.clone())
    });
    let missing: Vec<&Input> =
        inputs.iter().filter(|input| !found.iter().any(|strip| strip.name == input.stem)).collect();
    found.extend(missing.into_iter().map(|input| FoundStrip {
        name: input.stem.clone(),
        recording: Err(format!(
            "{}: none of the given files has the patches of this input; run it with `write_patches`",
            input.stem
        )),
        file: PathBuf::new(),
    }));
    Ok(found)
}

/// Files of patches in a folder, by name.
fn in_folder(folder: &Path) -> Result<Vec<PathBuf>, Failure> {
    let failed =
        |error: std::io::Error| Failure::Run(format!("{}: {error}; check the path", folder.display()));
    let mut files = Vec::new();
    for entry in folder.read_dir().map_err(failed)? {
        let entry = entry.map_err(failed)?;
        if entry.file_name().to_string_lossy().ends_with(ENDING) {
            files.push(entry.path());
        }
    }
    if files.is_empty() {
        let remedy = "run the job with the stage `write_patches`";
        return Err(Failure::Run(format!("{}: no patches (*{ENDING}); {remedy}", folder.display())));
    }
    files.sort();
    Ok(files)
}

impl FoundStrip {
    /// The patches with their recording and the trajectory of the job; adds the file to those that are `used` by strip.
    ///
    /// # Errors
    /// Why they cannot be used, with the name of the file or strip.
    pub(super) fn open(
        self,
        used: &mut BTreeMap<String, PathBuf>,
        loader: &mut Loader,
        cell_m: f64,
    ) -> Result<(PatchesFile, PathBuf, Arc<Geometry>), String> {
        let FoundStrip { name, recording, file } = self;
        let recording = recording?;
        if let Some(other) = used.get(&name) {
            return Err(format!(
                "{}: the patches of `{name}` are also in {}, which are used; remove the file that is out of date",
                file.display(),
                other.display()
            ));
        }
        let patches = read_patches(&file).map_err(|error| error.to_string())?;
        used.insert(name.clone(), file.clone());
        let geometry = loader.load(&name, || false).map_err(|error| format!("{name}: {error}"))?;
        match patches.difference(&geometry, cell_m) {
            Some(difference) => Err(format!("{}: {difference}", file.display())),
            None => Ok((patches, recording, Arc::new(geometry))),
        }
    }
}
