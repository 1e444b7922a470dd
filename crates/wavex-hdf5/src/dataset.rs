//! A data set of numbers with one or two dimensions, read by rows of chunks.

use wavex_formats::bytes::Fields;
use wavex_formats::{Error, Result};

use super::chunk_index::{Chunk, Grid, Index};
use super::filters::{self, Decoder, Filter, Sizes};
use super::input::{Address, COPY_AGAIN, Input, REPACK, address, within};
use super::number::Number;
use super::object::{Message, kind, messages};

/// Most bytes of a decoded chunk, and of a row of chunks.
const CHUNK_BYTES: u64 = 64 << 20;

/// Bytes that are read at once from data that are not in chunks.
const BLOCK_BYTES: u64 = 256 << 10;

/// A data set; the row of chunks that was read last is kept.
pub struct Dataset {
    name: String,
    number: Number,
    /// Extent: rows, and columns if there are two dimensions.
    extent: Vec<u64>,
    storage: Storage,
    filters: Vec<Filter>,
    fill: Vec<u8>,
    band: Band,
}

enum Storage {
    Compact(Vec<u8>),
    Contiguous(Option<Address>),
    Chunked(Grid, Vec<Chunk>),
}

/// Decoded rows.
#[derive(Default)]
struct Band {
    /// Numbers of the elements.
    elements: std::ops::Range<u64>,
    /// Values of the elements; empty if all have the fill value.
    bytes: Vec<u8>,
}

impl Dataset {
    /// Reads the description of the data set at an address; `name` is for errors.
    ///
    /// # Errors
    /// If the object has no numbers, more than two dimensions, too large chunks, or its structure is damaged.
    pub fn open(input: &Input, name: &str, at: Address) -> Result<Dataset> {
        input.next_object();
        messages(input, at)
            .and_then(|messages| Self::from_messages(input, name, at, &messages))
            .map_err(within(name))
    }

    fn from_messages(input: &Input, name: &str, at: Address, messages: &[Message]) -> Result<Dataset> {
        let find = |kind: u16, field: &str| match messages.iter().find(|message| message.kind == kind) {
            Some(message) => message.fields(input),
            None => Err(input.bad(at, field, "missing: this is no data set", COPY_AGAIN)),
        };
        let number = Number::read(&mut find(kind::DATATYPE, "data type")?)?;
        let space = &mut find(kind::DATASPACE, "dataspace")?;
        let [extent, most] = read_extent(space)?;
        let bytes =
            extent.iter().try_fold(number.bytes as u64, |product, &length| product.checked_mul(length));
        if bytes.is_none() {
            return Err(space.bad("dataspace", "impossible size", COPY_AGAIN));
        }
        let mut filters = Vec::new();
        let mut fill = vec![0; number.bytes];
        for message in messages {
            match message.kind {
                kind::FILTERS => filters = filters::read(&mut message.fields(input)?)?,
                kind::FILL_VALUE => read_fill_value(&mut message.fields(input)?, &mut fill)?,
                _ => {}
            }
        }
        let layout = &mut find(kind::LAYOUT, "layout")?;
        let grid = Grid {
            chunk_shape: Vec::new(),
            most,
            chunk_bytes: number.bytes as u64,
            filtered: !filters.is_empty(),
            size_bytes: 8,
        };
        let storage = read_layout(input, layout, grid, &extent)?;
        let dataset =
            Dataset { name: name.to_owned(), number, extent, storage, filters, fill, band: Band::default() };
        if dataset.band_bytes() > CHUNK_BYTES {
            let problem = format!("{} bytes in a row of chunks, at most {CHUNK_BYTES}", dataset.band_bytes());
            return Err(layout.bad("layout", problem, REPACK));
        }
        Ok(dataset)
    }

    /// Returns the name of the data set, with its groups.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Returns the number of rows.
    pub fn rows(&self) -> u64 {
        self.extent[0]
    }

