//! Limits of a job, so that a hostile one costs no more than its error message.

use std::io::{self, Read};

use super::JobError;
use super::sources::Include;

/// Maximum size of a job together with its included files, bytes.
pub const MAX_BYTES: u64 = 8_000_000;
/// Maximum number of included files.
pub const MAX_INCLUDES: usize = 32;
/// Maximum number of stages.
pub(super) const MAX_STAGES: usize = 1000;
/// Reads a job or an included file; reads no further than one byte past [`MAX_BYTES`].
///
/// # Errors
/// If it cannot be read, is larger than [`MAX_BYTES`], or is not UTF-8.
pub fn read_text(file: impl Read) -> io::Result<String> {
    let mut bytes = Vec::new();
    file.take(MAX_BYTES + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > MAX_BYTES {
        return Err(io::Error::other(format!("it is larger than {} MB", MAX_BYTES / 1_000_000)));
    }
    // Text in UTF-16 begins with a byte order mark, or has a zero byte in each ASCII character.
    if matches!(bytes.as_slice(), [0xff, 0xfe, ..] | [0xfe, 0xff, ..] | [_, 0, ..] | [0, _, ..]) {
        return Err(io::Error::other(
            "it is UTF-16 text, as `>` of Windows PowerShell writes; save it as UTF-8, or let wavex write the file: \
             `wavex init RECORDING JOB.toml`",
        ));
    }
    String::from_utf8(bytes).map_err(|error| {
        let at = error.utf8_error().valid_up_to();
        io::Error::other(format!("it is not UTF-8 text: byte {at}; save it as UTF-8"))
    })
}

/// Error if the texts of a job are too large or too many.
pub(super) fn check(text: &str, includes: &[Include]) -> Option<JobError> {
    let bytes = includes.iter().fold(text.len() as u64, |sum, file| sum + file.text.len() as u64);
    if bytes > MAX_BYTES {
        let of = if includes.is_empty() { "the job has" } else { "the job and its included files have" };
        let problem = format!("{of} {bytes} bytes, more than {} MB", MAX_BYTES / 1_000_000);
        return Some(JobError::of_job(problem).help("name many inputs by a pattern, as in `lines/*.laz`"));
    }
    let problem =
        || JobError::of_job(format!("the job includes {} files, more than {MAX_INCLUDES}", includes.len()));
    (includes.len() > MAX_INCLUDES).then(|| problem().help("merge some of them"))
}
