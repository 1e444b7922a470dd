//! Members of a group, in old and new forms.

use wavex_formats::Result;
use wavex_formats::bytes::Fields;

use super::fractal_heap::FractalHeap;
use super::input::{Address, COPY_AGAIN, Input, address, signature};
use super::object::{kind, messages};
use super::tree;

/// Name of a member, and the address of its object header.
pub type Link = (String, Address);

/// Lists the groups and data sets of a group.
///
/// Links to other paths and files are left out.
///
/// # Errors
/// If the object is no group, or its structure is damaged.
pub fn links(input: &Input, group: Address) -> Result<Vec<Link>> {
    input.next_object();
    let messages = messages(input, group)?;
    let mut found = Vec::new();
    for message in &messages {
        match message.kind {
            kind::SYMBOL_TABLE => symbol_table(input, &mut message.fields(input)?, &mut found)?,
            kind::LINK => found.extend(link(&mut message.fields(input)?)?),
            kind::LINK_INFO => dense_links(input, &mut message.fields(input)?, &mut found)?,
            _ => {}
        }
    }
    Ok(found)
}

/// Reads a link message; `None` if it does not point to an object of this file.
fn link(fields: &mut Fields) -> Result<Option<Link>> {
    let field = "link";
    fields.skip(1, field)?;
    let flags = fields.u8(field)?;
    let hard = flags & 8 == 0 || fields.u8(field)? == 0;
    fields.skip(if flags & 4 == 0 { 0 } else { 8 }, field)?;
    fields.skip(if flags & 16 == 0 { 0 } else { 1 }, field)?;
    let length = fields.uint(1 << (flags & 3), field)?;
    let length = usize::try_from(length).unwrap_or(usize::MAX);
    let name = fields.text(length, "name of a link")?;
    if !hard {
        return Ok(None);
    }
    Ok(Some((name, fields.u64(field)?)))
}

/// Reads links that are stored in a heap and listed by a B-tree.
fn dense_links(input: &Input, fields: &mut Fields, found: &mut Vec<Link>) -> Result<()> {
    let field = "link information";
    fields.skip(1, field)?;
    let flags = fields.u8(field)?;
    fields.skip(if flags & 1 == 0 { 0 } else { 8 }, field)?;
    let (heap, names) = (address(fields, field)?, address(fields, field)?);
    let (Some(heap), Some(names)) = (heap, names) else { return Ok(()) };
    let heap = FractalHeap::open(input, heap)?;
    tree::records(input, names, 5, &mut |record| {
        record.skip(4, "hash of a name")?;
        let (address, bytes) = heap.object(input, record)?;
        found.extend(link(&mut input.fields(address, &bytes))?);
        Ok(())
    })
}

/// Reads the links of a group of the old form.
fn symbol_table(input: &Input, fields: &mut Fields, found: &mut Vec<Link>) -> Result<()> {
    let (tree, heap) = (fields.u64("B-tree of a group")?, fields.u64("heap of a group")?);
    let field = "local heap";
    let head = input.metadata(heap, 32, field)?;
    let mut fields = input.fields(heap, &head);
    signature(&mut fields, b"HEAP", field)?;
    fields.skip(4, field)?;
    let size = fields.u64(field)?;
    fields.skip(8, field)?;
    let start = fields.u64(field)?;
    let names = input.metadata(start, size, field)?;
    tree::children(input, tree, 0, 8, &mut |_, node| symbols(input, node, &names, found))
}

/// Reads a node of symbols: its names are offsets in the local heap.
fn symbols(input: &Input, node: Address, names: &[u8], found: &mut Vec<Link>) -> Result<()> {
    let field = "symbol table node";
    let head = input.metadata(node, 8, field)?;
    let mut fields = input.fields(node, &head);
    signature(&mut fields, b"SNOD", field)?;
    fields.skip(2, field)?;
    let count = u64::from(fields.u16(field)?);
    let bytes = input.metadata(node + 8, count * 40, field)?;
    let mut fields = input.fields(node + 8, &bytes);
    for _ in 0..count {
        let before = fields.clone();
        let offset = usize::try_from(fields.u64("name of a member")?).unwrap_or(usize::MAX);
        let name = names.get(offset..).and_then(|name| name.split(|&byte| byte == 0).next());
        let Some(name) = name else {
            return Err(before.bad("name of a member", "beyond the end of the heap", COPY_AGAIN));
        };
        let header = address(&mut fields, "address of a member")?;
        let symbolic_link = fields.u32("cache type of a member")? == 2;
        fields.skip(20, field)?;
        if let Some(header) = header.filter(|_| !symbolic_link) {
            found.push((String::from_utf8_lossy(name).into_owned(), header));
        }
    }
    Ok(())
}
