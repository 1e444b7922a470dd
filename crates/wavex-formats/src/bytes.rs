//! Cursor over the fields of a binary record.
//!
//! Errors name the field.

use std::path::Path;

use super::{Error, Result};

/// Cursor over the little-endian fields of a record.
///
/// The record is at byte `base` of `file`.
#[derive(Clone)]
pub struct Fields<'a> {
    file: &'a Path,
    base: u64,
    bytes: &'a [u8],
    at: usize,
}

macro_rules! number {
    ($name:ident, $kind:ty) => {
        #[doc = concat!("Reads the next field as a little-endian `", stringify!($kind), "`.")]
        pub fn $name(&mut self, field: &str) -> Result<$kind> {
            Ok(<$kind>::from_le_bytes(self.array(field)?))
        }
    };
}

impl<'a> Fields<'a> {
    /// Starts at the first byte of `bytes`.
    ///
    /// They begin at byte `base` of `file`.
    pub fn new(file: &'a Path, base: u64, bytes: &'a [u8]) -> Fields<'a> {
        Fields { file, base, bytes, at: 0 }
    }

    /// Returns the file offset of the next field.
    pub fn offset(&self) -> u64 {
        self.base + self.at as u64
    }

    /// Returns the number of bytes left.
    pub fn left(&self) -> usize {
        self.bytes.len() - self.at
    }

    /// Reads `n` bytes.
    pub fn take(&mut self, n: usize, field: &str) -> Result<&'a [u8]> {
        match self.bytes.get(self.at..).and_then(|rest| rest.get(..n)) {
            Some(bytes) => {
                self.at += n;
                Ok(bytes)
            }
            None => Err(self.bad(
                field,
                format!("{n} bytes needed, {} left", self.left()),
                "the file is cut off: copy it again from its source",
            )),
        }
    }

    /// Skips `n` bytes.
    pub fn skip(&mut self, n: usize, field: &str) -> Result<()> {
        self.take(n, field).map(|_| ())
    }

    /// Reads `N` bytes as an array.
    pub fn array<const N: usize>(&mut self, field: &str) -> Result<[u8; N]> {
        let mut out = [0; N];
        out.copy_from_slice(self.take(N, field)?);
        Ok(out)
    }

    number!(u8, u8);
    number!(u16, u16);
    number!(i16, i16);
    number!(u32, u32);
    number!(i32, i32);
    number!(u64, u64);
    number!(i64, i64);
    number!(f32, f32);
    number!(f64, f64);

    /// Reads an unsigned integer of `n` bytes, at most 8.
    pub fn uint(&mut self, n: usize, field: &str) -> Result<u64> {
        let bytes = self.take(n, field)?;
        Ok(bytes.iter().rev().fold(0, |value, &byte| value << 8 | u64::from(byte)))
    }

    /// Reads `n` bytes as text up to the first zero byte.
    ///
    /// Invalid UTF-8 is replaced.
    pub fn text(&mut self, n: usize, field: &str) -> Result<String> {
        let bytes = self.take(n, field)?;
        let end = bytes.iter().position(|&b| b == 0).unwrap_or(n);
        Ok(String::from_utf8_lossy(&bytes[..end]).into_owned())
    }

    /// Creates an error at the next field.
    pub fn bad(&self, field: &str, problem: impl Into<String>, remedy: impl Into<String>) -> Error {
        Error::malformed(self.file, self.offset(), field, problem, remedy)
    }
}

/// Encodes text of a fixed length, truncated or padded with zeros.
pub(crate) fn text<const N: usize>(text: &str) -> [u8; N] {
    let mut bytes = [0; N];
    bytes.iter_mut().zip(text.bytes()).for_each(|(to, byte)| *to = byte);
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_are_little_endian_and_in_order() {
        let bytes = [1, 2, 0, 0xff, 0xff, 0xff, 0xff, b'a', b'b', 0, b'c'];
        let mut fields = Fields::new(Path::new("f"), 100, &bytes);
        assert_eq!(fields.clone().uint(3, "three bytes").unwrap(), 0x00_0201);
        assert_eq!(fields.u8("one").unwrap(), 1);
        assert_eq!(fields.u16("two").unwrap(), 2);
        assert_eq!(fields.i32("minus one").unwrap(), -1);
        assert_eq!(fields.offset(), 107);
        assert_eq!(fields.text(4, "name").unwrap(), "ab");
        assert_eq!(fields.left(), 0);
    }

    #[test]
    fn a_field_past_the_end_names_file_byte_and_field() {
        let mut fields = Fields::new(Path::new("short.las"), 96, &[7]);
        let error = fields.u32("offset to point data").unwrap_err().to_string();
        assert_eq!(
            error,
            "short.las: byte 96: offset to point data: 4 bytes needed, 1 left; the file is cut \
             off: copy it again from its source"
        );
    }
}
