//! Extra attributes after the standard fields of a point.
//!
//! LAS 1.4 R15, section "Extra Bytes".

use std::path::Path;

use wavex_simd::quantise::Steps;

use super::round::nearest;
use super::vlr::Vlr;
use crate::Result;
use crate::bytes::Fields;

/// Length of an attribute's descriptor, bytes.
pub(super) const DESCRIPTOR: usize = 192;
const HAS_NO_DATA: u8 = 1;
const HAS_MIN: u8 = 1 << 1;
const HAS_MAX: u8 = 1 << 2;
const HAS_SCALE: u8 = 1 << 3;
const HAS_OFFSET: u8 = 1 << 4;

/// Types of written attributes, with their codes in the specification.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum DataType {
    /// Unsigned, one byte.
    U8 = 1,
    /// Signed, one byte.
    I8 = 2,
    /// Unsigned, two bytes.
    U16 = 3,
    /// Signed, two bytes.
    I16 = 4,
    /// Unsigned, four bytes.
    U32 = 5,
    /// Signed, four bytes.
    I32 = 6,
    /// Single-precision number, rounded to 8 significant bits (0.2 %).
    ///
    /// Its two lower bytes are 0, which LAZ stores for nothing.
    F32 = 9,
}

impl DataType {
    /// Returns the length of a value, bytes.
    pub const fn bytes(self) -> usize {
        match self {
            DataType::U8 | DataType::I8 => 1,
            DataType::U16 | DataType::I16 => 2,
            DataType::U32 | DataType::I32 | DataType::F32 => 4,
        }
    }

    /// Returns the smallest and largest stored integer; of [`DataType::F32`], of its bits.
    const fn range(self) -> (i64, i64) {
        match self {
            DataType::U8 => (0, u8::MAX as i64),
            DataType::I8 => (i8::MIN as i64, i8::MAX as i64),
            DataType::U16 => (0, u16::MAX as i64),
            DataType::I16 => (i16::MIN as i64, i16::MAX as i64),
            DataType::U32 | DataType::F32 => (0, u32::MAX as i64),
            DataType::I32 => (i32::MIN as i64, i32::MAX as i64),
        }
    }
}

/// Extra attribute for output.
///
/// Value = stored integer * scale + offset; a [`DataType::F32`] is the value itself.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ExtraAttribute {
    /// Unique name, at most 32 bytes.
    pub name: &'static str,
    /// Quantity and unit, at most 32 bytes.
    pub description: &'static str,
    /// Type of the stored number.
    pub data_type: DataType,
    /// Step size; `None` means 1, not declared in the file.
    pub scale: Option<f64>,
    /// Value of a stored 0.
    ///
    /// `None` means 0, not declared in the file.
    pub offset: Option<f64>,
    /// Stored integer for NaN, within the range of the type.
    ///
    /// A [`DataType::F32`] stores NaN.
    pub nan: i64,
    /// Whether the file declares [`ExtraAttribute::nan`] as its no-data value.
    pub nan_is_no_data: bool,
    /// Smallest and largest valid stored number, declared in the file; values are clamped to them.
    pub limits: Option<(f64, f64)>,
}

/// Quantises a value to the nearest step.
///
/// Clamped to the limits, or to the range of the type. NaN becomes [`ExtraAttribute::nan`]. For
/// [`DataType::F32`], returns the bits of the rounded number.
pub fn quantise(value: f64, attribute: &ExtraAttribute) -> i64 {
    if attribute.data_type == DataType::F32 {
        return rounded_bits(attribute.limits.map_or(value, |(least, largest)| value.clamp(least, largest)));
    }
    let (least, largest) = attribute.bounds();
    if value.is_nan() {
        return attribute.stored_nan();
    }
    let steps = (value - attribute.offset.unwrap_or(0.0)) / attribute.scale.unwrap_or(1.0);
    nearest(steps).clamp(least, largest)
}

/// Returns the bits of the nearest single-precision number with 8 significant bits.
fn rounded_bits(value: f64) -> i64 {
    const HALF: u32 = 1 << 15;
    if value.is_nan() {
        return f32::NAN.to_bits().into();
    }
    let bits = (value as f32).clamp(-MOST, MOST).to_bits();
    ((bits + HALF) & !(2 * HALF - 1)).into()
}

