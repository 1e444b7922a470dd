//! Whether an archive and the files that it tells of are as they were: by digests alone.

use std::path::{Path, PathBuf};

use super::contents::Contents;
use super::digest;
use super::paths::plain;
use super::{Archive, DigestedFile, Files};
use crate::stage::Result;

/// Where inputs and outputs are now, where they are not where the archive says.
#[derive(Clone, Debug, Default)]
pub struct Folders {
    /// The folder of the inputs.
    pub inputs: Option<PathBuf>,
    /// The folder of the outputs.
    pub outputs: Option<PathBuf>,
}

/// What came out.
#[derive(Debug)]
pub struct Verified {
    /// Each thing that is not as it was.
    pub problems: Vec<String>,
    /// How many files of the archive, inputs and outputs were looked at.
    pub counts: [usize; 3],
    /// The archive's seal, the BLAKE3 digest of `archive.b3`; empty where that is missing.
    pub seal: String,
}

/// Compares the files of an archive, its inputs and its outputs with their digests; and the archive's seal with the one that
/// was written down, where that is given.
///
/// # Errors
/// There is no archive.
pub fn verify(path: &Path, folders: &Folders, seal_noted: Option<&str>) -> Result<Verified> {
    let contents = Contents::read(path)?;
    let seal = contents.seal();
    let mut problems: Vec<String> =
        seal_noted.and_then(|noted| other_seal(&seal, noted)).into_iter().collect();
    problems.extend(contents.tampering());
    // What cannot be told of an archive that was tampered with is told by that.
    let archive = match contents.archive() {
        Err(_) if !problems.is_empty() => {
            return Ok(Verified { problems, counts: [contents.count(), 0, 0], seal });
        }
        archive => archive?,
    };
    problems.extend(inputs(&archive, &contents, folders));
    problems.extend(outputs(&archive, &contents, folders));
    let counts = [contents.count(), archive.inputs.files.len(), archive.outputs.files.len()];
    Ok(Verified { problems, counts, seal })
}

/// What a seal that is not the one written down means.
fn other_seal(seal: &str, noted: &str) -> Option<String> {
    (!seal.is_empty() && !seal.eq_ignore_ascii_case(noted)).then(|| {
        format!(
            "the seal is {seal} instead of {noted}: this is not the archive whose seal was written down, or it was changed and \
             sealed anew"
        )
    })
}

/// What is not as it was of the inputs.
pub(super) fn inputs(archive: &Archive, contents: &Contents, folders: &Folders) -> Vec<String> {
    let folder = place(&archive.inputs, contents, folders.inputs.as_deref());
    archive.inputs.files.iter().filter_map(|file| problem("input", &folder, file, "--inputs")).collect()
}

fn outputs(archive: &Archive, contents: &Contents, folders: &Folders) -> Vec<String> {
    let folder = place(&archive.outputs, contents, folders.outputs.as_deref());
    archive.outputs.files.iter().filter_map(|file| problem("output", &folder, file, "--outputs")).collect()
}

/// Where files are: where the user says, else as seen from the archive, else where they were.
pub(super) fn place(files: &Files, contents: &Contents, said: Option<&Path>) -> PathBuf {
    if let Some(said) = said {
        return said.to_owned();
    }
    let has_any = |folder: &Path| files.files.iter().any(|file| folder.join(&file.path).exists());
    let seen = plain(&contents.folder().join(&files.folder));
    let was = PathBuf::from(&files.folder_was);
    if !has_any(&seen) && has_any(&was) { was } else { seen }
}

/// What is wrong with a file, if anything.
fn problem(what: &str, folder: &Path, file: &DigestedFile, option: &str) -> Option<String> {
    let path = folder.join(&file.path);
    if !path.exists() {
        let folder = folder.display();
        return Some(format!(
            "{what} {}: not found in {folder}; say with {option} where it is now",
            file.path
        ));
    }
    match digest::of_file(&path) {
        Err(error) => Some(format!("{what} {}: {error}", file.path)),
        Ok((bytes, _)) if bytes != file.bytes => {
            let path = path.display();
            Some(format!("{what} {}: changed: {path} has {bytes} bytes instead of {}", file.path, file.bytes))
        }
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
