//! Attributes of groups and data sets.

use wavex_formats::Result;
use wavex_formats::bytes::Fields;

use super::dataset::ElementType;
use super::fractal_heap::FractalHeap;
use super::input::{Address, Input, REPACK, address};
use super::number::Number;
use super::object::{kind, messages};
use super::text::Text;
use super::tree;

/// Attributes of an object.
pub struct Attributes(Vec<Attribute>);

impl Attributes {
    /// Reads the attributes of the object at an address.
    ///
    /// # Errors
    /// If its structure is damaged.
    pub fn of(input: &Input, at: Address) -> Result<Attributes> {
        input.next_object();
        let mut found = Vec::new();
        for message in messages(input, at)? {
            match message.kind {
                kind::ATTRIBUTE => found.extend(attribute(&mut message.fields(input)?)?),
                kind::ATTRIBUTE_INFO => dense(input, &mut message.fields(input)?, &mut found)?,
                _ => {}
            }
        }
        Ok(Attributes(found))
    }

    fn find<T: ElementType>(&self, input: &Input, name: &str) -> Result<Option<(T, &[u8])>> {
        let Some(found) = self.0.iter().find(|attribute| attribute.name == name) else { return Ok(None) };
        let mut fields = Fields::new(input.path(), found.at, &found.data_type);
        let element = T::read(&mut fields)?;
        match found.data.get(..element.bytes()) {
            Some(data) => Ok(Some((element, data))),
            None => Err(fields.bad(&format!("attribute {name}"), "it has no value", REPACK)),
        }
    }

    /// Returns the first number of an attribute; `None` without it.
    ///
    /// # Errors
    /// If it is no number.
    pub fn number(&self, input: &Input, name: &str) -> Result<Option<f64>> {
        let found = self.find::<Number>(input, name)?;
        Ok(found.map(|(number, stored)| number.to_f64(stored)))
    }

    /// Returns the first text of an attribute; `None` without it.
    ///
    /// # Errors
    /// If it is no text, or in a block that is damaged.
    pub fn text(&self, input: &Input, name: &str) -> Result<Option<String>> {
        let found = self.find::<Text>(input, name)?;
        found.map(|(text, stored)| text.decode(input, stored)).transpose()
    }
}

/// An attribute; its value is decoded when it is asked for.
struct Attribute {
    name: String,
    at: Address,
    data_type: Vec<u8>,
    data: Vec<u8>,
}

/// Reads attributes that are stored in a heap and listed by a B-tree.
fn dense(input: &Input, fields: &mut Fields, found: &mut Vec<Attribute>) -> Result<()> {
    let field = "attribute information";
    fields.skip(1, field)?;
    let flags = fields.u8(field)?;
    fields.skip(if flags & 1 == 0 { 0 } else { 2 }, field)?;
    let (heap, names) = (address(fields, field)?, address(fields, field)?);
    let (Some(heap), Some(names)) = (heap, names) else { return Ok(()) };
    let heap = FractalHeap::open(input, heap)?;
    tree::records(input, names, 8, &mut |record| {
        let (address, bytes) = heap.object(input, record)?;
        found.extend(attribute(&mut input.fields(address, &bytes))?);
        Ok(())
    })
}

/// Reads an attribute message; `None` if its type is stored elsewhere.
fn attribute(fields: &mut Fields) -> Result<Option<Attribute>> {
    let field = "attribute";
    let at = fields.offset();
    let version = fields.u8(field)?;
    let flags = fields.u8(field)?;
    let [name_bytes, type_bytes, space_bytes] =
        [fields.u16(field)?, fields.u16(field)?, fields.u16(field)?].map(usize::from);
    fields.skip(usize::from(version == 3), field)?;
    let padding = |bytes: usize| if version == 1 { bytes.next_multiple_of(8) - bytes } else { 0 };
    let name = fields.text(name_bytes, field)?;
    fields.skip(padding(name_bytes), field)?;
    let data_type = fields.take(type_bytes, field)?.to_vec();
    fields.skip(padding(type_bytes), field)?;
    fields.skip(space_bytes + padding(space_bytes), field)?;
    let data = fields.take(fields.left(), field)?.to_vec();
    let is_shared = version > 1 && flags & 3 != 0;
    Ok((!is_shared).then_some(Attribute { name, at, data_type, data }))
}
