//! Places of the chunks of a data set, from any of HDF5's six kinds of index.

use wavex_formats::Result;
use wavex_formats::bytes::Fields;

use super::chunk_arrays::{extensible_array, fixed_array};
use super::input::{Address, COPY_AGAIN, Input};
use super::tree;

/// Most chunks of one data set.
const MOST_CHUNKS: usize = 1_000_000;

/// A stored chunk.
#[derive(Clone, Copy, Debug)]
pub struct Chunk {
    /// Number in the grid of chunks, rows first.
    pub number: u64,
    /// Address of the stored bytes.
    pub address: Address,
    /// Number of stored bytes.
    pub stored_bytes: u64,
    /// Filters that were not applied, one bit each.
    pub skipped_filters: u32,
}

/// Grid of the chunks of a data set.
#[derive(Clone, Debug)]
pub struct Grid {
    /// Rows and columns of a chunk; one number if the data set has one dimension.
    pub chunk_shape: Vec<u64>,
    /// Largest rows and columns of the data set, `u64::MAX` if unlimited.
    pub most: Vec<u64>,
    /// Bytes of a chunk that is not compressed.
    pub chunk_bytes: u64,
    /// Whether chunks are filtered.
    pub filtered: bool,
    /// Bytes of stored sizes in the entries of an index, from the version of the layout.
    pub size_bytes: usize,
}

impl Grid {
    /// Returns the number of chunks in a row of chunks.
    pub fn columns(&self, extent: &[u64]) -> u64 {
        extent.iter().zip(&self.chunk_shape).skip(1).map(|(&all, &one)| all.div_ceil(one)).product()
    }
}

/// Kind of an index, with what its layout message says.
pub enum Index {
    BTree1,
    Single { stored_bytes: u64, skipped_filters: u32 },
    Implicit,
    FixedArray,
    ExtensibleArray,
    BTree2,
}

impl Index {
    /// Reads the kind from a layout message of version 4 or 5.
    ///
    /// # Errors
    /// If there is no such kind.
    pub fn read(fields: &mut Fields, flags: u8) -> Result<Index> {
        let field = "kind of chunk index";
        let before = fields.clone();
        let (index, skip) = match fields.u8(field)? {
            1 if flags & 2 != 0 => {
                let stored_bytes = fields.u64(field)?;
                (Index::Single { stored_bytes, skipped_filters: fields.u32(field)? }, 0)
            }
            1 => (Index::Single { stored_bytes: 0, skipped_filters: 0 }, 0),
            2 => (Index::Implicit, 0),
            3 => (Index::FixedArray, 1),
            4 => (Index::ExtensibleArray, 5),
            5 => (Index::BTree2, 6),
            _ => return Err(before.bad(field, "unknown", COPY_AGAIN)),
        };
        fields.skip(skip, field)?;
        Ok(index)
    }

    /// Lists the stored chunks of a data set with this extent, by their numbers.
    ///
    /// # Errors
    /// If the index is damaged, or too large.
    pub fn chunks(&self, input: &Input, at: Address, grid: &Grid, extent: &[u64]) -> Result<Vec<Chunk>> {
        let mut found = Found { input, at, grid, extent, chunks: Vec::new() };
        let field = "chunk index";
        match *self {
            Index::BTree1 => {
                let key_bytes = 8 + 8 * (extent.len() + 1);
                tree::children(input, at, 1, key_bytes, &mut |key, address| {
                    let stored_bytes = u64::from(key.u32(field)?);
                    let skipped_filters = key.u32(field)?;
                    let mut offset = Vec::new();
                    for &length in &grid.chunk_shape {
                        offset.push(key.u64(field)? / length);
                    }
                    found.push(&offset, address, stored_bytes, skipped_filters)
                })?;
            }
            Index::Single { stored_bytes, skipped_filters } => {
                let stored_bytes = if grid.filtered { stored_bytes } else { grid.chunk_bytes };
                found.push(&[0, 0][..extent.len()], at, stored_bytes, skipped_filters)?;
            }
            Index::Implicit => {
                let count = extent[0].div_ceil(grid.chunk_shape[0]).saturating_mul(grid.columns(extent));
                for number in 0..count {
                    let address =
                        number.checked_mul(grid.chunk_bytes).and_then(|offset| at.checked_add(offset));
                    let address = address.unwrap_or(u64::MAX - 1);
                    input.check(address, grid.chunk_bytes, field)?;
                    found.push_number(number, address, grid.chunk_bytes, 0)?;
                }
            }
            Index::FixedArray => {
                fixed_array(input, at, &mut |number, entry| found.push_entry(number, entry))?;
            }
            Index::ExtensibleArray => {
                extensible_array(input, at, &mut |number, entry| found.push_entry(number, entry))?;
            }
            Index::BTree2 => {
                let record_type = if grid.filtered { 11 } else { 10 };
                tree::records(input, at, record_type, &mut |record| {
                    let (address, stored_bytes, skipped_filters) = place(record, grid)?;
                    let mut offset = Vec::new();
                    for _ in &grid.chunk_shape {
                        offset.push(record.u64(field)?);
                    }
                    found.push(&offset, address, stored_bytes, skipped_filters)
                })?;
            }
        }
        let mut chunks = found.chunks;
        chunks.sort_by_key(|chunk| chunk.number);
        if chunks.windows(2).any(|pair| pair[0].number == pair[1].number) {
            return Err(input.bad(at, field, "lists a chunk twice", COPY_AGAIN));
        }
        Ok(chunks)
    }
}

