//! Fixed and extensible arrays: chunk indices of files of HDF5 1.10 and later.

use wavex_formats::Result;
use wavex_formats::bytes::Fields;

use super::input::{Address, COPY_AGAIN, Input, address, signature};

/// Bytes of the checksum after each block and page; it is not checked.
const CHECKSUM_BYTES: u64 = 4;

/// Gets the number of an entry and its fields.
type Visit<'a> = &'a mut dyn FnMut(u64, &mut Fields) -> Result<()>;

/// Visits all entries of a fixed array.
///
/// # Errors
/// If the array is damaged, or `visit` fails.
pub fn fixed_array(input: &Input, header: Address, visit: Visit) -> Result<()> {
    let field = "fixed array";
    let bytes = input.metadata(header, 24, field)?;
    let mut fields = input.fields(header, &bytes);
    signature(&mut fields, b"FAHD", field)?;
    fields.skip(2, field)?;
    let entry_bytes = u64::from(fields.u8(field)?);
    let page_bits = fields.u8(field)?;
    let count = fields.u64(field)?;
    let Some(block) = address(&mut fields, field)? else { return Ok(()) };
    let pages = Pages::of(input, header, entry_bytes, page_bits)?;
    let head = input.metadata(block, 14, field)?;
    signature(&mut input.fields(block, &head), b"FADB", field)?;
    let first = block + 14;
    if count <= pages.entries {
        return pages.entries(input, first, 0, count, visit);
    }
    let page_count = count.div_ceil(pages.entries);
    let used = input.metadata(first, page_count.div_ceil(8), field)?;
    let first_page = first + used.len() as u64 + CHECKSUM_BYTES;
    pages.visit(input, first_page, 0, count, &used, visit)
}

/// Entries of an array, in pages if there are many.
struct Pages {
    entry_bytes: u64,
    /// Entries of a page.
    entries: u64,
}

impl Pages {
    fn of(input: &Input, header: Address, entry_bytes: u64, page_bits: u8) -> Result<Pages> {
        if entry_bytes < 8 || page_bits > 32 {
            return Err(input.bad(header, "array of chunks", "impossible sizes of entries", COPY_AGAIN));
        }
        Ok(Pages { entry_bytes, entries: 1 << page_bits })
    }

    /// Visits entries that follow each other.
    fn entries(&self, input: &Input, at: Address, number: u64, count: u64, visit: Visit) -> Result<()> {
        let field = "entries of an array";
        let bytes = input.metadata(at, count.saturating_mul(self.entry_bytes), field)?;
        let mut fields = input.fields(at, &bytes);
        for index in 0..count {
            let start = fields.offset();
            let entry = fields.take(self.entry_bytes as usize, field)?;
            visit(number + index, &mut Fields::new(input.path(), start, entry))?;
        }
        Ok(())
    }

    /// Visits the entries of all pages in use.
    fn visit(
        &self,
        input: &Input,
        first_page: Address,
        number: u64,
        count: u64,
        used: &[u8],
        visit: Visit,
    ) -> Result<()> {
        let page_bytes = self.entries * self.entry_bytes + CHECKSUM_BYTES;
        for page in 0..count.div_ceil(self.entries) {
            let in_use = used.get((page / 8) as usize).is_some_and(|byte| byte & (0x80 >> (page % 8)) != 0);
            if in_use {
                let before = page * self.entries;
                let at = page.saturating_mul(page_bytes).saturating_add(first_page);
                self.entries(input, at, number + before, self.entries.min(count - before), visit)?;
            }
        }
        Ok(())
    }
}

/// Visits all entries of an extensible array.
///
/// # Errors
/// If the array is damaged, or `visit` fails.
pub fn extensible_array(input: &Input, header: Address, visit: Visit) -> Result<()> {
    let field = "extensible array";
    let bytes = input.metadata(header, 68, field)?;
    let mut fields = input.fields(header, &bytes);
    signature(&mut fields, b"EAHD", field)?;
    fields.skip(2, field)?;
    let entry_bytes = u64::from(fields.u8(field)?);
    let number_bits = u32::from(fields.u8(field)?);
    let direct_entries = u64::from(fields.u8(field)?);
    let smallest_block = u64::from(fields.u8(field)?);
    let smallest_super_block = u64::from(fields.u8(field)?);
    let page_bits = fields.u8(field)?;
    fields.skip(4 * 8, field)?;
    // Entries beyond the highest set one are in blocks that may not exist.
    let count = fields.u64("entries in use")?;
    fields.skip(8, field)?;
    let Some(index_block) = address(&mut fields, field)? else { return Ok(()) };
    if !smallest_block.is_power_of_two()
        || !smallest_super_block.is_power_of_two()
        || !(smallest_block.ilog2()..=64).contains(&number_bits)
    {
        return Err(input.bad(header, field, "impossible sizes of blocks", COPY_AGAIN));
    }
    let pages = Pages::of(input, header, entry_bytes, page_bits)?;
    let mut array = ExtensibleArray {
        input,
        pages,
        // Signature, version, client, address of the header, offset of the block.
        block_head: 14 + u64::from(number_bits.div_ceil(8)),
        number: 0,
        count,
        visit,
    };
    array.read(index_block, direct_entries, (smallest_block, smallest_super_block, number_bits))
}

