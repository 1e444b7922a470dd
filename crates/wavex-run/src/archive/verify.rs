//! Verifies an archive, its inputs and its outputs by their digests.

use std::path::{Path, PathBuf};

use super::contents::Contents;
use super::digest;
use super::paths::plain;
use super::{Archive, ArchivedFiles, DigestedFile, Seals};
use wavex_formats::Error;
use wavex_line::stage::Result;

/// Current folders of inputs and outputs, if different from those in the archive.
#[derive(Clone, Debug, Default)]
pub struct Folders {
    /// Folder of the inputs.
    pub inputs: Option<PathBuf>,
    /// Folder of the outputs.
    pub outputs: Option<PathBuf>,
}

/// Result of a verification.
#[derive(Debug)]
pub struct Verified {
    /// Differences.
    pub problems: Vec<String>,
    /// Number of verified archive files, inputs and outputs.
    pub counts: [usize; 3],
    /// Stems of the inputs that failed in the archived run.
    pub failed: Vec<String>,
    /// Seal of the archive: the BLAKE3 digest of `archive.b3`; empty if missing.
    pub seal: String,
    /// BLAKE3 digest of `results.b3`; none in archives without it.
    pub results: Option<String>,
}

/// Verifies the digests of an archive's files, inputs and outputs.
///
/// Also compares the seal with `seal_noted`, if given.
///
/// # Errors
/// If there is no archive.
pub fn verify(path: &Path, folders: &Folders, seal_noted: Option<&str>) -> Result<Verified> {
    let contents = Contents::read(path)?;
    let seal = contents.seal();
    let mut problems: Vec<String> =
        seal_noted.and_then(|noted| other_seal(&seal, noted)).into_iter().collect();
    problems.extend(contents.tampering());
    // If the archive was tampered with, the description may be unreadable; report the tampering
    // only.
    let archive = match contents.archive() {
        Err(_) if !problems.is_empty() => {
            let counts = [contents.count(), 0, 0];
            return Ok(Verified { problems, counts, failed: Vec::new(), seal, results: None });
        }
        archive => archive?,
    };
    problems.extend(inputs(&archive, &contents, folders));
    problems.extend(outputs(&archive, &contents, folders));
    let counts = [contents.count(), archive.inputs.files.len(), archive.outputs.files.len()];
    Ok(Verified { problems, counts, failed: failed(&archive), seal, results: contents.results() })
}

/// Description and seals of an existing archive.
///
/// # Errors
/// If it is not an archive with `results.b3`.
pub(crate) fn existing(path: &Path) -> Result<(Archive, Seals)> {
    let contents = Contents::read(path)?;
    let results = contents.results().ok_or_else(|| {
        let problem = "an archive of an older version, without results.b3";
        Error::unusable(path, problem, "move it away")
    })?;
    Ok((contents.archive()?, Seals { seal: contents.seal(), results }))
}

/// Stems of the inputs that failed in the archived run.
pub(super) fn failed(archive: &Archive) -> Vec<String> {
    archive.failed.iter().map(|input| input.stem.clone()).collect()
}

/// Message for a seal that differs from the noted one.
pub(super) fn other_seal(seal: &str, noted: &str) -> Option<String> {
    (!seal.is_empty() && !seal.eq_ignore_ascii_case(noted)).then(|| {
        format!(
            "the seal is {seal} instead of {noted}: this is not the archive with the noted seal, or it was changed and \
             resealed"
        )
    })
}

/// Verifies the inputs.
pub(super) fn inputs(archive: &Archive, contents: &Contents, folders: &Folders) -> Vec<String> {
    let folder = place(&archive.inputs, contents, folders.inputs.as_deref());
    archive.inputs.files.iter().filter_map(|file| problem("input", &folder, file, "--inputs")).collect()
}

fn outputs(archive: &Archive, contents: &Contents, folders: &Folders) -> Vec<String> {
    let folder = place(&archive.outputs, contents, folders.outputs.as_deref());
    archive.outputs.files.iter().filter_map(|file| problem("output", &folder, file, "--outputs")).collect()
}

/// Current folder of files: as given by the user, else relative to the archive, else the original.
pub(super) fn place(files: &ArchivedFiles, contents: &Contents, said: Option<&Path>) -> PathBuf {
    if let Some(said) = said {
        return said.to_owned();
    }
    let has_any = |folder: &Path| files.files.iter().any(|file| folder.join(&file.path).exists());
    let seen = plain(&contents.folder().join(&files.folder));
    let was = PathBuf::from(&files.folder_was);
    if !has_any(&seen) && has_any(&was) { was } else { seen }
}

/// Verifies one file; returns the problem, if any.
fn problem(what: &str, folder: &Path, file: &DigestedFile, option: &str) -> Option<String> {
    let path = folder.join(&file.path);
    if !path.exists() {
        let folder = folder.display();
        return Some(format!("{what} {}: not found in {folder}; give its folder with {option}", file.path));
    }
    // A file of another length need not be read.
    let length = std::fs::metadata(&path).ok().filter(std::fs::Metadata::is_file).map(|about| about.len());
    if let Some(bytes) = length.filter(|bytes| *bytes != file.bytes) {
        let path = path.display();
        return Some(format!(
            "{what} {}: changed: {path} has {bytes} bytes instead of {}",
            file.path, file.bytes
        ));
    }
    match digest::of_file(&path) {
        Err(error) => Some(format!("{what} {}: {error}", file.path)),
        Ok((_, blake3)) if blake3 != file.blake3 => {
            let path = path.display();
            Some(format!(
                "{what} {}: changed: the digest of {path} is {blake3} instead of {}",
                file.path, file.blake3
            ))
        }
        Ok(_) => None,
    }
}
