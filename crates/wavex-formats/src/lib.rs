//! Readers and writers of full-waveform lidar files, one module per format.
//!
//! | module | formats |
//! |---|---|
//! | [`mod@format`] | list of the formats of recordings: extensions, companion files, readers |
//! | [`las`] | LAS and LAZ with waveforms, COPC, spatial index (LAX) |
//! | [`pulsewaves`] | PulseWaves (`.pls`, `.wvs`; compressed `.plz`, `.wvz`) |
//! | [`sdf`] | RIEGL SDF and WFM, through RIEGL's library |
//! | [`container`] | the open waveform container (Arrow IPC) |
//! | [`trajectory`] | SBET, POF, SOL, TRJ, text; accuracies: POQ, smrmsg |
//! | [`terrain`], [`geoid`] | GeoTIFF and ESRI ASCII terrain models; NGS and GTX geoid grids |
//! | [`geojson`] | polygons |
//! | [`geokeys`], [`lookup_tables`] | GeoTIFF keys; lookup tables of receivers |
//!
//! The crate knows no scan lines, stages or configuration. Every size read from a file is checked
//! against a limit before anything is allocated. Every [`Error`] has the file, the byte, the field,
//! the problem and the remedy as fields:
//!
//! ```
//! use wavex_formats::{Error, las::Reader};
//!
//! let folder = tempfile::tempdir()?;
//! let path = folder.path().join("flight.las");
//! std::fs::write(&path, b"LASF, but cut off")?;
//! match Reader::open(&path).err() {
//!     Some(Error::Malformed { offset, field, .. }) => {
//!         assert_eq!((offset, field.as_str()), (8, "project ID"));
//!     }
//!     other => panic!("{other:?}"),
//! }
//! # Ok::<(), std::io::Error>(())
//! ```

use std::fs::{self, File};
use std::io::{self, Read};
use std::path::{Component, Path, PathBuf};
use std::string::FromUtf8Error;

mod arithmetic;
pub mod bytes;
pub mod container;
pub mod extensions;
pub mod format;
pub mod geoid;
pub mod geojson;
pub mod geokeys;
pub mod geotiff;
pub mod las;
pub mod lookup_tables;
mod misplaced;
pub mod other_format;
pub mod pulsewaves;
mod recorded_crs;
pub mod sdf;
pub mod terrain;
pub mod trajectory;
mod unsupported;

pub use format::{CompanionIndex, RecordingFormat};
pub use misplaced::{TRAJECTORIES, folder_of_outputs, is_only_points, is_report};
pub use recorded_crs::RecordedCrs;
pub use unsupported::unsupported;

/// Error of a file that cannot be read or written.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The operating system reported an error.
    #[error("{}: cannot {action}: {source}{}", file.display(), remedy_of(source.kind()))]
    Io {
        /// File concerned.
        file: PathBuf,
        /// Attempted action as a verb: "open", "read the header".
        action: &'static str,
        /// Error of the operating system.
        source: io::Error,
    },
    /// The bytes violate the format.
    #[error("{}: byte {offset}: {field}: {problem}; {remedy}", file.display())]
    Malformed {
        /// File concerned.
        file: PathBuf,
        /// Offset of the field from the beginning of the file, bytes.
        offset: u64,
        /// Name of the field in the specification.
        field: String,
        /// Description of the problem.
        problem: String,
        /// Advice to the user.
        remedy: String,
    },
    /// The whole file is unusable.
    ///
    /// Wrong format, missing companion, unsupported version.
    #[error("{}: {problem}; {remedy}", file.display())]
    Unusable {
        /// File concerned.
        file: PathBuf,
        /// Description of the problem.
        problem: String,
        /// Advice to the user.
        remedy: String,
    },
}

impl Error {
    /// Returns an I/O error constructor for `map_err`: `File::open(path).map_err(Error::io(path,
    /// "open"))`.
    pub fn io<'a>(file: &'a Path, action: &'static str) -> impl Fn(io::Error) -> Error + 'a {
        move |source| Error::Io { file: file.to_path_buf(), action, source }
    }

    /// Creates an error about the whole file.
    pub fn unusable(file: &Path, problem: impl Into<String>, remedy: impl Into<String>) -> Error {
        Error::Unusable { file: file.to_path_buf(), problem: problem.into(), remedy: remedy.into() }
    }

    /// Creates an error about one field.
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

    /// Returns whether there is no such file.
    pub fn is_missing(&self) -> bool {
        matches!(self, Error::Io { source, .. } if source.kind() == io::ErrorKind::NotFound)
    }

