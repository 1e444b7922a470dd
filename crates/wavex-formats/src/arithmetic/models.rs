//! Adaptive models of bits and symbols.

/// Binary digits of the start of a symbol as a fraction of the interval.
pub(super) const SYMBOL_SHIFT: u32 = 15;
/// Binary digits of the probability of a bit.
const BIT_SHIFT: u32 = 13;
/// Most bits between two updates of a model.
const LONGEST_BIT_CYCLE: u32 = 64;
/// Number of starts that are compared at once.
const BLOCK: usize = 16;

/// Model of a bit.
#[derive(Debug, Clone)]
pub(super) struct BitModel {
    zeros: u32,
    total: u32,
    /// Binary digits of the probability.
    digits: u32,
    probability_of_zero: u32,
    cycle: u32,
    until_update: u32,
}

impl BitModel {
    /// Creates a model of a bit.
    pub(super) fn of_bit() -> BitModel {
        BitModel::new(BIT_SHIFT)
    }

    /// Creates a model of a bit that is coded as one of two symbols.
    pub(super) fn of_two_symbols() -> BitModel {
        BitModel::new(SYMBOL_SHIFT)
    }

    fn new(digits: u32) -> BitModel {
        let probability_of_zero = 1 << (digits - 1);
        BitModel { zeros: 1, total: 2, digits, probability_of_zero, cycle: 4, until_update: 4 }
    }

    pub(super) fn restart(&mut self) {
        *self = BitModel::new(self.digits);
    }

    /// Returns the part of an interval that belongs to zero.
    #[inline(always)]
    pub(super) fn length_of_zero(&self, length: u32) -> u32 {
        self.probability_of_zero * (length >> self.digits)
    }

    #[inline(always)]
    pub(super) fn count(&mut self, bit: u32) {
        self.zeros += 1 - bit;
        self.until_update -= 1;
        if self.until_update == 0 {
            self.update();
        }
    }

    fn update(&mut self) {
        self.total += self.cycle;
        if self.total > 1 << self.digits {
            self.halve();
        }
        let scale = (1 << 31) / self.total;
        self.probability_of_zero = (self.zeros * scale) >> (31 - self.digits);
        self.cycle = (5 * self.cycle / 4).min(LONGEST_BIT_CYCLE);
        self.until_update = self.cycle;
    }

    fn halve(&mut self) {
        let ones = self.total - self.zeros;
        self.zeros = self.zeros.div_ceil(2);
        self.total = match self.digits {
            SYMBOL_SHIFT => self.zeros + ones.div_ceil(2),
            // One stays possible.
            _ => self.total.div_ceil(2).max(self.zeros + 1),
        };
    }
}

/// Model of symbols from 0.
///
/// Nothing is allocated before its first use.
#[derive(Debug, Clone)]
pub(crate) struct SymbolModel {
    symbols: usize,
    /// Start of each symbol in an interval of 2^15.
    starts: Vec<u32>,
    counts: Vec<u32>,
    total: u32,
    cycle: u32,
    /// Number of symbols until the next update; 0 before the first symbol.
    until_update: u32,
}

impl SymbolModel {
    /// Creates a model of 2 to 2048 equally probable symbols.
    pub(crate) fn new(symbols: usize) -> SymbolModel {
        let (starts, counts) = (Vec::new(), Vec::new());
        SymbolModel { symbols, starts, counts, total: 0, cycle: 0, until_update: 0 }
    }

    /// Makes all symbols equally probable again.
    #[inline(always)]
    pub(crate) fn restart(&mut self) {
        self.until_update = 0;
    }

    #[inline(always)]
    pub(super) fn begin_once(&mut self) {
        if self.until_update == 0 {
            self.begin();
        }
    }

    fn begin(&mut self) {
        self.starts.resize(self.symbols, 0);
        self.counts.clear();
        self.counts.resize(self.symbols, 1);
        self.total = self.symbols as u32;
        self.find_starts();
        self.cycle = (self.symbols as u32 + 6) / 2;
        self.until_update = self.cycle;
    }

    #[inline(always)]
    pub(super) fn count(&mut self, symbol: usize) {
        self.counts[symbol] += 1;
        self.until_update -= 1;
        if self.until_update == 0 {
            self.update();
        }
    }

    fn update(&mut self) {
        self.total += self.cycle;
        if self.total > 1 << SYMBOL_SHIFT {
            self.counts.iter_mut().for_each(|count| *count = count.div_ceil(2));
            self.total = self.counts.iter().sum();
        }
        self.find_starts();
        self.cycle = (5 * self.cycle / 4).min((self.symbols as u32 + 6) * 8);
        self.until_update = self.cycle;
    }

    fn find_starts(&mut self) {
        let scale = (1 << 31) / self.total;
        let mut sum = 0;
        for (start, count) in self.starts.iter_mut().zip(&self.counts) {
            *start = (scale * sum) >> (31 - SYMBOL_SHIFT);
            sum += count;
        }
    }

    /// Finds the symbol of a value, its start, and its end unless it is the last.
    ///
    /// `step` is the length of the interval divided by 2^15.
    #[inline(always)]
    pub(super) fn find(&self, value: u32, step: u32) -> (usize, u32, Option<u32>) {
        // Comparing all starts of a block costs less than mispredicted branches.
        let before = |starts: &[u32]| starts.iter().map(|start| usize::from(start * step <= value)).sum();
        let symbol = match self.starts[..] {
            [_, a, b, c] => before(&[a, b, c]),
            [_, a, b, c, d, e, f, g] => before(&[a, b, c, d, e, f, g]),
            _ if !self.symbols.is_multiple_of(BLOCK) => before(&self.starts[1..]),
            _ => {
                let (blocks, _) = self.starts.as_chunks::<BLOCK>();
                let is_before = |block: &[u32; BLOCK]| usize::from(block[0] * step <= value);
                let block: usize = blocks.iter().skip(1).map(is_before).sum();
                BLOCK * block + blocks.get(block).map_or(0, |block| before(&block[1..]))
            }
        };
        let start = |symbol: usize| self.starts.get(symbol).map(|start| start * step);
        (symbol, start(symbol).unwrap_or_default(), start(symbol + 1))
    }

    /// As [`SymbolModel::find`], for values after the first two symbols, and faster for the next ones.
    #[inline(always)]
    pub(super) fn find_after_two(&self, value: u32, step: u32) -> (usize, u32, Option<u32>) {
        let (mut symbol, mut start) = (2, self.starts[2] * step);
        for next_start in &self.starts[3..] {
            let end = next_start * step;
            if value < end {
                return (symbol, start, Some(end));
            }
            (symbol, start) = (symbol + 1, end);
        }
        (symbol, start, None)
    }

    /// Returns the starts of the second and the third of at least three symbols.
    #[inline(always)]
    pub(super) fn first_ends(&self, step: u32) -> [u32; 2] {
        [self.starts[1] * step, self.starts[2] * step]
    }
}
