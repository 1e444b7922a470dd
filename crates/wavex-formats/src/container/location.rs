//! Locations in a container, for errors.

use std::path::Path;

use crate::Error;

/// A record batch or another part of a container, for errors.
#[derive(Clone, Copy)]
pub(super) struct ContainerLocation<'a> {
    /// The file's name; `-` for standard input.
    pub(super) file: &'a Path,
    /// Start of the part, bytes from the beginning of the file.
    pub(super) offset: u64,
    /// First row of the record batch, counted from the start of the container, from 0.
    pub(super) first_row: u64,
}

impl ContainerLocation<'_> {
    /// Error in a field of the part.
    pub(super) fn bad(&self, field: impl Into<String>, problem: impl Into<String>, remedy: &str) -> Error {
        Error::malformed(self.file, self.offset, field, problem, remedy)
    }

    /// Error in a column in `row` of the record batch.
    pub(super) fn bad_row(
        &self,
        column: &str,
        row: usize,
        problem: impl Into<String>,
        remedy: &str,
    ) -> Error {
        let row = self.first_row + row as u64;
        self.bad(format!("column `{column}`, row {row}"), problem, remedy)
    }

    /// Error in a column, with the row if known.
    pub(super) fn bad_column(
        &self,
        column: &str,
        row: Option<usize>,
        problem: impl Into<String>,
        remedy: &str,
    ) -> Error {
        match row {
            Some(row) => self.bad_row(column, row, problem, remedy),
            None => self.bad(format!("column `{column}`"), problem, remedy),
        }
    }
}

/// Remedy for a file with inconsistent contents.
pub(super) const DAMAGED: &str = "the file is damaged: copy it again from its source";

/// Remedy for a file that ends too early.
pub(super) const CUT_OFF: &str = "the file is cut off: copy it again from its source";
