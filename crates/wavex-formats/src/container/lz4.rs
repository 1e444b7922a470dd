//! Decompresses LZ4 frames to a known length (LZ4 Frame Format 1.6.4, LZ4 Block Format).
//!
//! A column of one value is a single match that repeats the bytes just written. This decoder copies
//! such runs in pieces of doubling size.

use super::xxh32::xxh32;

const MAGIC: [u8; 4] = [0x04, 0x22, 0x4d, 0x18];

/// Bits of the first byte of a frame (section "Frame Descriptor").
mod flag {
    pub(super) const VERSION: u8 = 0b1100_0000;
    pub(super) const VERSION_1: u8 = 0b0100_0000;
    pub(super) const INDEPENDENT_BLOCKS: u8 = 1 << 5;
    pub(super) const BLOCK_CHECKSUMS: u8 = 1 << 4;
    pub(super) const CONTENT_SIZE: u8 = 1 << 3;
    pub(super) const CONTENT_CHECKSUM: u8 = 1 << 2;
    pub(super) const RESERVED: u8 = 1 << 1;
    pub(super) const DICTIONARY: u8 = 1;
}

/// Bit of a block's length for an uncompressed block.
const PLAIN: u32 = 1 << 31;

/// Minimum length of a match.
const MIN_MATCH: usize = 4;

/// Decompresses the frame at the start of `packed`, which must fill `out` exactly.
///
/// # Errors
/// The problem of the frame.
pub(super) fn unpack(packed: &[u8], out: &mut [u8]) -> Result<(), &'static str> {
    let (flags, mut rest) = descriptor(packed)?;
    let mut at = 0;
    loop {
        let length = u32::from_le_bytes(take(&mut rest).ok_or(CUT_OFF)?);
        if length == 0 {
            break;
        }
        let (block, behind) = rest.split_at_checked((length & !PLAIN) as usize).ok_or(CUT_OFF)?;
        rest = behind;
        if flags & flag::BLOCK_CHECKSUMS != 0 {
            check(block, &mut rest)?;
        }
        // Matches refer to previous blocks unless blocks are independent.
        let first = if flags & flag::INDEPENDENT_BLOCKS != 0 { at } else { 0 };
        at = match length & PLAIN {
            0 => unpack_block(block, out, at, first)
                .ok_or("an LZ4 block is damaged, or longer than it is said to be")?,
            _ => copy_plain(block, out, at).ok_or(TOO_LONG)?,
        };
    }
    if at != out.len() {
        return Err("an LZ4 frame is shorter than it is said to be");
    }
    if flags & flag::CONTENT_CHECKSUM != 0 {
        check(out, &mut rest)?;
    }
    Ok(())
}

const CUT_OFF: &str = "an LZ4 frame is cut off";
const TOO_LONG: &str = "an LZ4 frame is longer than it is said to be";

/// Parses a frame's descriptor; returns its flags and the remaining bytes.
fn descriptor(packed: &[u8]) -> Result<(u8, &[u8]), &'static str> {
    let mut rest = packed.strip_prefix(&MAGIC).ok_or("no LZ4 frame")?;
    let start = rest;
    let [flags, _largest_block] = take(&mut rest).ok_or(CUT_OFF)?;
    if flags & flag::VERSION != flag::VERSION_1 || flags & (flag::RESERVED | flag::DICTIONARY) != 0 {
        return Err("an LZ4 frame of an unknown kind");
    }
    if flags & flag::CONTENT_SIZE != 0 {
        take::<8>(&mut rest).ok_or(CUT_OFF)?;
    }
    let described = start.get(..start.len() - rest.len()).unwrap_or_default();
    let [checksum] = take(&mut rest).ok_or(CUT_OFF)?;
    if checksum != (xxh32(described) >> 8) as u8 {
        return Err("the checksum of an LZ4 frame's descriptor is wrong");
    }
    Ok((flags, rest))
}

/// Checks that the next four bytes of `rest` are the checksum of `bytes`.
fn check(bytes: &[u8], rest: &mut &[u8]) -> Result<(), &'static str> {
    let checksum = u32::from_le_bytes(take(rest).ok_or(CUT_OFF)?);
    if checksum == xxh32(bytes) { Ok(()) } else { Err("a checksum of an LZ4 frame is wrong") }
}

