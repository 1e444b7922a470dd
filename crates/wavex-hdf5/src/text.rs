//! Text of fixed and of variable length.

use wavex_formats::Result;
use wavex_formats::bytes::Fields;

use super::dataset::{ElementType, Elements};
use super::filters::Decoder;
use super::input::{COPY_AGAIN, Input, REPACK, signature};

/// A data set of text.
pub type Texts = Elements<Text>;

/// Most bytes of a text; descriptions of coordinate systems have a few thousand.
const MOST_BYTES: u64 = 1 << 20;
/// Most bytes of the collection of objects that contains a text.
const MOST_COLLECTION_BYTES: u64 = 16 << 20;

/// Type of a text.
#[derive(Clone, Copy)]
pub struct Text {
    bytes: usize,
    is_variable: bool,
}

impl ElementType for Text {
    fn read(fields: &mut Fields) -> Result<Text> {
        let field = "data type";
        let before = fields.clone();
        let class = fields.u8(field)? & 15;
        let kind = fields.uint(3, field)? & 15;
        let bytes = fields.u32(field)?;
        let is_variable = class == 9 && kind == 1;
        if !(is_variable && bytes == 16 || class == 3) {
            return Err(before.bad(field, "text expected", REPACK));
        }
        if !(1..=MOST_BYTES).contains(&u64::from(bytes)) {
            return Err(before.bad(field, format!("{bytes} bytes of text"), COPY_AGAIN));
        }
        Ok(Text { bytes: bytes as usize, is_variable })
    }

    fn bytes(&self) -> usize {
        self.bytes
    }
}

impl Text {
    /// Converts a stored text; zeros and blanks at its end are removed.
    ///
    /// # Errors
    /// If its block in the file is damaged.
    pub fn decode(self, input: &Input, stored: &[u8]) -> Result<String> {
        let object = match self.is_variable {
            true => object(input, &mut input.fields(0, stored))?,
            false => stored.to_vec(),
        };
        let text = String::from_utf8_lossy(&object);
        Ok(text.trim_end_matches(['\0', ' ']).to_owned())
    }
}

impl Texts {
    /// Reads the first text.
    ///
    /// # Errors
    /// If there is no text, or its block in the file is damaged.
    pub fn first(&mut self, input: &Input, decoder: &mut Decoder) -> Result<String> {
        let text = *self.element();
        text.decode(input, self.bytes_at(input, decoder, 0)?)
    }
}

/// Reads the object of a reference: length, address of a collection of objects, and number in it.
fn object(input: &Input, reference: &mut Fields) -> Result<Vec<u8>> {
    let field = "text";
    let length = u64::from(reference.u32(field)?);
    let at = reference.u64(field)?;
    let wanted = reference.u32(field)?;
    if length == 0 {
        return Ok(Vec::new());
    }
    input.next_object();
    let field = "collection of objects";
    let head = input.metadata(at, 16, field)?;
    let mut fields = input.fields(at, &head);
    signature(&mut fields, b"GCOL", field)?;
    fields.skip(4, field)?;
    let bytes = fields.u64(field)?;
    if length > MOST_BYTES || !(16..=MOST_COLLECTION_BYTES).contains(&bytes) {
        return Err(input.bad(at, field, format!("{length} bytes of text in {bytes}"), COPY_AGAIN));
    }
    let objects = input.metadata(at + 16, bytes - 16, field)?;
    let mut fields = input.fields(at + 16, &objects);
    while fields.left() >= 16 {
        let number = u32::from(fields.u16(field)?);
        fields.skip(6, field)?;
        let bytes = usize::try_from(fields.u64(field)?).unwrap_or(usize::MAX);
        // Number 0 is the free space at the end.
        if number == 0 {
            break;
        }
        let object = fields.take(bytes, field)?;
        if number == wanted {
            return Ok(object.get(..length as usize).unwrap_or(object).to_vec());
        }
        fields.skip((bytes.next_multiple_of(8) - bytes).min(fields.left()), field)?;
    }
    Err(input.bad(at, field, format!("it has no object {wanted}"), COPY_AGAIN))
}