/// Largest number of 8 significant bits in single precision.
const MOST: f32 = f32::from_bits(0x7f7f_0000);

impl ExtraAttribute {
    /// Returns the smallest and largest stored integer.
    fn bounds(&self) -> (i64, i64) {
        self.limits.map_or(self.data_type.range(), |(least, largest)| (least as i64, largest as i64))
    }

    /// Returns the stored integer for NaN.
    fn stored_nan(&self) -> i64 {
        let (least, largest) = self.data_type.range();
        self.nan.clamp(least, largest)
    }

    /// Encodes a stored number as in descriptors: as a double, or an integer of 8 bytes.
    fn wide(&self, number: f64) -> [u8; 8] {
        match self.data_type {
            DataType::F32 => number.to_le_bytes(),
            _ => (number as i64).to_le_bytes(),
        }
    }

    /// Appends the stored bytes of `value` to a point's extra bytes.
    pub fn push(&self, value: f64, extra: &mut Vec<u8>) {
        let bytes = quantise(value, self).to_le_bytes();
        extra.extend_from_slice(&bytes[..self.data_type.bytes()]);
    }

    /// Quantises a column of values like [`quantise`].
    ///
    /// Stops at the end of the shorter slice. Numbers beyond `i32` are stored as their bits.
    pub(super) fn quantise_column(&self, values: &[f64], stored: &mut [i32]) {
        let (least, largest) = self.bounds();
        let is_integer = self.data_type != DataType::F32;
        let (Ok(least), Ok(largest), true) = (i32::try_from(least), i32::try_from(largest), is_integer)
        else {
            for (stored, value) in stored.iter_mut().zip(values) {
                *stored = quantise(*value, self) as i32;
            }
            return;
        };
        // The cast is lossless: the range of this type fits 32 bits.
        let nan = quantise(f64::NAN, self) as i32;
        let (offset, scale) = (self.offset.unwrap_or(0.0), self.scale.unwrap_or(1.0));
        Steps { offset, scale, least, largest, nan }.count(values, stored);
    }

    /// Encodes the attribute's descriptor for the Extra Bytes record.
    pub(super) fn descriptor(&self) -> [u8; DESCRIPTOR] {
        let mut out = [0; DESCRIPTOR];
        let mut put = |at: usize, bytes: &[u8]| out[at..at + bytes.len()].copy_from_slice(bytes);
        let text = |text: &'static str| &text.as_bytes()[..text.len().min(32)];
        let bit = |set: bool, bit: u8| if set { bit } else { 0 };
        let options = bit(self.nan_is_no_data, HAS_NO_DATA)
            | bit(self.limits.is_some(), HAS_MIN | HAS_MAX)
            | bit(self.scale.is_some(), HAS_SCALE)
            | bit(self.offset.is_some(), HAS_OFFSET);
        put(2, &[self.data_type as u8, options]);
        put(4, text(self.name));
        if self.nan_is_no_data {
            let nan = if self.data_type == DataType::F32 { f64::NAN } else { self.stored_nan() as f64 };
            put(40, &self.wide(nan));
        }
        if let Some((least, largest)) = self.limits {
            put(64, &self.wide(least));
            put(88, &self.wide(largest));
        }
        put(112, &self.scale.unwrap_or(0.0).to_le_bytes());
        put(136, &self.offset.unwrap_or(0.0).to_le_bytes());
        put(160, text(self.description));
        out
    }
}

/// Attribute declared by a file.
#[derive(Debug, Clone, PartialEq)]
pub struct ExtraBytes {
    /// Unique name.
    pub name: String,
    /// Free text.
    pub description: String,
    /// Type code.
    ///
    /// 1 to 10 are `u8`, `i8`, `u16`, ... `i64`, `f32`, `f64`; 0 is undocumented bytes.
    pub data_type: u8,
    /// Offset of the value in the extra bytes of a point.
    pub start: usize,
    /// Length of the value, bytes.
    pub bytes: usize,
    /// Step size.
    pub scale: Option<f64>,
    /// Value of a stored 0.
    pub offset: Option<f64>,
    /// Stored no-data value.
    ///
    /// 8 bytes, an integer or an `f64` according to the type.
    pub no_data: Option<[u8; 8]>,
}

