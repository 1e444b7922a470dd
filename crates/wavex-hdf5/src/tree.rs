//! B-trees of both versions, read in order.

use wavex_formats::Result;
use wavex_formats::bytes::Fields;

use super::input::{Address, COPY_AGAIN, Input, signature};

/// Visits the children of all leaves of a B-tree of version 1.
///
/// `visit` gets the key before a child, and its address. `node_type` is 0 for groups, 1 for chunks.
///
/// # Errors
/// If the tree is damaged, or `visit` fails.
pub fn children(
    input: &Input,
    root: Address,
    node_type: u8,
    key_bytes: usize,
    visit: &mut dyn FnMut(&mut Fields, Address) -> Result<()>,
) -> Result<()> {
    let field = "B-tree";
    let mut pending = vec![(root, None)];
    while let Some((node, expected_level)) = pending.pop() {
        let head = input.metadata(node, 24, field)?;
        let mut fields = input.fields(node, &head);
        signature(&mut fields, b"TREE", field)?;
        let (kind, level) = (fields.u8(field)?, fields.u8(field)?);
        if kind != node_type || expected_level.is_some_and(|expected| level != expected) {
            return Err(input.bad(node, field, "a node of another tree or level", COPY_AGAIN));
        }
        let count = usize::from(fields.u16(field)?);
        let bytes = input.metadata(node + 24, (count * (key_bytes + 8)) as u64, field)?;
        let mut fields = input.fields(node + 24, &bytes);
        let first = pending.len();
        for _ in 0..count {
            let at = fields.offset();
            let key = fields.take(key_bytes, field)?;
            let child = fields.u64(field)?;
            match level.checked_sub(1) {
                None => visit(&mut Fields::new(input.path(), at, key), child)?,
                Some(below) => pending.push((child, Some(below))),
            }
        }
        pending[first..].reverse();
    }
    Ok(())
}

/// Visits all records of a B-tree of version 2.
///
/// `record_type` is 5 for names of links, 8 for names of attributes, 10 and 11 for chunks.
///
/// # Errors
/// If the tree is damaged, or `visit` fails.
pub fn records(
    input: &Input,
    header: Address,
    record_type: u8,
    visit: &mut dyn FnMut(&mut Fields) -> Result<()>,
) -> Result<()> {
    let field = "B-tree";
    let bytes = input.metadata(header, 34, field)?;
    let mut fields = input.fields(header, &bytes);
    signature(&mut fields, b"BTHD", field)?;
    fields.skip(1, field)?;
    let found_type = fields.u8(field)?;
    let node_bytes = fields.u32("size of a node")?;
    let record_bytes = fields.u16("size of a record")?;
    let depth = fields.u16("depth of the tree")?;
    fields.skip(2, field)?;
    let root = fields.u64(field)?;
    let count = fields.u16("records of the root")?;
    if found_type != record_type || record_bytes == 0 || depth > 16 || node_bytes < 64 {
        return Err(input.bad(header, field, "unexpected type or sizes", COPY_AGAIN));
    }
    if count == 0 {
        return Ok(());
    }
    let shape =
        Shape { node_bytes, record_bytes, pointer_bytes: pointer_bytes(node_bytes, record_bytes, depth) };
    node(input, &shape, (root, u64::from(count), depth), visit)
}

struct Shape {
    node_bytes: u32,
    record_bytes: u16,
    /// Bytes of the two counts of a pointer, by the level of its node: records of the child, and of all below.
    pointer_bytes: Vec<[usize; 2]>,
}

/// Returns the bytes of the counts in pointers of nodes of each level.
fn pointer_bytes(node_bytes: u32, record_bytes: u16, depth: u16) -> Vec<[usize; 2]> {
    let (node, record) = (u64::from(node_bytes), u64::from(record_bytes));
    let most_in_leaf = node.saturating_sub(10) / record;
    let count_bytes = bytes_for(most_in_leaf);
    let mut sizes = vec![[0, 0]];
    let (mut most_below, mut total_bytes) = (most_in_leaf, 0);
    for _ in 0..depth {
        sizes.push([count_bytes, total_bytes]);
        let pointer = (8 + count_bytes + total_bytes) as u64;
        let most = node.saturating_sub(10 + pointer) / (record + pointer);
        most_below = (most + 1).saturating_mul(most_below).saturating_add(most);
        total_bytes = bytes_for(most_below);
    }
    sizes
}

/// Returns the bytes that store values up to `most`.
fn bytes_for(most: u64) -> usize {
    (most.max(1).ilog2() / 8 + 1) as usize
}

fn node(
    input: &Input,
    shape: &Shape,
    (at, count, level): (Address, u64, u16),
    visit: &mut dyn FnMut(&mut Fields) -> Result<()>,
) -> Result<()> {
    let field = "node of a B-tree";
    let record_bytes = u64::from(shape.record_bytes);
    let [count_bytes, total_bytes] = shape.pointer_bytes[usize::from(level)];
    let pointers = if level == 0 { 0 } else { (count + 1) * (8 + count_bytes + total_bytes) as u64 };
    let length = 6 + count * record_bytes + pointers;
    if length > u64::from(shape.node_bytes) {
        return Err(input.bad(at, field, "more records than it can hold", COPY_AGAIN));
    }
    let bytes = input.metadata(at, length, field)?;
    let mut fields = input.fields(at, &bytes);
    signature(&mut fields, if level == 0 { b"BTLF" } else { b"BTIN" }, field)?;
    fields.skip(2, field)?;
    for _ in 0..count {
        let start = fields.offset();
        let record = fields.take(usize::from(shape.record_bytes), field)?;
        visit(&mut Fields::new(input.path(), start, record))?;
    }
    if level > 0 {
        for _ in 0..=count {
            let child = fields.u64(field)?;
            let count = fields.uint(count_bytes, field)?;
            fields.skip(total_bytes, field)?;
            node(input, shape, (child, count, level - 1), visit)?;
        }
    }
    Ok(())
}
