//! Adaptive arithmetic decoding, as in LASzip and PulseZIP.
//!
//! The coder is Amir Said's FastAC ("Introduction to Arithmetic Coding", HP Laboratories HPL-2004-76):
//! an interval of 32 bits, byte-wise renormalisation and periodically updated models. Integers are
//! coded as their difference from a prediction.
//!
//! Decoders never fail in the middle: missing bytes are read as zeros, and [`Decoder::check_end`] finds
//! them. Bytes that no encoder writes give wrong numbers, but neither panics nor allocations.

mod integers;
mod models;
#[cfg(test)]
mod tests;

pub(crate) use integers::IntegerDecoder;
pub(crate) use models::SymbolModel;

use models::BitModel;

/// Shortest interval; it is renormalised below.
const SHORTEST: u32 = 1 << 24;
/// Bytes that a decoder reads before the first symbol.
const FIRST_BYTES: usize = 4;
/// Zeros at the end of encoded data. Encoders append two or three because decoders read ahead.
const LAST_ZEROS: usize = 2;
/// Most bits that one division can read.
const BITS_AT_ONCE: u32 = 16;

/// Decoder of encoded bytes that may be followed by others.
#[derive(Debug, Clone)]
pub(crate) struct Decoder<'a> {
    bytes: &'a [u8],
    /// Number of bytes read, including missing ones.
    at: usize,
    /// Distance of the code from the start of the interval.
    value: u32,
    /// Length of the interval.
    length: u32,
    is_valid: bool,
}

impl<'a> Decoder<'a> {
    /// Starts at the first of the encoded bytes.
    pub(crate) fn new(bytes: &'a [u8]) -> Decoder<'a> {
        let mut decoder = Decoder { bytes, at: 0, value: 0, length: u32::MAX, is_valid: true };
        (0..FIRST_BYTES).for_each(|_| decoder.value = decoder.value << 8 | decoder.next_byte());
        // Every code is within its interval.
        decoder.is_valid = decoder.value < decoder.length;
        decoder
    }

    /// Returns whether the bytes did not suffice.
    pub(crate) fn is_past_end(&self) -> bool {
        self.at > self.bytes.len()
    }

    /// Returns the number of bytes read, at most those that there are.
    pub(crate) fn position(&self) -> u64 {
        self.at.min(self.bytes.len()) as u64
    }

    /// Checks that encoded data end here, and returns their length, bytes.
    ///
    /// # Errors
    /// With a description if bytes are missing or no encoder wrote them.
    pub(crate) fn check_end(&self) -> Result<usize, &'static str> {
        let Some(read) = self.bytes.get(..self.at) else { return Err("the encoded data end too early") };
        match self.is_valid && read.ends_with(&[0; LAST_ZEROS]) {
            true => Ok(self.at),
            false => Err("no encoder writes these bytes"),
        }
    }

    #[inline(always)]
    fn next_byte(&mut self) -> u32 {
        let byte = self.bytes.get(self.at).copied().unwrap_or(0);
        self.at += 1;
        byte.into()
    }

    #[inline(always)]
    fn renormalise(&mut self) {
        while self.length < SHORTEST {
            self.value = self.value << 8 | self.next_byte();
            self.length <<= 8;
        }
    }

    /// Decodes a bit of a model.
    #[inline(always)]
    fn bit(&mut self, model: &mut BitModel) -> u32 {
        let of_zero = model.length_of_zero(self.length);
        let bit = u32::from(self.value >= of_zero);
        // Without branches: the bits of a difference are noise.
        let if_one = bit.wrapping_neg();
        self.value -= of_zero & if_one;
        self.length = of_zero ^ ((of_zero ^ (self.length - of_zero)) & if_one);
        self.renormalise();
        model.count(bit);
        bit
    }

    /// Decodes a symbol if it is one of the first two of at least three, which are the most frequent.
    #[inline(always)]
    fn first_symbol(&mut self, model: &mut SymbolModel) -> Option<u32> {
        model.begin_once();
        let [first_end, second_end] = model.first_ends(self.length >> models::SYMBOL_SHIFT);
        if self.value >= second_end {
            return None;
        }
        let symbol = u32::from(self.value >= first_end);
        let if_second = symbol.wrapping_neg();
        self.value -= first_end & if_second;
        self.length = first_end ^ ((first_end ^ (second_end - first_end)) & if_second);
        self.renormalise();
        model.count(symbol as usize);
        Some(symbol)
    }

    /// Decodes a symbol of a model.
    #[inline(always)]
    pub(crate) fn symbol(&mut self, model: &mut SymbolModel) -> usize {
        model.begin_once();
        let found = model.find(self.value, self.length >> models::SYMBOL_SHIFT);
        self.take(model, found)
    }

    /// Decodes a symbol after [`Decoder::first_symbol`] has excluded the first two.
    #[inline(always)]
    fn later_symbol(&mut self, model: &mut SymbolModel) -> usize {
        let found = model.find_after_two(self.value, self.length >> models::SYMBOL_SHIFT);
        self.take(model, found)
    }

    #[inline(always)]
    fn take(&mut self, model: &mut SymbolModel, (symbol, start, end): (usize, u32, Option<u32>)) -> usize {
        self.value -= start;
        // The last symbol has what the division leaves.
        self.length = end.unwrap_or(self.length) - start;
        self.renormalise();
        model.count(symbol);
        symbol
    }

    /// Reads an unsigned number of up to 32 bits, equally probable.
    pub(crate) fn bits(&mut self, bits: u32) -> u32 {
        // LASzip reads the lower 16 of more than 19 bits first.
        if bits > 19 {
            let low = self.bits(BITS_AT_ONCE);
            return self.bits(bits - BITS_AT_ONCE) << BITS_AT_ONCE | low;
        }
        self.length >>= bits;
        let number = self.value / self.length;
        self.value -= number * self.length;
        self.renormalise();
        let most = (1 << bits) - 1;
        self.is_valid &= number <= most;
        number.min(most)
    }

    /// Reads a signed number of 64 bits.
    pub(crate) fn i64(&mut self) -> i64 {
        (0..4).fold(0, |number, part| number | i64::from(self.bits(BITS_AT_ONCE)) << (16 * part))
    }
}