    /// Returns the number of columns; 1 if there is one dimension.
    pub fn columns(&self) -> u64 {
        self.extent.get(1).copied().unwrap_or(1)
    }

    /// Returns the number of elements.
    pub fn len(&self) -> u64 {
        self.rows() * self.columns()
    }

    /// Returns the most bytes that are kept decoded.
    pub fn band_bytes(&self) -> u64 {
        let row = self.columns().saturating_mul(self.number.bytes as u64);
        self.band_rows().min(self.rows()).saturating_mul(row)
    }

    /// Returns the number of rows that are decoded at once.
    fn band_rows(&self) -> u64 {
        match &self.storage {
            Storage::Chunked(grid, _) => grid.chunk_shape[0],
            _ => (BLOCK_BYTES / (self.columns().max(1) * self.number.bytes as u64).max(1)).max(1),
        }
    }

    /// Reads one element as a float.
    ///
    /// # Errors
    /// If it is beyond the end, or its chunk is damaged.
    pub fn f64_at(&mut self, input: &Input, decoder: &mut Decoder, element: u64) -> Result<f64> {
        let number = self.number;
        Ok(number.to_f64(self.one(input, decoder, element)?))
    }

    /// Reads one element as a whole number; `None` if it is negative or has a fraction.
    ///
    /// # Errors
    /// As [`Dataset::f64_at`].
    pub fn u64_at(&mut self, input: &Input, decoder: &mut Decoder, element: u64) -> Result<Option<u64>> {
        let number = self.number;
        Ok(number.to_u64(self.one(input, decoder, element)?))
    }

    /// Appends elements as samples.
    ///
    /// # Errors
    /// As [`Dataset::f64_at`]; nothing is allocated if the elements are beyond the end.
    pub fn append_f32(
        &mut self,
        input: &Input,
        decoder: &mut Decoder,
        elements: std::ops::Range<u64>,
        samples: &mut Vec<f32>,
    ) -> Result<()> {
        self.check(input, elements.end)?;
        let mut next = elements.start;
        while next < elements.end {
            let number = self.number;
            self.load(input, decoder, next)?;
            let last = self.band.elements.end.min(elements.end);
            match self.kept(next, last) {
                Some(bytes) => number.append_f32(bytes, samples),
                None => {
                    samples.resize(samples.len() + (last - next) as usize, number.to_f64(&self.fill) as f32)
                }
            }
            next = last;
        }
        Ok(())
    }

    fn one(&mut self, input: &Input, decoder: &mut Decoder, element: u64) -> Result<&[u8]> {
        self.check(input, element.saturating_add(1))?;
        self.load(input, decoder, element)?;
        Ok(self.kept(element, element + 1).unwrap_or(&self.fill))
    }

    /// Returns the bytes of kept elements; `None` if they have the fill value.
    fn kept(&self, first: u64, end: u64) -> Option<&[u8]> {
        let byte = |element: u64| (element - self.band.elements.start) as usize * self.number.bytes;
        self.band.bytes.get(byte(first)..byte(end))
    }

    fn check(&self, input: &Input, end: u64) -> Result<()> {
        if end <= self.len() {
            return Ok(());
        }
        let problem = format!("{}: element {end} is needed, it has {}", self.name, self.len());
        Err(Error::unusable(input.path(), problem, COPY_AGAIN))
    }

