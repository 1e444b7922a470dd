//! Bytes to structs and back, one file per format: no batch, no stage, no configuration, no thread.
//!
//! Whatever a file says of its own sizes passes a limit before anything is allocated, and every error names the file,
//! the byte and the field.

use std::io;
use std::path::{Path, PathBuf};

pub mod bytes;
pub mod container;
pub mod geoid;
pub mod geokeys;
pub mod las;
pub mod lookup_tables;
pub mod pulsewaves;
pub mod sdf;
pub mod terrain;
pub mod trajectory;
mod unsupported;

pub use unsupported::unsupported;

/// What can be wrong with a file.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The operating system refused.
    #[error("{}: cannot {action}: {source}{}", file.display(), remedy_of(source.kind()))]
    Io {
        /// The file concerned.
        file: PathBuf,
        /// What was tried, as a verb: "open", "read the header".
        action: &'static str,
        /// The system's own words.
        source: io::Error,
    },
    /// The bytes are not what the format says.
    #[error("{}: byte {offset}: {field}: {problem}; {remedy}", file.display())]
    Malformed {
        /// The file concerned.
        file: PathBuf,
        /// Where the field starts, from the beginning of the file.
        offset: u64,
        /// The field's name in the specification.
        field: String,
        /// What is wrong with it.
        problem: String,
        /// What the user can do.
        remedy: String,
    },
    /// The file as a whole cannot be used: another format, a missing companion, an unsupported version.
    #[error("{}: {problem}; {remedy}", file.display())]
    Unusable {
        /// The file concerned.
        file: PathBuf,
        /// What is wrong with it.
        problem: String,
        /// What the user can do.
        remedy: String,
    },
}

impl Error {
    /// An input or output error, for `map_err`: `File::open(path).map_err(Error::io(path, "open"))`.
    pub fn io<'a>(file: &'a Path, action: &'static str) -> impl Fn(io::Error) -> Error + 'a {
        move |source| Error::Io { file: file.to_path_buf(), action, source }
    }

    /// The file as a whole cannot be used.
    pub fn unusable(file: &Path, problem: impl Into<String>, remedy: impl Into<String>) -> Error {
        Error::Unusable { file: file.to_path_buf(), problem: problem.into(), remedy: remedy.into() }
    }

    /// A field that is not what the format says.
    pub fn malformed(
        file: &Path,
        offset: u64,
        field: impl Into<String>,
        problem: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Error {
        Error::Malformed {
            file: file.to_path_buf(),
            offset,
            field: field.into(),
            problem: problem.into(),
            remedy: remedy.into(),
        }
    }

    /// The file concerned.
    pub fn file(&self) -> &Path {
        match self {
            Error::Io { file, .. } | Error::Malformed { file, .. } | Error::Unusable { file, .. } => file,
        }
    }
}

/// What the user can do where the system refuses, as the end of a message; empty where its own words must do.
fn remedy_of(kind: io::ErrorKind) -> &'static str {
    use io::ErrorKind::{
        AlreadyExists, FileTooLarge, IsADirectory, NotADirectory, NotFound, PermissionDenied, QuotaExceeded,
        ReadOnlyFilesystem, StorageFull,
    };
    match kind {
        NotFound => "; check the path",
        IsADirectory => "; give a file",
        AlreadyExists | NotADirectory => "; choose another folder: a file is in the way",
        PermissionDenied | ReadOnlyFilesystem => "; check the permissions, or choose another folder",
        StorageFull | QuotaExceeded | FileTooLarge => "; make room, or write to another disk",
        _ => "",
    }
}

/// The files beside a recording that belong to it: a `.wdp` beside LAS, a `.wvs` beside PulseWaves, whatever their case.
pub fn companions(path: &Path) -> Vec<PathBuf> {
    let extension = |path: &Path| path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
    let wanted = match extension(path).as_str() {
        "las" | "laz" => "wdp",
        "pls" => "wvs",
        _ => return Vec::new(),
    };
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let belongs = |other: &PathBuf| other.file_stem() == path.file_stem() && extension(other) == wanted;
    let entries = folder.read_dir().into_iter().flatten().flatten();
    entries.map(|entry| folder.join(entry.file_name())).filter(belongs).collect()
}

/// Shorthand for results of this module.
pub type Result<T> = std::result::Result<T, Error>;
