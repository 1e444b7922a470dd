//! A data set with one or two dimensions, read by rows of chunks.

use std::io::ErrorKind;
use std::ops::Range;

use wavex_formats::bytes::Fields;
use wavex_formats::{Error, Result};

use super::chunk_index::{Chunk, Grid};
use super::filters::{self, Decoder, Failure, Filter, Sizes};
use super::input::{Address, COPY_AGAIN, Input, REPACK, within};
use super::layout::{CHUNK_BYTES, Storage, read_extent, read_fill_value, read_layout};
use super::number::Number;
use super::object::{Message, kind, messages};

/// Bytes that are read at once from data that are not in chunks.
const BLOCK_BYTES: u64 = 256 << 10;

/// Type of the elements of a data set.
pub trait ElementType: Sized {
    /// Reads a data type message.
    ///
    /// # Errors
    /// If it is another type.
    fn read(fields: &mut Fields) -> Result<Self>;

    /// Returns the size of an element, bytes.
    fn bytes(&self) -> usize;
}

impl ElementType for Number {
    fn read(fields: &mut Fields) -> Result<Number> {
        Number::read(fields)
    }

    fn bytes(&self) -> usize {
        self.bytes
    }
}

/// A data set of numbers.
pub type Dataset = Elements<Number>;

/// A data set; the row of chunks that was read last is kept.
pub struct Elements<T> {
    name: String,
    element: T,
    /// Extent: rows, and columns if there are two dimensions.
    extent: Vec<u64>,
    storage: Storage,
    filters: Vec<Filter>,
    fill: Vec<u8>,
    band: Band,
}

/// Decoded rows.
#[derive(Default)]
struct Band {
    /// Numbers of the elements.
    elements: Range<u64>,
    /// Values of the elements; empty if all have the fill value.
    bytes: Vec<u8>,
}

impl<T: ElementType> Elements<T> {
    /// Reads the description of the data set at an address; `name` is for errors.
    ///
    /// # Errors
    /// If the object has another type, more than two dimensions, too large chunks, or its structure is damaged.
    pub fn open(input: &Input, name: &str, at: Address) -> Result<Elements<T>> {
        input.next_object();
        messages(input, at)
            .and_then(|messages| Self::from_messages(input, name, at, &messages))
            .map_err(within(name))
    }

    fn from_messages(input: &Input, name: &str, at: Address, messages: &[Message]) -> Result<Elements<T>> {
        let find = |kind: u16, field: &str| match messages.iter().find(|message| message.kind == kind) {
            Some(message) => message.fields(input),
            None => Err(input.bad(at, field, "missing: this is no data set", COPY_AGAIN)),
        };
        let element = T::read(&mut find(kind::DATATYPE, "data type")?)?;
        let element_bytes = element.bytes();
        let space = &mut find(kind::DATASPACE, "dataspace")?;
        let [extent, most] = read_extent(space)?;
        let bytes =
            extent.iter().try_fold(element_bytes as u64, |product, &length| product.checked_mul(length));
        if bytes.is_none() {
            return Err(space.bad("dataspace", "impossible size", COPY_AGAIN));
        }
        let mut filters = Vec::new();
        let mut fill = vec![0; element_bytes];
        for message in messages {
            match message.kind {
                kind::FILTERS => filters = filters::read(&mut message.fields(input)?)?,
                kind::EXTERNAL_FILES => {
                    return Err(space.bad("storage", "data in other files are not supported", REPACK));
                }
                kind::FILL_VALUE => read_fill_value(&mut message.fields(input)?, &mut fill)?,
                _ => {}
            }
        }
        let layout = &mut find(kind::LAYOUT, "layout")?;
        let grid = Grid {
            chunk_shape: Vec::new(),
            most,
            chunk_bytes: element_bytes as u64,
            filtered: !filters.is_empty(),
            size_bytes: 8,
        };
        let storage = read_layout(input, layout, grid, &extent)?;
        let dataset = Elements {
            name: name.to_owned(),
            element,
            extent,
            storage,
            filters,
            fill,
            band: Band::default(),
        };
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
        let row = self.columns().saturating_mul(self.element.bytes() as u64);
        self.band_rows().min(self.rows()).saturating_mul(row)
    }

    /// Returns the number of rows that are decoded at once.
    fn band_rows(&self) -> u64 {
        match &self.storage {
            Storage::Chunked(grid, _) => grid.chunk_shape[0],
            _ => (BLOCK_BYTES / (self.columns().max(1) * self.element.bytes() as u64).max(1)).max(1),
        }
    }

    /// Returns the type of the elements.
    pub fn element(&self) -> &T {
        &self.element
    }

    /// Reads the bytes of one element.
    ///
    /// # Errors
    /// If it is beyond the end, or its chunk is damaged.
    pub fn bytes_at(&mut self, input: &Input, decoder: &mut Decoder, element: u64) -> Result<&[u8]> {
        self.check(input, element.saturating_add(1))?;
        self.load(input, decoder, element)?;
        Ok(self.kept(element, element + 1).unwrap_or(&self.fill))
    }