    /// Decodes the rows around an element, unless they are kept.
    fn load(&mut self, input: &Input, decoder: &mut Decoder, element: u64) -> Result<()> {
        if self.band.elements.contains(&element) {
            return Ok(());
        }
        let (band_rows, columns) = (self.band_rows(), self.columns());
        let number = element / columns / band_rows;
        let first_row = number * band_rows;
        let rows = band_rows.min(self.rows() - first_row);
        let row_bytes = columns * self.number.bytes as u64;
        let (start, length) = (first_row * row_bytes, (rows * row_bytes) as usize);
        let bytes = &mut self.band.bytes;
        // A failure leaves no rows of another band.
        self.band.elements = 0..0;
        match &self.storage {
            Storage::Compact(data) => {
                bytes.clear();
                bytes.extend_from_slice(&data[start as usize..][..length]);
            }
            Storage::Contiguous(None) => bytes.clear(),
            Storage::Contiguous(Some(at)) => {
                input.check(*at, start + length as u64, "data").map_err(within(&self.name))?;
                bytes.resize(length, 0);
                input.read(at + start, bytes, "data").map_err(within(&self.name))?;
            }
            Storage::Chunked(grid, chunks) => {
                let beside = grid.columns(&self.extent);
                let first = chunks.partition_point(|chunk| chunk.number < number * beside);
                let end = chunks.partition_point(|chunk| chunk.number < (number + 1) * beside);
                let chunks = &chunks[first..end];
                if (chunks.len() as u64) < beside {
                    bytes.clear();
                    if !chunks.is_empty() {
                        bytes.extend(std::iter::repeat_n(&self.fill, length / self.fill.len()).flatten());
                    }
                } else {
                    bytes.resize(length, 0);
                }
                let chunk_columns = grid.chunk_shape.get(1).copied().unwrap_or(1);
                let chunk_row = chunk_columns as usize * self.number.bytes;
                for chunk in chunks {
                    let sizes = Sizes {
                        chunk: grid.chunk_bytes as usize,
                        number: self.number.bytes,
                        needed: rows as usize * chunk_row,
                    };
                    let decoded =
                        decode(input, decoder, &self.filters, chunk, sizes).map_err(within(&self.name))?;
                    let row_bytes = row_bytes as usize;
                    let left = (chunk.number % beside) as usize * chunk_row;
                    let width = chunk_row.min(row_bytes - left);
                    for (row, from) in bytes.chunks_exact_mut(row_bytes).zip(decoded.chunks_exact(chunk_row))
                    {
                        row[left..left + width].copy_from_slice(&from[..width]);
                    }
                }
            }
        }
        bytes.shrink_to(length);
        self.band.elements = first_row * columns..(first_row + rows) * columns;
        Ok(())
    }
}

/// Reads and decodes a chunk.
fn decode<'a>(
    input: &Input,
    decoder: &'a mut Decoder,
    filters: &[Filter],
    chunk: &Chunk,
    sizes: Sizes,
) -> Result<&'a [u8]> {
    let field = format!("chunk {}", chunk.number);
    input.check(chunk.address, chunk.stored_bytes, &field)?;
    // Data that cannot be compressed become a little larger.
    if chunk.stored_bytes > sizes.chunk as u64 + sizes.chunk as u64 / 8 + 1024 {
        return Err(input.bad(chunk.address, &field, "larger than without compression", COPY_AGAIN));
    }
    decoder.stored.resize(chunk.stored_bytes as usize, 0);
    input.read(chunk.address, &mut decoder.stored, &field)?;
    let decoded = decoder.decode(filters, chunk.skipped_filters, sizes);
    decoded.map_err(|damage| input.bad(chunk.address, &field, damage, COPY_AGAIN))
}

/// Reads the extent and the largest extent, `u64::MAX` if unlimited.
fn read_extent(fields: &mut Fields) -> Result<[Vec<u64>; 2]> {
    let field = "dataspace";
    let before = fields.clone();
    let version = fields.u8(field)?;
    let rank = usize::from(fields.u8(field)?);
    let flags = fields.u8(field)?;
    fields.skip(if version == 1 { 5 } else { 1 }, field)?;
    if rank > 2 {
        let problem = format!("{rank} dimensions, only 1 and 2 are supported");
        return Err(before.bad(field, problem, "give a file of GEDI L1B or LVIS L1B"));
    }
    let mut sizes = || (0..rank).map(|_| fields.u64(field)).collect::<Result<Vec<_>>>();
    let mut extent = sizes()?;
    let mut most = if flags & 1 == 0 { extent.clone() } else { sizes()? };
    if rank == 0 {
        (extent, most) = (vec![1], vec![1]);
    }
    Ok([extent, most])
}

