//! Decompresses LZ4 frames to a known length (LZ4 Frame Format 1.6.4).
//!
//! `lz4_flex` decompresses the blocks, directly to their destination. Its own reader of frames copies
//! each block twice and allocates buffers for each frame: it takes twice the time of this one.

use lz4_flex::block::decompress_into_with_dict;
use twox_hash::XxHash32;

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
        let (block, after) = rest.split_at_checked((length & !PLAIN) as usize).ok_or(CUT_OFF)?;
        rest = after;
        if flags & flag::BLOCK_CHECKSUMS != 0 {
            check(block, &mut rest)?;
        }
        let (before, room) = out.split_at_mut(at);
        at += if length & PLAIN != 0 {
            room.get_mut(..block.len()).ok_or(TOO_LONG)?.copy_from_slice(block);
            block.len()
        } else {
            // Matches refer to previous blocks unless blocks are independent.
            let dictionary = if flags & flag::INDEPENDENT_BLOCKS != 0 { &[] } else { &*before };
            decompress_into_with_dict(block, room, dictionary).map_err(|_| DAMAGED)?
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
const DAMAGED: &str = "an LZ4 block is damaged, or longer than it is said to be";

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
    if checksum != (XxHash32::oneshot(0, described) >> 8) as u8 {
        return Err("the checksum of an LZ4 frame's descriptor is wrong");
    }
    Ok((flags, rest))
}

/// Checks that the next four bytes of `rest` are the checksum of `bytes`.
fn check(bytes: &[u8], rest: &mut &[u8]) -> Result<(), &'static str> {
    let checksum = u32::from_le_bytes(take(rest).ok_or(CUT_OFF)?);
    if checksum == XxHash32::oneshot(0, bytes) { Ok(()) } else { Err("a checksum of an LZ4 frame is wrong") }
}

/// Removes and returns the next `N` bytes.
fn take<const N: usize>(rest: &mut &[u8]) -> Option<[u8; N]> {
    let (taken, after) = rest.split_first_chunk::<N>()?;
    *rest = after;
    Some(*taken)
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use lz4_flex::frame::{BlockMode, FrameEncoder, FrameInfo};
    use proptest::prelude::*;

    use super::*;

    /// Frame of independent, uncompressed blocks without checksums.
    fn frame(blocks: &[(u32, &[u8])]) -> Vec<u8> {
        let descriptor = [flag::VERSION_1 | flag::INDEPENDENT_BLOCKS, 0x40];
        let mut bytes = [&MAGIC[..], &descriptor, &[(XxHash32::oneshot(0, &descriptor) >> 8) as u8]].concat();
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
    fn linked_blocks_reach_back_and_checksums_are_checked() {
        let flags = flag::VERSION_1 | flag::BLOCK_CHECKSUMS | flag::CONTENT_SIZE | flag::CONTENT_CHECKSUM;
        let descriptor = [&[flags, 0x40][..], &10_u64.to_le_bytes()].concat();
        let mut whole = [&MAGIC[..], &descriptor, &[(XxHash32::oneshot(0, &descriptor) >> 8) as u8]].concat();
        for block in [&[0x50, b'0', b'1', b'2', b'3', b'4'][..], &[0x00, 5, 0, 0x10, b'x']] {
            whole.extend((block.len() as u32).to_le_bytes());
            whole.extend(block);
            whole.extend(XxHash32::oneshot(0, block).to_le_bytes());
        }
        whole.extend([0; 4]);
        whole.extend(XxHash32::oneshot(0, b"012340123x").to_le_bytes());
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
    fn invalid_frames_are_refused() {
        for (packed, size, problem) in [
            (b"\x04\x22\x4d\x19".to_vec(), 0, "no LZ4 frame"),
            ([&MAGIC[..], &[0xa0, 0x40, 0]].concat(), 0, "an LZ4 frame of an unknown kind"),
            (frame(&[(PLAIN, b"plain")]), 4, TOO_LONG),
            (frame(&[(PLAIN, b"plain")]), 6, "an LZ4 frame is shorter than it is said to be"),
            (frame(&[(0, &[0x50, b'a'])]), 5, DAMAGED),
            // A match before the first byte, one from nowhere, one without its offset, one past the
            // end.
            (frame(&[(0, &[0x10, b'a', 2, 0, 0x10, b'b'])]), 6, DAMAGED),
            (frame(&[(0, &[0x10, b'a', 0, 0, 0x10, b'b'])]), 6, DAMAGED),
            (frame(&[(0, &[0x10, b'a', 1])]), 6, DAMAGED),
            (frame(&[(0, &[0x1f, b'a', 1, 0, 100, 0x10, b'b'])]), 50, DAMAGED),
            // An independent block that refers to the previous one.
            (frame(&[(PLAIN, b"plain"), (0, &[0x00, 5, 0, 0x10, b'b'])]), 10, DAMAGED),
        ] {
            assert_eq!(unpacked(&packed, size).unwrap_err(), problem);
        }
    }

    proptest! {
        #[test]
        fn frames_of_another_writer_are_read(
            pieces in prop::collection::vec((any::<u8>(), 1usize..3000, any::<bool>()), 0..60),
            (is_linked, block_checksums, content_checksum) in any::<(bool, bool, bool)>(),
        ) {
            let piece = |(value, length, is_run): (u8, usize, bool)| {
                (0..length).map(move |i| if is_run { value } else { value.wrapping_mul(i as u8) })
            };
            let plain: Vec<u8> = pieces.into_iter().flat_map(piece).collect();
            let blocks = if is_linked { BlockMode::Linked } else { BlockMode::Independent };
            let info = FrameInfo::new()
                .block_mode(blocks)
                .block_checksums(block_checksums)
                .content_checksum(content_checksum);
            let mut encoder = FrameEncoder::with_frame_info(info, Vec::new());
            encoder.write_all(&plain).unwrap();
            let packed = encoder.finish().unwrap();
            prop_assert_eq!(unpacked(&packed, plain.len()).unwrap(), plain);
        }
    }
}
