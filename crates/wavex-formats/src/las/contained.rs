//! Runs compressors of the `laz` crate, whose arithmetic may panic on unusual values.

use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};

/// Runs a compressor; converts its panic to an error.
///
/// # Errors
/// The compressor fails or panics; a build with overflow checks panics for some values.
pub(super) fn contained<T>(compress: impl FnOnce() -> io::Result<T>) -> io::Result<T> {
    catch_unwind(AssertUnwindSafe(compress)).unwrap_or_else(|_| {
        let problem = "the LASzip library cannot compress these points: their values change by more than it \
                       supports; remove points with damaged coordinates, times or waveform offsets";
        Err(io::Error::other(problem))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_becomes_an_error() {
        let problem = contained::<()>(|| panic!("attempt to add with overflow")).unwrap_err().to_string();
        assert!(problem.starts_with("the LASzip library cannot compress these points: "), "{problem}");
        assert_eq!(contained(|| Ok(3)).unwrap(), 3);
    }
}
