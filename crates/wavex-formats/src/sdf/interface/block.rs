//! Sample blocks in the memory of the library.

use std::mem::MaybeUninit;

use crate::sdf::{MAX_BLOCKS, MAX_RECORD_SAMPLES, MAX_SAMPLES, SdfBlock, SdfRecord};

/// `fwifc_sbl_t`: the fields common to all versions.
#[repr(C)]
#[derive(Clone, Copy)]
pub(super) struct RawBlock {
    pub(super) time_sosbl_s: f64,
    pub(super) channel: u32,
    pub(super) sample_count: u32,
    /// Unused.
    ///
    /// The size of `*sample`, in a unit on which descriptions differ.
    pub(super) _sample_size: u32,
    pub(super) sample: *const u16,
}

/// Largest plausible size of a block, bytes.
pub(super) const MAX_STRIDE: u32 = 1 << 12;

/// Checks the array of blocks of a record.
pub(super) fn check_array(count: u32, stride: u32, blocks: *const RawBlock) -> Result<(), String> {
    let least = size_of::<RawBlock>();
    if count == 0 {
        Ok(())
    } else if count > MAX_BLOCKS {
        Err(format!("a record of {count} blocks"))
    } else if (stride as usize) < least || stride > MAX_STRIDE {
        Err(format!("blocks of {stride} bytes each, but {least} to {MAX_STRIDE} are valid"))
    } else if blocks.is_null() {
        Err("a null pointer to blocks".to_owned())
    } else {
        Ok(())
    }
}

/// Checks a block.
///
/// `before` is the number of samples already in the record.
pub(super) fn check_block(block: &RawBlock, before: usize) -> Result<(), String> {
    if block.sample_count > MAX_SAMPLES {
        Err(format!("a block of {} samples", block.sample_count))
    } else if before + block.sample_count as usize > MAX_RECORD_SAMPLES {
        Err(format!("a record of more than {MAX_RECORD_SAMPLES} samples"))
    } else if block.sample_count > 0 && block.sample.is_null() {
        Err("a null pointer to samples".to_owned())
    } else {
        Ok(())
    }
}

/// Appends a block to a record.
///
/// # Safety
/// `check_block` succeeded, the stated number of samples is readable at the pointer, and no other
/// thread calls the library meanwhile.
pub(super) unsafe fn copy_block(block: &RawBlock, record: &mut SdfRecord) {
    let count = block.sample_count as usize;
    let first = record.samples.len();
    record.samples.reserve(count);
    if count > 0 {
        let to: &mut [MaybeUninit<u16>] = record.samples.spare_capacity_mut();
        // SAFETY: the caller guarantees the source, `reserve` the target. Bytes are copied, because
        // the samples may be unaligned and any bytes are valid samples.
        unsafe {
            std::ptr::copy_nonoverlapping(
                block.sample.cast::<u8>(),
                to.as_mut_ptr().cast::<u8>(),
                count * size_of::<u16>(),
            );
            record.samples.set_len(first + count);
        }
    }
    record.blocks.push(SdfBlock { channel: block.channel, start_s: block.time_sosbl_s, first, len: count });
}
