//! Failures of library calls, with messages and remedies.

use std::path::Path;

use crate::Error;

/// Return codes of the interface.
pub(super) mod code {
    pub const END_OF_FILE: i32 = -1;
    pub const DONE: i32 = 0;
    pub const BAD_ARGUMENT: i32 = 1;
    pub const UNSUPPORTED_FORMAT: i32 = 2;
    pub const MISSING_INDEX: i32 = 3;
    pub const UNKNOWN_EXCEPTION: i32 = 4;
    pub const NOT_IMPLEMENTED: i32 = 5;
    pub const RUNTIME: i32 = 6;
    pub const NOT_LICENSED: i32 = 7;
}

/// Failed call, or call with unusable results.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum LibraryFault {
    /// The library returned an error.
    Refused {
        /// Function called.
        function: &'static str,
        /// Return code, not 0.
        code: i32,
        /// Error message of the library; may be empty.
        words: String,
    },
    /// The library reported success but returned invalid data.
    Nonsense {
        /// Function called.
        function: &'static str,
        /// Description of the invalid data.
        problem: String,
    },
}

/// Result of a call.
pub(super) type CallResult<T> = std::result::Result<T, LibraryFault>;

impl LibraryFault {
    pub(super) fn nonsense(function: &'static str, problem: impl Into<String>) -> LibraryFault {
        LibraryFault::Nonsense { function, problem: problem.into() }
    }

    /// Returns the return code; `None` if the call itself succeeded.
    pub(super) fn code(&self) -> Option<i32> {
        match self {
            LibraryFault::Refused { code, .. } => Some(*code),
            LibraryFault::Nonsense { .. } => None,
        }
    }

    /// Describes the problem.
    pub(super) fn problem(&self) -> String {
        match self {
            LibraryFault::Refused { function, code, words } => {
                let own = if words.is_empty() { String::new() } else { format!(": \"{words}\"") };
                format!("{function} of RIEGL's library failed with {code}, {}{own}", meaning(*code))
            }
            LibraryFault::Nonsense { function, problem } => {
                format!("{function} of RIEGL's library returned invalid data: {problem}")
            }
        }
    }

    /// Converts the fault to an error of a file.
    pub(super) fn of_file(&self, file: &Path) -> Error {
        Error::unusable(file, self.problem(), self.remedy())
    }

    fn remedy(&self) -> &'static str {
        match self.code() {
            Some(code::END_OF_FILE) => "the file may be cut off: copy it again",
            Some(code::BAD_ARGUMENT) => {
                "the library may have a version that wavex does not support: use a newer one, or \
                 report this to the wavex developers"
            }
            Some(code::UNSUPPORTED_FORMAT) => {
                "`.sdf` needs the library sdfifc, `.wfm` needs wfmifc-mt: check `library`, the \
                 file's extension, and its content"
            }
            Some(code::MISSING_INDEX) => "remove the `.idx` file next to the data so that it is rebuilt",
            Some(code::UNKNOWN_EXCEPTION) => "the file may be damaged: copy it again, or try a newer library",
            Some(code::NOT_IMPLEMENTED) => "use a newer version of the library",
            Some(code::RUNTIME) => "check the file, its folder and the disk",
            Some(code::NOT_LICENSED) => "ask RIEGL for a licence that covers it",
            Some(_) => "use a supported version of the library, or report this to the wavex developers",
            None => "the file may be damaged: copy it again, or try another version of the library",
        }
    }
}

/// Describes a return code.
fn meaning(code: i32) -> &'static str {
    match code {
        code::END_OF_FILE => "end of file",
        code::DONE => "no error",
        code::BAD_ARGUMENT => "a bad argument",
        code::UNSUPPORTED_FORMAT => "an unsupported format",
        code::MISSING_INDEX => "a missing index",
        code::UNKNOWN_EXCEPTION => "an unknown exception",
        code::NOT_IMPLEMENTED => "not implemented",
        code::RUNTIME => "a runtime error",
        code::NOT_LICENSED => "not licensed",
        _ => "an unknown code",
    }
}
