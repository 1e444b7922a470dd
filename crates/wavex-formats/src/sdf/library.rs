//! Locates RIEGL's library.
//!
//! The key of the command line comes first, then the environment variable [`VARIABLE`], then the usual places:
//! the folder of the program, the system's search path, and a few common folders.

use std::path::{Path, PathBuf};

use super::fault::LibraryFault;
use super::interface::{Functions, LibraryVersion};
use crate::extensions::is_wfm;
use crate::{Error, Result};

/// Environment variable that may name the library or its folder.
pub const VARIABLE: &str = "WAVEX_RIWAVELIB";

/// Major version of the declared interface.
pub const MAJOR: u16 = 1;

/// Common folders of the library, searched after the program's folder.
#[cfg(not(windows))]
const FOLDERS: &[&str] =
    &["/usr/local/lib", "/opt/riwavelib/lib", "/opt/riegl/lib", "/opt/riegl/riwavelib/lib"];
/// Common folders of the library, searched after the program's folder.
#[cfg(windows)]
const FOLDERS: &[&str] = &["C:\\Program Files\\RIEGL\\RiWAVELib\\lib", "C:\\riwavelib\\lib"];

/// Whether the program is static: it cannot load libraries.
const IS_STATIC: bool = cfg!(all(unix, target_feature = "crt-static"));

/// Remedy for a static program.
pub const LOADING_PROGRAM: &str = "use wavex from its Debian package, or built by `cargo install`";

/// Source of a library path.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Said {
    ByKey,
    ByVariable,
}

/// Returns the library's file names for a data file.
///
/// The usual one is first. As in the library, the extension of the file decides.
fn names(data: &Path) -> [String; 2] {
    let is_wfm = is_wfm(data);
    let stem = if is_wfm { "wfmifc-mt" } else { "sdfifc" };
    let suffix = if is_wfm { "-s" } else { "-mt" };
    let (before, after) = (std::env::consts::DLL_PREFIX, std::env::consts::DLL_SUFFIX);
    [format!("{before}{stem}{after}"), format!("{before}{stem}{suffix}{after}")]
}

/// Finds, loads and checks the library for a file.
///
/// `key` is the library or its folder, as given on the command line; `announce` gets the file before
/// it is loaded.
pub(super) fn find(
    data: &Path,
    key: Option<&Path>,
    announce: &dyn Fn(&Path),
) -> Result<(Functions, LibraryVersion)> {
    if IS_STATIC {
        return Err(Error::unusable(
            data,
            "this format needs RIEGL's Waveform Extraction Library (RiWAVELib), \
             which a static program cannot load",
            LOADING_PROGRAM,
        ));
    }
    let functions = match (key, std::env::var_os(VARIABLE)) {
        (Some(key), _) => named(data, key, Said::ByKey, announce)?,
        (None, Some(variable)) if !variable.is_empty() => {
            named(data, Path::new(&variable), Said::ByVariable, announce)?
        }
        _ => in_usual_places(data, announce)?,
    };
    let version = functions.version().map_err(|fault: LibraryFault| fault.of_file(data))?;
    match version.major {
        MAJOR => Ok((functions, version)),
        other => Err(Error::unusable(
            data,
            format!("RIEGL's library has version {other}.{}, but wavex supports {MAJOR}.x", version.minor),
            format!("set a library of version {MAJOR}, or use a newer wavex"),
        )),
    }
}

/// RIEGL's library for SDF on this machine.
#[derive(Clone, Debug, PartialEq)]
pub enum Installed {
    /// It was loaded.
    Loaded(LibraryVersion),
    /// It is in none of the usual places, and [`VARIABLE`] is not set.
    Missing,
    /// It was found, but cannot be used: the reason.
    Unusable(String),
    /// This program is static and loads no libraries.
    Unsupported,
}

/// Looks for the library for SDF where readers do without a key.
pub fn installed() -> Installed {
    if IS_STATIC {
        return Installed::Unsupported;
    }
    let data = Path::new("recording.sdf");
    match find(data, None, &|_| {}) {
        Ok((_, version)) => Installed::Loaded(version),
        Err(Error::Unusable { problem, .. }) if is_there(data) => Installed::Unusable(problem),
        Err(_) => Installed::Missing,
    }
}

