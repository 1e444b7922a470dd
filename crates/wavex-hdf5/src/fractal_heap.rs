//! Fractal heaps: storage of links and attributes of the new form.

use wavex_formats::Result;
use wavex_formats::bytes::Fields;

use super::input::{Address, COPY_AGAIN, Input, REPACK, address, signature};

/// A heap whose blocks form a table of rows with doubling sizes.
pub struct FractalHeap {
    header: Address,
    width: u64,
    first_block_bytes: u64,
    largest_direct_bytes: u64,
    offset_bytes: usize,
    length_bytes: usize,
    root: Option<Address>,
    root_rows: u64,
}

impl FractalHeap {
    /// Reads the header of a heap.
    ///
    /// # Errors
    /// If it is damaged, or its blocks are compressed.
    pub fn open(input: &Input, header: Address) -> Result<FractalHeap> {
        let field = "fractal heap";
        let bytes = input.metadata(header, 142, field)?;
        let mut fields = input.fields(header, &bytes);
        signature(&mut fields, b"FRHP", field)?;
        fields.skip(3, field)?;
        let filter_bytes = fields.u16("filters of the heap")?;
        fields.skip(1, field)?;
        let largest_object = u64::from(fields.u32("size of objects")?);
        fields.skip(12 * 8, field)?;
        let width = u64::from(fields.u16("width of the table")?);
        let first_block_bytes = fields.u64("size of the first block")?;
        let largest_direct_bytes = fields.u64("largest direct block")?;
        let offset_bits = usize::from(fields.u16("size of the heap")?);
        fields.skip(2, field)?;
        let root = address(&mut fields, field)?;
        let root_rows = u64::from(fields.u16("rows of the root block")?);
        if filter_bytes != 0 {
            return Err(input.bad(header, field, "compressed links are not supported", REPACK));
        }
        let sound = |size: u64| size.is_power_of_two() && size <= 1 << 32;
        if !(1..=64).contains(&offset_bits)
            || width == 0
            || !sound(first_block_bytes)
            || !sound(largest_direct_bytes)
            || root_rows > 64
        {
            return Err(input.bad(header, field, "impossible sizes of blocks", COPY_AGAIN));
        }
        let length_bytes = (largest_direct_bytes.ilog2() as usize).div_ceil(8);
        Ok(FractalHeap {
            header,
            width,
            first_block_bytes,
            largest_direct_bytes,
            offset_bytes: offset_bits.div_ceil(8),
            length_bytes: length_bytes.min(largest_object.max(1).ilog2() as usize / 8 + 1),
            root,
            root_rows,
        })
    }

    /// Reads the object with the ID at the next field; returns its address, too.
    ///
    /// # Errors
    /// If the object is missing, or stored in a block of its own, which is not supported.
    pub fn object(&self, input: &Input, id: &mut Fields) -> Result<(Address, Vec<u8>)> {
        let field = "ID of an object in a heap";
        if id.u8(field)? & 0x30 != 0 {
            return Err(id.bad(field, "a name of this length is not supported", REPACK));
        }
        let offset = id.uint(self.offset_bytes, field)?;
        let length = id.uint(self.length_bytes, field)?;
        let root = self.root.ok_or_else(|| id.bad(field, "the heap is empty", COPY_AGAIN))?;
        let at = self.locate(input, (root, self.root_rows), offset)?;
        let at = at.ok_or_else(|| id.bad(field, "beyond the end of the heap", COPY_AGAIN))?;
        Ok((at, input.metadata(at, length, "object in a heap")?))
    }

    /// Returns the address of an offset in the heap; `None` if no block contains it.
    fn locate(&self, input: &Input, root: (Address, u64), offset: u64) -> Result<Option<Address>> {
        let field = "indirect block of a heap";
        let (mut block, mut rows) = root;
        let mut offset = offset;
        while rows > 0 {
            let Some((row, column, start, bytes)) = self.entry(rows, offset) else { return Ok(None) };
            // Signature, version, address of the header, offset of the block.
            let entries = block.saturating_add(13 + self.offset_bytes as u64);
            let head = input.metadata(block, 13, field)?;
            let mut fields = input.fields(block, &head);
            signature(&mut fields, b"FHIB", field)?;
            fields.skip(1, field)?;
            if fields.u64(field)? != self.header {
                return Err(input.bad(block, field, "a block of another heap", COPY_AGAIN));
            }
            let at = entries.saturating_add((row * self.width + column) * 8);
            let bytes_of_entry = input.metadata(at, 8, field)?;
            let Some(child) = address(&mut input.fields(at, &bytes_of_entry), field)? else {
                return Ok(None);
            };
            (block, offset) = (child, offset - start);
            rows = if bytes <= self.largest_direct_bytes {
                0
            } else {
                // An indirect block has the rows that together have its size.
                u64::from((bytes / (self.first_block_bytes * self.width)).max(1).ilog2()) + 1
            };
        }
        Ok(block.checked_add(offset))
    }

    /// Finds the entry of an indirect block that contains an offset: row, column, its first offset and size.
    fn entry(&self, rows: u64, offset: u64) -> Option<(u64, u64, u64, u64)> {
        let (mut start, mut bytes) = (0_u64, self.first_block_bytes);
        for row in 0..rows {
            let end = start.checked_add(bytes.checked_mul(self.width)?)?;
            if offset < end {
                let column = (offset - start) / bytes;
                return Some((row, column, start + column * bytes, bytes));
            }
            start = end;
            // The first two rows have blocks of the same size.
            bytes = if row == 0 { bytes } else { bytes.checked_mul(2)? };
        }
        None
    }
}
