//! The superblock: position of the root group.

use wavex_formats::other_format::{DECISIVE_BYTES, other_format};
use wavex_formats::{Error, Result};

use super::input::{Address, Input, REPACK};

const SIGNATURE: &[u8; 8] = b"\x89HDF\r\n\x1a\n";

/// Finds the superblock, sets the base of addresses, and returns the address of the root group.
///
/// # Errors
/// If the file is no HDF5 file, is cut off, or its addresses do not have 8 bytes.
pub fn root(input: &mut Input) -> Result<Address> {
    let base = find(input)?;
    input.set_base(base);
    input.next_object();
    let length = input.length().saturating_sub(base).min(128);
    let bytes = input.metadata(0, length, "superblock")?;
    let mut fields = input.fields(0, &bytes);
    fields.skip(8, "signature")?;
    let version = fields.u8("version of the superblock")?;
    let sizes;
    match version {
        0 | 1 => {
            fields.skip(4, "versions")?;
            sizes = [fields.u8("size of offsets")?, fields.u8("size of lengths")?];
            // One reserved byte, two ranks of B-trees, flags; version 1 has another rank.
            fields.skip(if version == 0 { 9 } else { 13 }, "consistency flags")?;
            fields.skip(16, "base address")?;
        }
        2 | 3 => {
            sizes = [fields.u8("size of offsets")?, fields.u8("size of lengths")?];
            fields.skip(1, "consistency flags")?;
            fields.skip(16, "base address")?;
        }
        _ => {
            let problem = format!("version {version} is not supported");
            return Err(input.bad(8, "version of the superblock", problem, REPACK));
        }
    }
    if sizes != [8, 8] {
        let problem = format!("{} and {} bytes, only 8 are supported", sizes[0], sizes[1]);
        return Err(input.bad(8, "sizes of offsets and lengths", problem, REPACK));
    }
    let end = fields.u64("end of file address")?;
    // Unlike addresses, the end is counted from the first byte of the file.
    if end > input.length() {
        let problem = format!("cut off: {} of {end} bytes", input.length());
        return Err(Error::unusable(input.path(), problem, "copy it again from its source"));
    }
    if version < 2 {
        fields.skip(16, "driver information address")?;
    }
    fields.u64("address of the root group")
}

/// Returns the byte of the signature: 0, or after a user block 512, 1024, 2048 and so on.
fn find(input: &Input) -> Result<u64> {
    let mut start = [0; DECISIVE_BYTES];
    let held = start.len().min(usize::try_from(input.length()).unwrap_or(start.len()));
    input.read(0, &mut start[..held], "signature")?;
    let mut at = 0;
    while at + 8 <= input.length() {
        let mut bytes = [0; 8];
        input.read(at, &mut bytes, "signature")?;
        if &bytes == SIGNATURE {
            return Ok(at);
        }
        at = if at == 0 { 512 } else { at * 2 };
    }
    Err(other_format(input.path(), &start[..held], "read_hdf5").unwrap_or_else(|| {
        Error::unusable(input.path(), "not an HDF5 file", "give a file of GEDI L1B or LVIS L1B")
    }))
}
