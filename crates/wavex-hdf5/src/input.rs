//! Access to the bytes of a file by address, with a limit of metadata.

use std::cell::Cell;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use wavex_formats::bytes::Fields;
use wavex_formats::{Error, Result, regular_file};

/// Advice for files whose structure is damaged.
pub const COPY_AGAIN: &str = "the file is damaged: copy it again from its source";

/// Advice for sound files that use features of HDF5 which are not supported.
pub const REPACK: &str = "rewrite the file with `h5repack -f GZIP=4`";

/// Most bytes of metadata of one object.
///
/// A data set of a granule with a million shots has a chunk index of 4 MB. References in a circle, or many
/// references to the same node, reach the limit.
const METADATA_BYTES: u64 = 64 << 20;

/// Address of a block of the file, relative to its superblock.
pub type Address = u64;

/// An open HDF5 file.
pub struct Input {
    path: PathBuf,
    file: File,
    length: u64,
    base: u64,
    metadata_left: Cell<u64>,
}

impl Input {
    /// Opens a file; its superblock is assumed at byte 0.
    ///
    /// # Errors
    /// If it is no regular file, or the system refuses.
    pub fn open(path: &Path) -> Result<Input> {
        let file = regular_file(path)?;
        let length = file.metadata().map_err(Error::io(path, "open"))?.len();
        let metadata_left = Cell::new(0);
        Ok(Input { path: path.to_owned(), file, length, base: 0, metadata_left })
    }

    /// Moves address 0 to this byte: the position of the superblock.
    pub fn set_base(&mut self, base: u64) {
        self.base = base;
    }

    /// Returns the path of the file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the number of bytes of the file.
    pub fn length(&self) -> u64 {
        self.length
    }

    /// Starts the metadata of another object, with its own limit.
    pub fn next_object(&self) {
        self.metadata_left.set(METADATA_BYTES.min(self.length));
    }

    /// Checks that a block lies within the file; returns its first byte.
    ///
    /// # Errors
    /// If it does not.
    pub fn check(&self, address: Address, length: u64, field: &str) -> Result<u64> {
        let start = self
            .base
            .checked_add(address)
            .filter(|start| start.checked_add(length).is_some_and(|end| end <= self.length));
        start.ok_or_else(|| {
            let problem = format!(
                "{length} bytes at this address are beyond the end of the file, {} bytes",
                self.length
            );
            self.bad(address, field, problem, COPY_AGAIN)
        })
    }

    /// Reads stored data into a buffer.
    ///
    /// # Errors
    /// If they do not lie within the file, or the system reports an error.
    pub fn read(&self, address: Address, buffer: &mut [u8], field: &str) -> Result<()> {
        let start = self.check(address, buffer.len() as u64, field)?;
        let mut file = &self.file;
        let read = file.seek(SeekFrom::Start(start)).and_then(|_| file.read_exact(buffer));
        read.map_err(Error::io(&self.path, "read"))
    }

    /// Reads a block of metadata.
    ///
    /// # Errors
    /// As [`Input::read`], and beyond the limit of metadata of one object.
    pub fn metadata(&self, address: Address, length: u64, field: &str) -> Result<Vec<u8>> {
        self.check(address, length, field)?;
        match self.metadata_left.get().checked_sub(length) {
            Some(left) => self.metadata_left.set(left),
            None => {
                let problem = "more metadata than an object can have: references form a circle";
                return Err(self.bad(address, field, problem, COPY_AGAIN));
            }
        }
        let mut bytes = Vec::new();
        self.resize(&mut bytes, length as usize)?;
        self.read(address, &mut bytes, field)?;
        Ok(bytes)
    }

    /// Changes the length of a buffer to a checked one; new bytes are zero.
    ///
    /// # Errors
    /// If there is not enough memory.
    pub fn resize(&self, bytes: &mut Vec<u8>, length: usize) -> Result<()> {
        resize(bytes, length).map_err(Error::io(&self.path, "read"))
    }

    /// Starts reading the fields of a block of metadata.
    pub fn fields<'a>(&'a self, address: Address, bytes: &'a [u8]) -> Fields<'a> {
        Fields::new(&self.path, self.base.saturating_add(address), bytes)
    }

    /// Creates an error about a field at an address.
    pub fn bad(&self, address: Address, field: &str, problem: impl Into<String>, remedy: &str) -> Error {
        Error::malformed(&self.path, self.base.saturating_add(address), field, problem, remedy)
    }
}

/// Changes the length of a buffer; new bytes are zero.
///
/// # Errors
/// If there is not enough memory.
pub fn resize(bytes: &mut Vec<u8>, length: usize) -> io::Result<()> {
    let further = length.saturating_sub(bytes.len());
    bytes.try_reserve_exact(further).map_err(|_| io::ErrorKind::OutOfMemory)?;
    bytes.resize(length, 0);
    Ok(())
}

/// Reads an address; `None` if it is undefined.
///
/// # Errors
/// If the block ends before.
pub fn address(fields: &mut Fields, field: &str) -> Result<Option<Address>> {
    Ok(Some(fields.u64(field)?).filter(|&address| address != u64::MAX))
}

/// Reads and checks the signature of a block.
///
/// # Errors
/// If it is another one.
pub fn signature(fields: &mut Fields, expected: &[u8; 4], field: &str) -> Result<()> {
    let before = fields.clone();
    if fields.take(4, field)? == expected {
        return Ok(());
    }
    let name = String::from_utf8_lossy(expected);
    Err(before.bad(field, format!("the signature `{name}` is missing"), COPY_AGAIN))
}

/// Adds the name of a data set or group to an error.
pub fn within(name: &str) -> impl Fn(Error) -> Error + '_ {
    move |error| match error {
        Error::Malformed { file, offset, field, problem, remedy } => {
            Error::Malformed { file, offset, field: format!("{name}: {field}"), problem, remedy }
        }
        error => error,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missing_memory_is_an_error() {
        let input = Input::open(&Path::new(env!("CARGO_MANIFEST_DIR")).join("Cargo.toml")).unwrap();
        let error = input.resize(&mut Vec::new(), usize::MAX).unwrap_err().to_string();
        assert!(error.contains("Cargo.toml: cannot read: out of memory; end other programs"), "{error}");
    }

    #[test]
    fn addresses_that_overflow_are_beyond_the_end() {
        let mut input = Input::open(&Path::new(env!("CARGO_MANIFEST_DIR")).join("Cargo.toml")).unwrap();
        input.set_base(512);
        for (address, length) in [(u64::MAX - 100, 16), (0, u64::MAX), (input.length() - 512, 1)] {
            let error = input.check(address, length, "block").unwrap_err().to_string();
            assert!(error.contains("block: ") && error.contains("beyond the end of the file"), "{error}");
        }
        assert_eq!(input.check(8, input.length() - 520, "block").unwrap(), 520);
    }
}