/// Reads address, stored size and skipped filters of an entry.
fn place(entry: &mut Fields, grid: &Grid) -> Result<(Address, u64, u32)> {
    let field = "entry of a chunk index";
    let address = entry.u64(field)?;
    if !grid.filtered {
        return Ok((address, grid.chunk_bytes, 0));
    }
    Ok((address, entry.uint(grid.size_bytes, field)?, entry.u32(field)?))
}

/// Collects chunks.
struct Found<'a> {
    input: &'a Input,
    at: Address,
    grid: &'a Grid,
    extent: &'a [u64],
    chunks: Vec<Chunk>,
}

impl Found<'_> {
    /// Adds a chunk by its position in the grid; chunks beyond the extent are left out.
    fn push(
        &mut self,
        offset: &[u64],
        address: Address,
        stored_bytes: u64,
        skipped_filters: u32,
    ) -> Result<()> {
        let within = offset.iter().zip(&self.grid.chunk_shape).zip(self.extent).all(
            |((&offset, &length), &extent)| offset.checked_mul(length).is_some_and(|start| start < extent),
        );
        if !within {
            return Ok(());
        }
        let column = offset.get(1).copied().unwrap_or(0);
        let number = offset[0] * self.grid.columns(self.extent) + column;
        self.push_number(number, address, stored_bytes, skipped_filters)
    }

    /// Adds the chunk of an entry of an array, which counts chunks over the largest extent.
    fn push_entry(&mut self, number: u64, entry: &mut Fields) -> Result<()> {
        let (address, stored_bytes, skipped_filters) = place(entry, self.grid)?;
        let columns = self.grid.columns(&self.grid.most).max(1);
        let offset = [number / columns, number % columns];
        self.push(&offset[..self.extent.len()], address, stored_bytes, skipped_filters)
    }

    fn push_number(
        &mut self,
        number: u64,
        address: Address,
        stored_bytes: u64,
        skipped_filters: u32,
    ) -> Result<()> {
        if address == u64::MAX {
            return Ok(());
        }
        if self.chunks.len() == MOST_CHUNKS {
            let problem = format!("more than {MOST_CHUNKS} chunks");
            let remedy = "rewrite the file with larger chunks: `h5repack -l CHUNK=100000`";
            return Err(self.input.bad(self.at, "chunk index", problem, remedy));
        }
        self.chunks.push(Chunk { number, address, stored_bytes, skipped_filters });
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    #[test]
    fn the_number_of_chunks_is_limited() {
        let input = Input::open(&Path::new(env!("CARGO_MANIFEST_DIR")).join("Cargo.toml")).unwrap();
        let grid = Grid {
            chunk_shape: vec![1],
            most: vec![u64::MAX],
            chunk_bytes: 4,
            filtered: false,
            size_bytes: 8,
        };
        let chunk = Chunk { number: 0, address: 0, stored_bytes: 4, skipped_filters: 0 };
        let chunks = vec![chunk; MOST_CHUNKS - 1];
        let mut found = Found { input: &input, at: 8, grid: &grid, extent: &[u64::MAX], chunks };
        // Chunks beyond the extent, and without an address, do not count.
        found.push_number(7, u64::MAX, 4, 0).unwrap();
        found.push(&[u64::MAX], 0, 4, 0).unwrap();
        found.push(&[9], 0, 4, 0).unwrap();
        let error = found.push(&[10], 0, 4, 0).unwrap_err().to_string();
        assert!(
            error.contains(
                "byte 8: chunk index: more than 1000000 chunks; rewrite the file with larger chunks"
            )
        );
    }

    #[test]
    fn unknown_kinds_are_refused() {
        let error =
            Index::read(&mut Fields::new(Path::new("f.h5"), 40, &[9, 0, 0]), 0).err().unwrap().to_string();
        assert!(error.contains("f.h5: byte 40: kind of chunk index: unknown"), "{error}");
    }
}
