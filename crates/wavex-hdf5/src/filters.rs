//! Filters of stored chunks: deflate, shuffle, and the checksum Fletcher-32.

use flate2::{Decompress, FlushDecompress, Status};
use wavex_formats::bytes::Fields;

use super::input::REPACK;

/// A filter of a chunk, in the order in which a writer applies them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Filter {
    Deflate,
    /// The bytes of all numbers are ordered by significance.
    Shuffle,
    Fletcher32,
}

/// Reads a message of filters.
///
/// # Errors
/// If one is not supported.
pub fn read(fields: &mut Fields) -> wavex_formats::Result<Vec<Filter>> {
    let field = "filters";
    let version = fields.u8(field)?;
    let count = fields.u8(field)?;
    fields.skip(if version == 1 { 6 } else { 0 }, field)?;
    let mut filters = Vec::new();
    for _ in 0..count {
        let before = fields.clone();
        let id = fields.u16(field)?;
        let has_name = version == 1 || id >= 256;
        let name_bytes = if has_name { usize::from(fields.u16(field)?) } else { 0 };
        fields.skip(2, field)?;
        let values = usize::from(fields.u16(field)?);
        let padding = if version == 1 { name_bytes.next_multiple_of(8) - name_bytes } else { 0 };
        let name = fields.text(name_bytes, field)?;
        let value_padding = if version == 1 { values % 2 } else { 0 };
        fields.skip(padding + 4 * (values + value_padding), field)?;
        let filter = match id {
            1 => Filter::Deflate,
            2 => Filter::Shuffle,
            3 => Filter::Fletcher32,
            _ => return Err(before.bad(field, format!("filter {id} {name} is not supported"), REPACK)),
        };
        // Compressed twice, or shuffled after compression: sizes in between are unknown.
        if filters.contains(&filter) || filter == Filter::Shuffle && filters.contains(&Filter::Deflate) {
            return Err(before.bad(field, "unusual order of filters", REPACK));
        }
        filters.push(filter);
    }
    Ok(filters)
}

/// Sizes of a chunk in bytes.
#[derive(Clone, Copy)]
pub struct Sizes {
    /// The chunk without filters.
    pub chunk: usize,
    /// One number.
    pub number: usize,
    /// The part at the beginning that is needed.
    pub needed: usize,
}

/// Decodes chunks; its buffers are used again.
pub struct Decoder {
    /// Stored bytes of a chunk; see [`Decoder::decode`].
    pub stored: Vec<u8>,
    inflate: Decompress,
    spare: Vec<u8>,
}

/// Description of the damage of a chunk.
pub type Damage = &'static str;

impl Decoder {
    /// Creates a decoder.
    pub fn new() -> Decoder {
        Decoder { stored: Vec::new(), inflate: Decompress::new(true), spare: Vec::new() }
    }

    /// Decodes the stored bytes of a chunk and returns the needed ones.
    ///
    /// Bit i of `skipped` says that filter i was not applied.
    ///
    /// # Errors
    /// If the chunk is damaged.
    pub fn decode(&mut self, filters: &[Filter], skipped: u32, sizes: Sizes) -> Result<&[u8], Damage> {
        let applied = |&(index, _): &(usize, &Filter)| skipped >> index & 1 == 0;
        let applied = || filters.iter().enumerate().filter(applied).map(|(_, &filter)| filter);
        for (index, filter) in applied().enumerate().collect::<Vec<_>>().into_iter().rev() {
            let before = || applied().take(index);
            // A checksum applied before needs all bytes, and shuffling moves the first numbers over the chunk.
            let sums = before().filter(|&filter| filter == Filter::Fletcher32).count();
            let whole = sizes.chunk + 4 * sums;
            let all = sums > 0 || before().any(|filter| filter == Filter::Shuffle);
            match filter {
                Filter::Fletcher32 => {
                    check_sum(&mut self.stored)?;
                    continue;
                }
                Filter::Deflate => self.inflate(if all { whole } else { sizes.needed })?,
                Filter::Shuffle => {
                    let shuffled = self.stored.get(..whole).ok_or(SHORT)?;
                    self.spare.resize(if all { whole } else { sizes.needed }, 0);
                    unshuffle(shuffled, sizes.number, &mut self.spare);
                }
            }
            std::mem::swap(&mut self.stored, &mut self.spare);
        }
        self.stored.get(..sizes.needed).ok_or(SHORT)
    }