struct ExtensibleArray<'a> {
    input: &'a Input,
    pages: Pages,
    block_head: u64,
    /// Number of the next entry.
    number: u64,
    count: u64,
    visit: Visit<'a>,
}

impl ExtensibleArray<'_> {
    /// Reads the index block, and all blocks that it lists.
    fn read(&mut self, at: Address, direct_entries: u64, shape: (u64, u64, u32)) -> Result<()> {
        let (smallest_block, smallest_super_block, number_bits) = shape;
        let field = "index block of an array";
        let head = self.input.metadata(at, 14, field)?;
        signature(&mut self.input.fields(at, &head), b"EAIB", field)?;
        let direct = direct_entries.min(self.count);
        self.pages.entries(self.input, at + 14, 0, direct, self.visit)?;
        self.number = direct_entries;

        // Super block s has 2^(s/2) blocks of 2^((s+1)/2) times the smallest size. The index block lists the
        // blocks of the first ones itself.
        let direct_super_blocks = 2 * smallest_super_block.ilog2();
        let super_blocks = 1 + number_bits - smallest_block.ilog2();
        let mut next = at + 14 + direct_entries * self.pages.entry_bytes;
        for super_block in 0..super_blocks {
            if self.number >= self.count {
                break;
            }
            let blocks = 1_u64.checked_shl(super_block / 2).unwrap_or(u64::MAX);
            let factor = 1_u64.checked_shl(super_block.div_ceil(2)).unwrap_or(u64::MAX);
            let entries = smallest_block.saturating_mul(factor);
            if super_block < direct_super_blocks {
                self.blocks(next, blocks, entries, None)?;
                next = next.saturating_add(blocks.saturating_mul(8));
            } else {
                let bytes = self.input.metadata(next, 8, field)?;
                match address(&mut self.input.fields(next, &bytes), field)? {
                    Some(at) => self.super_block(at, blocks, entries)?,
                    None => self.skip(blocks.saturating_mul(entries)),
                }
                next = next.saturating_add(8);
            }
        }
        Ok(())
    }

    fn skip(&mut self, entries: u64) {
        self.number = self.number.saturating_add(entries);
    }

    /// Reads a super block: which pages of its blocks are in use, and the addresses of the blocks.
    fn super_block(&mut self, at: Address, blocks: u64, entries: u64) -> Result<()> {
        let field = "super block of an array";
        let head = self.input.metadata(at, self.block_head, field)?;
        signature(&mut self.input.fields(at, &head), b"EASB", field)?;
        let first = at + self.block_head;
        if entries <= self.pages.entries {
            return self.blocks(first, blocks, entries, None);
        }
        let used_bytes = entries.div_ceil(self.pages.entries).div_ceil(8);
        let used = self.input.metadata(first, blocks.saturating_mul(used_bytes), field)?;
        let first = first + used.len() as u64;
        self.blocks(first, blocks, entries, Some((&used, used_bytes as usize)))
    }

    /// Reads blocks of entries from the list of their addresses.
    fn blocks(
        &mut self,
        list: Address,
        blocks: u64,
        entries: u64,
        used: Option<(&[u8], usize)>,
    ) -> Result<()> {
        let field = "block of an array";
        for block in 0..blocks {
            let count = self.count.saturating_sub(self.number).min(entries);
            if count == 0 {
                break;
            }
            let at = list.saturating_add(block.saturating_mul(8));
            let bytes = self.input.metadata(at, 8, field)?;
            if let Some(at) = address(&mut self.input.fields(at, &bytes), field)? {
                let head = self.input.metadata(at, self.block_head, field)?;
                signature(&mut self.input.fields(at, &head), b"EADB", field)?;
                let first = at + self.block_head;
                match used {
                    None => self.pages.entries(self.input, first, self.number, count, self.visit)?,
                    Some((used, bytes)) => {
                        let used = used.get(block as usize * bytes..).unwrap_or(&[]);
                        let first_page = first + CHECKSUM_BYTES;
                        self.pages.visit(self.input, first_page, self.number, count, used, self.visit)?;
                    }
                }
            }
            self.skip(entries);
        }
        Ok(())
    }
}