impl ExtraBytes {
    /// Returns the value in the extra bytes of a point.
    ///
    /// NaN without data, and for undocumented bytes, pairs and triples.
    pub fn value(&self, extra: &[u8]) -> f64 {
        let stored = self.start.checked_add(self.bytes).and_then(|end| extra.get(self.start..end));
        let Some(stored) = stored.filter(|stored| stored.len() <= 8) else { return f64::NAN };
        let mut wide = [0; 8];
        wide.iter_mut().zip(stored).for_each(|(to, from)| *to = *from);
        let unsigned = u64::from_le_bytes(wide);
        let unused_bits = 64 - 8 * self.bytes as u32;
        // Sign-extends the number to eight bytes, as the no-data value has.
        let signed = unsigned.checked_shl(unused_bits).map_or(0, |shifted| shifted as i64 >> unused_bits);
        let (number, in_eight_bytes) = match self.data_type {
            1 | 3 | 5 | 7 => (unsigned as f64, unsigned),
            2 | 4 | 6 | 8 => (signed as f64, signed as u64),
            9 => {
                let number = f64::from(f32::from_bits(unsigned as u32));
                (number, number.to_bits())
            }
            10 => (f64::from_bits(unsigned), unsigned),
            _ => return f64::NAN,
        };
        if self.no_data.map(u64::from_le_bytes) == Some(in_eight_bytes) {
            return f64::NAN;
        }
        number * self.scale.unwrap_or(1.0) + self.offset.unwrap_or(0.0)
    }
}

/// Parses the attributes of record `vlr`.
///
/// Stops at the first of unknown length.
pub(super) fn parse(file: &Path, vlr: &Vlr) -> Result<Vec<ExtraBytes>> {
    let mut attributes = Vec::new();
    let mut start = 0;
    for (number, bytes) in vlr.data.chunks_exact(DESCRIPTOR).enumerate() {
        let mut fields = Fields::new(file, vlr.offset + (number * DESCRIPTOR) as u64, bytes);
        let Some(attribute) = parse_one(&mut fields, start)? else { break };
        start += attribute.bytes;
        attributes.push(attribute);
    }
    Ok(attributes)
}

fn parse_one(fields: &mut Fields, start: usize) -> Result<Option<ExtraBytes>> {
    fields.skip(2, "reserved")?;
    let (data_type, options) = (fields.u8("data type")?, fields.u8("options")?);
    let Some(bytes) = length(data_type, options) else { return Ok(None) };
    let name = fields.text(32, "name")?;
    fields.skip(4, "unused")?;
    let no_data = fields.array("no data")?;
    fields.skip(16 + 24 + 24, "minimum and maximum")?;
    let scale = fields.f64("scale")?;
    fields.skip(16, "deprecated")?;
    let offset = fields.f64("offset")?;
    fields.skip(16, "deprecated")?;
    let description = fields.text(32, "description")?;
    let has = |bit| data_type != 0 && options & bit != 0;
    Ok(Some(ExtraBytes {
        name,
        description,
        data_type,
        start,
        bytes,
        scale: has(HAS_SCALE).then_some(scale),
        offset: has(HAS_OFFSET).then_some(offset),
        no_data: has(HAS_NO_DATA).then_some(no_data),
    }))
}

/// Returns the length of a type.
///
/// Deprecated types 11 to 30 are pairs and triples of 1 to 10.
fn length(data_type: u8, options: u8) -> Option<usize> {
    const SIZES: [usize; 10] = [1, 1, 2, 2, 4, 4, 8, 8, 4, 8];
    match data_type {
        0 => Some(options.into()),
        1..=30 => {
            let index = usize::from(data_type) - 1;
            SIZES.get(index % 10).map(|size| size * (index / 10 + 1))
        }
        _ => None,
    }
}

#[cfg(test)]
pub(super) mod tests;