/// Reads the value of elements that are not stored, if it is defined.
fn read_fill_value(fields: &mut Fields, fill: &mut Vec<u8>) -> Result<()> {
    let field = "fill value";
    let version = fields.u8(field)?;
    let defined = if version < 3 {
        fields.skip(2, field)?;
        fields.u8(field)? != 0
    } else {
        fields.u8(field)? & 0x20 != 0
    };
    if !defined {
        return Ok(());
    }
    let before = fields.clone();
    let length = fields.u32(field)? as usize;
    match length {
        0 => {}
        _ if length == fill.len() => fill.copy_from_slice(fields.take(length, field)?),
        _ => return Err(before.bad(field, "not as long as the numbers", COPY_AGAIN)),
    }
    Ok(())
}

/// Reads where the data are; `grid` has what other messages say.
fn read_layout(input: &Input, fields: &mut Fields, mut grid: Grid, extent: &[u64]) -> Result<Storage> {
    let field = "layout";
    let before = fields.clone();
    let length = extent.iter().product::<u64>() * grid.chunk_bytes;
    let version = fields.u8(field)?;
    let class = fields.u8(field)?;
    match (version, class) {
        (3..=5, 0) => {
            let bytes = usize::from(fields.u16(field)?);
            if bytes as u64 != length {
                return Err(before.bad(field, format!("{bytes} bytes of {length}"), COPY_AGAIN));
            }
            Ok(Storage::Compact(fields.take(bytes, field)?.to_vec()))
        }
        (3..=5, 1) => Ok(Storage::Contiguous(address(fields, field)?)),
        (3..=5, 2) => {
            let flags = if version > 3 { fields.u8(field)? } else { 0 };
            let dimensions = usize::from(fields.u8(field)?);
            let mut at = if version == 3 { address(fields, field)? } else { None };
            let length_bytes = if version > 3 { usize::from(fields.u8(field)?) } else { 4 };
            if dimensions != extent.len() + 1 || !(1..=8).contains(&length_bytes) {
                return Err(before.bad(field, "dimensions of chunks differ from the data's", COPY_AGAIN));
            }
            for _ in extent {
                grid.chunk_shape.push(fields.uint(length_bytes, field)?);
            }
            let number_bytes = fields.uint(length_bytes, field)?;
            let elements =
                grid.chunk_shape.iter().try_fold(1_u64, |product, &length| product.checked_mul(length));
            let bytes =
                elements.and_then(|elements| elements.checked_mul(grid.chunk_bytes)).unwrap_or(u64::MAX);
            if number_bytes != grid.chunk_bytes || bytes == 0 {
                return Err(before.bad(field, "impossible size of chunks", COPY_AGAIN));
            }
            if bytes > CHUNK_BYTES {
                let problem = format!("{bytes} bytes in a chunk, at most {CHUNK_BYTES}");
                return Err(before.bad(field, problem, REPACK));
            }
            grid.chunk_bytes = bytes;
            // Version 4 stores sizes of chunks in as few bytes as a chunk that has grown a little needs.
            grid.size_bytes = if version == 4 { (1 + (bytes.ilog2() as usize + 8) / 8).min(8) } else { 8 };
            let mut index = Index::BTree1;
            if version > 3 {
                index = Index::read(fields, flags)?;
                at = address(fields, field)?;
            }
            let chunks = match at {
                Some(at) if !extent.contains(&0) => index.chunks(input, at, &grid, extent)?,
                _ => Vec::new(),
            };
            Ok(Storage::Chunked(grid, chunks))
        }
        (3..=5, _) => Err(before.bad(field, "virtual data sets are not supported", REPACK)),
        _ => Err(before.bad(field, format!("version {version} is not supported"), REPACK)),
    }
}
