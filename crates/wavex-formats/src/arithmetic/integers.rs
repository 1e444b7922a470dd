//! Integers as differences from their predictions.

use super::Decoder;
use super::models::{BitModel, SymbolModel};

/// Bits of a difference that are symbols; further ones are equally probable.
const SYMBOL_BITS: u32 = 8;
/// Samples between two checks for the end of the data.
const RUN: usize = 256;

/// Decoder of integers of up to 32 bits.
///
/// A difference is stored as the interval that contains it, and its position in there. Interval `k` has
/// -(2^k - 1) to -2^(k-1) and 2^(k-1) + 1 to 2^k; interval 0 has 0 and 1.
#[derive(Debug, Clone)]
pub(crate) struct IntegerDecoder {
    mask: u32,
    /// Intervals, by context.
    intervals: Vec<SymbolModel>,
    /// Positions in intervals 0 and 1.
    bits: [BitModel; 2],
    /// Positions in the intervals from 2.
    positions: Vec<SymbolModel>,
}

impl IntegerDecoder {
    /// Creates a decoder of integers of `bits` bits, 2 to 32, in at least one context.
    pub(crate) fn new(bits: u32, contexts: usize) -> IntegerDecoder {
        IntegerDecoder {
            mask: u32::MAX >> (32 - bits),
            intervals: vec![SymbolModel::new(bits as usize + 1); contexts],
            bits: [BitModel::of_bit(), BitModel::of_two_symbols()],
            positions: (2..=bits).map(|k| SymbolModel::new(1 << k.min(SYMBOL_BITS))).collect(),
        }
    }

    /// Forgets all numbers.
    pub(crate) fn restart(&mut self) {
        self.bits.iter_mut().for_each(BitModel::restart);
        self.intervals.iter_mut().chain(&mut self.positions).for_each(SymbolModel::restart);
    }

    /// Decodes a number with this prediction; those of less than 32 bits are not negative.
    #[inline(always)]
    pub(crate) fn number(&mut self, input: &mut Decoder, prediction: i32, context: usize) -> i32 {
        let difference = self.difference(input, context);
        (prediction.wrapping_add(difference) as u32 & self.mask) as i32
    }

    /// Decodes samples of up to 16 bits, each predicted by the one before it.
    ///
    /// Stops where the input ends.
    pub(crate) fn samples(&mut self, input: &mut Decoder, mut before: u16, context: usize, out: &mut [u16]) {
        // A copy stays in registers.
        let mut local = input.clone();
        for run in out.chunks_mut(RUN) {
            for sample in run {
                before = self.number(&mut local, before.into(), context) as u16;
                *sample = before;
            }
            if local.is_past_end() {
                break;
            }
        }
        *input = local;
    }

    #[inline(always)]
    fn difference(&mut self, input: &mut Decoder, context: usize) -> i32 {
        let intervals = &mut self.intervals[context];
        if let Some(interval) = input.first_symbol(intervals) {
            let bit = input.bit(&mut self.bits[interval as usize]) as i32;
            // 0 and 1, or -1 and 2.
            return bit * (1 + 2 * interval as i32) - interval as i32;
        }
        let interval = input.later_symbol(intervals);
        // Interval 32 has a single number.
        let Some(before) = interval.checked_sub(2).filter(|_| interval < 32) else { return i32::MIN };
        let high = input.symbol(&mut self.positions[before]) as u32;
        let position = match (interval as u32).saturating_sub(SYMBOL_BITS) {
            0 => high,
            bits => high << bits | input.bits(bits),
        } as i32;
        // The lower half is negative: -(2^k - 1) is added instead of 1. A branch could not be predicted.
        let if_lower = (position >> (interval - 1) & 1) - 1;
        position.wrapping_add(1).wrapping_sub((1 << interval) & if_lower)
    }
}
