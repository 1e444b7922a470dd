//! Extra bytes of compressed points.
//!
//! LASzip item `Byte14`, version 3, one layer per byte. A layer holds the difference of each byte
//! to the previous one, by adaptive arithmetic coding with 32-bit intervals (A. Said, "Introduction
//! to Arithmetic Coding: Theory and Practice", HPL-2004-76). The output is identical to the output
//! of the `laz` crate's compressor. Here one layer is encoded at a time: each symbol depends on the
//! interval left by the previous one, which thus stays in registers.

/// Scanner channels, each with its own frequencies.
const CHANNELS: usize = 4;
/// Values of a byte.
const SYMBOLS: usize = 256;
/// Maximum number of points added at once.
pub(super) const TOGETHER: usize = 512;

/// Layers of a chunk.
pub(super) struct ByteLayers {
    layers: Vec<ByteLayer>,
    is_used: [bool; CHANNELS],
    channel: u8,
    steps: Vec<ChannelStep>,
}

/// Dependence of a point's bytes on previous points.
#[derive(Clone, Copy)]
struct ChannelStep {
    /// Scanner channel, which selects the frequencies.
    channel: u8,
    /// Channel whose last byte is subtracted.
    from: u8,
    /// Channel whose last byte is updated.
    to: u8,
}

struct ByteLayer {
    encoder: Encoder,
    models: [Model; CHANNELS],
    last: [u8; CHANNELS],
    has_changed: bool,
}

impl ByteLayers {
    /// Starts a chunk with its first point.
    ///
    /// The extra bytes of that point are not part of the layers.
    pub(super) fn new(first: &[u8], channel: u8) -> ByteLayers {
        let layer = |byte: &u8| ByteLayer {
            encoder: Encoder::new(),
            models: std::array::from_fn(|_| Model::new()),
            last: [*byte; CHANNELS],
            has_changed: false,
        };
        let is_used = std::array::from_fn(|other| other == usize::from(channel));
        ByteLayers { layers: first.iter().map(layer).collect(), is_used, channel, steps: Vec::new() }
    }

    /// Adds up to [`TOGETHER`] points.
    ///
    /// `records` have this length and end with the extra bytes; channels are below 4.
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

    /// Advances to a point of this channel.
    ///
    /// As in LASzip version 3, the first byte after a change to an already used channel is still
    /// compared with the previous channel.
    fn step(&mut self, channel: u8) -> ChannelStep {
        let before = std::mem::replace(&mut self.channel, channel);
        let is_new = !std::mem::replace(&mut self.is_used[usize::from(channel) % CHANNELS], true);
        ChannelStep { channel, from: before, to: if is_new { channel } else { before } }
    }

    /// Returns the bytes of each layer.
    ///
    /// A layer of constant bytes is empty.
    pub(super) fn finish(self) -> impl Iterator<Item = Vec<u8>> {
        self.layers
            .into_iter()
            .map(|layer| if layer.has_changed { layer.encoder.finish() } else { Vec::new() })
    }
}

/// Adaptive symbol frequencies.
struct Model {
    /// Cumulative frequency below each symbol, in 2^-15.
    below: [u16; SYMBOLS],
    /// Count of each symbol; all are halved occasionally.
    counts: [u16; SYMBOLS],
    /// Sum of the counts at the last update.
    total: u32,
    /// Number of symbols between updates.
    cycle: u32,
    /// Number of symbols until the next update.
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

    /// Updates the frequencies from the counts; updates become less frequent.
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

/// Arithmetic encoder: interval, and finished leading bytes of its lower end.
struct Encoder {
    lower: u32,
    length: u32,
    bytes: Vec<u8>,
    n_bytes: usize,
}

/// Minimum interval length; shorter intervals are widened.
const SHORTEST: u32 = 1 << 24;

impl Encoder {
    fn new() -> Encoder {
        Encoder { lower: 0, length: u32::MAX, bytes: Vec::new(), n_bytes: 0 }
    }

    /// Encodes symbols with the frequencies of their channels.
    fn encode<'a>(
        &mut self,
        models: &mut [Model; CHANNELS],
        symbols: impl ExactSizeIterator<Item = (&'a ChannelStep, &'a u8)>,
    ) {
        // A symbol finishes at most three bytes. Four are written each time; unfinished ones are
        // overwritten.
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
            // The last symbol includes the rounding remainder.
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

    /// Finishes the encoding.
    ///
    /// Enough bytes to identify the interval, and zeros for decoder read-ahead.
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

/// Adds 1 to the big-endian number in the first `n` bytes.
#[cold]
fn carry(bytes: &mut [u8], n: usize) {
    for byte in bytes.iter_mut().take(n).rev() {
        *byte = byte.wrapping_add(1);
        if *byte != 0 {
            break;
        }
    }
}
