//! Items of compressed pulse records.

use super::UNKNOWN;
use super::pulse::Pulse;
use crate::Result;
use crate::arithmetic::{Decoder, IntegerDecoder, SymbolModel};
use crate::bytes::Fields;
use crate::pulsewaves::header::PULSE_BYTES;

/// Version of all items.
const VERSION: u16 = 1;
/// Types of items.
const EXTRA_BYTES: u16 = 1000;
const PULSE: u16 = 1001;
const SOURCE_ID_16: u16 = 1002;
const SOURCE_ID_32: u16 = 1003;

/// Part of a pulse record.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Item {
    /// Pulse record type 0.
    Pulse,
    /// Source ID of 16 bits.
    SourceId16,
    /// Source ID of 32 bits.
    SourceId32,
    /// This many other bytes.
    ExtraBytes(u16),
}

impl Item {
    pub(super) fn parse(fields: &mut Fields) -> Result<Item> {
        let at = fields.clone();
        let [kind, size, version] = [
            fields.u16("PulseZIP: item")?,
            fields.u16("PulseZIP: item size")?,
            fields.u16("PulseZIP: version")?,
        ];
        let item = match kind {
            EXTRA_BYTES if size > 0 => Some(Item::ExtraBytes(size)),
            PULSE => Some(Item::Pulse),
            SOURCE_ID_16 => Some(Item::SourceId16),
            SOURCE_ID_32 => Some(Item::SourceId32),
            _ => None,
        };
        item.filter(|item| item.size() == u32::from(size) && version == VERSION).ok_or_else(|| {
            let problem = format!("type {kind} of {size} bytes, version {version}, is not supported");
            at.bad("PulseZIP: item", problem, UNKNOWN)
        })
    }

    /// Returns the size of the item, bytes.
    pub(super) fn size(&self) -> u32 {
        match self {
            Item::Pulse => PULSE_BYTES,
            Item::SourceId16 => 2,
            Item::SourceId32 => 4,
            Item::ExtraBytes(size) => u32::from(*size),
        }
    }
}

/// Decoder of the pulse records of a chunk.
pub(super) struct PulseDecoder(Vec<ItemDecoder>);

enum ItemDecoder {
    Pulse(Box<Pulse>),
    SourceId(SourceId),
    ExtraBytes(Vec<(u8, SymbolModel)>),
}

impl PulseDecoder {
    /// Starts after the first record of a chunk.
    pub(super) fn new(items: &[Item], first: &[u8]) -> PulseDecoder {
        let mut rest = first;
        let decoder = |item: &Item| {
            let (first, more) = rest.split_at(rest.len().min(item.size() as usize));
            rest = more;
            match item {
                Item::Pulse => ItemDecoder::Pulse(Box::new(Pulse::new(first))),
                Item::SourceId16 => ItemDecoder::SourceId(SourceId::new(first, 16)),
                Item::SourceId32 => ItemDecoder::SourceId(SourceId::new(first, 32)),
                Item::ExtraBytes(_) => {
                    ItemDecoder::ExtraBytes(first.iter().map(|&byte| (byte, SymbolModel::new(256))).collect())
                }
            }
        };
        PulseDecoder(items.iter().map(decoder).collect())
    }

    /// Appends the next record to `records`.
    pub(super) fn next(&mut self, input: &mut Decoder, records: &mut Vec<u8>) {
        for item in &mut self.0 {
            match item {
                ItemDecoder::Pulse(pulse) => pulse.next(input, records),
                ItemDecoder::SourceId(id) => id.next(input, records),
                ItemDecoder::ExtraBytes(bytes) => {
                    for (byte, difference) in bytes {
                        *byte = byte.wrapping_add(input.symbol(difference) as u8);
                        records.push(*byte);
                    }
                }
            }
        }
    }
}

/// Decoder of source IDs: the last one, one of some earlier ones, or a new one.
struct SourceId {
    bits: u32,
    last: u32,
    earlier: Vec<u32>,
    /// Index of the oldest of the earlier IDs.
    oldest: usize,
    choice: SymbolModel,
    new: IntegerDecoder,
}

impl SourceId {
    fn new(first: &[u8], bits: u32) -> SourceId {
        SourceId {
            bits,
            last: first.iter().rev().fold(0, |id, &byte| id << 8 | u32::from(byte)),
            // As many as the ID has bits.
            earlier: (0..bits).collect(),
            oldest: 0,
            choice: SymbolModel::new(bits as usize + 2),
            new: IntegerDecoder::new(bits, 1),
        }
    }

    fn next(&mut self, input: &mut Decoder, records: &mut Vec<u8>) {
        match input.symbol(&mut self.choice) {
            0 => {}
            1 => {
                self.earlier[self.oldest] = self.last;
                self.oldest = (self.oldest + 1) % self.earlier.len();
                self.last = self.new.number(input, self.last as i32, 0) as u32;
            }
            number => self.last = self.earlier[number - 2],
        }
        records.extend(&self.last.to_le_bytes()[..self.bits as usize / 8]);
    }
}
