//! Digests of the parts of an Arrow file or stream.
//!
//! The custom metadata of the schema message, of each record batch message and of the footer have
//! the key [`KEY`]. Its value is XXH3-64 of the part as stored, 16 hexadecimal digits: the body, with
//! the XXH3-64 of the flatbuffer as seed, whose own value counts as [`BLANK`]. The flatbuffer
//! includes the padding of the message; schema and footer have an empty body. Other readers ignore
//! the key (Arrow columnar format 1.5, "Custom Application Metadata").

use std::ops::Range;

use arrow_ipc::KeyValue;
use flatbuffers::{ForwardsUOffset, Vector};
use twox_hash::XxHash3_64;

use super::location::{ContainerLocation, DAMAGED};
use crate::Result;

/// Key of the digest in custom metadata.
pub(super) const KEY: &str = "wavex.digest";

/// Value in place of the digest while it is computed.
pub(super) const BLANK: &str = "0000000000000000";

/// Custom metadata of a message or footer.
type Entries<'a> = Option<Vector<'a, ForwardsUOffset<KeyValue<'a>>>>;

/// Computes the digest of a flatbuffer whose own value is blank, and a body.
pub(super) fn of(blank: &[u8], body: &[u8]) -> String {
    format!("{:016x}", XxHash3_64::oneshot_with_seed(XxHash3_64::oneshot(blank), body))
}

/// Location in a flatbuffer of the value of its digest, if any.
pub(super) fn location_of(flatbuffer: &[u8], entries: Entries) -> Option<Range<usize>> {
    let entry = entries?.iter().find(|entry| entry.key() == Some(KEY))?;
    let value = entry.value()?;
    let start = (value.as_ptr() as usize).checked_sub(flatbuffer.as_ptr() as usize)?;
    Some(start..start + value.len())
}

/// Checks the digest of a part; returns whether it has one.
///
/// # Errors
/// The stored digest differs from the digest of the bytes.
pub(super) fn check(
    flatbuffer: &[u8],
    body: &[u8],
    entries: Entries,
    name: &str,
    location: ContainerLocation,
) -> Result<bool> {
    let Some(value) = location_of(flatbuffer, entries) else { return Ok(false) };
    let mut blank = flatbuffer.to_vec();
    let stored = blank.get_mut(value).unwrap_or_default();
    let expected = String::from_utf8_lossy(stored).into_owned();
    if stored.len() == BLANK.len() {
        stored.copy_from_slice(BLANK.as_bytes());
    }
    let found = of(&blank, body);
    if found == expected {
        return Ok(true);
    }
    let problem = format!("its digest is {}, but its bytes give {found}", expected.escape_debug());
    Err(location.bad(name, problem, DAMAGED))
}
