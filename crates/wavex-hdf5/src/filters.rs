//! Filters of stored chunks: deflate, shuffle, and the checksum Fletcher-32.

use flate2::{Decompress, FlushDecompress, Status};
use wavex_formats::bytes::Fields;

use super::input::{self, REPACK};

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

/// Reason why a chunk cannot be decoded.
#[derive(Debug, PartialEq)]
pub enum Failure {
    /// The chunk is damaged: description.
    Damaged(&'static str),
    /// There is not enough memory.
    OutOfMemory,
}

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
    /// If the chunk is damaged, or there is not enough memory.
    pub fn decode(&mut self, filters: &[Filter], skipped: u32, sizes: Sizes) -> Result<&[u8], Failure> {
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
                Filter::Deflate => self.inflate(if all { whole } else { sizes.needed }, whole)?,
                Filter::Shuffle => {
                    let shuffled = self.stored.get(..whole).ok_or(SHORT)?;
                    resize(&mut self.spare, if all { whole } else { sizes.needed })?;
                    unshuffle(shuffled, sizes.number, &mut self.spare);
                }
            }
            std::mem::swap(&mut self.stored, &mut self.spare);
        }
        self.stored.get(..sizes.needed).ok_or(SHORT)
    }

    /// Inflates the first `length` bytes into the spare buffer.
    fn inflate(&mut self, length: usize, whole: usize) -> Result<(), Failure> {
        // Deflate makes data at most 1032 times smaller: no memory for a chunk that cannot be so large.
        if length / 1032 > self.stored.len() {
            return Err(SHORT);
        }
        self.inflate.reset(true);
        resize(&mut self.spare, length)?;
        let status = self.inflate.decompress(&self.stored, &mut self.spare, FlushDecompress::Finish);
        let status = status.map_err(|_| DAMAGED)?;
        if self.inflate.total_out() < length as u64 {
            return Err(DAMAGED);
        }
        if length == whole && status != Status::StreamEnd {
            // The end of the stream has its checksum.
            let rest = self.stored.get(self.inflate.total_in() as usize..).unwrap_or(&[]);
            self.inflate.decompress(rest, &mut [], FlushDecompress::Finish).map_err(|_| DAMAGED)?;
        }
        Ok(())
    }
}

const SHORT: Failure = Failure::Damaged("shorter than the chunk's size");
const DAMAGED: Failure = Failure::Damaged("its compressed data are damaged");

/// Changes the length of a buffer.
fn resize(bytes: &mut Vec<u8>, length: usize) -> Result<(), Failure> {
    input::resize(bytes, length).map_err(|_| Failure::OutOfMemory)
}

