//! The extra bytes of compressed points: LASzip's item `Byte14`, version 3, in which each byte is a layer of its own.
//!
//! A layer holds the differences of each byte to the one before, by adaptive arithmetic coding with 32-bit intervals
//! (A. Said, "Introduction to Arithmetic Coding: Theory and Practice", HPL-2004-76). What is written is what the `laz` crate's
//! compressor writes. Here it is made a layer at a time: each symbol waits for the interval that the one before has left,
//! which so stays in registers.

/// Scanner channels, each with frequencies of its own.
const CHANNELS: usize = 4;
/// Values of a byte.
const SYMBOLS: usize = 256;
/// Points that are added at a time.
pub(super) const TOGETHER: usize = 512;

/// The layers of a chunk.
pub(super) struct ByteLayers {
    layers: Vec<Layer>,
    is_used: [bool; CHANNELS],
    channel: u8,
    steps: Vec<Step>,
}

/// What a point's bytes have to do with those of points before.
#[derive(Clone, Copy)]
struct Step {
    /// Its scanner channel, which chooses the frequencies.
    channel: u8,
    /// The channel whose last byte a byte is compared with.
    from: u8,
    /// The channel whose last byte it becomes.
    to: u8,
}

struct Layer {
    encoder: Encoder,
    models: [Model; CHANNELS],
    last: [u8; CHANNELS],
    has_changed: bool,
}

impl ByteLayers {
    /// For a chunk whose first point has these extra bytes, which are not in the layers, and this scanner channel.
    pub(super) fn new(first: &[u8], channel: u8) -> ByteLayers {
        let layer = |byte: &u8| Layer {
            encoder: Encoder::new(),
            models: std::array::from_fn(|_| Model::new()),
            last: [*byte; CHANNELS],
            has_changed: false,
        };
        let is_used = std::array::from_fn(|other| other == usize::from(channel));
        ByteLayers { layers: first.iter().map(layer).collect(), is_used, channel, steps: Vec::new() }
    }

    /// Adds up to [`TOGETHER`] points: records of this length, which end with the extra bytes, and their channels, below 4.
    pub(super) fn add(&mut self, records: &[u8], record_length: usize, channels: &[u8]) {
        let is_constant = channels.iter().all(|channel| *channel == self.channel);
        self.steps.clear();
        for channel in channels {
            let step = self.step(*channel);
            self.steps.push(step);
        }
        let mut differences = [0; TOGETHER];
        let first = record_length - self.layers.len().min(record_length);
        for (layer, at) in self.layers.iter_mut().zip(first..) {
            let bytes = records.chunks_exact(record_length).map(|record| record[at]);
            let bytes = differences.iter_mut().zip(bytes);
            let mut changes = 0;
            if is_constant {
                let last = &mut layer.last[usize::from(self.channel) % CHANNELS];
                for (difference, byte) in bytes {
                    *difference = byte.wrapping_sub(std::mem::replace(last, byte));
                    changes |= *difference;
                }
            } else {
                for ((difference, byte), step) in bytes.zip(&self.steps) {
                    *difference = byte.wrapping_sub(layer.last[usize::from(step.from) % CHANNELS]);
                    layer.last[usize::from(step.to) % CHANNELS] = byte;
                    changes |= *difference;
                }
            }
            layer.has_changed |= changes != 0;
            layer.encoder.encode(&mut layer.models, self.steps.iter().zip(&differences));
        }
    }

    /// The next point is of this channel. The first byte after a change to a channel that was there before is still
    /// compared with that of the other channel: so does version 3 of LASzip.
    fn step(&mut self, channel: u8) -> Step {
        let before = std::mem::replace(&mut self.channel, channel);
        let is_new = !std::mem::replace(&mut self.is_used[usize::from(channel) % CHANNELS], true);
        Step { channel, from: before, to: if is_new { channel } else { before } }
    }

    /// The bytes of each layer; a layer in which all bytes are the same has none.
    pub(super) fn finish(self) -> impl Iterator<Item = Vec<u8>> {
        self.layers
            .into_iter()
            .map(|layer| if layer.has_changed { layer.encoder.finish() } else { Vec::new() })
    }
}

/// How frequent the symbols were so far.
struct Model {
    /// The share of all symbols below each one, in 2^-15.
    below: [u16; SYMBOLS],
    /// How often each symbol came, all halved now and then.
    counts: [u16; SYMBOLS],
    /// The sum of the counts at the last update.
    total: u32,
    /// Symbols between updates.
    cycle: u32,
    /// Symbols until the next update.
    left: u32,
}