/// Whether a library is named or in one of the usual folders.
fn is_there(data: &Path) -> bool {
    let is_named = std::env::var_os(VARIABLE).is_some_and(|variable| !variable.is_empty());
    is_named || usual_folders().any(|folder| names(data).iter().any(|name| folder.join(name).is_file()))
}

/// Folders that are searched: the folder of the program, then the common ones.
fn usual_folders() -> impl Iterator<Item = PathBuf> {
    let program = std::env::current_exe().ok();
    let beside = program.and_then(|program| program.parent().map(Path::to_path_buf));
    beside.into_iter().chain(FOLDERS.iter().map(PathBuf::from))
}

/// Loads the library named by the user.
fn named(data: &Path, path: &Path, said: Said, announce: &dyn Fn(&Path)) -> Result<Functions> {
    let whose = match said {
        Said::ByKey => "the key `library`".to_owned(),
        Said::ByVariable => format!("the environment variable {VARIABLE}"),
    };
    let file = match path.is_dir() {
        false => path.to_path_buf(),
        true => {
            let [usual, other] = names(data).map(|name| path.join(name));
            match [&usual, &other].into_iter().find(|file| file.is_file()) {
                Some(file) => file.clone(),
                None => {
                    let problem = format!(
                        "{whose} names the folder {}, which has no {}",
                        path.display(),
                        file_name(&usual)
                    );
                    return Err(Error::unusable(data, problem, WHOSE));
                }
            }
        }
    };
    announce(&file);
    Functions::load(&file).map_err(|error| {
        let problem = format!(
            "the library {}, which {whose} names, cannot be loaded: {}",
            file.display(),
            reason(&error)
        );
        Error::unusable(data, problem, WHOSE)
    })
}

fn in_usual_places(data: &Path, announce: &dyn Fn(&Path)) -> Result<Functions> {
    let names = names(data);
    for file in usual_folders().flat_map(|folder| names.clone().map(|name| folder.join(name))) {
        if file.is_file() {
            announce(&file);
            return Functions::load(&file).map_err(|error| {
                let problem = format!("the library {} cannot be loaded: {}", file.display(), reason(&error));
                Error::unusable(data, problem, WHOSE)
            });
        }
    }
    for name in &names {
        announce(Path::new(name));
        if let Ok(functions) = Functions::load(Path::new(name)) {
            return Ok(functions);
        }
    }
    let looked: Vec<String> = usual_folders().map(|folder| folder.display().to_string()).collect();
    Err(Error::unusable(
        data,
        format!(
            "this format needs RIEGL's Waveform Extraction Library (RiWAVELib), but {} was found \
             neither where the system looks for libraries nor in {}",
            names[0],
            looked.join(", ")
        ),
        format!(
            "its licence forbids shipping it, but owners of a RIEGL instrument can download it \
             from RIEGL: then name the library or its folder in the environment variable {VARIABLE} \
             or with `--set read_sdf.library=PATH`"
        ),
    ))
}

const WHOSE: &str = "give the path of RIEGL's Waveform Extraction Library (sdfifc for `.sdf`, \
                     wfmifc-mt for `.wfm`), built for this system, or its folder";

fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// Returns the loader's error message.
///
/// It includes the system's error message, if present.
fn reason(error: &libloading::Error) -> String {
    match std::error::Error::source(error) {
        Some(source) => format!("{error}: {source}"),
        None => error.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_extension_chooses_the_library() {
        let (before, after) = (std::env::consts::DLL_PREFIX, std::env::consts::DLL_SUFFIX);
        for (data, stem) in
            [("a.sdf", "sdfifc"), ("a.wfm", "wfmifc-mt"), ("A.WFM", "wfmifc-mt"), ("a", "sdfifc")]
        {
            assert_eq!(names(Path::new(data))[0], format!("{before}{stem}{after}"));
        }
    }
}