/// Removes and returns the next `N` bytes.
fn take<const N: usize>(rest: &mut &[u8]) -> Option<[u8; N]> {
    let (taken, behind) = rest.split_first_chunk::<N>()?;
    *rest = behind;
    Some(*taken)
}

/// Copies an uncompressed block to `out[at..]` and returns its end.
fn copy_plain(block: &[u8], out: &mut [u8], at: usize) -> Option<usize> {
    let end = at.checked_add(block.len())?;
    out.get_mut(at..end)?.copy_from_slice(block);
    Some(end)
}

/// Decompresses a block to `out[at..]` and returns its end.
///
/// Literals and matches alternate, ending with literals. Matches start at `out[first]` or later.
/// `None` if the block is inconsistent or exceeds `out`.
fn unpack_block(block: &[u8], out: &mut [u8], mut at: usize, first: usize) -> Option<usize> {
    let mut next = 0;
    loop {
        let token = *block.get(next)?;
        next += 1;
        let literals = length(usize::from(token >> 4), block, &mut next)?;
        copy_literals(block, next, out, at, literals)?;
        (next, at) = (next + literals, at + literals);
        if next == block.len() {
            return Some(at);
        }
        let back = usize::from(u16::from_le_bytes(*block.get(next..)?.first_chunk()?));
        next += 2;
        let matched = MIN_MATCH + length(usize::from(token & 15), block, &mut next)?;
        if back == 0 || back > at - first {
            return None;
        }
        copy_match(out, at, back, matched)?;
        at += matched;
    }
}

/// Reads a length with the first four bits `start`.
///
/// If all bits are set, the following bytes are added up to the first that is not 255.
#[inline(always)]
fn length(start: usize, block: &[u8], next: &mut usize) -> Option<usize> {
    let mut length = start;
    if start == 15 {
        loop {
            let more = *block.get(*next)?;
            *next += 1;
            length += usize::from(more);
            if more != 255 {
                break;
            }
        }
    }
    Some(length)
}

/// Bytes copied at once if there is room; excess bytes are overwritten later.
const PIECE: usize = 16;

#[inline(always)]
fn copy_literals(block: &[u8], from: usize, out: &mut [u8], at: usize, count: usize) -> Option<()> {
    if count <= PIECE
        && let Some(piece) = block.get(from..).and_then(|rest| rest.first_chunk::<PIECE>())
        && let Some(to) = out.get_mut(at..).and_then(|rest| rest.first_chunk_mut::<PIECE>())
    {
        *to = *piece;
        return Some(());
    }
    let literals = block.get(from..from.checked_add(count)?)?;
    out.get_mut(at..at.checked_add(count)?)?.copy_from_slice(literals);
    Some(())
}

/// Copies to `out[at..]` from `back` bytes before.
///
/// `back` is at least 1 and at most `at`.
#[inline(always)]
fn copy_match(out: &mut [u8], at: usize, back: usize, count: usize) -> Option<()> {
    let from = at - back;
    if count <= 8 && back >= 8 && at + 8 <= out.len() {
        copy_piece::<8>(out, from, at);
        return Some(());
    }
    if count <= 2 * PIECE && at + 2 * PIECE <= out.len() {
        if back >= PIECE {
            copy_piece::<PIECE>(out, from, at);
            copy_piece::<PIECE>(out, from + PIECE, at + PIECE);
            return Some(());
        }
        if back >= 8 {
            (0..4).for_each(|i| copy_piece::<8>(out, from + 8 * i, at + 8 * i));
            return Some(());
        }
    }
    let end = at.checked_add(count).filter(|&end| end <= out.len())?;
    // The run written so far doubles with each piece.
    let mut done = at;
    while done < end {
        let piece = (done - from).min(end - done);
        out.copy_within(from..from + piece, done);
        done += piece;
    }
    Some(())
}

