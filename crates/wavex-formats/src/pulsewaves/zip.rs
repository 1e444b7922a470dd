//! Compressed pulses (PulseZIP): chunks of pulse records.
//!
//! The record `PulseWaves_Spec` 5 describes the items of a pulse record and the number of pulses of a
//! chunk. The pulses begin with the offset of a table of the sizes of all chunks. A chunk is its first
//! pulse record without compression, followed by all others, arithmetically coded. Layout: PulseTools
//! (rapidlasso), PulseZIP 0.0.

mod items;
mod pulse;

use std::io::{Read, Seek};

use super::header::PulseHeader;
use super::window::FileWindow;
use crate::arithmetic::{Decoder, IntegerDecoder};
use crate::bytes::Fields;
use crate::{Error, Result};
use items::{Item, PulseDecoder};

/// Compressor and coder of PulseZIP: chunks, arithmetic.
const SCHEME: (u16, u16) = (1, 0);
/// Number of pulses of a chunk if the table has it.
const VARIABLE: u32 = u32::MAX;
/// Version of the chunk table.
const TABLE_VERSION: u32 = 0;
/// Largest size of a chunk, compressed or not, bytes.
///
/// Chunks of PulseTools have 50 000 pulses, 2.4 MB.
const MOST_BYTES: u64 = 1 << 28;
/// Most bytes of an entry of the chunk table.
const ENTRY_BYTES: usize = 16;

pub(super) const CUT: &str = "the file is cut off or damaged: copy it again from its source";
const UNKNOWN: &str = "write the file again with PulseTools, or uncompressed";

/// Description of compressed pulses (`PulseWaves_Spec` 5).
#[derive(Debug, Clone, PartialEq)]
pub(super) struct PulseZip {
    /// Number of pulses of a chunk.
    chunk_pulses: u32,
    items: Vec<Item>,
}

/// Compressed pulses of a file.
#[derive(Debug)]
pub(super) struct PulseChunks {
    zip: PulseZip,
    pulse_size: usize,
    chunks: Vec<Chunk>,
    /// Number of the decoded chunk.
    decoded: Option<usize>,
    /// Its pulse records.
    records: Vec<u8>,
}

#[derive(Debug)]
struct Chunk {
    /// Number of the first pulse.
    first: u64,
    /// Number of pulses.
    pulses: u64,
    at: u64,
    bytes: u64,
}

impl PulseZip {
    /// Parses the payload of the record, which must match the header.
    pub(super) fn parse(mut fields: Fields, header: &PulseHeader) -> Result<PulseZip> {
        let at = fields.clone();
        let scheme = (fields.u16("PulseZIP: compressor")?, fields.u16("PulseZIP: coder")?);
        if scheme != SCHEME {
            let problem =
                format!("compressor {} and coder {} are not supported, only 1 and 0", scheme.0, scheme.1);
            return Err(at.bad("PulseZIP record", problem, UNKNOWN));
        }
        fields.skip(8, "PulseZIP: version and options")?;
        let chunk_pulses = fields.u32("PulseZIP: pulses per chunk")?;
        let count = fields.u16("PulseZIP: number of items")?;
        let mut items = Vec::new();
        for _ in 0..count {
            items.push(Item::parse(&mut fields)?);
        }
        let size: u32 = items.iter().map(Item::size).sum();
        if size != header.pulse_size || items.first() != Some(&Item::Pulse) {
            let problem = format!("its items do not match pulses of {} bytes", header.pulse_size);
            return Err(at.bad("PulseZIP record", problem, UNKNOWN));
        }
        if chunk_pulses == 0 {
            return Err(at.bad("PulseZIP: pulses per chunk", "it is 0", UNKNOWN));
        }
        Ok(PulseZip { chunk_pulses, items })
    }
}

impl PulseChunks {
    /// Reads the chunk table.
    ///
    /// # Errors
    /// It is missing, or contradicts the file or the header.
    pub(super) fn open<R: Read + Seek>(
        zip: PulseZip,
        window: &mut FileWindow<R>,
        header: &PulseHeader,
    ) -> Result<PulseChunks> {
        let at = header.offset_to_pulses;
        let pulse_size = header.pulse_size as usize;
        let start = at + 8;
        let table_at = find_table(window, at)?;
        let (file, bytes) = window.bytes(table_at, 8, "chunk table")?;
        let mut fields = Fields::new(file, table_at, bytes);
        let (version, count) = (fields.u32("version")?, fields.u32("number of chunks")?);
        let room = table_at - start;
        // Each chunk begins with an uncompressed pulse.
        if version != TABLE_VERSION || u64::from(count) > room / pulse_size as u64 {
            let problem = format!("version {version}, {count} chunks in {room} bytes");
            return Err(Error::malformed(window.file(), table_at, "chunk table", problem, CUT));
        }
        let sizes = read_sizes(window, table_at + 8, count as usize, zip.chunk_pulses == VARIABLE)?;
        let bad = |problem: String| Error::malformed(window.file(), table_at, "chunk table", problem, CUT);
        let mut chunks: Vec<Chunk> = Vec::new();
        let (mut first, mut at) = (0, start);
        for (pulses, bytes) in sizes {
            let pulses = pulses.unwrap_or(zip.chunk_pulses).into();
            let bytes = u64::from(bytes);
            if bytes > table_at - at || bytes < pulse_size as u64 {
                return Err(bad(format!(
                    "a chunk of {bytes} bytes at byte {at} does not fit before the table"
                )));
            }
            let pulses = u64::min(pulses, header.pulse_count.saturating_sub(first));
            let decoded = pulses.saturating_mul(pulse_size as u64);
            if bytes.max(decoded) > MOST_BYTES {
                return Err(bad(format!(
                    "a chunk of {pulses} pulses exceeds the limit of {MOST_BYTES} bytes"
                )));
            }
            chunks.push(Chunk { first, pulses, at, bytes });
            (first, at) = (first + pulses, at + bytes);
        }
        Ok(PulseChunks { zip, pulse_size, chunks, decoded: None, records: Vec::new() })
    }

