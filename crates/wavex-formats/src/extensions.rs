//! Extensions of files; files with the same stem and another extension.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::io;
use std::path::{Path, PathBuf};

/// Extension of LAS.
pub const LAS: &str = "las";
/// Extension of LAZ.
pub const LAZ: &str = "laz";
/// Extension of the waveform packets of LAS.
pub const PACKETS: &str = "wdp";
/// HDF5: GEDI and LVIS.
pub const HDF5: &str = "h5";
/// SPD, in HDF5.
pub const SPD: &str = "spd";
/// Extension of the compressed waveform packets of LAS, as LAStools writes them.
pub const COMPRESSED_PACKETS: &str = "wdz";
/// Extension of RIEGL WFM.
pub(crate) const WFM: &str = "wfm";
/// Extension of the waves of PulseWaves.
pub const WAVES: &str = "wvs";
/// Extension of PulseWaves.
pub const PULSES: &str = "pls";
/// Extension of compressed PulseWaves.
pub const COMPRESSED_PULSES: &str = "plz";
/// Extension of the compressed waves of PulseWaves.
pub const COMPRESSED_WAVES: &str = "wvz";

/// Whether a name ends in this extension, in any case.
pub fn has_extension(path: &Path, wanted: &str) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case(wanted))
}

/// Whether a recording is a WFM, of the two formats that RIEGL's library reads.
pub fn is_wfm(recording: &Path) -> bool {
    has_extension(recording, WFM)
}

/// File with the stem of a recording and this extension, in any case, in the same folder.
///
/// The extension in lower case is preferred, because `write_las` writes lower case; then upper case,
/// then the first other spelling in byte order.
pub fn beside(recording: &Path, extension: &str) -> Option<PathBuf> {
    // Most names are found without listing the folder, which may have many files.
    let usual = usual_names(recording, extension).into_iter().find(|path| path.exists());
    usual.or_else(|| {
        let folder = folder_of(recording);
        let names = folder.read_dir().ok()?.flatten().map(|entry| folder.join(entry.file_name()));
        let is_wanted =
            |path: &PathBuf| has_extension(path, extension) && path.file_stem() == recording.file_stem();
        names.filter(is_wanted).min()
    })
}

/// Names with the stem of a recording and this extension, in lower and in upper case.
pub(crate) fn usual_names(recording: &Path, extension: &str) -> [PathBuf; 2] {
    [extension.to_owned(), extension.to_uppercase()].map(|extension| recording.with_extension(extension))
}

pub(crate) fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Files of a folder whose extension, in lower case, is wanted, by stem.
pub(crate) fn by_stem(
    folder: &Path,
    is_wanted: impl Fn(&str) -> bool,
) -> io::Result<BTreeMap<OsString, Vec<PathBuf>>> {
    let mut files: BTreeMap<OsString, Vec<PathBuf>> = BTreeMap::new();
    let entries = match folder.read_dir() {
        Err(error) if matches!(error.kind(), io::ErrorKind::NotFound | io::ErrorKind::PermissionDenied) => {
            return Ok(files);
        }
        entries => entries?,
    };
    for entry in entries {
        let path = folder.join(entry?.file_name());
        if let (true, Some(stem)) = (is_wanted(&extension(&path)), path.file_stem()) {
            files.entry(stem.to_owned()).or_default().push(path.clone());
        }
    }
    Ok(files)
}

/// Extension of a path in lower case.
pub(crate) fn extension(path: &Path) -> String {
    path.extension().unwrap_or_default().to_string_lossy().to_lowercase()
}