impl Model {
    fn new() -> Model {
        let cycle = SYMBOLS as u32;
        let mut model = Model { below: [0; SYMBOLS], counts: [1; SYMBOLS], total: 0, cycle, left: 0 };
        model.update();
        model.cycle = (SYMBOLS as u32 + 6) / 2;
        model.left = model.cycle;
        model
    }

    /// Takes the counts over, from time to time and ever more seldom.
    fn update(&mut self) {
        self.total += self.cycle;
        if self.total > 1 << 15 {
            self.counts.iter_mut().for_each(|count| *count = count.div_ceil(2));
            self.total = self.counts.iter().map(|count| u32::from(*count)).sum();
        }
        let share = (1 << 31) / self.total;
        let mut sum = 0;
        for (below, count) in self.below.iter_mut().zip(&self.counts) {
            *below = ((share * sum) >> 16) as u16;
            sum += u32::from(*count);
        }
        self.cycle = (5 * self.cycle / 4).min((SYMBOLS as u32 + 6) * 8);
        self.left = self.cycle;
    }
}

/// An interval of numbers, and the leading bytes of its lower end that are settled.
struct Encoder {
    lower: u32,
    length: u32,
    bytes: Vec<u8>,
    n_bytes: usize,
}

/// An interval is widened while it is shorter.
const SHORTEST: u32 = 1 << 24;

impl Encoder {
    fn new() -> Encoder {
        Encoder { lower: 0, length: u32::MAX, bytes: Vec::new(), n_bytes: 0 }
    }

    /// Adds symbols, each by the frequencies of its point's channel.
    fn encode<'a>(
        &mut self,
        models: &mut [Model; CHANNELS],
        symbols: impl ExactSizeIterator<Item = (&'a Step, &'a u8)>,
    ) {
        // A symbol settles three bytes at most; four are written each time, of which those not settled are overwritten.
        let most = self.n_bytes + 3 * symbols.len() + 4;
        if self.bytes.len() < most {
            self.bytes.resize(2 * most, 0);
        }
        let Encoder { mut lower, mut length, ref mut bytes, n_bytes: mut at } = *self;
        for (step, symbol) in symbols {
            let model = &mut models[usize::from(step.channel) % CHANNELS];
            let symbol = usize::from(*symbol);
            let unit = length >> 15;
            let start = u32::from(model.below[symbol]) * unit;
            // The last symbol takes what rounding leaves, too.
            let next = u32::from(model.below[(symbol + 1) % SYMBOLS]) * unit;
            let end = if symbol + 1 == SYMBOLS { length } else { next };
            let (sum, overflows) = lower.overflowing_add(start);
            if overflows {
                carry(bytes, at);
            }
            length = end - start;
            let settled_bits = length.leading_zeros() / 8 * 8;
            if let Some(place) = bytes.get_mut(at..at + 4) {
                place.copy_from_slice(&sum.to_be_bytes());
            }
            at += (settled_bits / 8) as usize;
            lower = sum << settled_bits;
            length <<= settled_bits;
            model.counts[symbol] += 1;
            model.left -= 1;
            if model.left == 0 {
                model.update();
            }
        }
        (self.lower, self.length, self.n_bytes) = (lower, length, at);
    }

    /// All bytes: at the end enough to tell the interval from others, and zeros that decoders read ahead.
    fn finish(mut self) -> Vec<u8> {
        let is_long = self.length > 2 * SHORTEST;
        let (step, settled, zeros) = if is_long { (SHORTEST, 1, 3) } else { (SHORTEST / 2, 2, 2) };
        let (lower, overflows) = self.lower.overflowing_add(step);
        if overflows {
            carry(&mut self.bytes, self.n_bytes);
        }
        self.bytes.truncate(self.n_bytes);
        self.bytes.extend(lower.to_be_bytes().into_iter().take(settled));
        self.bytes.resize(self.n_bytes + settled + zeros, 0);
        self.bytes
    }
}

/// Adds 1 to the number that the first `n` bytes are.
#[cold]
fn carry(bytes: &mut [u8], n: usize) {
    for byte in bytes.iter_mut().take(n).rev() {
        *byte = byte.wrapping_add(1);
        if *byte != 0 {
            break;
        }
    }
}
