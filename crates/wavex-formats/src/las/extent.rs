//! Agreement of the number of points with the structures after them.

use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

use super::header::LasHeader;
use super::vlr::{self, Vlr};
use crate::{Error, Result};

const REMEDY: &str = "correct the number of points in the header, or export the file again";

/// Returns the number of bytes after uncompressed points that belong to nothing.
///
/// Writers pad the points: less than a record, or zeros, are no surplus. `packets` is the offset of
/// the waveform packets, if they are in this file.
///
/// # Errors
/// Whole records follow the points, or another structure begins inside them.
pub(super) fn surplus_bytes(
    input: &mut (impl Read + Seek),
    file: &Path,
    header: &LasHeader,
    evlrs: &[Vlr],
    packets: Option<u64>,
    file_length: u64,
) -> Result<u64> {
    if header.compressed {
        return Ok(0);
    }
    let record_length = u64::from(header.record_length);
    // The header was checked against the file length, so this does not overflow.
    let end = u64::from(header.offset_to_points) + header.n_points * record_length;
    let evlrs = evlrs.iter().map(|evlr| evlr.offset - vlr::EVLR_HEADER);
    let structures = || evlrs.clone().chain(packets);
    if let Some(start) = structures().find(|&start| start < end) {
        let problem = format!(
            "the {} points end at byte {end}, but an extended record begins at byte {start}",
            header.n_points
        );
        return Err(Error::malformed(file, header.count_at(), "number of point records", problem, REMEDY));
    }
    if vlr::waveform_record(input, file, end, file_length)?.is_some() {
        return Ok(0);
    }
    let declared = Some(header.start_of_waveforms).filter(|&start| start >= end);
    let next = structures().chain(declared).fold(file_length, u64::min);
    let surplus = next - end;
    if surplus < record_length {
        return Ok(0);
    }
    let mut first = Vec::new();
    let read =
        input.seek(SeekFrom::Start(end)).and_then(|_| input.take(record_length).read_to_end(&mut first));
    read.map_err(Error::io(file, "read the end of the points"))?;
    if first.iter().all(|&byte| byte == 0) {
        return Ok(0);
    }
    if !surplus.is_multiple_of(record_length) {
        return Ok(surplus);
    }
    let more = surplus / record_length;
    let records = if more == 1 { "record" } else { "records" };
    let problem = format!(
        "the header declares {} points, but {more} more {records} of {record_length} bytes follow",
        header.n_points
    );
    Err(Error::malformed(file, header.count_at(), "number of point records", problem, REMEDY))
}
