//! Layout and limits of blocks; texts.

use super::*;
use std::mem::offset_of;

#[cfg(target_pointer_width = "64")]
#[test]
fn a_block_is_laid_out_as_the_interface_says() {
    let offsets = [
        offset_of!(RawBlock, time_sosbl_s),
        offset_of!(RawBlock, channel),
        offset_of!(RawBlock, sample_count),
        offset_of!(RawBlock, _sample_size),
        offset_of!(RawBlock, sample),
        size_of::<RawBlock>(),
    ];
    assert_eq!(offsets, [0, 8, 12, 16, 24, 32]);
}

#[test]
fn an_array_passes_its_limits() {
    let somewhere = std::ptr::dangling();
    let wrong = |count, stride, blocks| check_array(count, stride, blocks).unwrap_err();
    assert_eq!(check_array(0, 0, std::ptr::null()), Ok(()), "no blocks need no place");
    assert_eq!(check_array(4096, 4096, somewhere), Ok(()));
    assert_eq!(wrong(4097, 32, somewhere), "a record of 4097 blocks");
    assert_eq!(wrong(1, 8, somewhere), "blocks of 8 bytes each, but 32 to 4096 are valid");
    assert_eq!(wrong(1, 32, std::ptr::null()), "a null pointer to blocks");
}

#[test]
fn a_block_passes_its_limits() {
    let block = |sample_count, sample| RawBlock {
        time_sosbl_s: 0.0,
        channel: 1,
        sample_count,
        _sample_size: 2,
        sample,
    };
    assert_eq!(check_block(&block(0, std::ptr::null()), 0), Ok(()));
    assert_eq!(check_block(&block(1 << 16, std::ptr::dangling()), 0), Ok(()));
    assert_eq!(check_block(&block(65_537, std::ptr::dangling()), 0).unwrap_err(), "a block of 65537 samples");
    assert_eq!(check_block(&block(1, std::ptr::null()), 0).unwrap_err(), "a null pointer to samples");
    let full = check_block(&block(1, std::ptr::dangling()), 1 << 20).unwrap_err();
    assert_eq!(full, "a record of more than 1048576 samples");
}

#[test]
fn unaligned_samples_are_copied_whole() {
    let bytes = [0xff, 1, 2, 3, 4, 0xff_u8];
    let mut record = SdfRecord::default();
    record.push(3, 0.0, &[7]);
    let sample = bytes[1..].as_ptr().cast::<c_void>().cast::<u16>();
    let block = RawBlock { time_sosbl_s: 1e-6, channel: 1, sample_count: 2, _sample_size: 2, sample };
    // SAFETY: four bytes are readable, and no library is called.
    unsafe { copy_block(&block, &mut record) };
    let expected = [u16::from_ne_bytes([1, 2]), u16::from_ne_bytes([3, 4])];
    assert_eq!(record.samples(&record.blocks[1]), expected);
    assert_eq!(record.samples(&record.blocks[0]), [7]);
}

#[test]
fn texts_end_in_a_zero_and_may_be_missing_or_endless() {
    let endless = vec![b'x'; 2 * MAX_TEXT];
    // SAFETY: each text is null, ends in 0, or is longer than the limit.
    let read = unsafe { [text(std::ptr::null()), text(c"\xe4b".as_ptr()), text(endless.as_ptr().cast())] };
    assert_eq!(read[..2], ["", "\u{fffd}b"]);
    assert_eq!(read[2].len(), MAX_TEXT);
}
