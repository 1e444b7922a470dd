//! Handling of malformed items: a single one is counted and skipped; a file that ends with them is
//! truncated.

use wavex_formats::{Error, Result};
use wavex_line::stage::{Context, Reason};

/// The malformed items since the last good one.
#[derive(Debug, Default)]
pub(crate) struct BrokenRun {
    first: Option<Error>,
    warned: bool,
}

impl BrokenRun {
    /// Returns whether an item is usable; rejects a malformed one, with one note per file.
    ///
    /// # Errors
    /// I/O errors, which affect more than one item.
    pub(crate) fn accepts<T>(&mut self, read: Result<T>, cx: &mut Context, reason: Reason) -> Result<bool> {
        match read {
            Ok(_) => {
                self.first = None;
                Ok(true)
            }
            Err(error @ Error::Io { .. }) => Err(error),
            Err(error) => {
                cx.reject(reason, 1);
                if !std::mem::replace(&mut self.warned, true) {
                    cx.warn(format!("{reason} was rejected; further ones are only counted: {error}"));
                }
                self.first.get_or_insert(error);
                Ok(false)
            }
        }
    }

    /// At the end of a file: fails if the last item was malformed.
    pub(crate) fn check_at_end(&mut self) -> Result<()> {
        self.first.take().map_or(Ok(()), Err)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    fn bad(offset: u64) -> Result<()> {
        Err(Error::malformed(Path::new("a.wvs"), offset, "samples", "cut", "copy it again"))
    }

    #[test]
    fn bad_items_are_counted_and_logged_once() {
        let (mut broken, mut cx) = (BrokenRun::default(), Context::default());
        cx.reject(Reason::PulseWithoutDirection, 1);
        for read in [bad(1), bad(2), Ok(())] {
            broken.accepts(read, &mut cx, Reason::UnreadableWaves).unwrap();
        }
        assert_eq!(cx.counters().rejected_of(Reason::UnreadableWaves.item()), 3);
        assert_eq!(
            cx.counters().notes,
            [
                "a pulse whose waves cannot be read was rejected; further ones are only counted: a.wvs: byte 1: \
              samples: cut; copy it again"
            ]
        );
        assert!(broken.check_at_end().is_ok());
    }

    #[test]
    fn a_file_that_ends_with_bad_items_is_cut_off() {
        let (mut broken, mut cx) = (BrokenRun::default(), Context::default());
        for read in [Ok(()), bad(3), bad(4)] {
            broken.accepts(read, &mut cx, Reason::UnreadableWaves).unwrap();
        }
        assert_eq!(
            broken.check_at_end().unwrap_err().to_string(),
            "a.wvs: byte 3: samples: cut; copy it again"
        );
    }
}