    /// Returns the file concerned.
    pub fn file(&self) -> &Path {
        match self {
            Error::Io { file, .. } | Error::Malformed { file, .. } | Error::Unusable { file, .. } => file,
        }
    }
}

/// Opens a file of data; pipes and devices, whose opening or reading may never end, are refused.
///
/// # Errors
/// If it is one, or the system refuses.
pub fn regular_file(path: &Path) -> Result<File> {
    if let Ok(about) = fs::metadata(path)
        && !about.is_file()
        && !about.is_dir()
    {
        return Err(Error::unusable(path, "a pipe or device", "copy its content to a file"));
    }
    File::open(path).map_err(Error::io(path, "open"))
}

/// Reads a small file whole.
///
/// `what` it is and `remedy` are for the error if it is larger.
///
/// # Errors
/// If it is a pipe or device, larger than `most_bytes`, or the system refuses.
pub fn read_small(path: &Path, most_bytes: u64, what: &str, remedy: &str) -> Result<Vec<u8>> {
    let file = regular_file(path)?;
    let length = file.metadata().map_err(Error::io(path, "open"))?.len();
    if length > most_bytes {
        return Err(Error::unusable(path, format!("{length} bytes is too large for {what}"), remedy));
    }
    let mut bytes = Vec::new();
    file.take(most_bytes).read_to_end(&mut bytes).map_err(Error::io(path, "read"))?;
    Ok(bytes)
}

/// Reads a small text file whole; see [`read_small`].
///
/// # Errors
/// As [`read_small`], and if it is not UTF-8.
pub fn read_small_text(path: &Path, most_bytes: u64, what: &str, remedy: &str) -> Result<String> {
    let not_text = |error: FromUtf8Error| {
        let error = io::Error::new(io::ErrorKind::InvalidData, error.utf8_error());
        Error::io(path, "read")(error)
    };
    String::from_utf8(read_small(path, most_bytes, what, remedy)?).map_err(not_text)
}

/// Returns the path of a file in a folder in which others may write.
///
/// # Errors
/// If there is no file of this name, or the name or a link leads out of the folder.
pub fn path_within(folder: &Path, name: impl AsRef<Path>) -> Result<PathBuf> {
    let name = name.as_ref();
    let path = folder.join(name);
    let refused = |problem: &str| {
        let remedy = "make the folder again from files that you trust";
        Err(Error::unusable(&path, format!("{problem} that leads out of {}", folder.display()), remedy))
    };
    if !name.components().all(|step| matches!(step, Component::Normal(_) | Component::CurDir)) {
        return refused("a path");
    }
    let found = |path: &Path| path.canonicalize().map_err(Error::io(path, "open"));
    if !found(&path)?.starts_with(found(folder)?) {
        return refused("a link");
    }
    Ok(path)
}

/// Makes room for further items whose number comes from a file.
///
/// # Errors
/// If there is not enough memory.
pub(crate) fn make_room<T>(items: &mut Vec<T>, further: usize) -> io::Result<()> {
    items.try_reserve_exact(further).map_err(|_| io::ErrorKind::OutOfMemory.into())
}

/// Changes the length of a buffer to one that comes from a file; new bytes are zero.
///
/// # Errors
/// If there is not enough memory.
pub(crate) fn resize(bytes: &mut Vec<u8>, length: usize) -> io::Result<()> {
    make_room(bytes, length.saturating_sub(bytes.len()))?;
    bytes.resize(length, 0);
    Ok(())
}

/// Returns advice for an I/O error, to end a message.
///
/// Empty if the system's message suffices.
fn remedy_of(kind: io::ErrorKind) -> &'static str {
    use io::ErrorKind::{
        AlreadyExists, FileTooLarge, IsADirectory, NotADirectory, NotFound, OutOfMemory, PermissionDenied,
        QuotaExceeded, ReadOnlyFilesystem, StorageFull,
    };
    match kind {
        NotFound => "; check the path",
        IsADirectory => "; give a file",
        AlreadyExists | NotADirectory => "; choose another folder: a file is in the way",
        PermissionDenied | ReadOnlyFilesystem => "; check the permissions, or choose another folder",
        OutOfMemory => "; end other programs, or use a machine with more memory",
        StorageFull | QuotaExceeded | FileTooLarge => "; free some space, or write to another disk",
        _ => "",
    }
}

/// Result of this module.
pub type Result<T> = std::result::Result<T, Error>;