/// Copies `N` bytes within `out`, if all are in bounds.
#[inline(always)]
fn copy_piece<const N: usize>(out: &mut [u8], from: usize, to: usize) {
    let piece: Option<[u8; N]> = out.get(from..).and_then(|rest| rest.first_chunk()).copied();
    let place = out.get_mut(to..).and_then(|rest| rest.first_chunk_mut::<N>());
    if let (Some(piece), Some(place)) = (piece, place) {
        *place = piece;
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Frame of independent, uncompressed blocks without checksums.
    fn frame(blocks: &[(u32, &[u8])]) -> Vec<u8> {
        let descriptor = [flag::VERSION_1 | flag::INDEPENDENT_BLOCKS, 0x40];
        let mut bytes = [&MAGIC[..], &descriptor, &[(xxh32(&descriptor) >> 8) as u8]].concat();
        for (plain, block) in blocks {
            bytes.extend((plain | block.len() as u32).to_le_bytes());
            bytes.extend(*block);
        }
        bytes.extend([0; 4]);
        bytes
    }

    fn unpacked(packed: &[u8], size: usize) -> Result<Vec<u8>, &'static str> {
        let mut out = vec![0xee; size];
        unpack(packed, &mut out).map(|()| out)
    }

    #[test]
    fn literals_and_matches_alternate() {
        // Three literals, a match of 4 from 3 before, a match of 5 from 1 before with one literal,
        // two literals.
        let block = [0x30, b'a', b'b', b'c', 3, 0, 0x11, b'd', 1, 0, 0x20, b'e', b'f'];
        assert_eq!(unpacked(&frame(&[(0, &block)]), 15).unwrap(), b"abcabcaddddddef");
        assert_eq!(unpacked(&frame(&[(PLAIN, b"plain"), (0, &block)]), 20).unwrap(), b"plainabcabcaddddddef");
    }

    #[test]
    fn a_run_repeats_what_it_has_just_written() {
        for (back, count) in
            [(1, 4), (1, 18), (2, 19), (3, 300), (8, 500), (9, 31), (16, 32), (17, 5000), (40, 7)]
        {
            let start: Vec<u8> = (0..back as u8).map(|i| i * 3 + 1).collect();
            let mut block = Vec::new();
            let long = |block: &mut Vec<u8>, mut more: usize| {
                while more >= 255 {
                    block.push(255);
                    more -= 255;
                }
                block.push(more as u8);
            };
            block.push((back.min(15) << 4) as u8 | (count - MIN_MATCH).min(15) as u8);
            if back >= 15 {
                long(&mut block, back - 15);
            }
            block.extend(&start);
            block.extend((back as u16).to_le_bytes());
            if count - MIN_MATCH >= 15 {
                long(&mut block, count - MIN_MATCH - 15);
            }
            block.extend([0x10, b'!']);
            let mut expected: Vec<u8> = start.iter().copied().cycle().take(back + count).collect();
            expected.push(b'!');
            assert_eq!(unpacked(&frame(&[(0, &block)]), expected.len()).unwrap(), expected, "{back} {count}");
        }
    }

    #[test]
    fn linked_blocks_reach_back_and_checksums_are_checked() {
        let flags = flag::VERSION_1 | flag::BLOCK_CHECKSUMS | flag::CONTENT_SIZE | flag::CONTENT_CHECKSUM;
        let descriptor = [&[flags, 0x40][..], &10_u64.to_le_bytes()].concat();
        let mut whole = [&MAGIC[..], &descriptor, &[(xxh32(&descriptor) >> 8) as u8]].concat();
        for block in [&[0x50, b'0', b'1', b'2', b'3', b'4'][..], &[0x00, 5, 0, 0x10, b'x']] {
            whole.extend((block.len() as u32).to_le_bytes());
            whole.extend(block);
            whole.extend(xxh32(block).to_le_bytes());
        }
        whole.extend([0; 4]);
        whole.extend(xxh32(b"012340123x").to_le_bytes());
        assert_eq!(unpacked(&whole, 10).unwrap(), b"012340123x");
        let last = whole.len() - 1;
        for (at, problem) in [
            (14, "the checksum of an LZ4 frame's descriptor is wrong"),
            (22, "a checksum of an LZ4 frame is wrong"),
            (last, "a checksum of an LZ4 frame is wrong"),
        ] {
            let mut bytes = whole.clone();
            bytes[at] ^= 1;
            assert_eq!(unpacked(&bytes, 10).unwrap_err(), problem, "{at}");
        }
        for end in 4..whole.len() {
            assert_eq!(unpacked(&whole[..end], 10).unwrap_err(), CUT_OFF, "{end}");
        }
    }

    #[test]
    fn what_is_no_frame_is_refused() {
        let damaged = "an LZ4 block is damaged, or longer than it is said to be";
        for (packed, size, problem) in [
            (b"\x04\x22\x4d\x19".to_vec(), 0, "no LZ4 frame"),
            ([&MAGIC[..], &[0xa0, 0x40, 0]].concat(), 0, "an LZ4 frame of an unknown kind"),
            (frame(&[(PLAIN, b"plain")]), 4, TOO_LONG),
            (frame(&[(PLAIN, b"plain")]), 6, "an LZ4 frame is shorter than it is said to be"),
            (frame(&[(0, &[0x50, b'a'])]), 5, damaged),
            // A match before the first byte, one from nowhere, one without its offset, one past the
            // end.
            (frame(&[(0, &[0x10, b'a', 2, 0, 0x10, b'b'])]), 6, damaged),
            (frame(&[(0, &[0x10, b'a', 0, 0, 0x10, b'b'])]), 6, damaged),
            (frame(&[(0, &[0x10, b'a', 1])]), 6, damaged),
            (frame(&[(0, &[0x1f, b'a', 1, 0, 100, 0x10, b'b'])]), 50, damaged),
            // An independent block that refers to the previous one.
            (frame(&[(PLAIN, b"plain"), (0, &[0x00, 5, 0, 0x10, b'b'])]), 10, damaged),
        ] {
            assert_eq!(unpacked(&packed, size).unwrap_err(), problem);
        }
    }

    /// Decompresses a block byte by byte, as in the format's description.
    ///
    /// `None` if the block is inconsistent.
    fn plainly(block: &[u8], size: usize) -> Option<Vec<u8>> {
        let mut bytes = block.iter().map(|&byte| usize::from(byte));
        let mut out = Vec::new();
        loop {
            let token = bytes.next()?;
            let long = |start: usize, bytes: &mut dyn Iterator<Item = usize>| {
                let (mut length, mut more) = (start, if start == 15 { 255 } else { 0 });
                while more == 255 {
                    more = bytes.next()?;
                    length += more;
                }
                Some(length)
            };
            for _ in 0..long(token >> 4, &mut bytes)? {
                out.push(bytes.next()? as u8);
            }
            if bytes.len() == 0 {
                return (out.len() == size).then_some(out);
            }
            let back = bytes.next()? + 256 * bytes.next()?;
            for _ in 0..MIN_MATCH + long(token & 15, &mut bytes)? {
                let repeated = out.len().checked_sub(back).filter(|_| back > 0)?;
                out.push(out[repeated]);
            }
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]

        /// For mostly valid sequences, the fast copies give the result of the description.
        #[test]
        fn a_block_is_unpacked_as_described(
            sequences in prop::collection::vec((0usize..40, 1u16..60, 0usize..80), 0..30),
            last in 0usize..20,
            off in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..2),
            size_off in 0usize..3,
        ) {
            let mut block = Vec::new();
            let mut size = last;
            let more = |block: &mut Vec<u8>, length: usize| {
                if length >= 15 {
                    block.push((length - 15) as u8);
                }
            };
            for (literals, back, matched) in sequences {
                block.push((literals.min(15) << 4) as u8 | matched.min(15) as u8);
                more(&mut block, literals);
                block.extend((0..literals).map(|i| (i * 7 + size) as u8));
                block.extend(back.to_le_bytes());
                more(&mut block, matched);
                size += literals + matched + MIN_MATCH;
            }
            block.push((last.min(15) << 4) as u8);
            more(&mut block, last);
            block.extend((0..last).map(|i| i as u8));
            for (index, byte) in off {
                let at = index.index(block.len());
                block[at] = byte;
            }
            let size = size + size_off;
            let mut out = vec![0; size];
            let end = unpack_block(&block, &mut out, 0, 0);
            prop_assert_eq!(end.filter(|&end| end == size).map(|_| out), plainly(&block, size));
        }
    }
}
