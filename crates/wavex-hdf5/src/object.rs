//! Object headers: the messages that describe a group or data set.

use wavex_formats::Result;
use wavex_formats::bytes::Fields;

use super::input::{Address, COPY_AGAIN, Input, REPACK, signature};

/// Kinds of messages that are read.
pub mod kind {
    pub const DATASPACE: u16 = 0x01;
    pub const LINK_INFO: u16 = 0x02;
    pub const DATATYPE: u16 = 0x03;
    pub const FILL_VALUE: u16 = 0x05;
    pub const LINK: u16 = 0x06;
    pub const EXTERNAL_FILES: u16 = 0x07;
    pub const LAYOUT: u16 = 0x08;
    pub const FILTERS: u16 = 0x0b;
    pub const ATTRIBUTE: u16 = 0x0c;
    pub const CONTINUATION: u16 = 0x10;
    pub const SYMBOL_TABLE: u16 = 0x11;
    pub const ATTRIBUTE_INFO: u16 = 0x15;
}

/// Most messages of one object; each link of a small group is one.
const MOST_MESSAGES: usize = 65_536;

/// The content is in another object, for example a committed data type.
const SHARED: u8 = 2;

/// One message of an object header.
pub struct Message {
    /// Kind of message; see [`kind`].
    pub kind: u16,
    flags: u8,
    address: Address,
    data: Vec<u8>,
}

impl Message {
    /// Starts reading the fields.
    ///
    /// # Errors
    /// If the content is shared with other objects, which is not supported.
    pub fn fields<'a>(&'a self, input: &'a Input) -> Result<Fields<'a>> {
        if self.flags & SHARED != 0 {
            return Err(input.bad(self.address, "message", "shared between objects", REPACK));
        }
        Ok(input.fields(self.address, &self.data))
    }
}

/// Reads all messages of the object at an address.
///
/// # Errors
/// If the address has no object, the object's blocks form a circle, or it has too many messages.
pub fn messages(input: &Input, address: Address) -> Result<Vec<Message>> {
    let field = "object header";
    let start = input.metadata(address, 16, field)?;
    let mut fields = input.fields(address, &start);
    let mut found = Vec::new();
    let (mut blocks, format) = if start.starts_with(b"OHDR") {
        fields.skip(4, field)?;
        if fields.u8(field)? != 2 {
            return Err(fields.bad(field, "unknown version", COPY_AGAIN));
        }
        let flags = fields.u8(field)?;
        let times = if flags & 0x20 == 0 { 0 } else { 16 };
        let limits = if flags & 0x10 == 0 { 0 } else { 4 };
        let size_bytes = 1_u64 << (flags & 3);
        let size_at = address + 6 + times + limits;
        let bytes = input.metadata(size_at, size_bytes, field)?;
        let length = input.fields(size_at, &bytes).uint(bytes.len(), field)?;
        (vec![(size_at + size_bytes, length)], Format::Two { with_order: flags & 4 != 0 })
    } else if start[0] == 1 {
        fields.skip(8, field)?;
        (vec![(address + 16, u64::from(fields.u32("size of the object header")?))], Format::One)
    } else {
        return Err(fields.bad(field, "neither version 1 nor 2", COPY_AGAIN));
    };
    while let Some((address, length)) = blocks.pop() {
        let bytes = input.metadata(address, length, field)?;
        let mut fields = input.fields(address, &bytes);
        if !found.is_empty() && matches!(format, Format::Two { .. }) {
            signature(&mut fields, b"OCHK", field)?;
        }
        while let Some(message) = format.next(&mut fields, address, length)? {
            if message.kind == kind::CONTINUATION {
                let mut fields = message.fields(input)?;
                let next = fields.u64("address of the continuation")?;
                let mut length = fields.u64("length of the continuation")?;
                if matches!(format, Format::Two { .. }) {
                    length = length.saturating_sub(4);
                }
                blocks.push((next, length));
            }
            if found.len() == MOST_MESSAGES {
                let problem = format!("more than {MOST_MESSAGES} messages");
                return Err(input.bad(address, field, problem, COPY_AGAIN));
            }
            found.push(message);
        }
    }
    Ok(found)
}

/// Layout of the messages of an object header.
#[derive(Clone, Copy)]
enum Format {
    One,
    Two { with_order: bool },
}

impl Format {
    /// Reads the next message of a block; `None` at its end, or before a gap.
    fn next(self, fields: &mut Fields, address: Address, length: u64) -> Result<Option<Message>> {
        let field = "message of an object header";
        let head_bytes = match self {
            Format::One => 8,
            Format::Two { with_order } => 4 + 2 * usize::from(with_order),
        };
        if fields.left() < head_bytes {
            return Ok(None);
        }
        let (kind, size, flags);
        match self {
            Format::One => {
                kind = fields.u16(field)?;
                size = fields.u16(field)?;
                flags = fields.u8(field)?;
                fields.skip(3, field)?;
            }
            Format::Two { with_order } => {
                kind = u16::from(fields.u8(field)?);
                size = fields.u16(field)?;
                flags = fields.u8(field)?;
                fields.skip(2 * usize::from(with_order), field)?;
            }
        }
        let address = address + length - fields.left() as u64;
        let data = fields.take(usize::from(size), field)?.to_vec();
        Ok(Some(Message { kind, flags, address, data }))
    }
}
