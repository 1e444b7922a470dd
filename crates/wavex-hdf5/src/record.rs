//! Records with named members: the compound types of HDF5.

use wavex_formats::Result;
use wavex_formats::bytes::Fields;

use super::dataset::{ElementType, Elements};
use super::input::{COPY_AGAIN, REPACK};
use super::number::Number;

/// A data set of records.
pub type Records = Elements<Record>;

/// Most bytes of a record.
const MOST_BYTES: usize = 65_536;

/// Type of a record.
pub struct Record {
    bytes: usize,
    members: Vec<(String, Member)>,
}

/// Number in a record.
#[derive(Clone, Copy)]
pub struct Member {
    /// First byte in the record.
    offset: usize,
    /// Type of the number.
    pub number: Number,
}

impl Record {
    /// Returns the member with this name.
    pub fn member(&self, name: &str) -> Option<Member> {
        self.members.iter().find(|(member, _)| member == name).map(|&(_, member)| member)
    }
}

impl Member {
    /// Returns the bytes of the number in a record of its type.
    pub fn of(self, record: &[u8]) -> &[u8] {
        record.get(self.offset..self.offset + self.number.bytes).unwrap_or_default()
    }
}

impl ElementType for Record {
    fn read(fields: &mut Fields) -> Result<Record> {
        let field = "data type";
        let before = fields.clone();
        let class_and_version = fields.u8(field)?;
        let (class, version) = (class_and_version & 15, class_and_version >> 4);
        let count = fields.uint(3, field)? & 0xffff;
        let bytes = fields.u32(field)? as usize;
        // Versions 4 and 5 store records as version 3.
        if class != 6 || !(1..=5).contains(&version) {
            return Err(before.bad(field, "records with named members expected", REPACK));
        }
        if !(1..=MOST_BYTES).contains(&bytes) {
            return Err(before.bad(field, format!("{bytes} bytes in a record"), COPY_AGAIN));
        }
        let mut members = Vec::new();
        for _ in 0..count {
            let before = fields.clone();
            let name = name(fields, version)?;
            let offset = match version {
                // As many bytes as the size of the record needs.
                3.. => fields.uint(bytes.ilog2() as usize / 8 + 1, field)? as usize,
                _ => fields.u32(field)? as usize,
            };
            // Number and sizes of dimensions, which later versions store as another type.
            if version == 1 {
                let dimensions = fields.u8(field)?;
                fields.skip(27, field)?;
                if dimensions != 0 {
                    return Err(before.bad(field, format!("member {name} is an array"), REPACK));
                }
            }
            let number = Number::read(fields)?;
            if offset + number.bytes > bytes {
                return Err(before.bad(field, format!("member {name} is outside of its record"), COPY_AGAIN));
            }
            members.push((name, Member { offset, number }));
        }
        Ok(Record { bytes, members })
    }

    fn bytes(&self) -> usize {
        self.bytes
    }
}

/// Reads the name of a member, which ends in a zero byte; before version 3, padded to a multiple of 8 bytes.
fn name(fields: &mut Fields, version: u8) -> Result<String> {
    let field = "name of a member";
    let mut name = Vec::new();
    loop {
        match fields.u8(field)? {
            0 => break,
            byte => name.push(byte),
        }
    }
    let stored = name.len() + 1;
    fields.skip(if version < 3 { stored.next_multiple_of(8) - stored } else { 0 }, field)?;
    Ok(String::from_utf8_lossy(&name).into_owned())
}