    /// Gives the bytes of elements in runs of neighbours; nothing is given if they are beyond the end.
    fn each_run(
        &mut self,
        input: &Input,
        decoder: &mut Decoder,
        elements: Range<u64>,
        mut take: impl FnMut(&[u8]),
    ) -> Result<()> {
        self.check(input, elements.end)?;
        let mut next = elements.start;
        while next < elements.end {
            self.load(input, decoder, next)?;
            let last = self.band.elements.end.min(elements.end);
            match self.kept(next, last) {
                Some(stored) => take(stored),
                None => (next..last).for_each(|_| take(&self.fill)),
            }
            next = last;
        }
        Ok(())
    }

    /// Returns the bytes of kept elements; `None` if they have the fill value.
    fn kept(&self, first: u64, end: u64) -> Option<&[u8]> {
        let byte = |element: u64| (element - self.band.elements.start) as usize * self.element.bytes();
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
        let row_bytes = columns * self.element.bytes() as u64;
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
                let chunks_per_row = grid.columns(&self.extent);
                let first = chunks.partition_point(|chunk| chunk.number < number * chunks_per_row);
                let end = chunks.partition_point(|chunk| chunk.number < (number + 1) * chunks_per_row);
                let chunks = &chunks[first..end];
                input.resize(bytes, if chunks.is_empty() { 0 } else { length })?;
                if (chunks.len() as u64) < chunks_per_row {
                    bytes
                        .chunks_exact_mut(self.fill.len())
                        .for_each(|value| value.copy_from_slice(&self.fill));
                }
                let chunk_columns = grid.chunk_shape.get(1).copied().unwrap_or(1);
                let chunk_row = chunk_columns as usize * self.element.bytes();
                for chunk in chunks {
                    let sizes = Sizes {
                        chunk: grid.chunk_bytes as usize,
                        number: self.element.bytes(),
                        needed: rows as usize * chunk_row,
                    };
                    let decoded =
                        decode(input, decoder, &self.filters, chunk, sizes).map_err(within(&self.name))?;
                    let row_bytes = row_bytes as usize;
                    let left = (chunk.number % chunks_per_row) as usize * chunk_row;
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

impl Dataset {
    /// Reads one element as a float.
    ///
    /// # Errors
    /// If it is beyond the end, or its chunk is damaged.
    pub fn f64_at(&mut self, input: &Input, decoder: &mut Decoder, element: u64) -> Result<f64> {
        let number = self.element;
        Ok(number.to_f64(self.bytes_at(input, decoder, element)?))
    }

    /// Reads one element as a whole number; `None` if it is negative or has a fraction.
    ///
    /// # Errors
    /// As [`Elements::f64_at`].
    pub fn u64_at(&mut self, input: &Input, decoder: &mut Decoder, element: u64) -> Result<Option<u64>> {
        let number = self.element;
        Ok(number.to_u64(self.bytes_at(input, decoder, element)?))
    }

    /// Appends elements as samples.
    ///
    /// # Errors
    /// As [`Elements::f64_at`]; nothing is allocated if the elements are beyond the end.
    pub fn append_f32(
        &mut self,
        input: &Input,
        decoder: &mut Decoder,
        elements: Range<u64>,
        samples: &mut Vec<f32>,
    ) -> Result<()> {
        let number = self.element;
        self.each_run(input, decoder, elements, |stored| number.append_f32(stored, samples))
    }

    /// Appends elements as samples in whole digitiser steps of 16 bits.
    ///
    /// # Errors
    /// As [`Elements::append_f32`], and if a sample is no whole number from 0 to 65535.
    pub fn append_u16(
        &mut self,
        input: &Input,
        decoder: &mut Decoder,
        elements: Range<u64>,
        samples: &mut Vec<u16>,
    ) -> Result<()> {
        let (number, first, before) = (self.element, elements.start, samples.len());
        let mut wrong = None;
        self.each_run(input, decoder, elements, |stored| {
            for one in stored.chunks_exact(number.bytes) {
                let sample = number.to_u64(one).and_then(|sample| u16::try_from(sample).ok());
                if sample.is_none() {
                    wrong.get_or_insert(first + (samples.len() - before) as u64);
                }
                samples.push(sample.unwrap_or(0));
            }
        })?;
        match wrong {
            None => Ok(()),
            Some(element) => {
                let problem = format!("{}: element {element} is no whole number from 0 to 65535", self.name);
                let remedy = "write the samples as unsigned integers of 16 bits";
                Err(Error::unusable(input.path(), problem, remedy))
            }
        }
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
    input.resize(&mut decoder.stored, chunk.stored_bytes as usize)?;
    input.read(chunk.address, &mut decoder.stored, &field)?;
    let decoded = decoder.decode(filters, chunk.skipped_filters, sizes);
    decoded.map_err(|failure| of_chunk(failure, input, chunk, &field))
}

/// Creates the error of a chunk.
fn of_chunk(failure: Failure, input: &Input, chunk: &Chunk, field: &str) -> Error {
    match failure {
        Failure::Damaged(damage) => input.bad(chunk.address, field, damage, COPY_AGAIN),
        Failure::OutOfMemory => Error::io(input.path(), "read")(ErrorKind::OutOfMemory.into()),
    }
}

#[cfg(test)]
mod tests {
    use std::path::{Path, PathBuf};

    use super::*;
    use crate::group::links;
    use crate::superblock;

    fn open(name: &str) -> Result<(Input, Dataset)> {
        let path: PathBuf = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/odd_data_sets.h5");
        let mut input = Input::open(&path)?;
        let root = superblock::root(&mut input)?;
        let (_, at) = links(&input, root)?.into_iter().find(|(link, _)| link == name).unwrap();
        let dataset = Dataset::open(&input, name, at)?;
        Ok((input, dataset))
    }

    #[test]
    fn unsupported_data_sets_are_named_with_their_reason() {
        for (name, expected) in [
            ("text", "text: data type: numbers expected, but this is text; rewrite the file with `h5repack"),
            ("compound", "numbers expected, but this is compound"),
            ("half", "unusual number of 2 bytes"),
            ("volume", "3 dimensions, only 1 and 2 are supported"),
            ("shared_type", "missing: this is no data set"),
            ("of_shared_type", "shared between objects"),
            ("lzf", "filter 32000 lzf is not supported"),
            ("large_chunks", "80000000 bytes in a chunk, at most 67108864"),
            ("wide", "80000000 bytes in a row of chunks, at most 67108864"),
            ("sideways", "rows that grow are not supported"),
            ("external", "data in other files are not supported"),
            ("virtual", "virtual data sets are not supported"),
        ] {
            let text = open(name).err().map(|error| error.to_string()).unwrap_or_default();
            assert!(text.contains("odd_data_sets.h5: byte "), "{name}: {text}");
            assert!(text.contains(&format!("{name}: ")) && text.contains(expected), "{name}: {text}");
        }
    }

    #[test]
    fn numbers_of_every_type_are_converted() {
        for kind in ["i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f4", "f8"] {
            for order in ["l", "b"] {
                let (input, mut dataset) = open(&format!("number_{order}{kind}")).unwrap();
                let first = if kind.starts_with('u') { 0.0 } else { -7.0 };
                let decoder = &mut Decoder::new();
                let mut samples = vec![5.0];
                dataset.append_f32(&input, decoder, 0..3, &mut samples).unwrap();
                assert_eq!(samples, [5.0, first, 100.0, 3.0], "{kind}");
                assert_eq!(dataset.f64_at(&input, decoder, 0).unwrap(), f64::from(first));
                assert_eq!(dataset.u64_at(&input, decoder, 1).unwrap(), Some(100));
                assert_eq!(
                    dataset.u64_at(&input, decoder, 0).unwrap(),
                    (first == 0.0).then_some(0),
                    "{kind}"
                );
            }
        }
        let (input, mut dataset) = open("fractions").unwrap();
        let found = [0, 1, 2].map(|index| dataset.u64_at(&input, &mut Decoder::new(), index).unwrap());
        assert_eq!(found, [None, None, Some(3)]);
    }

    #[test]
    fn elements_beyond_the_end_take_no_memory() {
        let (input, mut dataset) = open("edges").unwrap();
        let (decoder, mut samples) = (&mut Decoder::new(), Vec::new());
        dataset.append_f32(&input, decoder, 2..7, &mut samples).unwrap();
        assert_eq!(samples, [2.0, 3.0, 4.0, 5.0, 6.0]);
        let error = dataset.append_f32(&input, decoder, 2..1 << 60, &mut Vec::new()).unwrap_err().to_string();
        assert!(
            error.contains("edges: element 1152921504606846976 is needed, it has 7; the file is damaged")
        );
    }

    #[test]
    fn missing_memory_is_no_damage() {
        let (input, _) = open("edges").unwrap();
        let chunk = Chunk { number: 3, address: 9, stored_bytes: 4, skipped_filters: 0 };
        let text = |failure| of_chunk(failure, &input, &chunk, "chunk 3").to_string();
        assert!(text(Failure::OutOfMemory).contains("odd_data_sets.h5: cannot read: out of memory"));
        assert!(
            text(Failure::Damaged("cut"))
                .contains("odd_data_sets.h5: byte 9: chunk 3: cut; the file is damaged")
        );
    }

    #[test]
    fn sizes_that_overflow_are_refused() {
        let sound =
            std::fs::read(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/odd_data_sets.h5")).unwrap();
        // Dataspace of `wide`.
        let shape: Vec<u8> = [1000_u64, 20_000].into_iter().flat_map(u64::to_le_bytes).collect();
        let at = sound.windows(16).position(|bytes| bytes == shape).unwrap();
        let mut bytes = sound;
        bytes[at..at + 16].fill(0x7f);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("f.h5");
        std::fs::write(&path, bytes).unwrap();
        let mut input = Input::open(&path).unwrap();
        let root = superblock::root(&mut input).unwrap();
        let (_, at) = links(&input, root).unwrap().into_iter().find(|(link, _)| link == "wide").unwrap();
        let error = Dataset::open(&input, "wide", at).err().unwrap().to_string();
        assert!(error.contains("wide: dataspace: impossible size"), "{error}");
    }
}
