//! The checksum of LZ4 frames: XXH32 with the seed 0 (xxHash fast digest algorithm 0.1.1, section "XXH32").

const PRIMES: [u32; 5] = [0x9e37_79b1, 0x85eb_ca77, 0xc2b2_ae3d, 0x27d4_eb2f, 0x1656_67b1];

/// Checksum of bytes.
pub(super) fn xxh32(bytes: &[u8]) -> u32 {
    let [p1, p2, p3, p4, p5] = PRIMES;
    let mut stripes = bytes.chunks_exact(16);
    let mut lanes = [p1.wrapping_add(p2), p2, 0, 0_u32.wrapping_sub(p1)];
    for stripe in &mut stripes {
        for (lane, word) in lanes.iter_mut().zip(stripe.as_chunks().0) {
            let sum = lane.wrapping_add(u32::from_le_bytes(*word).wrapping_mul(p2));
            *lane = sum.rotate_left(13).wrapping_mul(p1);
        }
    }
    let mut hash = match bytes.len() {
        0..16 => p5,
        _ => lanes
            .iter()
            .zip([1, 7, 12, 18])
            .fold(0, |sum: u32, (lane, by)| sum.wrapping_add(lane.rotate_left(by))),
    };
    // The length modulo 2^32.
    hash = hash.wrapping_add(bytes.len() as u32);
    let (words, rest) = stripes.remainder().as_chunks();
    for word in words {
        let sum = hash.wrapping_add(u32::from_le_bytes(*word).wrapping_mul(p3));
        hash = sum.rotate_left(17).wrapping_mul(p4);
    }
    for &byte in rest {
        hash = hash.wrapping_add(u32::from(byte).wrapping_mul(p5)).rotate_left(11).wrapping_mul(p1);
    }
    hash = (hash ^ (hash >> 15)).wrapping_mul(p2);
    hash = (hash ^ (hash >> 13)).wrapping_mul(p3);
    hash ^ (hash >> 16)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_checksums() {
        assert_eq!(xxh32(b""), 0x02cc_5d05);
        assert_eq!(xxh32(b"a"), 0x550d_7456);
        assert_eq!(xxh32(b"abc"), 0x32d1_53ff);
        assert_eq!(xxh32(b"Nobody inspects the spammish repetition"), 0xe229_3b2f);
    }
}