/// Puts the bytes of the first numbers together.
fn unshuffle(shuffled: &[u8], number_bytes: usize, numbers: &mut [u8]) {
    let count = shuffled.len() / number_bytes;
    match number_bytes {
        2 => interleave::<2>(shuffled, count, numbers),
        4 => interleave::<4>(shuffled, count, numbers),
        8 => interleave::<8>(shuffled, count, numbers),
        1 => numbers.copy_from_slice(&shuffled[..numbers.len()]),
        _ => {
            for (index, record) in numbers.chunks_exact_mut(number_bytes).enumerate().take(count) {
                let planes = shuffled.chunks_exact(count);
                record.iter_mut().zip(planes).for_each(|(byte, plane)| *byte = plane[index]);
            }
        }
    }
    // Bytes after the last number, which belong to a checksum, are not shuffled.
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
fn check_sum(stored: &mut Vec<u8>) -> Result<(), Failure> {
    let (data, expected) = stored.split_last_chunk::<4>().ok_or(SHORT)?;
    if fletcher32(data) != u32::from_le_bytes(*expected) {
        return Err(Failure::Damaged("its checksum is wrong"));
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

#[cfg(test)]
mod tests {
    use std::io::Write;

    use flate2::Compression;
    use flate2::write::ZlibEncoder;

    use super::*;

    const SIZES: Sizes = Sizes { chunk: 24, number: 4, needed: 24 };

    fn numbers() -> Vec<u8> {
        (0..6_u32).flat_map(|number| (number * 0x0102_0304).to_le_bytes()).collect()
    }

    fn deflated(bytes: &[u8]) -> Vec<u8> {
        let mut encoder = ZlibEncoder::new(Vec::new(), Compression::default());
        encoder.write_all(bytes).unwrap();
        encoder.finish().unwrap()
    }

    fn with_sum(bytes: &[u8]) -> Vec<u8> {
        [bytes, &fletcher32(bytes).to_le_bytes()].concat()
    }

    /// Bytes after the last whole number stay in their place.
    fn shuffled(bytes: &[u8]) -> Vec<u8> {
        let (numbers, rest) = bytes.as_chunks::<4>();
        let planes = (0..4).flat_map(|byte| numbers.iter().map(move |number| number[byte]));
        planes.chain(rest.iter().copied()).collect()
    }

    fn decode(filters: &[Filter], skipped: u32, stored: Vec<u8>, needed: usize) -> Result<Vec<u8>, Failure> {
        let mut decoder = Decoder { stored, ..Decoder::new() };
        decoder.decode(filters, skipped, Sizes { needed, ..SIZES }).map(<[u8]>::to_vec)
    }

    #[test]
    fn filters_are_undone_in_any_usual_order() {
        use Filter::{Deflate, Fletcher32, Shuffle};
        let numbers = numbers();
        let cases: &[(&[Filter], Vec<u8>)] = &[
            (&[], numbers.clone()),
            (&[Deflate], deflated(&numbers)),
            (&[Shuffle, Deflate], deflated(&shuffled(&numbers))),
            (&[Shuffle, Deflate, Fletcher32], with_sum(&deflated(&shuffled(&numbers)))),
            (&[Fletcher32, Shuffle, Deflate], deflated(&shuffled(&with_sum(&numbers)))),
            (&[Shuffle, Fletcher32, Deflate], deflated(&with_sum(&shuffled(&numbers)))),
        ];
        for (filters, stored) in cases {
            for needed in [24, 12, 4] {
                let found = decode(filters, 0, stored.clone(), needed).unwrap();
                assert_eq!(found, numbers[..needed], "{filters:?}");
            }
        }
        // Deflate was not worth it, and was skipped.
        let skipped = decode(&[Shuffle, Deflate], 2, shuffled(&numbers), 24);
        assert_eq!(skipped.unwrap(), numbers);
    }

    #[test]
    fn numbers_of_every_size_are_unshuffled() {
        for bytes in [1, 2, 8] {
            let shuffled: Vec<u8> = (0..16).collect();
            let mut numbers = [0; 16];
            unshuffle(&shuffled, bytes, &mut numbers);
            let expected = (0..16).map(|at| ((at % bytes) * (16 / bytes) + at / bytes) as u8);
            assert!(expected.eq(numbers), "{bytes} bytes: {numbers:?}");
        }
    }

    #[test]
    fn fletcher_sums_big_endian_words() {
        // Words 0x0102 and 0x0300.
        assert_eq!(fletcher32(&[1, 2, 3]), 0x0504_0402);
        // 65535 is 0, but no sum is reduced to 0.
        assert_eq!(fletcher32(&[0xff; 4]), 0xffff_ffff);
    }

    #[test]
    fn sizes_between_filters_must_be_known() {
        let message = |ids: [u8; 2]| {
            let mut bytes = vec![2, 2];
            ids.into_iter().for_each(|id| bytes.extend([id, 0, 0, 0, 0, 0]));
            let text = read(&mut Fields::new(std::path::Path::new("f.h5"), 0, &bytes))
                .map_err(|error| error.to_string());
            text.err().unwrap_or_default()
        };
        assert_eq!(message([2, 1]), "");
        for ids in [[1, 1], [1, 2]] {
            assert!(message(ids).contains("f.h5: byte 8: filters: unusual order of filters; rewrite"));
        }
    }

    #[test]
    fn damage_is_reported_before_memory_is_taken() {
        use Filter::{Deflate, Fletcher32, Shuffle};
        let numbers = numbers();
        assert_eq!(decode(&[], 0, numbers[..20].to_vec(), 24), Err(SHORT));
        assert_eq!(decode(&[Shuffle], 0, numbers[..20].to_vec(), 24), Err(SHORT));
        assert_eq!(decode(&[Fletcher32], 0, vec![1, 2], 24), Err(SHORT));
        assert_eq!(decode(&[Deflate], 0, deflated(&numbers[..20]), 24), Err(DAMAGED));
        let mut wrong_end = deflated(&numbers);
        *wrong_end.last_mut().unwrap() ^= 1;
        assert_eq!(decode(&[Deflate], 0, wrong_end.clone(), 24), Err(DAMAGED));
        // The end is not read if the beginning is enough.
        assert_eq!(decode(&[Deflate], 0, wrong_end, 20).unwrap(), numbers[..20]);

        let mut decoder = Decoder { stored: vec![0x78; 100], ..Decoder::new() };
        let sizes = Sizes { chunk: 1 << 40, number: 4, needed: 1 << 40 };
        assert_eq!(decoder.decode(&[Deflate], 0, sizes), Err(SHORT));
        assert_eq!(decoder.spare.capacity(), 0);
        assert_eq!(resize(&mut Vec::new(), usize::MAX), Err(Failure::OutOfMemory));
    }
}
