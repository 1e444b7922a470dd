//! What can be wrong with a call of the library, and what the user can do about it.

use std::path::Path;

use crate::formats::Error;

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

/// A call that gave nothing that can be used.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Fault {
    /// The library refused.
    Refused {
        /// The function called.
        function: &'static str,
        /// Its return code, not 0.
        code: i32,
        /// The library's own words; may be empty.
        words: String,
    },
    /// The library succeeded, but what it gave cannot be.
    Nonsense {
        /// The function called.
        function: &'static str,
        /// What is wrong with what it gave.
        problem: String,
    },
}

/// What a call gives.
pub(super) type Answer<T> = std::result::Result<T, Fault>;

impl Fault {
    pub(super) fn nonsense(function: &'static str, problem: impl Into<String>) -> Fault {
        Fault::Nonsense { function, problem: problem.into() }
    }

    /// The return code; `None` where the call itself succeeded.
    pub(super) fn code(&self) -> Option<i32> {
        match self {
            Fault::Refused { code, .. } => Some(*code),
            Fault::Nonsense { .. } => None,
        }
    }

    /// What is wrong, in words.
    pub(super) fn problem(&self) -> String {
        match self {
            Fault::Refused { function, code, words } => {
                let own = if words.is_empty() { String::new() } else { format!(": \"{words}\"") };
                format!("{function} of RIEGL's library fails with {code}, {}{own}", meaning(*code))
            }
            Fault::Nonsense { function, problem } => {
                format!("{function} of RIEGL's library gives what cannot be: {problem}")
            }
        }
    }

    /// The error of a file.
    pub(super) fn of_file(&self, file: &Path) -> Error {
        Error::unusable(file, self.problem(), self.remedy())
    }

    fn remedy(&self) -> &'static str {
        match self.code() {
            Some(code::END_OF_FILE) => "the file may be cut off: copy it again",
            Some(code::BAD_ARGUMENT) => {
                "the library may be of another version than wavex knows: use a newer one, or tell the makers of wavex"
            }
            Some(code::UNSUPPORTED_FORMAT) => {
                "`.sdf` wants the library sdfifc, `.wfm` wfmifc-mt: check `library`, the file's extension, and its content"
            }
            Some(code::MISSING_INDEX) => "remove the `.idx` file beside the data, so that it is made anew",
            Some(code::UNKNOWN_EXCEPTION) => "the file may be damaged: copy it again, or try a newer library",
            Some(code::NOT_IMPLEMENTED) => "use a newer version of the library",
            Some(code::RUNTIME) => "check the file, its folder and the disk",
            Some(code::NOT_LICENSED) => "ask RIEGL for a licence that covers it",
            Some(_) => "use a library of the version that wavex knows, or tell the makers of wavex",
            None => "the file may be damaged: copy it again, or try another version of the library",
        }
    }
}

/// What a return code means.
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
        _ => "a code that is not known",
    }
}
