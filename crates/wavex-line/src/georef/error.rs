//! Error of georeferencing.

use std::path::PathBuf;

use wavex_geodesy::crs::CrsError;
use wavex_geodesy::time_axis::Misaligned;

/// Recording, trajectory or coordinate reference system that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A file is invalid.
    #[error(transparent)]
    Format(#[from] wavex_formats::Error),
    /// A coordinate reference system or geoid cannot be used.
    #[error("{}{source}", file.as_ref().map_or(String::new(), |file| format!("{}: ", file.display())))]
    Crs {
        /// File that defines it.
        file: Option<PathBuf>,
        /// Problem and remedy.
        source: CrsError,
    },
    /// The times of recording and trajectory do not match.
    #[error(transparent)]
    Misaligned(#[from] Misaligned),
    /// Any other problem, with its remedy.
    #[error("{problem}; {remedy}")]
    Unusable {
        /// The problem.
        problem: String,
        /// The remedy.
        remedy: String,
    },
}

impl From<CrsError> for Error {
    fn from(source: CrsError) -> Error {
        Error::Crs { file: None, source }
    }
}

impl Error {
    /// Creates an error from a problem and its remedy.
    pub(super) fn unusable(problem: impl Into<String>, remedy: impl Into<String>) -> Error {
        Error::Unusable { problem: problem.into(), remedy: remedy.into() }
    }
}

/// Result of georeferencing.
pub type Result<T> = std::result::Result<T, Error>;