    /// Inflates into the spare buffer.
    fn inflate(&mut self, length: usize) -> Result<(), Damage> {
        // Deflate makes data at most 1032 times smaller: nothing is allocated for a chunk that cannot be so large.
        if length / 1032 > self.stored.len() {
            return Err(SHORT);
        }
        self.inflate.reset(true);
        self.spare.resize(length, 0);
        let status = self.inflate.decompress(&self.stored, &mut self.spare, FlushDecompress::Finish);
        let status = status.map_err(|_| DAMAGED)?;
        if self.inflate.total_out() < length as u64 {
            return Err(DAMAGED);
        }
        if status != Status::StreamEnd {
            // Reads the checksum, if the data end here.
            let rest = self.stored.get(self.inflate.total_in() as usize..).unwrap_or(&[]);
            self.inflate.decompress(rest, &mut [], FlushDecompress::Finish).map_err(|_| DAMAGED)?;
        }
        Ok(())
    }
}

const SHORT: Damage = "shorter than the chunk's size";
const DAMAGED: Damage = "its compressed data are damaged";

/// Puts the bytes of the first numbers together.
fn unshuffle(shuffled: &[u8], number_bytes: usize, numbers: &mut [u8]) {
    let count = shuffled.len() / number_bytes;
    match number_bytes {
        2 => interleave::<2>(shuffled, count, numbers),
        4 => interleave::<4>(shuffled, count, numbers),
        8 => interleave::<8>(shuffled, count, numbers),
        _ => numbers.copy_from_slice(&shuffled[..numbers.len()]),
    }
    // Bytes behind the last number, which belong to a checksum, are not shuffled.
    let end = numbers.len();
    if let Some(rest) = numbers.get_mut(count * number_bytes..) {
        rest.copy_from_slice(&shuffled[count * number_bytes..end]);
    }
}

fn interleave<const N: usize>(shuffled: &[u8], count: usize, numbers: &mut [u8]) {
    let planes: [&[u8]; N] = std::array::from_fn(|byte| &shuffled[byte * count..][..count]);
    let (numbers, _) = numbers.as_chunks_mut::<N>();
    for (index, number) in numbers.iter_mut().enumerate() {
        *number = std::array::from_fn(|byte| planes[byte][index]);
    }
}

/// Checks and removes the checksum at the end of a chunk.
fn check_sum(stored: &mut Vec<u8>) -> Result<(), Damage> {
    let (data, expected) = stored.split_last_chunk::<4>().ok_or(SHORT)?;
    if fletcher32(data) != u32::from_le_bytes(*expected) {
        return Err("its checksum is wrong");
    }
    let length = data.len();
    stored.truncate(length);
    Ok(())
}

/// Computes the checksum Fletcher-32 of HDF5: sums of big-endian words modulo 65535.
fn fletcher32(data: &[u8]) -> u32 {
    let (mut first, mut second) = (0_u32, 0_u32);
    let fold = |sum: u32| (sum & 0xffff) + (sum >> 16);
    let (words, rest) = data.as_chunks::<2>();
    // 360 words do not overflow the second sum.
    for words in words.chunks(360) {
        for &word in words {
            first += u32::from(u16::from_be_bytes(word));
            second += first;
        }
        (first, second) = (fold(first), fold(second));
    }
    if let [last] = rest {
        first += u32::from(*last) << 8;
        second += first;
    }
    (first, second) = (fold(fold(first)), fold(fold(second)));
    second << 16 | first
}
