//! Types of stored numbers, and their conversion.

use wavex_formats::Result;
use wavex_formats::bytes::Fields;

use super::input::REPACK;

/// Kind of a number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kind {
    Unsigned,
    Signed,
    Float,
}

/// Type of a stored number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Number {
    /// Kind of the number.
    pub kind: Kind,
    /// Size, 1, 2, 4 or 8 bytes; floats have 4 or 8.
    pub bytes: usize,
    /// Whether the most significant byte is first.
    pub big_endian: bool,
}

/// Position and size of exponent and mantissa in bits, and the bias of the exponent.
const FLOAT_32: [u32; 5] = [23, 8, 0, 23, 127];
const FLOAT_64: [u32; 5] = [52, 11, 0, 52, 1023];

impl Number {
    /// Reads a data type message.
    ///
    /// # Errors
    /// If the type is no integer or IEEE float of a usual size.
    pub fn read(fields: &mut Fields) -> Result<Number> {
        let field = "data type";
        let before = fields.clone();
        let class = fields.u8(field)? & 15;
        let bits = fields.uint(3, field)?;
        let bytes = fields.u32(field)? as usize;
        let kind = match class {
            0 if bits & 8 == 0 => Kind::Unsigned,
            0 => Kind::Signed,
            1 => Kind::Float,
            _ => {
                let name = ["integer", "float", "time", "text", "bit field", "opaque", "compound"];
                let name = name.get(usize::from(class)).unwrap_or(&"another class");
                return Err(before.bad(field, format!("numbers expected, but this is {name}"), REPACK));
            }
        };
        let offset_and_precision = [fields.u16(field)?, fields.u16(field)?].map(usize::from);
        let usual = offset_and_precision == [0, bytes * 8]
            && match kind {
                Kind::Float => {
                    let mut parts = [0; 5];
                    for part in &mut parts[..4] {
                        *part = u32::from(fields.u8(field)?);
                    }
                    parts[4] = fields.u32(field)?;
                    let usual_order = bits & 0x40 == 0;
                    usual_order && [(4, FLOAT_32), (8, FLOAT_64)].contains(&(bytes, parts))
                }
                _ => matches!(bytes, 1 | 2 | 4 | 8),
            };
        if !usual {
            return Err(before.bad(field, format!("unusual number of {bytes} bytes"), REPACK));
        }
        Ok(Number { kind, bytes, big_endian: bits & 1 != 0 })
    }

    /// Converts a stored number; integers beyond 2^53 are rounded.
    pub fn to_f64(self, stored: &[u8]) -> f64 {
        let raw = self.raw(stored);
        match (self.kind, self.bytes) {
            (Kind::Unsigned, _) => raw as f64,
            (Kind::Signed, _) => self.signed(raw) as f64,
            (Kind::Float, 4) => f64::from(f32::from_bits(raw as u32)),
            (Kind::Float, _) => f64::from_bits(raw),
        }
    }

    /// Converts a stored number; `None` if it is negative or has a fraction.
    pub fn to_u64(self, stored: &[u8]) -> Option<u64> {
        let raw = self.raw(stored);
        match self.kind {
            Kind::Unsigned => Some(raw),
            Kind::Signed => u64::try_from(self.signed(raw)).ok(),
            Kind::Float => {
                let value = self.to_f64(stored);
                // Whole numbers below 2^53 are exact in a float.
                let exact = (0.0..9_007_199_254_740_992.0).contains(&value) && value.fract() == 0.0;
                exact.then_some(value as u64)
            }
        }
    }

    /// Converts stored samples and appends them; `f64` and integers beyond 2^24 are rounded.
    pub fn append_f32(self, stored: &[u8], samples: &mut Vec<f32>) {
        fn each<const N: usize>(stored: &[u8], samples: &mut Vec<f32>, convert: impl Fn([u8; N]) -> f32) {
            let (numbers, _) = stored.as_chunks();
            samples.extend(numbers.iter().map(|&number| convert(number)));
        }
        match (self.kind, self.bytes, self.big_endian) {
            (Kind::Float, 4, false) => each(stored, samples, f32::from_le_bytes),
            (Kind::Float, 4, true) => each(stored, samples, f32::from_be_bytes),
            (Kind::Unsigned, 2, false) => each(stored, samples, |n| f32::from(u16::from_le_bytes(n))),
            (Kind::Signed, 2, false) => each(stored, samples, |n| f32::from(i16::from_le_bytes(n))),
            (Kind::Unsigned, 2, true) => each(stored, samples, |n| f32::from(u16::from_be_bytes(n))),
            (Kind::Signed, 2, true) => each(stored, samples, |n| f32::from(i16::from_be_bytes(n))),
            _ => samples.extend(stored.chunks_exact(self.bytes).map(|number| self.to_f64(number) as f32)),
        }
    }

    /// Returns the bits of a stored number.
    fn raw(self, stored: &[u8]) -> u64 {
        let shift = |value, &byte: &u8| value << 8 | u64::from(byte);
        match self.big_endian {
            true => stored.iter().fold(0, shift),
            false => stored.iter().rev().fold(0, shift),
        }
    }

    /// Extends the sign of a stored number.
    fn signed(self, raw: u64) -> i64 {
        let unused_bits = 64 - 8 * self.bytes as u32;
        (raw << unused_bits) as i64 >> unused_bits
    }
}