    /// Returns the number of pulses.
    pub(super) fn pulse_count(&self) -> u64 {
        self.chunks.last().map_or(0, |last| last.first + last.pulses)
    }

    /// Returns the file offset of the chunk with pulse `index`.
    pub(super) fn chunk_at(&self, index: u64) -> u64 {
        self.chunk_of(index).and_then(|number| self.chunks.get(number)).map_or(0, |chunk| chunk.at)
    }

    fn chunk_of(&self, index: u64) -> Option<usize> {
        self.chunks.partition_point(|chunk| chunk.first <= index).checked_sub(1)
    }

    /// Returns the record of pulse `index`, which must exist.
    ///
    /// Decodes its chunk, unless it is the last decoded one.
    pub(super) fn record<R: Read + Seek>(&mut self, window: &mut FileWindow<R>, index: u64) -> Result<&[u8]> {
        let number = self.chunk_of(index).unwrap_or(0);
        if self.decoded != Some(number) {
            self.decoded = None;
            self.decode(window, number)?;
            self.decoded = Some(number);
        }
        let first = self.chunks.get(number).map_or(0, |chunk| chunk.first);
        let from = (index - first) as usize * self.pulse_size;
        Ok(self.records.get(from..from + self.pulse_size).unwrap_or_default())
    }

    fn decode<R: Read + Seek>(&mut self, window: &mut FileWindow<R>, number: usize) -> Result<()> {
        let Some(chunk) = self.chunks.get(number) else { return Ok(()) };
        let (file, bytes) = window.bytes(chunk.at, chunk.bytes as usize, "compressed pulses")?;
        let damaged = |problem: String| Error::malformed(file, chunk.at, "compressed pulses", problem, CUT);
        let (first, coded) = bytes.split_at(self.pulse_size);
        self.records.clear();
        self.records.extend(first);
        if chunk.pulses < 2 {
            return Ok(());
        }
        let mut pulses = PulseDecoder::new(&self.zip.items, first);
        let mut input = Decoder::new(coded);
        for _ in 1..chunk.pulses {
            pulses.next(&mut input, &mut self.records);
            if input.is_past_end() {
                break;
            }
        }
        let read =
            input.check_end().map_err(|problem| damaged(format!("they cannot be decoded: {problem}")))?;
        match coded.len() - read {
            0 => Ok(()),
            more => Err(damaged(format!("{more} bytes follow the last pulse of a chunk"))),
        }
    }
}

/// Finds the chunk table, whose offset is at byte `at`.
fn find_table<R: Read + Seek>(window: &mut FileWindow<R>, at: u64) -> Result<u64> {
    let length = window.length();
    let mut offset = |at: u64| -> Result<i64> {
        let (file, bytes) = window.bytes(at, 8, "offset to the chunk table")?;
        Fields::new(file, at, bytes).i64("offset to the chunk table")
    };
    let named = match offset(at)? {
        // Writers that cannot seek back write the offset at the end of the file.
        -1 => offset(length - 8)?,
        named => named,
    };
    let room = at + 8..=length.saturating_sub(8);
    u64::try_from(named).ok().filter(|named| room.contains(named)).ok_or_else(|| {
        let problem = format!("{named} is not between the pulses and the end of the file ({length} bytes)");
        Error::malformed(window.file(), at, "offset to the chunk table", problem, CUT)
    })
}

/// Reads the number of pulses, if it varies, and the bytes of each chunk.
fn read_sizes<R: Read + Seek>(
    window: &mut FileWindow<R>,
    at: u64,
    count: usize,
    varies: bool,
) -> Result<Vec<(Option<u32>, u32)>> {
    let mut sizes = Vec::new();
    if count == 0 {
        return Ok(sizes);
    }
    let length = (count * ENTRY_BYTES + ENTRY_BYTES).min((window.length() - at) as usize);
    let (file, bytes) = window.bytes(at, length, "chunk table")?;
    let mut input = Decoder::new(bytes);
    let mut numbers = IntegerDecoder::new(32, 2);
    let (mut pulses, mut bytes) = (0, 0);
    for _ in 0..count {
        if varies {
            pulses = numbers.number(&mut input, pulses, 0);
        }
        bytes = numbers.number(&mut input, bytes, 1);
        sizes.push((varies.then_some(pulses as u32), bytes as u32));
    }
    input.check_end().map_err(|problem| {
        let problem = format!("it cannot be decoded: {problem}");
        Error::malformed(file, at, "chunk table", problem, CUT)
    })?;
    Ok(sizes)
}
